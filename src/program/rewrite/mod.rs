//! Compilers over naga's modules: f64 as pairs of f32 ([`df64`]), derivatives beside every real ([`jvp`]), and the
//! gradient of a loss ([`transpose`]). A name for a compiler is the one that the field has for what it does.

pub mod df64;
mod function_builder;
pub mod jvp;
mod linear;
mod rules;
pub mod transpose;

use crate::error::{Error, Result};
use naga::Module;
use naga::back::wgsl::{WriterFlags, write_string};
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};

/// What naga knows of a module: the types of its values. `name` is what the module is called in errors.
fn validated(module: &Module, capabilities: Capabilities, name: &str) -> Result<ModuleInfo> {
    let info = Validator::new(ValidationFlags::all(), capabilities).validate(module);
    info.map_err(|error| Error::internal(name, &error))
}

/// A module that was rewritten, with its WGSL.
fn with_wgsl(module: Module, capabilities: Capabilities, name: &str) -> Result<(Module, String)> {
    let info = validated(&module, capabilities, name)?;
    let wgsl = write_string(&module, &info, WriterFlags::empty());
    let wgsl = wgsl.map_err(|error| Error::internal(&format!("writing {name}"), &error))?;
    Ok((module, wgsl))
}
