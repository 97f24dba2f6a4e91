//! Cheap tests that prove a ray segment misses a primitive, without the root and quotient of an intersection
//! (`shaders/cpu/path/miss_tests.wgsl`).
//!
//! Each miss test is sufficient: where it holds, the search finds nothing on the segment, whatever the search rounds.
//! Along a ray a quadric is F(t) = a t^2 + 2 g t + f. Let S be the largest length on the segment, and let M be
//! `|radial| S^2 + |axial| S^2 + 2 |offset| S + |constant|`. What the search takes for a crossing at t has an |F(t)| of
//! a few roundings of M. The reason is that both quotients of the citardauq formula are backward stable (Higham,
//! Accuracy and Stability of Numerical Algorithms, 2nd ed., section 1.8). So an |F| of [`ROUNDINGS`] roundings all
//! along the segment shows that the segment holds no crossing.

use crate::cpu::path::sampled_path::SampledPath;
use crate::model::shapes::{Quadric, Slab};
use crate::model::{Frame, Shape, ShapeKind};
use crate::program::Precision;
use glam::DVec3;

/// A miss test leaves room for so many roundings of M. The search makes some fifty. A test at the far end of a segment
/// makes some ten times as many. The segment's length may be 6 S, twice S at the highest of [`PACES`].
const ROUNDINGS: f64 = 1024.0;

/// How far rays may go, at most, while they go 1 along z ([`Exit::pace`]): the least that nearly all keep to is taken.
const PACES: [f64; 3] = [1.05, 1.5, 3.0];

/// A test that proves, in the primitive's frame, that a segment of a ray misses the primitive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MissTest {
    /// What proves it.
    pub sign: Sign,
    /// Where the segment ends. `None`: at the next event.
    pub exit: Option<Exit>,
}

/// What proves that a segment misses a primitive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sign {
    /// The ray leaves the primitive's quadric, whose other crossing lies behind it or beyond the segment.
    Leaves,
    /// Both ends of the segment lie before the slab that holds the primitive, or both behind it.
    Beside {
        /// Where the slab begins in z \[mm\].
        low: f64,
        /// Where it ends \[mm\].
        high: f64,
    },
    /// The ray is beyond its exit from the beginning.
    Past,
    /// Both ends are nearer to the axis than what the primitive leaves open, and so is all between them.
    Inside {
        /// The squared radius \[mm^2\].
        limit: f64,
    },
    /// On the whole segment the quadric is farther from 0 than this.
    Off {
        /// In units of the quadric.
        margin: f64,
    },
}

/// Where a ray that crosses the slab around a primitive leaves it for good.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exit {
    /// Where the slab ends, as the ray goes, in z \[mm\].
    pub plane: f64,
    /// The ray goes at most so far while it goes 1 along z; negative where it goes against z.
    pub pace: f64,
}

/// A segment of a ray, from one event to the next \[mm\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Where it begins.
    pub from: DVec3,
    /// Where it ends.
    pub to: DVec3,
}

/// F(t) = a t^2 + 2 g t + f along a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Along {
    a: f64,
    g: f64,
    f: f64,
}

impl MissTest {
    /// The cheapest test of a primitive that holds for nearly all profiled rays. `None` if no test does. `ends`: the
    /// segment ends at the next event; otherwise it ends nowhere. `leaving`: the segment begins on the primitive.
    /// `size` \[mm\] is the largest distance of a box's corner from the frame's origin. The box is the segment's,
    /// because what a ray meets beyond lies behind the event. For a segment that ends nowhere, `size` covers the
    /// primitive's box, too.
    pub fn of(
        (frame, shape): &(Frame, Shape),
        leaving: bool,
        ends: bool,
        size: f64,
        precision: Precision,
        profiled: &mut ProfiledRays,
    ) -> Option<Self> {
        let epsilon = 1.0 / precision.significands();
        let slab = slab(shape, size, ROUNDINGS * epsilon);
        let [low, high] = slab.unwrap_or([f64::NAN; 2]);
        let size = if slab.is_some() { size.max(low.abs()).max(high.abs()) } else { size };
        let largest = magnitude(shape, size);
        let margin = ROUNDINGS * epsilon * largest;
        // An f32 may not hold the terms of a huge quadric.
        let is_curved = shape.quadric().is_some_and(|quadric| !quadric.is_flat());
        let has_quadric = is_curved && largest < f64::from(f32::MAX);
        let inside = shape.opening().map(|radius| Sign::Inside {
            limit: radius * radius - margin - ROUNDINGS * epsilon * (size * size + radius * radius),
        });
        let beside = slab.map(|[low, high]| Sign::Beside { low, high });
        let signs = match leaving {
            true => [has_quadric.then_some(Sign::Leaves), None, None, None],
            false => {
                let off = has_quadric.then_some(Sign::Off { margin });
                [beside.filter(|_| ends), (!ends).then_some(Sign::Past), inside, off]
            }
        };
        let mut miss_tests = signs.into_iter().flatten().flat_map(|sign| {
            let to_end = ends.then_some(None);
            to_end.into_iter().chain(exits(sign, slab).map(Some)).map(move |exit| MissTest { sign, exit })
        });
        miss_tests.find(|miss_test| profiled.takes(frame, |segment| miss_test.holds(shape, segment)))
    }

