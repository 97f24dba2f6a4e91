//! What the user wrote, proven valid, in f64.

pub mod materials;
