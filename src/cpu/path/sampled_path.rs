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

/// The path of one ray: where it is born, where it meets primitives, and what it weighs there. A ray that is killed
/// ends where it was killed. A ray that escapes ends at a place behind its last primitive.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SampledPath {
    /// \[mm\]
    pub positions: Vec<DVec3>,
    /// On arrival.
    pub weights: Vec<f64>,
}
