//! The path that most rays take, and those of most others, which have stages of their own.

pub(crate) mod adder;
pub mod clearance;
pub(crate) mod compose;
mod follow;
pub mod main_path;
pub mod path_log;
pub mod pays;
pub mod pilot;
pub mod rejected;
pub mod side_path;
pub mod ways;
