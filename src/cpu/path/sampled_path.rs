//! The paths that the rays of a profiling run took.

use glam::DVec3;

/// A path, and the profiled rays that take it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ProfiledPath {
    /// The primitives that they meet, in their order: surfaces first, then detectors.
    pub primitives: Vec<usize>,
    /// Of each ray that takes it.
    pub samples: Vec<SampledPath>,
    /// Behind the last of the primitives they escape.
    pub escapes: bool,
    /// They are such a share of all rays.
    pub share: f64,
}

/// The path of one ray: where it is born, where it meets the primitives of its path and, if it was killed, where, or if it escapes, a place
/// behind the last of them; and what it weighs there.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SampledPath {
    /// \[mm\]
    pub positions: Vec<DVec3>,
    /// On arrival.
    pub weights: Vec<f64>,
}
