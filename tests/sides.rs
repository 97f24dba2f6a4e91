//! A solid inside out is found: by `nsq-gpu check` with rays of its own, and by every trace in the light that goes wrong.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod command;
mod zoo;

use command::{command, run, stderr};
use nsq_gpu::cpu::Override;
use nsq_gpu::model::SceneIr;
use nsq_gpu::model::sides::{MOST_WORK, SideFaults};
use nsq_gpu::program::Precision;
use nsq_gpu::result::{RunInfo, Tally};
use nsq_gpu::run::Strict;
use nsq_gpu::scene::notes;
use nsq_gpu::{Scene, TraceOptions, TraceResult};
use serde_json::{Value, json};
use zoo::forced::Asked;

const GLASS: &str = "glass";
const WATER: &str = "water";

fn glass() -> Value {
    json!({"type": "medium", "name": GLASS})
}

/// A surface between two media.
fn face(name: &str, z: f64, shape: &Value, front: Value, back: Value) -> Value {
    json!({"name": name, "shape": shape, "interaction": "refractive", "cs": {"z": z}, "material_front": front,
           "material_back": back})
}

/// A scene of these surfaces, on which a beam falls along z.
fn scene(surfaces: &[Value]) -> SceneIr {
    Scene::from_json(&json_of(surfaces).to_string()).unwrap().lower().unwrap()
}

fn json_of(surfaces: &[Value]) -> Value {
    json!({
        "nsq_schema_version": 1,
        "components": [],
        "sources": [{"type": "collimated", "name": "beam", "cs": {"z": -20}, "aperture_radius": 6, "total_flux": 1,
                     "spectrum": {"wavelengths": [0.55], "weights": [1]}}],
        "detectors": [{"type": "irradiance", "name": "far", "cs": {"z": 60}, "width": 200, "height": 200,
                       "num_pixels_x": 4, "num_pixels_y": 4}],
        "nsq_gpu": {"version": 1, "media": {GLASS: {"type": "constant", "n": 1.5}, WATER: {"type": "constant", "n": 1.33}},
                    "surfaces": surfaces},
    })
}

/// A shape that can be the first face of a solid, by its `type`.
fn first_faces() -> Vec<Value> {
    let conic = json!({"type": "conic", "radius": 40, "conic": -0.5, "aperture_radius": 8});
    let aperture = json!({"outline": "rectangle", "semi_axis_x": 8, "semi_axis_y": 8, "x": 0, "y": 0});
    let of = |kind: &str, more: Value| {
        let mut shape = json!({"type": kind, "aperture_radius": 8});
        shape.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        shape
    };
    vec![
        conic,
        json!({"type": "plane", "aperture_radius": 8}),
        json!({"type": "plane", "width": 16, "height": 16}),
        of("clipped_conic", json!({"radius": -50, "aperture": aperture})),
        of("even_asphere", json!({"radius": 50, "coefficients": [1e-4, 1e-6]})),
        of("odd_asphere", json!({"radius": 50, "coefficients": [0, 1e-4, 1e-5]})),
        of("biconic", json!({"radius_x": 50, "radius_y": -80})),
        of("toroidal", json!({"radius_x": 60, "radius_y": 90})),
        of("polynomial", json!({"radius": 60, "coefficients": [[0, 0, 1e-4], [0, 1e-4]]})),
        of(
            "chebyshev",
            json!({"radius": 60, "norm_x": 10, "norm_y": 10, "coefficients": [[0, 0, 0.01], [0, 0.01]]}),
        ),
        of("zernike", json!({"radius": 60, "norm_radius": 10, "coefficients": [0, 0, 0.01, 0.01]})),
    ]
}

/// A thick plate whose first face has this shape, and whose barrel absorbs.
fn plate(name: &str, z: f64, first: &Value) -> Vec<Value> {
    let is_square = first.get("width").is_some();
    let back = if is_square { first.clone() } else { json!({"type": "plane", "aperture_radius": 8}) };
    // That of a square plate is left out: little slips out of it.
    let barrel = json!({"type": "frustum", "r_front": 8, "r_back": 8, "z_front": -3, "z_back": if is_square { -2 } else { 6 }});
    vec![
        face(&format!("{name}.face_1"), z, first, Value::Null, glass()),
        face(&format!("{name}.face_2"), z + 6.0, &back, glass(), Value::Null),
        json!({"name": format!("{name}.barrel"), "shape": barrel, "interaction": "absorbing", "cs": {"z": z}}),
    ]
}

