//! The log of where rays end, which the host adds up.

pub mod adder;
pub(crate) mod bits;
pub(crate) mod corners;
pub(crate) mod entries;
pub mod format;
pub(crate) mod positions;
pub(crate) mod reals;
