//! What the rays of a pilot trace did.

use glam::DVec3;

/// What a pilot's rays say of the path.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PilotPath {
    /// The primitives that they meet, in their order: surfaces first, then detectors.
    pub primitives: Vec<usize>,
    /// Of each ray that takes it.
    pub ways: Vec<Way>,
    /// Behind the last of the primitives they escape.
    pub escapes: bool,
    /// They are such a share of all rays.
    pub share: f64,
}

/// Where a ray is born, where it meets the primitives of its path and, if it was killed, where, or if it escapes, a place
/// behind the last of them; and what it weighs there.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Way {
    /// \[mm\]
    pub positions: Vec<DVec3>,
    /// On arrival.
    pub weights: Vec<f64>,
}
