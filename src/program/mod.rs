//! From the flat scene to what the GPU runs: features, specialised WGSL and packed buffers.

#[allow(clippy::wildcard_enum_match_arm, reason = "of what naga has, it is refused what shaders do not use")]
pub mod df64;
pub mod events;
pub mod features;
pub mod geometry;
pub mod layout;
pub mod wgsl;

use crate::error::{Error, Result};
use crate::model::{SceneIr, SensorKind, Surface, ray_id};
pub use crate::program::features::{EmitterName, Features, Precision};
use crate::program::geometry::{bvh, contact, mesh, tree};
use crate::program::layout::records::{Records, StructLayout, put_real};
pub use crate::program::layout::rng::Sampler;
pub use crate::program::layout::splitting::Splitting;
use crate::program::layout::sums::SumBuffers;
pub use crate::program::layout::tables::Cells;
use crate::program::layout::{bsdf, rng, tables};
use crate::program::wgsl::compose::Composition;
use crate::software::extension::SoftwareExtension;
use crate::software::log::format::EndLog;
use crate::software::path::main_path::{NominalPath, PilotPath};
use crate::software::path::path_log;
use crate::software::path::path_log::{LoggedScene, PathLog};
use crate::software::path::side_path::SidePath;
use glam::DVec3;

/// Up to so many primitives the scene is compiled in; above, it lies in tables, and a tree finds the nearest. On lavapipe
/// (Zen 3, both ways in turns) lenses in a row, whose boxes most rays cross, are traced as fast by the tree from some 45
/// primitives on in f32 and 25 to 40 in f64, mirrors scattered off the axis from 18 and 14 on. Shaders that have 32
/// primitives compiled in take two to three times as long to compile.
pub const MAX_BAKED_PRIMITIVES: usize = 24;
/// Up to so many detectors stand apart from the tree.
const MAX_SENSORS_APART: usize = 8;
/// Events of an invocation whose loops never make many rounds.
const FEW_EVENTS: u32 = 1 << 8;

/// Which rays have their paths recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PathSampling {
    /// None.
    None,
    /// Rays whose hash is below `threshold`, of 2^32.
    Hashed {
        /// The bound of the hash.
        threshold: u32,
    },
    /// All.
    All,
}

/// How a program is specialised.
#[derive(Debug, Clone, PartialEq)]
pub struct ProgramOptions {
    /// Precision of the physics.
    pub precision: Precision,
    /// 64-bit integers and atomics of the device, instead of pairs of 32-bit ones. The results are the same bits.
    pub native: bool,
    /// Rays write down where they end, and the host adds it up. The results are the same bits.
    pub host_sums: bool,
    /// The scene compiled in, instead of in tables.
    pub baked: bool,
    /// Tables are searched by a tree of boxes, instead of one primitive after the other.
    pub tree: bool,
    /// Tables of at most so many bytes lie in uniform buffers.
    pub uniform_bytes: u32,
    /// Trees of at most so many bytes lie in images.
    pub texel_bytes: u64,
    /// Largest number of events of a ray.
    pub max_depth: u32,
    /// Roulette starts below this weight.
    pub roulette_threshold: f64,
    /// Events a ray goes through in registers before the survivors are compacted.
    pub events_per_dispatch: u32,
    /// Invocations a workgroup.
    pub workgroup_size: u32,
    /// Most rays that an invocation follows, see [`ProgramOptions::rays_per_invocation`]. The results are the same bits.
    pub most_rays_per_invocation: u32,
    /// An invocation follows two rays of the nominal path side by side, where it can
    /// ([`ProgramOptions::goes_side_by_side`]). The results are the same bits.
    pub side_by_side: bool,
    /// Lanes of a subgroup whose places on the nominal path are stored together (shaders/software/path/lanes.together.wgsl); 1 if each
    /// stores its own. The results are the same bits.
    pub lanes: u32,
    /// Lanes of the driver's vectors, where their number can change: with it, shaders do. The results are the same bits.
    pub vector_lanes: u32,
    /// Which paths are recorded.
    pub paths: PathSampling,
    /// The weight that each emitter's rays are born with.
    pub weights: Vec<f64>,
    /// What the draws are.
    pub sampler: Sampler,
    /// What is summed so that results tell their errors.
    pub moments: SecondMoments,
    /// The path that most rays take, for a stage of its own. The results are the same bits.
    pub nominal: Option<PilotPath>,
    /// Those that most of the others take, the most frequent first, for stages of their own. The results are the same bits.
    pub side_paths: Vec<PilotPath>,
    /// Sums are bound in parts of at most so many bytes.
    pub part_bytes: u64,
}

