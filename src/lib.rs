//! nsq-gpu traces Optiland's non-sequential scenes by Monte Carlo on any GPU that wgpu reaches.
//!
//! A lens from a file, traced:
//!
//! ```
//! use nsq_gpu::{Result, Run};
//!
//! # fn main() -> Result<()> {
//! # if nsq_gpu::gpu::list_adapters().is_empty() { return Ok(()); }
//! let outcome = Run::open("docs/example.json")?.rays(1e5)?.go()?;
//! assert!(outcome.result.ledger.closes());
//! println!("{}", outcome.result.report());
//! # Ok(())
//! # }
//! ```
//!
//! The flow, one direction; no module looks upstream:
//!
//! ```text
//! scene JSON -> scene    what the user wrote, proven valid, f64
//!            -> model    flat surfaces, media, sources, detectors, sampling
//!            -> program  features of the scene -> specialised WGSL and its buffers
//!            -> engine   a fold: Tally += pass(range of ray ids)
//!            -> result   maps, ledger, diagnostics -> files, command, viewer, Python
//! ```
//!
//! [`run`] is the face of the engine: a [`Run`] goes from options to the report, as `nsq-gpu trace` does. [`cpu`]
//! holds what is done otherwise on adapters that are processors, where most rays of a scene take one path. [`gpu`]
//! holds the mechanics of wgpu and knows no optics.
//!
//! [`folders`] knows where a user keeps settings and caches, `placing` puts files in their places, and [`mesa`] keeps
//! drivers silent. [`cli`] is the only place that prints, and [`bench`] measures. The module `viewer`, behind the
//! feature of that name, is the window of `nsq-gpu view`.

#![cfg_attr(
    not(feature = "cpu"),
    allow(dead_code, unused_imports, reason = "some parts of the engine are for the wing alone")
)]

#[cfg(feature = "cpu")]
pub mod bench;
pub mod cli;
pub mod count;
#[cfg(feature = "cpu")]
#[warn(clippy::wildcard_enum_match_arm, reason = "as in `model`")]
pub mod cpu;
pub mod derivatives;
pub mod engine;
pub mod error;
pub mod folders;
pub mod format;
pub mod gpu;
pub mod mesa;
#[warn(
    clippy::wildcard_enum_match_arm,
    reason = "whoever adds a kind must be told of every place that knows kinds"
)]
pub mod model;
pub mod paths;
mod placing;
#[warn(clippy::wildcard_enum_match_arm, reason = "as in `model`")]
pub mod program;
#[warn(clippy::wildcard_enum_match_arm, reason = "as in `model`")]
pub mod result;
pub mod run;
#[warn(clippy::wildcard_enum_match_arm, reason = "as in `model`")]
pub mod scene;
pub mod shaders;
#[cfg(feature = "viewer")]
pub mod viewer;

pub use crate::error::{Error, Result};
pub use crate::result::TraceResult;
pub use crate::run::{Outcome, Progress, Run, StandardError, TraceOptions, Tracer};
pub use crate::scene::Scene;
