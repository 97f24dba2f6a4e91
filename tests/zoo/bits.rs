//! The committed bits of every scene, tests/data/bits.json: those of lavapipe in strict arithmetic.

use std::collections::BTreeMap;
use std::path::PathBuf;

use super::files::repository;
use nsq_gpu::TraceOptions;
use nsq_gpu::program::Precision;
use nsq_gpu::result::Tally;
use nsq_gpu::trace::Strict;
use sha2::{Digest, Sha256};

pub fn bits_file() -> PathBuf {
    repository("tests/data/bits.json")
}

/// The hashes by the names of scenes.
pub fn committed() -> BTreeMap<String, String> {
    serde_json::from_str(&std::fs::read_to_string(bits_file()).unwrap()).unwrap()
}

/// All that a trace has summed up.
pub fn hash(tally: &Tally) -> String {
    let mut bytes = postcard::to_allocvec(tally).unwrap();
    // The sums of filters and of paths came later than the committed hashes. Where nobody asks for them they are empty: a
    // count and quanta of 0, and no table.
    let empty = [0; 3];
    assert!(bytes.ends_with(&empty) && tally.path_sums.is_none());
    bytes.truncate(bytes.len() - empty.len());
    Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The precision of a scene, by its number among all: f32 and f64 by turns.
pub fn precision(number: usize) -> Precision {
    if number.is_multiple_of(2) { Precision::F32 } else { Precision::F64 }
}

/// The options that the bits are of.
pub fn options(precision: Precision) -> TraceOptions {
    TraceOptions { num_rays: 3000, seed: 11, precision, strict: Strict::On, ..TraceOptions::default() }
}
