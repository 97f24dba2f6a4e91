//! A trace as a fold: snapshots, parts, uncertainty.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod zoo;

#[path = "progressive/fold.rs"]
mod fold;
#[path = "progressive/target.rs"]
mod target;
#[path = "progressive/uncertainty.rs"]
mod uncertainty;
