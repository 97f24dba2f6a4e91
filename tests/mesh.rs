//! Triangle meshes: no ray is lost between triangles, the tree finds what a search of all triangles finds, and a mesh
//! does what the same surface does as analytic shapes.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

#[path = "mesh/shapes.rs"]
mod shapes;
mod zoo;

use std::collections::BTreeMap;
use std::f64::consts::PI;

use glam::{DMat3, DVec3};
use nsq_gpu::model::{
    Collimated, Detector, DetectorKind, Frame, Interaction, Medium, Mesh, MeshId, Outline, PixelGrid, Point,
    Sampling, SceneIr, Shape, Source, SourceKind, Spectrum, Sphere, Splat, Surface, unit_normal,
};
use nsq_gpu::program::Precision;
use nsq_gpu::result::{PathEvent, PathEventKind, Tally};
use nsq_gpu::run::RecordPaths;
use nsq_gpu::{Scene, TraceOptions};
use shapes::{bumpy_ball, cube, icosphere};

const PRECISIONS: [Precision; 2] = [Precision::F32, Precision::F64];

fn at(x: f64, y: f64, z: f64) -> Frame {
    Frame { origin: DVec3::new(x, y, z), rotation: DMat3::IDENTITY }
}

/// The frame at `origin` whose z axis points along `axis`.
fn facing(origin: DVec3, axis: DVec3) -> Frame {
    let z = axis.normalize();
    let x = z.any_orthonormal_vector();
    Frame { origin, rotation: DMat3::from_cols(x, z.cross(x), z) }
}

fn surface(name: &str, frame: Frame, shape: Shape, interaction: Interaction) -> Surface {
    // Glass on the inside: normals point outward.
    Surface { name: name.into(), frame, shape, interaction, coating: None, scatter: None, front: 1, back: 0 }
}

fn mirror() -> Interaction {
    Interaction::Reflective { reflectance: vec![1.0] }
}

fn lamp(frame: Frame, kind: SourceKind) -> Source {
    Source {
        name: "lamp".into(),
        frame,
        kind,
        total_flux: 1.0,
        spectrum: Spectrum { wavelengths: vec![0], cdf: vec![1.0] },
        medium: 0,
    }
}

/// A lamp that shines everywhere.
fn bulb(x: f64, y: f64, z: f64) -> Source {
    lamp(at(x, y, z), SourceKind::Point(Point { half_angle: PI }))
}

/// A lamp whose rays all go along its axis.
fn laser(frame: Frame) -> Source {
    lamp(frame, SourceKind::Point(Point { half_angle: 0.0 }))
}

fn screen(frame: Frame, size: f64) -> Detector {
    let grid =
        PixelGrid { width: size, height: size, num_pixels_x: 32, num_pixels_y: 32, splat: Splat::Bilinear };
    Detector { name: "screen".into(), frame, kind: DetectorKind::Irradiance(grid), absorb: true }
}

/// Vacuum and glass, no detector.
fn scene(meshes: Vec<Mesh>, surfaces: Vec<Surface>, sources: Vec<Source>) -> SceneIr {
    let medium =
        |name: &str, n: f64| Medium { name: name.into(), ambient: n == 1.0, n: vec![n], k: vec![0.0] };
    SceneIr {
        wavelengths: vec![0.55],
        media: vec![medium("vacuum", 1.0), medium("glass", 1.5)],
        surfaces,
        meshes,
        sources,
        detectors: vec![],
        sampling: Sampling { rr_start_flux: 0.0, ..Sampling::default() },
        scatter_sampling: Vec::new(),
        allowed: Default::default(),
    }
}

/// A lamp within a mesh that absorbs what reaches it.
fn trap(mesh: Mesh) -> SceneIr {
    let wall = surface("wall", at(0.0, 0.0, 0.0), Shape::Mesh(MeshId(0)), Interaction::Absorbing);
    scene(vec![mesh], vec![wall], vec![bulb(1.0, 0.5, -0.25)])
}

fn edited(ir: &SceneIr, options: &TraceOptions, old: &str, new: &str) -> Tally {
    zoo::edited(ir, options, old, new).trace(|_| true).unwrap()
}

// No ray is lost.

#[test]
fn a_closed_mesh_of_82_thousand_triangles_loses_no_ray() {
    loses_no_ray(1_000_000);
}

/// `cargo test --test mesh -- --ignored` for the whole figure.
#[test]
#[ignore = "long"]
fn a_closed_mesh_of_82_thousand_triangles_loses_none_of_1e7_rays() {
    loses_no_ray(10_000_000);
}

fn loses_no_ray(num_rays: u64) {
    let ir = trap(icosphere(6, 10.0));
    assert!(ir.meshes[0].faces.len() >= 80_000);
    for precision in zoo::in_turn(PRECISIONS) {
        let tally = zoo::trace(&ir, &zoo::options(num_rays, 3, precision));
        assert_eq!(tally.escaped.count, 0, "{precision:?}");
        assert_eq!(tally.surfaces[0].absorbed.count, num_rays, "{precision:?}");
    }
}

/// The part of all rays that a missing triangle lets out is its share of the sphere of directions.
/// A rod whose end faces are fans from a corner of the rim, as CAD writes them.
fn rod(segments: u32) -> Mesh {
    let corner = |i: u32, z: f64| {
        let (y, x) = (2.0 * PI * f64::from(i) / f64::from(segments)).sin_cos();
        DVec3::new(10.0 * x, 10.0 * y, z)
    };
    let vertices = [-10.0, 10.0].into_iter().flat_map(|z| (0..segments).map(move |i| corner(i, z))).collect();
    let mut faces = Vec::new();
    for i in 0..segments {
        let next = (i + 1) % segments;
        faces.extend([[i, next, segments + next], [i, segments + next, segments + i]]);
    }
    for i in 1..segments - 1 {
        faces.extend([[segments, segments + i, segments + i + 1], [0, i + 1, i]]);
    }
    Mesh { vertices, faces }
}

/// Their boxes lie in one another, so that the tree that suits them best is as deep as they are many.
#[test]
fn a_rod_with_fans_for_end_faces_loses_no_ray() {
    for segments in [360, 1440] {
        for precision in zoo::in_turn(PRECISIONS) {
            let tally = zoo::trace(&trap(rod(segments)), &zoo::options(20_000, 3, precision));
            assert_eq!(tally.escaped.count, 0, "{segments} segments, {precision:?}");
            assert_eq!(tally.surfaces[0].absorbed.count, 20_000, "{segments} segments, {precision:?}");
        }
    }
}

