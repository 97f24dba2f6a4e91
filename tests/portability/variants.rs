//! Scenes and options that bring in each feature: alone, in pairs, and all at once.

use glam::{DMat3, DVec2, DVec3};
use nsq_gpu::cpu::path::hot_path::{ProfiledPath, SampledPath};
use nsq_gpu::cpu::request::CpuRequest;
use nsq_gpu::derivatives::Derivatives;
use nsq_gpu::guide::{Guide, Guided};
use nsq_gpu::model::Apart;
use nsq_gpu::model::ShapeKind;
use nsq_gpu::model::StepKind;
use nsq_gpu::model::path_filter::{Count, Events, Mark, Part, PathFilter, Pattern, Relation, Term};
use nsq_gpu::model::scatter_sampling::{Target, TargetShape};
use nsq_gpu::model::shapes::aperture::{ApertureOutline, Axes};
use nsq_gpu::model::shapes::freeform::Polynomial;
use nsq_gpu::model::shapes::{Biconic, Freeform, SagSurface, Toroidal};
use nsq_gpu::model::sources::rays::{Bounds, FileRays, Order, RayGroup, RayStream, StreamedRay};
use nsq_gpu::model::sources::{self, Aim};
use nsq_gpu::model::{
    Annulus, Aperture, AsphereProfile, Bsdf, BsdfKind, BsdfTable, ClippedConic, Coating, CoatingRow,
    Collimated, Conic, Detector, DetectorKind, Extended, FarField, Frame, Frustum, HarveyShack, Interaction,
    KCorrelation, Lambertian, Measured, MeasuredRow, MeasuredTable, Medium, Mesh, MeshId, Outline, PixelGrid,
    Point, PolarTable, Pupil, RayDatabase, ReflectProb, Sampling, Scatter, ScatterSampling, SceneIr, Shape,
    SimpleCoating, Source, SourceKind, Spectral, Spectrum, Specular, Sphere, Splat, Surface, Tabulated,
    TabulatedCoating,
};
use nsq_gpu::paths::followed::FollowedPaths;
use nsq_gpu::paths::sums::PathSums;
use nsq_gpu::program::addition::{ProgramAddition, ShaderAdditions};
use nsq_gpu::program::parsed::Parsed;
use nsq_gpu::program::rewrite::jvp::{Parameter, Tangents};
use nsq_gpu::program::{
    PathSampling, Precision, Program, ProgramOptions, Sampler, SecondMoments, SourceFunction,
};
use nsq_gpu::{Error, Result, TraceOptions};
use std::sync::Arc;

/// How a scene is compiled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tier {
    pub precision: Precision,
    pub native: bool,
    pub baked: bool,
}

impl Tier {
    /// All twelve.
    pub fn all() -> Vec<Tier> {
        let mut tiers = Vec::new();
        for precision in [Precision::F32, Precision::Df64, Precision::F64] {
            for native in [false, true] {
                tiers.extend([false, true].map(|baked| Tier { precision, native, baked }));
            }
        }
        tiers
    }
}

/// A scene and the options that change its shader.
#[derive(Debug, Clone)]
pub struct Variant {
    pub ir: SceneIr,
    pub paths: PathSampling,
    pub path_sums: PathSums,
    pub path_filter: Option<Arc<PathFilter>>,
    pub guided: bool,
    pub queue: bool,
    pub tree: bool,
    pub uniform_bytes: u32,
    pub texel_bytes: u64,
    pub roulette_threshold: f64,
    pub sampler: Sampler,
    pub moments: SecondMoments,
    /// The host adds up where rays end.
    pub deferred_splats: bool,
    /// The path that has a stage of its own.
    pub hot_path: Option<ProfiledPath>,
    /// The paths of rays that fail its guards.
    pub side_traces: Vec<ProfiledPath>,
    /// Sums are bound in parts of at most so many bytes.
    pub part_bytes: u64,
    /// Derivatives, of some parameters or of a loss.
    pub derivatives: Option<Derivatives>,
}

/// One feature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Choice {
    Shape(ShapeKind),
    Source(SourceFunction),
    Detector(usize),
    TransmissiveDetector(usize),
    Splat(Splat),
    SpectralSplat(Splat),
    Refractive,
    Reflective,
    ReflectiveBySpectrum,
    Absorbing,
    Aimed,
    Clipped,
    Tip,
    Coated,
    CoatedByAngle,
    CoatedBySpectrum,
    Scattering(BsdfKind),
    TransmissiveLobe(BsdfKind),
    /// A lens of this BSDF, with a target of each shape.
    ScattersTo(BsdfKind),
    Policy(ReflectProb),
    Split,
    Roulette,
    Polychromatic,
    AbsorbingMedium,
    Paths(PathSampling),
    Queue,
    QueuedMesh,
    QueuedContact,
    QueuedFacets,
    Tree {
        texel_bytes: u64,
    },
    UniformTables,
    Rotated,
    Sampler(Sampler),
    Moments,
    HostSums,
    HotPath {
        absorbs: bool,
    },
    HotPathThroughDetector,
    HotPathThroughGlass,
    Replicates,
    SumsInParts,
    PathSums(PathSums),
    PathFilter,
}

/// The variant after this one, so that a new one cannot be forgotten: the match would not compile.
fn shape_after(kind: ShapeKind) -> Option<ShapeKind> {
    match kind {
        ShapeKind::Conic => Some(ShapeKind::Plane),
        ShapeKind::Plane => Some(ShapeKind::Rectangle),
        ShapeKind::Rectangle => Some(ShapeKind::Disk),
        ShapeKind::Disk => Some(ShapeKind::Annulus),
        ShapeKind::Annulus => Some(ShapeKind::Frustum),
        ShapeKind::Frustum => Some(ShapeKind::Sphere),
        ShapeKind::Sphere => Some(ShapeKind::Mesh),
        ShapeKind::Mesh => Some(ShapeKind::ClippedConic),
        ShapeKind::ClippedConic => Some(ShapeKind::EvenAsphere),
        ShapeKind::EvenAsphere => Some(ShapeKind::OddAsphere),
        ShapeKind::OddAsphere => Some(ShapeKind::Biconic),
        ShapeKind::Biconic => Some(ShapeKind::Toroidal),
        ShapeKind::Toroidal => Some(ShapeKind::Freeform),
        ShapeKind::Freeform => None,
    }
}

