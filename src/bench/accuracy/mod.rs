//! Measures error against time: which tier, how many rays, which sampling, and which program.
//!
//! ```text
//! scenes      what is traced, and the detector that is looked at
//! methods     the ways to trace it: one setting each away from the plain one
//! estimate    what a trace says of a detector, and its distance from the answer
//! curves      error and time of a method as its rays grow, against the converged answer
//! numerical   the error of arithmetic alone: the same draws along the same paths in two tiers
//! variances   between independent traces, and the ratio of two of them with confidence
//! claims      what Sobol points are worth in random numbers, with confidence
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
