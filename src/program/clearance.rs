//! How little shows that a ray meets a primitive nowhere on a stretch of its way: without the roots and quotients that
//! it takes to find where a ray meets one (`shaders/lib/clearances.wgsl`).
//!
//! Each clearance is sufficient: where it holds, the search finds nothing on the stretch, whatever it rounds. Along a ray
//! a quadric is F(t) = a t^2 + 2 g t + f, and what the search takes for a crossing at t has an |F(t)| of a few roundings
//! of M = |radial| S^2 + |axial| S^2 + 2 |offset| S + |constant|, where S is the largest length on the stretch: both
//! quotients of the citardauq formula are backward stable (Higham, Accuracy and Stability of Numerical Algorithms, 2nd
//! ed., section 1.8). So an |F| of [`ROUNDINGS`] of them all along the stretch shows that it holds no crossing.

use super::Precision;
use super::features::ShapeKind;
use super::lowered::{gradient, shape_constant};
use super::nominal::Way;
use crate::ir::{Frame, Shape};
use glam::DVec3;

/// A clearance leaves room for so many roundings of M; the search makes some twenty, and what looks at the far end of a
/// stretch, whose length may be twice S, some ten times as many.
const ROUNDINGS: f64 = 1024.0;

/// What is to be seen of a stretch to know that it is clear of a primitive, in the primitive's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Clearance {
    /// The ray leaves the primitive's quadric, whose other crossing lies behind it or beyond the stretch.
    Leaves,
    /// Both ends of the stretch lie before the slab that holds the primitive, or both behind it.
    Beside {
        /// Where the slab begins in z \[mm\].
        low: f64,
        /// Where it ends \[mm\].
        high: f64,
    },
    /// On the whole stretch the quadric is farther from 0 than this.
    Off {
        /// In units of the quadric.
        margin: f64,
    },
}

/// Part of a ray's way, from one event to the next \[mm\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stretch {
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

impl Clearance {
    /// The cheapest one of a primitive that holds for nearly all rays of a pilot, on a stretch no corner of whose box is
    /// farther from the frame's origin than `size` \[mm\]; or none. `leaving` tells that it begins on the primitive.
    pub fn of(
        (frame, shape): &(Frame, Shape),
        leaving: bool,
        size: f64,
        precision: Precision,
        pilot: &mut Pilot,
    ) -> Option<Self> {
        let epsilon = 1.0 / precision.significands();
        let slab = slab(shape).filter(|_| !leaving).map(|[low, high]| {
            let room = ROUNDINGS * epsilon * size;
            Clearance::Beside { low: low - room, high: high + room }
        });
        let largest = magnitude(shape, size);
        // An f32 may not hold the terms of a huge quadric.
        let has_quadric = ShapeKind::of(shape).quadric().is_some() && largest < f64::from(f32::MAX);
        let quadric = has_quadric.then_some(match leaving {
            true => Clearance::Leaves,
            false => Clearance::Off { margin: ROUNDINGS * epsilon * largest },
        });
        let holds = |clearance: &Clearance| pilot.takes(frame, |stretch| clearance.holds(shape, stretch));
        [slab, quadric].into_iter().flatten().find(holds)
    }

    /// Whether a stretch in the primitive's frame is clear, as the shader's functions would find but for roundings.
    fn holds(&self, shape: &Shape, stretch: &Stretch) -> bool {
        let (direction, distance) = stretch.direction_and_length();
        let along = Along::of(shape, stretch.from, direction);
        if distance.is_nan() || distance <= 0.0 {
            return false;
        }
        match *self {
            Clearance::Leaves => along.leaves(distance),
            Clearance::Beside { low, high } => {
                let [from, to] = [stretch.from.z, stretch.to.z];
                (from < low && to < low) || (from > high && to > high)
            }
            Clearance::Off { margin } => along.stays_off(margin, distance),
        }
    }
}

impl Stretch {
    fn within(&self, frame: &Frame) -> Stretch {
        let local = |p: DVec3| frame.rotation.transpose() * (p - frame.origin);
        Stretch { from: local(self.from), to: local(self.to) }
    }

