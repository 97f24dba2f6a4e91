//! Light as the eye judges it: lumens, lux and candela beside watts.
//!
//! A trace that is asked for photometry keeps light of each wavelength apart ([`Apart`]). Here its sums over wavelengths become
//! the sums of the detectors as the scene has them, to the bit. The same sums, each weighted by the luminous efficiency V of
//! its wavelength, become photometric maps. A ray keeps its wavelength for life. So the squares of what rays leave add up with
//! the weight V^2, and standard errors of maps are as exact as those in watts.

use crate::error::{Error, Result};
use crate::format::{shown, significant};
use crate::model::photometry::{MOST_EFFICACY, efficacy, luminous_efficiency};
use crate::model::{Apart, DetectorKind, SceneIr, Source};
use crate::result::npz::ArrayWriter;
use crate::result::{Detector, DetectorTally, FluxUnit, Moments, Tally, TraceResult};
use ndarray::{ArrayD, arr0};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::borrow::Cow;
use std::fmt::Write;

/// Most cells of all detectors together, where each keeps wavelengths apart.
const MOST_CELLS: usize = 1 << 28;
/// Square millimetres of a square metre: lm/mm^2 in lx.
const LUX: f64 = 1e6;

/// What a detector saw, in photometric units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Luminous {
    /// Luminous flux \[lm\].
    pub flux_lm: f64,
    /// Its standard error \[lm\]; none if second moments were not summed. It takes the light of each source to have the
    /// spectrum with which it was launched.
    pub flux_lm_standard_error: Option<f64>,
    /// Illuminance \[lx\], or luminous intensity of a far field \[cd\], in the shape of the detector's map.
    #[serde(skip)]
    pub map: ArrayD<f64>,
    /// Its standard error; none if second moments were not summed.
    #[serde(skip)]
    pub standard_error: Option<ArrayD<f64>>,
    /// True of luminous intensity.
    #[serde(skip)]
    pub is_intensity: bool,
}

impl Luminous {
    /// The mean of the map \[lx\]; over the directions of a far field there is none.
    pub fn mean_lx(&self) -> Option<f64> {
        (!self.is_intensity).then(|| self.map.mean()).flatten()
    }

    /// The largest value of the map, with its standard error \[lx\] or \[cd\].
    pub fn peak(&self) -> (f64, Option<f64>) {
        let largest = self.map.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
        let error =
            |place: usize| self.standard_error.as_ref().and_then(|errors| errors.iter().nth(place).copied());
        largest.map_or((0.0, None), |(place, value)| (*value, error(place)))
    }

    /// The unit of the map.
    pub fn unit(&self) -> &'static str {
        if self.is_intensity { "cd" } else { "lx" }
    }

    /// The name of the map in files; that of its standard error ends in `_standard_error`.
    pub fn name(&self) -> &'static str {
        if self.is_intensity { "luminous_intensity" } else { "illuminance" }
    }

    /// Its entry of the report.
    pub(crate) fn entry(&self) -> Value {
        let (peak, error) = self.peak();
        let mut entry = json!(self);
        if let Some(mean) = self.mean_lx() {
            let per_lumen = if self.flux_lm > 0.0 { mean / self.flux_lm } else { 0.0 };
            entry["mean_lx"] = json!(mean);
            entry["mean_lx_standard_error"] =
                json!(self.flux_lm_standard_error.map(|error| error * per_lumen));
        }
        entry[format!("peak_{}", self.unit())] = json!(peak);
        entry[format!("peak_{}_standard_error", self.unit())] = json!(error);
        entry
    }

    /// Adds its map to a file of arrays.
    pub(crate) fn add_to(&self, file: &mut ArrayWriter) -> Result<()> {
        file.add(self.name(), &self.map)?;
        file.add_optional(&format!("{}_standard_error", self.name()), &self.standard_error)?;
        file.add("luminous_flux", &arr0(self.flux_lm))?;
        file.add_optional("luminous_flux_standard_error", &self.flux_lm_standard_error.map(arr0))
    }

    /// Units of the arrays in that file.
    pub(crate) fn units(&self) -> Vec<(&'static str, &'static str)> {
        let maps = match self.is_intensity {
            true => ["luminous_intensity", "luminous_intensity_standard_error"],
            false => ["illuminance", "illuminance_standard_error"],
        };
        let fluxes = ["luminous_flux", "luminous_flux_standard_error"].map(|name| (name, "lm"));
        maps.into_iter().map(|name| (name, self.unit())).chain(fluxes).collect()
    }
}

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
    table
}

