//! What a trace consists of: options and limits, ranges of rays, stages on a device, and how their sums are read back.

pub mod budget;
pub mod device;
pub mod dispatch_size;
pub mod double_word;
pub mod intake;
pub mod options;
pub mod pace;
pub mod rates;
pub mod sums;
pub mod tuning;
