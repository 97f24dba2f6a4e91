//! Faces in one place: a ray meets each of them once, in the order that a vanishing gap would give.
//!
//! Each pair of kinds stands in 50 random frames, once in contact and once with a gap of 1e-6 mm, with the same draws. In f64
//! and df64 every ray must then end in the same place; in f32 the flux must agree.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod zoo;

use glam::{DMat3, DVec3, EulerRot};
use nsq_gpu::TraceOptions;
use nsq_gpu::model::{
    Annulus, Collimated, Conic, Detector, DetectorKind, Extended, FarField, Frame, Frustum, Interaction,
    Medium, Mesh, MeshId, Outline, PixelGrid, Point, RayDatabase, Sampling, SceneIr, Shape, Source,
    SourceKind, Spectrum, Sphere, Splat, Surface,
};
use nsq_gpu::program::Precision;
use nsq_gpu::result::{DetectorData, Tally, TraceResult};
use zoo::draws::Draws;

const TIERS: [Precision; 3] = [Precision::F32, Precision::Df64, Precision::F64];
const NUM_FRAMES: usize = 50;
const GAP: f64 = 1e-6;

const VACUUM: usize = 0;
const GLASS: usize = 1;
const FLINT: usize = 2;

/// Meshes of [`scene`].
const SHEET: usize = 0;
const TURNED_SHEET: usize = 1;
const DOUBLED_SHEET: usize = 2;
const TUBE: usize = 3;

impl Draws {
    fn rotation(&mut self) -> DMat3 {
        let [a, b, c] = [(); 3].map(|()| self.between(-3.0, 3.0));
        DMat3::from_euler(EulerRot::XYZ, a, b, c)
    }
}

fn at(z: f64) -> Frame {
    Frame { origin: DVec3::new(0.0, 0.0, z), rotation: DMat3::IDENTITY }
}

fn within(outer: &Frame, inner: &Frame) -> Frame {
    Frame { origin: outer.rotation * inner.origin + outer.origin, rotation: outer.rotation * inner.rotation }
}

fn face(name: &str, frame: Frame, shape: Shape, front: usize, back: usize) -> Surface {
    Surface {
        name: name.into(),
        frame,
        shape,
        interaction: Interaction::Refractive,
        coating: None,
        scatter: None,
        front,
        back,
    }
}

fn mirror(frame: Frame, shape: Shape, reflectance: f64) -> Surface {
    let interaction = Interaction::Reflective { reflectance: vec![reflectance] };
    Surface { interaction, ..face("mirror", frame, shape, VACUUM, VACUUM) }
}

fn absorber(frame: Frame, shape: Shape) -> Surface {
    Surface { interaction: Interaction::Absorbing, ..face("absorber", frame, shape, VACUUM, VACUUM) }
}

fn rays(name: &str, frame: Frame, size: f64) -> Detector {
    let kind = DetectorKind::RayDatabase(RayDatabase { width: size, height: size, max_rays: None });
    Detector { name: name.into(), frame, kind, absorb: true }
}

fn screen(name: &str, frame: Frame, size: f64, absorb: bool) -> Detector {
    let grid = PixelGrid { width: size, height: size, num_pixels_x: 4, num_pixels_y: 4, splat: Splat::Hard };
    Detector { name: name.into(), frame, kind: DetectorKind::Irradiance(grid), absorb }
}

fn lamp(frame: Frame, kind: SourceKind, medium: usize) -> Source {
    Source {
        name: "lamp".into(),
        frame,
        kind,
        total_flux: 1.0,
        spectrum: Spectrum { wavelengths: vec![0], cdf: vec![1.0] },
        medium,
    }
}

/// A rectangle at z = 0 whose normal is +z, or, turned, -z.
fn sheet(faces: &[[u32; 3]]) -> Mesh {
    let corners = [(-6.0, -6.5), (7.0, -6.0), (6.5, 7.0), (-7.0, 6.0)];
    Mesh { vertices: corners.map(|(x, y)| DVec3::new(x, y, 0.0)).to_vec(), faces: faces.to_vec() }
}

/// A square tube along z without ends, of so many mm, whose walls look outwards.
fn tube(side: f64, length: f64) -> Mesh {
    let ring = |z: f64| {
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(x, y)| DVec3::new(0.5 * side * x, 0.5 * side * y, z))
    };
    let vertices = [ring(-0.5 * length), ring(0.5 * length)].concat();
    let wall = |i: u32| {
        let j = (i + 1) % 4;
        [[i, j, j + 4], [i, j + 4, i + 4]]
    };
    Mesh { vertices, faces: (0..4).flat_map(wall).collect() }
}

