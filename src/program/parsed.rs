//! A composed module as the device gets it.

use crate::error::{Error, Result};
use crate::model::Precision;
use crate::program::rewrite::{df64, jvp, transpose};
use naga::Scalar;

/// A composed module, parsed, and in df64 rewritten.
#[derive(Debug)]
pub struct Parsed {
    /// The WGSL as it is composed.
    pub wgsl: String,
    /// The WGSL with tangents beside reals, or that walks rays back, where that is asked for; in df64 with pairs in place of f64.
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
        let real = if precision == Precision::F32 { Scalar::F32 } else { Scalar::F64 };
        let (module, with_derivatives) = match jvp::num_tangents(&module) {
            0 if transpose::has_adjoints(&module) => {
                transpose::rewrite(&module, real).map(|(module, wgsl)| (module, Some(wgsl)))?
            }
            0 => (module, None),
            num => jvp::rewrite(&module, real, num).map(|(module, wgsl)| (module, Some(wgsl)))?,
        };
        let (module, rewritten) = match precision {
            Precision::Df64 => df64::rewrite(&module).map(|(module, wgsl)| (module, Some(wgsl)))?,
            Precision::F32 | Precision::F64 => (module, with_derivatives),
        };
        Ok(Parsed { wgsl, rewritten, module })
    }

    /// A composed module as it is, in f64 and without tangents: where its numbers lie.
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
