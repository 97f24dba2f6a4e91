//! What the traces of a verification have in common: options like the result's, and draws that follow from its hash.

use crate::error::Result;
use crate::model::{PathFilter, SceneIr};
use crate::program::Sampler;
use crate::result::RunInfo;
use crate::run::TraceOptions;
use sha2::{Digest, Sha256};
use std::sync::Arc;

/// Options that give the same light: all but the rays, the precision and the standard errors.
pub(super) fn options_like(run: &RunInfo, ir: &SceneIr) -> Result<TraceOptions> {
    let filter = run.filter.as_ref().map(|text| PathFilter::parse(text, ir)).transpose()?;
    Ok(TraceOptions {
        seed: run.seed,
        max_depth: run.max_depth,
        min_flux_fraction: run.min_flux_fraction,
        sampler: if run.sampler == Sampler::Sobol.name() { Sampler::Sobol } else { Sampler::Pcg },
        path_filter: filter.map(Arc::new),
        ..TraceOptions::default()
    })
}

/// The first bytes of the SHA-256 of a text, eight at most, as a number.
pub(super) fn word_of(text: &str, num_bytes: usize) -> u64 {
    Sha256::digest(text).iter().take(num_bytes).fold(0, |word, byte| word << 8 | u64::from(*byte))
}