fn scene(surfaces: Vec<Surface>, sources: Vec<Source>, detectors: Vec<Detector>) -> SceneIr {
    let medium =
        |name: &str, n: f64| Medium { name: name.into(), ambient: n == 1.0, n: vec![n], k: vec![0.0] };
    let two = [[0, 1, 2], [0, 2, 3]];
    let turned = two.map(|[a, b, c]| [a, c, b]);
    SceneIr {
        wavelengths: vec![0.55],
        media: vec![medium("vacuum", 1.0), medium("glass", 1.5), medium("flint", 1.8)],
        surfaces,
        meshes: vec![
            sheet(&two),
            sheet(&turned),
            // Twice, and the second time cut along the other diagonal.
            sheet(&[two[0], two[1], [1, 2, 3], [1, 3, 0]]),
            tube(1.0, 1000.0),
        ],
        sources,
        detectors,
        sampling: Sampling { rr_start_flux: 0.0, ..Sampling::default() },
        scatter_sampling: Vec::new(),
        allowed: Default::default(),
    }
}

fn options(num_rays: u64, precision: Precision) -> TraceOptions {
    zoo::tuned(TraceOptions { max_depth: 64, ..zoo::options(num_rays, 3, precision) })
}

/// As commands trace: lavapipe of Mesa 22.3 falls over these scenes where every access to memory is checked.
fn trace(ir: &SceneIr, options: &TraceOptions) -> Tally {
    zoo::trace_on(zoo::unchecked_gpu(), ir, options)
}

fn result(ir: &SceneIr, options: &TraceOptions) -> TraceResult {
    zoo::result_of(ir, options, &trace(ir, options))
}

fn flux(result: &TraceResult, name: &str) -> f64 {
    result.detectors.iter().find(|detector| detector.name == name).unwrap().total_flux
}

/// How two faces meet: their shapes and places, and which way the second one moves away.
struct Pair {
    name: &'static str,
    first: (Frame, Shape),
    second: (Frame, Shape),
    /// The second with a gap.
    apart: (Frame, Shape),
    /// Where light starts and where it goes, inside of the first face.
    source: Frame,
    /// A detector beyond, and one behind the source.
    beyond: Frame,
    behind: Frame,
    /// The second face's normal looks back at the first.
    turned: bool,
}

fn pairs() -> Vec<Pair> {
    let disk = |radius: f64| Shape::Conic(Conic { curvature: 0.0, conic: 0.0, aperture_radius: radius });
    let bent = |radius: f64| Shape::Conic(Conic { curvature: 0.05, conic: 0.0, aperture_radius: radius });
    let parabola =
        |radius: f64| Shape::Conic(Conic { curvature: -0.04, conic: -1.0, aperture_radius: radius });
    let rectangle = Shape::Plane(Outline::Rectangle { width: 13.0, height: 12.0 });
    let ring = |z_offset: f64| Shape::Annulus(Annulus { inner_radius: 1.0, outer_radius: 9.0, z_offset });
    let along_z = |name: &'static str, first: Shape, second: Shape| Pair {
        name,
        first: (at(0.0), first),
        second: (at(0.0), second.clone()),
        apart: (at(GAP), second),
        source: at(-5.0),
        beyond: at(6.0),
        behind: at(-9.0),
        turned: false,
    };
    let ball = Shape::Sphere(Sphere { radius: 20.0, aperture_radius: Some(6.0) });
    let sideways = |x: f64| Frame {
        origin: DVec3::new(x, 0.0, 0.0),
        rotation: DMat3::from_rotation_y(std::f64::consts::FRAC_PI_2),
    };
    let around = |name: &'static str, shape: fn(f64) -> Shape, wider: f64| Pair {
        name,
        first: (at(0.0), shape(5.0)),
        second: (at(0.0), shape(5.0)),
        apart: (at(0.0), shape(5.0 + wider)),
        source: sideways(0.0),
        beyond: sideways(9.0),
        behind: sideways(-12.0),
        turned: false,
    };
    vec![
        along_z("disk and rectangle", disk(7.0), rectangle.clone()),
        along_z("disk and ring", disk(7.0), ring(0.0)),
        along_z("ring and plane", ring(0.0), Shape::Plane(Outline::Disk { radius: 12.0 })),
        along_z("two spherical faces", bent(7.0), bent(6.0)),
        along_z("two paraboloids", parabola(6.0), parabola(7.0)),
        Pair {
            second: (at(20.0), ball.clone()),
            apart: (at(20.0 + GAP), ball.clone()),
            ..along_z("a spherical face and a ball", bent(7.0), ball)
        },
        around(
            "two cylinders",
            |radius| Shape::Frustum(Frustum { r_front: radius, r_back: radius, z_front: -8.0, z_back: 8.0 }),
            GAP,
        ),
        around(
            "two cones",
            |radius| {
                Shape::Frustum(Frustum {
                    r_front: radius - 1.6,
                    r_back: radius + 1.6,
                    z_front: -8.0,
                    z_back: 8.0,
                })
            },
            GAP,
        ),
        along_z("a mesh on a disk", Shape::Mesh(MeshId(SHEET)), disk(7.0)),
        along_z("a rectangle on a mesh", rectangle, Shape::Mesh(MeshId(SHEET))),
        along_z("two meshes", Shape::Mesh(MeshId(SHEET)), Shape::Mesh(MeshId(SHEET))),
        Pair {
            turned: true,
            ..along_z(
                "two meshes face to face",
                Shape::Mesh(MeshId(SHEET)),
                Shape::Mesh(MeshId(TURNED_SHEET)),
            )
        },
    ]
}