/// Solids that one closed shape bounds.
fn closed_shapes() -> Vec<Vec<Value>> {
    let corners = |i: usize| [0, 1, 2].map(|bit| if i >> bit & 1 == 0 { -8.0 } else { 8.0 });
    let squares = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let faces: Vec<[usize; 3]> = squares.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let vertices: Vec<[f64; 3]> = (0..8).map(corners).collect();
    vec![
        vec![face("X", 10.0, &json!({"type": "sphere", "radius": 8}), Value::Null, glass())],
        vec![face(
            "X",
            10.0,
            &json!({"type": "mesh", "vertices": vertices, "faces": faces}),
            glass(),
            Value::Null,
        )],
    ]
}

/// A rod: a cylinder with its two ends.
fn rod() -> Vec<Value> {
    let wall = json!({"type": "frustum", "r_front": 8, "r_back": 8, "z_front": 0, "z_back": 20});
    let end = json!({"type": "plane", "aperture_radius": 8});
    vec![
        face("X.in", 0.0, &end, Value::Null, glass()),
        face("X.wall", 0.0, &wall, glass(), Value::Null),
        face("X.out", 20.0, &end, glass(), Value::Null),
    ]
}

/// A tube that is closed by a ring and a disk at each end.
fn ring_and_disk() -> Vec<Value> {
    let ring = json!({"type": "annulus", "inner_radius": 4, "outer_radius": 8});
    let disk = json!({"type": "plane", "aperture_radius": 4});
    let mut surfaces = rod();
    surfaces[0] = face("X.ring", 0.0, &ring, Value::Null, glass());
    surfaces.push(face("X.disk", 0.0, &disk, Value::Null, glass()));
    surfaces
}

fn turned(ir: &SceneIr, faces: &[usize]) -> SceneIr {
    let mut ir = ir.clone();
    for &face in faces {
        let surface = &mut ir.surfaces[face];
        std::mem::swap(&mut surface.front, &mut surface.back);
    }
    ir
}

/// A good lens behind the solid, of the same glass.
fn lens_behind() -> Vec<Value> {
    plate("L", 32.0, &json!({"type": "conic", "radius": 90, "aperture_radius": 8}))
}

fn wrong_sides(ir: &SceneIr) -> SideFaults {
    nsq_gpu::model::sides::wrong_sides(ir, MOST_WORK)
}

/// Every solid, with the faces that bound it.
fn solids() -> Vec<(Vec<Value>, Vec<usize>)> {
    let plates = first_faces().into_iter().map(|first| (plate("X", 0.0, &first), vec![0, 1]));
    let closed = closed_shapes().into_iter().map(|surfaces| (surfaces, vec![0]));
    plates.chain(closed).chain([(rod(), vec![0, 1, 2]), (ring_and_disk(), vec![0, 1, 2, 3])]).collect()
}

#[test]
fn every_shape_inside_out_is_found_and_named_alone_and_in_a_lens() {
    for (surfaces, faces) in zoo::in_turn(solids()) {
        for others in [Vec::new(), lens_behind()] {
            let what = format!("{} with {} more", surfaces[0], others.len());
            let ir = scene(&[surfaces.clone(), others].concat());
            assert_eq!(wrong_sides(&ir), SideFaults::default(), "{what}");
            for &face in &faces {
                let ir = turned(&ir, &[face]);
                let found = wrong_sides(&ir);
                assert_eq!(
                    found,
                    SideFaults { turned: vec![vec![face]], ..SideFaults::default() },
                    "{what}: {face}"
                );
                let name = &ir.surfaces[face].name;
                assert!(notes::of(&ir)[0].starts_with(&format!("`{name}` is turned inside out")), "{what}");
            }
            let found = wrong_sides(&turned(&ir, &faces));
            assert_eq!(
                found,
                SideFaults { turned: vec![faces.clone()], ..SideFaults::default() },
                "{what}: all"
            );
        }
    }
}