/// What the device sums beside the first moments, so that results tell their errors.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum SecondMoments {
    /// Nothing.
    #[default]
    None,
    /// The squares of what each ray leaves. Where a detector lets rays pass, no ray may outlive a dispatch.
    Squares,
    /// The detectors' cells of each of [`ray_id::NUM_REPLICATES`] independent scrambles of Sobol points.
    Replicates,
}

impl ProgramOptions {
    /// True if rays can outlive a dispatch.
    pub fn has_queue(&self) -> bool {
        self.events_per_dispatch < self.max_depth
    }

    /// The primitives, more than one, that are searched by a tree; none if it is none. Few detectors stand apart and are
    /// compiled in: most rays end on one of them.
    pub fn tree_primitives(&self, ir: &SceneIr) -> std::ops::Range<usize> {
        let (surfaces, sensors) = (ir.surfaces.len(), ir.sensors.len());
        let num = if sensors <= MAX_SENSORS_APART { surfaces } else { surfaces + sensors };
        if self.tree && !self.baked && num > 1 { 0..num } else { 0..0 }
    }

    /// So many primitives, the first of all, are looked up in a table where the scene is not compiled in: all that do not
    /// stand apart from the tree.
    pub fn num_in_table(&self, ir: &SceneIr) -> usize {
        match self.tree_primitives(ir).end {
            0 => ir.surfaces.len() + ir.sensors.len(),
            num => num,
        }
    }

    /// True if so many rows of trees lie in an image. In df64 they do not: the rewriting of f64 knows none.
    pub fn are_texels(&self, num_rows: usize) -> bool {
        const ROW_BYTES: u64 = 16;
        let fits = num_rows as u64 * ROW_BYTES <= self.texel_bytes;
        num_rows > 0 && fits && self.precision != Precision::Df64
    }

    /// What shaders read of primitives, if it is to lie in an image with so many other rows. Lenses are traced a tenth faster
    /// so; spheres alone a tenth slower, whose records are short.
    fn records_in_texels(
        &self,
        ir: &SceneIr,
        centre: DVec3,
        primitives: &[u32],
        num_others: usize,
    ) -> Option<Records> {
        let records = tables::numbered_primitive_records(ir, centre, primitives);
        let makes_reals = match self.precision {
            Precision::F32 => true,
            Precision::F64 => self.native,
            Precision::Df64 => false,
        };
        let num_rows = num_others + records.num_texels(self.precision) * primitives.len();
        (makes_reals && records.has_varying("shape") && self.are_texels(num_rows)).then_some(records)
    }

    /// True if media are compiled in, where shaders read them: few rows are sooner chosen from than read from a table in
    /// which each lane has its own.
    pub fn bakes_media(&self, ir: &SceneIr) -> bool {
        const MOST_CHOSEN: usize = 16;
        self.baked && ir.media.len() * ir.wavelengths.len() <= MOST_CHOSEN
    }

    /// True if the loops of an invocation may make more rounds than some driver allows (shaders/software/rounds.many.wgsl): not if
    /// there are those over its events alone, and few of these.
    pub fn has_many_rounds(&self, features: &Features) -> bool {
        let [.., gaussian] = features.splats;
        features.splits
            || !self.baked
            || features.has_meshes()
            || gaussian
            || features.transmissive && self.moments == SecondMoments::Squares
            || self.events_per_dispatch > FEW_EVENTS
    }

