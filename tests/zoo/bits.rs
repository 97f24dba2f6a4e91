//! The committed bits of every scene, tests/data/bits.json: those of lavapipe in strict arithmetic.

use std::collections::BTreeMap;
use std::path::PathBuf;

use super::files::repository;
use nsq_gpu::TraceOptions;
use nsq_gpu::program::Precision;
use nsq_gpu::result::{DetectorTally, SurfaceTally, Tally};
use nsq_gpu::run::Strict;
use serde::Serialize;
use sha2::{Digest, Sha256};

pub fn bits_file() -> PathBuf {
    repository("tests/data/bits.json")
}

/// The hashes by the names of scenes.
pub fn committed() -> BTreeMap<String, String> {
    serde_json::from_str(&std::fs::read_to_string(bits_file()).unwrap()).unwrap()
}

/// The sums of a surface as they were when the hashes were committed: without the counts of rays on wrong sides.
fn surface_then(SurfaceTally { reached, absorbed, .. }: &SurfaceTally) -> impl Serialize + use<> {
    (*reached, *absorbed)
}

/// The same of a detector.
fn detector_then(sums: &DetectorTally) -> impl Serialize + '_ {
    let DetectorTally { quanta, hits, recorded, rows, squares, totals, replicates, .. } = sums;
    (quanta, hits, recorded, rows, squares, totals, replicates)
}

/// All that a trace has summed up, but for what came later than the committed hashes.
pub fn hash(tally: &Tally) -> String {
    let detectors: Vec<_> = tally.detectors.iter().map(detector_then).collect();
    let surfaces: Vec<_> = tally.surfaces.iter().map(surface_then).collect();
    let begins = (tally.launched, &tally.rays, detectors, surfaces);
    let mut bytes = postcard::to_allocvec(&begins).unwrap();
    let rest = Tally { detectors: Vec::new(), surfaces: Vec::new(), ..tally.clone() };
    // Launched rays come first, then two empty lists.
    let rest = postcard::to_allocvec(&rest).unwrap();
    let before = postcard::to_allocvec(&(tally.launched, &tally.rays, [0_u8; 2])).unwrap().len();
    bytes.extend_from_slice(&rest[before..]);
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
