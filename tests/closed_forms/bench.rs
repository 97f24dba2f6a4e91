//! An optical bench: scenes as JSON text, traced on a shared device in either precision.

use crate::zoo;
use glam::DVec3;
use nsq_gpu::gpu::{Gpu, list_adapters};
use nsq_gpu::program::Precision;
use nsq_gpu::result::{DetectorData, FarFieldPattern, IrradianceMap, RayPaths, RunInfo, SpectralMap};
use nsq_gpu::run::RecordPaths;
use nsq_gpu::{Scene, TraceOptions, TraceResult, Tracer};
use serde_json::{Map, Value, json};
use std::io::Write;
use std::sync::LazyLock;

/// The wavelength of scenes with one \[um\].
pub const WAVELENGTH: f64 = 0.5;

/// The seed of every trace.
pub const SEED: u64 = 20_260_101;

/// A precision on a shared device.
pub struct Tier {
    gpu: &'static Gpu,
    precision: Precision,
}

/// The precisions that this machine has; a loud line for what is skipped.
pub fn tiers(test: &str) -> Vec<Tier> {
    static IS_ANY: LazyLock<bool> = LazyLock::new(|| !list_adapters().is_empty());
    // Straight to the stream: the test runner hides what a passing test prints.
    let skip = |what: &str| {
        writeln!(std::io::stderr(), "SKIPPED: {test}: {what}").expect("standard error takes a line")
    };
    if !*IS_ANY {
        skip("no adapter");
        return Vec::new();
    }
    let gpu = zoo::gpu();
    if !gpu.f64 {
        skip("no 64-bit floats on this adapter");
        return vec![Tier { gpu, precision: Precision::F32 }];
    }
    zoo::in_turn([Precision::F64, Precision::F32]).map(|precision| Tier { gpu, precision }).collect()
}

impl Tier {
    /// The value for the precision at hand.
    pub fn pick<T>(&self, in_f64: T, in_f32: T) -> T {
        match self.precision {
            Precision::F64 | Precision::Df64 => in_f64,
            Precision::F32 => in_f32,
        }
    }

    /// The form's name with the precision.
    pub fn name(&self, form: &str) -> String {
        format!("{} {form}", self.pick("f64", "f32"))
    }
}

/// A scene in the making. Roulette is off unless asked for.
#[derive(Clone)]
pub struct Bench {
    sources: Vec<Value>,
    detectors: Vec<Value>,
    surfaces: Vec<Value>,
    media: Map<String, Value>,
    sampling: Map<String, Value>,
    origin: Value,
    max_depth: u32,
    paths: RecordPaths,
    baked: Option<bool>,
    seed: u64,
}

impl Bench {
    pub fn new() -> Self {
        let sampling = json!({ "rr_start_flux": 0.0 });
        Bench {
            sources: Vec::new(),
            detectors: Vec::new(),
            surfaces: Vec::new(),
            media: Map::new(),
            sampling: sampling.as_object().unwrap().clone(),
            origin: Value::Null,
            max_depth: 16,
            paths: RecordPaths::None,
            baked: None,
            seed: SEED,
        }
    }

    /// Everything that is placed from now on stands in this system.
    pub fn within(mut self, cs: Value) -> Self {
        self.origin = cs;
        self
    }

    pub fn max_depth(mut self, max_depth: u32) -> Self {
        self.max_depth = max_depth;
        self
    }

    /// The scene in tables instead of compiled in.
    pub fn in_tables(mut self) -> Self {
        self.baked = Some(false);
        self
    }

    pub fn record_paths(mut self) -> Self {
        self.paths = RecordPaths::All;
        self
    }

    /// The probability of drawing reflection: a word or a number.
    pub fn reflect_prob(mut self, policy: impl Into<Value>) -> Self {
        self.sampling.insert("reflect_prob".into(), policy.into());
        self
    }

    /// Rays of fewer events are split, with so many alive at a time of one that was launched.
    pub fn split(mut self, depth: u32, budget: f64) -> Self {
        self.sampling.insert("split_depth".into(), depth.into());
        self.sampling.insert("split_budget".into(), budget.into());
        self
    }

    /// Roulette below this fraction of the mean flux of a new ray.
    pub fn roulette_below(mut self, flux: f64) -> Self {
        self.sampling.insert("rr_start_flux".into(), flux.into());
        self
    }

    pub fn medium(mut self, name: &str, n: f64, k: f64) -> Self {
        self.media.insert(name.into(), json!({ "type": "constant", "n": n, "k": k }));
        self
    }

    pub fn dispersive_medium(mut self, name: &str, wavelengths: &[f64], n: &[f64]) -> Self {
        self.media.insert(name.into(), json!({ "type": "table", "wavelengths": wavelengths, "n": n }));
        self
    }

