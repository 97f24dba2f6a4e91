//! Mechanics of wgpu: adapters, pipelines, buffers, read-back. The room `gpu` knows no optics.

pub mod adapter;
pub mod adapter_class;
pub mod adapter_name;
pub mod compute;
mod no_adapter;
pub mod processors;
pub mod profile;
pub mod rounding;
pub mod strict;

pub use crate::gpu::adapter::{AdapterChoice, AdapterInfo, Gpu, Native, Ways, list_adapters};
pub use crate::gpu::adapter_class::AdapterClass;
