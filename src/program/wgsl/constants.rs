//! The constants of a scene's module: sizes, numbers of cells, and properties that shaders then need not ask for.

use crate::error::Result;
use crate::model::Precision;
use crate::program::addition::ShaderAdditions;
use crate::program::geometry::{mesh, tree};
use crate::program::layout::reals::literal;
use crate::program::layout::splitting::Splitting;
use crate::program::layout::tables::LEDGER_CELLS;
use crate::program::options::{PathSampling, TEXELS_PER_LINE};
use crate::program::wgsl::composition::Composition;
use std::fmt::{Display, Write};

/// Most detectors that have their own sum of forgotten visits (shaders/sums/visits.on.wgsl). An invocation keeps these
/// sums in its own memory.
const MAX_FORGOTTEN_PLACES: usize = 32;

/// Declarations of constants.
#[derive(Default)]
pub(crate) struct Constants(String);

impl Constants {
    /// An unsigned integer.
    pub(crate) fn uint(&mut self, name: &str, value: u32) {
        self.declare(name, "u32", format_args!("{value}u"));
    }

    /// A real, which every precision holds.
    pub(crate) fn real(&mut self, name: &str, value: f64) {
        self.declare(name, "real", format_args!("{value:?}"));
    }

    /// A boolean.
    pub(crate) fn bool(&mut self, name: &str, value: bool) {
        self.declare(name, "bool", value);
    }

    fn declare(&mut self, name: &str, kind: &str, value: impl Display) {
        let _ = writeln!(self.0, "const {name}: {kind} = {value};");
    }

    /// The text.
    pub(crate) fn text(&self) -> &str {
        &self.0
    }
}