/// Where no face borders on vacuum, the medium of the sources lies about the scene.
#[test]
fn a_lens_under_water_is_no_open_solid() {
    let water = json!({"type": "medium", "name": WATER});
    let mut surfaces = plate("X", 0.0, &json!({"type": "conic", "radius": 40, "aperture_radius": 8}));
    surfaces[0]["material_front"] = water.clone();
    surfaces[1]["material_back"] = water;
    let mut ir = scene(&surfaces);
    ir.sources[0].medium = ir.surfaces[0].front;
    assert_eq!(wrong_sides(&ir), SideFaults::default());
    for faces in [vec![0], vec![1], vec![0, 1]] {
        let expected = SideFaults { turned: vec![faces.clone()], ..SideFaults::default() };
        assert_eq!(wrong_sides(&turned(&ir, &faces)), expected);
    }
    // All sources of the light guide stand in its acrylic, and vacuum lies about it.
    assert!(wrong_sides(&zoo::load("light_pipe")).turned.is_empty());
}

/// What a trace warns of.
fn warnings(ir: &SceneIr, tally: &Tally) -> Vec<String> {
    TraceResult::new(ir, &RunInfo::default(), tally).unwrap().diagnostics.warnings
}

fn on_wrong_sides(tally: &Tally) -> u64 {
    let surfaces: u64 = tally.surfaces.iter().map(|sums| sums.entered_twice + sums.ended_inside).sum();
    surfaces + tally.detectors.iter().map(|sums| sums.ended_inside).sum::<u64>()
}

#[test]
fn a_trace_of_every_shape_inside_out_counts_rays_and_names_the_face() {
    for (surfaces, faces) in zoo::in_turn(solids()) {
        let what = surfaces[0].to_string();
        let right = scene(&surfaces);
        let options = zoo::options(1000, 5, Precision::F32);
        assert_eq!(on_wrong_sides(&zoo::trace(&right, &options)), 0, "{what}");
        let ir = turned(&right, &faces[..1]);
        let tally = zoo::trace(&ir, &options);
        assert!(on_wrong_sides(&tally) > 0, "{what}");
        let (name, warnings) = (&ir.surfaces[faces[0]].name, warnings(&ir, &tally));
        let names = |warning: &String| warning.starts_with(&format!("`{name}` is turned inside out"));
        assert!(warnings.iter().any(names), "{what}: {warnings:?}");
    }
}

/// The guide of the collection whose wall 1 is turned: light that was kept in by total reflection leaves there.
fn leaking_guide() -> SceneIr {
    let ir = zoo::load("light_pipe");
    let wall = ir.surfaces.iter().position(|surface| surface.name == "wall_1").unwrap();
    turned(&ir, &[wall])
}

#[test]
fn a_light_guide_with_one_wall_turned_is_not_dark_in_silence() {
    let (right, wrong) = (zoo::load("light_pipe"), leaking_guide());
    let options = zoo::options(5000, 1, Precision::F64);
    let [whole, dark] = [&right, &wrong].map(|ir| zoo::trace(ir, &options));
    assert_eq!(on_wrong_sides(&whole), 0);
    assert!(dark.detectors[0].total().quanta * 3 < whole.detectors[0].total().quanta * 2);
    let entered: Vec<u64> = dark.surfaces.iter().map(|sums| sums.entered_twice).collect();
    let most = entered.iter().max().unwrap();
    assert_eq!((wrong.surfaces[1].name.as_str(), entered[1]), ("wall_1", *most), "{entered:?}");
    let said = warnings(&wrong, &dark);
    assert!(said.iter().any(|warning| warning.contains("has on that side: `wall_1` (")), "{said:?}");
    assert!(said.iter().any(|warning| warning.starts_with("`wall_1` is turned inside out")), "{said:?}");
}

