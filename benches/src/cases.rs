//! The cases to measure: scenes in the form of files that users trace, so that every peer reads the same files.

use nsq_gpu::gpu::Gpu;
use nsq_gpu::internals::{CpuOverrides, Override};
use nsq_gpu::program::Precision;
use nsq_gpu::run::{StandardError, TraceOptions};
use nsq_gpu::{Error, Result};
use serde_json::{Value, json};

/// One scene, and the number of rays to trace.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// Unique name.
    pub name: String,
    /// The sweep of which the case is one point: `rays`, `surfaces`, `depth`, `short`, `lenses`, `spheres`, `meshes`,
    /// `splats`, `commands`, `cold_start`.
    pub axis: &'static str,
    /// The scene file's text.
    pub scene: String,
    /// Rays to launch.
    pub num_rays: u64,
    /// Largest number of events of a ray.
    pub max_depth: u32,
    /// What is timed.
    pub kind: Kind,
}

/// Rays of a case that stands for long traces.
const LONG_TRACE: u64 = 10_000_000;

impl Case {
    /// How the case is traced, with defaults for all else.
    pub fn options(&self, precision: Precision) -> TraceOptions {
        let (num_rays, max_depth) = (self.num_rays, self.max_depth);
        TraceOptions { num_rays, max_depth, precision, ..TraceOptions::default() }
    }

    /// The same without standard errors, cut as suits an adapter: for parts of a trace that are held against each other.
    pub fn options_without_errors(&self, precision: Precision, gpu: &Gpu) -> TraceOptions {
        TraceOptions { standard_error: StandardError::Off, ..self.options(precision) }.tuned(&gpu.info)
    }

    /// True if the case stands for a long trace.
    pub fn is_long(&self) -> bool {
        self.num_rays >= LONG_TRACE
    }
}

/// What an adapter that is a processor does in the midst of a long trace, if the trace is one.
pub fn in_midst(is_long: bool) -> CpuOverrides {
    let side_traces = if is_long { Override::Always } else { Override::Automatic };
    CpuOverrides { side_traces, ..CpuOverrides::default() }
}

/// What is timed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The trace alone, in a process that has read the scene and is warm.
    Trace,
    /// A whole command, from its start to its files.
    Command,
    /// A whole command, with the driver's cache of compiled shaders off.
    ColdCommand,
}

impl Kind {
    /// The name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Trace => "trace",
            Kind::Command => "command",
            Kind::ColdCommand => "cold_command",
        }
    }
}

/// The largest number of events: the default of Optiland and of `nsq-gpu trace`.
const MAX_DEPTH: u32 = 16;
/// The sweep over rays, through the scene of Optiland's ray sweep. A Dr.Jit kernel traces the scene, too.
pub const LENS_AXIS: &str = "rays";

/// Every case, with at most `max_rays` rays each. Points of the sweep over rays beyond that are left out.
pub fn all(max_rays: u64) -> Vec<Case> {
    let mut cases = rays_sweep(max_rays);
    cases.extend(surfaces_sweep());
    cases.extend(depth_sweep());
    cases.extend(short());
    cases.extend((0..10).map(|i| long(trace(&format!("lens_{i}"), "lenses", random_lens(i)))));
    for (axis, name, scene) in
        [("spheres", "spheres_100", spheres_scene(100)), ("meshes", "mesh_100k", torus_scene(224))]
    {
        cases.push(long(trace(name, axis, scene.clone())));
        cases.push(trace(&format!("{name}_short"), axis, scene));
    }
    cases.push(trace("flat", "splats", beam_scene(25.0)));
    cases.push(trace("spot", "splats", beam_scene(2500.0)));
    cases.extend(commands());
    cases.iter_mut().for_each(|case| case.num_rays = case.num_rays.min(max_rays));
    cases
}

fn trace(name: &str, axis: &'static str, scene: String) -> Case {
    Case { name: name.into(), axis, scene, num_rays: 1_000_000, max_depth: MAX_DEPTH, kind: Kind::Trace }
}

/// The case with many rays. On processors the hot path then has a stage of its own.
fn long(case: Case) -> Case {
    Case { num_rays: 10_000_000, ..case }
}

fn rays_sweep(max_rays: u64) -> Vec<Case> {
    let powers = (3..=7).filter(|&power| power == 3 || 10_u64.pow(power) <= max_rays);
    let case = |power| Case {
        num_rays: 10_u64.pow(power),
        ..trace(&format!("rays_1e{power}"), LENS_AXIS, lens_scene())
    };
    powers.map(case).collect()
}

