//! What the device reads and sums: records, tables, cells, and the buffers that they lie in.

pub mod bindings;
pub mod bsdf;
pub mod coating;
pub mod kind_tables;
pub mod numbers;
pub mod reals;
pub mod rng;
pub mod row_table;
pub mod splitting;
pub mod sums;
pub mod tables;
pub mod words;
