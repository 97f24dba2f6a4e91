//! The tree over all primitives finds what a search of every primitive in turn finds: the same paths and the same bits.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

#[path = "mesh/shapes.rs"]
mod shapes;
mod zoo;

use glam::{DMat3, DVec3, EulerRot};
use nsq_gpu::TraceOptions;
use nsq_gpu::model::{
    Annulus, Conic, Detector, DetectorKind, FarField, Frame, Frustum, Interaction, Medium, MeshId, Outline,
    PixelGrid, Point, ReflectProb, Sampling, SceneIr, Shape, Source, SourceKind, Spectrum, Sphere, Splat,
    Surface,
};
use nsq_gpu::program::Precision;
use nsq_gpu::result::Tally;
use nsq_gpu::run::RecordPaths;
use shapes::{bumpy_ball, cube};
use zoo::draws::Draws;
use zoo::forced::Asked;

const PRECISIONS: [Precision; 2] = [Precision::F32, Precision::F64];

impl Draws {
    fn frame(&mut self, reach: f64) -> Frame {
        let origin = DVec3::from([(); 3].map(|()| self.between(-reach, reach)));
        let [a, b, c] = [(); 3].map(|()| self.between(-3.0, 3.0));
        Frame { origin, rotation: DMat3::from_euler(EulerRot::XYZ, a, b, c) }
    }

    /// The kinds take turns.
    fn shape(&mut self, i: usize) -> Shape {
        let radius = self.between(2.0, 8.0);
        match i % 10 {
            0 => Shape::Conic(Conic { curvature: 0.05, conic: -0.5, aperture_radius: radius }),
            1 => Shape::Conic(Conic { curvature: -0.2, conic: 0.3, aperture_radius: 2.0 * radius }),
            2 => Shape::Conic(Conic { curvature: 0.0, conic: 0.0, aperture_radius: radius }),
            3 => Shape::Plane(Outline::Rectangle { width: radius, height: 2.0 * radius }),
            4 => Shape::Annulus(Annulus { inner_radius: 1.0, outer_radius: radius, z_offset: 3.0 }),
            5 => Shape::Frustum(Frustum { r_front: radius, r_back: 1.0, z_front: -4.0, z_back: 5.0 }),
            6 => Shape::Sphere(Sphere { radius, aperture_radius: None }),
            7 => Shape::Sphere(Sphere { radius: 8.0, aperture_radius: Some(0.5 * radius) }),
            // Seen from its frame the apex is far away: no box.
            8 => Shape::Frustum(Frustum { r_front: 1.0, r_back: radius, z_front: 50.0, z_back: 53.0 }),
            _ => Shape::Mesh(MeshId((self.between(0.0, 2.0) as usize).min(1))),
        }
    }
}

fn surface(frame: Frame, shape: Shape, i: usize) -> Surface {
    let interaction = match i % 3 {
        0 => Interaction::Refractive,
        1 => Interaction::Reflective { reflectance: vec![0.9] },
        _ => Interaction::Absorbing,
    };
    let front = i % 2;
    Surface {
        name: format!("s{i}"),
        frame,
        shape,
        interaction,
        coating: None,
        scatter: None,
        front,
        back: 1 - front,
    }
}

fn screen(frame: Frame, size: f64, absorb: bool) -> Detector {
    let grid =
        PixelGrid { width: size, height: size, num_pixels_x: 32, num_pixels_y: 32, splat: Splat::Hard };
    Detector { name: "screen".into(), frame, kind: DetectorKind::Irradiance(grid), absorb }
}

fn at(x: f64, y: f64, z: f64) -> Frame {
    Frame { origin: DVec3::new(x, y, z), rotation: DMat3::IDENTITY }
}

fn scene(surfaces: Vec<Surface>, detectors: Vec<Detector>) -> SceneIr {
    let medium =
        |name: &str, n: f64| Medium { name: name.into(), ambient: n == 1.0, n: vec![n], k: vec![0.0] };
    let lamp = Source {
        name: "lamp".into(),
        frame: at(0.5, 0.25, 0.0),
        kind: SourceKind::Point(Point { half_angle: 3.15 }),
        total_flux: 1.0,
        spectrum: Spectrum { wavelengths: vec![0], cdf: vec![1.0] },
        medium: 0,
    };
    SceneIr {
        wavelengths: vec![0.55],
        media: vec![medium("vacuum", 1.0), medium("glass", 1.5)],
        surfaces,
        meshes: vec![cube(6.0), bumpy_ball(1, 4.0)],
        sources: vec![lamp],
        detectors,
        sampling: Sampling { reflect_prob: ReflectProb::Auto, rr_start_flux: 0.0, ..Sampling::default() },
        scatter_sampling: Vec::new(),
        allowed: Default::default(),
    }
}