    /// Rays that an invocation of trace_new follows, one after the other: the atomics of its bins then cost little. One where
    /// rays outlive a dispatch, and where the loops of many could make too many rounds; so one, too, where an invocation
    /// remembers a ray's visits (shaders/sums/visits.on.wgsl).
    pub fn rays_per_invocation(&self, features: &Features) -> u32 {
        if self.has_queue() || self.has_many_rounds(features) {
            return 1;
        }
        (FEW_EVENTS / self.events_per_dispatch).clamp(1, self.most_rays_per_invocation.max(1))
    }

    /// True if an invocation of trace_nominal follows two rays at a time: where they leave nothing but what they log, and have
    /// no triangles to remember.
    pub fn goes_side_by_side(&self, features: &Features, log: Option<&PathLog>) -> bool {
        self.side_by_side && log.is_some_and(|log| log.tells_all) && !features.has_meshes()
    }

    /// Rays that an invocation follows along a path one after the other: one where the path takes nothing from them, or
    /// their weights tell what, and a loop would cost more than it spares, and where a lone one already has long loops.
    pub fn path_rays_per_invocation(&self, features: &Features, log: Option<&PathLog>) -> u32 {
        let [.., gaussian] = features.splats;
        let books_nothing = features.keeps_weight || log.is_some_and(|log| log.attenuating_legs.is_some());
        if books_nothing || gaussian {
            return 1;
        }
        self.most_rays_per_invocation.max(1)
    }

    /// True if rows go to the host: rays of a database, or events of paths.
    pub fn has_events(&self, features: &Features) -> bool {
        features.ray_database || self.paths != PathSampling::None
    }
}

/// A composed, validated shader module and the constant buffers it reads.
#[derive(Debug)]
pub struct Program {
    /// The WGSL as it is composed.
    pub wgsl: String,
    /// In df64, the WGSL with pairs in place of f64.
    pub rewritten: Option<String>,
    /// The module that the device runs, for reflection.
    pub module: naga::Module,
    /// What the scene needs.
    pub features: Features,
    /// How it was specialised.
    pub options: ProgramOptions,
    /// Limits of splitting, where rays are split.
    pub splitting: Option<Splitting>,
    /// Its sums.
    pub cells: Cells,
    /// Where they lie on the device.
    pub sums: SumBuffers,
    /// The log of where rays end, if the host adds it up.
    pub end_log: Option<EndLog>,
    /// The path that `trace_nominal` follows; the other stages then trace the rays that strayed from it.
    pub nominal: Option<NominalPath>,
    /// What `trace_nominal` logs, where positions tell all, alone or with weights.
    pub path_log: Option<PathLog>,
    /// The paths that `trace_side_a` and so on follow, which log as it does.
    pub side_paths: Vec<SidePath>,
    /// The scene's centre: positions on the device are relative to it \[mm\].
    pub centre: DVec3,
    /// The random generator's table, which depends on the seed.
    pub rng_table: Vec<u8>,
    /// Contents of the other read-only buffers and images of group 0, by binding.
    pub buffers: Vec<(u32, Vec<u8>)>,
    /// Every ray has at all times the weight that all are born with: sums are counts of it.
    pub constant_weights: bool,
    /// Largest number of rows for the host that one launched ray can make, its children's included.
    pub max_events_per_ray: u64,
    /// Per emitter, the uniform that a dispatch of its rays reads; none for a lone emitter, which is compiled in.
    pub emitters: Vec<Vec<u8>>,
    /// The words of step 0 of the random generator's table.
    first_step: [u32; 4],
}

/// Texels of an image from one line to the next.
pub const TEXELS_PER_LINE: u32 = 4096;

/// Binding of the random generator's table.
pub const RNG_TABLE: u32 = 1;
const SPECTRA: u32 = 6;
const REFLECTANCES: u32 = 7;
const SPECTRAL_BINS: u32 = 8;
const BSDF_TABLE: u32 = 14;