fn surfaces_sweep() -> Vec<Case> {
    let counts = [0, 1, 2, 5, 10, 20, 50, 200, 1000];
    let case = |count| long(trace(&format!("surfaces_{count}"), "surfaces", surface_count_scene(count)));
    counts.map(case).into()
}

fn depth_sweep() -> Vec<Case> {
    let case =
        |max_depth| Case { max_depth, ..long(trace(&format!("depth_{max_depth}"), "depth", cavity_scene())) };
    [2, 4, 8, 16, 32].map(case).into()
}

/// Traces too short for a stage of the hot path.
fn short() -> Vec<Case> {
    let surfaces = |count| trace(&format!("surfaces_{count}_short"), "short", surface_count_scene(count));
    let mut cases = Vec::from([0, 200, 1000].map(surfaces));
    cases.push(trace("depth_16_short", "short", cavity_scene()));
    cases
}

fn commands() -> Vec<Case> {
    let command =
        |name: &str, scene: &str| Case { kind: Kind::Command, ..trace(name, "commands", scene.into()) };
    vec![
        command("cooke_triplet", include_str!("../../scenes/cooke_triplet.json")),
        command("double_gauss", include_str!("../../scenes/double_gauss.json")),
        command("condenser_array", &condenser_array()),
        Case { num_rays: 10_000, kind: Kind::ColdCommand, ..trace("cold_start", "cold_start", lens_scene()) },
    ]
}

/// `lens_scene` of Optiland's harness: one lens of constant index, and a detector.
fn lens_scene() -> String {
    let lens = json!({"r1": 100.0, "r2": -100.0, "thickness": 5.0, "front_aperture_radius": 12.5,
        "material": {"type": "medium", "name": "glass"}});
    scene(json!({
        "components": [component("lens", "L", at_z(0.0), lens)],
        "sources": [collimated(at_z(-25.0), 10.0)],
        "detectors": [detector(at_z(150.0), 50.0, 64, true)],
        "nsq_gpu": {"version": 1, "media": {"glass": {"type": "constant", "n": 1.5}}},
    }))
}

/// `surface_count_scene` of Optiland's harness: mirrors off the axis, which no ray meets.
fn surface_count_scene(num_surfaces: u32) -> String {
    let decoy = |i: u32| {
        let cs = json!({"x": 500.0 * f64::from(i + 1), "z": 10.0});
        let mirror = json!({"radius": FLAT, "reflectance": 0.9, "aperture_radius": 5.0});
        component("mirror", &format!("decoy_{i}"), cs, mirror)
    };
    scene(json!({
        "components": (0..num_surfaces).map(decoy).collect::<Vec<_>>(),
        "sources": [collimated(at_z(-10.0), 5.0)],
        "detectors": [detector(at_z(100.0), 20.0, 64, true)],
    }))
}

/// `cavity_scene` of Optiland's harness: two flat mirrors face to face, with a transmissive detector between them.
fn cavity_scene() -> String {
    let mirror = |name: &str, z: f64| {
        let config = json!({"radius": FLAT, "reflectance": 0.98, "aperture_radius": 20.0});
        component("mirror", name, at_z(z), config)
    };
    scene(json!({
        "components": [mirror("M_far", 50.0), mirror("M_near", -50.0)],
        "sources": [collimated(at_z(0.0), 3.0)],
        "detectors": [detector(at_z(25.0), 12.0, 32, false)],
    }))
}

/// A lens whose radii, thickness, glass, field and pixels are drawn at random, but are the same on every machine.
fn random_lens(number: u64) -> String {
    const GLASSES: [&str; 5] = ["N-BK7", "N-SF11", "N-LAK8", "N-FK51A", "N-SF6"];
    const PIXELS: [u32; 4] = [32, 64, 128, 256];
    let mut draws = Draws(number);
    let mut radius = || {
        let size = draws.between(40.0, 200.0);
        if draws.unit() < 0.5 { -size } else { size }
    };
    let (r1, r2) = (radius(), radius());
    let glass = GLASSES[(draws.unit() * GLASSES.len() as f64) as usize];
    let lens = json!({"r1": r1, "r2": r2, "thickness": draws.between(6.0, 10.0), "front_aperture_radius": 12.5,
        "material": {"type": "catalog", "name": glass}});
    let source_cs = json!({"z": -25.0, "rx": draws.between(0.0, 0.1)});
    let pixels = PIXELS[(draws.unit() * PIXELS.len() as f64) as usize];
    scene(json!({
        "components": [component("lens", "L", at_z(0.0), lens)],
        "sources": [collimated(source_cs, draws.between(5.0, 10.0))],
        "detectors": [detector(at_z(draws.between(60.0, 150.0)), 50.0, pixels, true)],
    }))
}