/// What a source gives, in photometric units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LuminousSource {
    /// Luminous flux \[lm\].
    pub flux_lm: f64,
    /// Luminous efficacy of its spectrum \[lm/W\].
    pub efficacy: f64,
}

/// The scene, whose irradiance and far-field detectors keep light of each wavelength apart. A scene of one wavelength stays
/// as it is.
///
/// # Errors
/// [`Error::Usage`] if that takes too many cells.
pub fn keep_apart(ir: &SceneIr) -> Result<SceneIr> {
    let mut apart = ir.clone();
    if ir.wavelengths.len() < 2 {
        return Ok(apart);
    }
    for detector in &mut apart.detectors {
        if let Some(kind) = Apart::new(&detector.kind, &ir.wavelengths) {
            detector.kind = DetectorKind::Apart(kind);
        }
    }
    let num_cells: usize = apart.detectors.iter().map(|detector| detector.num_cells()).sum();
    match num_cells {
        0..=MOST_CELLS => Ok(apart),
        _ => Err(Error::Usage(format!(
            "photometry keeps {} wavelengths apart, which makes {num_cells} pixels; give detectors fewer pixels, or sources \
             fewer wavelengths ({MOST_CELLS} are the limit)",
            ir.wavelengths.len()
        ))),
    }
}

/// True if light of each wavelength is kept apart in the scene.
pub fn is_apart(ir: &SceneIr) -> bool {
    ir.detectors.iter().any(|detector| matches!(detector.kind, DetectorKind::Apart(_)))
}

/// The scene as the user wrote it, and sums over wavelengths where they were kept apart.
pub(crate) fn added_up<'a>(ir: &'a SceneIr, tally: &'a Tally) -> (Cow<'a, SceneIr>, Cow<'a, Tally>) {
    if !is_apart(ir) {
        return (Cow::Borrowed(ir), Cow::Borrowed(tally));
    }
    let (mut plain, mut sums) = (ir.clone(), tally.clone());
    for (detector, cells) in plain.detectors.iter_mut().zip(&mut sums.detectors) {
        let DetectorKind::Apart(apart) = &detector.kind else { continue };
        *cells = weighted(apart, cells, None);
        detector.kind = (*apart.of).clone();
    }
    (Cow::Owned(plain), Cow::Owned(sums))
}

/// Sums over wavelengths, each by its weight; without weights to the bit.
fn weighted(apart: &Apart, sums: &DetectorTally, weights: Option<&[f64]>) -> DetectorTally {
    let [own, num_cells] = [sums.quanta.len(), apart.of.num_cells()];
    let weight = |place: usize| weights.map_or(1.0, |weights| weights[place]);
    let add = |all: &[u128], power: i32| -> Vec<u128> {
        let mut added = vec![0; all.len() / own * num_cells];
        for (part, cells) in all.chunks(own).enumerate() {
            for (cell, quanta) in cells.iter().enumerate().filter(|(_, quanta)| **quanta > 0) {
                let (to, place) = apart.place_of(cell);
                added[part * num_cells + to] += match weights {
                    Some(_) => (*quanta as f64 * weight(place).powi(power)).ceil() as u128,
                    None => *quanta,
                };
            }
        }
        added
    };
    let mut hits = vec![0; num_cells];
    for (cell, count) in sums.hits.iter().enumerate().filter(|(_, count)| **count > 0) {
        let (to, place) = apart.place_of(cell);
        hits[to] += if weight(place) > 0.0 { *count } else { 0 };
    }
    DetectorTally {
        quanta: add(&sums.quanta, 1),
        squares: add(&sums.squares, 2),
        replicates: add(&sums.replicates, 1),
        hits,
        ..sums.clone()
    }
}