fn source_after(name: SourceFunction) -> Option<SourceFunction> {
    match name {
        SourceFunction::Point => Some(SourceFunction::CollimatedTophat),
        SourceFunction::CollimatedTophat => Some(SourceFunction::CollimatedGaussian),
        SourceFunction::CollimatedGaussian => Some(SourceFunction::ExtendedRectangle),
        SourceFunction::ExtendedRectangle => Some(SourceFunction::ExtendedDisk),
        SourceFunction::ExtendedDisk => Some(SourceFunction::Pupil),
        SourceFunction::Pupil => Some(SourceFunction::Tabulated),
        SourceFunction::Tabulated => Some(SourceFunction::Rays),
        SourceFunction::Rays => Some(SourceFunction::StreamedRays),
        SourceFunction::StreamedRays => None,
    }
}

fn bsdf_after(kind: BsdfKind) -> Option<BsdfKind> {
    match kind {
        BsdfKind::Specular => Some(BsdfKind::Lambertian),
        BsdfKind::Lambertian => Some(BsdfKind::HarveyShack),
        BsdfKind::HarveyShack => Some(BsdfKind::Tabulated),
        BsdfKind::Tabulated => Some(BsdfKind::KCorrelation),
        BsdfKind::KCorrelation => Some(BsdfKind::Measured),
        BsdfKind::Measured => None,
    }
}

/// Every kind of BSDF function.
pub fn bsdfs() -> Vec<BsdfKind> {
    std::iter::successors(Some(BsdfKind::Specular), |kind| bsdf_after(*kind)).collect()
}

/// Every kind of shape function.
pub fn shapes() -> Vec<ShapeKind> {
    std::iter::successors(Some(ShapeKind::Conic), |kind| shape_after(*kind)).collect()
}

/// Every kind of source function.
pub fn sources() -> Vec<SourceFunction> {
    std::iter::successors(Some(SourceFunction::Point), |name| source_after(*name)).collect()
}

/// Position of a kind among [`detectors`]; a new one fails to compile here.
fn detector_position(kind: &DetectorKind) -> usize {
    match kind {
        DetectorKind::Irradiance(_) => 0,
        DetectorKind::Spectral(_) => 1,
        DetectorKind::FarField(FarField { sphere: false, .. }) => 2,
        DetectorKind::FarField(_) => 5,
        DetectorKind::RayDatabase(_) => 3,
        DetectorKind::Apart(apart) => match *apart.of {
            DetectorKind::FarField(FarField { sphere: true, .. }) => 6,
            _ => 4,
        },
    }
}

/// One detector of every kind.
pub fn detectors() -> Vec<DetectorKind> {
    let far_field = |sphere| DetectorKind::FarField(FarField { num_theta: 8, num_phi: 18, sphere });
    let apart = |sphere| {
        DetectorKind::Apart(Apart { of: Box::new(far_field(sphere)), wavelengths: vec![0.45, 0.55] })
    };
    let kinds = vec![
        DetectorKind::Irradiance(grid(Splat::Hard)),
        DetectorKind::Spectral(Spectral { grid: grid(Splat::Hard), wavelength_edges: vec![0.4, 0.5, 0.6] }),
        far_field(false),
        DetectorKind::RayDatabase(RayDatabase { width: 20.0, height: 30.0, max_rays: None }),
        apart(false),
        far_field(true),
        apart(true),
    ];
    assert!(kinds.iter().map(detector_position).eq(0..kinds.len()));
    kinds
}

/// Every splat; a new one fails to compile here.
pub fn splats() -> Vec<Splat> {
    let position = |splat: &Splat| match splat {
        Splat::Hard => 0,
        Splat::Bilinear => 1,
        Splat::Gaussian { .. } => 2,
    };
    let splats = vec![Splat::Hard, Splat::Bilinear, Splat::Gaussian { sigma: 0.7 }];
    assert!(splats.iter().map(position).eq(0..splats.len()));
    splats
}

/// Every interaction; a new one fails to compile here.
pub fn interactions() -> Vec<Interaction> {
    let position = |interaction: &Interaction| match interaction {
        Interaction::Absorbing => 0,
        Interaction::Reflective { .. } => 1,
        Interaction::Refractive => 2,
    };
    let interactions = vec![
        Interaction::Absorbing,
        Interaction::Reflective { reflectance: vec![0.5] },
        Interaction::Refractive,
    ];
    assert!(interactions.iter().map(position).eq(0..interactions.len()));
    interactions
}

fn policies() -> Vec<ReflectProb> {
    let position = |policy: &ReflectProb| match policy {
        ReflectProb::Fresnel => 0,
        ReflectProb::Auto => 1,
        ReflectProb::Constant(_) => 2,
    };
    let policies = vec![ReflectProb::Fresnel, ReflectProb::Auto, ReflectProb::Constant(0.3)];
    assert!(policies.iter().map(position).eq(0..policies.len()));
    policies
}

fn path_samplings() -> Vec<PathSampling> {
    let position = |paths: &PathSampling| match paths {
        PathSampling::None => 0,
        PathSampling::Hashed { .. } => 1,
        PathSampling::All => 2,
    };
    let samplings = vec![PathSampling::None, PathSampling::Hashed { threshold: 1 << 20 }, PathSampling::All];
    assert!(samplings.iter().map(position).eq(0..samplings.len()));
    samplings
}

fn samplers() -> Vec<Sampler> {
    let position = |sampler: &Sampler| match sampler {
        Sampler::Pcg => 0,
        Sampler::Sobol => 1,
    };
    let samplers = vec![Sampler::Pcg, Sampler::Sobol];
    assert!(samplers.iter().map(position).eq(0..samplers.len()));
    samplers
}