impl Composition<'_> {
    /// All constants.
    pub(super) fn constants(&self, additions: &ShaderAdditions) -> Result<String> {
        let mut constants = Constants::default();
        self.sizes(&mut constants);
        self.places_of_trees(&mut constants);
        self.numbers_of_cells(&mut constants);
        self.sizes_of_families(&mut constants);
        self.questions(&mut constants, additions);
        self.tolerances(&mut constants)?;
        Ok(constants.0)
    }

    /// How many things of each kind there are, and how work is divided among invocations.
    fn sizes(&self, constants: &mut Constants) {
        let options = &self.options;
        constants.uint("IMPOSSIBLE_COUNT", u32::MAX - options.vector_lanes);
        constants.uint("WORKGROUP_SIZE", options.workgroup_size);
        constants.uint("RAYS_PER_INVOCATION", options.rays_per_invocation(&self.features));
        constants.uint("EVENTS_PER_DISPATCH", options.events_per_dispatch);
        constants.uint("MAX_DEPTH", options.max_depth);
        constants.uint("NUM_SURFACES", self.ir.surfaces.len() as u32);
        constants.uint("NUM_PRIMITIVES", self.num_primitives() as u32);
        constants.uint("NUM_WAVELENGTHS", self.ir.wavelengths.len() as u32);
        let threshold = match options.paths {
            PathSampling::Hashed { threshold } => threshold,
            PathSampling::None | PathSampling::All => 0,
        };
        constants.uint("PATH_THRESHOLD", threshold);
    }

    /// The positions of nodes, triangles and primitives among the rows of trees.
    fn places_of_trees(&self, constants: &mut Constants) {
        if self.has_trees() {
            constants.uint("TREE_DEPTH", self.forest.depth);
            constants.uint("TREE_ROWS", self.num_tree_rows() as u32);
        }
        if self.has_texels() {
            constants.uint("TEXELS_PER_LINE", TEXELS_PER_LINE);
        }
        let first_triangle = self.forest.num_rows();
        if self.has_triangles_among_trees() {
            constants.uint("FIRST_TRIANGLE", first_triangle as u32);
        }
        if let Some(tree) = &self.tree {
            let first = first_triangle + self.num_triangle_rows();
            constants.uint("TREE_ROOT", tree.root);
            constants.uint("FIRST_PRIMITIVE", first as u32);
            constants.uint("PRIMITIVE_ROWS", tree.rows_each(self.precision()) as u32);
            constants.uint("BOXED_PRIMITIVES", tree.num_boxed() as u32);
            constants.uint("TREE_PRIMITIVES", tree.primitives().len() as u32);
            constants.declare("TREE_SLACK", "f32", format_args!("{:?}", tree::SLACK));
        }
    }

    /// The numbers of the cells.
    fn numbers_of_cells(&self, constants: &mut Constants) {
        for (cell, name) in LEDGER_CELLS {
            constants.uint(name, cell as u32);
        }
        constants.uint("CELL_SURFACES", self.cells.surfaces);
        constants.uint("COUNTER_REACHED", self.cells.reached);
        if let Some(first) = self.wrong_sides() {
            constants.uint("COUNTER_ENTERED_TWICE", first);
            constants.uint("COUNTER_ENDED_INSIDE", first + self.ir.surfaces.len() as u32);
        }
        if let Some(moments) = &self.cells.moments {
            constants.uint("SQUARES_OFFSET", moments.squares_offset);
            constants.uint("CELL_LARGE_SQUARES", moments.large_squares);
            constants.uint("CELL_TOTALS", moments.totals.unwrap_or_default());
            constants.uint("NUM_SOURCES", self.ir.sources.len() as u32);
            constants.uint("FORGOTTEN_PLACES", self.ir.detectors.len().clamp(1, MAX_FORGOTTEN_PLACES) as u32);
        }
        if let Some(replicates) = &self.cells.replicates {
            constants.uint("REPLICATE_BITS", replicates.num.ilog2());
            constants.uint("REPLICATE_STRIDE", replicates.stride);
        }
    }

    /// How far rays are split.
    fn sizes_of_families(&self, constants: &mut Constants) {
        if let Some(saturated) = self.cells.saturated {
            let splitting = Splitting::of(&self.ir.sampling);
            constants.uint("COUNTER_SATURATED", saturated);
            constants.uint("SPLIT_DEPTH", splitting.depth);
            constants.uint("FAMILY_BUDGET", splitting.budget);
            constants.uint("FAMILY_BUDGET_FRACTION", splitting.budget_fraction);
            constants.uint("WAITING_RAYS", splitting.waiting_rays());
            constants.uint("INDEX_BITS", splitting.index_bits());
        }
    }

    /// Properties that some scenes have and others lack.
    fn questions(&self, constants: &mut Constants, additions: &ShaderAdditions) {
        let (features, options) = (&self.features, &self.options);
        let [hard, bilinear, gaussian] = features.splats;
        let has_totals = self.cells.moments.as_ref().is_some_and(|moments| moments.totals.is_some());
        constants.bool("HAS_REFRACTIVE", features.refractive);
        constants.bool("HAS_REFLECTIVE", features.reflective);
        constants.bool("HAS_HARD", hard);
        constants.bool("HAS_BILINEAR", bilinear);
        constants.bool("HAS_GAUSSIAN", gaussian);
        constants.bool("HAS_TRANSMISSIVE", features.transmissive);
        constants.bool("HAS_TRANSMISSIVE_LOBES", features.transmissive_lobes);
        constants.bool("HAS_QUEUE", options.has_queue());
        constants.bool("LOGS_PASSES", additions.any(|addition| addition.logs_passes()));
        constants.bool("HAS_TOTALS", has_totals);
        constants.bool("UNIT_GRADIENTS", features.unit_gradients);
        constants.bool("RECORD_ALL_PATHS", options.paths == PathSampling::All);
        constants.bool("HAS_TREE", self.tree.is_some());
        if features.has_meshes() {
            constants.bool("FACETS_TOUCH", self.searches_facets());
        }
        if features.splits {
            constants.bool("CUTS_WEIGHTS", self.cuts_weights());
        }
    }

    /// Lengths and weights on which decisions depend.
    fn tolerances(&self, constants: &mut Constants) -> Result<()> {
        let precision = self.precision();
        for (name, value) in self.lengths() {
            match self.numbers.are_live() {
                true => {
                    let _ = writeln!(constants.0, "var<private> {name}: real;");
                }
                false => constants.declare(name, "real", self.real(value)?),
            }
        }
        if self.features.splits {
            constants.declare("SIGNIFICANDS", "real", literal(precision.significands(), precision)?);
        }
        let threshold = literal(self.options.roulette_threshold, precision)?;
        constants.declare("ROULETTE_THRESHOLD", "real", threshold);
        Ok(())
    }

    /// Lengths on which decisions depend, by their names. Where numbers are live, an invocation begins by reading them.
    pub(super) fn lengths(&self) -> Vec<(&'static str, f64)> {
        let mut lengths = Vec::new();
        if self.contacts.any() {
            lengths.push(("CONTACT_TOLERANCE", self.contacts.tolerance));
            lengths.push(("BIRTH_TOLERANCE", self.contacts.birth_tolerance));
        }
        if self.features.has_meshes() && self.precision() == Precision::F32 {
            lengths.push(("EDGE_SLACK", mesh::edge_slack(self.ir, self.centre)));
        }
        lengths
    }

    /// The first counter of rays on wrong sides, where they are counted.
    pub fn wrong_sides(&self) -> Option<u32> {
        self.cells.wrong_sides.filter(|_| self.options.counts_wrong_sides)
    }

    /// True if weights must be cut before a split. A split weight must be whole steps, and a pair of f32 can hold more.
    pub(super) fn cuts_weights(&self) -> bool {
        self.features.splits && self.precision() == Precision::Df64
    }
}
