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
//! [`run`] is the face of the engine: a [`Run`] goes from options to the report, as `nsq-gpu trace` does. Four rooms
//! hold additions to the engine's loop. `paths` sorts light by its path, and `derivatives` has derivatives by numbers
//! of the scene. [`guide`] sends rays to rare light. [`cpu`] has what pays on adapters that are processors. [`gpu`]
//! holds the mechanics of wgpu and knows no optics.
//!
//! [`folders`] knows where a user keeps settings and caches, `placing` puts files in their places, and [`mesa`] keeps
//! drivers silent. [`cli`] is the only place that prints. The module `viewer`, behind the feature of that name, is the
//! window of `nsq-gpu view`.

#![cfg_attr(
    not(feature = "cpu"),
    allow(dead_code, unused_imports, reason = "some parts of the engine are for the CPU backend alone")
)]

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
pub mod guide;
pub mod mesa;
#[warn(
    clippy::wildcard_enum_match_arm,
    reason = "whoever adds a kind must learn of every place that knows kinds"
)]
pub mod model;
pub mod paths;
mod placing;
#[warn(clippy::wildcard_enum_match_arm, reason = "as in `model`")]
pub mod program;
mod random;
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

/// What `nsq-bench` needs of this library beyond what users get. Nothing here is a contract.
#[doc(hidden)]
#[cfg(all(feature = "cpu", feature = "viewer"))]
pub mod internals {
    pub use crate::cli::console::{print, say};
    pub use crate::cli::main_of;
    pub use crate::cli::output_file::check_places;
    pub use crate::count;
    pub use crate::cpu::adapter_traits::AdapterTraits;
    pub use crate::cpu::{CpuOverrides, Override};
    pub use crate::engine::tuning::{EVENTS_PER_DISPATCH, Tuning, WORKGROUP_SIZES};
    pub use crate::format::pretty_json;
    pub use crate::gpu::processors;
    pub use crate::result::output::REPORT;
    pub use crate::viewer::screenshot::OffscreenTexture;
    pub use crate::viewer::settings::Settings;
    pub use crate::viewer::tracing::Device;
    pub use crate::viewer::{App, Model, RENDERER};
    pub use eframe::egui;

    /// Writes a file, which appears whole or not at all.
    ///
    /// # Errors
    /// [`Error::File`](crate::Error::File) with the file that could not be written.
    pub fn replace_file(path: &std::path::Path, bytes: &[u8]) -> crate::Result<()> {
        crate::placing::replace_file(path, bytes).map_err(|error| crate::Error::file(path, error))
    }

    /// The program that is measured.
    pub const PROGRAM: &str = env!("CARGO_PKG_NAME");
    /// Its version.
    pub const VERSION: &str = env!("CARGO_PKG_VERSION");
}
