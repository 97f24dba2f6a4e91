//! Zernike surfaces: a conic and Zernike polynomials, in the orders and with the norms of three conventions.

use crate::Result;
use crate::model::checks;
use crate::model::shapes::freeform::Freeform;
pub use crate::model::shapes::freeform::FreeformSurface;
use crate::model::shapes::freeform::{HIGHEST_POWER, Polynomial};
use crate::model::shapes::sag::{SagSurface, check_aperture, written};
use crate::model::shapes::{Shape, WrittenShape};
use glam::DVec2;
use schemars::JsonSchema;
use serde::Deserialize;

/// Most coefficients: all polynomials up to order 21 of the standard ones, up to order 15 of Fringe.
const MAX_COEFFICIENTS: usize = 256;

/// In which order Zernike polynomials are counted, and how large they are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ZernikeType {
    /// OSA/ANSI Z80.28, of unit variance over the disk.
    #[default]
    Standard,
    /// Noll (1976), of unit variance: Zemax' "standard coefficients".
    Noll,
    /// Fringe, or University of Arizona, of unit size at the rim.
    Fringe,
}

written! {
    /// A Zernike surface in a scene file.
    #[schemars(rename = "Zernike")]
    pub struct Written {
        /// Semi-diameter \[mm\], at most `norm_radius`.
        pub aperture_radius: f64,
        /// Coefficients \[mm\], of the first polynomials of the convention, up to 256.
        #[serde(default)]
        pub coefficients: Vec<f64>,
        /// The convention.
        #[serde(default)]
        pub zernike_type: ZernikeType,
        /// The radius of the disk on which the polynomials are defined \[mm\].
        pub norm_radius: f64,
    }
}

impl WrittenShape for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        Freeform::check(self.radius, self.conic, self.aperture_radius, &[], at)?;
        for (i, &coefficient) in self.coefficients.iter().enumerate() {
            checks::between(format!("{}[{i}]", at("coefficients")), coefficient, -1e30, 1e30)?;
        }
        let num = self.coefficients.len();
        if num > MAX_COEFFICIENTS || self.zernike_type.order(num) > HIGHEST_POWER {
            let problem =
                format!("{num} coefficients go beyond order {HIGHEST_POWER}, or {MAX_COEFFICIENTS}");
            return checks::refuse(at("coefficients"), problem, "give fewer");
        }
        Freeform::check_norm("norm_radius", self.norm_radius, self.aperture_radius, at)?;
        check_aperture(self.aperture.as_ref(), at)
    }

    fn shape(&self, place: &str, _: Option<usize>) -> Result<Shape> {
        let indices = self.zernike_type.indices(self.coefficients.len());
        let value = |p: DVec2| {
            let terms = self.coefficients.iter().zip(&indices).filter(|(c, _)| **c != 0.0);
            terms
                .map(|(c, &(n, m))| c * self.zernike_type.norm(n, m) * zernike(n, m, p / self.norm_radius))
                .sum()
        };
        let order = self.zernike_type.order(self.coefficients.len());
        let kind = 3.0 + f64::from(self.zernike_type as u8);
        let definition = [&[kind, self.norm_radius][..], &self.coefficients].concat();
        let polynomial = Polynomial { powers: [order; 2], order, value: &value, definition };
        let freeform =
            Freeform::new(self.radius, self.conic, self.aperture_radius, &polynomial).checked(place)?;
        SagSurface::written(freeform, self.aperture.as_ref(), place).map(Shape::Zernike)
    }
}

impl ZernikeType {
    /// The place of the polynomial of radial order n and azimuthal order m, counted from 0.
    fn place(self, n: i32, m: i32) -> usize {
        let place = match self {
            ZernikeType::Standard => (n * (n + 2) + m) / 2,
            ZernikeType::Noll => {
                let is_late = if n % 4 >= 2 { m >= 0 } else { m <= 0 };
                n * (n + 1) / 2 + m.abs() + i32::from(is_late) - 1
            }
            ZernikeType::Fringe => (1 + (n + m.abs()) / 2).pow(2) - 2 * m.abs() + i32::from(m < 0) - 1,
        };
        place as usize
    }

    /// The orders of the first polynomials.
    fn indices(self, num: usize) -> Vec<(i32, i32)> {
        let mut found = vec![(0, 0); num];
        // Of a Fringe polynomial (n + |m|) / 2 is at most the root of its place, and n is at most twice that.
        let most = 2 * (num as f64).sqrt() as i32 + 2;
        for n in 0..=most {
            for m in (-n..=n).step_by(2) {
                if let Some(index) = found.get_mut(self.place(n, m)) {
                    *index = (n, m);
                }
            }
        }
        found
    }

    /// The highest order of the first polynomials.
    fn order(self, num: usize) -> usize {
        self.indices(num).iter().map(|(n, _)| *n as usize).max().unwrap_or(0)
    }

    fn norm(self, n: i32, m: i32) -> f64 {
        match self {
            ZernikeType::Fringe => 1.0,
            ZernikeType::Standard | ZernikeType::Noll => {
                f64::from((2 * n + 2) / if m == 0 { 2 } else { 1 }).sqrt()
            }
        }
    }
}