/// A source in glass that says no medium is in vacuum, and the first face has glass in front, and water behind.
#[test]
fn a_source_in_a_solid_without_its_medium_is_noticed() {
    let square = json!({"type": "plane", "width": 30, "height": 30});
    let water = || json!({"type": "medium", "name": WATER});
    let surfaces =
        [face("inner", 0.0, &square, glass(), water()), face("outer", 10.0, &square, water(), Value::Null)];
    let with_medium = |medium: Value| {
        let mut text = json_of(&surfaces);
        text["sources"][0]["medium"] = medium;
        Scene::from_json(&text.to_string()).unwrap().lower().unwrap()
    };
    let options = zoo::options(1000, 5, Precision::F32);
    let (right, wrong) = (with_medium(glass()), with_medium(Value::Null));
    assert_eq!(on_wrong_sides(&zoo::trace(&right, &options)), 0);
    let tally = zoo::trace(&wrong, &options);
    assert!(tally.surfaces[0].entered_twice > 900, "{:?}", tally.surfaces[0]);
    let said = warnings(&wrong, &tally);
    assert!(
        said.iter()
            .any(|warning| warning.contains("a source stands in a solid without the solid's `medium`")),
        "{said:?}"
    );
}

#[test]
fn a_result_looks_at_less_of_a_large_scene_than_check_does() {
    let square = json!({"type": "plane", "width": 16, "height": 16});
    let faces = |i: i32| plate(&format!("P{i}"), f64::from(10 * i + 2), &square).into_iter().take(2);
    let plates = (0..40).flat_map(faces);
    let ir = turned(&scene(&plates.collect::<Vec<_>>()), &[0]);
    let tally = zoo::trace(&ir, &zoo::options(1000, 5, Precision::F32));
    for (notes, is_whole) in [(warnings(&ir, &tally), false), (notes::of(&ir), true)] {
        let is_named = notes.iter().any(|note| note.starts_with("`P0.face_1` is turned inside out"));
        let has_unseen = notes.iter().any(|note| note.contains("were not looked at"));
        assert!(is_named && has_unseen != is_whole, "{notes:?}");
    }
}

/// What is counted is a sum over rays alone: it depends neither on how they are dealt out, nor on who follows them.
#[test]
fn rays_on_wrong_sides_are_the_same_however_they_are_traced() {
    let counts = |tally: &Tally| {
        let surfaces = tally.surfaces.iter().map(|sums| (sums.entered_twice, sums.ended_inside));
        let detectors = tally.detectors.iter().map(|sums| (0, sums.ended_inside));
        surfaces.chain(detectors).collect::<Vec<_>>()
    };
    let scenes = [
        leaking_guide(),
        zoo::load("split_ghosts"),
        zoo::load("coated_projector"),
        zoo::load("ball_lens_ghosts"),
    ];
    for ir in zoo::in_turn(scenes) {
        let options = TraceOptions { strict: Strict::On, ..zoo::options(6000, 3, Precision::F32) };
        let expected = counts(&zoo::trace(&ir, &options));
        assert!(expected.iter().any(|count| *count != (0, 0)));
        let few = TraceOptions { batch_size: Some(700), ..options.clone() };
        assert_eq!(counts(&zoo::trace(&ir, &few)), expected, "batches");
        let queued = TraceOptions { events_per_dispatch: 3, ..options.clone() };
        assert_eq!(counts(&zoo::trace(&ir, &queued)), expected, "queue");
        let table = TraceOptions { collect: nsq_gpu::run::Collect::paths(), ..options.clone() };
        assert_eq!(counts(&zoo::trace(&ir, &table)), expected, "paths");
        assert_eq!(counts(&zoo::trace(&ir, &options.on_device())), expected, "sums on the device");
        let hot_path = options.with(|overrides| overrides.hot_path = Override::Always);
        assert_eq!(counts(&zoo::trace(&ir, &hot_path)), expected, "hot path");
        assert_eq!(counts(&zoo::trace_on(zoo::portable_gpu(), &ir, &options)), expected, "portable");
    }
}

#[test]
fn scenes_without_media_look_for_nothing() {
    let options = zoo::options(1000, 5, Precision::F32);
    let text = |ir: &SceneIr| options.tracer(zoo::gpu(), ir).unwrap().program().wgsl.clone();
    for name in ["kaleidoscope", "bench_cavity", "newtonian_telescope", "integrating_sphere"] {
        let text = text(&zoo::load(name));
        assert!(!text.contains("ENTERED_TWICE") && text.contains("fn settle("), "{name}");
    }
    assert!(text(&zoo::load("bench_lens")).contains("COUNTER_ENTERED_TWICE"));
}