impl Choice {
    /// Every feature.
    pub fn all() -> Vec<Choice> {
        let mut overrides: Vec<Choice> = shapes().into_iter().map(Choice::Shape).collect();
        overrides.extend(sources().into_iter().map(Choice::Source));
        overrides.extend(
            (0..detectors().len()).flat_map(|i| [Choice::Detector(i), Choice::TransmissiveDetector(i)]),
        );
        overrides.extend(
            splats().into_iter().flat_map(|splat| [Choice::Splat(splat), Choice::SpectralSplat(splat)]),
        );
        overrides.extend(
            bsdfs().into_iter().flat_map(|kind| [Choice::Scattering(kind), Choice::TransmissiveLobe(kind)]),
        );
        overrides.extend(bsdfs().into_iter().filter(|kind| has_density(*kind)).map(Choice::ScattersTo));
        overrides.extend(policies().into_iter().map(Choice::Policy));
        overrides.extend(path_samplings().into_iter().map(Choice::Paths));
        overrides.extend(samplers().into_iter().map(Choice::Sampler));
        overrides.extend([
            Choice::Refractive,
            Choice::Reflective,
            Choice::ReflectiveBySpectrum,
            Choice::Absorbing,
            Choice::Aimed,
            Choice::Clipped,
            Choice::Tip,
            Choice::Coated,
            Choice::CoatedByAngle,
            Choice::CoatedBySpectrum,
            Choice::Split,
            Choice::Roulette,
            Choice::Polychromatic,
            Choice::AbsorbingMedium,
            Choice::Queue,
            Choice::QueuedMesh,
            Choice::QueuedContact,
            Choice::QueuedFacets,
            Choice::Tree { texel_bytes: 0 },
            Choice::Tree { texel_bytes: 1 << 24 },
            Choice::UniformTables,
            Choice::Rotated,
            Choice::Moments,
            Choice::HostSums,
            Choice::HotPath { absorbs: false },
            Choice::HotPath { absorbs: true },
            Choice::HotPathThroughDetector,
            Choice::HotPathThroughGlass,
            Choice::Replicates,
            Choice::SumsInParts,
            Choice::PathFilter,
        ]);
        overrides.extend(path_sums().map(Choice::PathSums));
        overrides
    }