/// A fly's-eye condenser: a lamp, its collimator, 3 x 3 lenslets side by side, and a field lens. The field lens lays
/// the lenslets' pictures of the lamp over one another.
fn condenser_array() -> String {
    const PITCH: f64 = 6.0;
    let lens = |name: &str, cs: Value, (r1, r2): (f64, f64), thickness: f64, radius: f64| {
        let config = json!({"r1": r1, "r2": r2, "thickness": thickness, "front_aperture_radius": radius,
            "material": {"type": "catalog", "name": "N-BK7"}});
        component("lens", name, cs, config)
    };
    let lenslet = |i: i32| {
        let (x, y) = (PITCH * f64::from(i % 3 - 1), PITCH * f64::from(i / 3 - 1));
        lens(&format!("lenslet_{i}"), json!({"x": x, "y": y, "z": 34.0}), (12.0, -12.0), 2.5, 0.49 * PITCH)
    };
    let mut components = vec![lens("collimator", at_z(20.0), (60.0, -18.0), 10.0, 13.0)];
    components.extend((0..9).map(lenslet));
    components.push(lens("field", at_z(50.0), (50.0, -50.0), 8.0, 16.0));
    scene(json!({
        "components": components,
        "sources": [{"type": "extended", "name": "lamp", "cs": at_z(0.0), "spectrum": spectrum(), "total_flux": 1.0,
            "width": 2.0, "height": 2.0, "half_angle_deg": 28.0}],
        "detectors": [detector(at_z(100.0), 30.0, 128, true)],
    }))
}

/// Small flat mirrors in random places, which a wide beam crosses. Their area in all is the same, however many there
/// are: a ray meets one of them on average, and none meets 64.
pub(crate) fn mirror_cloud(num_mirrors: u32) -> String {
    const WIDTH: f64 = 100.0;
    let radius = (2.0 * WIDTH * WIDTH / (std::f64::consts::PI * f64::from(num_mirrors))).sqrt();
    let mut draws = Draws(1000);
    let mut mirror = |i: u32| {
        let [x, y, z] = [(); 3].map(|()| draws.between(-0.5 * WIDTH, 0.5 * WIDTH));
        let [rx, ry] = [(); 2].map(|()| draws.between(-1.5, 1.5));
        let config = json!({"radius": FLAT, "reflectance": 0.9, "aperture_radius": radius});
        component("mirror", &format!("M_{i}"), json!({"x": x, "y": y, "z": z, "rx": rx, "ry": ry}), config)
    };
    scene(json!({
        "components": (0..num_mirrors).map(&mut mirror).collect::<Vec<_>>(),
        "sources": [collimated(at_z(-80.0), 40.0)],
        "detectors": [detector(at_z(80.0), 200.0, 64, true)],
    }))
}

/// Rays in random directions from a disk onto absorbing spheres in random places, which gives searches without
/// coherence.
fn spheres_scene(num_spheres: u32) -> String {
    let mut draws = Draws(100);
    let mut sphere = |i| {
        let place = [(); 3].map(|()| draws.between(-50.0, 50.0));
        json!({
            "name": format!("ball_{i}"), "cs": {"x": place[0], "y": place[1], "z": place[2]},
            "shape": {"type": "sphere", "radius": draws.between(2.0, 8.0)}, "interaction": "absorbing",
        })
    };
    let spheres: Vec<Value> = (0..num_spheres).map(&mut sphere).collect();
    in_random_directions(spheres)
}