/// Surfaces of all kinds at random places within `reach`.
fn random_scene(seed: u64, num_surfaces: usize, reach: f64) -> SceneIr {
    let mut draws = Draws(seed);
    let surfaces =
        (0..num_surfaces).map(|i| surface(draws.frame(reach), draws.shape(i), i / 10 + i)).collect();
    let far_field = DetectorKind::FarField(FarField { num_theta: 9, num_phi: 18, sphere: false });
    let detectors = vec![
        screen(draws.frame(reach), 20.0, false),
        Detector { name: "sky".into(), frame: at(0.0, 0.0, 2.0 * reach), kind: far_field, absorb: true },
    ];
    scene(surfaces, detectors)
}

fn trace_by(ir: &SceneIr, options: &TraceOptions, tree: bool) -> Tally {
    zoo::trace(ir, &TraceOptions { baked: Some(false), tree: Some(tree), ..options.clone() })
}

/// In turn and by the tree, with all paths.
fn assert_same(ir: &SceneIr, num_rays: u64, what: &str) -> Tally {
    let mut last = Tally::default();
    for precision in PRECISIONS {
        let options = TraceOptions { paths: RecordPaths::All, ..zoo::options(num_rays, 7, precision) };
        let [in_turn, by_tree] = [false, true].map(|tree| trace_by(ir, &options, tree));
        let other = in_turn.paths.iter().zip(&by_tree.paths).find(|(a, b)| a != b);
        assert_eq!(other, None, "{what}, {precision:?}");
        assert!(in_turn == by_tree, "{what}, {precision:?}: other sums");
        last = by_tree;
    }
    last
}

#[test]
fn random_scenes_have_the_same_paths() {
    for (seed, num_surfaces, reach) in [(1, 40, 30.0), (2, 150, 60.0), (3, 60, 2e4)] {
        let tally = assert_same(&random_scene(seed, num_surfaces, reach), 4_000, &format!("scene {seed}"));
        let reached = tally.surfaces.iter().filter(|surface| surface.reached).count();
        assert!(reached > num_surfaces / 2 || reach > 1e3, "only {reached} of {num_surfaces} are reached");
    }
}

/// Infinite planes have no box, and send rays far beyond all boxes.
#[test]
fn planes_without_end_have_the_same_paths() {
    let mut ir = random_scene(4, 40, 30.0);
    for (i, z) in [-40.0, 45.0].into_iter().enumerate() {
        ir.surfaces.insert(20 * i, surface(at(0.0, 0.0, z), Shape::Plane(Outline::Infinite), 1));
    }
    ir.detectors.truncate(1);
    assert_same(&ir, 4_000, "planes");
}

/// Flat stacks whose faces touch, cut off in the middle of one another and at detectors: ties and contact everywhere.
#[test]
fn faces_in_contact_have_the_same_paths() {
    let plate = |i: usize, z: f64, radius: f64, interaction: usize| {
        let frame = at(if i.is_multiple_of(2) { 0.0 } else { 3.0 }, 0.0, z);
        surface(
            frame,
            Shape::Conic(Conic { curvature: 0.0, conic: 0.0, aperture_radius: radius }),
            interaction,
        )
    };
    let mut surfaces = Vec::new();
    for layer in 0..12 {
        let z = 2.0 + f64::from(layer / 2);
        surfaces.push(plate(surfaces.len(), z, 10.0, 0));
        surfaces.push(plate(surfaces.len(), z, 6.0, 3));
    }
    let detectors = (0..4).map(|i| screen(at(0.0, 0.0, 2.0 + f64::from(i)), 4.0, false)).collect();
    let mut ir = scene(surfaces, detectors);
    ir.surfaces.push(surface(at(0.0, 0.0, 20.0), Shape::Plane(Outline::Infinite), 2));
    ir.sampling.reflect_prob = ReflectProb::Fresnel;
    assert_same(&ir, 4_000, "contact");
}

