//! The table of the files of shaders/ that a scene takes: one row a slot, with its twin files and the rule that picks
//! one.
//!
//! A row's rule sees features, options and the prepared scene, and no addition. An addition sets options, or gives a
//! file that takes the place of the row's (`ShaderAddition::replaces`).
//!
//! By this rule four rows pick files of shaders/cpu. The CPU backend sets the option for texels, which picks two files.
//! The CPU backend and derivatives set options for several rays of an invocation. `cpu/loops.many` follows from
//! features and options on every adapter.

use crate::error::{Error, Result};
use crate::model::{DetectorFunction, Precision, SourceFunction};
use crate::program::addition::ShaderAdditions;
use crate::program::features::Features;
use crate::program::layout::tables::ReachedMarks;
use crate::program::options::{PathSampling, ProgramOptions, SecondMoments};
use crate::program::wgsl::composition::Composition;
use crate::shaders::{ShaderFile, shader};

/// Files of every scene.
const ALWAYS: &[ShaderFile] = &[
    shader!("stages/state.wgsl"),
    shader!("stages/counts.wgsl"),
    shader!("stages/generate.wgsl"),
    shader!("stages/interact.wgsl"),
    shader!("stages/splat.wgsl"),
    shader!("stages/trace.wgsl"),
    shader!("geometry/transforms.wgsl"),
    shader!("geometry/quadric.wgsl"),
    shader!("shapes/plane.wgsl"),
    shader!("sums/ledger.wgsl"),
];

/// A slot: a place in a module that one of several files fills. The files declare the same functions.
struct Slot {
    /// The beginning of the files' paths.
    stem: &'static str,
    /// The file that a scene takes, if any.
    pick: fn(&Case) -> Option<ShaderFile>,
}

/// The input of the rules.
struct Case<'a> {
    f: &'a Features,
    o: &'a ProgramOptions,
    all: &'a Composition<'a>,
}