    /// Brings the feature into a variant. Choices add up in any order.
    pub fn apply(self, variant: &mut Variant) {
        let ir = &mut variant.ir;
        match self {
            Choice::Shape(kind) => {
                if kind == ShapeKind::Mesh && ir.meshes.is_empty() {
                    ir.meshes.push(tetrahedron());
                }
                ir.surfaces.push(surface(shape_of(kind), Interaction::Absorbing));
            }
            Choice::Source(name) => ir.sources.push(source(source_of(name), ir.wavelengths.len())),
            Choice::Detector(i) => ir.detectors.push(detector(detectors()[i].clone(), true)),
            Choice::TransmissiveDetector(i) => ir.detectors.push(detector(detectors()[i].clone(), false)),
            Choice::Splat(splat) => ir.detectors.push(detector(DetectorKind::Irradiance(grid(splat)), true)),
            Choice::SpectralSplat(splat) => {
                let kind =
                    DetectorKind::Spectral(Spectral { grid: grid(splat), wavelength_edges: vec![0.4, 0.6] });
                ir.detectors.push(detector(kind, true));
            }
            Choice::Refractive => ir.surfaces.push(surface(ball(), Interaction::Refractive)),
            Choice::Reflective => ir.surfaces.push(surface(ball(), mirror(0.9, 0.9, ir.wavelengths.len()))),
            Choice::ReflectiveBySpectrum => {
                polychromatic(ir);
                ir.surfaces.push(surface(ball(), mirror(0.9, 0.5, ir.wavelengths.len())));
            }
            Choice::Absorbing => ir.surfaces.push(surface(ball(), Interaction::Absorbing)),
            Choice::Aimed => {
                polychromatic(ir);
                let rows = vec![vec![0.0, 0.25], vec![0.125]];
                let aim =
                    Aim { wavelength: 0.55, x: rows.clone(), y: vec![], vector_x: rows, vector_y: vec![] };
                let pupil = Pupil {
                    beam_radii: [1.0, 2.0],
                    chief: [0.1, 0.2, 1.0],
                    pupil_radii: [0.3, 0.1],
                    aimed: [aim].into(),
                };
                ir.sources.push(source(SourceKind::Pupil(pupil), ir.wavelengths.len()));
            }
            Choice::Clipped => {
                let profile = AsphereProfile::new(50.0, -0.5, 10.0, 2, &[1e-4, 2e-6]);
                let clipped = SagSurface::new(profile, Some(aperture()));
                ir.surfaces.push(surface(Shape::EvenAsphere(clipped), Interaction::Refractive));
            }
            Choice::Tip => {
                let cone = Shape::Frustum(Frustum { r_front: 5.0, r_back: 0.0, z_front: -1.0, z_back: 2.0 });
                ir.surfaces.push(surface(cone, Interaction::Refractive));
            }
            Choice::Coated => ir.surfaces.push(coated(0.9, 0.9, ir.wavelengths.len())),
            Choice::CoatedByAngle => {
                let num_wavelengths = ir.wavelengths.len();
                let coating = Some(coating_by_angle(num_wavelengths));
                ir.surfaces
                    .push(Surface { coating: coating.clone(), ..surface(ball(), Interaction::Refractive) });
                let mirror = surface(ball(), mirror(1.0, 1.0, num_wavelengths));
                ir.surfaces.push(Surface { coating, ..mirror });
            }
            Choice::CoatedBySpectrum => {
                polychromatic(ir);
                ir.surfaces.push(coated(0.9, 0.5, ir.wavelengths.len()));
            }
            Choice::Scattering(kind) => {
                let mirror = surface(ball(), mirror(0.9, 0.9, ir.wavelengths.len()));
                ir.surfaces.push(scattering(mirror, bsdf_of(kind, 0.0)));
            }
            Choice::TransmissiveLobe(kind) => {
                let lens = surface(ball(), Interaction::Refractive);
                ir.surfaces.push(scattering(lens, bsdf_of(kind, 0.25)));
            }
            Choice::ScattersTo(kind) => {
                Choice::TransmissiveLobe(kind).apply(variant);
                let ir = &mut variant.ir;
                ir.scatter_sampling = vec![ScatterSampling::default(); ir.surfaces.len()];
                if let Some(sampling) = ir.scatter_sampling.last_mut() {
                    sampling.prob = Some(0.75);
                    sampling.targets = targets();
                }
            }
            Choice::Policy(policy) => {
                ir.surfaces.push(surface(ball(), Interaction::Refractive));
                ir.sampling.reflect_prob = policy;
            }
            Choice::Split => {
                ir.surfaces.push(surface(ball(), Interaction::Refractive));
                ir.sampling = Sampling { split_depth: 5, split_budget: 2.5, ..ir.sampling };
            }
            Choice::Roulette => variant.roulette_threshold = 1.5,
            Choice::Polychromatic => polychromatic(ir),
            Choice::AbsorbingMedium => ir.media[1].k.fill(1e-6),
            Choice::Paths(paths) => variant.paths = paths,
            Choice::Queue => variant.queue = true,
            Choice::QueuedMesh => {
                variant.queue = true;
                Choice::Shape(ShapeKind::Mesh).apply(variant);
            }
            // Two balls, or two meshes, in one place.
            Choice::QueuedContact => {
                variant.queue = true;
                ir.surfaces.extend([(); 2].map(|()| surface(ball(), Interaction::Refractive)));
            }
            Choice::QueuedFacets => {
                variant.queue = true;
                Choice::Shape(ShapeKind::Mesh).apply(variant);
                Choice::Shape(ShapeKind::Mesh).apply(variant);
            }
            Choice::HostSums => variant.deferred_splats = true,
            Choice::HotPath { absorbs } => {
                variant.deferred_splats = true;
                ir.surfaces.push(surface(ball(), Interaction::Refractive));
                ir.detectors.push(detector(DetectorKind::Irradiance(grid(Splat::Hard)), true));
                if absorbs {
                    ir.media[1].k.fill(1e-6);
                }
                // Numbers of primitives shift as others come: the last detector is then some other, or a surface.
                let primitives = vec![ir.surfaces.len() - 1, ir.surfaces.len() + ir.detectors.len() - 1];
                // A profiled ray that stays far from everything, so that the others are clear of all of it.
                let away = |z| DVec3::new(1e3, 1e3, 1e3 + z);
                let way =
                    SampledPath { positions: [0.0, 1.0, 2.0].map(away).to_vec(), weights: vec![1.0; 3] };
                variant.hot_path =
                    Some(ProfiledPath { primitives, samples: vec![way], escapes: false, share: 0.5 });
            }
            // Another path takes its place, and then there is the detector alone. In a trace of 16 events it is full, and
            // arrives at some places again.
            Choice::HotPathThroughDetector => {
                variant.deferred_splats = true;
                ir.detectors.push(detector(DetectorKind::Irradiance(grid(Splat::Bilinear)), false));
                let primitives = vec![ir.surfaces.len() + ir.detectors.len() - 1; 16];
                let away = |z| DVec3::new(1e3, 1e3, 1e3 + f64::from(z % 5));
                let mut weights = vec![0.5; 17];
                weights[0] = 1.0;
                let way = SampledPath { positions: (0..17).map(away).collect(), weights };
                variant.hot_path.get_or_insert(ProfiledPath {
                    primitives,
                    samples: vec![way],
                    escapes: false,
                    share: 0.5,
                });
            }
            // A path whose rays log what they weigh; another one takes its place.
            Choice::HotPathThroughGlass => {
                variant.deferred_splats = true;
                ir.surfaces.push(surface(ball(), Interaction::Refractive));
                ir.detectors.push(detector(DetectorKind::Irradiance(grid(Splat::Bilinear)), true));
                ir.media[1].k.fill(1e-6);
                let primitives = vec![ir.surfaces.len() - 1, ir.surfaces.len() + ir.detectors.len() - 1];
                let way = |weight: f64| {
                    let away = |z| DVec3::new(1e3, 1e3, 1e3 + z);
                    SampledPath {
                        positions: [0.0, 1.0, 2.0].map(away).to_vec(),
                        weights: vec![1.0, 1.0, weight],
                    }
                };
                let hot_path = ProfiledPath {
                    primitives,
                    samples: vec![way(0.5), way(0.75)],
                    escapes: false,
                    share: 0.5,
                };
                // One side trace misses the detector, the other one meets the ball again.
                let escaping = |primitives| ProfiledPath {
                    primitives,
                    samples: hot_path.samples.clone(),
                    escapes: true,
                    share: 0.1,
                };
                let ball = ir.surfaces.len() - 1;
                variant.side_traces = vec![escaping(vec![ball]), escaping(vec![ball, ball])];
                variant.hot_path.get_or_insert(hot_path);
            }
            // So many cells that those of all other choices add few parts.
            Choice::SumsInParts => {
                let wide = PixelGrid { num_pixels_x: 64, num_pixels_y: 64, ..grid(Splat::Hard) };
                ir.detectors.push(detector(DetectorKind::Irradiance(wide), true));
                variant.part_bytes = 1 << 13;
            }
            Choice::PathSums(sums) => variant.path_sums = sums,
            Choice::PathFilter => variant.path_filter = Some(Arc::new(path_filter())),
            // Replicates take the place of squares.
            Choice::Moments if variant.moments == SecondMoments::Replicates => {}
            Choice::Moments => variant.moments = SecondMoments::Squares,
            Choice::Replicates => {
                variant.sampler = Sampler::Sobol;
                variant.moments = SecondMoments::Replicates;
            }
            Choice::UniformTables => variant.uniform_bytes = 1 << 16,
            Choice::Tree { texel_bytes } => {
                variant.tree = true;
                variant.texel_bytes = texel_bytes;
                ir.surfaces.extend([(); 2].map(|()| surface(ball(), Interaction::Absorbing)));
            }
            Choice::Rotated => rotate(ir),
            // What is there anyway.
            Choice::Sampler(Sampler::Pcg) => {}
            Choice::Sampler(Sampler::Sobol) => variant.sampler = Sampler::Sobol,
        }
    }
}

