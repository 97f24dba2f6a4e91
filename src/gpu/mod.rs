//! Mechanics of wgpu: adapter, buffers, pipelines, read-back. No optics.

pub mod sums;
