//! The files of shaders/, which the program holds.

/// A file of shaders/, which the program holds.
#[derive(Debug, Clone, Copy)]
pub struct ShaderFile {
    /// Its path below shaders/.
    pub path: &'static str,
    /// What it says.
    pub text: &'static str,
}

/// The file of shaders/ at a path.
macro_rules! shader {
    ($($path:tt)+) => {
        $crate::shaders::ShaderFile {
            path: concat!($($path)+),
            text: include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/", $($path)+)),
        }
    };
}
pub(crate) use shader;
