//! The reals in a packed buffer, by the type of the variable that reads it.

use crate::error::{Error, Result};
use crate::model::Precision;
use crate::program::layout::bindings;
use crate::program::layout::reals::put_real;
use naga::{Module, Scalar, Type, TypeInner, VectorSize};

/// Where the reals lie in a buffer of so many bytes. `None` if the module has no variable of the binding.
fn places(module: &Module, binding: u32, precision: Precision, num_bytes: usize) -> Option<Vec<usize>> {
    let is_it = |variable: &naga::GlobalVariable| {
        variable.binding.as_ref().is_some_and(|b| (b.group, b.binding) == (bindings::SCENE, binding))
    };
    let (_, variable) = module.global_variables.iter().find(|(_, variable)| is_it(variable))?;
    let mut found = Vec::new();
    add(module, &module.types[variable.ty], precision, 0, num_bytes, &mut found);
    Some(found)
}

fn add(module: &Module, ty: &Type, precision: Precision, at: usize, end: usize, found: &mut Vec<usize>) {
    let is_real = matches!(
        (&ty.inner, precision),
        (TypeInner::Scalar(Scalar::F64), Precision::F64)
            | (TypeInner::Scalar(Scalar::F32), Precision::F32)
            | (TypeInner::Vector { size: VectorSize::Bi, scalar: Scalar::F32 }, Precision::Df64)
    );
    if is_real {
        found.push(at);
        return;
    }
    match &ty.inner {
        TypeInner::Struct { members, .. } => {
            for member in members {
                add(module, &module.types[member.ty], precision, at + member.offset as usize, end, found);
            }
        }
        TypeInner::Array { base, size, stride } => {
            let num = match size {
                naga::ArraySize::Constant(num) => num.get() as usize,
                naga::ArraySize::Pending(_) | naga::ArraySize::Dynamic => (end - at) / *stride as usize,
            };
            for i in 0..num {
                add(module, &module.types[*base], precision, at + i * *stride as usize, end, found);
            }
        }
        _ => {}
    }
}

/// The reals of a buffer of an `f64` module, in their order; none if the module does not read the buffer.
pub fn take_reals(module: &Module, binding: u32, bytes: &[u8]) -> Option<Vec<f64>> {
    let places = places(module, binding, Precision::F64, bytes.len())?;
    let real = |at: usize| {
        bytes.get(at..at + 8).map_or(0.0, |bytes| f64::from_le_bytes(bytes.try_into().unwrap_or_default()))
    };
    Some(places.into_iter().map(real).collect())
}

/// A buffer of so many bytes that holds these reals where the module's variable of the binding has its own. `None` if
/// the module does not read the buffer.
///
/// # Errors
/// [`Error::Internal`] if the variable has room for another number of them.
pub fn place_reals(
    module: &Module,
    binding: u32,
    precision: Precision,
    num_bytes: usize,
    reals: &[f64],
) -> Result<Option<Vec<u8>>> {
    let Some(places) = places(module, binding, precision, num_bytes) else { return Ok(None) };
    if places.len() != reals.len() {
        let (room, given) = (places.len(), reals.len());
        return Err(Error::Internal(format!("{given} tangents for {room} numbers of binding {binding}")));
    }
    let mut bytes = vec![0; num_bytes];
    for (at, value) in places.into_iter().zip(reals) {
        put_real(&mut bytes[at..], *value, precision)?;
    }
    Ok(Some(bytes))
}