/// Steps that a source may draw beyond the events of a ray: Gaussian beams attempt 32 times and then fall back.
const SOURCE_STEPS: u32 = 33;

impl Program {
    /// Rays that an invocation of trace_nominal follows, side by side or one after the other.
    pub fn nominal_rays_per_invocation(&self) -> u32 {
        match self.options.goes_side_by_side(&self.features, self.path_log.as_ref()) {
            true => 2,
            false => self.side_rays_per_invocation(),
        }
    }

    /// Rays that an invocation follows along a side path; see [`ProgramOptions::path_rays_per_invocation`].
    pub fn side_rays_per_invocation(&self) -> u32 {
        self.options.path_rays_per_invocation(&self.features, self.path_log.as_ref())
    }

    /// What its sums and tables take of a device \[bytes\].
    pub fn device_bytes(&self) -> u64 {
        let sums: u64 = self.sums.all().flat_map(|sums| sums.part_bytes()).sum();
        sums + self.buffers.iter().map(|(_, bytes)| bytes.len() as u64).sum::<u64>()
    }

    /// Composes and packs a scene for a seed.
    ///
    /// # Errors
    /// [`Error::Usage`] if the precision cannot hold one of the scene's numbers.
    pub fn new(ir: &SceneIr, options: ProgramOptions, seed: u64) -> Result<Self> {
        Self::with_wgsl_edit(ir, options, seed, |wgsl| wgsl)
    }

