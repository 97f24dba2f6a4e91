//! Derivatives of a program, in forward mode: beside every real goes its tangent, the derivative by a parameter.
//!
//! The physics is composed as for a plain trace, parsed, and rewritten in naga's representation, as
//! [`crate::program::rewrite::df64`] does. Loops, draws and decisions stay as they are in the plain program, made of
//! the same expressions. A function gets a twin that takes and gives tangents. A variable gets a twin for each
//! parameter, and so does a buffer that holds numbers of the scene.
//!
//! [`crate::program::rewrite::linear`] has the rules of operations. Some functions have a rule of their own
//! ([`crate::program::rewrite::rules`]). The search for the next hit is not differentiated. `attached`
//! and `detached` say what a derivative is to see, and `note` sends a tangent to its sum.
//!
//! Source: Griewank and Walther, Evaluating Derivatives (2008), section 3.1, forward propagation of tangents.

pub(in crate::program) mod function;
mod parameters;
mod reals;
pub(in crate::program) mod rewriting;

pub use crate::program::rewrite::jvp::parameters::{Parameter, Tangents};
pub use crate::program::rewrite::jvp::reals::{place_reals, take_reals};

use crate::error::Result;
use crate::program::rewrite::jvp::function::{called_as_before, rewrite_function};
pub use crate::program::rewrite::jvp::rewriting::BINDING_STRIDE;
use crate::program::rewrite::jvp::rewriting::{NewFunction, Rewriting};
use crate::program::rewrite::rules::rule;
use crate::program::rewrite::{validated, with_wgsl};
use naga::valid::Capabilities;
use naga::{Expression, Literal, Module, Scalar, Span};

/// The constant of a composed text that says how many tangents go beside each real.
pub const NUM_TANGENTS: &str = "NUM_TANGENTS";

/// How many tangents a composed module asks for.
pub fn num_tangents(module: &Module) -> usize {
    let constant =
        module.constants.iter().find(|(_, constant)| constant.name.as_deref() == Some(NUM_TANGENTS));
    let init = constant.map(|(_, constant)| &module.global_expressions[constant.init]);
    match init {
        Some(Expression::Literal(Literal::U32(num))) => *num as usize,
        _ => 0,
    }
}

/// The module with `num` tangents beside every real, and its WGSL.
///
/// # Errors
/// [`crate::error::Error::Internal`] if the shader does something with a real that has no rule.
pub fn rewrite(module: &Module, real: Scalar, num: usize) -> Result<(Module, String)> {
    const NAME: &str = "the shader of derivatives";
    let info = validated(module, Capabilities::all(), NAME)?;
    let mut rewriting = Rewriting::new(module, &info, real, num);
    rewriting.globals();
    rewriting.functions()?;
    rewriting.entry_points()?;
    with_wgsl(rewriting.new, Capabilities::all(), NAME)
}

impl Rewriting<'_> {
    fn functions(&mut self) -> Result<()> {
        // All functions as they were come first, because rules call some of them.
        for (handle, function) in self.old.functions.iter() {
            let plain = called_as_before(self, function);
            let plain = self.new.functions.append(plain, Span::UNDEFINED);
            self.functions.insert(handle, NewFunction { plain, with_tangents: None });
        }
        for (handle, function) in self.old.functions.iter() {
            let name = function.name.as_deref().unwrap_or_default();
            if rule(name).is_some() || name.starts_with("df64_") || !self.has_tangents(function) {
                continue;
            }
            let info = self.info;
            let mut with_tangents = rewrite_function(self, function, &info[handle])?;
            with_tangents.name = Some(format!("{name}_with_tangents"));
            let with_tangents = Some(self.new.functions.append(with_tangents, Span::UNDEFINED));
            let plain = self.functions[&handle].plain;
            self.functions.insert(handle, NewFunction { plain, with_tangents });
        }
        Ok(())
    }

    fn entry_points(&mut self) -> Result<()> {
        let info = self.info;
        for (i, entry) in self.old.entry_points.iter().enumerate() {
            let function = rewrite_function(self, &entry.function, info.get_entry_point(i))?;
            self.new.entry_points.push(naga::EntryPoint { function, ..entry.clone() });
        }
        Ok(())
    }
}