/// Builds slots from rows. A row has the stem; the ends of its files' paths; when the slot is filled; and by which
/// file. An end with `@` has its file under another stem.
macro_rules! slots {
    ($case:ident; $($stem:literal [$($end:ident $(@ $elsewhere:literal)?),+] $when:expr => $which:expr;)+) => {
        &[$(Slot {
            stem: $stem,
            pick: |$case: &Case| {
                let _ = $case;
                $(#[allow(non_upper_case_globals)] const $end: ShaderFile = twin!($stem $(, $elsewhere)?; $end);)+
                $when.then(|| $which)
            },
        }),+]
    };
}

macro_rules! twin {
    ($stem:literal; $end:ident) => {
        shader!($stem, ".", stringify!($end), ".wgsl")
    };
    ($stem:literal, $elsewhere:literal; $end:ident) => {
        shader!($elsewhere, ".", stringify!($end), ".wgsl")
    };
}

/// All slots. `either` picks the first of two files where the condition holds.
#[rustfmt::skip]
const SLOTS: &[Slot] = slots! { c;
    // Stem                     [files]                               filled where => by
    "stages/ids"                [range, range_uploaded]               true => either(c.f.uploads_rays(), range_uploaded, range);
    "stages/launched"           [range]                               c.f.splits => range;
    "stages/path"               [plain]                               true => plain;
    "stages/hit"                [plain]                               true => plain;
    "stages/taps"               [plain]                               true => plain;
    "stages/family"             [plain]                               c.f.splits => plain;
    "stages/lobe"               [plain]                               !c.f.bsdfs.is_empty() => plain;
    "stages/scattered"          [plain]                               !c.f.bsdfs.is_empty() => plain;
    "stages/queue_entry"        [plain]                               c.o.has_queue() => plain;
    "stages/rays"               [one, several @ "cpu/rays"]      true => either(c.o.rays_per_invocation(c.f) == 1, one, several);
    "stages/loops"              [many @ "cpu/loops", few]       true => either(c.o.has_long_loops(c.f), many, few);
    "stages/scatter"            [on, to, none]                        true => match (c.f.bsdfs.is_empty(), c.f.scatters_to) {
        (true, _) => none,
        (false, true) => to,
        (false, false) => on,
    };
    "stages/scatter_branch"     [plain]                               !c.f.bsdfs.is_empty() => plain;
    "stages/scattering"         [plain]                               !c.f.bsdfs.is_empty() => plain;
    "scatter_to/lobe"           [mixed]                               c.f.scatters_to => mixed;
    "stages/compact"            [on, none]                            true => either(c.o.has_queue(), on, none);
    "stages/queued_ray"         [alone, mesh, contact, mesh_contact]  c.o.has_queue() => match (c.has_meshes(), c.has_contacts()) {
        (false, false) => alone,
        (true, false) => mesh,
        (false, true) => contact,
        (true, true) => mesh_contact,
    };

    "optics/spectrum"           [discrete, uploaded, single]          true => match (c.f.polychromatic, c.f.uploads_rays()) {
        (false, _) => single,
        (true, false) => discrete,
        (true, true) => uploaded,
    };
    "optics/bulk"               [on, none]                            true => either(c.f.bulk_absorption, on, none);
    "optics/roulette"           [on, none]                            true => either(c.f.roulette, on, none);
    "optics/attenuated"         [plain]                               c.f.bulk_absorption => plain;
    "optics/survival"           [plain]                               c.f.roulette => plain;
    "optics/reflection"         [drawn]                               !c.f.splits => drawn;
    "optics/wrong_sides"        [counted, none]                       true => either(c.all.wrong_sides().is_some(), counted, none);
    "optics/branch"             [importance, fresnel]                 true => either(c.f.importance, importance, fresnel);
    "optics/coating"            [tabulated, simple, none]             true => match (c.f.coated, c.f.tabulated_coatings) {
        (false, _) => none,
        (true, true) => tabulated,
        (true, false) => simple,
    };
    "optics/coating_pass"       [table, constant]                     c.f.coated && !c.f.tabulated_coatings => either(c.f.spectral_reflectance, table, constant);
    "optics/reflectance"        [table, constant, none]               true => match (c.has_reflectances(), c.f.spectral_reflectance) {
        (false, _) => none,
        (true, true) => table,
        (true, false) => constant,
    };
    "optics/indices"            [table, constant, none]               true => match (c.f.refractive, c.f.polychromatic) {
        (false, _) => none,
        (true, true) => table,
        (true, false) => constant,
    };

    "geometry/gradients"        [tip, smooth]                         true => either(c.f.tips, tip, smooth);
    "geometry/contact"          [on, none]                            true => either(c.has_contacts(), on, none);
    "geometry/mesh"             [none]                                !c.has_meshes() => none;
    "geometry/mesh_rows"        [f32, f64]                            c.has_meshes() => either(c.is_f32(), f32, f64);
    "geometry/edges"            [f32, exact]                          c.has_meshes() => either(c.is_f32(), f32, exact);
    "sources/accepted"          [plain]                               c.f.sources.contains(&SourceFunction::CollimatedGaussian) => plain;
    "sources/aimed"             [table, none]                         c.f.sources.contains(&SourceFunction::Pupil) => either(c.f.aimed, table, none);
    "geometry/clip"             [table, none]                         c.f.can_clip() => either(c.f.clips, table, none);
    "geometry/sag"              [search]                              c.f.has_sags() => search;
    "geometry/sag_rounding"     [f32, df64, f64]                      c.f.has_sags() => match c.o.precision {
        Precision::F32 => f32,
        Precision::Df64 => df64,
        Precision::F64 => f64,
    };
    "geometry/facets"           [touching, apart]                     c.has_meshes() => either(c.touch_facets(), touching, apart);
    "geometry/facet_contacts"   [none]                                c.has_contacts() && !c.touch_facets() => none;
    "geometry/split_triangle"   [mesh, none]                          c.f.splits => either(c.has_meshes(), mesh, none);
    "geometry/tree"             [texels @ "cpu/tree", storage]   c.all.has_trees() => either(c.all.has_texels(), texels, storage);
    "geometry/waiting"          [indexed]                             c.all.has_trees() && !c.all.chooses_what_waits() => indexed;
    "geometry/primitives"       [tree, table]                         !c.o.baked => either(c.all.tree.is_some(), tree, table);
    "geometry/placed"           [texels @ "cpu/placed", table]   c.all.tree.is_some() => either(c.all.tree_records().is_some(), texels, table);
    "geometry/try_primitive"    [alone, contact, facets]              !c.o.baked => match (c.touch_facets(), c.has_contacts()) {
        (true, _) => facets,
        (false, true) => contact,
        (false, false) => alone,
    };

    "sums/ends"                 [deposited]                           true => deposited;
    "sums/passes"               [deposited]                           true => deposited;
    "sums/weights"              [constant, vary]                      true => either(c.all.constant_weights, constant, vary);
    "sums/reached"              [none, bits, counters]                true => match c.all.cells.reached_marks(c.f, c.o.baked) {
        ReachedMarks::None => none,
        ReachedMarks::Bits => bits,
        ReachedMarks::Counters => counters,
    };
    "sums/deposit"              [plain]                               true => plain;
    "sums/replicates"           [on, none]                            true => either(c.o.moments == SecondMoments::Replicates, on, none);
    "sums/moments"              [on, none]                            true => either(c.has_squares(), on, none);
    "sums/visits"               [on, none]                            c.has_squares() => either(c.f.transmissive || c.f.splits, on, none);

    "rows/paths"                [none, recorded]                      true => either(c.o.paths == PathSampling::None, none, recorded);
};

impl Case<'_> {
    /// Files that have no twin, and when a scene takes them.
    fn single(&self, additions: &ShaderAdditions) -> [(bool, ShaderFile); 10] {
        let (f, o) = (self.f, self.o);
        [
            (!f.splits, shader!("stages/intersect.wgsl")),
            (f.splits, shader!("stages/split.wgsl")),
            (f.reads_media(), shader!("optics/media.wgsl")),
            (f.has_tables(), shader!("optics/tables.wgsl")),
            (f.has_polar_tables(), shader!("optics/polar_table.wgsl")),
            (self.all.has_trees(), shader!("geometry/boxes.wgsl")),
            (f.reads_bins(), shader!("detectors/bins.wgsl")),
            (f.borrows(DetectorFunction::FarField), DetectorFunction::FarField.wgsl().file),
            (f.borrows(DetectorFunction::FarFieldSphere), DetectorFunction::FarFieldSphere.wgsl().file),
            (o.has_events(f) || additions.rows_per_ray(o.max_depth) > 0, shader!("rows/events.wgsl")),
        ]
    }

    fn has_meshes(&self) -> bool {
        self.f.has_meshes()
    }

    fn has_contacts(&self) -> bool {
        self.all.contacts.any()
    }

    fn touch_facets(&self) -> bool {
        self.all.searches_facets()
    }

    fn has_reflectances(&self) -> bool {
        self.f.reflective || self.f.coated
    }

    fn has_squares(&self) -> bool {
        self.o.moments == SecondMoments::Squares
    }

    fn is_f32(&self) -> bool {
        self.o.precision == Precision::F32
    }
}

