//! Checks that the surfaces of a lens close up, by Optiland's two tests. Every sampled point of a rim has a neighbour
//! on another surface's rim. Rays from the centroid leave through an odd number of surfaces.
//!
//! The tests run in the frame of the compound, while Optiland's run in global coordinates. The verdict is the same
//! near the origin, and does not drown in rounding far from it.

use glam::DVec3;

use crate::model::Shape;

/// Largest gap between a rim point and its nearest neighbour \[mm\].
const GAP_TOLERANCE: f64 = 1e-6;
/// Points per rim.
const RIM_SAMPLES: usize = 64;
/// Crossings after which a ray is given up.
const MAX_CROSSINGS: usize = 64;
/// How far a ray is moved past a surface that it crossed \[mm\].
const NUDGE: f64 = 1e-6;
/// Closest hit that counts \[mm\].
const MIN_DISTANCE: f64 = 1e-9;

/// Global directions in which the parity of crossings is tested: the rows of
/// `numpy.random.default_rng(0).normal(size=(8, 3))`, normalised, which are Optiland's.
const DIRECTIONS: [DVec3; 8] = [
    DVec3::new(0.18881711923692265, -0.19839032737660414, 0.9617636786063786),
    DVec3::new(0.16021416297716448, -0.818128926665578, 0.5522648652001644),
    DVec3::new(0.7415052042025201, 0.5385471155343273, -0.4001712589507583),
    DVec3::new(-0.8967022761251738, -0.4416644114201207, 0.029284393059288184),
    DVec3::new(-0.8784069177470692, -0.08266045905288898, -0.4707106705432322),
    DVec3::new(-0.7583158229918717, -0.5636195521419911, -0.32755169522293953),
    DVec3::new(0.3648617673568587, 0.9240647543268903, -0.11393077078653183),
    DVec3::new(0.8759982916180951, -0.4264361324882868, 0.22534244604736822),
];

/// A boundary surface in the compound's frame.
#[derive(Debug, Clone)]
pub(super) struct Face<'a> {
    /// What messages call it.
    pub name: &'a str,
    /// Position of its vertex along the compound's z \[mm\].
    pub z: f64,
    /// Its shape.
    pub shape: Shape,
}

/// Why a boundary is not closed.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Leak {
    /// A rim point of `surface` is `gap` mm from every other rim.
    Gap { surface: String, gap: f64 },
    /// A ray from the centroid crosses the boundary this many times.
    Parity { crossings: usize },
}

/// Checks a boundary; `to_local` turns a global direction into the compound's frame.
pub(super) fn check(boundary: &[Face<'_>], to_local: impl Fn(DVec3) -> DVec3) -> Result<(), Leak> {
    let rims: Vec<Vec<DVec3>> = boundary.iter().map(rim_points).collect();
    for (own, rim) in rims.iter().enumerate() {
        let gap = largest_gap(rim, own, &rims);
        if gap > GAP_TOLERANCE {
            return Err(Leak::Gap { surface: boundary[own].name.to_owned(), gap });
        }
    }
    let count: usize = rims.iter().map(Vec::len).sum();
    let centroid = rims.iter().flatten().sum::<DVec3>() / count as f64;
    for direction in DIRECTIONS {
        let crossings = count_crossings(boundary, centroid, to_local(direction));
        if crossings.is_multiple_of(2) {
            return Err(Leak::Parity { crossings });
        }
    }
    Ok(())
}

/// The largest distance from a point of `rim` to its nearest neighbour on any other rim, or 0 if all are met.
fn largest_gap(rim: &[DVec3], own: usize, rims: &[Vec<DVec3>]) -> f64 {
    let others = || rims.iter().enumerate().filter(move |(other, _)| *other != own).map(|(_, points)| points);
    let gap = |(index, point): (usize, &DVec3)| {
        // Rims that meet do so at the same angle: no need to look at all the others.
        let angle = index % RIM_SAMPLES;
        let mut facing = others().flat_map(|points| points.iter().skip(angle).step_by(RIM_SAMPLES));
        if facing.any(|other| point.distance(*other) <= GAP_TOLERANCE) {
            return 0.0;
        }
        others().flatten().map(|other| point.distance(*other)).fold(f64::INFINITY, f64::min)
    };
    rim.iter().enumerate().map(gap).fold(0.0, f64::max)
}

/// Sample points of the rims of a surface: one loop, or two for a ring or a frustum.
fn rim_points(face: &Face<'_>) -> Vec<DVec3> {
    face.shape.rims().into_iter().flat_map(|(radius, z)| circle(radius, face.z + z)).collect()
}

fn circle(radius: f64, z: f64) -> impl Iterator<Item = DVec3> {
    (0..RIM_SAMPLES).map(move |i| {
        let (sin, cos) = (i as f64 * (std::f64::consts::TAU / RIM_SAMPLES as f64)).sin_cos();
        DVec3::new(radius * cos, radius * sin, z)
    })
}

fn count_crossings(boundary: &[Face<'_>], origin: DVec3, direction: DVec3) -> usize {
    let mut at = origin;
    for crossings in 0..MAX_CROSSINGS {
        let nearest =
            boundary.iter().filter_map(|face| hit(face, at, direction)).fold(f64::INFINITY, f64::min);
        if !nearest.is_finite() {
            return crossings;
        }
        at += (nearest + NUDGE) * direction;
    }
    MAX_CROSSINGS
}

/// Distance to the nearest point of a surface along a ray, if it is hit.
fn hit(face: &Face<'_>, origin: DVec3, direction: DVec3) -> Option<f64> {
    let crossings = face.shape.crossings(origin - DVec3::new(0.0, 0.0, face.z), direction);
    crossings.into_iter().filter(|t| *t > MIN_DISTANCE).min_by(f64::total_cmp)
}