    /// Whether the test holds for a segment in the primitive's frame, as the shader's functions would find but for roundings.
    fn holds(&self, shape: &Shape, segment: &Segment) -> bool {
        let (direction, length) = segment.direction_and_length();
        if length.is_nan() || length <= 0.0 {
            return false;
        }
        let distance = match self.exit {
            None => length,
            Some(exit) if exit.is_kept_to(direction) => exit.distance(segment.from),
            Some(_) => return false,
        };
        self.sign.holds(shape, segment.from, direction, distance)
    }
}

impl Sign {
    fn holds(&self, shape: &Shape, from: DVec3, direction: DVec3, distance: f64) -> bool {
        let to = from + distance * direction;
        let along = Along::of(shape, from, direction);
        match *self {
            Sign::Leaves => along.leaves(distance),
            Sign::Beside { low, high } => (from.z < low && to.z < low) || (from.z > high && to.z > high),
            Sign::Past => distance <= 0.0,
            Sign::Inside { limit } => [from, to].iter().all(|end| end.truncate().length_squared() < limit),
            Sign::Off { margin } => along.stays_off(margin, distance),
        }
    }
}

impl Exit {
    fn is_kept_to(&self, direction: DVec3) -> bool {
        direction.z * self.pace >= 1.0
    }

    /// The most that a ray goes to its exit. Not positive for a ray that is beyond.
    fn distance(&self, from: DVec3) -> f64 {
        (self.plane - from.z) * self.pace
    }
}

/// Where rays may leave a slab, as far as it matters for a sign. Exits of rays that keep closest to the slab's normal
/// come first.
fn exits(sign: Sign, slab: Option<[f64; 2]>) -> impl Iterator<Item = Exit> {
    let paces = match sign {
        Sign::Beside { .. } => &[][..],
        // The ray is beyond its exit, so its pace does not count.
        Sign::Past => &PACES[PACES.len() - 1..],
        Sign::Leaves | Sign::Inside { .. } | Sign::Off { .. } => &PACES,
    };
    slab.into_iter().flat_map(move |[low, high]| {
        paces.iter().flat_map(move |&pace| [Exit { plane: high, pace }, Exit { plane: low, pace: -pace }])
    })
}

impl Segment {
    fn within(&self, frame: &Frame) -> Segment {
        let local = |p: DVec3| frame.rotation.transpose() * (p - frame.origin);
        Segment { from: local(self.from), to: local(self.to) }
    }

    fn direction_and_length(&self) -> (DVec3, f64) {
        let way = self.to - self.from;
        let length = way.length();
        (way / length, length)
    }
}

/// Whether nearly all rays end their segments on a conic at the nearer crossing, and are seen to do so
/// (`nearer_conic_distance` in the shader). Nearer is to the point where the ray's line comes closest to the conic's
/// origin.
pub fn end_at_nearer_crossing((frame, shape): &(Frame, Shape), profiled: &mut ProfiledRays) -> bool {
    shape.kind() == ShapeKind::Conic
        && profiled.takes(frame, |segment| ends_at_nearer_crossing(shape, segment))
}

fn ends_at_nearer_crossing(shape: &Shape, segment: &Segment) -> bool {
    let (direction, distance) = segment.direction_and_length();
    let shift = -segment.from.dot(direction);
    let Along { a, g, f } = Along::of(shape, segment.from + shift * direction, direction);
    let q = -(g + (g * g - a * f).sqrt().copysign(g));
    let t = f / q;
    // Profiled rays in f32 have its roundings.
    let is_met = (t + shift - distance).abs() <= 1e-3 * distance;
    let room = (t + shift).abs() + 0.002 * (t.abs() + shift.abs());
    is_met && (2.0 * q - a * (t - shift)).abs() > a.abs() * room
}

