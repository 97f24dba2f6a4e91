//! The paths that the rays of a profiling run took.

use glam::DVec3;

/// A path, and the profiled rays that take it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ProfiledPath {
    /// The primitives that they meet, in their order: surfaces first, then detectors.
    pub primitives: Vec<usize>,
    /// A sample of each ray that takes the path.
    pub samples: Vec<SampledPath>,
    /// True if rays escape behind the last primitive.
    pub escapes: bool,
    /// The share of all rays that take the path.
    pub share: f64,
}

/// The path of one ray: where it is born, where it meets primitives, and what it weighs there. A ray that is killed
/// ends where it was killed. A ray that escapes ends at a place behind its last primitive.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SampledPath {
    /// The places of its birth, its events and its end \[mm\].
    pub positions: Vec<DVec3>,
    /// What the ray weighs when it arrives there.
    pub weights: Vec<f64>,
}