impl Default for Variant {
    /// A lamp in the void: no surface, no detector.
    fn default() -> Self {
        let medium =
            |name: &str, n| Medium { name: name.into(), ambient: name == "vacuum", n: vec![n], k: vec![0.0] };
        let ir = SceneIr {
            wavelengths: vec![0.45],
            media: vec![medium("vacuum", 1.0), medium("glass", 1.5)],
            surfaces: vec![],
            meshes: vec![],
            sources: vec![source(SourceKind::Point(Point { half_angle: 0.5 }), 1)],
            detectors: vec![],
            sampling: Sampling { rr_start_flux: 0.0, ..Sampling::default() },
            scatter_sampling: Vec::new(),
            allowed: Default::default(),
        };
        Variant {
            ir,
            paths: PathSampling::None,
            path_sums: PathSums::None,
            path_filter: None,
            guided: false,
            queue: false,
            tree: false,
            uniform_bytes: 0,
            texel_bytes: 0,
            roulette_threshold: 0.0,
            sampler: Sampler::Pcg,
            deferred_splats: false,
            hot_path: None,
            side_traces: Vec::new(),
            part_bytes: 1 << 27,
            derivatives: None,
            moments: SecondMoments::None,
        }
    }
}

impl Variant {
    /// The variant of one choice, and its name.
    pub fn of_choice(choice: Choice) -> (String, Variant) {
        let mut variant = Variant::default();
        choice.apply(&mut variant);
        (format!("{choice:?}"), variant)
    }

    fn wanted(&self) -> CpuRequest {
        CpuRequest {
            deferred_splats: self.deferred_splats,
            side_by_side: true,
            hot_path: self.hot_path.clone(),
            side_traces: self.side_traces.clone(),
        }
    }

    /// The composed program.
    pub fn program(&self, tier: Tier) -> Program {
        self.program_with(tier, &self.wanted())
    }

    /// Its text, which is composed and not parsed.
    pub fn text(&self, tier: Tier) -> String {
        let mut text = None;
        let keep = |wgsl, _, _: &_| {
            text = Some(wgsl);
            Err(Error::Interrupted)
        };
        let stopped = self.parsed_by(tier, &self.wanted(), keep).err();
        text.unwrap_or_else(|| panic!("{self:?}: {stopped:?}"))
    }

    /// The program with one more addition than those of the variant.
    pub fn program_with(&self, tier: Tier, addition: &dyn ProgramAddition) -> Program {
        let parse = |wgsl, precision, additions: &_| Parsed::of(wgsl, precision, additions).map(Arc::new);
        self.parsed_by(tier, addition, parse).unwrap_or_else(|error| panic!("{self:?}: {error}"))
    }

    fn parsed_by(
        &self,
        tier: Tier,
        addition: &dyn ProgramAddition,
        parse: impl FnOnce(String, Precision, &ShaderAdditions) -> Result<Arc<Parsed>>,
    ) -> Result<Program> {
        let follows = self.path_sums != PathSums::None || self.path_filter.is_some();
        let followed = || FollowedPaths::new(self.path_sums, self.path_filter.clone()).guided(self.guided);
        let paths = (follows || self.guided).then(followed);
        let paths = paths.iter().map(|paths| paths as &dyn ProgramAddition);
        let guide = self.guided.then(|| Arc::new(Guide::plain(&self.ir)));
        let asked = TraceOptions { guide, path_filter: self.path_filter.clone(), ..TraceOptions::default() };
        let guided = Guided::of(&asked);
        let paths = paths.chain(guided.iter().map(|guided| guided as &dyn ProgramAddition));
        let derivatives = self.derivatives.iter().map(|derivatives| derivatives as &dyn ProgramAddition);
        let additions: Vec<&dyn ProgramAddition> = paths.chain(derivatives).chain([addition]).collect();
        let options = ProgramOptions {
            precision: tier.precision,
            native: tier.native,
            baked: tier.baked,
            tree: self.tree,
            uniform_bytes: self.uniform_bytes,
            texel_bytes: self.texel_bytes,
            max_depth: 16,
            roulette_threshold: self.roulette_threshold,
            events_per_dispatch: if self.queue { 4 } else { 16 },
            workgroup_size: 64,
            paths: self.paths,
            weights: (0..self.ir.sources.len()).map(|i| 1.0 + 0.25 * i as f64).collect(),
            sampler: self.sampler,
            moments: self.moments,
            most_rays_per_invocation: if self.deferred_splats { 8 } else { 1 },
            vector_lanes: 0,
            part_bytes: self.part_bytes,
            live: self.derivatives.is_some(),
            copies_numbers: false,
            fixed_rays_per_invocation: None,
            has_long_loops: false,
            counts_wrong_sides: true,
        };
        Program::parsed_by(&self.ir, options, &additions, 0, parse)
    }
}

/// Every choice at once, but splitting, which follows rays to their end and so leaves no queue, and replicates, which take
/// the place of second moments.
pub fn everything() -> Variant {
    let mut variant = Variant::default();
    // Last, what the others build on: rotation turns what is there.
    let is_other = |choice: &Choice| {
        !matches!(choice, Choice::Split | Choice::Replicates | Choice::PathSums(_) | Choice::PathFilter)
    };
    let others = Choice::all().into_iter().filter(is_other);
    others.for_each(|choice| choice.apply(&mut variant));
    variant
}

