//! The df64 tier, for devices without f64: every real of the f64 module becomes the unevaluated sum of two f32.
//!
//! The physics is composed as for f64, parsed, and rewritten in naga's representation. An f64 becomes a `vec2<f32>`
//! (high, low), and a `vecN<f64>` a matrix of N such columns. Every operation becomes a call of
//! `shaders/math/df64.wgsl`. The result is WGSL again, without any f64.

mod function;
mod rewriting;

use crate::error::Result;
pub use crate::model::double_word::{join, rounded, split};
pub use crate::program::layout::bindings::DF64_ZERO as ZERO;
use crate::program::rewrite::df64::function::rewrite_function;
use crate::program::rewrite::df64::rewriting::{PREFIX, Rewriting};
use crate::program::rewrite::{validated, with_wgsl};
use naga::valid::Capabilities;
use naga::{Module, Span};

/// Double-word arithmetic, which reads [`ZERO`].
pub const LIBRARY: &str = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/math/df64.wgsl"));

/// The module with pairs in place of f64, and its WGSL. `source` must hold `shaders/math/df64.wgsl`.
///
/// # Errors
/// [`crate::error::Error::Internal`] if the shader uses f64 in a way that has no counterpart.
pub fn rewrite(module: &Module) -> Result<(Module, String)> {
    const NAME: &str = "the df64 shader";
    let info = validated(module, Capabilities::all(), NAME)?;
    let mut rewriting = Rewriting::new(module, &info);
    rewriting.globals()?;
    rewriting.functions()?;
    rewriting.entry_points()?;
    with_wgsl(rewriting.new, Capabilities::all().difference(Capabilities::FLOAT64), NAME)
}

impl Rewriting<'_> {
    /// The functions of the library come first, because all others call them.
    fn functions(&mut self) -> Result<()> {
        let is_library =
            |function: &naga::Function| function.name.as_ref().is_some_and(|name| name.starts_with(PREFIX));
        let (library, others): (Vec<_>, Vec<_>) =
            self.old.functions.iter().partition(|(_, function)| is_library(function));
        for (handle, function) in library.into_iter().chain(others) {
            let info = self.info;
            let new = rewrite_function(self, function, &info[handle])?;
            let name = new.name.clone();
            let new = self.new.functions.append(new, Span::UNDEFINED);
            self.functions.insert(handle, new);
            if let Some(name) = name.filter(|_| is_library(function)) {
                self.library.insert(name, new);
            }
        }
        Ok(())
    }

    fn entry_points(&mut self) -> Result<()> {
        let info = self.info;
        for (i, entry) in self.old.entry_points.iter().enumerate() {
            let mut function = rewrite_function(self, &entry.function, info.get_entry_point(i))?;
            self.copy_zero(&mut function)?;
            self.new.entry_points.push(naga::EntryPoint { function, ..entry.clone() });
        }
        Ok(())
    }
}
