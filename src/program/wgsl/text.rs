//! The text of a module in parts, each below a comment that names its origin.

use crate::shaders::ShaderFile;
use std::fmt::Write;

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

    /// Adds text that the host composes, if there is any. `by` names the module that composes it.
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