    fn place(&self, mut item: Value, cs: Value) -> Value {
        item["cs"] = cs;
        item["cs"]["reference_cs"] = self.origin.clone();
        item
    }

    /// A source of one watt, unless `more` says otherwise.
    pub fn source(mut self, kind: &str, cs: Value, more: Value) -> Self {
        let name = format!("source {}", self.sources.len());
        let spectrum = json!({ "wavelengths": [WAVELENGTH], "weights": [1.0] });
        let source = json!({ "type": kind, "name": name, "spectrum": spectrum, "total_flux": 1.0 });
        let source = self.place(merged(source, more), cs);
        self.sources.push(source);
        self
    }

    /// One ray, over and over: a point source of no half-angle.
    pub fn pencil(self, origin: DVec3, direction: DVec3, more: Value) -> Self {
        self.source("point", towards(origin, direction), merged(json!({ "half_angle_deg": 0.0 }), more))
    }

    /// A cone of rays, uniform in solid angle.
    pub fn cone(self, origin: DVec3, direction: DVec3, half_angle_deg: f64) -> Self {
        self.source("point", towards(origin, direction), json!({ "half_angle_deg": half_angle_deg }))
    }

    /// A uniform parallel beam.
    pub fn beam(self, origin: DVec3, direction: DVec3, radius: f64) -> Self {
        self.source("collimated", towards(origin, direction), json!({ "aperture_radius": radius }))
    }

    pub fn detector(mut self, kind: &str, name: &str, cs: Value, more: Value) -> Self {
        let detector = self.place(merged(json!({ "type": kind, "name": name }), more), cs);
        self.detectors.push(detector);
        self
    }

    /// Hard pixels over a square of this side.
    pub fn pixels(self, name: &str, cs: Value, side: f64, num: u32) -> Self {
        let grid = json!({ "width": side, "height": side, "num_pixels_x": num, "num_pixels_y": num, "splat": "hard" });
        self.detector("irradiance", name, cs, grid)
    }

    /// A ray database over a square of this side.
    pub fn database(self, name: &str, cs: Value, side: f64, absorb: bool) -> Self {
        self.detector("ray_database", name, cs, json!({ "width": side, "height": side, "absorb": absorb }))
    }

    fn surface(mut self, name: &str, cs: Value, shape: Value, interaction: Value) -> Self {
        let surface = self.place(merged(json!({ "name": name, "shape": shape }), interaction), cs);
        self.surfaces.push(surface);
        self
    }

    pub fn mirror(self, name: &str, cs: Value, shape: Value, reflectance: f64) -> Self {
        self.surface(name, cs, shape, json!({ "interaction": "reflective", "reflectance": reflectance }))
    }

    pub fn absorber(self, name: &str, cs: Value, shape: Value) -> Self {
        self.surface(name, cs, shape, json!({ "interaction": "absorbing" }))
    }

    /// A boundary from medium `front` to medium `back` along the geometric normal; "" is vacuum.
    pub fn boundary(self, name: &str, cs: Value, shape: Value, front: &str, back: &str) -> Self {
        let medium = |name: &str| match name {
            "" => Value::Null,
            _ => json!({ "type": "medium", "name": name }),
        };
        let media = json!({
            "interaction": "refractive", "material_front": medium(front), "material_back": medium(back),
        });
        self.surface(name, cs, shape, media)
    }

    /// A coat on nothing, which reflects and transmits so much of the light.
    pub fn coat(self, name: &str, cs: Value, reflectance: f64, transmittance: f64) -> Self {
        let coating = json!({ "type": "simple", "reflectance": reflectance, "transmittance": transmittance });
        self.surface(name, cs, disk(50.0), json!({ "interaction": "refractive", "coating": coating }))
    }

    /// A scene needs a detector: where the bench has none, two small ones out of every ray's way, which leave the
    /// scene's centre where it is.
    fn json(&self) -> String {
        if self.detectors.is_empty() {
            let unused = |bench: Bench, side: f64| {
                bench.pixels(&format!("unused {side}"), at(side * 170.0, side * 190.0, 0.0), 1e-6, 1)
            };
            return unused(unused(self.clone(), 1.0), -1.0).json();
        }
        json!({
            "nsq_schema_version": 1,
            "sources": self.sources,
            "detectors": self.detectors,
            "nsq_gpu": {
                "version": 1, "media": self.media, "surfaces": self.surfaces, "sampling": self.sampling,
            },
        })
        .to_string()
    }