#[test]
fn a_missing_triangle_lets_out_the_rays_that_aim_at_it() {
    let mut ir = trap(icosphere(3, 10.0));
    let gap = ir.meshes[0].faces.pop().unwrap();
    let eye = ir.sources[0].frame.origin;
    let share = solid_angle(ir.meshes[0].corners(gap).map(|corner| corner - eye)) / (4.0 * PI);
    let num_rays = 1_000_000;
    for precision in zoo::in_turn(PRECISIONS) {
        let tally = zoo::trace(&ir, &zoo::options(num_rays, 3, precision));
        let expected = share * num_rays as f64;
        let escaped = tally.escaped.count as f64;
        assert!(
            (escaped - expected).abs() < 5.0 * expected.sqrt(),
            "{precision:?}: {escaped} rays instead of {expected}"
        );
    }
}

/// Van Oosterom and Strackee, The Solid Angle of a Plane Triangle, 1983.
fn solid_angle([a, b, c]: [DVec3; 3]) -> f64 {
    let (x, y, z) = (a.length(), b.length(), c.length());
    let denominator = x * y * z + a.dot(b) * z + b.dot(c) * x + c.dot(a) * y;
    2.0 * a.dot(b.cross(c)).abs().atan2(denominator)
}

/// Squares of a checkerboard of side 1 about the origin at z = 5, cut along alternating diagonals.
fn board(squares: u32) -> Mesh {
    let side = squares + 1;
    let vertex = |i: u32| DVec3::new(f64::from(i % side), f64::from(i / side), 5.0);
    let square = |i: u32| {
        let (x, y) = (i % squares, i / squares);
        let [a, b, c, d] = [y * side + x, y * side + x + 1, (y + 1) * side + x + 1, (y + 1) * side + x];
        if (x + y) % 2 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] }
    };
    Mesh {
        vertices: (0..side * side).map(vertex).collect(),
        faces: (0..squares * squares).flat_map(square).collect(),
    }
}

/// Rays along z at every half of a square's side: through vertices, along edges, across diagonals, all exactly.
fn rays_at_a_board() -> SceneIr {
    let squares = 8;
    let wall = surface("board", at(0.0, 0.0, 0.0), Shape::Mesh(MeshId(0)), Interaction::Absorbing);
    let steps = 2 * squares + 1;
    let place = |i: u32| at(f64::from(i % steps) / 2.0, f64::from(i / steps) / 2.0, 0.0);
    scene(vec![board(squares)], vec![wall], (0..steps * steps).map(|i| laser(place(i))).collect())
}

#[test]
fn rays_exactly_through_vertices_and_edges_hit() {
    let ir = rays_at_a_board();
    let num_rays = ir.sources.len() as u64;
    for precision in zoo::in_turn(PRECISIONS) {
        let tally = zoo::trace(&ir, &zoo::options(num_rays, 0, precision));
        assert_eq!(tally.surfaces[0].absorbed.count, num_rays, "{precision:?}");
    }
}

#[test]
fn edges_that_belong_to_no_triangle_are_noticed() {
    let ir = rays_at_a_board();
    let options = zoo::options(ir.sources.len() as u64, 0, Precision::F64);
    let half_open = edited(
        &ir,
        &options,
        "let outside = min(s.u, min(s.v, s.w)) < 0.0",
        "let outside = min(s.u, min(s.v, s.w)) <= 0.0",
    );
    assert_ne!(half_open.escaped.count, 0);
}

/// From within, at every vertex and at the middle of every edge of a sphere, to rounding.
#[test]
fn rays_at_the_vertices_and_edges_of_a_sphere_hit() {
    let mesh = icosphere(2, 3.0);
    let eye = DVec3::new(0.3, -0.2, 0.1);
    let middles = mesh.faces.iter().map(|face| {
        let [a, b, _] = mesh.corners(*face);
        0.5 * (a + b)
    });
    let targets: Vec<DVec3> = mesh.vertices.iter().copied().chain(middles).collect();
    let mut ir = trap(mesh);
    ir.sources = targets.iter().map(|target| laser(facing(eye, *target - eye))).collect();
    for precision in zoo::in_turn(PRECISIONS) {
        let tally = zoo::trace(&ir, &zoo::options(targets.len() as u64, 0, precision));
        assert_eq!(tally.escaped.count, 0, "{precision:?}");
    }
}

// The tree.

/// The nearest triangle ahead among all, tested one by one (Moeller and Trumbore, 1997): its distance.
fn nearest_of_all(mesh: &Mesh, o: DVec3, d: DVec3) -> f64 {
    let crossing = |face: &[u32; 3]| {
        let [a, b, c] = mesh.corners(*face);
        let (ab, ac) = (b - a, c - a);
        let p = d.cross(ac);
        let determinant = ab.dot(p);
        let u = (o - a).dot(p) / determinant;
        let q = (o - a).cross(ab);
        let v = d.dot(q) / determinant;
        let t = ac.dot(q) / determinant;
        if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 { t } else { f64::INFINITY }
    };
    mesh.faces.iter().map(crossing).fold(f64::INFINITY, f64::min)
}

/// Two turned copies of a bumpy ball and an analytic sphere around a lamp.
fn bumpy_scene() -> SceneIr {
    let turned = |x: f64, angle: f64| Frame {
        origin: DVec3::new(x, 1.0, -2.0),
        rotation: DMat3::from_rotation_y(angle) * DMat3::from_rotation_x(0.7),
    };
    let ball = Shape::Sphere(Sphere { radius: 2.0, aperture_radius: None });
    let surfaces = vec![
        surface("left", turned(-6.0, 0.4), Shape::Mesh(MeshId(0)), Interaction::Absorbing),
        surface("right", turned(5.0, 2.9), Shape::Mesh(MeshId(0)), Interaction::Absorbing),
        surface("ball", at(-1.5, 5.0, 1.0), ball, Interaction::Absorbing),
    ];
    scene(vec![bumpy_ball(3, 4.0)], surfaces, vec![bulb(0.0, 0.0, 0.0)])
}

/// First events of all rays: where born, what met where.
fn first_events(ir: &SceneIr, options: &TraceOptions) -> Vec<(DVec3, DVec3, Option<usize>, DVec3)> {
    let options = TraceOptions { paths: RecordPaths::All, ..options.clone() };
    let mut births = BTreeMap::new();
    let mut ends = Vec::new();
    for PathEvent { ray, kind } in zoo::trace(ir, &options).paths {
        let position = DVec3::from_array(ray.position);
        match kind {
            PathEventKind::Birth(_) => {
                births.insert(ray.ray_id, (position, DVec3::from_array(ray.direction)));
            }
            PathEventKind::Surface(i) => ends.push((ray.ray_id, Some(i), position)),
            _ => ends.push((ray.ray_id, None, position)),
        }
    }
    ends.into_iter().map(|(id, hit, end)| (births[&id].0, births[&id].1, hit, end)).collect()
}