// The command.

/// The text of the command for a scene file.
fn checked(text: &str, more: &[&str]) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.json");
    std::fs::write(&path, text).unwrap();
    let output = command(&[&["check", path.to_str().unwrap()], more].concat()).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn check_prints_sides_and_extents() {
    let lens = run(&["check", "scenes/bench_lens.json", "--sides"]);
    let said = String::from_utf8(lens.stdout).unwrap();
    assert!(said.contains("extent: 50 x 50 x 175 mm (x -25 to 25, y -25 to 25, z -25 to 150)"), "{said}");
    let guide = run(&["check", "scenes/tapered_light_guide.json", "--sides"]);
    let said = String::from_utf8(guide.stdout).unwrap();
    let row = |name: &str| -> Vec<String> {
        let line = said.lines().find(|line| line.trim_start().starts_with(&format!("{name} "))).unwrap();
        line.split_whitespace().map(String::from).collect()
    };
    assert_eq!(row("cone"), ["cone", "inside", "tinted", "->", "vacuum"]);
    assert_eq!(row("entry"), ["entry", "towards", "-z", "vacuum", "->", "tinted"]);
    assert_eq!(row("exit"), ["exit", "towards", "-z", "tinted", "->", "vacuum"]);
}

/// The table of sides tells which way a face looks: so it does for a frame that is turned.
#[test]
fn fronts_turn_with_frames() {
    let mut ir = scene(&plate("X", 0.0, &json!({"type": "plane", "aperture_radius": 8})));
    ir.surfaces[0].frame.rotation = glam::DMat3::from_rotation_y(std::f64::consts::FRAC_PI_2);
    ir.surfaces[1].frame.rotation = glam::DMat3::from_rotation_x(0.5);
    let table = notes::sides(&ir);
    assert!(table.contains("towards -x"), "{table}");
    assert!(
        table.contains("towards (-0.000, 0.479, -0.878)") || table.contains("towards (0.000, 0.479, -0.878)"),
        "{table}"
    );
}

fn with_surface(surface: Value) -> String {
    json!({
        "nsq_schema_version": 1,
        "components": [],
        "sources": [{"type": "point", "name": "S", "cs": {}, "total_flux": 1,
                     "spectrum": {"wavelengths": [0.55], "weights": [1]}}],
        "detectors": [{"type": "irradiance", "name": "D", "cs": {"z": 9}, "width": 9, "height": 9}],
        "nsq_gpu": {"version": 1, "surfaces": [surface]},
    })
    .to_string()
}

fn paint(bsdf: &Value, reflectance: f64, fraction: Value) -> String {
    with_surface(json!({"name": "wall", "shape": {"type": "plane", "width": 9, "height": 9}, "cs": {"z": 5},
        "interaction": "reflective", "reflectance": reflectance, "bsdf": bsdf, "scatter_fraction": fraction}))
}

#[test]
fn check_says_what_a_table_of_scattering_leaves_out() {
    // A value of 1/pi scatters everything; half of it, half.
    let level = |share: f64| {
        let value = share / std::f64::consts::PI;
        json!({"type": "tabulated", "theta_i": [0, 90], "theta_s": [0, 90], "bsdf": [[value, value], [value, value]]})
    };
    let said = checked(&paint(&level(0.5), 1.0, json!(1.0)), &[]);
    assert!(said.contains("the table of `wall` has no azimuth"), "{said}");
    assert!(said.contains("becomes a ring about the normal"), "{said}");
    assert!(said.contains("loses up to 50 %") && said.contains("its values add up to 0.5"), "{said}");
    let said = checked(&paint(&level(0.95), 1.0, json!(1.0)), &[]);
    assert!(said.contains("has no azimuth") && !said.contains("loses up to"), "{said}");
    let lambertian = json!({"type": "lambertian"});
    assert!(!checked(&paint(&lambertian, 1.0, json!(1.0)), &[]).contains("note:"));
}

