//! Profiles of aspheres: the height over the distance from the axis, with the bounds that prove a crossing to be the first
//! (shaders/geometry/sag.search.wgsl).

use crate::Result;
use crate::model::checks;
use crate::model::mesh::Mesh;
use crate::model::shapes::conic::curvature;
use crate::model::shapes::{Extent, Geometry, Level, Shape, ShapeKind, ring_samples, section_between};
use glam::{DMat3, DVec2, DVec3};

/// How many coefficients an asphere has.
pub const NUM_COEFFICIENTS: usize = 10;

/// More than any bound that is of use.
const UNBOUNDED: f64 = 1e30;

/// z = c r^2 / (1 + sqrt(1 - (1 + conic) c^2 r^2)) + the sum of `coefficients[i]` r^(step (i + 1)) for r <= aperture_radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Profile {
    /// Vertex curvature c = 1/R of the conic part \[1/mm\].
    pub curvature: f64,
    /// Conic constant.
    pub conic: f64,
    /// Semi-diameter \[mm\].
    pub aperture_radius: f64,
    /// 1 where all powers of r occur, 2 for even ones.
    pub step: u32,
    /// Coefficients, of powers of r \[mm\].
    pub coefficients: [f64; NUM_COEFFICIENTS],
}

/// The height and its derivatives along r \[mm, 1, 1/mm\].
#[derive(Debug, Clone, Copy, PartialEq)]
struct At {
    height: f64,
    slope: f64,
    bend: f64,
    /// The slope over r: the bend across r.
    across: f64,
}

/// Bounds over the whole aperture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// The lowest height \[mm\].
    pub lowest: f64,
    /// The highest height \[mm\].
    pub highest: f64,
    /// The largest slope.
    pub slope: f64,
    /// The largest second derivative along any line, but for what a tip on the axis adds \[1/mm\].
    pub bend: f64,
}

impl Profile {
    /// The profile of numbers that were checked.
    pub fn new(radius: f64, conic: f64, aperture_radius: f64, step: u32, given: &[f64]) -> Self {
        let mut coefficients = [0.0; NUM_COEFFICIENTS];
        coefficients.iter_mut().zip(given).for_each(|(own, given)| *own = *given);
        Profile { curvature: curvature(radius), conic, aperture_radius, step, coefficients }
    }

    /// Refuses numbers that no asphere has.
    pub fn check(
        radius: f64,
        conic: f64,
        aperture_radius: f64,
        coefficients: &[f64],
        at: &dyn Fn(&str) -> String,
    ) -> Result<()> {
        checks::radius(at("radius"), radius)?;
        checks::conic_constant(at("conic"), conic)?;
        checks::size(at("aperture_radius"), aperture_radius)?;
        if coefficients.len() > NUM_COEFFICIENTS {
            let problem = format!("there are {} coefficients", coefficients.len());
            return checks::refuse(at("coefficients"), problem, format!("give at most {NUM_COEFFICIENTS}"));
        }
        for (i, &coefficient) in coefficients.iter().enumerate() {
            checks::between(format!("{}[{i}]", at("coefficients")), coefficient, -1e30, 1e30)?;
        }
        let widest = 1.0 / (curvature(radius).abs() * (1.0 + conic).max(0.0).sqrt());
        if aperture_radius < 0.9999 * widest {
            return Ok(());
        }
        let problem = format!("the conic part ends {widest} mm off the axis");
        checks::refuse(at("aperture_radius"), problem, "give less: an asphere needs its slope at the rim")
    }

    fn power(&self, i: usize) -> i32 {
        (self.step as usize * (i + 1)) as i32
    }

    fn at(&self, r: f64) -> At {
        let (c, kappa) = (self.curvature, (1.0 + self.conic) * self.curvature * self.curvature);
        let root = (1.0 - kappa * r * r).max(0.0).sqrt();
        let mut at = At {
            height: c * r * r / (1.0 + root),
            slope: c * r / root,
            bend: c / (root * root * root),
            across: c / root,
        };
        for (i, &a) in self.coefficients.iter().enumerate().filter(|(_, a)| **a != 0.0) {
            let n = self.power(i);
            let factor = f64::from(n);
            at.height += a * r.powi(n);
            at.slope += factor * a * r.powi(n - 1);
            at.bend += if n > 1 { factor * (factor - 1.0) * a * r.powi(n - 2) } else { 0.0 };
            at.across += factor * a * r.powi(n - 2);
        }
        at
    }

    /// More than the polynomial's third derivative up to a distance from the axis, and than the derivative of its slope over
    /// r: term by term \[1/mm^2\]. A tip has none.
    fn most_of_third_derivative(&self, r: f64) -> f64 {
        let term = |(i, a): (usize, &f64)| {
            let n = self.power(i);
            let factor = f64::from(n * (n - 2).max(0)) * f64::from((n - 1).max(1));
            if factor == 0.0 { 0.0 } else { factor * a.abs() * r.powi(n - 3) }
        };
        self.coefficients.iter().enumerate().map(term).sum()
    }

