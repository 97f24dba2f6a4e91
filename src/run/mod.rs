//! A run: a scene, options and a device, from the choice of a precision to the report.
//!
//! [`Tracer`] is a scene ready to trace. [`precision`] chooses the tier, [`stopping`] ends a trace early, and
//! [`checkpoint`] keeps sums in a file. [`difference`] and [`gradients`] trace in blocks of rays.

pub mod additions;
mod blocks;
pub mod checkpoint;
pub mod difference;
pub mod gradients;
pub mod precision;
pub mod stopping;
mod tracer;

pub use crate::engine::options::{Collect, RecordPaths, StandardError, Strict, TraceOptions};
pub use crate::engine::shelf::Shelf;
pub use crate::engine::wavefront::Progress;
pub use crate::run::tracer::Tracer;
