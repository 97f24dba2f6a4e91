//! The colour of what detectors saw, with errors.
//!
//! X, Y and Z are sums of the light of each wavelength, weighted by the observer's colour-matching functions. Y is the
//! photometric map. A ray keeps its wavelength for life. So the variances of X, Y and Z and of their sums are as exact
//! as variances of watts. Covariances follow from the sums: 2 cov(X, Y) = var(X + Y) - var(X) - var(Y).

use crate::error::Result;
use crate::result::npz::ArrayWriter;
use ndarray::{ArrayD, Axis, stack};
use serde::{Deserialize, Serialize};

/// The colour of what a detector saw, by the CIE 1931 observer of 2 degrees.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Color {
    /// X, Y and Z of all light \[lm\].
    #[serde(rename = "flux_XYZ_lm")]
    pub flux: [f64; 3],
    /// Their standard errors; none if second moments were not summed.
    #[serde(rename = "flux_XYZ_lm_standard_error")]
    pub flux_standard_error: Option<[f64; 3]>,
    /// The chromaticity of all light; none in the dark.
    pub chromaticity: Option<Chromaticity>,
    /// X, Y and Z in the shape of the detector's map \[lx\]; of a far field \[cd\].
    #[serde(skip)]
    pub xyz: [ArrayD<f64>; 3],
    /// Their standard errors, one behind the other; none if second moments were not summed.
    #[serde(skip)]
    pub standard_error: Option<ArrayD<f64>>,
    /// The covariances of X and Y, X and Z, Y and Z, one behind the other \[lx^2\] or \[cd^2\].
    #[serde(skip)]
    pub covariance: Option<ArrayD<f64>>,
}

/// A chromaticity: x and y of the CIE 1931 diagram, u' and v' of the CIE 1976 diagram (CIE 015:2018, sections 7.3 and 8.1).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Chromaticity {
    /// X / (X + Y + Z).
    pub x: f64,
    /// Y / (X + Y + Z).
    pub y: f64,
    /// 4 X / (X + 15 Y + 3 Z).
    pub u_prime: f64,
    /// 9 Y / (X + 15 Y + 3 Z).
    pub v_prime: f64,
    /// Their standard errors, in this order.
    pub standard_error: Option<[f64; 4]>,
}

/// The pairs of X, Y and Z.
pub(crate) const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// A weighted sum of light: all of it, the map, and their standard errors.
pub(crate) struct Weighted {
    pub flux: f64,
    pub flux_error: Option<f64>,
    pub map: ArrayD<f64>,
    pub error: Option<ArrayD<f64>>,
}

impl Color {
    /// The colour, of X, Y and Z, and of their sums in [`PAIRS`].
    pub(crate) fn new(of: &[Weighted; 3], of_pairs: &[Weighted; 3]) -> Self {
        let covariance_of =
            |errors: [f64; 3]| (errors[2].powi(2) - errors[0].powi(2) - errors[1].powi(2)) / 2.0;
        let flux = [0, 1, 2].map(|i| of[i].flux);
        let flux_standard_error: Option<Vec<f64>> = of.iter().map(|one| one.flux_error).collect();
        let flux_standard_error: Option<[f64; 3]> =
            flux_standard_error.and_then(|errors| errors.try_into().ok());
        let covariances = flux_standard_error.and_then(|errors| {
            let mut all = [[0.0; 3]; 3];
            (0..3).for_each(|i| all[i][i] = errors[i].powi(2));
            for (pair, (a, b)) in of_pairs.iter().zip(PAIRS) {
                let covariance = covariance_of([errors[a], errors[b], pair.flux_error?]);
                (all[a][b], all[b][a]) = (covariance, covariance);
            }
            Some(all)
        });
        let errors: Option<Vec<&ArrayD<f64>>> = of.iter().map(|one| one.error.as_ref()).collect();
        let covariance = errors.as_ref().and_then(|errors| {
            let mut maps = Vec::new();
            for (pair, (a, b)) in of_pairs.iter().zip(PAIRS) {
                let mut map = pair.error.clone()?;
                ndarray::Zip::from(&mut map).and(errors[a]).and(errors[b]).for_each(|sum, one, other| {
                    *sum = covariance_of([*one, *other, *sum]);
                });
                maps.push(map);
            }
            one_behind_the_other(&maps.iter().collect::<Vec<_>>())
        });
        Color {
            flux,
            flux_standard_error,
            chromaticity: Chromaticity::of(flux, covariances),
            xyz: [0, 1, 2].map(|i| of[i].map.clone()),
            standard_error: errors.and_then(|errors| one_behind_the_other(&errors)),
            covariance,
        }
    }

