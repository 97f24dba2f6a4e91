//! From the flat scene to what the GPU runs: features, specialised WGSL and packed buffers.

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
mod streams;
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
