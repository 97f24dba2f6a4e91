//! What a run gives back.

use crate::error::{Error, Result};
use crate::model::Sequence;
use crate::result::{Tally, TraceResult};
use crate::run::TraceOptions;
use crate::run::checkpoint::{self, Identity};
use crate::run::proof::Proof;
use glam::DVec3;
use std::collections::HashMap;

/// What a run gives back.
#[derive(Debug)]
pub struct Outcome {
    /// What users read: maps, ledger, warnings, and how the scene was traced.
    pub result: TraceResult,
    /// The sums.
    pub tally: Tally,
    /// The trace to which the sums belong.
    pub identity: Identity,
    /// The proof of the sums, where one was kept ([`crate::Run::proof`]).
    pub proof: Option<Proof>,
    /// The options that the scene was traced with.
    pub options: TraceOptions,
    /// Where some ray came to the end of each path of the table, if there is one, in the scene's frame \[mm\].
    pub found_paths: HashMap<Sequence, DVec3>,
    /// What became of the sums that were to be saved.
    pub saved: Saved,
}

/// What became of sums that were to be saved in a file ([`crate::Run::checkpoint`]).
#[derive(Debug, Clone, PartialEq)]
pub enum Saved {
    /// No file was named.
    NoFile,
    /// They are in the file.
    Written,
    /// The file holds so many rays of this trace, more than were traced now, and was kept.
    Kept(u64),
    /// They could not be written.
    Failed(Error),
}

impl Outcome {
    /// The contents of a file of sums, such as `tally.bin`, which `nsq-gpu merge` adds up.
    ///
    /// # Errors
    /// [`Error::Internal`] if the sums cannot be encoded.
    pub fn sums(&self) -> Result<Vec<u8>> {
        checkpoint::encode(&self.identity, &self.tally, self.proof.as_ref())
    }
}

/// What to say where a target was asked for and missed, with the rays that would do.
pub fn missed_target(result: &TraceResult) -> Option<String> {
    let target = result.run.target_error?;
    let percent = |fraction: f64| format!("{:.3} %", 100.0 * fraction);
    let has_few_rays =
        || result.detectors.iter().any(|detector| detector.few_rays.is_some_and(|few| few.rests_on > 0));
    match result.relative_error {
        Some(error) if error <= target => None,
        Some(error) if has_few_rays() => Some(format!(
            "the relative error is {}, above the target of {}. The flux of a detector rests on fewer than 10 rays. So few \
             rays do not say how many are needed",
            percent(error),
            percent(target),
        )),
        Some(error) => Some(format!(
            "the relative error is {}, above the target of {}; it falls as 1 / sqrt(rays), so give about -n {:.1e}",
            percent(error),
            percent(target),
            result.num_rays_total as f64 * (error / target).powi(2)
        )),
        None => Some(format!(
            "the relative error is not known, and so not below the target of {}",
            percent(target)
        )),
    }
}
