//! Profiles of aspheres: the height over the distance from the axis, with the bounds that prove a crossing to be the first
//! (shaders/geometry/sag.search.wgsl).

use crate::Result;
use crate::model::checks;
use crate::model::shapes::conic::curvature;
use crate::model::shapes::sag::{Bounds, ROOM, Sag, SagAt, SagSurface};
use crate::model::shapes::{Shape, ShapeKind};
use glam::{DMat2, DVec2};

/// How many coefficients an asphere has.
pub const NUM_COEFFICIENTS: usize = 10;

/// z = c r^2 / (1 + sqrt(1 - (1 + conic) c^2 r^2)) + the sum of `coefficients[i]` r^(step (i + 1)) for r <= aperture_radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AsphereProfile {
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

/// A ring of the aperture, and bounds of the height and its derivatives within it, a tip's slope among them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ring {
    /// Its inner radius \[mm\].
    pub from: f64,
    /// Bounds.
    pub bounds: Bounds,
}

impl AsphereProfile {
    /// The profile of numbers that were checked.
    pub fn new(radius: f64, conic: f64, aperture_radius: f64, step: u32, given: &[f64]) -> Self {
        let mut coefficients = [0.0; NUM_COEFFICIENTS];
        coefficients.iter_mut().zip(given).for_each(|(own, given)| *own = *given);
        AsphereProfile { curvature: curvature(radius), conic, aperture_radius, step, coefficients }
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
        AsphereProfile::check_reach(radius, conic, aperture_radius, at)
    }

    /// Refuses a semi-diameter beyond which the conic part does not go.
    pub(super) fn check_reach(
        radius: f64,
        conic: f64,
        aperture_radius: f64,
        at: &dyn Fn(&str) -> String,
    ) -> Result<()> {
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

    /// The height and its derivatives at a distance from the axis \[mm\].
    fn along(&self, r: f64) -> At {
        let (c, kappa) = (self.curvature, self.axial());
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

    /// More than the polynomial's third derivative up to a distance from the axis \[1/mm^2\], and more than the
    /// derivative of its slope over r. Bounds are summed term by term. A tip has none.
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
        self.along(r).height
    }

    /// What each coefficient adds at the rim \[mm\]: powers of the radius would leave the range of f32.
    pub(super) fn at_rim(&self) -> Vec<f64> {
        let at_rim = |(i, a): (usize, &f64)| a * self.aperture_radius.powi(self.power(i));
        self.coefficients.iter().enumerate().map(at_rim).collect()
    }

    /// (1 + K) c^2 \[1/mm^2\].
    pub(super) fn axial(&self) -> f64 {
        (1.0 + self.conic) * self.curvature * self.curvature
    }

    /// The size of the conic part's height at the rim \[mm\]; where the conic ends, the height has fewer digits than its
    /// size says.
    pub(super) fn conic_magnitude(&self) -> f64 {
        let limit = self.aperture_radius * self.aperture_radius;
        let root = (1.0 - self.axial() * limit).abs().sqrt().min(1.0);
        (self.curvature * limit).abs() / root
    }

    /// Bounds ring by ring, to a little beyond the rim, that hold whatever the profile does.
    ///
    /// In a ring the conic part and its derivatives lie between their values at its ends, because they grow or fall
    /// throughout. The polynomial lies no farther from its value in the middle than its next derivative, bounded term by
    /// term, allows.
    pub(super) fn rings(&self) -> impl Iterator<Item = Ring> {
        const RINGS: i32 = 512;
        let profile = *self;
        let conic = AsphereProfile { coefficients: [0.0; NUM_COEFFICIENTS], ..profile };
        // What a tip adds to the bend is no part of the bound.
        let mut terms = AsphereProfile { curvature: 0.0, ..profile };
        let tip = if self.step == 1 { std::mem::take(&mut terms.coefficients[0]) } else { 0.0 };
        let sizes = AsphereProfile { coefficients: terms.coefficients.map(f64::abs), ..terms };
        let rim = ROOM * self.aperture_radius;
        (0..RINGS).map(move |ring| {
            let [from, to] = [ring, ring + 1].map(|i| rim * f64::from(i) / f64::from(RINGS));
            let half = 0.5 * (to - from);
            let (middle, most) = (terms.along(from + half), sizes.along(to));
            let ends = [conic.along(from), conic.along(to)];
            let off = most.slope * half;
            let rise = [tip * from, tip * to];
            let low = ends[0].height.min(ends[1].height) + rise[0].min(rise[1]);
            let high = ends[0].height.max(ends[1].height) + rise[0].max(rise[1]);
            let largest = |of: fn(&At) -> f64, middle: f64, off: f64| {
                let [a, b] = ends.each_ref().map(of);
                (a + middle).abs().max((b + middle).abs()) + off
            };
            let steepness = profile.most_of_third_derivative(to) * half;
            let along = largest(|at| at.bend, middle.bend, steepness);
            let bounds = Bounds {
                lowest: low + middle.height - off,
                highest: high + middle.height + off,
                slope: largest(|at| at.slope, middle.slope + tip, most.bend * half),
                bend: along.max(largest(|at| at.across, middle.across, steepness)),
            };
            Ring { from, bounds }
        })
    }
}

impl Sag for AsphereProfile {
    fn aperture_radius(&self) -> f64 {
        self.aperture_radius
    }