/// One of two files.
pub(crate) fn either(condition: bool, first: ShaderFile, second: ShaderFile) -> ShaderFile {
    if condition { first } else { second }
}

impl Composition<'_> {
    /// The files that the scene needs, each once.
    pub(super) fn files(&self, additions: &ShaderAdditions) -> Result<Vec<ShaderFile>> {
        let case = Case { f: &self.features, o: &self.options, all: self };
        let is_slot = |stem| SLOTS.iter().any(|slot| slot.stem == stem);
        if let Some((stem, file)) = additions.replaced().find(|(stem, _)| !is_slot(*stem)) {
            return Err(Error::Internal(format!(
                "{} is for the slot {stem}, which does not exist",
                file.path
            )));
        }
        let mut files = ALWAYS.to_vec();
        files.extend(case.single(additions).into_iter().filter(|(needed, _)| *needed).map(|(_, file)| file));
        files.extend(self.features.detectors.iter().map(|function| function.wgsl().file));
        for slot in SLOTS {
            if let Some(own) = (slot.pick)(&case) {
                files.push(additions.file(slot.stem)?.unwrap_or(own));
            }
        }
        // Several kinds of shapes may share a file.
        for kind in &self.features.shapes {
            let file = kind.wgsl().file;
            if files.iter().all(|known| known.path != file.path) {
                files.push(file);
            }
        }
        files.extend(self.features.sources.iter().map(|name| name.wgsl().file));
        for kind in &self.features.bsdfs {
            let shared =
                kind.wgsl().shared.filter(|shared| files.iter().all(|known| known.path != shared.path));
            files.extend(shared.into_iter().chain([kind.wgsl().file]));
            let toward = kind.wgsl().toward.iter().filter(|_| self.features.scatters_to);
            let new = toward.filter(|toward| files.iter().all(|known| known.path != toward.path)).copied();
            let new: Vec<ShaderFile> = new.collect();
            files.extend(new);
        }
        Ok(files)
    }
}