/// The same with no tree in an image, and so every primitive in a table.
pub fn everything_in_buffers() -> Variant {
    Variant { texel_bytes: 0, ..everything() }
}

/// Every choice at once.
pub fn everything_split() -> Variant {
    let mut variant = everything();
    Choice::Split.apply(&mut variant);
    variant
}

/// Every choice that the plain loop has, with each way to sum up light by its path, and a filter.
pub fn everything_with_paths() -> Vec<Variant> {
    let with = |path_sums, split: bool| {
        let mut variant =
            Variant { deferred_splats: false, hot_path: None, side_traces: Vec::new(), ..everything() };
        variant.path_sums = path_sums;
        variant.path_filter = Some(Arc::new(path_filter()));
        if split {
            Choice::Split.apply(&mut variant);
        }
        variant
    };
    path_sums().flat_map(|sums| [with(sums, false), with(sums, true)]).chain(guided(with)).collect()
}

/// Guided rays, with a filter and without.
fn guided(with: impl Fn(PathSums, bool) -> Variant) -> [Variant; 2] {
    let mut filtered = with(PathSums::None, false);
    filtered.guided = true;
    filtered.ir.sampling.reflect_prob = ReflectProb::Fresnel;
    let alone = Variant { path_filter: None, ..filtered.clone() };
    [filtered, alone]
}

/// Every choice that has derivatives, with those of some parameters and with those of a loss, and each policy of reflection.
pub fn everything_with_derivatives() -> Vec<Variant> {
    let has_derivatives = |choice: &Choice| match choice {
        Choice::Shape(kind) => *kind != ShapeKind::Mesh,
        Choice::Source(_)
        | Choice::Detector(_)
        | Choice::TransmissiveDetector(_)
        | Choice::Splat(_)
        | Choice::SpectralSplat(_)
        | Choice::Scattering(_)
        | Choice::TransmissiveLobe(_)
        | Choice::Policy(_) => true,
        Choice::Refractive
        | Choice::Reflective
        | Choice::ReflectiveBySpectrum
        | Choice::Absorbing
        | Choice::Clipped
        | Choice::Coated
        | Choice::CoatedByAngle
        | Choice::CoatedBySpectrum
        | Choice::Roulette
        | Choice::AbsorbingMedium
        | Choice::Rotated => true,
        _ => false,
    };
    let mut variant = Variant::default();
    Choice::all().into_iter().filter(has_derivatives).for_each(|choice| choice.apply(&mut variant));
    let with = |policy| {
        let mut variant = variant.clone();
        variant.ir.sampling.reflect_prob = policy;
        let parameter = |name: &str| Parameter { name: name.into(), stencil: Vec::new() };
        let tangents = Tangents { parameters: ["a", "b", "c"].map(parameter).to_vec() };
        [Derivatives::Tangents(Arc::new(tangents)), Derivatives::Adjoints]
            .map(|derivatives| Variant { derivatives: Some(derivatives), ..variant.clone() })
    };
    policies().into_iter().flat_map(with).collect()
}

fn path_sums() -> impl Iterator<Item = PathSums> {
    let totals = PathSums::Totals { rows: 1 << 18, ends: true };
    [PathSums::None, totals, PathSums::Maps(3), PathSums::Events { ends: true }].into_iter()
}

/// A filter that asks for all that filters can ask for.
fn path_filter() -> PathFilter {
    let events = |kinds: &[StepKind]| Events { kinds: kinds.to_vec(), surfaces: vec![0, 1, 3] };
    let compare = |count, comparison| Term::Compare(count, comparison, 2);
    let marked = (0..4).map(Term::Marked);
    let counted =
        Count::ALL.into_iter().zip(Relation::ALL).map(|((_, count), (_, sign))| compare(count, sign));
    let whole = Term::Any(marked.chain(counted).collect());
    PathFilter {
        text: "all that filters ask for".into(),
        root: Term::All(vec![Term::Not(Box::new(whole)), Term::Matches(0), Term::Matches(1)]),
        marks: vec![
            Mark::Source(vec![0]),
            Mark::Some(events(&[StepKind::Reflected])),
            Mark::First(events(&StepKind::ALL)),
            Mark::Last(events(&[StepKind::ScatteredBack, StepKind::ScatteredThrough])),
        ],
        patterns: vec![
            Pattern(vec![Part::Source(vec![0, 2]), Part::Anything, Part::Detector(vec![0])]),
            Pattern(vec![Part::Anything, Part::Step(events(&[StepKind::Transmitted])), Part::Anything]),
        ],
    }
}

/// A shape that its function draws.
pub fn shape_of(kind: ShapeKind) -> Shape {
    let shape = match kind {
        ShapeKind::Conic => Shape::Conic(Conic { curvature: 0.02, conic: -0.5, aperture_radius: 10.0 }),
        ShapeKind::Plane => Shape::Plane(Outline::Infinite),
        ShapeKind::Rectangle => Shape::Plane(Outline::Rectangle { width: 10.0, height: 20.0 }),
        ShapeKind::Disk => Shape::Plane(Outline::Disk { radius: 10.0 }),
        ShapeKind::Annulus => {
            Shape::Annulus(Annulus { inner_radius: 5.0, outer_radius: 10.0, z_offset: 0.5 })
        }
        ShapeKind::Frustum => {
            Shape::Frustum(Frustum { r_front: 5.0, r_back: 8.0, z_front: -1.0, z_back: 2.0 })
        }
        ShapeKind::Sphere => Shape::Sphere(Sphere { radius: 8.0, aperture_radius: Some(6.0) }),
        ShapeKind::Mesh => Shape::Mesh(MeshId(0)),
        ShapeKind::EvenAsphere => {
            Shape::EvenAsphere(AsphereProfile::new(50.0, -0.5, 10.0, 2, &[1e-4, 2e-6]).into())
        }
        ShapeKind::OddAsphere => {
            Shape::OddAsphere(AsphereProfile::new(50.0, -0.5, 10.0, 1, &[1e-3, 1e-4, 2e-6]).into())
        }
        ShapeKind::Biconic => Shape::Biconic(
            Biconic {
                curvature: DVec2::new(0.02, -0.01),
                conic: DVec2::new(-0.5, 0.25),
                aperture_radius: 10.0,
            }
            .into(),
        ),
        ShapeKind::Toroidal => Shape::Toroidal(
            Toroidal { curvature_x: 0.015, profile: AsphereProfile::new(50.0, -0.5, 10.0, 2, &[1e-4, 2e-6]) }
                .into(),
        ),
        ShapeKind::Freeform => {
            let value = |p: DVec2| 1e-3 * p.x * p.x - 2e-4 * p.x * p.y + 1e-5 * p.y.powi(3);
            let polynomial = Polynomial { powers: [2, 3], order: 3, value: &value, definition: vec![] };
            Shape::Polynomial(Freeform::new(50.0, -0.5, 10.0, &polynomial).into())
        }
        ShapeKind::ClippedConic => {
            let conic = Conic { curvature: 0.02, conic: -0.5, aperture_radius: 10.0 };
            Shape::ClippedConic(ClippedConic::new(conic, aperture()))
        }
    };
    assert_eq!(ShapeKind::of(&shape), kind);
    shape
}

