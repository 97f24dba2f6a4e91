//! The files of shaders/, which are compiled into the program.

/// A file of shaders/, as compiled into the program.
#[derive(Debug, Clone, Copy)]
pub struct ShaderFile {
    /// The file's path below shaders/.
    pub path: &'static str,
    /// The file's text.
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
