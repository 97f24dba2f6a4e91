//! Derivatives of a loss, in reverse mode: what the loss gains by a change of each number of the scene. One pass over
//! the rays gives all of these, however many numbers there are.
//!
//! The physics is composed as for a plain trace, parsed, and transposed in naga's representation. Each function that a
//! ray's path goes through gets two halves. [`forward`] records what the way back needs. [`back`] goes from adjoints of
//! what the function gave to adjoints of what it took. A variable with numbers of the scene has a twin for their
//! adjoints. The walk back along a ray's events is written by hand (shaders/derivatives/adjoints.wgsl).
//!
//! The rules are the same as for tangents ([`crate::program::rewrite::linear`], [`crate::program::rewrite::rules`]).
//!
//! Source: Griewank and Walther, Evaluating Derivatives (2008), section 3.2, reverse propagation of gradients.

mod accumulate;
mod activity;
mod adjoint;
mod back;
mod emit;
mod expressions;
mod forward;
mod layout;
mod loops;
mod names;
mod record;
mod side_effects;
mod sums;
mod transposer;

pub use crate::program::rewrite::transpose::layout::{Layout, NUM_OTHER_SUMS};

use crate::error::{Error, Result};
use crate::program::rewrite::function_builder::called;
use crate::program::rewrite::jvp::function::called_as_before;
use crate::program::rewrite::jvp::rewriting::NewFunction;
use crate::program::rewrite::transpose::names::{ADD_UP, BACK, WRITE};
use crate::program::rewrite::transpose::side_effects::strip_side_effects;
use crate::program::rewrite::transpose::transposer::Transposer;
use crate::program::rewrite::{validated, with_wgsl};
use naga::valid::Capabilities;
use naga::{Function, Handle, Module, Scalar, Span, Statement};
use std::collections::HashSet;

/// The entry point that walks rays back.
pub const ENTRY_POINT: &str = "trace_back";

/// True if a composed module asks for adjoints.
pub fn has_adjoints(module: &Module) -> bool {
    module.entry_points.iter().any(|entry| entry.name == ENTRY_POINT)
}

/// The module that walks rays back, and its WGSL.
///
/// # Errors
/// [`Error::NoWayBack`] if the shader does something that has no way back. [`Error::Internal`] if the module is wrong.
pub fn rewrite(module: &Module, real: Scalar) -> Result<(Module, String)> {
    const NAME: &str = "the shader of adjoints";
    let stripped = strip_side_effects(module);
    let info = validated(&stripped, Capabilities::all(), NAME)?;
    let mut transposer = Transposer::new(&stripped, &info, real);
    transposer.add_twins();
    transposer.functions()?;
    with_wgsl(transposer.rewriting.new, Capabilities::all(), NAME)
}

/// True of a function that a shader declares without a body, to be written here.
fn is_declared(name: &str, function: &Function) -> bool {
    let is_empty =
        function.body.iter().all(|statement| matches!(statement, Statement::Return { value: None }));
    is_empty && (name.ends_with(BACK) || name == ADD_UP || name == WRITE)
}

impl Transposer<'_> {
    fn functions(&mut self) -> Result<()> {
        let module = self.module;
        // What calls a function that is yet to be written comes after it.
        let mut late = HashSet::new();
        for (handle, function) in module.functions.iter() {
            let name = self.name(handle);
            if is_declared(name, function)
                || called(&function.body).iter().any(|callee| late.contains(callee))
            {
                late.insert(handle);
            } else {
                self.append_plain(handle);
            }
        }
        let layout = Layout::of(module, self.rewriting.real);
        for (handle, function) in module.functions.iter().filter(|(handle, _)| late.contains(handle)) {
            let name = self.name(handle);
            let new = match name.strip_suffix(BACK) {
                _ if !is_declared(name, function) => called_as_before(&self.rewriting, function),
                Some(of) => self.both_ways(handle, of)?,
                None if name == ADD_UP => self.add_up(function, &layout)?,
                None if name == WRITE => self.write_sums(function, &layout)?,
                None => return Err(Error::Internal(format!("no text for {name}"))),
            };
            self.append(handle, new);
        }
        for entry in module.entry_points.iter().filter(|entry| entry.name == ENTRY_POINT) {
            let function = called_as_before(&self.rewriting, &entry.function);
            self.rewriting.new.entry_points.push(naga::EntryPoint { function, ..entry.clone() });
        }
        Ok(())
    }

    /// Appends a function that takes the place of an old one.
    fn append(&mut self, old: Handle<Function>, new: Function) {
        let plain = self.rewriting.new.functions.append(new, Span::UNDEFINED);
        let new = NewFunction { plain, with_tangents: None };
        self.rewriting.functions.insert(old, new);
    }

    fn append_plain(&mut self, handle: Handle<Function>) {
        let plain = called_as_before(&self.rewriting, &self.module.functions[handle]);
        self.append(handle, plain);
    }
}