/// Of meshes, plates and detectors in one plane the first in the list wins, wherever the tree meets it.
/// Shells in one another are a chain, however they are grouped.
#[test]
fn concentric_shells_have_the_same_paths() {
    let shell = |i: usize| {
        let sphere = Shape::Sphere(Sphere { radius: 5.0 + 0.01 * i as f64, aperture_radius: None });
        let mut shell = surface(at(0.0, 0.0, 0.0), sphere, i);
        shell.interaction = Interaction::Refractive;
        shell
    };
    let sky = DetectorKind::FarField(FarField { num_theta: 9, num_phi: 18, sphere: false });
    let detectors = vec![Detector { name: "sky".into(), frame: at(0.0, 0.0, 40.0), kind: sky, absorb: true }];
    assert_same(&scene((0..400).map(shell).collect(), detectors), 40, "400 shells");
}

#[test]
fn ties_go_to_the_first_in_the_list() {
    let shapes = [
        Shape::Plane(Outline::Rectangle { width: 5.0, height: 5.0 }),
        Shape::Mesh(MeshId(0)),
        Shape::Plane(Outline::Rectangle { width: 4.0, height: 9.0 }),
        Shape::Mesh(MeshId(0)),
    ];
    for first in 0..2 {
        let mut surfaces: Vec<Surface> = (0..40)
            .map(|i| {
                let shape = shapes[(first + i) % shapes.len()].clone();
                // The cube's near face lies in the plane of the plates.
                let z = if matches!(shape, Shape::Mesh(_)) { 11.0 } else { 5.0 };
                surface(at(0.3 * (i / 8) as f64, 0.0, z), shape, 1)
            })
            .collect();
        surfaces.push(surface(at(0.0, 0.0, -5.0), shapes[0].clone(), 1));
        let detectors = vec![screen(at(0.0, 0.0, 5.0), 6.0, false)];
        assert_same(&scene(surfaces, detectors), 2_000, &format!("ties from {first}"));
    }
}

/// One primitive, and none at all.
#[test]
fn the_smallest_trees_work() {
    let ball = surface(at(0.0, 0.0, 9.0), Shape::Sphere(Sphere { radius: 2.0, aperture_radius: None }), 2);
    let plane = surface(at(0.0, 0.0, 9.0), Shape::Plane(Outline::Infinite), 2);
    for surfaces in [vec![], vec![ball.clone()], vec![plane.clone()], vec![ball, plane]] {
        let what = format!("{} surfaces", surfaces.len());
        assert_same(&scene(surfaces, vec![]), 500, &what);
    }
}

/// Processors read trees from images, GPUs from buffers.
#[test]
fn trees_in_buffers_and_in_images_give_the_same_bits() {
    let mut ir = random_scene(5, 400, 100.0);
    ir.meshes[1] = bumpy_ball(4, 4.0);
    for precision in [Precision::F32, Precision::F64] {
        let options = TraceOptions { tree: Some(true), ..zoo::options(2_000, 1, precision) };
        let traced = [("var<storage, read> tree_rows", 0), ("var tree_rows: texture", u64::MAX)].map(
            |(declaration, texel_bytes)| {
                let options = options.with(|overrides| overrides.texel_bytes = Some(texel_bytes));
                let mut tracer = options.tracer(zoo::gpu(), &ir).unwrap();
                assert!(tracer.program().wgsl.contains(declaration));
                tracer.trace(|_| true).unwrap()
            },
        );
        assert!(traced[0] == traced[1], "{precision:?}");
        assert!(traced[0] == trace_by(&ir, &options, false), "{precision:?}: not what the list finds");
    }
}

/// What the slack is for: without it, rays along the faces of boxes are lost.
#[test]
fn boxes_without_slack_are_noticed() {
    let ir = random_scene(6, 150, 60.0);
    let options =
        TraceOptions { tree: Some(true), paths: RecordPaths::All, ..zoo::options(20_000, 7, Precision::F32) };
    let [wide, narrow] = ["TREE_SLACK", "-0.01"]
        .map(|slack| format!("box_ray(position, vec3<f32>(ray.direction), {slack} * size)"));
    let lossy = zoo::edited(&ir, &options, &wide, &narrow).trace(|_| true).unwrap();
    assert!(lossy != trace_by(&ir, &options, true));
}
