//! Tables of shapes for the shaders: they are the first part of the buffer of tables.

use crate::model::{SceneIr, Shape};

/// The numbers that a shape's functions take, with the place of its table in that of the first.
pub fn arguments(ir: &SceneIr, shape: &Shape) -> Vec<f64> {
    let mut arguments = shape.arguments();
    if let (Some(table), Some(first)) = (shape.table(), arguments.first_mut()) {
        let before = distinct(ir).into_iter().take_while(|other| *other != table);
        *first = before.map(<[f64]>::len).sum::<usize>() as f64;
    }
    arguments
}

/// All tables, one after the other.
pub fn tables(ir: &SceneIr) -> impl Iterator<Item = f64> {
    distinct(ir).into_iter().flatten().copied()
}

/// How many numbers they are.
pub fn num_numbers(ir: &SceneIr) -> usize {
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