/// An aperture of all that apertures are made of.
fn aperture() -> Aperture {
    let axes = Axes { middle: DVec2::new(1.0, 2.0), semi_axes: DVec2::new(5.0, 6.0) };
    let part = |outline| Aperture { outline, inverted: false };
    let both = |one, other| Box::new([part(one), part(other)]);
    let triangle = ApertureOutline::Polygon(vec![DVec2::ZERO, DVec2::X, DVec2::Y]);
    let hole =
        ApertureOutline::Difference(both(ApertureOutline::Rectangle(axes), ApertureOutline::Ellipse(axes)));
    let outline = ApertureOutline::Union(both(triangle.clone(), hole));
    Aperture { outline: ApertureOutline::Intersection(both(outline, triangle)), inverted: true }
}

fn tetrahedron() -> Mesh {
    let vertices = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
    Mesh { vertices, faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]] }
}

/// Rays that are uploaded, all of them the same.
#[derive(Debug)]
struct Streamed;

impl RayStream for Streamed {
    fn rays(&self, _: u64, ids: &[u64], _: &dyn Fn(u64) -> u64) -> nsq_gpu::Result<Vec<StreamedRay>> {
        let ray = StreamedRay { wavelength: None, position: [0.5, 0.0, 1.0], direction: [0.0, 0.0, 1.0] };
        Ok(vec![ray; ids.len()])
    }

    fn order(&self) -> Order {
        Order::Drawn
    }
}

/// A source that its function emits.
pub fn source_of(name: SourceFunction) -> SourceKind {
    let rectangle = Outline::Rectangle { width: 3.0, height: 4.0 };
    let kind = match name {
        SourceFunction::Point => SourceKind::Point(Point { half_angle: 0.5 }),
        SourceFunction::CollimatedTophat => {
            SourceKind::Collimated(Collimated { aperture_radius: 2.0, sigma: None })
        }
        SourceFunction::CollimatedGaussian => {
            SourceKind::Collimated(Collimated { aperture_radius: 2.0, sigma: Some(1.0) })
        }
        SourceFunction::ExtendedRectangle => {
            SourceKind::Extended(Extended { area: rectangle, half_angle: 0.5 })
        }
        SourceFunction::ExtendedDisk => {
            SourceKind::Extended(Extended { area: Outline::Disk { radius: 2.0 }, half_angle: 2.0 })
        }
        SourceFunction::Tabulated => {
            let row = vec![1.0, 0.0];
            let table = PolarTable {
                polar: vec![0.0, 0.5],
                azimuth: vec![0.0, std::f64::consts::TAU],
                rows: vec![row.clone(), row],
            };
            SourceKind::Tabulated(sources::Tabulated { area: rectangle, table: Arc::new(table) })
        }
        SourceFunction::Rays => {
            let group = RayGroup {
                wavelength: None,
                positions: vec![[0.5, 0.0, 1.0], [0.0; 3]],
                directions: vec![[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]],
                shares: vec![0.5, 0.25],
            };
            let set = FileRays::held("0".into(), 1.0, vec![group]);
            SourceKind::Rays(sources::Rays { set: set.into() })
        }
        SourceFunction::StreamedRays => {
            let set = FileRays::streamed("1".into(), 1.0, Arc::new(Streamed), Bounds::default());
            SourceKind::Rays(sources::Rays { set: set.into() })
        }
        SourceFunction::Pupil => SourceKind::Pupil(Pupil {
            beam_radii: [1.0, 2.0],
            chief: [0.1, 0.2, 1.0],
            pupil_radii: [0.3, 0.1],
            aimed: [].into(),
        }),
    };
    assert_eq!(SourceFunction::of(&kind), name);
    kind
}

fn ball() -> Shape {
    Shape::Sphere(Sphere { radius: 3.0, aperture_radius: None })
}

fn grid(splat: Splat) -> PixelGrid {
    PixelGrid { width: 20.0, height: 30.0, num_pixels_x: 5, num_pixels_y: 7, splat }
}

fn frame(z: f64) -> Frame {
    Frame { origin: DVec3::new(0.5, -0.25, z), rotation: DMat3::IDENTITY }
}

fn surface(shape: Shape, interaction: Interaction) -> Surface {
    Surface {
        name: "surface".into(),
        frame: frame(20.0),
        shape,
        interaction,
        coating: None,
        scatter: None,
        front: 0,
        back: 1,
    }
}

/// True if directions that it draws have a density, so that some may go towards a target.
fn has_density(kind: BsdfKind) -> bool {
    !kind.wgsl().toward.is_empty()
}

