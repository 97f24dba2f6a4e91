//! What the shaders need of surfaces, detectors, primitives and media, as records. Origins are relative to the scene's centre.

use crate::error::{Error, Result};
use crate::model::detectors::grid::GridRow;
use crate::model::primitives::primitives;
use crate::model::shapes::Quadric;
use crate::model::surface_optics::{coating_pass, has_boundaries, reflectance, splits};
use crate::model::{Detector, Frame, Interaction, Medium, SceneIr, Splat};
use crate::program::features::Features;
use crate::program::geometry::contact::{self, Contacts};
use crate::program::layout::bindings;
use crate::program::layout::bsdf;
use crate::program::layout::coating;
use crate::program::layout::kind_tables::KindTables;
use crate::program::layout::row_table::RowTable;
use glam::{DMat3, DVec3};

/// Columns for the numbers of shapes in every table of them.
const SHAPE_ARGUMENTS: usize = 4;

/// The sums that a trace keeps, as indices of cells.
#[derive(Debug, Clone)]
pub struct Cells {
    /// First cell of the surfaces; before it lie the ledger's bins.
    pub surfaces: u32,
    /// The cell of light that a filter keeps from maps; behind the surfaces'.
    pub filtered: Option<u32>,
    /// First cell of each detector.
    pub detectors: Vec<u32>,
    /// Number of cells.
    pub num_cells: u32,
    /// First of the counters of whether a primitive was reached, where [`ReachedMarks`] are made.
    pub reached: u32,
    /// The counter of whether splitting wanted more rays than the budget. The counter lies behind the primitives'.
    pub saturated: Option<u32>,
    /// First of the counters of rays on the wrong side, where media border on each other
    /// (shaders/optics/wrong_sides.counted.wgsl). Each surface has one for rays that enter a medium twice. Then each
    /// primitive has one for rays that end inside.
    pub wrong_sides: Option<u32>,
    /// Number of counters: one a cell, one a primitive, one of splitting, and the counters of wrong sides.
    pub num_counters: u32,
    /// Where the second moments lie, if they are summed on the device.
    pub moments: Option<MomentCells>,
    /// Copies of the detectors' cells, one behind the other, if each scramble of the points has its own.
    pub replicates: Option<ReplicateCells>,
    /// Number of sums: the cells of weights, and the cells of second moments.
    pub num_sums: u32,
}

/// Detectors' cells that lie there once for each scramble (shaders/sums/replicates.on.wgsl).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReplicateCells {
    /// From a cell of a detector to its cell in the next copy.
    pub stride: u32,
    /// Number of copies.
    pub num: u32,
    /// The copies but the first hold tangents, two for each parameter: those above zero, and those below.
    pub are_tangents: bool,
}

/// Cells of second moments (shaders/sums/moments.on.wgsl), behind all others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MomentCells {
    /// From a cell of a detector to the cell of its squares.
    pub squares_offset: u32,
    /// First of the cells of sum and square per detector and source. `None` where the cells of a single source's rays
    /// add up to these.
    pub totals: Option<u32>,
    /// The sum of large squares.
    pub large_squares: u32,
}

/// A bin of the ledger, in the order of cells. Fates stand in the order of shaders/stages/state.wgsl.
///
/// `Readback::finish` (engine/readback.rs) reads each: a bin that is added here does not compile until it is read there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum LedgerCell {
    /// Deposits that no sum can hold.
    Invalid,
    /// Rays that left a medium that they were not in.
    Underflows,
    /// Weight gained by survivors of roulette.
    RouletteGain,
    /// Taken by absorbing media.
    Bulk,
    /// Weight lost where a branch was drawn more often than its share.
    ImportanceLoss,
    /// Weight gained where a branch was drawn less often than its share.
    ImportanceGain,
    /// Met nothing any more.
    Escaped,
    /// Reached the largest number of events.
    DepthKilled,
    /// Ended by roulette.
    RouletteKilled,
    /// Taken by coatings.
    Coating,
    /// Taken by scattering surfaces.
    Bsdf,
    /// Weight gained by scattering.
    BsdfGain,
}