    /// Traces the bench. The ledger closes, whatever the form.
    pub fn trace(&self, tier: &Tier, num_rays: u64) -> TraceResult {
        let ir = Scene::from_json(&self.json()).unwrap().lower().unwrap();
        let options = TraceOptions {
            num_rays,
            seed: self.seed,
            max_depth: self.max_depth,
            min_flux_fraction: 0.0,
            precision: tier.precision,
            paths: self.paths,
            baked: self.baked,
            ..Default::default()
        };
        let tally = Tracer::new(tier.gpu, &ir, &options).unwrap().trace(|_| true).unwrap();
        let run = RunInfo { num_rays, seed: self.seed, max_depth: self.max_depth, ..Default::default() };
        let result = TraceResult::new(&ir, &run, &tally).unwrap();
        assert!(result.ledger.closes(), "the ledger does not close: {:?}", result.ledger);
        assert_eq!(result.num_rays_total, num_rays);
        result
    }
}

fn merged(mut base: Value, more: Value) -> Value {
    if let (Some(base), Value::Object(more)) = (base.as_object_mut(), more) {
        base.extend(more);
    }
    base
}

/// A system at a point, rotated about x, then y, then z.
pub fn turned(origin: DVec3, rx: f64, ry: f64, rz: f64) -> Value {
    json!({ "x": origin.x, "y": origin.y, "z": origin.z, "rx": rx, "ry": ry, "rz": rz })
}

/// A system at a point.
pub fn at(x: f64, y: f64, z: f64) -> Value {
    turned(DVec3::new(x, y, z), 0.0, 0.0, 0.0)
}

/// A system at a point whose z axis has this direction: rx takes z to (0, -sin, cos), then ry turns it in xz.
pub fn towards(origin: DVec3, direction: DVec3) -> Value {
    let rx = (-direction.y).atan2(direction.x.hypot(direction.z));
    turned(origin, rx, direction.x.atan2(direction.z), 0.0)
}

/// A direction in the plane y = 0 at this angle from z.
pub fn tilted(angle: f64) -> DVec3 {
    DVec3::new(angle.sin(), 0.0, angle.cos())
}

pub fn plane() -> Value {
    json!({ "type": "plane" })
}

pub fn disk(radius: f64) -> Value {
    json!({ "type": "plane", "aperture_radius": radius })
}

pub fn conic(radius: f64, conic: f64, aperture_radius: f64) -> Value {
    json!({ "type": "conic", "radius": radius, "conic": conic, "aperture_radius": aperture_radius })
}

/// One row of a ray database.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    pub ray: u64,
    pub position: DVec3,
    pub direction: DVec3,
    pub flux: f64,
    pub wavelength: f64,
}

pub fn rows(result: &TraceResult, name: &str) -> Vec<Row> {
    let DetectorData::RayDatabase(database) = &result.detector(name).unwrap().data else {
        panic!("{name} is no ray database");
    };
    let database = database.columns().unwrap();
    let row = |i: usize| Row {
        ray: database.ray_id[i],
        position: DVec3::from_array([0, 1, 2].map(|axis: usize| database.position[axis][i])),
        direction: DVec3::from_array([0, 1, 2].map(|axis: usize| database.direction[axis][i])),
        flux: database.flux[i],
        wavelength: database.wavelength[i],
    };
    (0..database.flux.len()).map(row).collect()
}

pub fn irradiance<'a>(result: &'a TraceResult, name: &str) -> &'a IrradianceMap {
    match &result.detector(name).unwrap().data {
        DetectorData::Irradiance(map) => map,
        _ => panic!("{name} is no irradiance detector"),
    }
}

pub fn spectral<'a>(result: &'a TraceResult, name: &str) -> &'a SpectralMap {
    match &result.detector(name).unwrap().data {
        DetectorData::Spectral(map) => map,
        _ => panic!("{name} is no spectral detector"),
    }
}

pub fn far_field<'a>(result: &'a TraceResult, name: &str) -> &'a FarFieldPattern {
    match &result.detector(name).unwrap().data {
        DetectorData::FarField(pattern) => pattern,
        _ => panic!("{name} is no far-field detector"),
    }
}

pub fn hits(result: &TraceResult, name: &str) -> u64 {
    result.detector(name).unwrap().num_rays_hit
}

/// Rays that an absorbing surface took.
pub fn absorbed(result: &TraceResult, name: &str) -> u64 {
    result.surfaces.iter().find(|surface| surface.name == name).unwrap().num_rays_absorbed
}

/// Events of recorded paths whose kind and subject are these: position and direction before the event.
pub fn path_events(paths: &RayPaths, kind: &str, subject: &str) -> Vec<(DVec3, DVec3)> {
    let vector = |columns: &[ndarray::Array1<f64>; 3], i: usize| {
        DVec3::from_array([0, 1, 2].map(|axis: usize| columns[axis][i]))
    };
    let paths = paths.columns().unwrap();
    (0..paths.flux.len())
        .filter(|&i| {
            paths.event_type[i] == kind && (subject.is_empty() || paths.component_name[i] == subject)
        })
        .map(|i| (vector(&paths.position, i), vector(&paths.direction, i)))
        .collect()
}
