//! The share of the light that a table about the specular direction scatters: an integral that the horizon cuts.

use crate::model::PolarTable;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Places and weights of Gauss's rule of eight points on -1 to 1, for the half from 0 to 1. Source: Abramowitz and
/// Stegun, Handbook of Mathematical Functions, table 25.4.
const GAUSS: [(f64, f64); 4] = [
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_27),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_48),
    (0.960_289_856_497_536_3, 0.101_228_536_290_376_26),
];

/// The integral of the values times the cosine of the direction with the normal. The azimuth is integrated in closed
/// form, the radial angle by Gauss's rule. Relative error: 1e-13.
pub(super) fn within_hemisphere(values: &PolarTable, incidence_deg: f64) -> f64 {
    /// Longest step of the radial angle \[rad\].
    const LONGEST_STEP: f64 = 0.05;
    /// Halvings of a step on either side of where the horizon begins and ends, for the integrand has a root there.
    const HALVINGS: i32 = 16;
    let incidence = incidence_deg.to_radians();
    let mut ends: Vec<f64> = values.polar.clone();
    for pair in values.polar.windows(2) {
        let steps = ((pair[1] - pair[0]) / LONGEST_STEP).ceil().max(1.0);
        ends.extend((1..steps as usize).map(|i| pair[0] + (pair[1] - pair[0]) * i as f64 / steps));
    }
    for kink in [FRAC_PI_2 - incidence, FRAC_PI_2 + incidence] {
        ends.push(kink);
        let offs = (0..HALVINGS).map(|k| LONGEST_STEP * 0.5_f64.powi(k));
        ends.extend(offs.flat_map(|off| [kink - off, kink + off]));
    }
    let last = values.polar[values.polar.len() - 1];
    ends.retain(|end| (0.0..=last).contains(end));
    ends.sort_by(f64::total_cmp);
    let between = |pair: &[f64]| {
        let (middle, half) = ((pair[0] + pair[1]) / 2.0, (pair[1] - pair[0]) / 2.0);
        let at = |radial: f64| radial.sin() * around(values, radial, incidence);
        half * GAUSS.iter().map(|(x, w)| w * (at(middle - half * x) + at(middle + half * x))).sum::<f64>()
    };
    ends.windows(2).map(between).sum()
}

/// The integral over the azimuth at a radial angle. The cosine of scatter is a + b cos(azimuth), and the part above the horizon
/// is that about the azimuth 0.
fn around(values: &PolarTable, radial: f64, incidence: f64) -> f64 {
    let (a, b) = (radial.cos() * incidence.cos(), radial.sin() * incidence.sin());
    let horizon = if b > 0.0 {
        (-a / b).clamp(-1.0, 1.0).acos()
    } else if a > 0.0 {
        PI
    } else {
        0.0
    };
    let row = values.row_at(radial);
    let mut sum = 0.0;
    for (angles, ends) in values.azimuth.windows(2).zip(row.windows(2)) {
        let slope = (ends[1] - ends[0]) / (angles[1] - angles[0]);
        let start = ends[0] - slope * angles[0];
        // The integral of (start + slope x) (a + b cos x).
        let up_to = |x: f64| {
            a * x * (start + slope * x / 2.0) + b * (start * x.sin() + slope * (x * x.sin() + x.cos()))
        };
        for lit in [[0.0, horizon], [TAU - horizon, TAU]] {
            let (from, to) = (angles[0].max(lit[0]), angles[1].min(lit[1]));
            if from < to {
                sum += up_to(to) - up_to(from);
            }
        }
    }
    sum
}
