//! A scene as a module of WGSL, with the buffers that it reads.

use crate::error::Result;
use crate::model::Precision;
use crate::model::sources::rays::MOST_UPLOADED;
use crate::model::surface_optics::{coating_pass, reflectance};
use crate::model::{Detector, SceneIr, SourceFunction, Surface};
use crate::program::addition::{ProgramAddition, ShaderAdditions};
use crate::program::features::Features;
use crate::program::geometry::{bvh, contact, mesh, tree};
use crate::program::input::ProgramInput;
use crate::program::layout::kind_tables::KindTables;
use crate::program::layout::reals::{StructLayout, put_real};
use crate::program::layout::splitting::Splitting;
use crate::program::layout::sums::SumBuffers;
use crate::program::layout::tables::Cells;
use crate::program::layout::{bindings, rng, tables};
use crate::program::options::{PathSampling, ProgramOptions, RayRange};
use crate::program::parsed::Parsed;
use crate::program::streamed_sources::StreamedSources;
use crate::program::wgsl::composition::Composition;
use glam::DVec3;
use std::ops::Deref;
use std::sync::Arc;

/// A composed, validated shader module and the constant buffers it reads.
#[derive(Debug)]
pub struct Program {
    /// Its module, which programs of the same text share.
    pub parsed: Arc<Parsed>,
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
    /// What additions give to the plain module.
    pub additions: ShaderAdditions,
    /// The entry point that follows new rays.
    pub entry_point: &'static str,
    /// The scene's centre: positions on the device are relative to it \[mm\].
    pub centre: DVec3,
    /// The random generator's table, which depends on the seed.
    pub rng_table: Vec<u8>,
    /// Contents of the other read-only buffers and images of the scene, by binding.
    pub buffers: Vec<(u32, Vec<u8>)>,
    /// Every ray has at all times the weight that all are born with: sums are counts of it.
    pub constant_weights: bool,
    /// Largest number of rows for the host that one launched ray can make, its children's included.
    pub max_events_per_ray: u64,
    /// Per source, the uniform that a dispatch of its rays reads; none for a single source, which is compiled in.
    pub source_uniforms: Vec<Vec<u8>>,
    /// The uniforms of additions that a dispatch reads: the binding, and the contents by source.
    pub uploads: Vec<(u32, Vec<Vec<u8>>)>,
    /// The rays of files that are uploaded for each dispatch.
    streams: StreamedSources,
    /// The seed of the draws.
    seed: u64,
    /// The words of step 0 of the random generator's table.
    first_step: [u32; 4],
}

impl Deref for Program {
    type Target = Parsed;

    fn deref(&self) -> &Parsed {
        &self.parsed
    }
}

impl Program {
    /// Composes and packs a scene for a seed, in the plain way.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if the precision cannot hold one of the scene's numbers.
    pub fn new(ir: &SceneIr, options: ProgramOptions, seed: u64) -> Result<Self> {
        Self::with(ir, options, &[], seed)
    }

    /// As [`Program::new`], with additions.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if the precision cannot hold one of the scene's numbers.
    pub fn with(
        ir: &SceneIr,
        options: ProgramOptions,
        additions: &[&dyn ProgramAddition],
        seed: u64,
    ) -> Result<Self> {
        Self::parsed_by(ir, options, additions, seed, |wgsl, precision, additions| {
            Parsed::of(wgsl, precision, additions).map(Arc::new)
        })
    }

    /// As [`Program::with`]. `parse` gives the module of a text.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if the precision cannot hold one of the scene's numbers.
    pub fn parsed_by(
        ir: &SceneIr,
        options: ProgramOptions,
        additions: &[&dyn ProgramAddition],
        seed: u64,
        parse: impl FnOnce(String, Precision, &ShaderAdditions) -> Result<Arc<Parsed>>,
    ) -> Result<Self> {
        let scene = ProgramInput::of(ir, options, additions)?;
        let additions = ShaderAdditions::of(additions, &scene);
        // Sums that follow from counts are none of the device's.
        let num_sums = if scene.constant_weights { 0 } else { scene.cells.num_sums };
        let sums = SumBuffers::of(
            num_sums,
            scene.cells.num_counters,
            scene.options.native,
            scene.options.part_bytes,
        )?;
        let composition = Composition::of(&scene, &sums);
        let parsed = parse(composition.compose(&additions)?, scene.options.precision, &additions)?;
        let numbers = composition.numbers.bytes(&parsed.module)?;
        let ProgramInput { options, features, splitting, centre, cells, places, constant_weights, .. } =
            scene;
        let plain_entry_point = if features.splits { "trace_split" } else { "trace_new" };
        let mut program = Program {
            entry_point: additions.entry_point()?.unwrap_or(plain_entry_point),
            parsed,
            max_events_per_ray: max_events_per_ray(ir, &features, &options),
            features,
            options,
            splitting,
            cells,
            sums,
            additions,
            centre,
            rng_table: Vec::new(),
            buffers: Vec::new(),
            constant_weights,
            source_uniforms: Vec::new(),
            uploads: Vec::new(),
            streams: StreamedSources::of(ir, &places),
            seed,
            first_step: [0; 4],
        };
        program.set_seed(seed);
        program.max_events_per_ray *= program.most_rays();
        program.max_events_per_ray += program.additions.rows_per_ray(program.options.max_depth);
        program.buffers = program.pack(ir, &places, &scene.contacts, &scene.facets, scene.tree.as_ref())?;
        program.buffers.extend(numbers.map(|bytes| (bindings::NUMBERS, bytes)));
        program.buffers.extend(program.trees(&scene.forest, &scene.triangles, scene.tree.as_ref())?);
        program.source_uniforms = program.pack_sources(ir, &places)?;
        Ok(program)
    }

