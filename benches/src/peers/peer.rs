//! What a program must do to be compared.

use crate::cases::Case;
use nsq_gpu::Result;
use std::collections::BTreeMap;

/// A program for comparison.
pub trait Peer {
    /// The peer's name in tables.
    fn name(&self) -> &'static str;
    /// Versions of the peer's parts.
    fn versions(&self) -> BTreeMap<String, String>;
    /// True if the peer can trace the case.
    fn takes(&self, case: &Case) -> bool;
    /// Prepares for the first run of a case.
    ///
    /// # Errors
    /// As [`Peer::run`].
    fn warm_up(&mut self, case: &Case) -> Result<()>;
    /// Traces the case once. Returns a timing for each precision in which the peer computes.
    ///
    /// # Errors
    /// [`nsq_gpu::Error::Usage`] if the peer cannot be run, [`nsq_gpu::Error::Internal`] if it launched another number of
    /// rays.
    fn run(&mut self, case: &Case) -> Result<Vec<PeerRun>>;
}

/// One timing of a peer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PeerRun {
    /// `f32` or `f64`.
    pub precision: &'static str,
    /// Rays launched.
    pub num_rays: u64,
    /// Time that the rays took \[s\].
    pub seconds: f64,
    /// Rays that ended on detectors, if the peer reports them. Their share must be this program's.
    pub detected: Option<u64>,
}
