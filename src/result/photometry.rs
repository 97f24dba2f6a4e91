//! Light as the eye judges it: lumens, lux and candela beside watts.
//!
//! Sums of each wavelength, weighted by its luminous efficiency V, become photometric maps
//! ([`crate::result::wavelengths_apart`]).

use crate::error::Result;
use crate::format::{shown, significant};
use crate::model::color::matching_functions;
use crate::model::photometry::{MOST_EFFICACY, efficacy, luminous_efficiency};
use crate::model::{Apart, DetectorKind, SceneIr, Source};
use crate::result::color::{Color, PAIRS, Weighted};
use crate::result::luminous::{Luminous, LuminousSource};
use crate::result::wavelengths_apart::weighted;
use crate::result::{Detector, FluxUnit, Moments, Tally, TraceResult};
use std::fmt::Write;

/// Square millimetres of a square metre: lm/mm^2 in lx.
const LUX: f64 = 1e6;

/// The text of a report: what sources give, and what detectors saw.
pub(crate) fn table(result: &TraceResult) -> String {
    let width =
        result.detectors.iter().map(|detector| shown(&detector.name).chars().count()).max().unwrap_or(0);
    let width = width.max(16) + 2;
    let mut table = format!("{:<width$}{:>14}{:>14}\n", "source", "lm", "lm/W");
    for (name, seen) in &result.sources {
        let _ = writeln!(
            table,
            "{:<width$}{:>14}{:>14}",
            shown(name),
            significant(seen.flux_lm, 6),
            significant(seen.efficacy, 5)
        );
    }
    let _ = writeln!(
        table,
        "{:<width$}{:>14}{:>14}{:>16}{:>16}{:>14}",
        "detector", "lm", "std. error", "mean", "peak", "std. error"
    );
    let error = |error: Option<f64>| {
        error.filter(|error| error.is_finite()).map_or("-".into(), |error| significant(error, 2))
    };
    for detector in &result.detectors {
        let Some(seen) = &detector.luminous else { continue };
        let (peak, of_peak) = seen.peak();
        let mean = seen.mean_lx().map_or("-".into(), |mean| format!("{} lx", significant(mean, 5)));
        let _ = writeln!(
            table,
            "{:<width$}{:>14}{:>14}{mean:>16}{:>16}{:>14}",
            shown(&detector.name),
            significant(seen.flux_lm, 6),
            error(seen.flux_lm_standard_error),
            format!("{} {}", significant(peak, 5), seen.unit()),
            error(of_peak),
        );
    }
    let colored: Vec<_> = result
        .detectors
        .iter()
        .filter_map(|detector| {
            Some((&detector.name, detector.luminous.as_ref()?.color.as_ref()?.chromaticity?))
        })
        .collect();
    if !colored.is_empty() {
        let _ = writeln!(table, "{:<width$}{:>20}{:>20}{:>20}{:>20}", "color", "x", "y", "u'", "v'");
    }
    for (name, color) in colored {
        let figure = |i: usize, value: f64| match color.standard_error {
            Some(errors) => format!("{value:.5} ± {:.1e}", errors[i]),
            None => format!("{value:.5}"),
        };
        let [x, y] = [figure(0, color.x), figure(1, color.y)];
        let [u, v] = [figure(2, color.u_prime), figure(3, color.v_prime)];
        let _ = writeln!(table, "{:<width$}{x:>20}{y:>20}{u:>20}{v:>20}", shown(name));
    }
    table
}

/// The places of a source's wavelengths in the scene, and their shares of its light.
fn shares(source: &Source) -> impl Iterator<Item = (usize, f64)> {
    let below = std::iter::once(&0.0).chain(&source.spectrum.cdf);
    let shares = source.spectrum.cdf.iter().zip(below).map(|(cdf, below)| cdf - below);
    source.spectrum.wavelengths.iter().copied().zip(shares)
}

/// The luminous efficacy of a source's light \[lm/W\].
#[cfg(feature = "viewer")]
pub(crate) fn efficacy_of(ir: &SceneIr, source: &Source) -> f64 {
    shares(source).map(|(place, share)| share * efficacy(ir.wavelengths[place])).sum()
}

/// The mean of a function of the wavelength to a power, over what a detector gets of a source. The detector gets the
/// share `through` of each wavelength, whichever the source.
fn mean_over(
    ir: &SceneIr,
    source: &Source,
    through: &[f64],
    function: &dyn Fn(f64) -> f64,
    power: i32,
) -> f64 {
    let received = || shares(source).map(|(place, share)| (place, share * through[place]));
    let all: f64 = received().map(|(_, share)| share).sum();
    let sum: f64 = received().map(|(place, share)| share * function(ir.wavelengths[place]).powi(power)).sum();
    if all > 0.0 { sum / all } else { 0.0 }
}

