//! What a trace gives back: exact integer sums ([`Tally`]), and what users read ([`TraceResult`]).
//!
//! A ray's weight is dimensionless; one unit of weight is [`QUANTA_PER_WEIGHT`] quanta and stands for the mean flux of
//! a new ray, `total_flux_in / num_rays`. Watts appear only here.

pub mod tally;

pub use tally::{Booking, PathEvent, PathEventKind, RayRow, SensorTally, SurfaceTally, Tally};

/// Quanta in one unit of weight: 2^52, so that an f64 weight of order one is counted to its last bits.
pub const QUANTA_PER_WEIGHT: f64 = (1u64 << 52) as f64;
