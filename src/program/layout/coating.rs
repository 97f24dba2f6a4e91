//! Tables of coatings for the shaders: where they lie, as columns of the surfaces' records, and their numbers.

use crate::model::{SceneIr, Surface, TabulatedCoating};
use crate::program::layout::bsdf;
use crate::program::layout::kind_tables::Places;
use crate::program::layout::records::Records;

/// Adds what shaders/optics/coating.tabulated.wgsl reads of a surface.
pub fn put_columns(records: &mut Records, ir: &SceneIr) {
    let distinct = distinct(ir);
    let mut next = (Places::of(ir).num_numbers() + bsdf::tables(ir).len()) as u32;
    let starts: Vec<u32> = distinct
        .iter()
        .map(|table| {
            let start = next;
            next += table.numbers().len() as u32;
            start
        })
        .collect();
    let place = |surface: &Surface| -> Option<(u32, u32)> {
        let table = surface.coating.as_ref()?.tabulated();
        let index = distinct.iter().position(|other| *other == table)?;
        Some((starts[index], table.cosines.len() as u32))
    };
    let places: Vec<(u32, u32)> =
        ir.surfaces.iter().map(|surface| place(surface).unwrap_or_default()).collect();
    records.uint("coating_table", places.iter().map(|place| place.0));
    records.uint("coating_cosines", places.iter().map(|place| place.1));
    let absorbs = |surface: &Surface| surface.coating.as_ref().is_some_and(|coating| coating.is_tabulated());
    records.uint("absorbs_totally_reflected", ir.surfaces.iter().map(|surface| u32::from(absorbs(surface))));
}

/// All tables, one after the other; none where no coating depends on the angle.
pub fn tables(ir: &SceneIr) -> Vec<f64> {
    distinct(ir).iter().flat_map(TabulatedCoating::numbers).collect()
}

/// Surfaces of equal coatings share a table: all faces of a lens may have the same. Where a coating is a table, all are.
fn distinct(ir: &SceneIr) -> Vec<TabulatedCoating> {
    let coatings = || ir.surfaces.iter().filter_map(|surface| surface.coating.as_ref());
    let mut distinct: Vec<TabulatedCoating> = Vec::new();
    if coatings().any(|coating| coating.is_tabulated()) {
        for table in coatings().map(|coating| coating.tabulated()) {
            if !distinct.contains(&table) {
                distinct.push(table);
            }
        }
    }
    distinct
}