/// All bins, with their names in shaders.
pub const LEDGER_CELLS: [(LedgerCell, &str); 12] = [
    (LedgerCell::Invalid, "CELL_INVALID"),
    (LedgerCell::Underflows, "CELL_UNDERFLOWS"),
    (LedgerCell::RouletteGain, "CELL_ROULETTE_GAIN"),
    (LedgerCell::Bulk, "CELL_BULK"),
    (LedgerCell::ImportanceLoss, "CELL_IMPORTANCE_LOSS"),
    (LedgerCell::ImportanceGain, "CELL_IMPORTANCE_GAIN"),
    (LedgerCell::Escaped, "CELL_ESCAPED"),
    (LedgerCell::DepthKilled, "CELL_DEPTH_KILLED"),
    (LedgerCell::RouletteKilled, "CELL_ROULETTE_KILLED"),
    (LedgerCell::Coating, "CELL_COATING"),
    (LedgerCell::Bsdf, "CELL_BSDF"),
    (LedgerCell::BsdfGain, "CELL_BSDF_GAIN"),
];

impl Cells {
    /// The cells of a scene.
    pub fn of(ir: &SceneIr) -> Self {
        let surfaces = LEDGER_CELLS.len() as u32;
        let mut next = surfaces + ir.surfaces.len() as u32;
        let detectors = ir
            .detectors
            .iter()
            .map(|detector| {
                let first = next;
                // A ray database has one cell, for its total.
                next += detector.num_cells().max(1) as u32;
                first
            })
            .collect();
        let primitives = (ir.surfaces.len() + ir.detectors.len()) as u32;
        let saturated = splits(ir).then_some(next + primitives);
        let behind = next + primitives + u32::from(saturated.is_some());
        let wrong_sides = has_boundaries(ir).then_some(behind);
        let num_counters = behind + wrong_sides.map_or(0, |_| ir.surfaces.len() as u32 + primitives);
        Cells {
            surfaces,
            filtered: None,
            detectors,
            num_cells: next,
            reached: next,
            saturated,
            wrong_sides,
            num_counters,
            moments: None,
            replicates: None,
            num_sums: next,
        }
    }
}

impl Cells {
    /// With a cell for what a filter keeps from maps, in front of the detectors' cells.
    #[must_use]
    pub fn with_filtered(self) -> Self {
        let detectors: Vec<u32> = self.detectors.iter().map(|first| first + 1).collect();
        Cells {
            filtered: Some(detectors.first().map_or(self.num_cells, |first| first - 1)),
            detectors,
            num_cells: self.num_cells + 1,
            reached: self.reached + 1,
            saturated: self.saturated.map(|counter| counter + 1),
            wrong_sides: self.wrong_sides.map(|counter| counter + 1),
            num_counters: self.num_counters + 1,
            num_sums: self.num_sums + 1,
            ..self
        }
    }

    /// With the detectors' cells `num` times.
    ///
    /// # Errors
    /// [`Error::Usage`] if there are too many to number.
    pub fn with_replicates(self, num: u32) -> Result<Self> {
        let stride = self.num_cells - self.detectors.first().copied().unwrap_or(self.num_cells);
        let more = stride.checked_mul(num - 1).filter(|more| more.checked_add(self.num_counters).is_some());
        let more = more.ok_or_else(|| {
            Error::Usage(format!(
                "{num} sums for each of {stride} cells of the detectors, as standard errors of Sobol points need, are too \
                 many; use fewer pixels, --sampler pcg or --standard-error off"
            ))
        })?;
        Ok(Cells {
            num_cells: self.num_cells + more,
            reached: self.reached + more,
            saturated: self.saturated.map(|counter| counter + more),
            wrong_sides: self.wrong_sides.map(|counter| counter + more),
            num_counters: self.num_counters + more,
            replicates: Some(ReplicateCells { stride, num, are_tangents: false }),
            num_sums: self.num_sums + more,
            ..self
        })
    }