/// The pair in many frames, each with its own light; or apart. The second face is one of glass, of flint, or a mirror, by
/// turns, and stands first in the list in every second frame.
fn stations(pair: &Pair, is_apart: bool) -> SceneIr {
    let mut draws = Draws(7);
    let (mut surfaces, mut sources, mut detectors) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..NUM_FRAMES {
        let place = [(); 3].map(|()| draws.between(-10.0, 10.0));
        let frame = Frame {
            origin: DVec3::from(place) + DVec3::new(80.0 * (i as f64 - 25.0), 0.0, 0.0),
            rotation: draws.rotation(),
        };
        let (place, shape) = if is_apart { pair.apart.clone() } else { pair.second.clone() };
        let place = within(&frame, &place);
        let second = match (i % 3, pair.turned) {
            (0, false) => face("second", place, shape, VACUUM, GLASS),
            (0, true) => face("second", place, shape, GLASS, VACUUM),
            (1, false) => face("second", place, shape, VACUUM, FLINT),
            (1, true) => face("second", place, shape, FLINT, VACUUM),
            _ => mirror(place, shape, 1.0),
        };
        let first = face("first", within(&frame, &pair.first.0), pair.first.1.clone(), GLASS, VACUUM);
        surfaces.extend(if i.is_multiple_of(2) { [second, first] } else { [first, second] });
        let cone = SourceKind::Point(Point { half_angle: 0.35 });
        sources.push(lamp(within(&frame, &pair.source), cone, GLASS));
        detectors.push(rays("beyond", within(&frame, &pair.beyond), 30.0));
        detectors.push(rays("behind", within(&frame, &pair.behind), 30.0));
    }
    scene(surfaces, sources, detectors)
}

/// The detector, the ray's id, and where the ray arrived.
type Row = (usize, u64, [f64; 3]);

/// All rows of all detectors.
fn rows(result: &TraceResult) -> Vec<Row> {
    let mut rows = Vec::new();
    for (i, detector) in result.detectors.iter().enumerate() {
        let DetectorData::RayDatabase(database) = &detector.data else { continue };
        let columns = database.columns().unwrap();
        for (k, &id) in columns.ray_id.iter().enumerate() {
            rows.push((i, id, [0, 1, 2].map(|axis| columns.position[axis][k])));
        }
    }
    rows
}

