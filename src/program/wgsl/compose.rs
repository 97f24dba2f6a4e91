//! Composition of the WGSL for one scene: files of shaders/ as they are, and around them only constants, records and
//! calls. No formula is written here.

use crate::error::Result;
use crate::model::shapes::{Normal, Quadric};
use crate::model::{Frame, ReflectProb, SceneIr, Shape, ShapeKind};
use crate::program::features::{Features, Precision};
use crate::program::geometry::bvh::Forest;
use crate::program::geometry::contact::Contacts;
use crate::program::geometry::mesh::{self, Triangles};
use crate::program::geometry::tree::{self, PrimitiveTree};
use crate::program::layout::bsdf::BsdfKind;
use crate::program::layout::records::{Records, literal};
use crate::program::layout::splitting::Splitting;
use crate::program::layout::sums::SumBuffers;
use crate::program::layout::tables::{self, Cells, LEDGER_CELLS, ReachedMarks};
use crate::program::wgsl::library::{self, Integers, Real};
use crate::program::{PathSampling, ProgramOptions, SecondMoments, TEXELS_PER_LINE};
use crate::software::log::format::{EndLog, Form};
use crate::software::path::main_path::NominalPath;
use crate::software::path::path_log::PathLog;
use crate::software::path::side_path::SidePath;
use glam::DVec3;
use std::fmt::Write;

/// Up to so many detectors have a sum each of the visits that were forgotten (shaders/sums/visits.wgsl): an invocation keeps
/// them in its own memory.
const MAX_FORGOTTEN_PLACES: usize = 32;

/// The shader that prepares the next dispatch of a pass.
pub const ADVANCE: &str = shader!("stages/advance.wgsl");

/// What a composition is made from.
pub struct Composition<'a> {
    /// The scene.
    pub ir: &'a SceneIr,
    /// Its features.
    pub features: &'a Features,
    /// The centre of the scene \[mm\].
    pub centre: DVec3,
    /// Its cells.
    pub cells: &'a Cells,
    /// The buffers that they lie in.
    pub sums: &'a SumBuffers,
    /// The trees over its meshes and its primitives.
    pub forest: &'a Forest,
    /// The triangles of its meshes.
    pub triangles: &'a Triangles,
    /// Which of its faces are in contact.
    pub contacts: &'a Contacts,
    /// The contacts of facets.
    pub facets: &'a tables::FacetTable,
    /// The tree over its primitives, if they are searched by one.
    pub tree: Option<&'a PrimitiveTree>,
    /// Every ray has at all times the weight that all are born with.
    pub constant_weights: bool,
    /// The log of where rays end, if the host adds it up.
    pub end_log: Option<&'a EndLog>,
    /// The path that most rays take, if it has a stage of its own.
    pub nominal: Option<&'a NominalPath>,
    /// What that stage logs, where positions tell all, alone or with weights.
    pub path_log: Option<&'a PathLog>,
    /// The paths that most of the others take.
    pub side_paths: &'a [SidePath],
    /// Media take little from the rays of all these paths on each of their ways.
    pub media_absorb_weakly: bool,
    /// How to specialise.
    pub options: &'a ProgramOptions,
}

