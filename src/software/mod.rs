//! All that is done otherwise on adapters that are processors.

pub mod extension;
pub mod log;
pub mod logs;
pub mod path;
pub mod vector_width;