    /// With two copies of the detectors' cells for each of `num` parameters, in which tangents are summed.
    ///
    /// # Errors
    /// [`Error::Usage`] if there are too many to number.
    pub fn with_tangents(self, num: u32) -> Result<Self> {
        let cells = self.with_replicates(1 + 2 * num)?;
        Ok(Cells {
            replicates: cells.replicates.map(|copies| ReplicateCells { are_tangents: true, ..copies }),
            ..cells
        })
    }

    /// With cells for the second moments.
    ///
    /// # Errors
    /// [`Error::Usage`] if there are too many to number.
    pub fn with_moments(self, ir: &SceneIr) -> Result<Self> {
        let squares_offset = self.num_cells - self.detectors.first().copied().unwrap_or(self.num_cells);
        let has_totals = !cells_hold_totals(ir);
        let num_totals = if has_totals { 2 * ir.detectors.len() as u64 * ir.sources.len() as u64 } else { 0 };
        let totals = u64::from(self.num_cells) + u64::from(squares_offset);
        let large_squares = totals + num_totals;
        let num_sums = u32::try_from(large_squares + 1).map_err(|_| {
            Error::Usage(format!(
                "a square for each of {squares_offset} cells of the detectors, as standard errors need, are too many sums; use \
                 fewer pixels or --standard-error off"
            ))
        })?;
        let moments = Some(MomentCells {
            squares_offset,
            totals: has_totals.then_some(totals as u32),
            large_squares: large_squares as u32,
        });
        Ok(Cells { moments, num_sums, ..self })
    }
}

/// True if a detector's squares add up to the square of what each ray left on it. This holds if all rays are of one
/// source, and each meets one cell of one detector, unsplit.
pub fn cells_hold_totals(ir: &SceneIr) -> bool {
    ir.sources.len() == 1 && !splits(ir) && ir.detectors.iter().all(takes_rays_whole)
}

/// True if a ray ends on the detector, in a single cell.
pub fn takes_rays_whole(detector: &Detector) -> bool {
    detector.absorb && detector.kind.grid().is_none_or(|grid| grid.splat == Splat::Hard)
}

/// How shaders record which surfaces were reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReachedMarks {
    /// Not at all: every surface absorbs, so the ends of rays show it.
    None,
    /// As bits of one counter: few primitives, compiled in.
    Bits,
    /// By a counter each.
    Counters,
}

impl Cells {
    /// How surfaces are marked that were reached.
    pub fn reached_marks(&self, features: &Features, baked: bool) -> ReachedMarks {
        let num_primitives = self.saturated.or(self.wrong_sides).unwrap_or(self.num_counters) - self.reached;
        match (features.refractive || features.reflective, baked && num_primitives <= u32::BITS) {
            (false, _) => ReachedMarks::None,
            (true, true) => ReachedMarks::Bits,
            (true, false) => ReachedMarks::Counters,
        }
    }
}

/// True if some frame is rotated, or may be.
pub fn any_rotated<'a>(ir: &SceneIr, mut frames: impl Iterator<Item = &'a Frame>) -> bool {
    ir.allowed.turned || frames.any(|frame| is_rotated(frame.rotation))
}

/// True unless the local axes are the global ones, exactly.
pub fn is_rotated(rotation: DMat3) -> bool {
    rotation != DMat3::IDENTITY
}

