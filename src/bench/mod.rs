//! Measures how fast scenes are traced. This program and its peers run cases in turns, and the times become statistics
//! and files.
//!
//! ```text
//! cases       the scenes of Optiland's harness and others, as scene files
//! runner      warm-up, then runs in turns; launched = counted, in every run
//! peers       Optiland, Mitsuba and a Dr.Jit kernel, as children
//! viewer      frames a second of the viewer's window
//! statistics  median, least and greatest of the runs; ratios
//! report      one JSON document, CSV and a chart
//! tuning      how to cut work for an adapter
//! accuracy    error against time of every tier, sampler and setting
//! growth      how the cost grows with surfaces, depth and rays
//! stability   scenes where tracers fail, each with its exact answer
//! ```
//!
//! A benchmark is not a test: nothing here passes or fails by the clock. [`stability`] and [`accuracy`] can fail, by
//! their answers.

pub mod accuracy;
pub mod cases;
pub mod gradients;
pub mod growth;
pub mod machine;
pub mod paths;
pub mod peers;
pub mod report;
pub mod runner;
pub mod stability;
pub mod statistics;
pub mod tuning;
#[cfg(feature = "viewer")]
pub mod viewer;

pub use crate::bench::cases::{Case, Kind};
pub use crate::bench::peers::Peer;
pub use crate::bench::report::{BenchReport, ViewerResult};
pub use crate::bench::runner::{CaseResult, Counts, Session};
pub use crate::bench::statistics::Summary;