#[test]
fn the_tree_finds_what_a_search_of_all_triangles_finds() {
    let ir = bumpy_scene();
    let num_rays = 30_000;
    for (precision, tolerance, most_flips) in [(Precision::F64, 1e-12, 0), (Precision::F32, 2e-5, 3)] {
        let events = first_events(&ir, &zoo::options(num_rays, 8, precision));
        assert_eq!(events.len() as u64, num_rays);
        let mut hits = 0;
        let mut flips = 0;
        for (origin, direction, hit, end) in events {
            let (expected, distance) = search_all(&ir, origin, direction);
            hits += u64::from(expected.is_some_and(|i| i < 2));
            if hit != expected {
                flips += 1;
            } else if hit.is_some() {
                let error = (end - (origin + distance * direction)).length();
                // At grazing incidence a distance is as uncertain as its cosine is small.
                assert!(error < 1e3 * tolerance, "{precision:?}: {error:e} mm off");
            }
        }
        assert!(hits > num_rays / 10, "{precision:?}: only {hits} rays meet a mesh");
        assert!(flips <= most_flips, "{precision:?}: {flips} rays met something else");
    }
}

/// The surface that a ray of the bumpy scene meets, and where.
fn search_all(ir: &SceneIr, origin: DVec3, direction: DVec3) -> (Option<usize>, f64) {
    let distance = |s: &Surface| {
        let (o, d) = (
            s.frame.rotation.transpose() * (origin - s.frame.origin),
            s.frame.rotation.transpose() * direction,
        );
        match s.shape {
            Shape::Mesh(MeshId(i)) => nearest_of_all(&ir.meshes[i], o, d),
            Shape::Sphere(Sphere { radius, .. }) => {
                let b = o.dot(d);
                let discriminant = b * b - o.length_squared() + radius * radius;
                let t = -b - discriminant.sqrt();
                if t > 0.0 { t } else { f64::INFINITY }
            }
            _ => f64::INFINITY,
        }
    };
    let distances = ir.surfaces.iter().map(distance).enumerate();
    match distances.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap() {
        (i, t) if t.is_finite() => (Some(i), t),
        _ => (None, f64::INFINITY),
    }
}

#[test]
fn boxes_that_are_too_small_are_noticed() {
    let ir = trap(icosphere(4, 10.0));
    let options = zoo::options(100_000, 3, Precision::F64);
    let shrunk = edited(&ir, &options, "entry <= exit)", "entry + 0.01 <= exit)");
    assert_ne!(shrunk.escaped.count, 0);
}

/// Within a closed mesh every ray that misses what it meets first must come back for the rest.
#[test]
fn siblings_that_are_not_visited_are_noticed() {
    let ir = trap(icosphere(4, 10.0));
    let options = zoo::options(100_000, 3, Precision::F32);
    for (old, new) in [
        ("select(0u, 1u, keys.y != NONE)", "0u"),
        ("select(0u, 1u, keys.w != NONE)", "0u"),
        ("select(1u, 0u, is_empty(rest))", "select(0u, 1u, descends)"),
        ("(group & 0x3Fu) >> 2u", "(group & 0x3Fu)"),
        ("items & (items - 1u)", "0u"),
    ] {
        assert_ne!(edited(&ir, &options, old, new).escaped.count, 0, "{new} for {old}");
    }
}

// Meshes against analytic shapes.

/// A cube of glass of half side 2: as a mesh, or as six squares with outward normals.
fn glass_cube(as_mesh: bool) -> SceneIr {
    let (half, frame) =
        (2.0, Frame { origin: DVec3::new(0.2, -0.1, 0.0), rotation: DMat3::from_rotation_y(0.3) });
    let square = Shape::Plane(Outline::Rectangle { width: 2.0 * half, height: 2.0 * half });
    let side = |axis: DVec3| {
        let local = facing(half * axis, axis);
        Frame {
            origin: frame.origin + frame.rotation * local.origin,
            rotation: frame.rotation * local.rotation,
        }
    };
    let axes = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
    let surfaces = match as_mesh {
        true => vec![surface("cube", frame, Shape::Mesh(MeshId(0)), Interaction::Refractive)],
        false => {
            let plate = |(i, axis): (usize, &DVec3)| {
                surface(&format!("side {i}"), side(*axis), square.clone(), Interaction::Refractive)
            };
            axes.iter().enumerate().map(plate).collect()
        }
    };
    let beam =
        lamp(at(0.0, 0.0, -10.0), SourceKind::Collimated(Collimated { aperture_radius: 3.0, sigma: None }));
    let mut ir = scene(vec![cube(half)], surfaces, vec![beam, bulb(0.0, 3.0, -6.0)]);
    ir.detectors =
        vec![screen(at(0.0, 0.0, 9.0), 14.0), screen(facing(DVec3::new(8.0, 0.0, 0.0), DVec3::NEG_X), 12.0)];
    ir
}

/// The events of each ray; every part of the cube counts as one.
fn fates(ir: &SceneIr, options: &TraceOptions) -> BTreeMap<u64, Vec<PathEventKind>> {
    let options = TraceOptions { paths: RecordPaths::All, ..options.clone() };
    let mut fates: BTreeMap<u64, Vec<PathEventKind>> = BTreeMap::new();
    for PathEvent { ray, kind } in zoo::trace(ir, &options).paths {
        let kind = if let PathEventKind::Surface(_) = kind { PathEventKind::Surface(0) } else { kind };
        fates.entry(ray.ray_id).or_default().push(kind);
    }
    fates
}

/// The largest difference of two maps, in units of the largest cell.
fn map_deviation(ours: &Tally, theirs: &Tally) -> f64 {
    let cells = ours.detectors.iter().zip(&theirs.detectors).flat_map(|(mine, other)| {
        let peak = *other.quanta.iter().max().unwrap() as f64;
        assert!(peak > 0.0, "a map is dark");
        mine.quanta.iter().zip(&other.quanta).map(move |(mine, other)| mine.abs_diff(*other) as f64 / peak)
    });
    cells.fold(0.0, f64::max)
}