/// The surfaces' records.
pub fn surface_records(ir: &SceneIr, centre: DVec3, features: &Features, places: &KindTables) -> RowTable {
    let mut records = RowTable::new("Surface", "surface", bindings::SURFACES);
    records.uint("interaction", ir.surfaces.iter().map(|s| interaction_code(&s.interaction)));
    put_frames(&mut records, ir, ir.surfaces.iter().map(|s| &s.frame), centre);
    // For a shape that is no quadric, these columns are not read.
    let quadrics = || ir.surfaces.iter().map(|s| s.shape.quadric().unwrap_or(Quadric::PLANE));
    records.real("radial", quadrics().map(|q| q.radial));
    records.real("axial", quadrics().map(|q| q.axial));
    records.real("offset", quadrics().map(|q| q.offset));
    if features.tips {
        records.real("tip", ir.surfaces.iter().map(|s| s.shape.tip().unwrap_or(1.0)));
    }
    if features.has_meshes() {
        records.uint("mesh", ir.surfaces.iter().map(|s| u32::from(s.shape.mesh().is_some())));
    }
    if features.has_own_normals() {
        records.uint("shape", ir.surfaces.iter().map(|s| s.shape.kind().code()));
        let arguments = ir.surfaces.iter().map(|s| places.arguments(&s.shape));
        put_arguments(&mut records, "a", SHAPE_ARGUMENTS, arguments);
    }
    records.uint("front", ir.surfaces.iter().map(|s| s.front as u32));
    records.uint("back", ir.surfaces.iter().map(|s| s.back as u32));
    if features.refractive && !features.polychromatic {
        records.real("n_front", ir.surfaces.iter().map(|s| ir.media[s.front].n[0]));
        records.real("n_back", ir.surfaces.iter().map(|s| ir.media[s.back].n[0]));
    }
    if (features.reflective || features.coated) && !features.spectral_reflectance {
        records.real("reflectance", ir.surfaces.iter().map(|s| reflectance(s, 0)));
    }
    if features.tabulated_coatings {
        coating::put_columns(&mut records, ir, places);
    } else if features.coated {
        records.uint("coated", ir.surfaces.iter().map(|s| u32::from(s.coating.is_some())));
    }
    if features.coated && !features.tabulated_coatings && !features.spectral_reflectance {
        records.real("coating_pass", ir.surfaces.iter().map(|s| coating_pass(s, 0)));
    }
    bsdf::put_columns(&mut records, ir, &features.bsdfs, places);
    records
}

/// Media as the shaders read them, a row per medium and wavelength: n, and 4 pi k / lambda \[1/mm\].
pub fn medium_records(ir: &SceneIr) -> RowTable {
    const UM_PER_MM: f64 = 1e3;
    let absorption =
        |medium: &Medium, w: usize| 4.0 * std::f64::consts::PI * medium.k[w] / ir.wavelengths[w] * UM_PER_MM;
    let wavelengths = 0..ir.wavelengths.len();
    let rows = || ir.media.iter().flat_map(|medium| wavelengths.clone().map(move |w| (medium, w)));
    let mut records = RowTable::new("Medium", "medium", bindings::MEDIA);
    records.real("n", rows().map(|(medium, w)| medium.n[w]));
    records.real("absorption", rows().map(|(medium, w)| absorption(medium, w)));
    records
}

/// Codes of shaders/stages/interact.wgsl.
fn interaction_code(interaction: &Interaction) -> u32 {
    match interaction {
        Interaction::Absorbing => 0,
        Interaction::Reflective { .. } => 1,
        Interaction::Refractive => 2,
    }
}

/// Origin relative to the centre, and the rotation's columns if any frame of the table is rotated.
pub fn put_frames<'a>(
    records: &mut RowTable,
    ir: &SceneIr,
    frames: impl Iterator<Item = &'a Frame> + Clone,
    centre: DVec3,
) {
    records.real("origin_x", frames.clone().map(|f| f.origin.x - centre.x));
    records.real("origin_y", frames.clone().map(|f| f.origin.y - centre.y));
    records.real("origin_z", frames.clone().map(|f| f.origin.z - centre.z));
    if any_rotated(ir, frames.clone()) {
        for (c, column) in ["x", "y", "z"].into_iter().enumerate() {
            for (r, row) in ["x", "y", "z"].into_iter().enumerate() {
                records.real(&format!("{column}{row}"), frames.clone().map(|f| f.rotation.col(c)[r]));
            }
        }
    }
}