/// The same rays onto an absorbing torus of 2 segments^2 triangles.
fn torus_scene(segments: u32) -> String {
    const LARGE_RADIUS: f64 = 35.0;
    const SMALL_RADIUS: f64 = 15.0;
    let turn = |i: u32| std::f64::consts::TAU * f64::from(i) / f64::from(segments);
    let each = || (0..segments).flat_map(|i| (0..segments).map(move |j| (i, j)));
    let vertex = |(i, j): (u32, u32)| {
        let from_axis = LARGE_RADIUS + SMALL_RADIUS * turn(j).cos();
        [from_axis * turn(i).cos(), from_axis * turn(i).sin(), SMALL_RADIUS * turn(j).sin()]
    };
    let number = |i: u32, j: u32| (i % segments) * segments + j % segments;
    let faces = each().flat_map(|(i, j)| {
        let corners = [number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)];
        [[corners[0], corners[1], corners[2]], [corners[0], corners[2], corners[3]]]
    });
    in_random_directions(vec![json!({
        "name": "torus", "cs": {}, "interaction": "absorbing",
        "shape": {"type": "mesh", "vertices": each().map(vertex).collect::<Vec<_>>(), "faces": faces.collect::<Vec<_>>()},
    })])
}

/// Surfaces around the origin, lit by a disk that shines into a cone, with a detector behind.
fn in_random_directions(surfaces: Vec<Value>) -> String {
    let source = json!({"type": "extended", "name": "S", "cs": at_z(-80.0), "spectrum": spectrum(), "total_flux": 1.0,
        "aperture_radius": 50.0, "half_angle_deg": 45.0});
    scene(json!({
        "components": [],
        "sources": [source],
        "detectors": [detector(at_z(80.0), 200.0, 64, true)],
        "nsq_gpu": {"version": 1, "surfaces": surfaces},
    }))
}

/// A beam 20 mm wide on 64 x 64 pixels, which are `width` mm wide in all. The beam falls all over the pixels, or within
/// four around the centre.
fn beam_scene(width: f64) -> String {
    scene(json!({
        "components": [],
        "sources": [collimated(at_z(0.0), 10.0)],
        "detectors": [detector(at_z(10.0), width, 64, true)],
    }))
}

/// The radius of a flat surface; [`scene`] writes it in the form of scene files.
const FLAT: &str = "Infinity";

/// The text of a scene file. Strict JSON has no infinity, but scene files have.
fn scene(mut document: Value) -> String {
    document["nsq_schema_version"] = json!(1);
    document.to_string().replace("\"Infinity\"", "Infinity")
}

fn component(kind: &str, name: &str, cs: Value, config: Value) -> Value {
    json!({"type": kind, "name": name, "cs": cs, "config": config})
}

fn collimated(cs: Value, aperture_radius: f64) -> Value {
    json!({"type": "collimated", "name": "S", "cs": cs, "spectrum": spectrum(), "total_flux": 1.0,
        "aperture_radius": aperture_radius})
}

fn spectrum() -> Value {
    json!({"wavelengths": [0.55], "weights": [1.0]})
}

fn detector(cs: Value, width: f64, pixels: u32, absorb: bool) -> Value {
    json!({"type": "irradiance", "name": "D", "cs": cs, "width": width, "height": width, "num_pixels_x": pixels,
        "num_pixels_y": pixels, "absorb": absorb})
}

fn at_z(z: f64) -> Value {
    json!({"z": z})
}

/// SplitMix64: the scenes' own draws, which are independent of a trace's.
struct Draws(u64);

impl Draws {
    /// A number in 0..1.
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((mixed ^ (mixed >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }
}

/// The cases that are traces: whole commands have other costs. `option` names what is measured.
///
/// # Errors
/// [`Error::Usage`] if none is.
pub fn of_traces(all: Vec<Case>, option: &str) -> Result<Vec<Case>> {
    let cases: Vec<Case> = all.into_iter().filter(|case| matches!(case.kind, Kind::Trace)).collect();
    if cases.is_empty() {
        return Err(Error::Usage(format!("whole commands are not measured with {option}; name other cases")));
    }
    Ok(cases)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsq_gpu::Scene;

    #[test]
    fn every_scene_is_valid_and_every_name_unique() {
        let cases = all(u64::MAX);
        for case in &cases {
            Scene::from_json(&case.scene).unwrap_or_else(|error| panic!("{}: {error}", case.name));
        }
        let mut names: Vec<&str> = cases.iter().map(|case| case.name.as_str()).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), cases.len());
    }

    #[test]
    fn no_case_has_more_rays_than_asked_for() {
        assert!(all(500).iter().all(|case| case.num_rays == 500));
        let sweep = |max| all(max).iter().filter(|case| case.axis == LENS_AXIS).count();
        assert_eq!((sweep(500), sweep(100_000), sweep(u64::MAX)), (1, 3, 5));
    }
}
