//! Tables of shapes and sources for the shaders: they are the first part of the buffer of tables.

use crate::error::{Error, Result};
use crate::model::{SceneIr, Shape, Source};
use std::collections::HashMap;

/// Most numbers before the last table of a shape or a source: places of tables are reals, which f32 has exactly up to there.
const MAX_PLACE: usize = 1 << 24;

/// Where the table of each shape and source begins. Shapes of equal tables share them.
#[derive(Debug)]
pub struct Places {
    /// By the bits of a table's numbers.
    starts: HashMap<Vec<u64>, usize>,
    numbers: Vec<f64>,
}

fn bits(table: &[f64]) -> Vec<u64> {
    table.iter().map(|number| number.to_bits()).collect()
}

impl Places {
    /// Those of a scene.
    pub fn of(ir: &SceneIr) -> Self {
        let mut places = Places { starts: HashMap::new(), numbers: Vec::new() };
        for table in ir.surfaces.iter().filter_map(|surface| surface.shape.table()) {
            places.add(table);
        }
        for source in &ir.sources {
            places.add(&source.kind.table(&ir.wavelengths));
        }
        places
    }

    fn add(&mut self, table: &[f64]) {
        if !table.is_empty() {
            let start = self.numbers.len();
            if *self.starts.entry(bits(table)).or_insert(start) == start {
                self.numbers.extend(table);
            }
        }
    }

    fn start_of(&self, table: &[f64]) -> Option<f64> {
        self.starts.get(&bits(table)).map(|start| *start as f64)
    }

    /// The numbers that a shape's functions take, with the place of its table in that of the first.
    pub fn arguments(&self, shape: &Shape) -> Vec<f64> {
        let mut arguments = shape.arguments();
        let start = shape.table().and_then(|table| self.start_of(table));
        if let (Some(start), Some(first)) = (start, arguments.first_mut()) {
            *first = start;
        }
        arguments
    }

    /// The numbers that a source's function takes, with the place of its table in that of the last.
    pub fn source_arguments(&self, source: &Source, wavelengths: &[f64]) -> Vec<f64> {
        let mut arguments = source.kind.arguments();
        let start = self.start_of(&source.kind.table(wavelengths));
        if let (Some(start), Some(last)) = (start, arguments.last_mut()) {
            *last = start;
        }
        arguments
    }

    /// How many numbers all tables have.
    pub fn num_numbers(&self) -> usize {
        self.numbers.len()
    }

    /// All tables, one after the other.
    ///
    /// # Errors
    /// [`Error::Usage`] if they are too many to have places.
    pub fn numbers(self) -> Result<Vec<f64>> {
        match self.numbers.len() {
            num if num > MAX_PLACE => Err(Error::Usage(format!(
                "apertures and coefficients of the scene's surfaces take {num} numbers; give surfaces the same ones, or at most {MAX_PLACE}"
            ))),
            _ => Ok(self.numbers),
        }
    }
}