/// The mean of V^power over the light of a source.
fn mean_efficiency(ir: &SceneIr, source: &Source, power: i32) -> f64 {
    let below = std::iter::once(&0.0).chain(&source.spectrum.cdf);
    let shares = source.spectrum.cdf.iter().zip(below).map(|(cdf, below)| cdf - below);
    let efficiencies =
        source.spectrum.wavelengths.iter().map(|&place| luminous_efficiency(ir.wavelengths[place]));
    shares.zip(efficiencies).map(|(share, efficiency)| share * efficiency.powi(power)).sum()
}

/// What each source gives, in photometric units, where all of them together give `total_flux` \[W\] of what they emit.
pub(crate) fn of_source(ir: &SceneIr, source: &Source) -> LuminousSource {
    let efficacy = MOST_EFFICACY * mean_efficiency(ir, source, 1);
    LuminousSource { flux_lm: source.total_flux * efficacy, efficacy }
}

/// What each detector saw, in photometric units; none of a detector whose light has no map, or whose bins mix wavelengths.
///
/// # Errors
/// [`Error::Internal`] if the sums are not those of the scene.
pub(crate) fn of_detectors(ir: &SceneIr, tally: &Tally, unit: FluxUnit) -> Result<Vec<Option<Luminous>>> {
    let (plain, sums) = added_up(ir, tally);
    let efficiencies: Vec<f64> =
        ir.wavelengths.iter().map(|&wavelength| luminous_efficiency(wavelength)).collect();
    let of = |number: usize| -> Result<Option<Luminous>> {
        let (detector, as_written) = (&ir.detectors[number], &plain.detectors[number]);
        let one = Apart::new(&as_written.kind, &ir.wavelengths);
        let apart = match (&detector.kind, &one) {
            (DetectorKind::Apart(apart), _) => apart,
            (_, Some(one)) if ir.wavelengths.len() == 1 => one,
            _ => return Ok(None),
        };
        let mut cells = weighted(apart, &tally.detectors[number], Some(&efficiencies));
        cells.totals = totals(ir, &cells.totals);
        let unit = unit.times(MOST_EFFICACY);
        let seen = Detector::of_part(&plain, &sums, unit, as_written, &cells)?;
        Ok(seen.data.result().map().map(|map| {
            let is_intensity = as_written.kind.grid().is_none();
            let scale = if is_intensity { 1.0 } else { LUX };
            Luminous {
                flux_lm: seen.total_flux,
                flux_lm_standard_error: seen.total_flux_standard_error,
                map: map.values.mapv(|value| value * scale),
                standard_error: map.errors.map(|errors| errors.mapv(|error| error * scale)),
                is_intensity,
            }
        }))
    };
    (0..ir.detectors.len()).map(of).collect()
}

/// Moments of each source's light, of which the spectrum is taken to be that of the source.
fn totals(ir: &SceneIr, totals: &[Moments]) -> Vec<Moments> {
    let scaled = |quanta: u128, factor: f64| (quanta as f64 * factor).ceil() as u128;
    let of_source = |(moments, source): (&Moments, &Source)| Moments {
        quanta: scaled(moments.quanta, mean_efficiency(ir, source, 1)),
        squares: scaled(moments.squares, mean_efficiency(ir, source, 2)),
    };
    totals.iter().zip(&ir.sources).map(of_source).collect()
}

/// True if the eye sees some of the light of the scene.
pub fn is_visible(ir: &SceneIr) -> bool {
    ir.wavelengths.iter().any(|&wavelength| crate::model::photometry::is_visible(efficacy(wavelength)))
}
