//! The text of a module in parts, each below a comment that says where it comes from.

use std::fmt::Write;

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
        $crate::program::wgsl::text::ShaderFile {
            path: concat!($($path)+),
            text: include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/", $($path)+)),
        }
    };
}
pub(crate) use shader;

/// The text of a module. The order of declarations means nothing to WGSL.
#[derive(Debug, Default)]
pub struct Text(String);

impl Text {
    /// Adds a file as it is.
    pub fn file(&mut self, file: ShaderFile) {
        let _ = writeln!(self.0, "// ==== shaders/{}\n{}", file.path, file.text);
    }

    /// Adds files as they are.
    pub fn files(&mut self, files: impl IntoIterator<Item = ShaderFile>) {
        files.into_iter().for_each(|file| self.file(file));
    }

    /// Adds what the host composes, if anything; `by` names the module that does.
    pub fn composed(&mut self, by: &str, text: &str) {
        if !text.is_empty() {
            let _ = writeln!(self.0, "// ==== composed by {by}\n{text}");
        }
    }

    /// The whole text.
    pub fn into_string(self) -> String {
        self.0
    }
}