fn compare_with_a_gap(name: &str, tiers: &[Precision]) {
    let pairs = pairs();
    let pair = pairs.iter().find(|pair| pair.name == name).unwrap();
    let num_rays = 10_000;
    for &precision in zoo::in_turn(tiers) {
        let what = format!("{name}, {precision:?}");
        let [together, apart] = [false, true].map(|is_apart| {
            let ir = stations(pair, is_apart);
            zoo::result_of(&ir, &options(num_rays, precision), &trace(&ir, &options(num_rays, precision)))
        });
        let hits = |result: &TraceResult, name: &str| -> f64 {
            let named = result.detectors.iter().filter(|detector| detector.name == name);
            named.map(|detector| detector.num_rays_hit as f64).sum()
        };
        let beyond = [&together, &apart].map(|result| hits(result, "beyond"));
        let seen = beyond[1] + hits(&apart, "behind");
        assert!(seen > 0.6 * num_rays as f64, "{what}: the detectors see {seen} rays");
        if precision == Precision::F32 {
            let share = beyond[1] / num_rays as f64;
            let sigma = (2.0 * num_rays as f64 * share * (1.0 - share)).sqrt();
            assert!((beyond[0] - beyond[1]).abs() <= 4.0 * sigma, "{what}: {beyond:?}");
            continue;
        }
        let [got, expected] = [rows(&together), rows(&apart)];
        // A ray that goes to and fro in a gap of 1e-6 mm is moved by so much each time, and more where it grazes.
        let differs = |(a, b): &(&Row, &Row)| {
            let moved = a.2.iter().zip(b.2).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max);
            a.0 != b.0 || a.1 != b.1 || moved > 1e-4
        };
        assert_eq!(got.len(), expected.len(), "{what}");
        let other = got.iter().zip(&expected).find(differs);
        assert_eq!(other, None, "{what}: a ray ends elsewhere");
    }
}

macro_rules! pairs {
    ($($test:ident: $name:literal, $tiers:expr;)*) => {$(
        #[test]
        fn $test() {
            compare_with_a_gap($name, &$tiers);
        }
    )*};
}

const TWO_TIERS: [Precision; 2] = [Precision::F32, Precision::F64];

pairs! {
    a_disk_and_a_rectangle_in_contact: "disk and rectangle", TIERS;
    a_disk_and_a_ring_in_contact: "disk and ring", TWO_TIERS;
    a_ring_and_a_plane_in_contact: "ring and plane", TWO_TIERS;
    spherical_faces_in_contact: "two spherical faces", TIERS;
    paraboloids_in_contact: "two paraboloids", TWO_TIERS;
    a_spherical_face_and_a_ball_in_contact: "a spherical face and a ball", TWO_TIERS;
    cylinders_in_contact: "two cylinders", TWO_TIERS;
    cones_in_contact: "two cones", TWO_TIERS;
    a_mesh_in_contact_with_a_disk: "a mesh on a disk", TWO_TIERS;
    a_rectangle_in_contact_with_a_mesh: "a rectangle on a mesh", TWO_TIERS;
    meshes_in_contact: "two meshes", TIERS;
    meshes_face_to_face: "two meshes face to face", TWO_TIERS;
}

/// Flat faces in which detectors and sources lie.
fn flat_shapes() -> Vec<Shape> {
    vec![
        Shape::Conic(Conic { curvature: 0.0, conic: 0.0, aperture_radius: 7.0 }),
        Shape::Plane(Outline::Rectangle { width: 13.0, height: 12.0 }),
        Shape::Plane(Outline::Infinite),
        Shape::Mesh(MeshId(SHEET)),
        Shape::Mesh(MeshId(TURNED_SHEET)),
        Shape::Mesh(MeshId(DOUBLED_SHEET)),
    ]
}

fn random_frame(draws: &mut Draws) -> Frame {
    let place = [(); 3].map(|()| draws.between(-300.0, 300.0));
    Frame { origin: DVec3::from(place), rotation: draws.rotation() }
}

