//! What a program must do to be compared with.

use crate::bench::cases::Case;
use crate::error::Result;
use std::collections::BTreeMap;

/// A program to compare with.
pub trait Peer {
    /// Its name in tables.
    fn name(&self) -> &'static str;
    /// Versions of what it is made of.
    fn versions(&self) -> BTreeMap<String, String>;
    /// True if it can trace the case.
    fn takes(&self, case: &Case) -> bool;
    /// Whatever should be done before the first run of a case.
    ///
    /// # Errors
    /// As [`Peer::run`].
    fn warm_up(&mut self, case: &Case) -> Result<()>;
    /// Traces the case once: a timing for each precision that it computes in.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if it cannot be run, [`crate::Error::Internal`] if it launched another number of rays.
    fn run(&mut self, case: &Case) -> Result<Vec<PeerRun>>;
}

/// One timing of a peer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PeerRun {
    /// `f32` or `f64`.
    pub precision: &'static str,
    /// Rays launched.
    pub num_rays: u64,
    /// Time that they took \[s\].
    pub seconds: f64,
    /// Rays that ended on detectors, where the peer tells: its share must be this program's.
    pub detected: Option<u64>,
}