    fn pack(
        &self,
        ir: &SceneIr,
        places: &KindTables,
        contacts: &contact::Contacts,
        facets: &tables::FacetTable,
        tree: Option<&tree::PrimitiveTree>,
    ) -> Result<Vec<(u32, Vec<u8>)>> {
        let mut buffers = Vec::new();
        if self.options.precision == Precision::Df64 {
            buffers.push((bindings::DF64_ZERO, vec![0; 16]));
        }
        if self.features.polychromatic {
            buffers.push((bindings::SPECTRA, spectra(ir)));
        }
        if self.features.spectral_reflectance {
            buffers.push((bindings::REFLECTANCES, self.reflectances(ir)?));
        }
        if self.features.has_tables() {
            buffers.push((bindings::TABLES, self.reals(places.numbers()?.iter().copied())?));
        }
        if self.features.reads_bins() {
            buffers.push((bindings::SPECTRAL_BINS, spectral_bins(ir)));
        }
        if !facets.words.is_empty() {
            buffers
                .push((bindings::FACETS, facets.words.iter().flat_map(|word| word.to_le_bytes()).collect()));
        }
        let mut tables = Vec::new();
        if self.features.reads_media() && !self.options.bakes_media(ir) {
            tables.push(tables::medium_records(ir));
        }
        if !self.options.bakes_records() {
            tables.push(tables::surface_records(ir, self.centre, &self.features, places));
            tables.push(tables::detector_records(ir, self.centre, &self.cells));
        }
        if !self.options.baked {
            let has_records = tree.is_some_and(|tree| tree.records.is_some());
            let num = self.options.num_in_table(ir);
            tables.extend((!has_records).then(|| tables::primitive_records(ir, self.centre, num, places)));
            tables.extend(contacts.any().then(|| tables::contact_records(ir, contacts, facets)));
        }
        for records in tables {
            let records = records.with_live(self.options.live);
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
        let buffers = [(bindings::MESH_ROWS, of_triangles), (bindings::TREE_ROWS, rows)];
        Ok(buffers.into_iter().filter(|(_, bytes)| !bytes.is_empty()).collect())
    }

    /// Other draws, of the same shader: sets the random generator's table.
    pub fn set_seed(&mut self, seed: u64) -> &[u8] {
        self.seed = seed;
        // A source may draw beyond the events of a ray.
        let source_steps = SourceFunction::ALL.iter().map(|name| name.wgsl().num_steps).fold(0, u32::max);
        let num_steps = (self.options.max_depth + source_steps) as usize;
        let rows = rng::step_table(self.options.sampler, seed, num_steps);
        self.first_step = rows[0];
        self.rng_table = rows.into_iter().flatten().flat_map(u32::to_le_bytes).collect();
        &self.rng_table
    }

    /// Most rays of a dispatch, where the host uploads rays of files.
    pub(crate) fn most_uploaded(&self) -> u32 {
        if self.features.uploads_rays() { MOST_UPLOADED } else { u32::MAX }
    }

    /// True if rays of this source begin as rays that are uploaded.
    pub(crate) fn streams_rays(&self, source: usize) -> bool {
        self.streams.has(source)
    }

    /// What is uploaded for a dispatch of rays with these ids, and its first byte in the tables' buffer. None for a source whose
    /// rays are not uploaded.
    ///
    /// # Errors
    /// If the rays' file can no longer be read, or the precision cannot hold a number.
    pub(crate) fn streamed_rows(&self, source: usize, ids: &[u64]) -> Result<Option<(u64, Vec<u8>)>> {
        let rows = self.streams.rows(source, self.seed, ids)?;
        let bytes = |(first, numbers): (usize, Vec<f64>)| {
            Ok(((first * self.real_size()) as u64, self.reals(numbers.into_iter())?))
        };
        rows.map(bytes).transpose()
    }

    fn pack_sources(&self, ir: &SceneIr, places: &KindTables) -> Result<Vec<Vec<u8>>> {
        if ir.sources.len() == 1 {
            return Ok(Vec::new());
        }
        let records = tables::source_records(ir, self.centre, &self.options.weights, places);
        records.bytes_by_row(&self.module, self.options.precision)
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
        self.reals(table(reflectance).chain(table(coating_pass)))
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
            ("source", range.source as u32),
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

/// (threshold, wavelength) per entry: bits <= threshold decides as bits / 2^32 <= cdf does.
fn spectra(ir: &SceneIr) -> Vec<u8> {
    const TWO_POW_32: f64 = 4294967296.0;
    let entries = ir.sources.iter().flat_map(|e| e.spectrum.cdf.iter().zip(&e.spectrum.wavelengths));
    // The conversion saturates: a cdf of 1 gives the largest of all bits.
    entries
        .flat_map(|(cdf, wavelength)| [(cdf * TWO_POW_32).floor() as u32, *wavelength as u32])
        .flat_map(u32::to_le_bytes)
        .collect()
}

/// The bin of each wavelength, per detector.
fn spectral_bins(ir: &SceneIr) -> Vec<u8> {
    let bins = |detector: &Detector| ir.wavelengths.iter().map(|&w| detector.kind.bin(w)).collect::<Vec<_>>();
    ir.detectors.iter().flat_map(bins).flat_map(u32::to_le_bytes).collect()
}

fn max_events_per_ray(ir: &SceneIr, features: &Features, options: &ProgramOptions) -> u64 {
    let recorded = if features.stores_rays() {
        let all_absorb = ir.detectors.iter().all(|s| s.absorb || !s.kind.stores_rays());
        if all_absorb { 1 } else { options.max_depth }
    } else {
        0
    };
    // Birth, every event, death.
    let path = if options.paths != PathSampling::None { options.max_depth + 2 } else { 0 };
    u64::from(recorded + path)
}