#[test]
fn check_says_that_a_weak_bsdf_does_not_make_paint_of_a_mirror() {
    let weak = json!({"type": "lambertian", "reflectance_value": 0.05});
    let lobe = json!({"type": "harvey_shack", "b0": 0.01, "l0": 0.01, "s": 2.5});
    let is_mirror = |text: &str| checked(text, &[]).contains("`wall` is a mirror and no black paint");
    assert!(is_mirror(&paint(&weak, 1.0, json!("tis"))));
    assert!(is_mirror(&paint(&weak, 1.0, json!(0.05))));
    assert!(is_mirror(&paint(&lobe, 1.0, json!("tis"))));
    // Without `tis` the lobe takes all the light, whatever its level.
    assert!(is_mirror(&paint(&lobe, 1.0, json!(1.0))));
    assert!(!is_mirror(&paint(&weak, 1.0, json!(1.0))), "5 % come back: that is paint");
    assert!(!is_mirror(&paint(&weak, 0.05, json!("tis"))));
    assert!(!is_mirror(&paint(&json!({"type": "lambertian"}), 1.0, json!(1.0))));
}

// Sizes.

fn mesh(shape: &Value) -> Scene {
    let surface = json!({"name": "rod", "shape": shape, "cs": {"z": 5}, "interaction": "absorbing"});
    Scene::from_json(&with_surface(surface)).unwrap()
}

fn rod_mesh(size: f64, scale: Option<f64>) -> Value {
    let corners = [[0.0, 0.0, 0.0], [60.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
    let vertices = corners.map(|corner| corner.map(|x| x * size));
    let mut shape =
        json!({"type": "mesh", "vertices": vertices, "faces": [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]});
    if let Some(scale) = scale {
        shape["scale"] = scale.into();
    }
    shape
}

#[test]
fn a_mesh_in_other_units_is_scaled_as_if_it_were_written_so() {
    let plain = mesh(&rod_mesh(1.0, None)).lower().unwrap();
    assert_eq!(mesh(&rod_mesh(0.5, Some(2.0))).lower().unwrap(), plain);
    assert_ne!(mesh(&rod_mesh(1.0, Some(2.0))).lower().unwrap(), plain);
    assert_eq!(mesh(&rod_mesh(1.0, Some(1.0))).lower().unwrap(), plain);
    let lines = |ir: &SceneIr| notes::extents(ir).join("\n");
    let small = mesh(&rod_mesh(0.001, None)).lower().unwrap();
    assert!(lines(&small).contains("mesh rod: 0.06 x 0.01 x 0.01 mm"), "{}", lines(&small));
    let whole = mesh(&rod_mesh(0.001, Some(1000.0))).lower().unwrap();
    assert!(lines(&whole).contains("mesh rod: 60 x 10 x 10 mm (x 0 to 60,"), "{}", lines(&whole));
    for scale in [0.0, -1.0, 1e10] {
        let surface =
            json!({"name": "rod", "shape": rod_mesh(1.0, Some(scale)), "cs": {}, "interaction": "absorbing"});
        let error = Scene::from_json(&with_surface(surface)).unwrap_err().to_string();
        assert!(error.contains("nsq_gpu.surfaces[0].shape.scale"), "{error}");
    }
}

#[test]
fn one_file_may_stand_in_a_scene_in_two_sizes() {
    let folder = tempfile::tempdir().unwrap();
    let stl = "solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid s\n";
    std::fs::write(folder.path().join("part.stl"), stl).unwrap();
    let surface = |name: &str, scale: f64| json!({"name": name, "shape": {"type": "mesh", "path": "part.stl", "scale": scale}, "cs": {}, "interaction": "absorbing"});
    let mut text: Value = serde_json::from_str(&with_surface(surface("a", 1.0))).unwrap();
    text["nsq_gpu"]["surfaces"] = json!([surface("a", 1.0), surface("b", 25.4), surface("c", 25.4)]);
    let path = folder.path().join("scene.json");
    std::fs::write(&path, text.to_string()).unwrap();
    let ir = Scene::from_path(&path).unwrap().lower().unwrap();
    let lines = notes::extents(&ir);
    assert_eq!(ir.meshes.len(), 2);
    assert!(lines.iter().any(|line| line.starts_with("mesh a: 1 x 1 x 0 mm")), "{lines:?}");
    assert!(lines.iter().any(|line| line.starts_with("mesh c: 25.4 x 25.4 x 0 mm")), "{lines:?}");
}