/// The record of every primitive in contact. `facets`: see shaders/geometry/facets.touching.wgsl.
pub fn contact_records(ir: &SceneIr, contacts: &Contacts, facets: &FacetTable) -> RowTable {
    let mut records = RowTable::new("Contact", "contact", bindings::CONTACTS);
    let primitives = &contacts.primitives;
    records.uint("group", primitives.iter().map(|c| c.group));
    records.uint("layer", primitives.iter().map(|c| 1 << c.layer));
    records.uint("level", primitives.iter().map(|c| c.level));
    records.uint("role", primitives.iter().map(|c| c.role as u32));
    records.uint("flipped", primitives.iter().map(|c| u32::from(c.flipped)));
    let surfaces = &ir.surfaces;
    let side = |i: usize, flipped: bool| match surfaces.get(i) {
        Some(surface) if surface.interaction == Interaction::Absorbing => contact::NO_MEDIUM,
        Some(surface) if flipped => surface.back as u32,
        Some(surface) => surface.front as u32,
        None => contact::NO_MEDIUM,
    };
    records.uint("below", primitives.iter().enumerate().map(|(i, c)| side(i, c.flipped)));
    records.uint("above", primitives.iter().enumerate().map(|(i, c)| side(i, !c.flipped)));
    let refracts = |i: usize| surfaces.get(i).is_some_and(|s| s.interaction == Interaction::Refractive);
    records.uint("refracts", (0..primitives.len()).map(|i| u32::from(refracts(i))));
    records.uint("born", contacts.born_on.iter().map(|&born| u32::from(born)));
    records.uint("facets", (0..primitives.len()).map(|i| facets.first_of(ir, i)));
    records
}

/// The contacts of facets, two words each, in the order of the triangles of each mesh.
#[derive(Debug, Default)]
pub struct FacetTable {
    /// The contents of the buffer.
    pub words: Vec<u32>,
    /// For each surface in the table, what brings the number of one of its triangles to its row.
    firsts: std::collections::HashMap<usize, u32>,
}

impl FacetTable {
    /// What `facets` says of a primitive that is no mesh, and of a mesh without facets in contact.
    const NO_MESH: u32 = u32::MAX;
    const NO_FACETS: u32 = u32::MAX - 1;

    /// The table of a scene's contacts.
    pub fn of(
        ir: &SceneIr,
        contacts: &Contacts,
        triangles: &crate::program::geometry::mesh::Triangles,
    ) -> Self {
        let mut table = FacetTable::default();
        for (i, surface) in ir.surfaces.iter().enumerate() {
            let (Some(mesh), Some(facets)) = (surface.shape.mesh(), contacts.facets.get(&i)) else {
                continue;
            };
            let (first, order) = triangles.of_mesh(mesh);
            // So that what brings a triangle's number to its row is not negative.
            let row = (table.words.len() / 2).max(first);
            table.words.resize(2 * row, 0);
            table.firsts.insert(i, (row - first) as u32);
            table.words.extend(order.iter().flat_map(|&face| {
                let contact = facets[face as usize];
                [contact.group, contact.layer | u32::from(contact.flipped) << 5 | contact.level << 6]
            }));
        }
        table
    }

    fn first_of(&self, ir: &SceneIr, primitive: usize) -> u32 {
        match ir.surfaces.get(primitive).and_then(|surface| surface.shape.mesh()) {
            Some(_) => self.firsts.get(&primitive).copied().unwrap_or(Self::NO_FACETS),
            None => Self::NO_MESH,
        }
    }
}

/// The sources' records; `weights` are those that their rays are born with.
pub fn source_records(ir: &SceneIr, centre: DVec3, weights: &[f64], places: &KindTables) -> RowTable {
    let mut records = RowTable::new("Source", "source", bindings::SOURCE);
    let sources = &ir.sources;
    records.uint("kind", sources.iter().map(|e| e.kind.kind() as u32));
    records.uint("medium", sources.iter().map(|e| e.medium as u32));
    let firsts = sources.iter().scan(0, |next, e| {
        let first = *next;
        *next += e.spectrum.cdf.len() as u32;
        Some(first)
    });
    records.uint("spectrum_first", firsts);
    records.uint("spectrum_count", sources.iter().map(|e| e.spectrum.cdf.len() as u32));
    records.real("weight", weights.iter().copied());
    put_frames(&mut records, ir, sources.iter().map(|e| &e.frame), centre);
    let arguments = (0..).zip(sources).map(|(number, source)| places.source_arguments(number, source));
    put_arguments(&mut records, "p", 3, arguments);
    records
}

