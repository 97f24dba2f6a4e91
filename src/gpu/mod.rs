//! Mechanics of wgpu: adapters, pipelines, buffers, read-back. No optics.

pub mod adapter;
pub mod compute;
pub mod double_word;
pub mod end_log;
mod end_positions;
pub mod end_sums;
pub mod profile;
pub mod rates;
pub mod strict;
pub mod sums;
pub mod tuning;

pub use adapter::{AdapterChoice, AdapterInfo, Gpu, Native, list_adapters};
