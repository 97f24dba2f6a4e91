//! The deposit log, which the host adds up.

pub(crate) mod bits;
pub mod buffers;
pub(crate) mod corners;
pub mod deposit_sums;
pub(crate) mod entries;
pub mod format;
pub(crate) mod positions;
pub(crate) mod reals;
