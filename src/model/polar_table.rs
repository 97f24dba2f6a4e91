//! Tables over the polar angle and the azimuth about an axis, by which directions are drawn. Examples are the intensity
//! of a lamp, and a measured BSDF about the specular direction.
//!
//! Between the angles of the table the function is linear in each of them. Beyond the polar angles it is 0.
//!
//! A direction is drawn by the exact inverse of the table's distribution. The polar angle comes first, by the integral between
//! polar angles and by Newton's method within an interval. The azimuth follows, by the integral around that cone and by a
//! quadratic equation within an interval.

use std::f64::consts::{PI, TAU};

/// Longest interval of polar angles in the shaders' table \[rad\]: the series of shaders/optics/polar_table.wgsl are exact to
/// 1e-13 up to there.
const LONGEST_INTERVAL: f64 = 0.02;

/// Values over polar angles and azimuths, all around the axis: of a lamp, intensities; its integral is a flux.
#[derive(Debug, Clone, PartialEq)]
pub struct PolarTable {
    /// Polar angles, rising \[rad\].
    pub polar: Vec<f64>,
    /// Azimuths, rising from 0 to 2 pi \[rad\]; the rows of both ends are alike.
    pub azimuth: Vec<f64>,
    /// A row of values for each azimuth.
    pub rows: Vec<Vec<f64>>,
}

/// The integral of intensity over all directions: over polar angles and azimuths \[rad\], with a row for each azimuth, or one
/// row all around. Intensity is linear in each angle, and the integral of that is exact.
pub(crate) fn flux(polar: &[f64], azimuth: &[f64], rows: &[Vec<f64>]) -> f64 {
    let of_rows: Vec<f64> = rows.iter().map(|row| flux_per_radian(polar, row)).collect();
    match of_rows.as_slice() {
        [all_around] => TAU * all_around,
        _ => {
            let steps = azimuth.windows(2).map(|pair| pair[1] - pair[0]);
            steps.zip(of_rows.windows(2)).map(|(step, pair)| step * (pair[0] + pair[1]) / 2.0).sum()
        }
    }
}

/// The integral of I sin(theta) d(theta) over a plane.
fn flux_per_radian(polar: &[f64], row: &[f64]) -> f64 {
    let intervals = polar.windows(2).zip(row.windows(2));
    intervals.map(|(angles, values)| flux_between([angles[0], angles[1]], [values[0], values[1]])).sum()
}

/// The integral of I sin(theta) d(theta) over an interval where I is linear in theta: from the middle, so that little cancels.
fn flux_between([a, b]: [f64; 2], values: [f64; 2]) -> f64 {
    let (middle, half) = ((a + b) / 2.0, (b - a) / 2.0);
    if half <= 0.0 {
        return 0.0;
    }
    let mean = (values[0] + values[1]) * middle.sin() * half.sin();
    let slope = (values[1] - values[0]) * middle.cos() * (half.sin() - half * half.cos()) / half;
    mean + slope
}

/// A row of the shaders' table: a polar angle and what is known there.
struct Knot {
    /// Polar angle \[rad\].
    angle: f64,
    /// Intensities by azimuth.
    values: Vec<f64>,
    /// Their integrals over the azimuth, from 0 to each.
    sums: Vec<f64>,
}

impl Knot {
    fn new(azimuth: &[f64], angle: f64, values: Vec<f64>) -> Self {
        let mut sum = 0.0;
        let steps = azimuth.windows(2).zip(values.windows(2));
        let sums = std::iter::once(0.0).chain(steps.map(|(angles, values)| {
            sum += (angles[1] - angles[0]) * (values[0] + values[1]) / 2.0;
            sum
        }));
        Knot { angle, sums: sums.collect(), values }
    }

    /// The integral around the axis.
    fn total(&self) -> f64 {
        self.sums.last().copied().unwrap_or(0.0)
    }

    /// The flux between two knots: the integral of (M + B s) sin(angle + s), by the series of the shader.
    fn flux_to(&self, next: &Knot) -> f64 {
        let length = next.angle - self.angle;
        let slope = (next.total() - self.total()) / length;
        flux_within(self.angle.sin(), self.angle.cos(), self.total(), slope, length)
    }
}

/// The integral of (m + b t) sin(theta + t) for t from 0 to s, with `sine` and `cosine` of theta: the series of
/// shaders/optics/polar_table.wgsl.
fn flux_within(sine: f64, cosine: f64, m: f64, b: f64, s: f64) -> f64 {
    let square = s * s;
    let of_cosine = s * (1.0 - square / 6.0 * (1.0 - square / 20.0));
    let of_sine = square / 2.0 * (1.0 - square / 12.0 * (1.0 - square / 30.0));
    let with_cosine = square / 2.0 * (1.0 - square / 4.0 * (1.0 - square / 18.0));
    let with_sine = square * s / 3.0 * (1.0 - square / 10.0 * (1.0 - square / 28.0));
    m * (sine * of_cosine + cosine * of_sine) + b * (sine * with_cosine + cosine * with_sine)
}

/// Distances from a pole between rising ones that lie far apart. With them sin(theta) grows little within an interval,
/// and Newton's method converges in a few steps.
fn nearer_to_pole(rising: impl Iterator<Item = f64>) -> Vec<f64> {
    /// How much farther the end of an interval may be from the pole than its beginning.
    const MOST_FARTHER: f64 = 3.0;
    /// Most halvings of an interval that begins in the pole.
    const HALVINGS: usize = 8;
    let (mut more, mut near) = (Vec::new(), None);
    for distance in rising {
        let mut far = distance;
        for _ in 0..HALVINGS {
            if near.is_some_and(|near| far > MOST_FARTHER * near) {
                far /= 2.0;
                more.push(far);
            }
        }
        near = Some(distance);
    }
    more
}