    /// As [`Program::new`], with a change of the composed text: for tests that must notice a wrong shader.
    #[doc(hidden)]
    pub fn with_wgsl_edit(
        ir: &SceneIr,
        mut options: ProgramOptions,
        seed: u64,
        edit: impl FnOnce(String) -> String,
    ) -> Result<Self> {
        let features = Features::of(ir, &options.weights, options.roulette_threshold, options.max_depth);
        let splitting = features.splits.then(|| Splitting::of(&ir.sampling));
        if splitting.is_some() {
            // A family waits in registers, and so stays with its invocation to its end.
            options.events_per_dispatch = options.max_depth;
        }
        let centre = centre_of(ir);
        let cells = match options.moments {
            SecondMoments::None => Cells::of(ir),
            SecondMoments::Squares => Cells::of(ir).with_moments(ir)?,
            SecondMoments::Replicates => Cells::of(ir).with_replicates(ray_id::NUM_REPLICATES)?,
        };
        let in_tree = options.tree_primitives(ir);
        let has_tree = !in_tree.is_empty();
        // Of meshes that no surface has nothing is searched.
        let meshes = if features.has_meshes() { &ir.meshes[..] } else { &[] };
        let mut forest = bvh::Forest::of_roots(meshes.len() + usize::from(has_tree));
        let triangles = mesh::Triangles::of(meshes, &mut forest);
        let contacts = contact::Contacts::of(ir, centre, options.precision)?;
        let facets = tables::FacetTable::of(ir, &contacts, &triangles);
        let tree = match has_tree {
            true => {
                let boxes = tree::boxes(ir, centre, &contacts);
                let mut tree = tree::PrimitiveTree::of(&boxes[in_tree], &mut forest, meshes.len());
                let num_others = forest.num_rows() + triangles.num_rows();
                tree.records = options.records_in_texels(ir, centre, tree.primitives(), num_others);
                Some(tree)
            }
            false => None,
        };
        // Squares are sums that no count tells.
        let constant_weights = features.whole_weights
            && options.moments != SecondMoments::Squares
            && options.weights.iter().all(|weight| *weight == options.weights[0]);
        let end_log = EndLog::of(ir, &features, &cells, &options, constant_weights);
        let pilot = options.nominal.as_ref();
        let nominal = pilot.and_then(|pilot| NominalPath::of(ir, centre, &contacts, &options, pilot));
        let logged = |log| LoggedScene { ir, cells: &cells, log, options: &options, features: &features };
        let path = end_log.as_ref().map(logged).zip(nominal.as_ref());
        let path_log = path.zip(pilot).and_then(|((scene, path), pilot)| PathLog::of(&scene, path, pilot));
        let side_paths = path.map_or_else(Vec::new, |(scene, path)| {
            SidePath::of(&scene, centre, &contacts, path, path_log.as_ref())
        });
        // Sums that follow from counts are none of the device's.
        let num_sums = if constant_weights { 0 } else { cells.num_sums };
        let sums = SumBuffers::of(num_sums, cells.num_counters, options.native, options.part_bytes)?;
        let media_absorb_weakly = pilot.is_some_and(path_log::media_absorb_weakly)
            && side_paths.iter().all(|side| side.media_absorb_weakly);
        let extension = SoftwareExtension { end_log, nominal, path_log, side_paths, media_absorb_weakly };
        let composition = Composition {
            ir,
            features: &features,
            centre,
            cells: &cells,
            sums: &sums,
            forest: &forest,
            triangles: &triangles,
            contacts: &contacts,
            facets: &facets,
            tree: tree.as_ref(),
            constant_weights,
            extension: &extension,
            options: &options,
        };
        let wgsl = edit(composition.compose()?);
        let module = naga::front::wgsl::parse_str(&wgsl)
            .map_err(|e| Error::Internal(format!("the composed shader: {}", e.emit_to_string(&wgsl))))?;
        let (module, rewritten) = match options.precision {
            Precision::Df64 => df64::rewrite(&module).map(|(module, wgsl)| (module, Some(wgsl)))?,
            Precision::F32 | Precision::F64 => (module, None),
        };
        let max_events_per_ray = max_events_per_ray(ir, &features, &options);
        let SoftwareExtension { end_log, nominal, path_log, side_paths, .. } = extension;
        let mut program = Program {
            wgsl,
            rewritten,
            module,
            features,
            options,
            splitting,
            cells,
            sums,
            end_log,
            nominal,
            path_log,
            side_paths,
            centre,
            rng_table: Vec::new(),
            buffers: Vec::new(),
            constant_weights,
            max_events_per_ray,
            emitters: Vec::new(),
            first_step: [0; 4],
        };
        program.set_seed(seed);
        program.max_events_per_ray *= program.most_rays();
        program.buffers = program.pack(ir, &contacts, &facets, tree.as_ref())?;
        program.buffers.extend(program.trees(&forest, &triangles, tree.as_ref())?);
        program.emitters = program.pack_emitters(ir)?;
        Ok(program)
    }

    fn pack(
        &self,
        ir: &SceneIr,
        contacts: &contact::Contacts,
        facets: &tables::FacetTable,
        tree: Option<&tree::PrimitiveTree>,
    ) -> Result<Vec<(u32, Vec<u8>)>> {
        let mut buffers = Vec::new();
        if self.options.precision == Precision::Df64 {
            buffers.push((df64::ZERO, vec![0; 16]));
        }
        if self.features.polychromatic {
            buffers.push((SPECTRA, spectra(ir)));
        }
        if self.features.spectral_reflectance {
            buffers.push((REFLECTANCES, self.reflectances(ir)?));
        }
        if self.features.has_bsdf_table() {
            buffers.push((BSDF_TABLE, self.reals(bsdf::tables(ir).into_iter())?));
        }
        if self.features.spectral {
            buffers.push((SPECTRAL_BINS, spectral_bins(ir)));
        }
        if !facets.words.is_empty() {
            buffers
                .push((contact::FACETS, facets.words.iter().flat_map(|word| word.to_le_bytes()).collect()));
        }
        let mut tables = Vec::new();
        if self.features.reads_media() && !self.options.bakes_media(ir) {
            tables.push(tables::medium_records(ir));
        }
        if !self.options.baked {
            let surfaces = tables::surface_records(ir, self.centre, &self.features);
            let sensors = tables::sensor_records(ir, self.centre, &self.cells);
            let has_records = tree.is_some_and(|tree| tree.records.is_some());
            let num = self.options.num_in_table(ir);
            let primitives = (!has_records).then(|| tables::primitive_records(ir, self.centre, num));
            let contacts = contacts.any().then(|| tables::contact_records(ir, contacts, facets));
            tables.extend([surfaces, sensors].into_iter().chain(primitives).chain(contacts));
        }
        for records in tables {
            let bytes = records.bytes(&self.module, self.options.precision)?;
            buffers.extend(bytes.map(|bytes| (records.binding, bytes)));
        }
        Ok(buffers)
    }