/// How nearly all rays come to a shape and go on from it: along its normal, or against it. The normal points to the
/// side of the back medium. `None` where rays differ. A segment without a length, between faces in contact, shows
/// nothing. Then the other segment decides, and rays are assumed to go through.
pub fn sides((frame, shape): &(Frame, Shape), profiled: &mut ProfiledRays) -> Option<[bool; 2]> {
    let all = [[true, true], [false, false], [true, false], [false, true]];
    all.into_iter().find(|&along| {
        profiled.takes_turn(frame, |segments| {
            let place = segments[0].to;
            let slopes = segments.map(|segment| Along::of(shape, place, segment.to - segment.from).g);
            let agrees = |(slope, along): (f64, bool)| if along { slope >= 0.0 } else { slope <= 0.0 };
            slopes != [0.0; 2] && slopes.into_iter().zip(along).all(agrees)
        })
    })
}

/// The profiled rays that take the path, and what was assumed of them.
#[derive(Debug)]
pub struct ProfiledRays<'a> {
    /// The recorded paths of these rays.
    samples: &'a [SampledPath],
    /// The segment that is looked at, by its number.
    pub step: usize,
    /// All that is assumed must hold for this share of the rays.
    least_share: f64,
    /// For each ray, whether all that was assumed so far holds.
    keeps: Vec<bool>,
}

impl<'a> ProfiledRays<'a> {
    /// Rays of which nothing is assumed yet. All that will be assumed must hold for `least_share` of them.
    pub fn new(samples: &'a [SampledPath], least_share: f64) -> Self {
        ProfiledRays { samples, step: 0, least_share, keeps: vec![true; samples.len()] }
    }

    /// Assumes something in the frame of a primitive, if it and all earlier assumptions hold for the least share of the
    /// rays. The result is whether it was assumed.
    pub fn takes(&mut self, frame: &Frame, holds: impl Fn(&Segment) -> bool) -> bool {
        let step = self.step;
        self.takes_of_each(|sample| match sample.positions.get(step..step + 2) {
            Some(&[from, to]) => holds(&Segment { from, to }.within(frame)),
            _ => false,
        })
    }

    /// The same of the segment and the one behind it.
    pub fn takes_turn(&mut self, frame: &Frame, holds: impl Fn([&Segment; 2]) -> bool) -> bool {
        let step = self.step;
        self.takes_of_each(|sample| match sample.positions.get(step..step + 3) {
            Some(&[from, at, to]) => {
                let [before, after] =
                    [Segment { from, to: at }, Segment { from: at, to }].map(|segment| segment.within(frame));
                holds([&before, &after])
            }
            _ => false,
        })
    }

    fn takes_of_each(&mut self, is_so: impl Fn(&SampledPath) -> bool) -> bool {
        let rays = self.keeps.iter().zip(self.samples);
        let keeps: Vec<bool> = rays.map(|(keeps, sample)| *keeps && is_so(sample)).collect();
        let num = keeps.iter().filter(|keeps| **keeps).count();
        let pays = num > 0 && num as f64 >= self.least_share * keeps.len() as f64;
        if pays {
            self.keeps = keeps;
        }
        pays
    }
}

impl Along {
    fn of(shape: &Shape, o: DVec3, d: DVec3) -> Self {
        let Quadric { radial, axial, offset, constant } = quadric(shape);
        let dot = |p: DVec3, q: DVec3| radial * (p.x * q.x + p.y * q.y) + axial * p.z * q.z;
        Along { a: dot(d, d), g: dot(o, d) + offset * d.z, f: dot(o, o) + 2.0 * offset * o.z + constant }
    }

    fn leaves(&self, distance: f64) -> bool {
        let half = 0.2505 * distance * self.a;
        (self.g + half).abs() > half.abs() + 1e-15
    }

    fn stays_off(&self, margin: f64, distance: f64) -> bool {
        let halfway = self.f + distance * self.g;
        let there = halfway + distance * (self.g + self.a * distance);
        let both_off = |x: f64, y: f64| (x + y).abs() > (x - y).abs() + 2.0 * margin;
        both_off(self.f, halfway) && both_off(halfway, there)
    }
}

