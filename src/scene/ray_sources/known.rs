//! The files that were read last. A sweep and a session read a scene again and again, and its ray files once.

use crate::model::sources::rays::{Order, Written};
use crate::scene::ray_files::{self, FileState};
use crate::scene::ray_sources::reading::Reading;
use crate::scene::ray_sources::taking::Refusal;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Most files that are kept.
const MOST: usize = 4;

/// What a reading depends on.
#[derive(PartialEq)]
struct Key {
    path: PathBuf,
    state: FileState,
    order: Order,
    scale: f64,
    wavelengths: Vec<f64>,
    in_lumens: bool,
}

static KNOWN: Mutex<Vec<(Key, Arc<Reading>)>> = Mutex::new(Vec::new());

/// What a file holds: as it was read last, unless the file has changed since.
pub(super) fn reading(path: &Path, written: &Written) -> std::result::Result<Arc<Reading>, Refusal> {
    let key = Key {
        path: std::path::absolute(path).unwrap_or_else(|_| path.to_owned()),
        state: ray_files::state_of(path)?,
        order: written.order,
        scale: written.scale,
        wavelengths: written.spectrum.wavelengths.clone(),
        in_lumens: written.total_flux_lumens.is_some(),
    };
    let known = || KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, reading)) = known().iter().find(|(other, _)| *other == key) {
        return Ok(reading.clone());
    }
    let reading = Arc::new(Reading::of(path, written)?);
    let mut known = known();
    known.truncate(MOST - 1);
    known.insert(0, (key, reading.clone()));
    Ok(reading)
}