    /// Nodes, triangles and primitives in one buffer; but triangles in another where they are no f32.
    fn trees(
        &self,
        forest: &bvh::Forest,
        triangles: &mesh::Triangles,
        tree: Option<&tree::PrimitiveTree>,
    ) -> Result<Vec<(u32, Vec<u8>)>> {
        let mut rows: Vec<u8> = forest.words()?.flat_map(u32::to_le_bytes).collect();
        let mut of_triangles = self.reals(triangles.reals())?;
        if self.options.precision == Precision::F32 {
            rows.append(&mut of_triangles);
        }
        if let Some(tree) = tree {
            rows.extend(tree.words(self.options.precision)?.into_iter().flat_map(u32::to_le_bytes));
        }
        let buffers = [(mesh::ROWS, of_triangles), (bvh::ROWS, rows)];
        Ok(buffers.into_iter().filter(|(_, bytes)| !bytes.is_empty()).collect())
    }

    /// Other draws, of the same shader: sets the random generator's table.
    pub fn set_seed(&mut self, seed: u64) -> &[u8] {
        let num_steps = (self.options.max_depth + SOURCE_STEPS) as usize;
        let rows = rng::step_table(self.options.sampler, seed, num_steps);
        self.first_step = rows[0];
        self.rng_table = rows.into_iter().flatten().flat_map(u32::to_le_bytes).collect();
        &self.rng_table
    }

    fn pack_emitters(&self, ir: &SceneIr) -> Result<Vec<Vec<u8>>> {
        if ir.emitters.len() == 1 {
            return Ok(Vec::new());
        }
        let records = tables::emitter_records(ir, self.centre, &self.options.weights);
        records.bytes_by_row(&self.module, self.options.precision)
    }

    /// The WGSL that the device runs.
    pub fn source(&self) -> &str {
        self.rewritten.as_deref().unwrap_or(&self.wgsl)
    }

    /// The entry point that follows new rays.
    pub fn entry_point(&self) -> &'static str {
        if self.features.splits { "trace_split" } else { "trace_new" }
    }

    /// Most rays that one launched ray can become.
    pub fn most_rays(&self) -> u64 {
        self.splitting.map_or(1, |splitting| splitting.most_rays())
    }

    fn reals(&self, values: impl Iterator<Item = f64>) -> Result<Vec<u8>> {
        let size = self.real_size();
        let mut bytes = Vec::new();
        for value in values {
            let start = bytes.len();
            bytes.resize(start + size, 0);
            put_real(&mut bytes[start..], value, self.options.precision)?;
        }
        Ok(bytes)
    }

    /// Bytes of a real.
    pub fn real_size(&self) -> usize {
        match self.options.precision {
            Precision::F32 => 4,
            Precision::Df64 | Precision::F64 => 8,
        }
    }

    /// Per surface and wavelength: reflectances of mirrors and coatings, then what coatings let pass.
    fn reflectances(&self, ir: &SceneIr) -> Result<Vec<u8>> {
        let table = |value: fn(&Surface, usize) -> f64| {
            ir.surfaces
                .iter()
                .flat_map(move |surface| (0..ir.wavelengths.len()).map(move |w| value(surface, w)))
        };
        self.reals(table(tables::reflectance).chain(table(tables::coating_pass)))
    }

    /// The uniform of one dispatch (shaders/stages/state.wgsl, `Range`).
    pub fn range_bytes(&self, range: &RayRange) -> Result<Vec<u8>> {
        let layout = StructLayout::of(&self.module, "Range")?;
        let mut bytes = vec![0; layout.stride];
        let [seed_lo, seed_hi, ..] = self.first_step;
        let fields = [
            ("first_lo", range.first as u32),
            ("first_hi", (range.first >> 32) as u32),
            ("count", range.count),
            ("emitter", range.emitter as u32),
            ("seed_lo", seed_lo),
            ("seed_hi", seed_hi),
            ("log_stride", range.log_stride),
            ("reached", range.reached),
        ];
        for (field, value) in fields {
            let offset = layout.offset(field)?;
            bytes[offset..offset + 4].copy_from_slice(&value.to_le_bytes());
        }
        Ok(bytes)
    }
}