impl Composition<'_> {
    /// The whole module.
    pub fn compose(&self) -> Result<String> {
        let real = match self.precision() {
            Precision::F32 => Real::F32,
            Precision::Df64 => Real::Df64,
            Precision::F64 => Real::F64,
        };
        let integers = if self.options.native { Integers::Native } else { Integers::Portable };
        let mut text = library::source(real, integers, self.options.sampler);
        text.push_str(&self.constants()?);
        for file in self.files() {
            text.push_str(file);
            text.push('\n');
        }
        if self.features.splits {
            text.push_str(&self.drawn_branch());
        }
        if self.features.has_own_normals() {
            // The file's own is that of a quadric, to which the one for all shapes turns.
            text = text.replace("fn quadric_normal(", "fn normal_of_quadric(");
            text.push_str(&self.normal_by_kind());
        }
        text.push_str(&self.records()?);
        text.push_str(&self.nearest_primitive()?);
        if self.chooses_what_waits() {
            text.push_str(&self.waiting());
        }
        text.push_str(&self.path_stages()?);
        text.push_str(&self.record());
        text.push_str(&self.bins());
        text.push_str(&self.emit());
        text.push_str(&self.sample_bsdf());
        text.push_str(&self.reflect_probability()?);
        self.sums.cut(text)
    }

    pub(crate) fn precision(&self) -> Precision {
        self.options.precision
    }

    fn constants(&self) -> Result<String> {
        let f = self.features;
        let o = self.options;
        let mut text = String::new();
        let mut uint = |name: &str, value: u32| {
            let _ = writeln!(text, "const {name}: u32 = {value}u;");
        };
        uint("NO_COUNT", u32::MAX - o.vector_lanes);
        uint("WORKGROUP_SIZE", o.workgroup_size);
        uint("RAYS_PER_INVOCATION", o.rays_per_invocation(f));
        if self.nominal.is_some() {
            uint("PATH_RAYS_PER_INVOCATION", self.path_rays_per_invocation());
        }
        if self.stores_together() {
            uint("LANES", o.lanes);
            // Half of a vector of f32, or of one of f64, of which there are two.
            uint("LANES_TOGETHER", if o.precision == Precision::F64 { 4 } else { 2 });
        }
        uint("EVENTS_PER_DISPATCH", o.events_per_dispatch);
        uint("MAX_DEPTH", o.max_depth);
        uint("NUM_SURFACES", self.ir.surfaces.len() as u32);
        uint("NUM_PRIMITIVES", (self.ir.surfaces.len() + self.ir.sensors.len()) as u32);
        uint("NUM_WAVELENGTHS", self.ir.wavelengths.len() as u32);
        if self.has_trees() {
            uint("TREE_DEPTH", self.forest.depth);
            uint("TREE_ROWS", self.num_tree_rows() as u32);
        }
        let first_triangle = self.forest.num_rows();
        if self.has_texels() {
            uint("TEXELS_PER_LINE", TEXELS_PER_LINE);
        }
        if self.has_triangles_among_trees() {
            uint("FIRST_TRIANGLE", first_triangle as u32);
        }
        if let Some(tree) = self.tree {
            let first = first_triangle + self.num_triangle_rows();
            uint("TREE_ROOT", tree.root);
            uint("FIRST_PRIMITIVE", first as u32);
            uint("PRIMITIVE_ROWS", tree.rows_each(o.precision) as u32);
            uint("BOXED_PRIMITIVES", tree.num_boxed() as u32);
            uint("TREE_PRIMITIVES", tree.primitives().len() as u32);
        }
        for (i, name) in (0..).zip(LEDGER_CELLS) {
            uint(name, i);
        }
        uint("CELL_SURFACES", self.cells.surfaces);
        uint("COUNTER_REACHED", self.cells.reached);
        if let Some(saturated) = self.cells.saturated {
            let splitting = Splitting::of(&self.ir.sampling);
            uint("COUNTER_SATURATED", saturated);
            uint("SPLIT_DEPTH", splitting.depth);
            uint("FAMILY_BUDGET", splitting.budget);
            uint("FAMILY_BUDGET_FRACTION", splitting.budget_fraction);
            uint("WAITING_RAYS", splitting.waiting_rays());
            uint("INDEX_BITS", splitting.index_bits());
        }
        if let Some(moments) = &self.cells.moments {
            uint("SQUARES_OFFSET", moments.squares_offset);
            uint("CELL_LARGE_SQUARES", moments.large_squares);
            uint("CELL_TOTALS", moments.totals.unwrap_or_default());
            uint("NUM_EMITTERS", self.ir.emitters.len() as u32);
            uint("FORGOTTEN_PLACES", self.ir.sensors.len().clamp(1, MAX_FORGOTTEN_PLACES) as u32);
        }
        if let Some(replicates) = &self.cells.replicates {
            uint("REPLICATE_BITS", replicates.num.ilog2());
            uint("REPLICATE_STRIDE", replicates.stride);
        }
        if let PathSampling::Hashed { threshold } = o.paths {
            uint("PATH_THRESHOLD", threshold);
        } else {
            uint("PATH_THRESHOLD", 0);
        }
        for (name, value) in [
            ("HAS_REFRACTIVE", f.refractive),
            ("HAS_REFLECTIVE", f.reflective),
            ("HAS_HARD", f.splats[0]),
            ("HAS_BILINEAR", f.splats[1]),
            ("HAS_GAUSSIAN", f.splats[2]),
            ("HAS_TRANSMISSIVE", f.transmissive),
            ("HAS_TRANSMISSIVE_LOBES", f.transmissive_lobes),
            ("HAS_QUEUE", o.has_queue()),
            ("LOGS_PASSES", self.logs_passes()),
            ("HAS_TOTALS", self.cells.moments.as_ref().is_some_and(|moments| moments.totals.is_some())),
            ("UNIT_GRADIENTS", f.unit_gradients),
            ("RECORD_ALL_PATHS", o.paths == PathSampling::All),
            ("HAS_TREE", self.tree.is_some()),
        ] {
            let _ = writeln!(text, "const {name}: bool = {value};");
        }
        if let Some(log) = self.end_log {
            let _ = writeln!(text, "const LOG_WORDS: u32 = {}u;", log.num_words());
            let _ = writeln!(text, "const MEDIA_ABSORB_WEAKLY: bool = {};", self.media_absorb_weakly);
            let _ = writeln!(text, "const LOGS_POSITIONS: bool = {};", log.logs_positions());
            let _ = writeln!(text, "const LOGS_WEIGHTS: bool = {};", log.logs_weights());
        }
        if self.tree.is_some() {
            let _ = writeln!(text, "const TREE_SLACK: f32 = {:?};", tree::SLACK);
        }
        if self.contacts.any() {
            let tolerance = literal(self.contacts.tolerance, o.precision)?;
            let _ = writeln!(text, "const CONTACT_TOLERANCE: real = {tolerance};");
            let tolerance = literal(self.contacts.birth_tolerance, o.precision)?;
            let _ = writeln!(text, "const BIRTH_TOLERANCE: real = {tolerance};");
        }
        if f.has_meshes() {
            let _ = writeln!(text, "const FACETS_TOUCH: bool = {};", self.searches_facets());
            if o.precision == Precision::F32 {
                let slack = literal(mesh::edge_slack(self.ir, self.centre), o.precision)?;
                let _ = writeln!(text, "const EDGE_SLACK: real = {slack};");
            }
        }
        if f.splits {
            let significands = literal(o.precision.significands(), o.precision)?;
            let _ = writeln!(text, "const SIGNIFICANDS: real = {significands};");
            let _ = writeln!(text, "const CUTS_WEIGHTS: bool = {};", self.cuts_weights());
        }
        let threshold = literal(o.roulette_threshold, o.precision)?;
        let _ = writeln!(text, "const ROULETTE_THRESHOLD: real = {threshold};");
        Ok(text)
    }

    /// The files that the scene needs, each once.
    fn files(&self) -> Vec<&'static str> {
        let f = self.features;
        let o = self.options;
        let has_squares = o.moments == SecondMoments::Squares;
        let pick = |condition: bool, yes: &'static str, no: &'static str| if condition { yes } else { no };
        let split_triangle = pick(
            f.has_meshes(),
            shader!("geometry/split_triangle.wgsl"),
            shader!("geometry/split_triangle_none.wgsl"),
        );
        let mut files = vec![
            shader!("stages/state.wgsl"),
            pick(
                self.nominal.is_some(),
                shader!("software/path/ids_listed.wgsl"),
                shader!("stages/ids_range.wgsl"),
            ),
            pick(
                o.moments == SecondMoments::Replicates,
                shader!("sums/replicates.wgsl"),
                shader!("sums/replicates_none.wgsl"),
            ),
            shader!("geometry/transforms.wgsl"),
            shader!("geometry/quadric.wgsl"),
            shader!("sums/ledger.wgsl"),
            shader!("stages/counts.wgsl"),
            match self.cells.reached_marks(f, o.baked) {
                ReachedMarks::None => shader!("sums/reached_none.wgsl"),
                ReachedMarks::Bits => shader!("sums/reached_mask.wgsl"),
                ReachedMarks::Counters => shader!("sums/reached_table.wgsl"),
            },
            pick(
                self.constant_weights,
                shader!("sums/weights_constant.wgsl"),
                shader!("sums/weights_vary.wgsl"),
            ),
            pick(
                self.end_log.is_some(),
                shader!("software/log/ends_logged.wgsl"),
                shader!("sums/ends_booked.wgsl"),
            ),
            pick(
                self.logs_passes(),
                shader!("software/log/passes_logged.wgsl"),
                shader!("sums/passes_booked.wgsl"),
            ),
            pick(
                f.polychromatic,
                shader!("optics/spectrum_discrete.wgsl"),
                shader!("optics/spectrum_single.wgsl"),
            ),
            pick(f.bulk_absorption, shader!("optics/bulk.wgsl"), shader!("optics/bulk_none.wgsl")),
            pick(f.roulette, shader!("optics/roulette.wgsl"), shader!("optics/roulette_none.wgsl")),
            pick(o.has_many_rounds(f), shader!("software/rounds.wgsl"), shader!("stages/rounds_none.wgsl")),
            pick(
                o.rays_per_invocation(f) == 1,
                shader!("stages/rays_one.wgsl"),
                shader!("software/rays_several.wgsl"),
            ),
            pick(f.splits, shader!("stages/split.wgsl"), self.branch_file()),
            pick(f.coated, shader!("optics/coating.wgsl"), shader!("optics/coating_none.wgsl")),
            pick(f.bsdfs.is_empty(), shader!("stages/scatter_none.wgsl"), shader!("stages/scatter.wgsl")),
            pick(
                self.options.paths == PathSampling::None,
                shader!("rows/paths_none.wgsl"),
                shader!("rows/paths_recorded.wgsl"),
            ),
            pick(f.has_meshes(), shader!("shapes/mesh.wgsl"), shader!("geometry/mesh_none.wgsl")),
            pick(
                self.contacts.any(),
                shader!("geometry/contact.wgsl"),
                shader!("geometry/contact_none.wgsl"),
            ),
            shader!("shapes/plane.wgsl"),
            shader!("stages/generate.wgsl"),
            pick(f.splits, split_triangle, shader!("stages/intersect.wgsl")),
            pick(f.tips, shader!("geometry/gradients_tip.wgsl"), shader!("geometry/gradients.wgsl")),
            shader!("stages/interact.wgsl"),
            shader!("stages/splat.wgsl"),
            shader!("stages/trace.wgsl"),
        ];
        for kind in &f.shapes {
            let text = kind.wgsl().text;
            if !files.contains(&text) {
                files.push(text);
            }
        }
        files.extend(self.end_log.map(|log| log_file(log.form)));
        files.extend(f.emitters.iter().map(|e| e.wgsl().text));
        files.extend(f.bsdfs.iter().map(|kind| bsdf_file(*kind)));
        let optional = [
            (self.searches_facets(), shader!("geometry/facets.wgsl")),
            (f.has_meshes() && !self.searches_facets(), shader!("geometry/facets_apart.wgsl")),
            (
                f.has_meshes(),
                pick(
                    o.precision == Precision::F32,
                    shader!("geometry/edges_f32.wgsl"),
                    shader!("geometry/edges_exact.wgsl"),
                ),
            ),
            (self.contacts.any() && !self.searches_facets(), shader!("geometry/facets_none.wgsl")),
            (f.reads_media(), shader!("optics/media.wgsl")),
            (
                f.refractive,
                pick(f.polychromatic, shader!("optics/indices_table.wgsl"), shader!("optics/indices.wgsl")),
            ),
            (!f.refractive, shader!("optics/indices_none.wgsl")),
            (
                f.reflective || f.coated,
                pick(
                    f.spectral_reflectance,
                    shader!("optics/reflectance_table.wgsl"),
                    shader!("optics/reflectance.wgsl"),
                ),
            ),
            (!f.reflective && !f.coated, shader!("optics/reflectance_none.wgsl")),
            (
                f.coated,
                pick(
                    f.spectral_reflectance,
                    shader!("optics/coating_pass_table.wgsl"),
                    shader!("optics/coating_pass.wgsl"),
                ),
            ),
            (f.has_bsdf_table(), shader!("optics/bsdf_table.wgsl")),
            (self.has_trees(), shader!("geometry/boxes.wgsl")),
            (
                f.has_meshes(),
                pick(
                    self.has_triangles_among_trees(),
                    shader!("geometry/mesh_rows_f32.wgsl"),
                    shader!("geometry/mesh_rows_f64.wgsl"),
                ),
            ),
            (
                self.has_trees(),
                pick(
                    self.has_texels(),
                    shader!("software/tree_texels.wgsl"),
                    shader!("geometry/tree_storage.wgsl"),
                ),
            ),
            (self.has_trees() && !self.chooses_what_waits(), shader!("geometry/waiting_indexed.wgsl")),
            (self.tree.is_some(), shader!("geometry/primitives_tree.wgsl")),
            (
                self.tree.is_some(),
                pick(
                    self.tree_records().is_some(),
                    shader!("software/placed_texels.wgsl"),
                    shader!("geometry/placed_table.wgsl"),
                ),
            ),
            (!o.baked && self.tree.is_none(), shader!("geometry/primitives_table.wgsl")),
            (
                !o.baked,
                match (self.searches_facets(), self.contacts.any()) {
                    (true, _) => shader!("geometry/try_primitive_facets.wgsl"),
                    (false, true) => shader!("geometry/try_primitive_contact.wgsl"),
                    (false, false) => shader!("geometry/try_primitive.wgsl"),
                },
            ),
            (self.options.has_events(f), shader!("rows/events.wgsl")),
            (self.options.has_queue(), shader!("stages/compact.wgsl")),
            (
                self.options.has_queue(),
                match (f.has_meshes(), self.contacts.any()) {
                    (false, false) => shader!("stages/queued_ray.wgsl"),
                    (true, false) => shader!("stages/queued_ray_mesh.wgsl"),
                    (false, true) => shader!("stages/queued_ray_contact.wgsl"),
                    (true, true) => shader!("stages/queued_ray_mesh_contact.wgsl"),
                },
            ),
            (!self.options.has_queue(), shader!("stages/queue_none.wgsl")),
            (!has_squares, shader!("sums/moments_none.wgsl")),
            (has_squares, shader!("sums/moments.wgsl")),
            (
                has_squares,
                pick(
                    f.transmissive || f.splits,
                    shader!("sums/visits.wgsl"),
                    shader!("sums/visits_none.wgsl"),
                ),
            ),
            (f.irradiance, shader!("detectors/irradiance.wgsl")),
            (f.spectral, shader!("detectors/spectral.wgsl")),
            (f.far_field, shader!("detectors/far_field.wgsl")),
            (f.ray_database, shader!("detectors/ray_database.wgsl")),
            (self.nominal.is_some(), shader!("software/path/path.wgsl")),
            (
                self.nominal.is_some(),
                pick(
                    self.path_log.is_some(),
                    shader!("software/path/path_places.wgsl"),
                    shader!("software/path/path_entries.wgsl"),
                ),
            ),
            (
                self.nominal.is_some(),
                pick(
                    self.stores_together(),
                    shader!("software/path/lanes_together.wgsl"),
                    shader!("software/path/lanes_alone.wgsl"),
                ),
            ),
            (self.path_log.is_some(), self.places_file()),
            (
                self.nominal.is_some(),
                pick(
                    self.logs_weights(),
                    shader!("software/path/path_losses_told.wgsl"),
                    shader!("software/path/path_losses_booked.wgsl"),
                ),
            ),
            (self.nominal.is_some(), shader!("software/path/clearances.wgsl")),
            (
                self.nominal.is_some() && self.path_rays_per_invocation() > 1,
                shader!("software/path/path_rays_several.wgsl"),
            ),
            (self.goes_side_by_side(), shader!("software/path/nominal_pair.wgsl")),
        ];
        files.extend(optional.into_iter().filter(|(needed, _)| *needed).map(|(_, file)| file));
        files
    }

    /// Lanes of a subgroup store their places together.
    fn stores_together(&self) -> bool {
        self.path_log.is_some() && self.options.lanes > 1
    }

    /// Rays of the nominal path log what they weigh.
    pub(crate) fn logs_weights(&self) -> bool {
        self.path_log.is_some_and(|log| log.attenuating_legs.is_some())
    }

    fn places_file(&self) -> &'static str {
        let reals = self.precision() == Precision::F64;
        if self.logs_weights() {
            return match self.stores_together() {
                true => shader!("software/log/places_weighed_together.wgsl"),
                false => shader!("software/log/places_weighed.wgsl"),
            };
        }
        match (self.stores_together(), reals, self.options.native) {
            (true, true, _) => shader!("software/log/places_reals_together.wgsl"),
            (true, false, _) => shader!("software/log/places_words_together.wgsl"),
            (false, true, _) => shader!("software/log/places_reals.wgsl"),
            (false, false, true) => shader!("software/log/places_packed.wgsl"),
            (false, false, false) => shader!("software/log/places_words.wgsl"),
        }
    }

    fn has_trees(&self) -> bool {
        self.num_tree_rows() > 0
    }

    /// Trees lie in an image.
    fn has_texels(&self) -> bool {
        self.options.are_texels(self.num_tree_rows())
    }

    /// Processors choose what waits among all levels sooner than each lane finds it by its index.
    fn chooses_what_waits(&self) -> bool {
        const MOST_LEVELS: u32 = 32;
        self.has_texels() && self.forest.depth <= MOST_LEVELS
    }

    /// The twin of geometry/waiting_indexed.wgsl.
    fn waiting(&self) -> String {
        let levels = 1..self.forest.depth;
        let at = levels
            .clone()
            .map(|i| format!("    group = select(group, (*walk).waiting[{i}], place == {i}u);\n"));
        let at: String = at.collect();
        let put = levels.map(|i| {
            format!("    (*walk).waiting[{i}] = select((*walk).waiting[{i}], group, place == {i}u);\n")
        });
        let put: String = put.collect();
        format!(
            "fn waiting_at(walk: ptr<function, Walk>, place: u32) -> u32 {{\n    var group = (*walk).waiting[0];\n{at}    \
             return group;\n}}\nfn wait_at(walk: ptr<function, Walk>, place: u32, group: u32) {{\n    \
             (*walk).waiting[0] = select((*walk).waiting[0], group, place == 0u);\n{put}}}\n"
        )
    }

    fn has_triangles_among_trees(&self) -> bool {
        self.features.has_meshes() && self.precision() == Precision::F32
    }

    /// Rows of triangles among those of trees.
    fn num_triangle_rows(&self) -> usize {
        if self.has_triangles_among_trees() { self.triangles.num_rows() } else { 0 }
    }

    /// Nodes, triangles, primitives.
    fn num_tree_rows(&self) -> usize {
        let of_primitives = self.tree.map_or(0, |tree| tree.num_rows(self.precision()));
        self.forest.num_rows() + self.num_triangle_rows() + of_primitives
    }

    /// What stands of primitives beside their tree.
    fn tree_records(&self) -> Option<&Records> {
        self.tree?.records.as_ref()
    }

    fn logs_passes(&self) -> bool {
        self.end_log.is_some_and(|log| log.max_passes > 0)
    }

    /// Facets of meshes are in contact, or sources lie on them.
    fn searches_facets(&self) -> bool {
        let is_mesh = |i: usize| self.ir.surfaces.get(i).is_some_and(|s| s.shape.mesh().is_some());
        let births = (0..self.ir.surfaces.len()).any(|i| is_mesh(i) && self.contacts.is_born_on(i));
        births || !self.contacts.facets.is_empty()
    }

    fn contact_records(&self) -> Records {
        tables::contact_records(self.ir, self.contacts, self.facets)
    }

    fn branch_file(&self) -> &'static str {
        if self.features.importance {
            shader!("optics/branch_importance.wgsl")
        } else {
            shader!("optics/branch_fresnel.wgsl")
        }
    }

    /// Where rays are split, a weight must be whole steps; a pair of f32 can hold more.
    fn cuts_weights(&self) -> bool {
        self.features.splits && self.precision() == Precision::Df64
    }

    /// Where rays are split, `draw_reflection` is the split's, which falls back on the draw under another name.
    fn drawn_branch(&self) -> String {
        self.branch_file().replace("fn draw_reflection(", "fn draw_branch(")
    }

    fn records(&self) -> Result<String> {
        let surfaces = tables::surface_records(self.ir, self.centre, self.features);
        let sensors = tables::sensor_records(self.ir, self.centre, self.cells);
        let rotated_surfaces = tables::any_rotated(self.ir.surfaces.iter().map(|s| &s.frame));
        let rotated_sensors = tables::any_rotated(self.ir.sensors.iter().map(|s| &s.frame));
        let mut text = String::new();
        for records in [&surfaces, &sensors] {
            text.push_str(&self.rows_of(records, self.options.baked)?);
        }
        if self.features.reads_media() {
            text.push_str(
                &self.rows_of(&tables::medium_records(self.ir), self.options.bakes_media(self.ir))?,
            );
        }
        text.push_str(&self.emitter()?);
        if self.contacts.any() {
            text.push_str(&self.rows_of(&self.contact_records(), self.options.baked)?);
        }
        text.push_str(&frame_functions("Surface", "surface", rotated_surfaces));
        text.push_str(&frame_functions("Sensor", "sensor", rotated_sensors));
        if !self.options.baked {
            text.push_str(&match self.tree_records() {
                Some(records) => records.texels(self.precision())?,
                None => {
                    let num = self.options.num_in_table(self.ir);
                    self.rows_of(&tables::primitive_records(self.ir, self.centre, num), false)?
                }
            });
        }
        Ok(text)
    }

    fn rows_of(&self, records: &Records, baked: bool) -> Result<String> {
        match baked {
            true => records.baked(self.precision()),
            false => records.table(self.precision(), self.options.uniform_bytes),
        }
    }

    /// A lone emitter is compiled in; of several, the one of the dispatch lies in a uniform. `begin` copies what lies in
    /// uniforms before the first branch.
    fn emitter(&self) -> Result<String> {
        let emitters = tables::emitter_records(self.ir, self.centre, &self.options.weights);
        let rotated = tables::any_rotated(self.ir.emitters.iter().map(|e| &e.frame));
        let (row, source, copy) = match self.ir.emitters.len() {
            1 => (emitters.baked(self.precision())?, "emitter_of(0u)", ""),
            _ => (
                format!("{}var<private> emitter_copy: Emitter;\n", emitters.uniform()),
                "emitter_copy",
                "    emitter_copy = emitter_uniform;\n",
            ),
        };
        let functions = frame_functions("Emitter", "emitter", rotated);
        let begin = format!("fn begin() {{\n    range = range_uniform;\n{copy}}}\n");
        Ok(format!("{row}{functions}fn emitter() -> Emitter {{\n    return {source};\n}}\n{begin}"))
    }

    /// Baked: one call a primitive, with its numbers. Table: a loop over the primitives' records, or a tree and what stands
    /// apart from it.
    fn nearest_primitive(&self) -> Result<String> {
        let num = self.ir.surfaces.len() + self.ir.sensors.len();
        if self.options.baked {
            return self.nearest_in_turn("nearest_primitive", 0..num);
        }
        let mut text = self.nearest_primitive_table();
        if self.tree.is_some() {
            let apart = self.options.tree_primitives(self.ir).end..num;
            text.push_str(&self.nearest_in_turn("nearest_apart", apart)?);
        }
        Ok(text)
    }

    fn nearest_in_turn(&self, name: &str, primitives: std::ops::Range<usize>) -> Result<String> {
        let candidates = primitives.map(|i| (i, format!("ray.last == {i}u")));
        self.nearest_of(&format!("{name}(ray: Ray, start: Hit)"), "start", None, candidates)
    }

    /// A function that looks for the nearest of some primitives, one after the other; each with whether the ray stands on
    /// it. Of the one that is `nearer`, a conic, it looks at the nearer crossing alone.
    pub(crate) fn nearest_of(
        &self,
        head: &str,
        start: &str,
        nearer: Option<usize>,
        candidates: impl Iterator<Item = (usize, String)>,
    ) -> Result<String> {
        let primitives = tables::primitives(self.ir);
        let mut text = format!("fn {head} -> Hit {{\n    var best = {start};\n");
        if self.contacts.any() {
            text.push_str("    let here = standing(ray);\n");
        }
        for (i, leaving) in candidates {
            let (frame, shape) = &primitives[i];
            let function = match nearer == Some(i) {
                true => "nearer_conic_distance",
                false => &shape.kind().function("distance"),
            };
            text.push_str(&self.try_primitive(i, frame, shape, function, &leaving)?);
        }
        text.push_str("    return best;\n}\n");
        Ok(text)
    }

    /// The ray's position and direction in the frame of a primitive.
    pub(crate) fn in_frame(&self, frame: &Frame) -> Result<(String, String)> {
        let v = format!("ray.position - {}", self.vector(frame.origin - self.centre)?);
        if !tables::is_rotated(frame.rotation) {
            return Ok((v, "ray.direction".into()));
        }
        let [x, y, z] = [frame.rotation.x_axis, frame.rotation.y_axis, frame.rotation.z_axis];
        let [x, y, z] = [self.vector(x)?, self.vector(y)?, self.vector(z)?];
        let rotation = format!("Rotation({x}, {y}, {z})");
        Ok((format!("to_local({v}, {rotation})"), format!("to_local(ray.direction, {rotation})")))
    }

    fn vector(&self, v: DVec3) -> Result<String> {
        let [x, y, z] = [self.real(v.x)?, self.real(v.y)?, self.real(v.z)?];
        Ok(format!("vec3<real>({x}, {y}, {z})"))
    }

    pub(crate) fn real(&self, value: f64) -> Result<String> {
        literal(value, self.precision())
    }

    /// Makes a primitive's hit the `best` one if it is nearer; `leaving` tells whether the ray stands on it.
    fn try_primitive(
        &self,
        i: usize,
        frame: &Frame,
        shape: &Shape,
        function: &str,
        leaving: &str,
    ) -> Result<String> {
        let kind = ShapeKind::of(shape);
        let farthest = if kind.is_searched() { ", best.distance" } else { "" };
        let mut arguments = String::new();
        for argument in shape.arguments() {
            let _ = write!(arguments, "{}, ", self.real(argument)?);
        }
        let (o, d) = self.in_frame(frame)?;
        if kind.is_searched() && self.searches_facets() {
            let contact = self.contact_records().row(self.precision(), i)?;
            let distance = format!("{function}({o}, {d}, {arguments}{leaving}, farthest_from(best))");
            return Ok(format!(
                "    search_facets(ray, here, {contact});\n    \
                 best = nearer_facet(best, ray, {i}u, {distance});\n"
            ));
        }
        let mut leaving = leaving.to_string();
        if self.contacts.is_born_on(i) {
            let quadric = match shape.quadric() {
                Some(Quadric { radial, axial, offset, constant }) => {
                    let [radial, axial, offset] = [self.real(radial)?, self.real(axial)?, self.real(offset)?];
                    format!("Quadric({radial}, {axial}, {offset}, {})", self.real(constant)?)
                }
                None => quadric_of(kind, &o, arguments.trim_end_matches(", ")),
            };
            leaving = format!("({leaving}) | is_born_on(ray, {o}, {quadric})");
        }
        if !self.contacts.touches(i) {
            return Ok(format!(
                "    best = nearer(best, {function}({o}, {d}, {arguments}{leaving}{farthest}), {i}u);\n"
            ));
        }
        let contact = self.contact_records().row(self.precision(), i)?;
        let holds = kind.function("holds");
        let stands = format!("({leaving}) | stands_on(here, {contact})");
        let elsewhere = format!("{function}({o}, {d}, {arguments}{stands})");
        let holds = format!("{holds}({o}, {})", arguments.trim_end_matches(", "));
        Ok(format!("    best = nearer_in_contact(best, ray, here, {i}u, {contact}, {elsewhere}, {holds});\n"))
    }

    fn nearest_primitive_table(&self) -> String {
        let primitives = &tables::primitives(self.ir)[..self.options.num_in_table(self.ir)];
        let rotated = tables::any_rotated(primitives.iter().map(|(frame, _)| frame));
        let kinds = ShapeKind::among(primitives.iter().map(|(_, shape)| shape));
        let mut text = frame_functions("Primitive", "primitive", rotated);
        text += &by_kind(
            "fn shape_distance(p: Primitive, o: vec3<real>, d: vec3<real>, leaving: bool, farthest: real) -> real",
            &kinds,
            "MISS",
            |kind, arguments| {
                let farthest = if kind.is_searched() { ", farthest" } else { "" };
                format!("{}(o, d{arguments}, leaving{farthest})", kind.function("distance"))
            },
        );
        if self.contacts.any() {
            let head = "fn shape_holds(p: Primitive, o: vec3<real>) -> bool";
            text += &by_kind(head, &kinds, "false", |kind, a| format!("{}(o{a})", kind.function("holds")));
            let head = "fn shape_quadric(p: Primitive, o: vec3<real>) -> Quadric";
            let flat = "Quadric(0.0, 0.0, 1.0, 0.0)";
            text += &by_kind(head, &kinds, flat, |kind, arguments| {
                quadric_of(kind, "o", arguments.trim_start_matches(", "))
            });
        }
        text
    }

    /// Dispatch over the kinds of shapes that have a function for their normal; the others are quadrics.
    fn normal_by_kind(&self) -> String {
        let mut text = String::from(
            "fn quadric_normal(surface: Surface, position: vec3<real>) -> vec3<real> {\n    \
             let origin = vec3<real>(surface.origin_x, surface.origin_y, surface.origin_z);\n    \
             let p = to_surface(surface, position - origin);\n",
        );
        for kind in self.features.shapes.iter().filter(|kind| kind.has_own_normal()) {
            let arguments: String = (0..kind.num_arguments()).map(|i| format!(", surface.a{i}")).collect();
            let (code, function) = (kind.code(), kind.function("normal"));
            let normal = format!("from_surface(surface, {function}(p{arguments}))");
            let _ = writeln!(text, "    if surface.shape == {code}u {{ return {normal}; }}");
        }
        text + "    return normal_of_quadric(surface, position);\n}\n"
    }

    /// Dispatch over the kinds of sensors that occur; the codes are those of [`tables::sensor_code`].
    fn record(&self) -> String {
        let mut text = String::from("fn record(ray: Ray, sensor: Sensor, index: u32, ends: bool) {\n");
        let f = self.features;
        for (present, code, call) in [
            (f.irradiance, 0, "record_irradiance(ray, sensor, ends)"),
            (f.spectral, 1, "record_spectral(ray, sensor, ends)"),
            (f.far_field, 2, "record_far_field(ray, sensor, ends)"),
            (f.ray_database, 3, "record_ray_database(ray, sensor, index, ends)"),
        ] {
            if present {
                let _ = writeln!(text, "    if sensor.kind == {code}u {{ {call}; }}");
            }
        }
        text.push_str("}\n");
        text
    }

    /// Bins that rays meet on their way, in registers; of a table's mirrors those on the nominal path alone, and the others
    /// book in memory. What a ray has put into them since `keep_bins` is taken back by `restore_bins`.
    fn bins(&self) -> String {
        let f = self.features;
        let mut bins: Vec<(String, bool)> = [
            (f.refractive, "CELL_UNDERFLOWS", false),
            (f.roulette, "CELL_ROULETTE_GAIN", true),
            (f.bulk_absorption, "CELL_BULK", true),
            (f.importance || self.cuts_weights(), "CELL_IMPORTANCE_LOSS", true),
            (f.importance, "CELL_IMPORTANCE_GAIN", true),
            (f.coated, "CELL_COATING", true),
            (!f.bsdfs.is_empty(), "CELL_BSDF", true),
            (!f.bsdfs.is_empty(), "CELL_BSDF_GAIN", true),
        ]
        .into_iter()
        .filter(|(present, ..)| *present)
        .map(|(_, name, has_quanta)| (name.to_string(), has_quanta))
        .collect();
        let on_path = |i: &u32| {
            let paths = self.nominal.into_iter().chain(self.side_paths.iter().map(|side| &side.path));
            paths.flat_map(|path| &path.events).any(|event| event.primitive == *i as usize)
        };
        let mirrors = tables::lossy_mirrors(self.ir).filter(|i| self.options.baked || on_path(i));
        bins.extend(mirrors.map(|i| (format!("{}u", self.cells.surfaces + i), true)));
        let mut variables = String::new();
        let mut add = String::from("fn add_to_bin(cell: u32, q: Quanta) {\n");
        let mut flush = String::from("fn flush_bins() {\n");
        let mut keep = String::from("fn keep_bins() {\n");
        let mut restore = String::from("fn restore_bins() {\n");
        let mut register = |name: String, kind: &str, zero: &str| {
            let _ = writeln!(variables, "var<private> {name}: {kind} = {zero};");
            if self.nominal.is_some() {
                let _ = writeln!(variables, "var<private> kept_{name}: {kind} = {zero};");
            }
            let _ = writeln!(keep, "    kept_{name} = {name};");
            let _ = writeln!(restore, "    {name} = kept_{name};");
        };
        for (i, (cell, has_quanta)) in bins.iter().enumerate() {
            register(format!("bin_{i}_events"), "u32", "0u");
            let _ = writeln!(add, "    if cell == {cell} {{\n        bin_{i}_events += 1u;");
            if *has_quanta {
                register(format!("bin_{i}"), "Quanta", "NO_QUANTA");
                let _ = writeln!(add, "        bin_{i} = q_add(bin_{i}, q);");
                let _ = writeln!(flush, "    flush_bin({cell}, bin_{i}_events, bin_{i});");
            } else {
                let _ = writeln!(flush, "    flush_count({cell}, bin_{i}_events);");
            }
            let _ = writeln!(add, "        return;\n    }}");
        }
        if !self.options.baked {
            add.push_str("    count(cell);\n    deposit(cell, q);\n");
        }
        let mut text = format!("{variables}{add}}}\n{flush}}}\n");
        if self.nominal.is_some() {
            let _ = write!(text, "{keep}}}\n{restore}}}\n");
        }
        text
    }

    /// Dispatch over the kinds of emitters that occur.
    fn emit(&self) -> String {
        let mut text = String::from("fn emit(key: RayKey, e: Emitter) -> LocalRay {\n");
        let (last, others) = match self.features.emitters.split_last() {
            Some(kinds) => kinds,
            None => return String::new(),
        };
        for kind in others {
            let _ = writeln!(
                text,
                "    if e.kind == {}u {{ return emit_{}(key, e); }}",
                *kind as u32,
                kind.name()
            );
        }
        let _ = writeln!(text, "    return emit_{}(key, e);\n}}", last.name());
        text
    }

    /// Dispatch over the kinds of BSDFs that occur.
    fn sample_bsdf(&self) -> String {
        let Some((last, others)) = self.features.bsdfs.split_last() else {
            return String::new();
        };
        let mut text = String::from("fn sample_bsdf(s: Scattering, surface: Surface) -> Lobe {\n");
        for kind in others {
            let (code, name) = (*kind as u32, kind.name());
            let _ = writeln!(text, "    if surface.bsdf == {code}u {{ return sample_{name}(s, surface); }}");
        }
        let _ = writeln!(text, "    return sample_{}(s, surface);\n}}", last.name());
        text
    }

    fn reflect_probability(&self) -> Result<String> {
        if !self.features.importance {
            return Ok(String::new());
        }
        let probability = match self.ir.sampling.reflect_prob {
            ReflectProb::Fresnel => "reflectance".into(),
            ReflectProb::Auto => "clamp(reflectance, 0.25, 0.75)".into(),
            ReflectProb::Constant(p) => literal(p, self.precision())?,
        };
        Ok(format!("fn reflect_probability(reflectance: real) -> real {{\n    return {probability};\n}}\n"))
    }
}

