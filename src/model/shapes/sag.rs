//! Surfaces z = sag(x, y) within a semi-diameter, whose crossings are searched along the ray
//! (shaders/geometry/sag.search.wgsl): what is the same for all of them.

use crate::model::shapes::{Extent, Level};
use glam::{DMat2, DMat3, DVec2, DVec3};
use std::f64::consts::TAU;

/// What is beyond the rim, and rounding: bounds hold so much farther out.
pub const ROOM: f64 = 1.0 + 1e-5;
/// More than any bound that is of use.
pub const UNBOUNDED: f64 = 1e30;

/// The sag at a point: its height \[mm\], its gradient, and its second derivatives \[1/mm\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SagAt {
    /// The height.
    pub height: f64,
    /// The slopes along x and y.
    pub gradient: DVec2,
    /// The second derivatives.
    pub hessian: DMat2,
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

impl Bounds {
    /// With room for rounding, and within what is of use.
    pub fn with_room(self, aperture_radius: f64) -> Self {
        let room = 1e-3 * (self.highest - self.lowest) + 1e-6 * aperture_radius;
        let bend = if self.bend.is_finite() { ROOM * self.bend } else { UNBOUNDED };
        Bounds {
            lowest: self.lowest - room,
            highest: self.highest + room,
            slope: (ROOM * self.slope).clamp(1e-9, UNBOUNDED),
            bend: bend.min(UNBOUNDED),
        }
    }
}

/// A surface z = sag(x, y) within a semi-diameter.
pub trait Sag {
    /// The semi-diameter \[mm\].
    fn aperture_radius(&self) -> f64;

    /// The sag at a point \[mm\].
    fn at(&self, p: DVec2) -> SagAt;

    /// Its height alone \[mm\].
    fn height(&self, p: DVec2) -> f64 {
        self.at(p).height
    }

    /// Bounds that hold everywhere on the aperture, and a little beyond its rim.
    fn bounds(&self) -> Bounds;

    /// The height of a point above the surface, along the axis \[mm\].
    fn height_above(&self, p: DVec3) -> f64 {
        p.z - self.height(p.truncate())
    }

    /// The numbers with which every such function begins: the squared semi-diameter, bounds, and `magnitude`, the sum of
    /// its terms' sizes \[mm\].
    fn search_arguments(&self, magnitude: f64) -> Vec<f64> {
        let Bounds { lowest, highest, slope, bend } = self.bounds();
        vec![self.aperture_radius().powi(2), lowest, highest, slope, bend, magnitude]
    }

    /// See [`crate::model::shapes::Geometry::level`].
    fn sag_level(&self, p: DVec3) -> Level {
        let SagAt { height, gradient, hessian } = self.at(p.truncate());
        let [x, y] = [hessian.x_axis, hessian.y_axis];
        let hessian = DMat3::from_cols((-x).extend(0.0), (-y).extend(0.0), DVec3::ZERO);
        Level { value: p.z - height, gradient: (-gradient).extend(1.0), hessian }
    }

    /// See [`crate::model::shapes::Geometry::extent`].
    fn sag_extent(&self) -> Extent {
        let Bounds { lowest, highest, .. } = self.bounds();
        let radius = self.aperture_radius();
        Extent::round(radius, lowest, highest, radius + lowest.abs().max(highest.abs()))
    }

    /// Points spread over the surface.
    fn sag_samples(&self) -> Vec<DVec3> {
        const TURNS: [f64; 4] = [0.05, 0.32, 0.6, 0.85];
        let on = |share: f64| TURNS.map(|turn| self.on(share, turn));
        [0.3, 0.6, 0.9].into_iter().flat_map(on).collect()
    }

    /// The point of the surface at a share of the semi-diameter, in a direction given as a share of a turn \[mm\].
    fn on(&self, share: f64, turn: f64) -> DVec3 {
        let p = DVec2::from_angle(turn * TAU) * (share * self.aperture_radius());
        p.extend(self.height(p))
    }

    /// The rim as a closed curve, and two curves across \[mm\].
    fn sag_edges(&self) -> Vec<Vec<DVec3>> {
        const STEPS: i32 = 64;
        let steps = || (0..=STEPS).map(|step| f64::from(step) / f64::from(STEPS));
        let rim = steps().map(|turn| self.on(1.0, turn)).collect();
        let across = |turn: f64| steps().map(|part| self.on(2.0 * part - 1.0, turn)).collect();
        vec![rim, across(0.0), across(0.25)]
    }

    /// The curve in the plane y = 0: x, and heights \[mm\].
    fn sag_section(&self) -> Vec<Vec<DVec2>> {
        const STEPS: i32 = 48;
        let radius = self.aperture_radius();
        let at = |step: i32| radius * (2.0 * f64::from(step) / f64::from(STEPS) - 1.0);
        vec![(0..=STEPS).map(|step| DVec2::new(at(step), self.height(DVec2::new(at(step), 0.0)))).collect()]
    }