    fn direction_and_length(&self) -> (DVec3, f64) {
        let way = self.to - self.from;
        let length = way.length();
        (way / length, length)
    }
}

/// Whether nearly all rays end their stretches on a conic at the crossing that is nearer to their line's closest approach to
/// its origin, and are seen to do so (`nearer_conic_distance` in the shader).
pub fn end_at_nearer_crossing((frame, shape): &(Frame, Shape), pilot: &mut Pilot) -> bool {
    ShapeKind::of(shape) == ShapeKind::Conic
        && pilot.takes(frame, |stretch| ends_at_nearer_crossing(shape, stretch))
}

fn ends_at_nearer_crossing(shape: &Shape, stretch: &Stretch) -> bool {
    let (direction, distance) = stretch.direction_and_length();
    let shift = -stretch.from.dot(direction);
    let Along { a, g, f } = Along::of(shape, stretch.from + shift * direction, direction);
    let q = -(g + (g * g - a * f).sqrt().copysign(g));
    let t = f / q;
    // A pilot in f32 has its roundings.
    let is_met = (t + shift - distance).abs() <= 1e-3 * distance;
    let room = (t + shift).abs() + 0.002 * (t.abs() + shift.abs());
    is_met && (2.0 * q - a * (t - shift)).abs() > a.abs() * room
}

/// How nearly all rays come to a shape and go on from it: along its normal, which is to the side of its back medium, or
/// against it; nothing where that is not the same for nearly all. A stretch without a length, between faces in contact,
/// tells nothing: then the other does, and they are taken to go through.
pub fn sides((frame, shape): &(Frame, Shape), pilot: &mut Pilot) -> Option<[bool; 2]> {
    let all = [[true, true], [false, false], [true, false], [false, true]];
    all.into_iter().find(|&along| {
        pilot.takes_turn(frame, |stretches| {
            let place = stretches[0].to;
            let slopes = stretches.map(|stretch| Along::of(shape, place, stretch.to - stretch.from).g);
            let agrees = |(slope, along): (f64, bool)| if along { slope >= 0.0 } else { slope <= 0.0 };
            slopes != [0.0; 2] && slopes.into_iter().zip(along).all(agrees)
        })
    })
}

/// The rays of a pilot that take the path, and what was taken for granted of them.
#[derive(Debug)]
pub struct Pilot<'a> {
    /// Theirs.
    ways: &'a [Way],
    /// The stretch that is looked at, by its number.
    pub step: usize,
    /// For so many of the rays all that is taken must hold.
    least_share: f64,
    /// For each ray, whether all that was taken so far does.
    keeps: Vec<bool>,
}

impl<'a> Pilot<'a> {
    /// Rays of whom nothing is taken for granted yet, and the share of them for which all that is taken must hold.
    pub fn new(ways: &'a [Way], least_share: f64) -> Self {
        Pilot { ways, step: 0, least_share, keeps: vec![true; ways.len()] }
    }

    /// Takes something for granted, if it and all that was taken before hold for the least share of the rays, in the
    /// frame of a primitive.
    pub fn takes(&mut self, frame: &Frame, holds: impl Fn(&Stretch) -> bool) -> bool {
        let step = self.step;
        self.takes_of_each(|way| match way.positions.get(step..step + 2) {
            Some(&[from, to]) => holds(&Stretch { from, to }.within(frame)),
            _ => false,
        })
    }

    /// The same of the stretch and the one behind it.
    pub fn takes_turn(&mut self, frame: &Frame, holds: impl Fn([&Stretch; 2]) -> bool) -> bool {
        let step = self.step;
        self.takes_of_each(|way| match way.positions.get(step..step + 3) {
            Some(&[from, at, to]) => {
                let [before, after] =
                    [Stretch { from, to: at }, Stretch { from: at, to }].map(|stretch| stretch.within(frame));
                holds([&before, &after])
            }
            _ => false,
        })
    }

