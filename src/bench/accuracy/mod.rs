//! Measures error against time: which tier, how many rays, which sampling, and which program.
//!
//! ```text
//! scenes      the scenes to trace, each with one detector
//! methods     the ways to trace a scene: each differs from the plain one in one setting
//! estimate    the estimate that a trace makes of a detector, and its distance from the answer
//! curves      error and time of a method as its rays grow, against the converged answer
//! numerical   the error of arithmetic alone: the same draws along the same paths in two tiers
//! variances   variances between independent traces, and the ratio of two of them with confidence
//! claims      how many random numbers a Sobol point is worth, with confidence
//! report      table, CSV and charts
//! ```

pub mod claims;
pub mod curves;
pub mod estimate;
pub mod methods;
pub mod numerical;
pub mod report;
pub mod scenes;
pub mod variances;

pub use crate::bench::accuracy::claims::{CLAIMS, Claim, Verdict};
pub use crate::bench::accuracy::curves::{Curve, Point, SceneCurves};
pub use crate::bench::accuracy::estimate::{Errors, Estimate};
pub use crate::bench::accuracy::numerical::Numerical;
pub use crate::bench::accuracy::report::AccuracyReport;
pub use crate::bench::accuracy::scenes::{AccuracyScene, SCENES};