    /// Crossings of a line, by 4096 samples of what lies within the aperture.
    fn sag_crossings(&self, o: DVec3, d: DVec3) -> Vec<f64> {
        const STEPS: i32 = 4096;
        let Bounds { lowest, highest, .. } = self.bounds();
        let radius = self.aperture_radius();
        let square = d.truncate().length_squared();
        let b = o.truncate().dot(d.truncate());
        let discriminant = b * b - square * (o.truncate().length_squared() - radius * radius);
        if discriminant < 0.0 || square == 0.0 && o.truncate().length() > radius {
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

/// The largest size of a second derivative along any line, where those along x, across, and along y are at most so large.
pub fn largest_bend(xx: f64, xy: f64, yy: f64) -> f64 {
    let half = 0.5 * (xx - yy);
    0.5 * (xx + yy) + half.hypot(xy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::shapes::freeform::Polynomial;
    use crate::model::shapes::{Biconic, Freeform, Profile, Toroidal};
    use proptest::prelude::*;

    /// No point of a surface breaks its bounds, and the derivatives are those of the height.
    fn bounds_hold(surface: &dyn Sag, points: &[(f64, f64)]) -> std::result::Result<(), TestCaseError> {
        let bounds = surface.bounds();
        for &(share, turn) in points {
            let p = surface.on(share, turn).truncate();
            let at = surface.at(p);
            prop_assert!((at.height - surface.height(p)).abs() < 1e-12);
            prop_assert!((bounds.lowest..=bounds.highest).contains(&at.height));
            prop_assert!(at.gradient.length() <= bounds.slope, "{} beyond {bounds:?}", at.gradient.length());
            let [xx, xy, yy] = [at.hessian.x_axis.x, at.hessian.x_axis.y, at.hessian.y_axis.y];
            let trace = 0.5 * (xx + yy);
            let bend = trace.abs() + (0.5 * (xx - yy)).hypot(xy);
            prop_assert!(bend <= bounds.bend, "{bend} beyond {bounds:?}");
            for step in [DVec2::new(1e-4, 0.0), DVec2::new(0.0, 1e-4)] {
                let [low, high] = [p - step, p + step].map(|p| surface.at(p));
                let slope = (high.height - low.height) / 2e-4;
                prop_assert!((slope - at.gradient.dot(step) / 1e-4).abs() < 1e-5 * (1.0 + slope.abs()));
                let bend = (high.gradient - low.gradient) / 2e-4;
                let expected = at.hessian * step / 1e-4;
                prop_assert!((bend - expected).length() < 1e-4 * (1.0 + bend.length()), "{bend} {expected}");
            }
        }
        Ok(())
    }

    /// Radii from 15 mm on, of either sign.
    fn radius() -> impl Strategy<Value = f64> {
        prop_oneof![-200.0..-15.0f64, 15.0..200.0f64]
    }

    fn points() -> impl Strategy<Value = Vec<(f64, f64)>> {
        prop::collection::vec((0.0..0.999f64, 0.0..1.0f64), 32)
    }

    const APERTURE: f64 = 10.0;

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, cases: 64, ..ProptestConfig::default() })]

        #[test]
        fn bounds_of_biconics_hold(
            x in radius(), y in radius(), kx in -3.0..0.5f64, ky in -3.0..0.5f64, points in points(),
        ) {
            let (curvature, conic) = (DVec2::new(1.0 / x, 1.0 / y), DVec2::new(kx, ky));
            bounds_hold(&Biconic { curvature, conic, aperture_radius: APERTURE }, &points)?;
        }

        #[test]
        fn bounds_of_toroids_hold(
            x in radius(), y in radius(), conic in -3.0..0.5f64, rim_terms in prop::collection::vec(-0.5..0.5f64, 0..5),
            points in points(),
        ) {
            let coefficients: Vec<f64> =
                (1..).zip(&rim_terms).map(|(i, a)| a / APERTURE.powi(2 * i)).collect();
            let profile = Profile::new(y, conic, APERTURE, 2, &coefficients);
            bounds_hold(&Toroidal { curvature_x: 1.0 / x, profile }, &points)?;
        }

        #[test]
        fn bounds_of_freeforms_hold(
            radius in radius(), conic in -3.0..0.5f64, terms in prop::collection::vec(-0.5..0.5f64, 21), points in points(),
        ) {
            let value = |p: DVec2| {
                let p = p / APERTURE;
                let powers = (0..6).flat_map(|i| (0..6 - i).map(move |j| p.x.powi(i) * p.y.powi(j)));
                powers.zip(&terms).map(|(power, term)| power * term).sum()
            };
            let freeform = Freeform::new(radius, conic, APERTURE, &Polynomial { powers: [5; 2], order: 5, value: &value });
            for &(share, turn) in &points {
                let p = freeform.on(share, turn).truncate();
                prop_assert!((freeform.height(p) - freeform.conic.height(p) - value(p)).abs() < 1e-13);
            }
            bounds_hold(&freeform, &points)?;
            // And they are of use: not much larger than what occurs.
            let occurs = (0..=400).map(|i| freeform.at(freeform.on(f64::from(i % 21) / 20.0, f64::from(i) / 400.0).truncate()));
            let slope = occurs.fold(0.0f64, |slope, at| slope.max(at.gradient.length()));
            prop_assert!(freeform.bounds().slope <= 1.2 * slope + 0.05, "{:?} beside {slope}", freeform.bounds());
        }
    }
}