fn log_file(form: Form) -> &'static str {
    match form {
        Form::Counts => shader!("software/log/log_counts.wgsl"),
        Form::Packed => shader!("software/log/log_packed.wgsl"),
        Form::Words => shader!("software/log/log_words.wgsl"),
        Form::Reals => shader!("software/log/log_reals.wgsl"),
    }
}

fn bsdf_file(kind: BsdfKind) -> &'static str {
    match kind {
        BsdfKind::Specular => shader!("bsdfs/specular.wgsl"),
        BsdfKind::Lambertian => shader!("bsdfs/lambertian.wgsl"),
        BsdfKind::HarveyShack => shader!("bsdfs/harvey_shack.wgsl"),
        BsdfKind::Tabulated => shader!("bsdfs/tabulated.wgsl"),
    }
}

/// A `Quadric` that tells in WGSL how far a point `o` is from a shape with these arguments: the shape's own one, or for
/// a shape that is none a plane at the shape's height above the point.
fn quadric_of(kind: ShapeKind, o: &str, arguments: &str) -> String {
    match kind.wgsl().normal {
        Normal::Quadric(quadric) => quadric(&arguments.split(", ").collect::<Vec<_>>()),
        Normal::Facet => "Quadric(0.0, 0.0, 1.0, 0.0)".into(),
        Normal::Own => {
            let height = kind.function("height");
            format!("Quadric(0.0, 0.0, 1.0, 2.0 * ({height}({o}, {arguments}) - ({o}).z))")
        }
    }
}

/// A function that returns for its primitive, `p` in `head`, what `call` does for the kind, given the primitive's arguments,
/// and `otherwise` where it is of none of the kinds; a lone kind is not asked for.
fn by_kind(
    head: &str,
    kinds: &[ShapeKind],
    otherwise: &str,
    call: impl Fn(ShapeKind, &str) -> String,
) -> String {
    let call = |kind: ShapeKind| {
        let arguments: String = (0..kind.num_arguments()).map(|i| format!(", p.a{i}")).collect();
        call(kind, &arguments)
    };
    if let [kind] = kinds {
        return format!("{head} {{\n    return {};\n}}\n", call(*kind));
    }
    let mut text = format!("{head} {{\n    switch p.shape {{\n");
    for kind in kinds {
        let _ = writeln!(text, "        case {}u: {{ return {}; }}", kind.code(), call(*kind));
    }
    let _ = writeln!(text, "        default: {{ return {otherwise}; }}\n    }}\n}}");
    text
}

/// `to_<row>` and `from_<row>`: into and out of a record's frame; no code where no frame of the table is rotated.
fn frame_functions(name: &str, row: &str, rotated: bool) -> String {
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
