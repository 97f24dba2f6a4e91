//! Records that shaders read by row: surfaces, detectors, media, sources, contacts and primitives. Records are compiled
//! in, or read from tables.

use crate::error::Result;
use crate::program::addition::ShaderAdditions;
use crate::program::layout::row_table::RowTable;
use crate::program::layout::tables;
use crate::program::wgsl::composition::Composition;
use std::fmt::Write;

impl Composition<'_> {
    /// All records, each with the functions into its frame and out of it.
    pub(super) fn rows(&self, additions: &ShaderAdditions) -> Result<String> {
        Ok([
            self.surfaces_and_detectors()?,
            self.media()?,
            self.source(additions)?,
            self.contacts_of_faces()?,
            self.primitives()?,
        ]
        .concat())
    }

    fn surfaces_and_detectors(&self) -> Result<String> {
        let surfaces = tables::surface_records(self.ir, self.centre, &self.features, &self.places);
        let detectors = tables::detector_records(self.ir, self.centre, &self.cells);
        let rotated_surfaces = tables::any_rotated(self.ir, self.ir.surfaces.iter().map(|s| &s.frame));
        let rotated_detectors = tables::any_rotated(self.ir, self.ir.detectors.iter().map(|s| &s.frame));
        Ok([
            self.rows_of(&surfaces, self.options.bakes_records())?,
            self.rows_of(&detectors, self.options.bakes_records())?,
            frame_functions("Surface", "surface", rotated_surfaces),
            frame_functions("Detector", "detector", rotated_detectors),
        ]
        .concat())
    }

    fn media(&self) -> Result<String> {
        match self.features.reads_media() {
            true => self.rows_of(&tables::medium_records(self.ir), self.options.bakes_media(self.ir)),
            false => Ok(String::new()),
        }
    }

    /// A single source is compiled in. Of several sources, the source of the dispatch lies in a uniform. `begin` copies
    /// the uniforms before the first branch.
    fn source(&self, additions: &ShaderAdditions) -> Result<String> {
        let sources = tables::source_records(self.ir, self.centre, &self.options.weights, &self.places);
        let rotated = tables::any_rotated(self.ir, self.ir.sources.iter().map(|e| &e.frame));
        let (row, of_dispatch, copy) = match self.ir.sources.len() {
            1 => (sources.baked(&self.numbers)?, "source_of(0u)", ""),
            _ => (
                format!("{}var<private> source_copy: Source;\n", sources.uniform()),
                "source_copy",
                "    source_copy = source_uniform;\n",
            ),
        };
        let functions = frame_functions("Source", "source", rotated);
        let mut lengths = String::new();
        for (name, value) in self.lengths().into_iter().filter(|_| self.numbers.are_live()) {
            let _ = writeln!(lengths, "    {name} = {};", self.real(value)?);
        }
        let added: String = additions.all().map(|addition| addition.begin()).collect();
        let numbers = self.numbers.copy();
        let begin = format!("fn begin() {{\n    range = range_uniform;\n{copy}{added}{numbers}{lengths}}}\n");
        Ok(format!("{row}{functions}fn source() -> Source {{\n    return {of_dispatch};\n}}\n{begin}"))
    }

    fn contacts_of_faces(&self) -> Result<String> {
        match self.contacts.any() {
            true => self.rows_of(&self.contact_records(), self.options.baked),
            false => Ok(String::new()),
        }
    }

    pub(super) fn contact_records(&self) -> RowTable {
        tables::contact_records(self.ir, &self.contacts, &self.facets)
    }

    /// Where the scene is compiled in, the calls of the search contain the numbers of primitives.
    fn primitives(&self) -> Result<String> {
        match (self.options.baked, self.tree_records()) {
            (true, _) => Ok(String::new()),
            (false, Some(records)) => records.texels(&self.numbers),
            (false, None) => {
                let num = self.options.num_in_table(self.ir);
                self.rows_of(&tables::primitive_records(self.ir, self.centre, num, &self.places), false)
            }
        }
    }

    fn rows_of(&self, records: &RowTable, baked: bool) -> Result<String> {
        match baked {
            true => records.baked(&self.numbers),
            false => {
                records.clone().with_live(self.options.live).table(&self.numbers, self.options.uniform_bytes)
            }
        }
    }
}

/// `to_<row>` and `from_<row>`, the functions into a record's frame and out of it. Without a rotated frame in the
/// table, both functions do nothing.
pub(crate) fn frame_functions(name: &str, row: &str, rotated: bool) -> String {
    let (to, from) = if rotated {
        let rotation = "Rotation(vec3<real>(r.xx, r.xy, r.xz), vec3<real>(r.yx, r.yy, r.yz), vec3<real>(r.zx, r.zy, r.zz))";
        (format!("to_local(v, {rotation})"), format!("to_global(v, {rotation})"))
    } else {
        ("v".to_string(), "v".to_string())
    };
    format!(
        "fn to_{row}(r: {name}, v: vec3<real>) -> vec3<real> {{\n    return {to};\n}}\n\
         fn from_{row}(r: {name}, v: vec3<real>) -> vec3<real> {{\n    return {from};\n}}\n"
    )
}
