//! What noise as large as a map's own does to a figure.
//!
//! A parametric bootstrap: normal noise of the cells' standard errors is added to the map again and again. Source:
//! Efron and Tibshirani, An Introduction to the Bootstrap (1993), section 6.5. The spread of a figure between these
//! maps is its standard error. Their mean shift from the figure says what noise does to it: it lowers the least of many
//! cells, and raises the largest.

use crate::random::Draw;
use crate::result::figures::field::Field;
use crate::result::figures::found::Figure;

/// Maps with noise. The standard error of a standard error of so many is 5 %.
const NOISY_MAPS: usize = 200;

/// Figures of a field, of which some may not exist. Figures have errors if the errors of the field's cells are known.
pub(super) fn with_errors<const N: usize>(
    field: &Field,
    has_errors: bool,
    figures: impl Fn(&Field) -> [Option<f64>; N],
) -> [Option<Figure>; N] {
    let values = figures(field);
    let mut of_noise = vec![[None; N]; 0];
    if has_errors {
        let mut noisy = field.clone();
        let mut draws = Draw::new(0);
        for _ in 0..NOISY_MAPS {
            for ((noisy, &value), &error) in noisy.values.iter_mut().zip(&field.values).zip(&field.sigma) {
                *noisy = if error > 0.0 { value + error * draws.normal() } else { value };
            }
            of_noise.push(figures(&noisy));
        }
    }
    std::array::from_fn(|number| {
        let value = values[number]?;
        let noisy: Vec<f64> = of_noise.iter().filter_map(|figures| figures[number]).collect();
        // Where noise makes a figure vanish, its spread says too little.
        let is_known = has_errors && noisy.len() == NOISY_MAPS;
        let mean = noisy.iter().sum::<f64>() / noisy.len() as f64;
        let variance =
            noisy.iter().map(|found| (found - mean).powi(2)).sum::<f64>() / (noisy.len() as f64 - 1.0);
        Some(Figure {
            value,
            standard_error: is_known.then(|| variance.sqrt()),
            noise_bias: is_known.then_some(mean - value),
        })
    })
}
