//! Converts watts to lumens, by Optiland's photopic curve.

/// The beginning of the curve \[um\]; the curve is 0 outside.
const FIRST: f64 = 0.380;
/// Step of the table \[um\].
const STEP: f64 = 0.010;
/// CIE 1931 luminous efficiency of the 2-degree observer, 380 nm to 780 nm, as in `optiland.nonsequential.units` 0.6.3.
const PHOTOPIC: [f64; 41] = [
    0.0000, 0.0001, 0.0004, 0.0012, 0.0040, 0.0116, 0.0230, 0.0380, 0.0600, 0.0910, 0.1390, 0.2080, 0.3230,
    0.5030, 0.7100, 0.8620, 0.9540, 0.9950, 0.9950, 0.9520, 0.8700, 0.7570, 0.6310, 0.5030, 0.3810, 0.2650,
    0.1750, 0.1070, 0.0610, 0.0320, 0.0170, 0.0082, 0.0041, 0.0021, 0.0010, 0.00052, 0.00025, 0.00012,
    0.00006, 0.00003, 0.000015,
];
/// Optiland's luminous efficacy at 555 nm \[lm/W\].
const PEAK: f64 = 683.002;
/// Below this fraction of the peak, light counts as invisible and not as dim: Optiland's guard.
const NEGLIGIBLE: f64 = 1e-6;

/// Luminous efficacy of a wavelength in um \[lm/W\]; 0 outside 0.38 um to 0.78 um.
pub fn efficacy(wavelength: f64) -> f64 {
    let at = (wavelength - FIRST) / STEP;
    let last = (PHOTOPIC.len() - 1) as f64;
    // The edges of the band are not exact in binary.
    if !(-1e-9..=last + 1e-9).contains(&at) {
        return 0.0;
    }
    let at = at.clamp(0.0, last);
    let index = (at as usize).min(PHOTOPIC.len() - 2);
    let part = at - index as f64;
    PEAK * (PHOTOPIC[index] * (1.0 - part) + PHOTOPIC[index + 1] * part)
}

/// True if the eye sees light of this efficacy.
pub fn is_visible(efficacy: f64) -> bool {
    efficacy >= PEAK * NEGLIGIBLE
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_is_optilands() {
        for (wavelength, expected) in [
            (0.555, 683.002 * 0.995),
            (0.58756, 683.002 * (0.8700 + (0.7570 - 0.8700) * 0.756)),
            (0.38, 0.0),
            (0.78, 683.002 * 0.000015),
            (0.379, 0.0),
            (1.55, 0.0),
        ] {
            assert!((efficacy(wavelength) - expected).abs() < 1e-9, "{wavelength} {}", efficacy(wavelength));
        }
        assert!(is_visible(efficacy(0.77)) && !is_visible(efficacy(1.064)));
    }
}
