//! The buffer of shaders/optics/tables.wgsl: tables of shapes and sources, then of BSDFs, of targets of scattering, and
//! of coatings.

use crate::error::{Error, Result};
use crate::model::{Coating, SceneIr, Shape, Source};
use std::collections::HashMap;

/// Most numbers before the last table of a shape or a source: places of tables are reals, which f32 has exactly up to there.
const MAX_PLACE: usize = 1 << 24;

/// Where each table begins. Equal tables are one: lenses by the dozen have the same polish, and the same film.
#[derive(Debug, Default)]
pub struct KindTables {
    /// By the bits of a table's numbers.
    starts: HashMap<Vec<u64>, usize>,
    numbers: Vec<f64>,
    /// Where the table of each source begins, if it has one.
    of_sources: Vec<Option<usize>>,
    /// How many numbers shapes and sources have, whose places are reals.
    num_of_reals: usize,
}

fn bits(table: &[f64]) -> Vec<u64> {
    table.iter().map(|number| number.to_bits()).collect()
}

impl KindTables {
    /// The tables of a scene.
    pub fn of(ir: &SceneIr) -> Self {
        let mut places = KindTables::default();
        for table in ir.surfaces.iter().filter_map(|surface| surface.shape.table()) {
            places.add(table);
        }
        places.of_sources =
            ir.sources.iter().map(|source| places.add(&source.kind.table(&ir.wavelengths))).collect();
        places.num_of_reals = places.numbers.len();
        let scatters = ir.surfaces.iter().filter_map(|surface| surface.scatter.as_ref());
        for scatter in scatters.filter(|scatter| scatter.bsdf.kind().has_table()) {
            places.add(&scatter.bsdf.table());
        }
        for (surface, sampling) in ir.surfaces.iter().zip(&ir.scatter_sampling) {
            places.add(&sampling.table(surface.frame.origin));
        }
        // Where a coating is a table, all are.
        let coatings = || ir.surfaces.iter().filter_map(|surface| surface.coating.as_ref());
        if coatings().any(Coating::is_tabulated) {
            for coating in coatings() {
                places.add(&coating.tabulated().numbers());
            }
        }
        places
    }

    /// Where the table begins, which may be an equal one that came before; none for an empty table.
    fn add(&mut self, table: &[f64]) -> Option<usize> {
        let next = self.numbers.len();
        let start = (!table.is_empty()).then(|| *self.starts.entry(bits(table)).or_insert(next))?;
        if start == next {
            self.numbers.extend(table);
        }
        Some(start)
    }

    /// Where a table begins.
    pub fn start_of(&self, table: &[f64]) -> Option<usize> {
        self.starts.get(&bits(table)).copied()
    }

    /// The numbers that a shape's functions take. If it has a table, the first number is the table's place.
    pub fn arguments(&self, shape: &Shape) -> Vec<f64> {
        let mut arguments = shape.arguments();
        let start = shape.table().and_then(|table| self.start_of(table));
        if let (Some(start), Some(first)) = (start, arguments.first_mut()) {
            *first = start as f64;
        }
        arguments
    }

    /// Where the table of a source begins, if it has one.
    pub fn of_source(&self, number: usize) -> Option<usize> {
        self.of_sources.get(number).copied().flatten()
    }

    /// The numbers that a source's function takes. If it has a table, the last number is the table's place.
    pub fn source_arguments(&self, number: usize, source: &Source) -> Vec<f64> {
        let mut arguments = source.kind.arguments();
        let start = self.of_source(number);
        if let (Some(start), Some(last)) = (start, arguments.last_mut()) {
            *last = start as f64;
        }
        arguments
    }

    /// All tables, one after the other.
    ///
    /// # Errors
    /// [`Error::Usage`] if the tables of shapes and sources are too long for their places to be reals.
    pub fn numbers(&self) -> Result<&[f64]> {
        match self.num_of_reals {
            num if num > MAX_PLACE => Err(Error::Usage(format!(
                "the apertures and coefficients of surfaces and the tables of sources take {num} numbers, and at most {MAX_PLACE} have places; give surfaces the same ones, or sources smaller ray files"
            ))),
            _ => Ok(&self.numbers),
        }
    }
}
