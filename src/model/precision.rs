//! The arithmetic of a trace.

use crate::model::double_word;

/// Precision of the physics.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Precision {
    /// 32-bit floats: every adapter.
    F32,
    /// Pairs of 32-bit floats: adapters whose arithmetic passes a test.
    Df64,
    /// 64-bit floats: adapters with the feature.
    F64,
}

impl Precision {
    /// The name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Precision::F32 => "f32",
            Precision::Df64 => "df64",
            Precision::F64 => "f64",
        }
    }

    /// A number as the device holds it.
    pub fn nearest(self, value: f64) -> f64 {
        match self {
            Precision::F32 => f64::from(value as f32),
            Precision::Df64 => double_word::rounded(value),
            Precision::F64 => value,
        }
    }

    /// Numbers from 2^n on that are whole multiples of 2^n / significands have differences that are not rounded.
    pub fn significands(self) -> f64 {
        match self {
            Precision::F32 => 16777216.0,
            Precision::Df64 => 140737488355328.0,
            Precision::F64 => 9007199254740992.0,
        }
    }
}
