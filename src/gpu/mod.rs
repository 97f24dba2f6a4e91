//! Mechanics of wgpu: adapters, pipelines, buffers, read-back. No optics.

pub mod adapter;
pub mod compute;
pub mod double_word;
mod end_corners;
mod end_entries;
pub mod end_log;
mod end_paths;
mod end_positions;
mod end_reals;
pub mod end_sums;
pub mod profile;
pub mod rates;
pub mod strays;
pub mod strict;
pub mod sums;
pub mod tuning;

pub use adapter::{AdapterChoice, AdapterInfo, Gpu, Native, Ways, list_adapters};
