//! Why a trace ended before its last ray.

use serde::{Deserialize, Serialize};

/// Why a trace ended before its last ray.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StoppedBy {
    /// Ctrl-C.
    Interrupt,
    /// The time limit.
    TimeLimit,
    /// The target for the error was met.
    TargetError,
}
