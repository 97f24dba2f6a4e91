//! A composed module as the device gets it.

use crate::error::{Error, Result};
use crate::model::Precision;
use crate::program::df64;

/// A composed module, parsed, and in df64 rewritten.
#[derive(Debug)]
pub struct Parsed {
    /// The WGSL as it is composed.
    pub wgsl: String,
    /// In df64, the WGSL with pairs in place of f64.
    pub rewritten: Option<String>,
    /// The module that the device runs, for reflection.
    pub module: naga::Module,
}

impl Parsed {
    /// Parses a composed module.
    ///
    /// # Errors
    /// [`Error::Internal`] if the text is no WGSL.
    pub fn of(wgsl: String, precision: Precision) -> Result<Self> {
        let module = naga::front::wgsl::parse_str(&wgsl)
            .map_err(|e| Error::Internal(format!("the composed shader: {}", e.emit_to_string(&wgsl))))?;
        let (module, rewritten) = match precision {
            Precision::Df64 => df64::rewrite(&module).map(|(module, wgsl)| (module, Some(wgsl)))?,
            Precision::F32 | Precision::F64 => (module, None),
        };
        Ok(Parsed { wgsl, rewritten, module })
    }

    /// The WGSL that the device runs.
    pub fn device_wgsl(&self) -> &str {
        self.rewritten.as_deref().unwrap_or(&self.wgsl)
    }
}