/// The end of the interval of an angle among rising ones, and how far the angle lies in the interval.
fn place_among(rising: &[f64], angle: f64) -> (usize, f64) {
    let next = rising.partition_point(|known| *known <= angle).clamp(1, rising.len() - 1);
    let (low, high) = (rising[next - 1], rising[next]);
    (next, (angle - low) / (high - low))
}

impl PolarTable {
    /// Flux over all directions, in the units of the table times sr.
    pub fn flux(&self) -> f64 {
        flux(&self.polar, &self.azimuth, &self.rows)
    }

    /// Its polar angles, and as many between them as the shaders' series and Newton's method ask for. Intensity is linear
    /// there, so that nothing is approximated.
    fn knots(&self) -> Vec<Knot> {
        let mut angles: Vec<f64> = Vec::new();
        for ends in self.polar.windows(2) {
            let length = ends[1] - ends[0];
            let parts = (length / LONGEST_INTERVAL).ceil().max(1.0) as usize;
            angles.extend((0..parts).map(|i| ends[0] + length * (i as f64 / parts as f64)));
        }
        angles.extend(self.polar.last());
        let upper = nearer_to_pole(angles.iter().copied());
        let lower =
            nearer_to_pole(angles.iter().rev().map(|angle| PI - angle)).into_iter().map(|angle| PI - angle);
        angles.extend(upper.into_iter().chain(lower.collect::<Vec<_>>()));
        angles.sort_by(f64::total_cmp);
        angles.dedup();
        angles.into_iter().map(|angle| Knot::new(&self.azimuth, angle, self.row_at(angle))).collect()
    }

    /// Values by polar angle at an azimuth.
    #[cfg(feature = "viewer")]
    pub(crate) fn plane_at(&self, azimuth: f64) -> Vec<f64> {
        let (next, part) = place_among(&self.azimuth, azimuth);
        let rows = self.rows[next - 1].iter().zip(&self.rows[next]);
        rows.map(|(low, high)| low * (1.0 - part) + high * part).collect()
    }

    /// Values by azimuth at a polar angle.
    pub(crate) fn row_at(&self, angle: f64) -> Vec<f64> {
        let (next, part) = place_among(&self.polar, angle);
        self.rows.iter().map(|row| row[next - 1] * (1.0 - part) + row[next] * part).collect()
    }

    /// The table of shaders/optics/polar_table.wgsl, for a flux of 1. The numbers of knots and of azimuths come first.
    /// Then come the shares of the flux below each knot, and the knots' angles. Each knot then has the angle to the
    /// next one, its sine, cosine and total. Azimuths follow. Last, each knot has its values and then their sums.
    pub(crate) fn numbers(&self) -> Vec<f64> {
        let knots = self.knots();
        let fluxes: Vec<f64> = knots.windows(2).map(|pair| pair[0].flux_to(&pair[1])).collect();
        let flux: f64 = fluxes.iter().sum();
        let mut below = 0.0;
        let mut numbers = vec![knots.len() as f64, self.azimuth.len() as f64, 0.0];
        numbers.extend(fluxes.iter().map(|one| {
            below += one;
            // Shares behind the last light are 1 exactly, so that no draw falls there.
            if below >= flux { 1.0 } else { below / flux }
        }));
        numbers.extend(knots.iter().map(|knot| knot.angle));
        let lengths = knots.windows(2).map(|pair| pair[1].angle - pair[0].angle).chain(std::iter::once(0.0));
        numbers.extend(
            knots
                .iter()
                .zip(lengths)
                .flat_map(|(knot, length)| [length, knot.angle.sin(), knot.angle.cos(), knot.total() / flux]),
        );
        numbers.extend(&self.azimuth);
        numbers.extend(
            knots.iter().flat_map(|knot| [&knot.values[..], &knot.sums].concat()).map(|value| value / flux),
        );
        numbers
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(polar: &[f64], rows: Vec<Vec<f64>>) -> PolarTable {
        let azimuth = (0..rows.len()).map(|i| TAU * i as f64 / (rows.len() - 1) as f64).collect();
        PolarTable { polar: polar.to_vec(), azimuth, rows }
    }

    /// 1 cd in all directions is 4 pi lm. A hat over a right angle has pi^2 - 2 pi of its peak, of which 4 come from
    /// its rim.
    #[test]
    fn the_flux_is_the_integral_of_the_table() {
        let even = table(&[0.0, PI], vec![vec![1.0, 1.0]; 2]).flux();
        assert!((even - 4.0 * PI).abs() < 1e-12, "{even}");
        // The integral of 2 pi (1 - 2 theta / pi) sin(theta) from 0 to pi / 2 is 2 pi (1 - 2 / pi).
        let cone = table(&[0.0, PI / 2.0], vec![vec![1.0, 0.0]; 3]).flux();
        assert!((cone - 2.0 * PI * (1.0 - 2.0 / PI)).abs() < 1e-12, "{cone}");
        // Half of the circle is dark but for two slopes, which make up for the other half.
        let rows = vec![vec![0.0; 2], vec![1.0; 2], vec![0.0; 2]];
        let half = table(&[0.5, 1.5], rows).flux();
        assert!((half - PI * (0.5_f64.cos() - 1.5_f64.cos())).abs() < 1e-12, "{half}");
    }
}