    /// Adds its maps to a file of arrays.
    pub(crate) fn add_to(&self, file: &mut ArrayWriter) -> Result<()> {
        for (name, map) in ["X", "Y", "Z"].into_iter().zip(&self.xyz) {
            file.add(name, map)?;
        }
        file.add_optional("standard_error_XYZ", &self.standard_error)?;
        file.add_optional("covariance_XYZ", &self.covariance)
    }

    /// Units of the arrays in that file, for a map in this unit.
    pub(crate) fn units(unit: &'static str) -> [(&'static str, &'static str); 5] {
        let squared = if unit == "cd" { "cd^2" } else { "lx^2" };
        [("X", unit), ("Y", unit), ("Z", unit), ("standard_error_XYZ", unit), ("covariance_XYZ", squared)]
    }
}

fn one_behind_the_other(maps: &[&ArrayD<f64>]) -> Option<ArrayD<f64>> {
    let views: Vec<_> = maps.iter().map(|map| map.view()).collect();
    stack(Axis(0), &views).ok()
}

impl Chromaticity {
    /// Of X, Y and Z and their covariances, to first order; none in the dark.
    pub fn of([x, y, z]: [f64; 3], covariances: Option<[[f64; 3]; 3]>) -> Option<Self> {
        let (sum, wide) = (x + y + z, x + 15.0 * y + 3.0 * z);
        if sum <= 0.0 {
            return None;
        }
        // The derivatives of a / b by X, Y and Z.
        let quotient = |a: f64, of_a: [f64; 3], b: f64, of_b: [f64; 3]| {
            [0, 1, 2].map(|i| (of_a[i] - of_b[i] * a / b) / b)
        };
        let gradients = [
            quotient(x, [1.0, 0.0, 0.0], sum, [1.0; 3]),
            quotient(y, [0.0, 1.0, 0.0], sum, [1.0; 3]),
            quotient(4.0 * x, [4.0, 0.0, 0.0], wide, [1.0, 15.0, 3.0]),
            quotient(9.0 * y, [0.0, 9.0, 0.0], wide, [1.0, 15.0, 3.0]),
        ];
        let error = |gradient: [f64; 3], covariances: &[[f64; 3]; 3]| {
            let pairs = (0..3).flat_map(|i| (0..3).map(move |j| (i, j)));
            let variance: f64 = pairs.map(|(i, j)| gradient[i] * covariances[i][j] * gradient[j]).sum();
            variance.max(0.0).sqrt()
        };
        Some(Chromaticity {
            x: x / sum,
            y: y / sum,
            u_prime: 4.0 * x / wide,
            v_prime: 9.0 * y / wide,
            standard_error: covariances
                .map(|covariances| gradients.map(|gradient| error(gradient, &covariances))),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Standard illuminant E is at x = y = 1/3, u' = 4/19, v' = 9/19. Errors of light in proportion have no
    /// chromaticity. Errors of X alone follow by differences.
    #[test]
    fn chromaticity_and_its_errors() {
        let white = Chromaticity::of([2.0; 3], Some([[0.01; 3]; 3])).unwrap();
        assert!((white.x - 1.0 / 3.0).abs() < 1e-15 && (white.u_prime - 4.0 / 19.0).abs() < 1e-15);
        assert!(white.standard_error.unwrap().iter().all(|error| *error < 1e-9));
        let xyz = [0.4, 0.5, 0.2];
        let mut alone = [[0.0; 3]; 3];
        alone[0][0] = 1e-4;
        let [of_x, of_y, of_u, of_v] = Chromaticity::of(xyz, Some(alone)).unwrap().standard_error.unwrap();
        let moved = |off: f64| Chromaticity::of([xyz[0] + off, xyz[1], xyz[2]], None).unwrap();
        let by = |figure: fn(&Chromaticity) -> f64| {
            0.01 * ((figure(&moved(1e-5)) - figure(&moved(-1e-5))) / 2e-5).abs()
        };
        for (found, expected) in
            [(of_x, by(|c| c.x)), (of_y, by(|c| c.y)), (of_u, by(|c| c.u_prime)), (of_v, by(|c| c.v_prime))]
        {
            assert!((found / expected - 1.0).abs() < 1e-7, "{found} and {expected}");
        }
        assert_eq!(Chromaticity::of([0.0; 3], None), None);
    }
}