/// Rays `first..first + count` of one emitter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayRange {
    /// First ray id.
    pub first: u64,
    /// Number of rays.
    pub count: u32,
    /// The emitter they come from.
    pub emitter: usize,
    /// From an entry of a ray in the log to its next.
    pub log_stride: u32,
    /// Primitives that earlier passes reached, a bit each, where they are marked so.
    pub reached: u32,
}

/// (threshold, wavelength) per entry: bits <= threshold decides as bits / 2^32 <= cdf does.
fn spectra(ir: &SceneIr) -> Vec<u8> {
    const TWO_POW_32: f64 = 4294967296.0;
    let entries = ir.emitters.iter().flat_map(|e| e.spectrum.cdf.iter().zip(&e.spectrum.wavelengths));
    // The conversion saturates: a cdf of 1 gives the largest of all bits.
    entries
        .flat_map(|(cdf, wavelength)| [(cdf * TWO_POW_32).floor() as u32, *wavelength as u32])
        .flat_map(u32::to_le_bytes)
        .collect()
}

/// The bin of each wavelength, per sensor: Optiland's searchsorted(edges, wavelength, "right") - 1, clamped.
fn spectral_bins(ir: &SceneIr) -> Vec<u8> {
    let bins = ir.sensors.iter().flat_map(|sensor| {
        ir.wavelengths.iter().map(|wavelength| match &sensor.kind {
            SensorKind::Spectral { wavelength_edges: edges, .. } => {
                let above = edges.partition_point(|edge| edge <= wavelength);
                above.saturating_sub(1).min(edges.len() - 2) as u32
            }
            SensorKind::Irradiance(_) | SensorKind::FarField { .. } | SensorKind::RayDatabase { .. } => 0,
        })
    });
    bins.flat_map(u32::to_le_bytes).collect()
}

/// The middle of all origins, so that coordinates on the device are of the scene's size, not of its distance.
pub fn centre_of(ir: &SceneIr) -> DVec3 {
    let frames = tables::primitives(ir).into_iter().map(|(frame, _)| frame);
    let origins = frames.chain(ir.emitters.iter().map(|e| e.frame)).map(|frame| frame.origin);
    let bounds = origins.fold(None, |bounds: Option<(DVec3, DVec3)>, origin| match bounds {
        None => Some((origin, origin)),
        Some((low, high)) => Some((low.min(origin), high.max(origin))),
    });
    bounds.map_or(DVec3::ZERO, |(low, high)| 0.5 * (low + high))
}

fn max_events_per_ray(ir: &SceneIr, features: &Features, options: &ProgramOptions) -> u64 {
    let recorded = if features.ray_database {
        let all_absorb =
            ir.sensors.iter().all(|s| s.absorb || !matches!(s.kind, SensorKind::RayDatabase { .. }));
        if all_absorb { 1 } else { options.max_depth }
    } else {
        0
    };
    // Birth, every event, death.
    let path = if options.paths == PathSampling::None { 0 } else { options.max_depth + 2 };
    u64::from(recorded + path)
}