/// Where a shape that lies between two planes across z begins and ends. No place is farther from the origin than
/// `size`, and `share` of such lengths is the room for roundings. `None` where there are no such planes, or where a rim
/// shows badly where they are.
fn slab(shape: &Shape, size: f64, share: f64) -> Option<[f64; 2]> {
    const LEAST_STEEPNESS: f64 = 0.1;
    let Slab { ends, steepness } = shape.slab()?;
    // A height at a rim is off by what the quadric is off there, over its steepness.
    let size = match steepness {
        None => size,
        Some(steepness) if steepness >= LEAST_STEEPNESS && ends.iter().all(|z| z.is_finite()) => {
            let farthest = size.max(ends[0].abs()).max(ends[1].abs());
            size + magnitude(shape, farthest) / (2.0 * steepness.min(1.0))
        }
        Some(_) => return None,
    };
    let (low, high) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
    let room = share * size.max(low.abs()).max(high.abs());
    let slab = [low - room, high + room];
    slab.iter().all(|z| z.abs() < f64::from(f32::MAX)).then_some(slab)
}

/// M: the largest sum of a quadric's terms within so far of the origin.
fn magnitude(shape: &Shape, size: f64) -> f64 {
    let Quadric { radial, axial, offset, constant } = quadric(shape);
    (radial.abs() + axial.abs()) * size * size + 2.0 * offset.abs() * size + constant.abs()
}

