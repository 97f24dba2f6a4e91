//! How surfaces scatter, and what coatings do.

use std::f64::consts::{PI, TAU};

/// A coating of a refractive surface: it takes the place of Fresnel's reflectance and transmittance, total reflection
/// excepted. What the two leave of 1 is absorbed.
#[derive(Debug, Clone, PartialEq)]
pub struct Coating {
    /// Reflectance per wavelength of the scene.
    pub reflectance: Vec<f64>,
    /// Transmittance per wavelength of the scene.
    pub transmittance: Vec<f64>,
}

/// Scattering at a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Scatter {
    /// Probability that a ray is scattered; the others follow Fresnel or the mirror.
    pub fraction: f64,
    /// Where scattered rays go.
    pub bsdf: Bsdf,
}

/// Scatter models. `transmissive_fraction` is the probability that a scattered ray leaves on the far side.
#[derive(Debug, Clone, PartialEq)]
pub enum Bsdf {
    /// Mirror reflection.
    Specular,
    /// Cosine-weighted over the hemisphere.
    Lambertian {
        /// Fraction of the flux that is scattered, in \[0, 1\].
        reflectance_value: f64,
        /// See [`Bsdf`].
        transmissive_fraction: f64,
    },
    /// b0 / (1 + (beta / l0)^s), beta being the distance of direction cosines from the specular direction.
    HarveyShack {
        /// Value at beta = 0 \[1/sr\]. Only the shape matters here: rays keep their weight.
        b0: f64,
        /// Shoulder of the lobe.
        l0: f64,
        /// Slope beyond it.
        s: f64,
        /// See [`Bsdf`].
        transmissive_fraction: f64,
    },
    /// Values over polar angles of incidence and scatter, 0 beyond them.
    Tabulated {
        /// The values.
        table: BsdfTable,
        /// See [`Bsdf`].
        transmissive_fraction: f64,
    },
}

/// Values of a BSDF over two angles from the normal, the same for every azimuth.
#[derive(Debug, Clone, PartialEq)]
pub struct BsdfTable {
    /// Angles of incidence, ascending, at least two \[deg\].
    pub theta_i: Vec<f64>,
    /// Angles of scatter, ascending, at least two \[deg\].
    pub theta_s: Vec<f64>,
    /// One row of values per angle of incidence \[1/sr\].
    pub values: Vec<f64>,
}

impl Bsdf {
    /// The probability that a scattered ray leaves on the far side.
    pub fn transmissive_fraction(&self) -> f64 {
        match self {
            Bsdf::Specular => 0.0,
            Bsdf::Lambertian { transmissive_fraction, .. }
            | Bsdf::HarveyShack { transmissive_fraction, .. }
            | Bsdf::Tabulated { transmissive_fraction, .. } => *transmissive_fraction,
        }
    }
}

impl BsdfTable {
    /// The fraction of the flux that is scattered at an angle of incidence: the integral of value cos(theta_s) over the
    /// hemisphere, with the value linear in theta_s between its angles and 0 beyond them.
    pub fn albedo(&self, row: usize) -> f64 {
        let count = self.theta_s.len();
        let values = &self.values[row * count..(row + 1) * count];
        let intervals = self.theta_s.windows(2).zip(values.windows(2));
        intervals.map(|(theta, value)| scattered_between([theta[0], theta[1]], [value[0], value[1]])).sum()
    }
}

/// The integral of pi f sin(2 theta) d(theta) over an interval where f is linear in theta: by parts, exactly.
fn scattered_between(theta: [f64; 2], value: [f64; 2]) -> f64 {
    let [a, b] = theta.map(f64::to_radians);
    let slope = (value[1] - value[0]) / (b - a);
    let boundary = value[0] * (2.0 * a).cos() - value[1] * (2.0 * b).cos();
    let interior = slope * ((2.0 * b).sin() - (2.0 * a).sin()) / 2.0;
    PI / 2.0 * (boundary + interior)
}

/// Knots of a Harvey-Shack table.
pub const HARVEY_SHACK_KNOTS: usize = 4096;

/// Distances of direction cosines reach from 0 to 2.
const LONGEST_OFFSET: f64 = 2.0;

/// Distance of two knots.
pub const HARVEY_SHACK_STEP: f64 = LONGEST_OFFSET / (HARVEY_SHACK_KNOTS - 1) as f64;

/// The distribution of the radial offset at [`HARVEY_SHACK_KNOTS`] equal steps, by Optiland's trapezoids in its order,
/// and the total integrated scatter.
pub fn harvey_shack_table(b0: f64, l0: f64, s: f64) -> (Vec<f64>, f64) {
    let last = HARVEY_SHACK_KNOTS - 1;
    let beta = |knot: usize| if knot == last { LONGEST_OFFSET } else { knot as f64 * HARVEY_SHACK_STEP };
    // d(beta_x) d(beta_y) = 2 pi beta d(beta).
    let density = |knot: usize| b0 / (1.0 + (beta(knot) / l0).powf(s)) * TAU * beta(knot);
    let mut sum = 0.0;
    let mut cumulative = vec![0.0];
    cumulative.extend((1..HARVEY_SHACK_KNOTS).map(|knot| {
        sum += 0.5 * (density(knot) + density(knot - 1)) * (beta(knot) - beta(knot - 1));
        sum
    }));
    cumulative.iter_mut().for_each(|value| *value /= sum);
    (cumulative, sum)
}
