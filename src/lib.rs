//! nsq-gpu traces Optiland's non-sequential scenes by Monte Carlo on any GPU that wgpu reaches.
//!
//! The flow, one direction; no module looks upstream:
//!
//! ```text
//! scene JSON -> scene    what the user wrote, proven valid, f64
//!            -> ir       flat surfaces, media, emitters, sensors, sampling
//!            -> program  features of the scene -> specialised WGSL and its buffers
//!            -> trace    a fold: Tally += pass(range of ray ids)
//!            -> result   maps, ledger, diagnostics -> files, command, viewer, Python
//! ```
//!
//! [`gpu`] holds the mechanics of wgpu and knows no optics; [`cli`] is the only place that prints; [`bench`] measures;
//! `viewer`, behind the feature of that name, is the window of `nsq-gpu view`.

pub mod bench;
pub mod cli;
pub mod error;
pub mod gpu;
pub mod ir;
pub mod program;
pub mod result;
pub mod scene;
pub mod trace;
#[cfg(feature = "viewer")]
pub mod viewer;

pub use error::{Error, Result};
pub use result::TraceResult;
pub use scene::Scene;
pub use trace::{TraceOptions, Tracer};
