//! Closed forms of optics, traced through the public interface in f64 and f32 with every run-time check of shaders on.
//!
//! Deterministic forms hold to 1e-12 in f64 (or the stated tolerance), statistical ones within 4 sigma of the
//! estimator's own variance. Lavapipe traces some 1e6 rays a second, so statistical forms use 1e6 rays or fewer.
//! Seeds are fixed: a test that passes, passes again. `cargo test --test closed_forms -- --nocapture` prints every
//! measured deviation in units of its tolerance.
//!
//! What scatters, the integrating sphere among it, stands in `tests/bsdf.rs`.

// Clippy's exemption of tests does not reach the helpers that tests share.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

mod bench;
mod bookkeeping;
mod detectors;
mod deviation;
mod imaging;
mod interfaces;
mod shapes;
mod sources;
mod splitting;
#[path = "../zoo/mod.rs"]
mod zoo;