#[test]
fn a_cube_of_triangles_does_what_six_squares_do() {
    let [mesh, squares] = [true, false].map(glass_cube);
    for baked in [true, false] {
        let options = TraceOptions { baked: Some(baked), ..zoo::options(100_000, 5, Precision::F64) };
        let of_mesh = fates(&mesh, &options);
        let inside = of_mesh.values().filter(|events| events.len() > 4).count();
        assert!(inside > 10_000, "only {inside} rays go through the cube");
        let differ = fates(&squares, &options).iter().filter(|(ray, fate)| of_mesh[ray] != **fate).count();
        assert_eq!(differ, 0, "rays of another fate");
        let deviation = map_deviation(&zoo::trace(&mesh, &options), &zoo::trace(&squares, &options));
        eprintln!("cube of triangles against squares: {deviation:.1e}");
        assert!(deviation <= 1e-12, "{deviation:e}");
    }
}

#[test]
fn a_normal_of_another_triangle_is_noticed() {
    let [mesh, squares] = [true, false].map(glass_cube);
    let options = zoo::options(20_000, 5, Precision::F64);
    let wrong = edited(&mesh, &options, "let row = arrived_triangle;", "let row = 0u;");
    assert!(map_deviation(&wrong, &zoo::trace(&squares, &options)) > 1e-3);
}

/// Mirrors within: every event leaves a triangle for one that stands beside it or opposite.
#[test]
fn solids_of_mirrors_keep_their_rays() {
    let mirrors = surface("mirrors", at(0.0, 0.0, 0.0), Shape::Mesh(MeshId(0)), mirror());
    let options = TraceOptions { max_depth: 100, ..zoo::options(100_000, 5, Precision::F64) };
    let within = |solid| scene(vec![solid], vec![mirrors.clone()], vec![bulb(0.3, 0.5, -0.2)]);
    assert_eq!(zoo::trace(&within(cube(2.0)), &options).depth_killed.count, 100_000);
    // No two triangles of a ball lie in one plane, which would be left as a whole (geometry/facets.touching.wgsl).
    let ir = within(icosphere(1, 2.0));
    let tally = zoo::trace(&ir, &options);
    assert_eq!(tally.depth_killed.count, 100_000);
    let sticky = edited(&ir, &options, "triangle != ray.leaves", "true");
    assert!(sticky != tally, "a triangle that is met again by the ray that leaves it makes a difference");
}

/// A sphere of 82 thousand triangles images as the sphere does, to what flat facets allow.
#[test]
fn a_fine_ball_of_glass_refracts_as_a_sphere_does() {
    let ball = |shape, front, back| {
        let mut ball = surface("ball", at(0.0, 0.0, 0.0), shape, Interaction::Refractive);
        (ball.front, ball.back) = (front, back);
        let beam = lamp(
            at(0.0, 0.0, -20.0),
            SourceKind::Collimated(Collimated { aperture_radius: 5.0, sigma: None }),
        );
        let mut ir = scene(vec![icosphere(6, 10.0)], vec![ball], vec![beam]);
        ir.detectors = vec![screen(at(0.0, 0.0, 12.0), 8.0)];
        zoo::trace(&ir, &zoo::options(100_000, 1, Precision::F64))
    };
    // The normal of a sphere points inward.
    let sphere = ball(Shape::Sphere(Sphere { radius: 10.0, aperture_radius: None }), 0, 1);
    let facets = ball(Shape::Mesh(MeshId(0)), 1, 0);
    let [expected, found] = [&sphere, &facets].map(|tally| tally.detectors[0].total().quanta as f64);
    assert!((found / expected - 1.0).abs() < 1e-3, "{found} instead of {expected}");
    assert_eq!(facets.medium_stack_underflows, 0);
}

// The same bits.

/// Refracting and reflecting meshes, two of them copies of one, and roulette.
fn diverse() -> SceneIr {
    let mut ir = glass_cube(true);
    ir.meshes.push(bumpy_ball(2, 1.5));
    let half = Interaction::Reflective { reflectance: vec![0.5] };
    ir.surfaces.push(surface("near", at(3.0, 2.0, 4.0), Shape::Mesh(MeshId(1)), half.clone()));
    ir.surfaces.push(surface("far", at(-3.0, -1.0, 5.0), Shape::Mesh(MeshId(1)), half));
    ir.sampling.rr_start_flux = 0.3;
    ir
}

#[test]
fn batches_queues_and_portable_integers_give_the_same_bits() {
    let ir = diverse();
    for precision in zoo::in_turn(PRECISIONS) {
        for baked in [true, false] {
            let options = TraceOptions { baked: Some(baked), ..zoo::options(20_000, 11, precision) };
            let plain = zoo::trace(&ir, &options);
            assert!(plain.surfaces.iter().all(|surface| surface.reached));
            let changes: [fn(&mut TraceOptions); 4] = [
                |options| options.batch_size = Some(777),
                |options| options.events_per_dispatch = 1,
                |options| options.events_per_dispatch = 3,
                |options| options.workgroup_size = 256,
            ];
            for change in changes {
                let mut changed = options.clone();
                change(&mut changed);
                assert!(zoo::trace(&ir, &changed) == plain, "other bits with {changed:?}");
            }
            assert!(
                zoo::trace_on(zoo::portable_gpu(), &ir, &options) == plain,
                "other bits with {options:?}"
            );
        }
    }
}

#[test]
fn a_queue_without_the_triangle_is_noticed() {
    let ir = diverse();
    let options = TraceOptions { events_per_dispatch: 1, ..zoo::options(20_000, 11, Precision::F32) };
    let forgetful = edited(&ir, &options, "    arrived_triangle = q.triangle;\n", "");
    assert!(forgetful != zoo::trace(&ir, &options));
}

#[test]
fn meshes_in_tables_agree_with_meshes_compiled_in() {
    let ir = diverse();
    let options = zoo::options(50_000, 2, Precision::F64);
    let [baked, tables] =
        [true, false].map(|baked| zoo::trace(&ir, &TraceOptions { baked: Some(baked), ..options.clone() }));
    assert_eq!(baked.escaped.count, tables.escaped.count);
    let deviation = map_deviation(&tables, &baked);
    assert!(deviation <= 1e-12, "{deviation:e}");
}

/// One mesh placed twice gives the bits of two meshes.
#[test]
fn a_mesh_placed_twice_is_two_meshes() {
    let once = bumpy_scene();
    let mut twice = once.clone();
    twice.meshes.push(once.meshes[0].clone());
    twice.surfaces[1].shape = Shape::Mesh(MeshId(1));
    for precision in zoo::in_turn(PRECISIONS) {
        let options = zoo::options(20_000, 4, precision);
        assert!(zoo::trace(&once, &options) == zoo::trace(&twice, &options), "{precision:?}");
    }
}

