//! An addition to the plain loop: light by its path.
//!
//! A ray carries a few words that say which path it takes ([`wgsl`]). Its deposits go to a row of a table on the device
//! ([`table`]), which the host reads, empties and makes larger ([`drain`]). One ray of each row is traced again to
//! learn the sequence of its surfaces ([`replay`]). All rays are traced again for maps of the strongest paths
//! ([`maps`], [`rows`]). A filter keeps light from maps, with or without a table. docs/methods/paths.md says why.

mod ahead;
mod drain;
mod filter_state;
pub mod followed;
pub mod layout;
pub mod maps;
pub(crate) mod replay;
pub mod rows;
pub mod sums;
mod table;
pub(crate) mod totals;
mod wgsl;
pub mod what_if;
