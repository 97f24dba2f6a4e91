//! Reals as the device has them: literals of WGSL, bytes of buffers, and where a struct's fields lie.

use crate::error::{Error, Result};
use crate::model::Precision;
use crate::program::rewrite::df64;
use std::collections::HashMap;

/// A WGSL literal of a real. Refused where the precision cannot hold it.
pub fn literal(value: f64, precision: Precision) -> Result<String> {
    let rounded = round_to(value, precision)?;
    // `real(...)` keeps selects of abstract literals in the tier's own type.
    Ok(format!("real({rounded:?})"))
}

fn round_to(value: f64, precision: Precision) -> Result<f64> {
    let rounded = precision.nearest(value);
    if rounded.is_finite() {
        Ok(rounded)
    } else {
        let advice = match precision {
            Precision::F64 => "some number of the scene is too large or too small to compute with",
            Precision::F32 | Precision::Df64 => "use --precision f64",
        };
        Err(Error::Usage(format!("{value:e} does not fit {}; {advice}", precision.name())))
    }
}

/// Writes a real in the tier's precision.
pub fn put_real(place: &mut [u8], value: f64, precision: Precision) -> Result<()> {
    let rounded = round_to(value, precision)?;
    match precision {
        Precision::F32 => place[..4].copy_from_slice(&(rounded as f32).to_le_bytes()),
        Precision::Df64 => place[..8].copy_from_slice(bytemuck::bytes_of(&df64::split(value))),
        Precision::F64 => place[..8].copy_from_slice(&rounded.to_le_bytes()),
    }
    Ok(())
}

/// Where a struct's fields lie in memory, as naga lays them out.
pub struct StructLayout {
    /// Distance from one element of an array to the next \[bytes\].
    pub stride: usize,
    offsets: HashMap<String, usize>,
    name: String,
}

impl StructLayout {
    /// The layout of a struct of a composed module.
    pub fn of(module: &naga::Module, name: &str) -> Result<Self> {
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(module.to_ctx()).map_err(|e| Error::Internal(format!("layout of {name}: {e}")))?;
        let (handle, kind) = module
            .types
            .iter()
            .find(|(_, kind)| kind.name.as_deref() == Some(name))
            .ok_or_else(|| Error::Internal(format!("the composed module has no struct {name}")))?;
        let naga::TypeInner::Struct { members, .. } = &kind.inner else {
            return Err(Error::Internal(format!("{name} is not a struct")));
        };
        let offsets =
            members.iter().map(|m| (m.name.clone().unwrap_or_default(), m.offset as usize)).collect();
        Ok(StructLayout { stride: layouter[handle].to_stride() as usize, offsets, name: name.into() })
    }

    /// Offset of a field \[bytes\].
    pub fn offset(&self, field: &str) -> Result<usize> {
        self.offsets.get(field).copied().ok_or_else(|| {
            Error::Internal(format!("struct {} of the composed module has no field {field}", self.name))
        })
    }
}