    /// The height at a distance from the axis \[mm\].
    pub fn sag(&self, r: f64) -> f64 {
        self.at(r).height
    }

    /// Bounds that hold everywhere on the aperture, and a little beyond its rim, whatever the profile does.
    ///
    /// The aperture is cut into rings. In a ring the conic part and its derivatives lie between their values at its ends,
    /// because they grow or fall throughout. The polynomial lies no farther from its value in the middle than its next
    /// derivative, bounded term by term, allows.
    pub fn bounds(&self) -> Bounds {
        const RINGS: i32 = 512;
        /// What is beyond the rim, and rounding.
        const ROOM: f64 = 1.0 + 1e-5;
        let conic = Profile { coefficients: [0.0; NUM_COEFFICIENTS], ..*self };
        // What a tip adds to the bend is no part of the bound.
        let mut terms = Profile { curvature: 0.0, ..*self };
        let tip = if self.step == 1 { std::mem::take(&mut terms.coefficients[0]) } else { 0.0 };
        let magnitude = |r: f64| {
            let sizes = Profile { coefficients: terms.coefficients.map(f64::abs), ..terms };
            sizes.at(r)
        };
        let rim = ROOM * self.aperture_radius;
        let (mut lowest, mut highest, mut slope, mut bend) = (0.0f64, 0.0f64, 0.0f64, 0.0f64);
        for ring in 0..RINGS {
            let [from, to] = [ring, ring + 1].map(|i| rim * f64::from(i) / f64::from(RINGS));
            let half = 0.5 * (to - from);
            let (middle, most) = (terms.at(from + half), magnitude(to));
            let ends = [conic.at(from), conic.at(to)];
            let off = most.slope * half;
            let rise = [tip * from, tip * to];
            let low = ends[0].height.min(ends[1].height) + rise[0].min(rise[1]);
            let high = ends[0].height.max(ends[1].height) + rise[0].max(rise[1]);
            lowest = lowest.min(low + middle.height - off);
            highest = highest.max(high + middle.height + off);
            let largest = |of: fn(&At) -> f64, middle: f64, off: f64| {
                let [a, b] = ends.each_ref().map(of);
                (a + middle).abs().max((b + middle).abs()) + off
            };
            slope = slope.max(largest(|at| at.slope, middle.slope + tip, most.bend * half));
            let steepness = self.most_of_third_derivative(to) * half;
            bend = bend.max(largest(|at| at.bend, middle.bend, steepness));
            bend = bend.max(largest(|at| at.across, middle.across, steepness));
        }
        let room = 1e-3 * (highest - lowest) + 1e-6 * self.aperture_radius;
        let bend = if bend.is_finite() { ROOM * bend } else { UNBOUNDED };
        Bounds {
            lowest: lowest - room,
            highest: highest + room,
            slope: (ROOM * slope).clamp(1e-9, UNBOUNDED),
            bend: bend.min(UNBOUNDED),
        }
    }

    /// The height of a point above the surface, along the axis \[mm\].
    fn height_above(&self, p: DVec3) -> f64 {
        p.z - self.sag(p.truncate().length())
    }
}

impl Geometry for Profile {
    fn kind(&self) -> ShapeKind {
        match self.step {
            1 => ShapeKind::OddAsphere,
            _ => ShapeKind::EvenAsphere,
        }
    }

    fn coincides(&self, other: &Shape) -> bool {
        let (Shape::EvenAsphere(other) | Shape::OddAsphere(other)) = other else { return false };
        Profile { aperture_radius: self.aperture_radius, ..*other } == *self
    }

    fn arguments(&self) -> Vec<f64> {
        let Bounds { lowest, highest, slope, bend } = self.bounds();
        let limit = self.aperture_radius * self.aperture_radius;
        let axial = (1.0 + self.conic) * self.curvature * self.curvature;
        // By what each adds at the rim: powers of the radius would leave the range of f32.
        let at_rim = |(i, a): (usize, &f64)| a * self.aperture_radius.powi(self.power(i));
        let coefficients: Vec<f64> = self.coefficients.iter().enumerate().map(at_rim).collect();
        // Where the conic part ends, its height has fewer digits than its size says.
        let root = (1.0 - axial * limit).abs().sqrt().min(1.0);
        let conic = (self.curvature * limit).abs() / root;
        let magnitude = coefficients.iter().map(|a| a.abs()).sum::<f64>() + conic;
        let mut arguments =
            vec![limit, lowest, highest, slope, bend, magnitude, 1.0 / limit, self.curvature, axial];
        arguments.extend(coefficients);
        arguments
    }

    fn level(&self, p: DVec3) -> Option<Level> {
        let across = p.truncate();
        let r = across.length();
        let At { height, slope, bend, across: turned } = self.at(r.max(1e-12 * self.aperture_radius));
        let radial = if r > 0.0 { across / r } else { DVec2::X };
        let gradient = (-slope * radial).extend(1.0);
        let [x, y] = radial.to_array();
        // Along r the bend, across r the slope over r.
        let part = |a: f64, b: f64, unit: f64| -(bend * a * b + turned * (unit - a * b));
        let (xx, xy, yy) = (part(x, x, 1.0), part(x, y, 0.0), part(y, y, 1.0));
        let hessian = DMat3::from_cols(DVec3::new(xx, xy, 0.0), DVec3::new(xy, yy, 0.0), DVec3::ZERO);
        Some(Level { value: p.z - height, gradient, hessian })
    }