/// A target of each shape.
fn targets() -> Vec<Target> {
    let center = [0.5, 1.0, -20.0];
    let sides = [[2.0, 0.0, 0.0], [0.0, 3.0, 0.0]];
    let shapes = [
        TargetShape::Cone { axis: [0.0, 0.0, 1.0], half_angle: 0.25 },
        TargetShape::Sphere { center, radius: 2.0 },
        TargetShape::Rectangle { center, half_sides: sides },
        TargetShape::Disk { center, radii: sides },
    ];
    shapes.map(|shape| Target { share: 0.125, shape }).into()
}

/// A scatter model that its function samples.
pub fn bsdf_of(kind: BsdfKind, transmissive_fraction: f64) -> Bsdf {
    let bsdf = match kind {
        BsdfKind::Specular => Bsdf::Specular(Specular {}),
        BsdfKind::Lambertian => {
            Bsdf::Lambertian(Lambertian { reflectance_value: 0.75, transmissive_fraction })
        }
        BsdfKind::HarveyShack => {
            Bsdf::HarveyShack(HarveyShack { b0: 0.5, l0: 0.125, s: 2.0, transmissive_fraction })
        }
        BsdfKind::Tabulated => Bsdf::Tabulated(Tabulated {
            table: BsdfTable {
                theta_i: vec![0.0, 45.0, 90.0],
                theta_s: vec![0.0, 90.0],
                values: vec![0.125, 0.0, 0.25, 0.0, 0.25, 0.125],
            },
            transmissive_fraction,
        }),
        BsdfKind::Measured => {
            let values = PolarTable {
                polar: vec![0.0, 0.5],
                azimuth: vec![0.0, std::f64::consts::PI, std::f64::consts::TAU],
                rows: vec![vec![0.5, 0.25], vec![0.25, 0.125], vec![0.5, 0.25]],
            };
            let row = |incidence_deg| MeasuredRow {
                incidence_deg,
                values: values.clone(),
                scattered: 0.25,
                measured: 0.25,
            };
            let transmits = transmissive_fraction > 0.0;
            let table = MeasuredTable { transmits, rows: vec![row(0.0), row(60.0)] };
            Bsdf::Measured(Measured { table: table.into(), level: 1.0 })
        }
        BsdfKind::KCorrelation => {
            Bsdf::KCorrelation(KCorrelation { b0: 0.5, b: 8.0, s: 3.0, transmissive_fraction })
        }
    };
    assert_eq!(bsdf.kind(), kind);
    bsdf
}

fn scattering(surface: Surface, bsdf: Bsdf) -> Surface {
    Surface { scatter: Some(Scatter { fraction: 0.5, bsdf }), ..surface }
}

fn coated(first: f64, others: f64, num_wavelengths: usize) -> Surface {
    let mut transmittance = vec![others; num_wavelengths];
    transmittance[0] = first;
    let coating = SimpleCoating { reflectance: vec![0.0625; num_wavelengths], transmittance };
    Surface { coating: Some(Coating::Simple(coating)), ..surface(ball(), Interaction::Refractive) }
}

fn detector(kind: DetectorKind, absorb: bool) -> Detector {
    Detector { name: "detector".into(), frame: frame(40.0), kind, absorb }
}

fn source(kind: SourceKind, num_wavelengths: usize) -> Source {
    let cdf = (1..=num_wavelengths).map(|i| i as f64 / num_wavelengths as f64).collect();
    Source {
        name: "lamp".into(),
        frame: frame(0.0),
        kind,
        total_flux: 1.0,
        spectrum: Spectrum { wavelengths: (0..num_wavelengths).collect(), cdf },
        medium: SceneIr::VACUUM,
    }
}

fn mirror(first: f64, others: f64, num_wavelengths: usize) -> Interaction {
    let mut reflectance = vec![others; num_wavelengths];
    reflectance[0] = first;
    Interaction::Reflective { reflectance }
}

/// Two wavelengths, if there is one.
fn polychromatic(ir: &mut SceneIr) {
    if ir.wavelengths.len() > 1 {
        return;
    }
    ir.wavelengths.push(0.55);
    for medium in &mut ir.media {
        medium.n.push(medium.n[0]);
        medium.k.push(medium.k[0]);
    }
    for surface in &mut ir.surfaces {
        if let Interaction::Reflective { reflectance } = &mut surface.interaction {
            reflectance.push(reflectance[0]);
        }
        match &mut surface.coating {
            Some(Coating::Simple(SimpleCoating { reflectance, transmittance })) => {
                reflectance.push(reflectance[0]);
                transmittance.push(transmittance[0]);
            }
            Some(Coating::Tabulated(table)) => table.rows.push(table.rows[0].clone()),
            None => {}
        }
    }
    for lamp in &mut ir.sources {
        lamp.spectrum = Spectrum { wavelengths: vec![0, 1], cdf: vec![0.5, 1.0] };
    }
}

/// A coating of three angles that absorbs, and differs from its two sides.
fn coating_by_angle(num_wavelengths: usize) -> Coating {
    let row = CoatingRow {
        reflectance: vec![1.0, 0.25, 0.125],
        transmittance: vec![0.0, 0.5, 0.75],
        reflectance_back: vec![1.0, 0.125, 0.0625],
        transmittance_back: vec![0.0, 0.5, 0.875],
    };
    let rows = vec![row; num_wavelengths];
    Coating::Tabulated(TabulatedCoating { cosines: vec![0.0, 0.5, 1.0], rows })
}

fn rotate(ir: &mut SceneIr) {
    let rotation = DMat3::from_rotation_x(0.25);
    ir.surfaces.push(surface(ball(), Interaction::Absorbing));
    ir.detectors.push(detector(DetectorKind::Irradiance(grid(Splat::Hard)), true));
    ir.surfaces.iter_mut().for_each(|surface| surface.frame.rotation = rotation);
    ir.detectors.iter_mut().for_each(|detector| detector.frame.rotation = rotation);
    ir.sources.iter_mut().for_each(|lamp| lamp.frame.rotation = rotation);
}