/// Of two meshes in one place the first in the list takes every ray, and its normal counts.
#[test]
fn the_first_of_two_meshes_in_one_place_wins() {
    let mut ir = trap(icosphere(2, 4.0));
    let mut second = ir.surfaces[0].clone();
    second.name = "second".into();
    ir.surfaces.push(second);
    let tally = zoo::trace(&ir, &zoo::options(20_000, 4, Precision::F64));
    assert_eq!(tally.surfaces[0].absorbed.count, 20_000);
}

#[test]
fn a_scene_far_away_keeps_its_mesh_in_f32() {
    let mut ir = trap(icosphere(5, 10.0));
    let near = zoo::trace(&ir, &zoo::options(100_000, 4, Precision::F32));
    let shift = DVec3::new(1e9, -2e9, 5e8);
    ir.surfaces.iter_mut().for_each(|s| s.frame.origin += shift);
    ir.sources.iter_mut().for_each(|e| e.frame.origin += shift);
    assert!(zoo::trace(&ir, &zoo::options(100_000, 4, Precision::F32)) == near);
}

// Files.

fn lowered(shapes: &[String], folder: Option<&std::path::Path>) -> nsq_gpu::Result<(SceneIr, Vec<String>)> {
    lowered_as("absorbing", shapes, folder)
}

fn lowered_as(
    interaction: &str,
    shapes: &[String],
    folder: Option<&std::path::Path>,
) -> nsq_gpu::Result<(SceneIr, Vec<String>)> {
    let surface = |(i, shape): (usize, &String)| {
        format!(
            r#"{{"name": "part {i}", "cs": {{"z": {i}}}, "interaction": "{interaction}", "shape": {shape}}}"#
        )
    };
    let surfaces: Vec<String> = shapes.iter().enumerate().map(surface).collect();
    let text = format!(
        r#"{{"nsq_schema_version": 1, "sources": [{{"type": "point", "name": "S", "cs": {{}}, "total_flux": 1,
        "spectrum": {{"wavelengths": [0.5], "weights": [1]}}}}], "detectors": [{{"type": "irradiance", "name": "D",
        "cs": {{"z": 9}}, "width": 1, "height": 1}}], "nsq_gpu": {{"version": 1, "surfaces": [{}]}}}}"#,
        surfaces.join(", ")
    );
    let scene = match folder {
        None => Scene::from_json(&text)?,
        Some(folder) => {
            let path = folder.join("scene.json");
            std::fs::write(&path, text).unwrap();
            Scene::from_path(&path)?
        }
    };
    Ok((scene.lower()?, scene.warnings))
}

fn inline(mesh: &Mesh) -> String {
    let vertices: Vec<[f64; 3]> = mesh.vertices.iter().map(|v| v.to_array()).collect();
    format!(r#"{{"type": "mesh", "vertices": {vertices:?}, "faces": {:?}}}"#, mesh.faces)
}

fn tetrahedron() -> Mesh {
    let vertices = vec![DVec3::ZERO, 2.0 * DVec3::X, 3.0 * DVec3::Y, DVec3::Z];
    Mesh { vertices, faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]] }
}

/// The corners of all triangles in the scene's coordinates.
fn placed_corners(ir: &SceneIr, surface: usize) -> Vec<[DVec3; 3]> {
    let Shape::Mesh(MeshId(mesh)) = ir.surfaces[surface].shape else { panic!("not a mesh") };
    let (frame, mesh) = (&ir.surfaces[surface].frame, &ir.meshes[mesh]);
    mesh.faces.iter().map(|face| mesh.corners(*face).map(|v| frame.origin + frame.rotation * v)).collect()
}