/// As in Optiland, where a detector lies in a surface, the surface alone is met; but nothing passes a mirror.
#[test]
fn a_detector_in_a_surface_reads_nothing_and_changes_nothing() {
    let mut draws = Draws(11);
    for (i, shape) in flat_shapes().into_iter().enumerate() {
        for (turn, precision) in zoo::in_turn(TWO_TIERS.into_iter().enumerate()) {
            let frame = random_frame(&mut draws);
            let kind = (i + turn) % 3;
            let surface = match kind {
                0 => mirror(frame, shape.clone(), 1.0),
                1 => face("glass", frame, shape.clone(), VACUUM, GLASS),
                _ => absorber(frame, shape.clone()),
            };
            let beam = SourceKind::Collimated(Collimated { aperture_radius: 3.0, sigma: None });
            let sources = vec![lamp(within(&frame, &at(-8.0)), beam, VACUUM)];
            let detectors = vec![
                screen("through", within(&frame, &at(9.0)), 60.0, true),
                screen("back", within(&frame, &at(-9.0)), 60.0, true),
                screen("on", frame, 12.0, false),
            ];
            let with = scene(vec![surface], sources, detectors);
            let mut without = with.clone();
            without.detectors.pop();
            let options = options(5_000, precision);
            let [with, without] = [with, without].map(|ir| result(&ir, &options));
            let what = format!("shape {i}, kind {kind}, {precision:?}");
            assert_eq!(flux(&with, "on"), 0.0, "{what}");
            for name in ["through", "back"] {
                assert_eq!(flux(&with, name), flux(&without, name), "{what}: {name}");
            }
            if kind == 0 {
                assert_eq!(flux(&with, "through"), 0.0, "{what}: passes the mirror");
            }
            if kind == 1 {
                let reflected = flux(&with, "back");
                assert!(
                    (reflected - 0.04).abs() < 4.5 * (0.04_f64 * 0.96 / 5_000.0).sqrt(),
                    "{what}: {reflected}"
                );
            }
        }
    }
}

#[test]
fn of_detectors_in_one_place_the_first_alone_reads() {
    let mut draws = Draws(12);
    for precision in zoo::in_turn(TIERS) {
        let frame = random_frame(&mut draws);
        let beam = SourceKind::Collimated(Collimated { aperture_radius: 3.0, sigma: None });
        let sources = vec![lamp(within(&frame, &at(-8.0)), beam, VACUUM)];
        let mut detectors: Vec<Detector> =
            (0..4).map(|i| screen(&format!("{i}"), frame, 12.0 + f64::from(i), false)).collect();
        detectors.push(screen("behind", within(&frame, &at(9.0)), 12.0, true));
        let result = result(&scene(Vec::new(), sources, detectors), &options(5_000, precision));
        let read = ["0", "1", "2", "3", "behind"].map(|name| flux(&result, name));
        assert_eq!(read, [1.0, 0.0, 0.0, 0.0, 1.0], "{precision:?}");
    }
}

/// Of an absorber in another surface, the first in the list is met, from either side.
#[test]
fn of_an_absorber_in_a_surface_the_first_in_the_list_is_met() {
    let mut draws = Draws(13);
    for shape in flat_shapes() {
        let frame = random_frame(&mut draws);
        for side in [-8.0, 8.0] {
            let turn = if side < 0.0 { 0.0 } else { std::f64::consts::PI };
            let start = Frame { rotation: DMat3::from_rotation_x(turn), ..at(side) };
            let beam = SourceKind::Collimated(Collimated { aperture_radius: 3.0, sigma: None });
            let sources = vec![lamp(within(&frame, &start), beam, VACUUM)];
            let back = vec![screen("back", within(&frame, &at(1.1 * side)), 60.0, true)];
            let two = [mirror(frame, shape.clone(), 1.0), absorber(frame, shape.clone())];
            let [first, second] = [[0_usize, 1], [1, 0]].map(|order| {
                let surfaces = order.map(|i| two[i].clone()).to_vec();
                let ir = scene(surfaces, sources.clone(), back.clone());
                flux(&result(&ir, &options(1_000, Precision::F64)), "back")
            });
            assert_eq!([first, second], [1.0, 0.0], "{shape:?} from {side}");
        }
    }
}

/// A lamp on its board: all of the light leaves on the lamp's side.
#[test]
fn a_source_on_a_surface_leaves_it() {
    let mut draws = Draws(14);
    let mut shapes: Vec<(Frame, Shape)> = flat_shapes().into_iter().map(|shape| (at(0.0), shape)).collect();
    // A point on the top of a ball, and on a bent mirror's vertex.
    shapes.push((at(-5.0), Shape::Sphere(Sphere { radius: 5.0, aperture_radius: None })));
    shapes.push((at(0.0), Shape::Conic(Conic { curvature: -0.05, conic: 0.0, aperture_radius: 6.0 })));
    for (i, (place, shape)) in shapes.into_iter().enumerate() {
        for precision in zoo::in_turn(TWO_TIERS) {
            let in_tables = (i % 2 == 0) == (precision == Precision::F32);
            {
                let frame = random_frame(&mut draws);
                let area = Outline::Rectangle { width: 1.0, height: 2.0 };
                let kind = match i {
                    0..6 => SourceKind::Extended(Extended { area, half_angle: std::f64::consts::FRAC_PI_2 }),
                    _ => SourceKind::Point(Point { half_angle: 1.5 }),
                };
                let surface = absorber(within(&frame, &place), shape.clone());
                let sky = Detector {
                    kind: DetectorKind::FarField(FarField { num_theta: 3, num_phi: 3, sphere: false }),
                    ..screen("sky", within(&frame, &at(4.0)), 1.0, true)
                };
                let ir = scene(vec![surface], vec![lamp(frame, kind, VACUUM)], vec![sky]);
                let options = TraceOptions { baked: Some(!in_tables), ..options(20_000, precision) };
                let result = result(&ir, &options);
                assert_eq!(result.total_flux_absorbed, 0.0, "shape {i}, {precision:?}, tables: {in_tables}");
                assert_eq!(result.num_rays_absorbed, 0);
            }
        }
    }
}

