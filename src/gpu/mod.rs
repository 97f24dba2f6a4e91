//! Mechanics of wgpu: adapters, pipelines, buffers, read-back. No optics.

pub mod adapter;
pub mod compute;
pub mod double_word;
pub mod profile;
pub mod rates;
pub mod sums;

pub use adapter::{AdapterChoice, AdapterInfo, Gpu, Native, list_adapters};
