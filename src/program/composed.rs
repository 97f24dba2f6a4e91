//! A scene as a module of WGSL, with the buffers that it reads.

use crate::error::Result;
use crate::model::Precision;
use crate::model::surface_optics::{coating_pass, reflectance};
use crate::model::{Detector, SceneIr, SourceFunction, Surface};
use crate::program::features::Features;
use crate::program::geometry::{bvh, contact, mesh, tree};
use crate::program::layout::kind_tables::Places;
use crate::program::layout::paths::PathTableLayout;
use crate::program::layout::reals::{StructLayout, put_real};
use crate::program::layout::splitting::Splitting;
use crate::program::layout::sums::SumBuffers;
use crate::program::layout::tables::Cells;
use crate::program::layout::{bindings, rng, tables};
use crate::program::options::{PathSampling, PathSums, ProgramOptions, RayRange};
use crate::program::parsed::Parsed;
use crate::program::prepared::Prepared;
use crate::program::wgsl::composition::Composition;
use crate::program::wgsl::extension::{Extend, Extension, NoExtension};
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
    /// What was added to the plain module.
    pub extension: Arc<dyn Extension>,
    /// The scene's centre: positions on the device are relative to it \[mm\].
    pub centre: DVec3,
    /// The random generator's table, which depends on the seed.
    pub rng_table: Vec<u8>,
    /// Contents of the other read-only buffers and images of the scene, by binding.
    pub buffers: Vec<(u32, Vec<u8>)>,
    /// Every ray has at all times the weight that all are born with: sums are counts of it.
    pub constant_weights: bool,
    /// What the rows of the table of paths are, where there is one.
    pub path_table: Option<PathTableLayout>,
    /// Largest number of rows for the host that one launched ray can make, its children's included.
    pub max_events_per_ray: u64,
    /// Per source, the uniform that a dispatch of its rays reads; none for a single source, which is compiled in.
    pub source_uniforms: Vec<Vec<u8>>,
    /// The tangents of these uniforms: for each parameter the binding, and the contents by source.
    pub source_tangents: Vec<(u32, Vec<Vec<u8>>)>,
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
    /// What its sums and tables take of a device \[bytes\].
    pub fn device_bytes(&self) -> u64 {
        let sums: u64 = self.sums.all().flat_map(|sums| sums.part_bytes()).sum();
        sums + self.buffers.iter().map(|(_, bytes)| bytes.len() as u64).sum::<u64>()
    }

    /// Composes and packs a scene for a seed, in the plain way.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if the precision cannot hold one of the scene's numbers.
    pub fn new(ir: &SceneIr, options: ProgramOptions, seed: u64) -> Result<Self> {
        Self::extended(ir, options, &NoExtension, seed, |wgsl| wgsl)
    }

    /// As [`Program::new`], with an extension. `edit` changes the composed text: for tests that must notice a wrong shader.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if the precision cannot hold one of the scene's numbers.
    pub fn extended(
        ir: &SceneIr,
        options: ProgramOptions,
        extend: &dyn Extend,
        seed: u64,
        edit: impl FnOnce(String) -> String,
    ) -> Result<Self> {
        let parse = |wgsl, precision| Parsed::of(wgsl, precision).map(Arc::new);
        Self::parsed_by(ir, options, extend, seed, |wgsl, precision| parse(edit(wgsl), precision))
    }

    /// As [`Program::extended`]. `parse` gives the module of a text.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if the precision cannot hold one of the scene's numbers.
    pub fn parsed_by(
        ir: &SceneIr,
        options: ProgramOptions,
        extend: &dyn Extend,
        seed: u64,
        parse: impl FnOnce(String, Precision) -> Result<Arc<Parsed>>,
    ) -> Result<Self> {
        let scene = Prepared::of(ir, options)?;
        let extension = extend.extension(&scene);
        // Sums that follow from counts are none of the device's.
        let num_sums = if scene.constant_weights { 0 } else { scene.cells.num_sums };
        let sums = SumBuffers::of(
            num_sums,
            scene.cells.num_counters,
            scene.options.native,
            scene.options.part_bytes,
        )?;
        let composition = Composition::of(&scene, &sums);
        let parsed = parse(composition.compose(extension.as_ref())?, scene.options.precision)?;
        let numbers = composition.numbers.bytes(&parsed.module)?;
        let Prepared { options, features, splitting, centre, cells, constant_weights, path_table, .. } =
            scene;
        let path_table = options.has_path_table().then_some(path_table);
        let mut program = Program {
            parsed,
            max_events_per_ray: max_events_per_ray(ir, &features, &options),
            features,
            options,
            splitting,
            cells,
            sums,
            extension,
            centre,
            rng_table: Vec::new(),
            buffers: Vec::new(),
            constant_weights,
            path_table,
            source_uniforms: Vec::new(),
            source_tangents: Vec::new(),
            first_step: [0; 4],
        };
        program.set_seed(seed);
        // Of a family whose paths are told, one ray is.
        if program.options.path_sums != PathSums::Told {
            program.max_events_per_ray *= program.most_rays();
        }
        program.buffers = program.pack(ir, &scene.contacts, &scene.facets, scene.tree.as_ref())?;
        program.buffers.extend(numbers.map(|bytes| (bindings::NUMBERS, bytes)));
        program.buffers.extend(program.trees(&scene.forest, &scene.triangles, scene.tree.as_ref())?);
        program.source_uniforms = program.pack_sources(ir)?;
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
            buffers.push((bindings::DF64_ZERO, vec![0; 16]));
        }
        if self.features.polychromatic {
            buffers.push((bindings::SPECTRA, spectra(ir)));
        }
        if self.features.spectral_reflectance {
            buffers.push((bindings::REFLECTANCES, self.reflectances(ir)?));
        }
        if self.features.has_tables() {
            buffers.push((bindings::TABLES, self.reals(Places::of(ir).numbers()?.into_iter())?));
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
            tables.push(tables::surface_records(ir, self.centre, &self.features));
            tables.push(tables::detector_records(ir, self.centre, &self.cells));
        }
        if !self.options.baked {
            let has_records = tree.is_some_and(|tree| tree.records.is_some());
            let num = self.options.num_in_table(ir);
            tables.extend((!has_records).then(|| tables::primitive_records(ir, self.centre, num)));
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
        // A source may draw beyond the events of a ray.
        let source_steps = SourceFunction::ALL.iter().map(|name| name.wgsl().num_steps).fold(0, u32::max);
        let num_steps = (self.options.max_depth + source_steps) as usize;
        let rows = rng::step_table(self.options.sampler, seed, num_steps);
        self.first_step = rows[0];
        self.rng_table = rows.into_iter().flatten().flat_map(u32::to_le_bytes).collect();
        &self.rng_table
    }

    fn pack_sources(&self, ir: &SceneIr) -> Result<Vec<Vec<u8>>> {
        if ir.sources.len() == 1 {
            return Ok(Vec::new());
        }
        let records = tables::source_records(ir, self.centre, &self.options.weights);
        records.bytes_by_row(&self.module, self.options.precision)
    }

    /// The entry point that follows new rays.
    pub fn entry_point(&self) -> &'static str {
        match (self.options.adjoints, self.features.splits) {
            (true, _) => crate::program::rewrite::transpose::ENTRY_POINT,
            (false, true) => "trace_split",
            (false, false) => "trace_new",
        }
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
    let is_told = options.paths != PathSampling::None || options.path_sums == PathSums::Told;
    let path = if is_told { options.max_depth + 2 } else { 0 };
    u64::from(recorded + path)
}
