//! `nsq-bench`: measures how fast scenes are traced. This program and its peers run cases in turns, and the times become statistics
//! and files.
//!
//! ```text
//! cases       the scenes of Optiland's harness and others, as scene files
//! runner      warm-up, then runs in turns; launched = counted, in every run
//! peers       Optiland, Mitsuba and a Dr.Jit kernel, as children
//! viewer      frames a second of the viewer's window
//! statistics  median, least and greatest of the runs; ratios
//! report      one JSON document and CSV
//! tuning      how to cut work for an adapter
//! growth      how the cost grows with surfaces, depth and rays
//! stability   scenes where tracers fail, each with its exact answer
//! ```
//!
//! A benchmark is not a test: nothing here passes or fails by the clock. [`stability`] can fail, by its
//! answers. `benches/accuracy.py` measures error against time, and `benches/draw.py` draws what was measured.

pub mod cases;
pub mod command;
pub mod gradients;
pub mod growth;
pub mod machine;
pub mod parts;
pub mod paths;
pub mod peers;
pub mod report;
pub mod runner;
pub mod stability;
pub mod statistics;
pub mod tuning;
pub mod viewer;

pub use crate::cases::{Case, Kind};
pub use crate::peers::Peer;
pub use crate::report::{BenchReport, ViewerResult};
pub use crate::runner::{CaseResult, Counts, Session};
pub use crate::statistics::Summary;