/// A second facet in the same place adds no matter.
#[test]
fn doubled_facets_are_as_one() {
    let mut draws = Draws(15);
    for precision in zoo::in_turn(TIERS) {
        let frame = random_frame(&mut draws);
        let beam = SourceKind::Collimated(Collimated { aperture_radius: 3.0, sigma: None });
        let read = [SHEET, DOUBLED_SHEET].map(|mesh| {
            let place = within(&frame, &at(2.0));
            let surfaces = vec![
                face("front", frame, Shape::Mesh(MeshId(mesh)), VACUUM, GLASS),
                face("back", place, Shape::Mesh(MeshId(mesh)), GLASS, VACUUM),
            ];
            let sources = vec![lamp(within(&frame, &at(-8.0)), beam.clone(), VACUUM)];
            let detectors = vec![screen("behind", within(&frame, &at(9.0)), 60.0, true)];
            flux(&result(&scene(surfaces, sources, detectors), &options(20_000, precision)), "behind")
        });
        assert_eq!(read[0], read[1], "{precision:?}");
        assert!((read[0] - 12.0 / 13.0).abs() < 0.01, "{read:?}");
    }
}

/// Walls 1,000 times longer than wide: f32 rounds positions to 6e-5 mm there.
#[test]
fn long_thin_walls_do_not_leak() {
    let mut draws = Draws(16);
    for (i, precision) in [Precision::F32, Precision::F32, Precision::F64].into_iter().enumerate() {
        let frame = if i == 0 { at(0.0) } else { random_frame(&mut draws) };
        let tube = mirror(frame, Shape::Mesh(MeshId(TUBE)), 1.0);
        let cone = SourceKind::Point(Point { half_angle: 0.5 });
        let sources = vec![lamp(within(&frame, &at(-499.5)), cone, VACUUM)];
        let ends = [("near", -500.0), ("far", 500.0)]
            .map(|(name, z)| screen(name, within(&frame, &at(z)), 1.001, true));
        let options = TraceOptions { max_depth: 4_000, ..options(10_000, precision) };
        let result = result(&scene(vec![tube], sources, ends.to_vec()), &options);
        assert_eq!(result.num_rays_escaped, 0, "{precision:?} in frame {i}");
        assert_eq!(flux(&result, "near") + flux(&result, "far"), 1.0, "{precision:?} in frame {i}");
    }
}

/// One mesh with two bodies in touch is two plates in touch.
#[test]
fn bodies_of_one_mesh_in_touch_are_crossed_as_two() {
    let cuboid = |low: f64, high: f64, first: u32| {
        let corner = |i: u32| {
            let side = |bit: u32| if i >> bit & 1 == 0 { -10.0 } else { 10.0 };
            DVec3::new(side(0), side(1), if i < 4 { low } else { high })
        };
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let faces = quads.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]);
        let vertices: Vec<DVec3> = (0..8).map(corner).collect();
        (vertices, faces.map(|face| face.map(|i: u32| i + first)).collect::<Vec<_>>())
    };
    let ((mut vertices, mut faces), (more, others)) = (cuboid(-3.0, 0.0, 0), cuboid(0.0, 3.0, 8));
    vertices.extend(more);
    faces.extend(others);
    let mut draws = Draws(17);
    // Four boundaries of reflectance R = 0.04 at normal incidence: (1 - R) / (1 + 3 R) (Stokes).
    let transmitted = 0.96 / 1.12;
    for precision in zoo::in_turn(TWO_TIERS) {
        let frame = random_frame(&mut draws);
        let bodies = face("bodies", frame, Shape::Mesh(MeshId(0)), GLASS, VACUUM);
        let beam = SourceKind::Collimated(Collimated { aperture_radius: 3.0, sigma: None });
        let sources = vec![lamp(within(&frame, &at(-8.0)), beam, VACUUM)];
        let detectors = vec![screen("behind", within(&frame, &at(9.0)), 60.0, true)];
        let mut ir = scene(vec![bodies], sources, detectors);
        ir.meshes = vec![Mesh { vertices: vertices.clone(), faces: faces.clone() }];
        let read = flux(&result(&ir, &options(20_000, precision)), "behind");
        let sigma = (transmitted * (1.0 - transmitted) / 20_000.0_f64).sqrt();
        assert!((read - transmitted).abs() < 4.5 * sigma, "{precision:?}: {read}");
    }
}