    fn takes_of_each(&mut self, is_so: impl Fn(&Way) -> bool) -> bool {
        let rays = self.keeps.iter().zip(self.ways);
        let keeps: Vec<bool> = rays.map(|(keeps, way)| *keeps && is_so(way)).collect();
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
        let [radial, axial, offset] = gradient(shape);
        let dot = |p: DVec3, q: DVec3| radial * (p.x * q.x + p.y * q.y) + axial * p.z * q.z;
        Along {
            a: dot(d, d),
            g: dot(o, d) + offset * d.z,
            f: dot(o, o) + 2.0 * offset * o.z + shape_constant(shape),
        }
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

/// Where a shape that lies between two planes across z begins and ends; none for one that is better told by its quadric.
fn slab(shape: &Shape) -> Option<[f64; 2]> {
    match *shape {
        Shape::Plane(_) => Some([0.0; 2]),
        Shape::Annulus { z_offset, .. } => Some([z_offset; 2]),
        Shape::Conic { curvature: 0.0, .. } => Some([0.0; 2]),
        Shape::Frustum { z_front, z_back, .. } => Some([z_front.min(z_back), z_front.max(z_back)]),
        Shape::Conic { .. } | Shape::Sphere { .. } | Shape::Mesh(_) => None,
    }
}

/// M: the largest sum of a quadric's terms within so far of the origin.
fn magnitude(shape: &Shape, size: f64) -> f64 {
    let [radial, axial, offset] = gradient(shape).map(f64::abs);
    (radial + axial) * size * size + 2.0 * offset * size + shape_constant(shape).abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point(reach: f64) -> impl Strategy<Value = DVec3> {
        [-reach..reach, -reach..reach, -reach..reach].prop_map(DVec3::from_array)
    }

    fn shape() -> impl Strategy<Value = Shape> {
        prop_oneof![
            (-0.5..0.5f64, -3.0..2.0f64).prop_map(|(curvature, conic)| Shape::Conic {
                curvature,
                conic,
                aperture_radius: 4.0
            }),
            (1.0..5.0f64).prop_map(|radius| Shape::Sphere { radius, aperture_radius: None }),
            (1.0..5.0f64, 1.0..5.0f64).prop_map(|(r_front, r_back)| Shape::Frustum {
                r_front,
                r_back,
                z_front: -1.0,
                z_back: 2.0
            }),
        ]
    }

    /// The quadric at many places of the stretch.
    fn samples(shape: Shape, stretch: Stretch) -> impl Iterator<Item = f64> {
        let at = move |i| stretch.from.lerp(stretch.to, f64::from(i) / 1000.0);
        (0..=1000).map(move |i| Along::of(&shape, at(i), DVec3::Z).f)
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn a_stretch_that_stays_off_a_quadric_has_no_crossing(
            shape in shape(), from in point(6.0), to in point(6.0), margin in 0.0..0.5f64,
        ) {
            let stretch = Stretch { from, to };
            if (Clearance::Off { margin }).holds(&shape, &stretch) {
                let is_negative = Along::of(&shape, from, DVec3::Z).f < 0.0;
                for value in samples(shape, stretch) {
                    prop_assert!((value < 0.0) == is_negative && value.abs() > 0.99 * margin, "{value}");
                }
            }
        }

        #[test]
        fn a_stretch_without_a_crossing_is_seen_to_stay_off(
            shape in shape(), from in point(6.0), to in point(6.0),
        ) {
            let stretch = Stretch { from, to };
            let no_crossing =
                samples(shape, stretch).all(|f| f > 1e-3) || samples(shape, stretch).all(|f| f < -1e-3);
            let way = to - from;
            let along = Along::of(&shape, from, way.normalize());
            let there = along.g + along.a * way.length();
            // What bends towards 0 between the ends is not looked at any closer.
            let bends = (along.g < 0.0) != (there < 0.0) && (along.a < 0.0) == (along.f < 0.0);
            let off = Clearance::Off { margin: 1e-4 };
            prop_assert!(off.holds(&shape, &stretch) || bends || !no_crossing);
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