/// The polynomial of orders n and m at a point, in units of the norm. It is the radial part over r^|m|, by powers of
/// r^2, times the real or imaginary part of (x + i y)^|m|.
fn zernike(n: i32, m: i32, p: DVec2) -> f64 {
    let (square, turns) = (p.length_squared(), m.abs());
    let half = (n - turns) / 2;
    // (-1)^k (n - k)! / (k! ((n + |m|) / 2 - k)! ((n - |m|) / 2 - k)!), as products of binomials.
    let coefficient = |k: i32| {
        let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
        sign * binomial(n - k, k) * binomial(n - 2 * k, half - k)
    };
    let radial = (0..=half).fold(0.0, |sum, k| sum * square + coefficient(k));
    let turned = (0..turns).fold(DVec2::X, |power, _| power.rotate(p));
    radial * if m < 0 { turned.y } else { turned.x }
}

fn binomial(n: i32, k: i32) -> f64 {
    (0..k).map(|i| f64::from(n - i) / f64::from(i + 1)).product::<f64>().round()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Polynomials of a high order are far larger in the corners of the square than in the disk. Yet f64 has enough
    /// digits, and the bounds hold in the disk. For the highest order too few digits are left.
    #[test]
    fn high_orders_are_bounded_and_the_highest_are_refused() {
        use crate::model::shapes::sag::Sag;
        use crate::model::shapes::{Geometry, Shape};

        let written = |num: usize, size: f64| {
            let mut coefficients = vec![0.0; num];
            coefficients[num - 1] = size;
            let (radius, zernike_type) = (f64::INFINITY, ZernikeType::Fringe);
            Written {
                radius,
                conic: 0.0,
                aperture_radius: 10.0,
                coefficients,
                zernike_type,
                norm_radius: 10.0,
                aperture: None,
            }
        };
        // Order 12, the last of 37 terms: its slope is at most 84 at the rim, in units of its size over the radius.
        let Shape::Zernike(surface) = written(49, 0.01).shape("", None).unwrap() else {
            panic!("no Zernike")
        };
        let bounds = surface.sag.bounds();
        // Cells at the rim reach a little beyond it, where the polynomial rises.
        assert!((0.084..0.25).contains(&bounds.slope), "{bounds:?}");
        assert!(bounds.lowest > -0.01 && bounds.highest < 0.05, "{bounds:?}");
        for share in [0.0, 0.3, 0.7, 1.0] {
            let p = DVec2::new(6.0 * share, 8.0 * share);
            let expected = 0.01 * zernike(12, 0, p / 10.0);
            assert!((surface.level(p.extend(expected)).unwrap().value).abs() < 1e-13);
        }
        let refused = written(256, 1.0).shape("s", None).unwrap_err().to_string();
        assert!(refused.contains("s.coefficients") && refused.contains("fewer of high order"), "{refused}");
    }

    /// The first polynomials by their names, at a point, as the conventions count them.
    #[test]
    fn conventions_count_as_they_should() {
        let p = DVec2::new(0.3, -0.5);
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let (tilt_x, tilt_y, defocus) = (x, y, 2.0 * r2 - 1.0);
        let (oblique, astigmatism) = (2.0 * x * y, x * x - y * y);
        let (coma_x, coma_y) = ((3.0 * r2 - 2.0) * x, (3.0 * r2 - 2.0) * y);
        let spherical = 6.0 * r2 * r2 - 6.0 * r2 + 1.0;
        let (trefoil_x, trefoil_y) = (x * x * x - 3.0 * x * y * y, 3.0 * x * x * y - y * y * y);
        let [three, five, six, eight] = [3.0f64, 5.0, 6.0, 8.0].map(f64::sqrt);
        let check = |kind: ZernikeType, expected: &[f64]| {
            for (i, (&(n, m), value)) in kind.indices(expected.len()).iter().zip(expected).enumerate() {
                let found = kind.norm(n, m) * zernike(n, m, p);
                assert!((found - value).abs() < 1e-14, "{kind:?} {i}: {found}, not {value}");
            }
        };
        check(
            ZernikeType::Standard,
            &[
                1.0,
                2.0 * tilt_y,
                2.0 * tilt_x,
                six * oblique,
                three * defocus,
                six * astigmatism,
                eight * trefoil_y,
                eight * coma_y,
                eight * coma_x,
                eight * trefoil_x,
            ],
        );
        // Noll, J. Opt. Soc. Am. 66, 207 (1976), table I.
        check(
            ZernikeType::Noll,
            &[
                1.0,
                2.0 * tilt_x,
                2.0 * tilt_y,
                three * defocus,
                six * oblique,
                six * astigmatism,
                eight * coma_y,
                eight * coma_x,
                eight * trefoil_y,
                eight * trefoil_x,
                five * spherical,
            ],
        );
        check(
            ZernikeType::Fringe,
            &[1.0, tilt_x, tilt_y, defocus, astigmatism, oblique, coma_x, coma_y, spherical, trefoil_x],
        );
        for kind in [ZernikeType::Standard, ZernikeType::Noll, ZernikeType::Fringe] {
            let indices = kind.indices(MAX_COEFFICIENTS);
            let distinct: std::collections::HashSet<_> = indices.iter().collect();
            assert_eq!(distinct.len(), MAX_COEFFICIENTS, "{kind:?} leaves a place empty");
        }
    }
}
