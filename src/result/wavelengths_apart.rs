//! Light of each wavelength kept apart while rays are traced, and added up again.
//!
//! A trace that is asked for photometry keeps light of each wavelength apart ([`Apart`]). Here its sums over
//! wavelengths become the sums of the detectors as the scene has them, to the bit. The sums may also be taken by
//! another weight of each wavelength. A ray keeps its wavelength for life. So the squares of what rays leave add up
//! with the square of that weight. Standard errors of weighted maps are then as exact as errors in watts.

use crate::error::{Error, Result};
use crate::model::{Apart, DetectorKind, SceneIr};
use crate::result::{DetectorTally, Tally};
use std::borrow::Cow;

/// Most cells of all detectors together, where each keeps wavelengths apart.
const MOST_CELLS: usize = 1 << 28;
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
pub(crate) fn weighted(apart: &Apart, sums: &DetectorTally, weights: Option<&[f64]>) -> DetectorTally {
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
