//! A composed module as the device gets it.

use crate::error::{Error, Result};
use crate::model::Precision;
use crate::program::addition::ShaderAdditions;
use crate::program::rewrite::df64;
use naga::Scalar;

/// A composed module, parsed, and in df64 rewritten.
#[derive(Debug)]
pub struct Parsed {
    /// The WGSL as it is composed.
    pub wgsl: String,
    /// The WGSL as additions rewrite it; in df64 with pairs in place of f64.
    pub rewritten: Option<String>,
    /// The module that the device runs, for reflection.
    pub module: naga::Module,
}

impl Parsed {
    /// Parses a composed module.
    ///
    /// # Errors
    /// [`Error::Internal`] if the text is no WGSL.
    pub fn of(wgsl: String, precision: Precision, additions: &ShaderAdditions) -> Result<Self> {
        let module = naga::front::wgsl::parse_str(&wgsl)
            .map_err(|e| Error::Internal(format!("the composed shader: {}", e.emit_to_string(&wgsl))))?;
        let real = if precision == Precision::F32 { Scalar::F32 } else { Scalar::F64 };
        let (module, rewritten) = match additions.rewrite(&module, real)? {
            Some((module, wgsl)) => (module, Some(wgsl)),
            None => (module, None),
        };
        let (module, rewritten) = match precision {
            Precision::Df64 => df64::rewrite(&module).map(|(module, wgsl)| (module, Some(wgsl)))?,
            Precision::F32 | Precision::F64 => (module, rewritten),
        };
        Ok(Parsed { wgsl, rewritten, module })
    }

    /// A composed module as it is, in f64 and not rewritten: where its numbers lie.
    ///
    /// # Errors
    /// [`Error::Internal`] if the text is no WGSL.
    pub fn as_composed(wgsl: String) -> Result<Self> {
        let module = naga::front::wgsl::parse_str(&wgsl)
            .map_err(|e| Error::Internal(format!("the composed shader: {}", e.emit_to_string(&wgsl))))?;
        Ok(Parsed { wgsl, rewritten: None, module })
    }

    /// The bytes of its texts: what it takes of a driver's memory is in proportion.
    pub fn num_bytes(&self) -> usize {
        self.wgsl.len() + self.rewritten.as_ref().map_or(0, String::len)
    }

    /// The WGSL that the device runs.
    pub fn device_wgsl(&self) -> &str {
        self.rewritten.as_deref().unwrap_or(&self.wgsl)
    }
}