#[test]
fn files_and_lists_give_the_same_mesh_once() {
    let mesh = tetrahedron();
    let folder = tempfile::tempdir().unwrap();
    let facets = mesh.faces.iter().map(|face| mesh.corners(*face));
    let vertex = |v: &DVec3| format!("vertex {} {} {:e}\n", v.x, v.y, v.z);
    let ascii = facets.clone().map(|corners| {
        let corners: String = corners.iter().map(vertex).collect();
        format!("facet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\n")
    });
    let ascii = format!("solid part\n{}endsolid part\n", ascii.collect::<String>());
    std::fs::write(folder.path().join("ascii.stl"), ascii).unwrap();
    let mut binary = b"solid but binary".to_vec();
    binary.resize(80, b' ');
    binary.extend((mesh.faces.len() as u32).to_le_bytes());
    for corners in facets {
        let numbers = [unit_normal(corners), corners[0], corners[1], corners[2]];
        binary.extend(numbers.iter().flat_map(|v| v.as_vec3().to_array()).flat_map(f32::to_le_bytes));
        binary.extend([0, 0]);
    }
    std::fs::write(folder.path().join("binary.STL"), binary).unwrap();
    let obj = "# part\nv 0 0 0\nv 2 0 0\nv 0 3 0\nv 0 0 1 1.0\nvn 0 0 1\nf 1/1 3/2 2/3\nf 1//1 2//1 4//1\nf -4 -1 -2\nf 2 3 4\n";
    std::fs::write(folder.path().join("part.obj"), obj).unwrap();
    let file = |name: &str| format!(r#"{{"type": "mesh", "path": "{name}"}}"#);
    let shapes = [inline(&mesh), file("ascii.stl"), file("binary.STL"), file("part.obj"), file("ascii.stl")];
    let (ir, warnings) = lowered(&shapes, Some(folder.path())).unwrap();
    assert_eq!(warnings, Vec::<String>::new());
    let corners = |i: usize| placed_corners(&ir, i);
    for i in 0..shapes.len() {
        let moved: Vec<[DVec3; 3]> = corners(i).iter().map(|t| t.map(|v| v - i as f64 * DVec3::Z)).collect();
        for (found, expected) in moved.iter().flatten().zip(mesh.faces.iter().flat_map(|f| mesh.corners(*f)))
        {
            assert!((*found - expected).length() < 1e-14, "shape {i}: {found} instead of {expected}");
        }
    }
    // The list and the OBJ number their vertices alike; so do both kinds of STL.
    let meshes: Vec<&Shape> = ir.surfaces.iter().map(|s| &s.shape).collect();
    assert_eq!(meshes, [0, 1, 1, 0, 1].map(|mesh| Shape::Mesh(MeshId(mesh))).iter().collect::<Vec<_>>());
    assert_eq!(ir.meshes.len(), 2);
}

/// An E, no corner of which sees into all three arms.
const COMB: &str = "v 0 0 0\nv 3 0 0\nv 3 1 0\nv 1 1 0\nv 1 2 0\nv 3 2 0\nv 3 3 0\nv 1 3 0\nv 1 4 0\nv 3 4 0\nv 3 5 0\n\
    v 0 5 0\nf 1 2 3 4 5 6 7 8 9 10 11 12\n";

/// A rectangle of 10 x 7 mm aslant, with corners in rows on its edges, in as many digits as files have.
fn in_rows() -> String {
    let corners = [(0.0, 0.0), (10.0, 0.0), (10.0, 7.0), (0.0, 7.0)];
    let mut text = String::new();
    for (i, from) in corners.into_iter().enumerate() {
        let to = corners[(i + 1) % 4];
        for step in 0..20 {
            let share = f64::from(step) / 20.0;
            let (x, y) = (from.0 + share * (to.0 - from.0), from.1 + share * (to.1 - from.1));
            let (sin, cos) = 0.7_f64.sin_cos();
            text += &format!("v {:.6} {:.6} 0\n", cos * x - sin * y, sin * x + cos * y);
        }
    }
    text + "f " + &(1..=80).map(|i| i.to_string()).collect::<Vec<_>>().join(" ") + "\n"
}

#[test]
fn faces_of_many_corners_are_covered_once() {
    let folder = tempfile::tempdir().unwrap();
    // An L, whose first corner does not see the last but one.
    let l = "v 0 0 0\nv 2 0 0\nv 2 1 0\nv 1 1 0\nv 1 3 0\nv 0 3 0\nf 2 3 4 \\\n 5 6 1 # an L\n";
    // The second corner of the square lies on an edge; a comment may end in a backslash.
    let edged = "v 0 0 0\n# C:\\\nv 1 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nf 1 2 3 4 5\n";
    let square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n";
    // Corners in rows are rounded to either side of the edge that they lie on.
    for (name, obj, area, least) in [
        ("l.obj", l, 4.0, 0.5),
        ("square.obj", square, 1.0, 0.5),
        ("edged.obj", edged, 4.0, 0.5),
        ("rows.obj", &in_rows(), 70.0, -1e-5),
    ] {
        std::fs::write(folder.path().join(name), obj).unwrap();
        let shape = format!(r#"{{"type": "mesh", "path": "{name}"}}"#);
        let (ir, _) = lowered(&[shape], Some(folder.path())).unwrap();
        let mesh = &ir.meshes[0];
        let areas = mesh.faces.iter().map(|face| {
            let [a, b, c] = mesh.corners(*face);
            0.5 * (b - a).cross(c - a).z
        });
        let areas: Vec<f64> = areas.collect();
        assert!(areas.iter().all(|area| *area >= least), "{name}: {areas:?}");
        assert!((areas.iter().sum::<f64>() - area).abs() < 1e-6 * area, "{name}: {areas:?}");
    }
}

#[test]
fn solids_that_leak_are_reported_by_their_kind() {
    let mut open = tetrahedron();
    open.faces.pop();
    let mut turned = tetrahedron();
    turned.faces[0].swap(1, 2);
    let whole = tetrahedron();
    for (mesh, told) in [
        (open, "the mesh \"part 0\" is not closed (3 open edges)"),
        (turned, "faces of the mesh \"part 0\" are turned against their neighbours (along 3 edges)"),
        (whole, ""),
    ] {
        let (_, warnings) = lowered_as("refractive", &[inline(&mesh)], None).unwrap();
        assert_eq!(warnings.is_empty(), told.is_empty(), "{warnings:?}");
        assert!(warnings.concat().contains(told), "{warnings:?}");
    }
}

#[test]
fn faces_without_area_are_left_out_loudly() {
    let mut mesh = tetrahedron();
    mesh.faces.push([0, 0, 1]);
    let (ir, warnings) = lowered(&[inline(&mesh)], None).unwrap();
    assert_eq!(ir.meshes[0].faces.len(), 4);
    assert_eq!(warnings, ["1 of the 5 triangles of \"part 0\" have no area and are left out"]);
}

#[test]
fn meshes_that_mean_nothing_are_refused_with_their_place() {
    let triangle = |vertices: &str, faces: &str| {
        format!(r#"{{"type": "mesh", "vertices": {vertices}, "faces": {faces}}}"#)
    };
    let corners = "[[0, 0, 0], [1, 0, 0], [0, 1, 0]]";
    for (shape, place, problem) in [
        (r#"{"type": "mesh"}"#.to_string(), "shape", "either a file or its vertices"),
        (triangle(corners, "null"), "shape", "either a file or its vertices"),
        (
            r#"{"type": "mesh", "path": "a.stl", "faces": []}"#.into(),
            "shape",
            "either a file or its vertices",
        ),
        (triangle(corners, "[[0, 1, 3]]"), "shape.faces[0]", "[0, 1, 3] names a vertex that is not there"),
        (
            triangle("[[0, 0, 0], [1, 0, 0], [0, 1e13, 0]]", "[[0, 1, 2]]"),
            "shape.vertices[2]",
            "out of range",
        ),
        (
            triangle("[[0, 0, Infinity], [1, 0, 0], [0, 1, 0]]", "[[0, 1, 2]]"),
            "shape.vertices[0]",
            "out of range",
        ),
        (triangle(corners, "[]"), "shape", "no triangle"),
        (triangle(corners, "[[0, 1, 1]]"), "shape", "no triangle"),
        (r#"{"type": "mesh", "path": "part.step"}"#.into(), "shape.path", "neither .stl nor .obj"),
    ] {
        let message = lowered(std::slice::from_ref(&shape), None).unwrap_err().to_string();
        assert!(message.starts_with(&format!("nsq_gpu.surfaces[0].{place}: ")), "{shape}: {message}");
        assert!(message.contains(problem), "{shape}: {message}");
    }
}

/// A binary STL of two triangles, with a corner that is no number.
fn nan_corner() -> Vec<u8> {
    let mut bytes = vec![0; 80];
    bytes.extend(2_u32.to_le_bytes());
    for x in [4.0, f32::NAN] {
        let numbers = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, x, 5.0, 6.0, 1.0, 0.0, 0.0_f32];
        bytes.extend(numbers.into_iter().flat_map(f32::to_le_bytes));
        bytes.extend([0, 0]);
    }
    bytes
}

/// The text of an STL.
fn stl_of(mesh: &Mesh) -> String {
    let vertex = |v: DVec3| format!("      vertex {:.9e} {:.9e} {:.9e}\n", v.x, v.y, v.z);
    let facet = |face: &[u32; 3]| {
        let corners: String = mesh.corners(*face).map(vertex).concat();
        format!("  facet normal 0 0 0\n    outer loop\n{corners}    endloop\n  endfacet\n")
    };
    let facets: String = mesh.faces.iter().map(facet).collect();
    format!("solid part\n{facets}endsolid part\n")
}

fn latin_1(text: &str) -> Vec<u8> {
    text.chars().map(|c| u32::from(c) as u8).collect()
}

fn utf_16(text: &str) -> Vec<u8> {
    format!("\u{feff}{text}").encode_utf16().flat_map(u16::to_le_bytes).collect()
}

/// What exporters and editors make of a text, and trimesh reads: the mesh is that of the plain file, to the bit.
#[test]
fn dialects_of_text_files_are_the_same_mesh() {
    let stl = stl_of(&tetrahedron());
    let (first, second) = stl.split_at(stl.find("endfacet").unwrap() + 9);
    let obj = "v 0 0 0\nv 2 0 0\nv 0 3 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
    let dialects: Vec<(&str, Vec<u8>)> = vec![
        ("plain.stl", stl.clone().into()),
        ("upper.stl", stl.to_uppercase().into()),
        (
            "capital.stl",
            stl.replace("facet", "Facet").replace("solid", "Solid").replace("vertex", "Vertex").into(),
        ),
        ("mark.stl", format!("\u{feff}{stl}").into()),
        ("latin.stl", latin_1(&stl.replace("part", "K\u{f6}rper"))),
        ("utf16.stl", utf_16(&stl)),
        ("crlf.stl", stl.replace('\n', "\r\n").into()),
        ("tabs.stl", stl.replace("  ", "\t").into()),
        ("blank.stl", format!("\n\n{}", stl.replace('\n', "\n\n")).into()),
        (
            "apart.stl",
            stl.replace("endloop", "end loop")
                .replace("endfacet", "end facet")
                .replace("endsolid", "end solid")
                .into(),
        ),
        ("nameless.stl", stl.replace(" part", "").into()),
        ("misnamed.stl", stl.replace("part", "# vertex facet endloop").into()),
        ("normals.stl", stl.replace("normal 0 0 0", "normal -nan nan(ind) 0,5").into()),
        ("signs.stl", stl.replace("vertex ", "vertex +").into()),
        ("exponents.stl", stl.replace("e0", "e+000").into()),
        ("loopless.stl", stl.replace("    outer loop\n", "").replace("    endloop\n", "").into()),
        ("one_line.stl", stl.replace("normal 0 0 0\n", "").replace("outer loop\n", "").into()),
        ("comment.stl", format!("exported by a program\n{stl}").into()),
        ("two.stl", format!("{first}endsolid part\nsolid part\n{second}").into()),
        ("plain.obj", obj.into()),
        ("mark.obj", format!("\u{feff}{obj}").into()),
        ("joined.obj", obj.replace("v 0 3 0", "\u{feff}v 0 3 0").into()),
        ("latin.obj", latin_1(&format!("# K\u{f6}rper\no K\u{f6}rper\n{obj}"))),
        ("utf16.obj", utf_16(obj)),
        ("crlf.obj", obj.replace('\n', "\r\n").into()),
        ("tabs.obj", obj.replace(' ', "\t").into()),
        ("indented.obj", obj.replace("f ", "  f  ").into()),
        ("numbers.obj", obj.replace("v 0 0 0", "v +0. -0.0 .0e0").replace("v 2 0", "v 2.E0 0e+00").into()),
        ("colours.obj", obj.replace("v 0 0 1", "v 0 0 1 0.5 0.25 1").into()),
        ("backwards.obj", obj.replace("f 1 3 2", "f -4 -2 -3").into()),
        (
            "slashes.obj",
            obj.replace("f 1 3 2", "f 1/1 3/2/ 2//7").replace("f 2 3 4", "f 2/1/1 3/1/1 4/1/1").into(),
        ),
        ("groups.obj", obj.replace("f 1 2 4", "g side\nusemtl glass\ns off\nf 1 2 4").into()),
        ("continued.obj", obj.replace("f 1 2 4", "f 1 \\\n 2 \\\n4").into()),
        ("comments.obj", obj.replace("f 1 2 4", "# C:\\\nf 1 2 4 # side").into()),
        ("faces_first.obj", {
            let (vertices, faces) = obj.split_at(obj.find('f').unwrap());
            format!("{faces}{vertices}").into()
        }),
    ];
    let folder = tempfile::tempdir().unwrap();
    let mesh_of = |name: &str, bytes: &[u8]| {
        std::fs::write(folder.path().join(name), bytes).unwrap();
        let shape = format!(r#"{{"type": "mesh", "path": "{name}"}}"#);
        let (mut ir, warnings) = lowered_as("refractive", &[shape], Some(folder.path()))
            .unwrap_or_else(|err| panic!("{name}: {err}"));
        assert_eq!(warnings, Vec::<String>::new(), "{name}");
        ir.meshes.remove(0)
    };
    let plain = [mesh_of("plain.stl", stl.as_bytes()), mesh_of("plain.obj", obj.as_bytes())];
    assert_eq!(plain[0].faces.len(), 4);
    for (name, bytes) in &dialects {
        let of_kind = &plain[usize::from(name.ends_with("obj"))];
        assert_eq!(mesh_of(name, bytes), *of_kind, "{name}");
    }
}

/// Where the last line alone is missing, nothing is lost; half of a mesh is refused (`half.stl`).
#[test]
fn a_closed_mesh_without_its_last_line_is_read_and_told() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("whole.stl"), stl_of(&tetrahedron()).replace("endsolid part\n", ""))
        .unwrap();
    let shape = r#"{"type": "mesh", "path": "whole.stl"}"#.to_string();
    let (ir, warnings) = lowered(&[shape], Some(folder.path())).unwrap();
    assert_eq!(ir.meshes[0].faces.len(), 4);
    assert!(warnings.len() == 1 && warnings[0].contains("without `endsolid`"), "{warnings:?}");
}

/// A pipe without a writer would wait for ever, and /dev/zero has no end.
#[cfg(unix)]
#[test]
fn what_is_no_file_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe.stl");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    std::fs::create_dir(folder.path().join("folder.obj")).unwrap();
    std::os::unix::fs::symlink("/dev/zero", folder.path().join("endless.stl")).unwrap();
    let table = |path: &str| {
        format!(r#"{{"type": "plane"}}, "reflectance": 1, "bsdf": {{"type": "tabulated", "path": "{path}"}}"#)
    };
    for (name, problem) in [
        ("pipe.stl", "it is a pipe or a device, and no file"),
        ("endless.stl", "it is a pipe or a device, and no file"),
        ("folder.obj", "it is a folder, and no file"),
    ] {
        let mesh = format!(r#"{{"type": "mesh", "path": "{name}"}}"#);
        for (interaction, shape) in [("absorbing", mesh), ("reflective", table(name))] {
            let message = lowered_as(interaction, &[shape], Some(folder.path())).unwrap_err().to_string();
            assert!(message.contains(name) && message.contains(problem), "{name}: {message}");
        }
    }
}

fn two(first: &Mesh, second: &Mesh) -> Mesh {
    let mut both = first.clone();
    let next = both.vertices.len() as u32;
    both.vertices.extend(&second.vertices);
    both.faces.extend(second.faces.iter().map(|face| face.map(|corner| corner + next)));
    both
}

fn turned(mut mesh: Mesh) -> Mesh {
    mesh.faces.iter_mut().for_each(|face| face.swap(1, 2));
    mesh
}

fn shifted(mut mesh: Mesh, by: DVec3) -> Mesh {
    mesh.vertices.iter_mut().for_each(|v| *v += by);
    mesh
}

#[test]
fn solids_that_are_inside_out_are_named() {
    let glass = |front: &str, back: &str, mesh: &Mesh| {
        format!(r#"{}, "material_front": {front}, "material_back": {back}"#, inline(mesh))
    };
    let beside = shifted(cube(2.0), 5.0 * DVec3::X);
    for (what, mesh, parts) in [
        ("a cube", cube(2.0), 0),
        ("a cube whose faces look inward", turned(cube(2.0)), 1),
        ("a hollow cube", two(&cube(4.0), &turned(cube(2.0))), 0),
        ("two cubes", two(&cube(2.0), &beside), 0),
        ("two cubes, one inside out", two(&cube(2.0), &turned(beside.clone())), 1),
        ("two cubes inside out", two(&turned(cube(2.0)), &turned(beside)), 2),
    ] {
        let (_, warnings) = lowered_as("refractive", &[glass("\"N-BK7\"", "null", &mesh)], None).unwrap();
        let told =
            warnings.iter().any(|warning| warning.contains(&format!("\"part 0\" is inside out ({parts} of")));
        assert_eq!((told, warnings.len()), (parts > 0, usize::from(parts > 0)), "{what}: {warnings:?}");
        // With the media exchanged, a mesh that looks inward is right.
        let (_, warnings) = lowered_as("refractive", &[glass("null", "\"N-BK7\"", &mesh)], None).unwrap();
        assert_eq!(warnings, Vec::<String>::new(), "{what}");
    }
}

#[test]
fn doubled_facets_are_named_however_they_are_written() {
    let again = |order: [usize; 3]| {
        let mut mesh = tetrahedron();
        let face = mesh.faces[3];
        mesh.faces.push(order.map(|i| face[i]));
        mesh
    };
    let whole = two(&tetrahedron(), &tetrahedron());
    let (stands, faces) = ("stand where another one has", "face another one with");
    for (mesh, doubled, all, how) in [
        (again([0, 1, 2]), 1, 5, stands),
        (again([2, 0, 1]), 1, 5, stands),
        (again([1, 0, 2]), 1, 5, faces),
        (whole, 4, 8, stands),
    ] {
        for (interaction, more) in
            [("absorbing", ""), ("reflective", r#", "reflectance": 1"#), ("refractive", "")]
        {
            let (_, warnings) = lowered_as(interaction, &[inline(&mesh) + more], None).unwrap();
            let told =
                format!("{doubled} of the {all} triangles of the mesh \"part 0\" {how} the same corners");
            assert!(warnings.iter().any(|warning| warning.contains(&told)), "{interaction}: {warnings:?}");
        }
    }
    let (_, warnings) = lowered(&[inline(&tetrahedron())], None).unwrap();
    assert_eq!(warnings, Vec::<String>::new());
}

#[test]
fn broken_files_are_refused_with_their_line() {
    let folder = tempfile::tempdir().unwrap();
    for (name, contents, problem) in [
        ("short.stl", &b"sol"[..], "the file: it is too short for an STL"),
        ("count.stl", &[b'x'; 100], "bytes are no binary STL of"),
        ("vertex.stl", b"solid\nfacet\nvertex 1 2\n", "line 3: a vertex needs three finite numbers"),
        ("corner.stl", b"solid\nvertex 1 2 3\nendloop\n", "line 3: this facet has 1 corners instead of 3"),
        ("cut.stl", b"solid\nvertex 1 2 3\n", "the end of the file: the last facet is not complete"),
        ("index.obj", b"v 0 0 0\nf 1 1 2\n", "line 2: a face needs three or more vertices that are there"),
        ("zero.obj", b"v 0 0 0\nf 0 1 1\n", "line 2: a face needs"),
        ("line.obj", b"v 0 0 0\nf 1 1\n", "line 2: a face needs"),
        ("text.obj", b"v 0 0 0\n\xff", "it holds no triangle"),
        (
            "cr.obj",
            b"v 0 0 0\rv 1 0 0\rv 0 1 0\rf 1 2 3\r",
            "line 1: its lines end in a carriage return alone",
        ),
        ("far.obj", b"v 0 0 1e13\n", "line 1: the vertex [0.0, 0.0, 10000000000000.0] mm is out of range"),
        ("before.stl", b"solid\nvertex 1 2 3\nfacet\n", "line 3: the facet before has no end"),
        ("four.stl", b"solid\nvertex 1 2 3 4\n", "line 2: the number 4 belongs to no vertex"),
        ("comma.stl", b"solid\nvertex 1,0 2 3\n", "line 2: a vertex needs three finite numbers"),
        ("nan.stl", &nan_corner(), "facet 2: a vertex needs three finite numbers, and has [NaN, 5.0, 6.0]"),
        (
            "half.stl",
            b"solid\nfacet\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n",
            "the file ends without `endsolid` and its mesh has 3 open edges",
        ),
        ("nan.obj", b"v 0 0 nan\n", "line 1: a vertex needs three finite numbers"),
        ("empty.obj", b"v 0 0 0\n", "it holds no triangle; nsq_gpu.surfaces[0].shape.path names it"),
        ("truncated.stl", &[&b"solid"[..], &[0; 80]].concat(), "85 bytes are no binary STL of"),
        ("comb.obj", COMB.as_bytes(), "line 13: this face of 12 corners cannot be cut into a fan"),
    ] {
        std::fs::write(folder.path().join(name), contents).unwrap();
        let shape = format!(r#"{{"type": "mesh", "path": "{name}"}}"#);
        let message = lowered(&[shape], Some(folder.path())).unwrap_err().to_string();
        assert!(message.contains(name) && message.contains(problem), "{name}: {message}");
    }
    let missing = lowered(&[r#"{"type": "mesh", "path": "missing.stl"}"#.into()], Some(folder.path()));
    let missing = missing.unwrap_err().to_string();
    assert!(
        missing.contains("missing.stl") && missing.contains("nsq_gpu.surfaces[0].shape.path names it"),
        "{missing}"
    );
}
