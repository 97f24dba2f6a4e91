//! The WGSL of one scene: which files it takes, and what stands around them.

/// The text of a file of shaders/, which the program holds.
macro_rules! shader {
    ($path:literal) => {
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/", $path))
    };
}
pub(crate) use shader;

pub mod compose;
pub mod library;
