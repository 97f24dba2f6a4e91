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
//! [`precision`] predicts, by a pilot trace, what error f32 makes in a scene.
//! [`nominal`] finds, by a pilot trace, the path that most rays take, and those of most others, so that they can have stages
//! of their own.
//! [`stopping`] and [`checkpoint`] are callers of the fold: when it is good enough, and how it survives.
//! [`folders`] knows where a user keeps settings and caches, [`processors`] how many threads are worth their start. `placing`
//! puts files in their places, and [`mesa`] keeps drivers silent.
//! [`gpu`] holds the mechanics of wgpu and knows no optics; [`cli`] is the only place that prints; [`bench`] measures;
//! `viewer`, behind the feature of that name, is the window of `nsq-gpu view`.

pub mod bench;
pub mod checkpoint;
pub mod cli;
pub mod error;
pub mod folders;
pub mod gpu;
#[warn(
    clippy::wildcard_enum_match_arm,
    reason = "whoever adds a kind must be told of every place that knows kinds"
)]
pub mod ir;
pub mod mesa;
#[warn(clippy::wildcard_enum_match_arm, reason = "as in `ir`")]
pub mod nominal;
mod placing;
pub mod precision;
pub mod processors;
#[warn(clippy::wildcard_enum_match_arm, reason = "as in `ir`")]
pub mod program;
#[warn(clippy::wildcard_enum_match_arm, reason = "as in `ir`")]
pub mod result;
#[warn(clippy::wildcard_enum_match_arm, reason = "as in `ir`")]
pub mod scene;
pub mod stopping;
pub mod trace;
pub mod vectors;
#[cfg(feature = "viewer")]
pub mod viewer;

pub use error::{Error, Result};
pub use result::TraceResult;
pub use scene::Scene;
pub use trace::{Progress, StandardError, TraceOptions, Tracer};