    fn holds(&self, p: DVec3) -> bool {
        p.truncate().length_squared() <= self.aperture_radius * self.aperture_radius
    }

    fn extent(&self, _: &[Mesh]) -> Option<Extent> {
        let Bounds { lowest, highest, .. } = self.bounds();
        let size = self.aperture_radius + lowest.abs().max(highest.abs());
        Some(Extent::round(self.aperture_radius, lowest, highest, size))
    }

    fn samples(&self) -> Vec<DVec3> {
        ring_samples(
            &[0.3, 0.6, 0.9]
                .map(|share| (share * self.aperture_radius, self.sag(share * self.aperture_radius))),
        )
    }

    fn rims(&self) -> Vec<(f64, f64)> {
        vec![(self.aperture_radius, self.sag(self.aperture_radius))]
    }

    fn section(&self) -> Vec<Vec<DVec2>> {
        vec![section_between(-self.aperture_radius, self.aperture_radius, |r| self.sag(r.abs()))]
    }

    /// By 4096 samples of what lies within the aperture.
    fn crossings(&self, o: DVec3, d: DVec3) -> Vec<f64> {
        const STEPS: i32 = 4096;
        let Bounds { lowest, highest, .. } = self.bounds();
        let square = d.truncate().length_squared();
        let b = o.truncate().dot(d.truncate());
        let discriminant = b * b - square * (o.truncate().length_squared() - self.aperture_radius.powi(2));
        if discriminant < 0.0 || square == 0.0 && o.truncate().length() > self.aperture_radius {
            return Vec::new();
        }
        let mut range = [f64::NEG_INFINITY, f64::INFINITY];
        if square > 0.0 {
            range = [-1.0, 1.0].map(|sign| (-b + sign * discriminant.sqrt()) / square);
        }
        if d.z != 0.0 {
            let [one, other] = [lowest, highest].map(|z| (z - o.z) / d.z);
            range = [range[0].max(one.min(other)), range[1].min(one.max(other))];
        }
        let level = |t: f64| self.height_above(o + t * d);
        let at = |i: i32| range[0] + (range[1] - range[0]) * f64::from(i) / f64::from(STEPS);
        let changes = (0..STEPS).filter(|&i| (level(at(i)) < 0.0) != (level(at(i + 1)) < 0.0));
        let bisected = |i: i32| {
            let (mut low, mut high) = (at(i), at(i + 1));
            let is_low = level(low) < 0.0;
            for _ in 0..100 {
                let middle = 0.5 * (low + high);
                if (level(middle) < 0.0) == is_low { low = middle } else { high = middle }
            }
            low
        };
        changes.map(bisected).filter(|t| t.is_finite()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        /// No point of a random asphere breaks the bounds.
        #[test]
        fn bounds_hold(
            radius in prop_oneof![-200.0..-15.0f64, 15.0..200.0f64],
            conic in -3.0..1.0f64,
            step in 1..3u32,
            rim_terms in prop::collection::vec(-1.0..1.0f64, 0..6),
            shares in prop::collection::vec(0.0..1.0f64, 64),
        ) {
            let aperture: f64 = 10.0;
            // Coefficients by what they add at the rim [mm].
            let coefficients: Vec<f64> =
                rim_terms.iter().enumerate().map(|(i, a)| a / aperture.powi((step as usize * (i + 1)) as i32)).collect();
            let profile = Profile::new(radius, conic, aperture, step, &coefficients);
            let bounds = profile.bounds();
            for share in shares {
                let at = profile.at(share.max(1e-6) * aperture);
                prop_assert!((bounds.lowest..=bounds.highest).contains(&at.height));
                prop_assert!(at.slope.abs() <= bounds.slope);
                let tip = if step == 1 { profile.coefficients[0].abs() / (share.max(1e-6) * aperture) } else { 0.0 };
                prop_assert!(at.bend.abs() <= bounds.bend && at.across.abs() <= (bounds.bend + tip) * (1.0 + 1e-12));
            }
            // And they are of use: not much larger than what occurs.
            let occurs = (0..=1000).map(|i| profile.at(f64::from(i).max(1e-3) / 1000.0 * aperture));
            let (slope, bend) = occurs.fold((0.0f64, 0.0f64), |(slope, bend), at| {
                (slope.max(at.slope.abs()), bend.max(at.bend.abs()).max(at.across.abs()))
            });
            prop_assert!(bounds.slope <= 1.5 * slope + 0.05, "{} beside {slope}", bounds.slope);
            prop_assert!(bounds.bend <= 3.0 * bend + 0.05, "{} beside {bend}", bounds.bend);
        }
    }
}