/// The share of the light of each wavelength that a detector gets, up to a factor of all.
fn received(ir: &SceneIr, apart: &Apart, quanta: &[u128]) -> Vec<f64> {
    let mut launched = vec![0.0; ir.wavelengths.len()];
    for source in &ir.sources {
        shares(source).for_each(|(place, share)| launched[place] += share * source.total_flux);
    }
    let mut seen = vec![0.0; ir.wavelengths.len()];
    let cells = apart.of.num_cells() * ir.wavelengths.len();
    for (cell, quanta) in quanta.iter().take(cells).enumerate() {
        seen[apart.place_of(cell).1] += *quanta as f64;
    }
    let share = |(seen, launched): (f64, f64)| if launched > 0.0 { seen / launched } else { 0.0 };
    seen.into_iter().zip(launched).map(share).collect()
}

/// What each source gives, in photometric units, where all of them together give `total_flux` \[W\] of what they emit.
pub(crate) fn of_source(ir: &SceneIr, source: &Source) -> LuminousSource {
    let efficacy =
        MOST_EFFICACY * mean_over(ir, source, &vec![1.0; ir.wavelengths.len()], &luminous_efficiency, 1);
    LuminousSource { flux_lm: source.total_flux * efficacy, efficacy }
}

/// What each detector saw, in photometric units. `None` for a detector whose light has no map, or whose bins mix
/// wavelengths. Scene and sums are given twice: as they were traced, and with wavelengths added up. `color` is for
/// detectors of these names.
///
/// # Errors
/// [`Error::Internal`] if the sums belong to another scene.
pub(crate) fn of_detectors(
    [ir, plain]: [&SceneIr; 2],
    [tally, sums]: [&Tally; 2],
    unit: FluxUnit,
    color: &[String],
) -> Result<Vec<Option<Luminous>>> {
    let of = |number: usize| -> Result<Option<Luminous>> {
        let (detector, as_written) = (&ir.detectors[number], &plain.detectors[number]);
        let one = Apart::new(&as_written.kind, &ir.wavelengths);
        let apart = match (&detector.kind, &one) {
            (DetectorKind::Apart(apart), _) => apart,
            (_, Some(one)) if ir.wavelengths.len() == 1 => one,
            _ => return Ok(None),
        };
        let is_intensity = as_written.kind.grid().is_none();
        let seen_by = &tally.detectors[number];
        // Squares of weights have shares of their own: dim light of a wavelength weighs less in these.
        let through = [&seen_by.quanta, &seen_by.squares].map(|sums| received(ir, apart, sums));
        let seen = |function: &dyn Fn(f64) -> f64| -> Result<Option<Weighted>> {
            let weights: Vec<f64> = ir.wavelengths.iter().map(|&wavelength| function(wavelength)).collect();
            let mut cells = weighted(apart, &tally.detectors[number], Some(&weights));
            cells.totals = totals(ir, &cells.totals, &through, function);
            let seen = Detector::of_part(plain, sums, unit.times(MOST_EFFICACY), as_written, &cells)?;
            Ok(seen.data.result().map().map(|map| {
                let scale = if is_intensity { 1.0 } else { LUX };
                Weighted {
                    flux: seen.total_flux,
                    flux_error: seen.total_flux_standard_error,
                    map: map.values.mapv(|value| value * scale),
                    error: map.errors.map(|errors| errors.mapv(|error| error * scale)),
                }
            }))
        };
        let Some(of_y) = seen(&luminous_efficiency)? else { return Ok(None) };
        let (flux_lm, flux_lm_standard_error) = (of_y.flux, of_y.flux_error);
        let (map, standard_error) = (of_y.map.clone(), of_y.error.clone());
        let color = match color.contains(&detector.name) {
            true => {
                let [x, z] = [0, 2].map(|i| seen(&|wavelength| matching_functions(wavelength)[i]));
                let pairs = PAIRS.map(|(a, b)| {
                    seen(&|wavelength| matching_functions(wavelength)[a] + matching_functions(wavelength)[b])
                });
                let [xy, xz, yz] = pairs;
                let all = (x?, z?, xy?, xz?, yz?);
                let (Some(x), Some(z), Some(xy), Some(xz), Some(yz)) = all else { return Ok(None) };
                Some(Color::new(&[x, of_y, z], &[xy, xz, yz]))
            }
            false => None,
        };
        Ok(Some(Luminous { flux_lm, flux_lm_standard_error, map, standard_error, is_intensity, color }))
    };
    (0..ir.detectors.len()).map(of).collect()
}

/// Moments of each source's light by a function of the wavelength. Each wavelength takes part by what the detector gets of it:
/// by sums of weights, and by sums of their squares.
fn totals(
    ir: &SceneIr,
    totals: &[Moments],
    [through, through_squared]: &[Vec<f64>; 2],
    function: &dyn Fn(f64) -> f64,
) -> Vec<Moments> {
    let scaled = |quanta: u128, factor: f64| (quanta as f64 * factor).ceil() as u128;
    let of_source = |(moments, source): (&Moments, &Source)| Moments {
        quanta: scaled(moments.quanta, mean_over(ir, source, through, function, 1)),
        squares: scaled(moments.squares, mean_over(ir, source, through_squared, function, 2)),
    };
    totals.iter().zip(&ir.sources).map(of_source).collect()
}

/// True if the eye sees some of the light of the scene.
pub fn is_visible(ir: &SceneIr) -> bool {
    ir.wavelengths.iter().any(|&wavelength| crate::model::photometry::is_visible(efficacy(wavelength)))
}