/// The records of the first primitives, which are looked up in a table.
pub fn primitive_records(ir: &SceneIr, centre: DVec3, num: usize, places: &KindTables) -> RowTable {
    let mut primitives = primitives(ir);
    primitives.truncate(num);
    let mut records = RowTable::new("Primitive", "primitive", bindings::PRIMITIVES);
    records.uint("shape", primitives.iter().map(|(_, shape)| shape.kind().code()));
    put_frames(&mut records, ir, primitives.iter().map(|(frame, _)| frame), centre);
    let arguments = primitives.iter().map(|(_, shape)| places.arguments(shape));
    put_arguments(&mut records, "a", SHAPE_ARGUMENTS, arguments);
    records
}

/// The numbers that functions of kinds take: as many columns as the row with the most has, and at least so many.
fn put_arguments(records: &mut RowTable, name: &str, least: usize, rows: impl Iterator<Item = Vec<f64>>) {
    let rows: Vec<Vec<f64>> = rows.collect();
    let num = rows.iter().map(Vec::len).fold(least, usize::max);
    for i in 0..num {
        records.real(&format!("{name}{i}"), rows.iter().map(|row| row.get(i).copied().unwrap_or(0.0)));
    }
}

/// The records of a tree's primitives, a permutation of the first ones, each with its number.
pub fn numbered_primitive_records(
    ir: &SceneIr,
    centre: DVec3,
    primitives: &[u32],
    places: &KindTables,
) -> RowTable {
    let mut records = primitive_records(ir, centre, primitives.len(), places).picked(primitives);
    records.uint("number", primitives.iter().copied());
    records
}

/// The detectors' records.
pub fn detector_records(ir: &SceneIr, centre: DVec3, cells: &Cells) -> RowTable {
    let mut records = RowTable::new("Detector", "detector", bindings::DETECTORS);
    let detectors = &ir.detectors;
    records.uint("kind", detectors.iter().map(|s| s.kind.function().code()));
    records.uint("absorb", detectors.iter().map(|s| u32::from(s.absorb)));
    records.uint("cell", cells.detectors.iter().copied());
    put_frames(&mut records, ir, detectors.iter().map(|s| &s.frame), centre);
    let grids: Vec<GridRow> = detectors.iter().map(|s| s.kind.grid_row()).collect();
    records.real("half_width", grids.iter().map(|g| g.half_width));
    records.real("half_height", grids.iter().map(|g| g.half_height));
    records.real("pitch_x", grids.iter().map(|g| g.pitch_x));
    records.real("pitch_y", grids.iter().map(|g| g.pitch_y));
    records.uint("num_x", grids.iter().map(|g| g.num_x));
    records.uint("num_y", grids.iter().map(|g| g.num_y));
    records.uint("splat", detectors.iter().map(|s| s.kind.grid().map_or(0, |g| splat_code(g.splat))));
    records.uint("splat_radius", detectors.iter().map(|s| s.kind.grid().map_or(0, |g| g.splat.radius())));
    records.real(
        "splat_falloff",
        detectors.iter().map(|s| s.kind.grid().map_or(0.0, |g| splat_falloff(g.splat))),
    );
    let bins: Vec<u32> = detectors.iter().map(|s| s.kind.num_bins()).collect();
    let num_wavelengths = ir.wavelengths.len() as u32;
    records.uint("bins", (0..).zip(detectors).map(|(i, _)| i * num_wavelengths));
    records.uint("num_bins", bins);
    records
}

/// Codes of shaders/stages/splat.wgsl.
fn splat_code(splat: Splat) -> u32 {
    match splat {
        Splat::Hard => 0,
        Splat::Bilinear => 1,
        Splat::Gaussian { .. } => 2,
    }
}

fn splat_falloff(splat: Splat) -> f64 {
    match splat {
        Splat::Gaussian { sigma } => 0.5 / (sigma * sigma),
        Splat::Hard | Splat::Bilinear => 0.0,
    }
}
