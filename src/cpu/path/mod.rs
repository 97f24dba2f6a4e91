//! The hot path, which most rays take, and the side traces, which most others take. Each has a stage of its own, whose
//! guards check what the stage assumes. A ray that fails a guard falls back on the plain stages.

pub(crate) mod compose;
pub mod fallback;
mod follow;
pub mod hot_path;
pub mod miss_test;
pub mod path_log;
pub(crate) mod path_sums;
pub mod pays;
pub mod profile;
pub mod sampled_path;
pub mod side_trace;