/// The quadric of a shape. A hot path is looked for where every shape has one.
fn quadric(shape: &Shape) -> Quadric {
    shape.quadric().unwrap_or(Quadric::PLANE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Annulus, Conic, Frustum, Sphere};
    use proptest::prelude::*;

    fn point(reach: f64) -> impl Strategy<Value = DVec3> {
        [-reach..reach, -reach..reach, -reach..reach].prop_map(DVec3::from_array)
    }

    fn shape() -> impl Strategy<Value = Shape> {
        prop_oneof![
            (-0.5..0.5f64, -3.0..2.0f64).prop_map(|(curvature, conic)| Shape::Conic(Conic {
                curvature,
                conic,
                aperture_radius: 4.0
            })),
            (1.0..5.0f64).prop_map(|radius| Shape::Sphere(Sphere { radius, aperture_radius: None })),
            (1.0..5.0f64, 1.0..5.0f64).prop_map(|(r_front, r_back)| Shape::Frustum(Frustum {
                r_front,
                r_back,
                z_front: -1.0,
                z_back: 2.0
            })),
        ]
    }

    fn to_the_end(sign: Sign) -> MissTest {
        MissTest { sign, exit: None }
    }

    /// Whether a straight line meets a shape, found by small steps along the line. True if the line crosses the quadric
    /// near a place of the shape.
    fn is_met(shape: &Shape, line: &Segment) -> bool {
        let on_shape = |p: DVec3| {
            if let Shape::Conic(Conic { curvature, conic, aperture_radius }) = *shape {
                1.0 - (1.0 + conic) * curvature * p.z >= 0.0 && p.truncate().length() <= aperture_radius
            } else if let Shape::Frustum(Frustum { z_front, z_back, .. }) = *shape {
                (z_front..=z_back).contains(&p.z)
            } else if let Shape::Annulus(Annulus { inner_radius, outer_radius, .. }) = *shape {
                (inner_radius..=outer_radius).contains(&p.truncate().length())
            } else {
                false
            }
        };
        let at = |i: u32| line.from.lerp(line.to, f64::from(i) / 20_000.0);
        let value = |p: DVec3| Along::of(shape, p, DVec3::Z).f;
        (1..=20_000).any(|i| {
            let (before, here) = (at(i - 1), at(i));
            (value(before) < 0.0) != (value(here) < 0.0) && on_shape(before) && on_shape(here)
        })
    }

    /// The quadric at many places of the segment.
    fn samples(shape: Shape, segment: Segment) -> impl Iterator<Item = f64> {
        let at = move |i| segment.from.lerp(segment.to, f64::from(i) / 1000.0);
        (0..=1000).map(move |i| Along::of(&shape, at(i), DVec3::Z).f)
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn a_segment_that_stays_off_a_quadric_has_no_crossing(
            shape in shape(), from in point(6.0), to in point(6.0), margin in 0.0..0.5f64,
        ) {
            let segment = Segment { from, to };
            if to_the_end(Sign::Off { margin }).holds(&shape, &segment) {
                let is_negative = Along::of(&shape, from, DVec3::Z).f < 0.0;
                for value in samples(shape, segment) {
                    prop_assert!((value < 0.0) == is_negative && value.abs() > 0.99 * margin, "{value}");
                }
            }
        }

        #[test]
        fn a_segment_without_a_crossing_is_seen_to_stay_off(
            shape in shape(), from in point(6.0), to in point(6.0),
        ) {
            let segment = Segment { from, to };
            let no_crossing =
                samples(shape.clone(), segment).all(|f| f > 1e-3) || samples(shape.clone(), segment).all(|f| f < -1e-3);
            let way = to - from;
            let along = Along::of(&shape, from, way.normalize());
            let there = along.g + along.a * way.length();
            // A quadric that bends towards 0 between the ends is not looked at any closer.
            let bends = (along.g < 0.0) != (there < 0.0) && (along.a < 0.0) == (along.f < 0.0);
            let off = to_the_end(Sign::Off { margin: 1e-4 });
            prop_assert!(off.holds(&shape, &segment) || bends || !no_crossing);
        }

        /// What is found as a miss test of one ray proves a miss: far beyond its exit as well, if it has one.
        #[test]
        fn a_miss_test_that_is_found_shows_that_nothing_is_met(
            shape in prop_oneof![
                shape().prop_filter("a ball has no end", |shape| !matches!(shape, Shape::Sphere(Sphere { .. }))),
                (1.0..4.0f64).prop_map(|inner_radius| Shape::Annulus(Annulus {
                    inner_radius, outer_radius: 5.0, z_offset: 0.5,
                })),
            ],
            from in point(6.0), to in point(6.0), ends: bool,
        ) {
            let far = from + 8.0 * (to - from);
            let way = SampledPath { positions: vec![from, to, far], weights: Vec::new() };
            let mut profiled = ProfiledRays::new(std::slice::from_ref(&way), 1.0);
            let frame = Frame { origin: DVec3::ZERO, rotation: glam::DMat3::IDENTITY };
            let found = MissTest::of(&(frame, shape.clone()), false, ends, 11.0, Precision::F64, &mut profiled);
            if let Some(miss_test) = found {
                let until = if miss_test.exit.is_some() { far } else { to };
                prop_assert!(!is_met(&shape, &Segment { from, to: until }), "{miss_test:?}");
                prop_assert!(ends || miss_test.exit.is_some());
            }
        }

        #[test]
        fn a_ray_that_leaves_a_cap_meets_it_nowhere_where_that_is_seen(
            curvature in -0.2..0.2f64, conic in -3.0..1.0f64, x in -3.9..3.9f64, to in point(40.0), ends: bool,
        ) {
            let shape = Shape::Conic(Conic { curvature, conic, aperture_radius: 4.0 });
            let root = (1.0 - (1.0 + conic) * (curvature * x).powi(2)).sqrt();
            prop_assume!(root > 0.0);
            let from = DVec3::new(x, 0.0, curvature * x * x / (1.0 + root));
            let way = SampledPath { positions: vec![from, to], weights: Vec::new() };
            let mut profiled = ProfiledRays::new(std::slice::from_ref(&way), 1.0);
            let frame = Frame { origin: DVec3::ZERO, rotation: glam::DMat3::IDENTITY };
            let found = MissTest::of(&(frame, shape.clone()), true, ends, 70.0, Precision::F64, &mut profiled);
            if found.is_some() {
                // It begins on the cap.
                let start = from.lerp(to, 1e-3);
                prop_assert!(!is_met(&shape, &Segment { from: start, to }), "{found:?}");
            }
        }

        #[test]
        fn a_ray_that_leaves_a_quadric_has_its_other_crossing_elsewhere(
            shape in shape(), from in point(4.0), to in point(6.0),
        ) {
            // On the quadric that its constant makes go through `from`.
            let distance = (to - from).length();
            let along = Along { f: 0.0, ..Along::of(&shape, from, (to - from) / distance) };
            let crossing = -2.0 * along.g / along.a;
            if along.leaves(distance) {
                prop_assert!(!(crossing > 0.0 && crossing <= distance), "{crossing} of {distance}");
            } else {
                prop_assert!(crossing > 0.0 && crossing <= 1.002 * distance, "{crossing} of {distance}");
            }
        }
    }
}