/// Mirrors on a black board in their plane: each is met or hidden by its own place in the list.
#[test]
fn tiles_on_a_board_go_by_the_list_one_by_one() {
    let tile = |x: f64| {
        let frame = Frame { origin: DVec3::new(x, 0.0, 0.0), rotation: DMat3::IDENTITY };
        mirror(frame, Shape::Plane(Outline::Rectangle { width: 8.0, height: 8.0 }), 1.0)
    };
    let board = absorber(at(0.0), Shape::Plane(Outline::Rectangle { width: 40.0, height: 40.0 }));
    let surfaces = vec![tile(-5.0), board, tile(5.0)];
    for (x, reflected) in [(-5.0, 1.0), (5.0, 0.0)] {
        let start = Frame { origin: DVec3::new(x, 0.0, -8.0), rotation: DMat3::IDENTITY };
        let beam = SourceKind::Collimated(Collimated { aperture_radius: 3.0, sigma: None });
        let sources = vec![lamp(start, beam, VACUUM)];
        let detectors = vec![screen("back", at(-9.0), 60.0, true)];
        let ir = scene(surfaces.clone(), sources, detectors);
        assert_eq!(flux(&result(&ir, &options(1_000, Precision::F64)), "back"), reflected, "at {x}");
    }
}

/// A far-field detector has a radius of 1e6 mm: what f32 rounds there is nothing to a lamp 3 mm off a mirror.
#[test]
fn far_fields_blur_nothing_near() {
    let sky = |z: f64| Detector {
        kind: DetectorKind::FarField(FarField { num_theta: 3, num_phi: 3, sphere: false }),
        ..screen("sky", at(z), 1.0, false)
    };
    let reflector = mirror(at(0.0), Shape::Plane(Outline::Rectangle { width: 20.0, height: 20.0 }), 1.0);
    let beam = SourceKind::Collimated(Collimated { aperture_radius: 3.0, sigma: None });
    let lamps = vec![
        lamp(at(0.0), SourceKind::Point(Point { half_angle: 0.1 }), VACUUM),
        lamp(at(-3.0), beam, VACUUM),
    ];
    let detectors = vec![screen("back", at(-4.0), 60.0, true), sky(-50.0), sky(-50.0), sky(60.0)];
    for precision in zoo::in_turn(TWO_TIERS) {
        let traced = result(
            &scene(vec![reflector.clone()], lamps.clone(), detectors.clone()),
            &options(2_000, precision),
        );
        assert_eq!(flux(&traced, "back"), 1.0, "{precision:?}");
    }
}

/// The planted error: without the memory of what was passed, light goes through a mirror or meets faces again.
#[test]
fn a_ray_that_forgets_what_it_passed_is_noticed() {
    let pairs = pairs();
    let pair = pairs.iter().find(|pair| pair.name == "disk and rectangle").unwrap();
    let ir = stations(pair, false);
    let options = options(5_000, Precision::F64);
    let right = zoo::trace(&ir, &options);
    for (before, after) in [
        ("(*ray).below_it = select(before, passed, forward == came_forward);", ""),
        ("let bounds = select(2u, select(1u, 0u, is_inner), near == medium);", "let bounds = 0u;"),
        ("return stands_on(here, contact) & is_ahead", "return is_ahead & false"),
    ] {
        let wrong = zoo::edited(&ir, &options, before, after).trace(|_| true).unwrap();
        assert!(wrong != right, "{before}");
    }
}
