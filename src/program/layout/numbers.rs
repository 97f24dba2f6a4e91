//! The numbers of a scene in its shader: compiled in as literals, or live in one table, which shaders read.
//!
//! Scenes of one shape differ in their numbers alone. With live numbers such scenes have the same text, so that one
//! compiled shader serves them all.

use crate::error::Result;
use crate::model::Precision;
use crate::program::layout::bindings;
use crate::program::layout::reals::{StructLayout, literal, put_real};
use std::cell::RefCell;
use std::fmt::Write;

/// The numbers of a scene, as its text has them.
#[derive(Debug)]
pub struct Numbers {
    precision: Precision,
    /// The table, in the order in which the text asked for its numbers; `None` if numbers are compiled in.
    table: Option<RefCell<Vec<f64>>>,
    /// Shaders read a copy, which each invocation makes first.
    are_copied: bool,
}

/// True if live numbers of a precision lie in uniform buffers, which lavapipe reads twice to three times as fast as
/// others. Numbers of 32 bits do not lie there. Where a condition depends on such uniforms alone, Mesa 22.3 compiles
/// the shader anew for each of their values, and writes over its stack.
pub fn lie_in_uniforms(precision: Precision) -> bool {
    precision == Precision::F64
}

impl Numbers {
    /// No number yet.
    pub fn new(precision: Precision, live: bool, are_copied: bool) -> Self {
        Numbers { precision, table: live.then(RefCell::default), are_copied }
    }

    /// The statement that copies the table; nothing where shaders read the table itself.
    pub fn copy(&self) -> &'static str {
        if self.are_copied { "    numbers = numbers_uniform;\n" } else { "" }
    }

    /// True if numbers are read from a table.
    pub fn are_live(&self) -> bool {
        self.table.is_some()
    }

    /// The precision of all numbers.
    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// A number as an expression of WGSL.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if the precision cannot hold it.
    pub fn expression(&self, value: f64) -> Result<String> {
        let literal = literal(value, self.precision)?;
        let Some(table) = &self.table else { return Ok(literal) };
        let mut table = table.borrow_mut();
        table.push(value);
        Ok(format!("numbers.n{}", table.len() - 1))
    }

    /// The declaration of the table. Empty without a table.
    pub fn declaration(&self) -> String {
        let count = self.table.as_ref().map_or(0, |table| table.borrow().len());
        if count == 0 {
            return String::new();
        }
        let mut text = String::from("struct Numbers {\n");
        (0..count).for_each(|i| {
            let _ = writeln!(text, "    n{i}: real,");
        });
        let (group, binding) = (bindings::SCENE, bindings::NUMBERS);
        let memory = if lie_in_uniforms(self.precision) { "uniform" } else { "storage, read" };
        let name = if self.are_copied { "numbers_uniform" } else { "numbers" };
        text += &format!("}}\n@group({group}) @binding({binding}) var<{memory}> {name}: Numbers;\n");
        if self.are_copied {
            text += "var<private> numbers: Numbers;\n";
        }
        text
    }

    /// The contents of the table, if there is one.
    ///
    /// # Errors
    /// [`crate::Error::Internal`] if the module has no such table.
    pub fn bytes(&self, module: &naga::Module) -> Result<Option<Vec<u8>>> {
        let Some(table) = self.table.as_ref().filter(|table| !table.borrow().is_empty()) else {
            return Ok(None);
        };
        let layout = StructLayout::of(module, "Numbers")?;
        let mut bytes = vec![0; layout.stride];
        for (i, value) in table.borrow().iter().enumerate() {
            put_real(&mut bytes[layout.offset(&format!("n{i}"))?..], *value, self.precision)?;
        }
        Ok(Some(bytes))
    }
}
