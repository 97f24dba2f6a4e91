//! Coatings by angle for the shaders: where their tables lie, as columns of the surfaces' records.

use crate::model::{Coating, SceneIr};
use crate::program::layout::kind_tables::KindTables;
use crate::program::layout::row_table::RowTable;

/// Adds what shaders/optics/coating.tabulated.wgsl reads of a surface.
pub fn put_columns(records: &mut RowTable, ir: &SceneIr, places: &KindTables) {
    let coatings = || ir.surfaces.iter().map(|surface| surface.coating.as_ref());
    let tables = coatings().map(|coating| coating.map(Coating::tabulated));
    let columns: Vec<(u32, u32)> = tables
        .map(|table| {
            table.map_or((0, 0), |table| {
                let start = places.start_of(&table.numbers()).unwrap_or(0);
                (start as u32, table.cosines.len() as u32)
            })
        })
        .collect();
    records.uint("coating_table", columns.iter().map(|column| column.0));
    records.uint("coating_cosines", columns.iter().map(|column| column.1));
    let absorbs = |coating: Option<&Coating>| coating.is_some_and(Coating::is_tabulated);
    records.uint("absorbs_totally_reflected", coatings().map(|coating| u32::from(absorbs(coating))));
}
