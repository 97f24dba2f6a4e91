//! Surfaces z = sag(x, y) within a semi-diameter, whose crossings are searched along the ray
//! (shaders/geometry/sag.search.wgsl): what is the same for all of them.

use crate::Result;
use crate::model::mesh::Mesh;
use crate::model::shapes::aperture::{self, Aperture};
use crate::model::shapes::{Extent, Geometry, Level, Shape, ShapeKind, section_between};
use glam::{DMat2, DMat3, DVec2, DVec3};
use std::f64::consts::TAU;
use std::sync::Arc;

/// What is beyond the rim, and rounding: bounds hold so much farther out.
pub const ROOM: f64 = 1.0 + 1e-5;
/// More than any bound that is of use.
pub const UNBOUNDED: f64 = 1e30;

/// Makes what scene files have of an asphere: the keys of all aspheres around its own.
macro_rules! written {
    (
        $(#[$attribute:meta])*
        pub struct $name:ident {
            $(#[$limit:meta])*
            pub aperture_radius: f64,
            $($(#[$key_attribute:meta])* pub $key:ident: $type:ty,)*
        }
    ) => {
        #[derive(Debug, Clone, PartialEq, serde::Deserialize, schemars::JsonSchema)]
        #[serde(deny_unknown_fields)]
        $(#[$attribute])*
        pub struct $name {
            /// Vertex radius of the conic part \[mm\].
            pub radius: f64,
            /// Conic constant.
            #[serde(default)]
            pub conic: f64,
            $(#[$limit])*
            pub aperture_radius: f64,
            $($(#[$key_attribute])* pub $key: $type,)*
            /// The part across the axis that there is; all if null.
            #[serde(default)]
            pub aperture: Option<$crate::model::shapes::aperture::Written>,
        }
    };
}
pub(super) use written;

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
    /// Bounds that hold where any of these do, and at height 0.
    pub fn over(parts: impl Iterator<Item = Bounds>) -> Self {
        let none = Bounds { lowest: 0.0, highest: 0.0, slope: 0.0, bend: 0.0 };
        parts.fold(none, |all, part| Bounds {
            lowest: all.lowest.min(part.lowest),
            highest: all.highest.max(part.highest),
            slope: all.slope.max(part.slope),
            bend: all.bend.max(part.bend),
        })
    }

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

/// A function z = sag(x, y), and the semi-diameter within which it has bounds.
pub trait Sag: std::fmt::Debug + Clone + PartialEq {
    /// The semi-diameter \[mm\].
    fn aperture_radius(&self) -> f64;

    /// The sag at a point \[mm\].
    fn at(&self, p: DVec2) -> SagAt;

    /// Its height alone \[mm\].
    fn height(&self, p: DVec2) -> f64 {
        self.at(p).height
    }

    /// Bounds that hold everywhere within the semi-diameter, and a little beyond.
    fn bounds(&self) -> Bounds;

    /// The shader functions that trace it.
    fn kind(&self) -> ShapeKind;

    /// The sum of the sizes of its terms \[mm\].
    fn magnitude(&self) -> f64;

    /// The numbers of the shader's sag.
    fn numbers(&self) -> Vec<f64>;

    /// What the shader's sag reads from the buffer of tables.
    fn coefficients(&self) -> &[f64] {
        &[]
    }

    /// True if it is the same in every direction from the axis.
    fn is_round(&self) -> bool {
        false
    }

    /// True if both are one function, whatever their semi-diameters.
    fn is_one_with(&self, other: &Self) -> bool;

    /// The surface of such a function that a shape is.
    fn of_shape(shape: &Shape) -> Option<&SagSurface<Self>>;
}

/// A surface z = sag(x, y) within a semi-diameter, and maybe within an aperture that need be neither round nor on the axis.
#[derive(Debug, Clone, PartialEq)]
pub struct SagSurface<S> {
    /// The function.
    pub sag: S,
    /// The aperture.
    pub aperture: Option<Arc<Aperture>>,
    /// The aperture, then the coefficients, for the shaders. `None` if the surface has neither of these.
    table: Option<Arc<[f64]>>,
}

impl<S: Sag> From<S> for SagSurface<S> {
    fn from(sag: S) -> Self {
        SagSurface::new(sag, None)
    }
}

impl<S: Sag> SagSurface<S> {
    /// A surface within an aperture.
    pub fn new(sag: S, aperture: Option<Aperture>) -> Self {
        let has_table = aperture.is_some() || !sag.coefficients().is_empty();
        let table = has_table
            .then(|| [aperture::table(aperture.as_ref()), sag.coefficients().to_vec()].concat().into());
        SagSurface { sag, aperture: aperture.map(Arc::new), table }
    }

    /// A surface of numbers that were checked. `place` is where it stands in the scene file.
    pub(super) fn written(sag: S, aperture: Option<&aperture::Written>, place: &str) -> Result<Self> {
        let surface = SagSurface::new(sag, aperture.map(aperture::Written::aperture));
        aperture::check_rest(place, &surface.samples())?;
        Ok(surface)
    }

    /// The point of the surface at a share of the semi-diameter, in a direction given as a share of a turn \[mm\].
    fn on(&self, share: f64, turn: f64) -> DVec3 {
        self.lifted(DVec2::from_angle(turn * TAU) * (share * self.sag.aperture_radius()))
    }

    fn lifted(&self, p: DVec2) -> DVec3 {
        let p = p.clamp_length_max(self.sag.aperture_radius());
        p.extend(self.sag.height(p))
    }

    /// True if nothing but the semi-diameter bounds it, and it is round.
    fn is_round(&self) -> bool {
        self.aperture.is_none() && self.sag.is_round()
    }
}

/// Refuses numbers that no aperture has. `at` gives the place of a key of the shape.
pub(super) fn check_aperture(
    aperture: Option<&aperture::Written>,
    at: &dyn Fn(&str) -> String,
) -> Result<()> {
    let place = at("aperture");
    aperture.map_or(Ok(()), |aperture| aperture.check(&|key| format!("{place}.{key}")))
}

impl<S: Sag> Geometry for SagSurface<S> {
    fn kind(&self) -> ShapeKind {
        self.sag.kind()
    }

    fn arguments(&self) -> Vec<f64> {
        /// Where there is no table.
        const NONE: f64 = -1.0;
        let Bounds { lowest, highest, slope, bend } = self.sag.bounds();
        let limit = self.sag.aperture_radius().powi(2);
        let mut arguments = vec![NONE, limit, lowest, highest, slope, bend, self.sag.magnitude()];
        arguments.extend(self.sag.numbers());
        arguments
    }

    fn table(&self) -> Option<&[f64]> {
        self.table.as_deref()
    }

    fn terms_size(&self) -> f64 {
        self.sag.magnitude()
    }

    fn is_clipped(&self) -> bool {
        self.aperture.is_some()
    }

    fn coincides(&self, other: &Shape) -> bool {
        let Some(other) = S::of_shape(other) else { return false };
        self.sag.is_one_with(&other.sag)
            && (self.samples().iter().any(|&p| other.holds(p))
                || other.samples().iter().any(|&p| self.holds(p)))
    }

    fn level(&self, p: DVec3) -> Option<Level> {
        let SagAt { height, gradient, hessian } = self.sag.at(p.truncate());
        let [x, y] = [hessian.x_axis, hessian.y_axis];
        let hessian = DMat3::from_cols((-x).extend(0.0), (-y).extend(0.0), DVec3::ZERO);
        Some(Level { value: p.z - height, gradient: (-gradient).extend(1.0), hessian })
    }

    fn holds(&self, p: DVec3) -> bool {
        p.truncate().length_squared() <= self.sag.aperture_radius().powi(2)
            && self.aperture.as_ref().is_none_or(|aperture| aperture.holds(p.truncate()))
    }

    fn extent(&self, _: &[Mesh]) -> Option<Extent> {
        let Bounds { lowest, highest, .. } = self.sag.bounds();
        let radius = self.sag.aperture_radius();
        Some(Extent::round(radius, lowest, highest, radius + lowest.abs().max(highest.abs())))
    }

    fn samples(&self) -> Vec<DVec3> {
        const TURNS: [f64; 4] = [0.05, 0.32, 0.6, 0.85];
        if let Some(aperture) = &self.aperture {
            let samples = aperture.samples(0.999_999 * self.sag.aperture_radius());
            return samples.into_iter().map(|p| self.lifted(p)).collect();
        }
        let on = |share: f64| TURNS.map(|turn| self.on(share, turn));
        [0.3, 0.6, 0.9].into_iter().flat_map(on).collect()
    }

    fn rims(&self) -> Vec<(f64, f64)> {
        let radius = self.sag.aperture_radius();
        if self.is_round() { vec![(radius, self.on(1.0, 0.0).z)] } else { Vec::new() }
    }

    fn section(&self) -> Vec<Vec<DVec2>> {
        let radius = self.sag.aperture_radius();
        if self.aperture.is_some() {
            return Vec::new();
        }
        vec![section_between(-radius, radius, |x| self.sag.height(DVec2::new(x, 0.0)))]
    }

    /// The rim and two curves across, or the outlines of the aperture.
    fn edges(&self, _: &[Mesh]) -> Vec<Vec<DVec3>> {
        const STEPS: i32 = 64;
        if self.is_round() {
            return Vec::new();
        }
        let steps = || (0..=STEPS).map(|step| f64::from(step) / f64::from(STEPS));
        let rim = || steps().map(|turn| self.on(1.0, turn)).collect();
        let across = |turn: f64| steps().map(|part| self.on(2.0 * part - 1.0, turn)).collect();
        let Some(aperture) = &self.aperture else { return vec![rim(), across(0.0), across(0.25)] };
        let lifted = |curve: Vec<DVec2>| curve.into_iter().map(|p| self.lifted(p)).collect();
        let mut curves: Vec<Vec<DVec3>> = aperture.curves().into_iter().map(lifted).collect();
        if aperture.inverted {
            curves.push(rim());
        }
        curves
    }

    /// By 4096 samples of what lies within the semi-diameter.
    fn crossings(&self, o: DVec3, d: DVec3) -> Vec<f64> {
        const STEPS: i32 = 4096;
        let Bounds { lowest, highest, .. } = self.sag.bounds();
        let radius = self.sag.aperture_radius();
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
        let level = |t: f64| {
            let p = o + t * d;
            p.z - self.sag.height(p.truncate())
        };
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
        let is_part = |t: &f64| {
            t.is_finite()
                && self.aperture.as_ref().is_none_or(|aperture| aperture.holds((o + *t * d).truncate()))
        };
        changes.map(bisected).filter(is_part).collect()
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
    use crate::model::shapes::{AsphereProfile, Biconic, Freeform, Toroidal};
    use proptest::prelude::*;

    /// All points of a surface keep its bounds, and its slopes are the derivatives of its height.
    fn bounds_hold<S: Sag>(sag: &S, points: &[(f64, f64)]) -> std::result::Result<(), TestCaseError> {
        let surface = SagSurface::from(sag.clone());
        let bounds = sag.bounds();
        for &(share, turn) in points {
            let p = surface.on(share, turn).truncate();
            let at = sag.at(p);
            prop_assert!((at.height - sag.height(p)).abs() < 1e-12);
            prop_assert!((bounds.lowest..=bounds.highest).contains(&at.height));
            prop_assert!(at.gradient.length() <= bounds.slope, "{} beyond {bounds:?}", at.gradient.length());
            let [xx, xy, yy] = [at.hessian.x_axis.x, at.hessian.x_axis.y, at.hessian.y_axis.y];
            let trace = 0.5 * (xx + yy);
            let bend = trace.abs() + (0.5 * (xx - yy)).hypot(xy);
            prop_assert!(bend <= bounds.bend, "{bend} beyond {bounds:?}");
            for step in [DVec2::new(1e-4, 0.0), DVec2::new(0.0, 1e-4)] {
                let [low, high] = [p - step, p + step].map(|p| sag.at(p));
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
            let profile = AsphereProfile::new(y, conic, APERTURE, 2, &coefficients);
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
            let freeform = Freeform::new(radius, conic, APERTURE, &Polynomial { powers: [5; 2], order: 5, value: &value, definition: vec![] });
            let surface = SagSurface::from(freeform.clone());
            for &(share, turn) in &points {
                let p = surface.on(share, turn).truncate();
                prop_assert!((freeform.height(p) - freeform.conic.height(p) - value(p)).abs() < 1e-13);
            }
            bounds_hold(&freeform, &points)?;
            // And they are of use: not much larger than what occurs.
            let occurs = (0..=400).map(|i| freeform.at(surface.on(f64::from(i % 21) / 20.0, f64::from(i) / 400.0).truncate()));
            let slope = occurs.fold(0.0f64, |slope, at| slope.max(at.gradient.length()));
            prop_assert!(freeform.bounds().slope <= 1.2 * slope + 0.05, "{:?} beside {slope}", freeform.bounds());
        }
    }
}
