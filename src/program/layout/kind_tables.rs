//! Tables of shapes and sources for the shaders: they are the first part of the buffer of tables.

use crate::model::{SceneIr, Shape, Source};

/// The numbers that a shape's functions take, with the place of its table in that of the first.
pub fn arguments(ir: &SceneIr, shape: &Shape) -> Vec<f64> {
    let mut arguments = shape.arguments();
    if let (Some(table), Some(first)) = (shape.table(), arguments.first_mut()) {
        let before = distinct(ir).into_iter().take_while(|other| *other != table);
        *first = before.map(<[f64]>::len).sum::<usize>() as f64;
    }
    arguments
}

/// The numbers that a source's function takes, with the place of its table.
pub fn source_arguments(ir: &SceneIr, source: &Source) -> Vec<f64> {
    let mut arguments = source.kind.arguments();
    let table = source.kind.table(&ir.wavelengths);
    if let (false, Some(last)) = (table.is_empty(), arguments.last_mut()) {
        let before = ir.sources.iter().map(|other| other.kind.table(&ir.wavelengths));
        let before = before.take_while(|other| *other != table).map(|other| other.len()).sum::<usize>();
        *last = (num_of_shapes(ir) + before) as f64;
    }
    arguments
}

/// All tables, one after the other.
pub fn tables(ir: &SceneIr) -> impl Iterator<Item = f64> {
    let of_sources = ir.sources.iter().flat_map(|source| source.kind.table(&ir.wavelengths));
    distinct(ir).into_iter().flatten().copied().chain(of_sources)
}

/// How many numbers they are.
pub fn num_numbers(ir: &SceneIr) -> usize {
    let of_sources = ir.sources.iter().map(|source| source.kind.table(&ir.wavelengths).len());
    num_of_shapes(ir) + of_sources.sum::<usize>()
}

fn num_of_shapes(ir: &SceneIr) -> usize {
    distinct(ir).into_iter().map(<[f64]>::len).sum()
}

/// Shapes of equal tables share them.
fn distinct(ir: &SceneIr) -> Vec<&[f64]> {
    let mut distinct: Vec<&[f64]> = Vec::new();
    for table in ir.surfaces.iter().filter_map(|surface| surface.shape.table()) {
        if !distinct.contains(&table) {
            distinct.push(table);
        }
    }
    distinct
}
