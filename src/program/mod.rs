//! From the flat scene to what the GPU runs: features, specialised WGSL and packed buffers.
//!
//! The way of a scene, each step in a file:
//! - input: the prepared scene, with features, cells, trees and contacts ([`input`], made by `prepare_input`);
//! - composition: the input with the numbers and sums that the text needs ([`wgsl::composition`]);
//! - text: the files of shaders/ that the scene takes, with composed functions around them ([`wgsl::compose`]);
//! - [`parsed::Parsed`]: the text as a module of naga, rewritten where df64 or derivatives need that;
//! - [`Program`]: the module with the buffers that it reads (`composed`).

pub mod addition;
mod composed;
pub mod events;
pub mod features;
pub mod geometry;
pub mod input;
pub mod layout;
pub mod options;
pub mod parsed;
mod prepare_input;
#[allow(clippy::wildcard_enum_match_arm, reason = "of what naga has, it is refused what shaders do not use")]
pub mod rewrite;
mod streamed_sources;
pub mod wgsl;

pub use crate::model::Precision;
pub use crate::model::SourceFunction;
pub use crate::program::composed::Program;
pub use crate::program::features::Features;
pub use crate::program::input::centre_of;
pub use crate::program::layout::rng::Sampler;
pub use crate::program::layout::splitting::Splitting;
pub use crate::program::layout::tables::Cells;
pub use crate::program::options::{
    MAX_BAKED_PRIMITIVES, PathSampling, ProgramOptions, RayRange, SecondMoments, TEXELS_PER_LINE,
};
