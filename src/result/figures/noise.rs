//! What noise as large as a map's own does to a figure.
//!
//! A parametric bootstrap: normal noise of the cells' standard errors is added to a map again and again. Source:
//! Efron and Tibshirani, An Introduction to the Bootstrap (1993), section 6.5. The spread of a figure between these
//! maps is its standard error. Their mean shift from the figure of the map without noise says what noise does to the
//! figure. Noise lowers the least of many cells, and raises the largest.
//!
//! The map that gets noise is the map itself or, for the least and the largest cell, a smoothed one. In the map itself,
//! the least cell is the one that noise has lowered most already, and more noise hardly lowers it further.

use crate::random::Draw;
use crate::result::figures::field::Field;
use crate::result::figures::found::Figure;

/// Maps with noise. The standard error of a standard error of so many is 5 %.
const NOISY_MAPS: usize = 200;

/// Figures of a field, of which some may not exist. Noise is added to `base`. Without it, figures have no errors.
pub(super) fn with_errors<const N: usize>(
    field: &Field,
    base: Option<&Field>,
    figures: impl Fn(&Field) -> [Option<f64>; N],
) -> [Option<Figure>; N] {
    let values = figures(field);
    let of_base = base.map(&figures);
    let mut of_noise = vec![[None; N]; 0];
    if let Some(base) = base {
        let mut noisy = base.clone();
        let mut draws = Draw::new(0);
        for _ in 0..NOISY_MAPS {
            for ((noisy, &value), &error) in noisy.values.iter_mut().zip(&base.values).zip(&base.sigma) {
                *noisy = if error > 0.0 { value + error * draws.normal() } else { value };
            }
            of_noise.push(figures(&noisy));
        }
    }
    std::array::from_fn(|number| {
        let value = values[number]?;
        let noisy: Vec<f64> = of_noise.iter().filter_map(|figures| figures[number]).collect();
        // Where noise makes a figure vanish, its spread says too little.
        let is_known = noisy.len() == NOISY_MAPS;
        let mean = noisy.iter().sum::<f64>() / noisy.len() as f64;
        let variance =
            noisy.iter().map(|found| (found - mean).powi(2)).sum::<f64>() / (noisy.len() as f64 - 1.0);
        let of_base = of_base.filter(|_| is_known).and_then(|of_base| of_base[number]);
        Some(Figure {
            value,
            standard_error: is_known.then(|| variance.sqrt()),
            noise_bias: of_base.map(|of_base| mean - of_base),
        })
    })
}