    fn at(&self, p: DVec2) -> SagAt {
        let r = p.length();
        let At { height, slope, bend, across } = self.along(r.max(1e-12 * self.aperture_radius));
        let radial = if r > 0.0 { p / r } else { DVec2::X };
        // Along r the bend, across r the slope over r.
        let [x, y] = radial.to_array();
        let part = |a: f64, b: f64, unit: f64| bend * a * b + across * (unit - a * b);
        let (xx, xy, yy) = (part(x, x, 1.0), part(x, y, 0.0), part(y, y, 1.0));
        SagAt {
            height,
            gradient: slope * radial,
            hessian: DMat2::from_cols(DVec2::new(xx, xy), DVec2::new(xy, yy)),
        }
    }

    fn height(&self, p: DVec2) -> f64 {
        self.sag(p.length())
    }

    fn kind(&self) -> ShapeKind {
        match self.step {
            1 => ShapeKind::OddAsphere,
            _ => ShapeKind::EvenAsphere,
        }
    }

    fn magnitude(&self) -> f64 {
        self.at_rim().iter().map(|a| a.abs()).sum::<f64>() + self.conic_magnitude()
    }

    fn numbers(&self) -> Vec<f64> {
        let mut numbers = vec![self.aperture_radius.powi(-2), self.curvature, self.axial()];
        numbers.extend(self.at_rim());
        numbers
    }

    fn is_round(&self) -> bool {
        true
    }

    fn is_one_with(&self, other: &Self) -> bool {
        AsphereProfile { aperture_radius: self.aperture_radius, ..*other } == *self
    }

    fn of_shape(shape: &Shape) -> Option<&SagSurface<Self>> {
        let (Shape::EvenAsphere(surface) | Shape::OddAsphere(surface)) = shape else { return None };
        Some(surface)
    }

    fn bounds(&self) -> Bounds {
        Bounds::over(self.rings().map(|ring| ring.bounds)).with_room(self.aperture_radius)
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
            let profile = AsphereProfile::new(radius, conic, aperture, step, &coefficients);
            let bounds = profile.bounds();
            for share in shares {
                let at = profile.along(share.max(1e-6) * aperture);
                prop_assert!((bounds.lowest..=bounds.highest).contains(&at.height));
                prop_assert!(at.slope.abs() <= bounds.slope);
                let tip = if step == 1 { profile.coefficients[0].abs() / (share.max(1e-6) * aperture) } else { 0.0 };
                prop_assert!(at.bend.abs() <= bounds.bend && at.across.abs() <= (bounds.bend + tip) * (1.0 + 1e-12));
            }
            // And they are of use: not much larger than what occurs.
            let occurs = (0..=1000).map(|i| profile.along(f64::from(i).max(1e-3) / 1000.0 * aperture));
            let (slope, bend) = occurs.fold((0.0f64, 0.0f64), |(slope, bend), at| {
                (slope.max(at.slope.abs()), bend.max(at.bend.abs()).max(at.across.abs()))
            });
            prop_assert!(bounds.slope <= 1.5 * slope + 0.05, "{} beside {slope}", bounds.slope);
            prop_assert!(bounds.bend <= 3.0 * bend + 0.05, "{} beside {bend}", bounds.bend);
        }
    }
}
