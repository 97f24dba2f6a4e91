//! The features of a scene, and the WGSL specialised to them.

pub mod library;
pub mod rng;
