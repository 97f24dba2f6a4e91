//! The rays of files that are uploaded for each dispatch, as rows of the tables' buffer (shaders/sources/streamed_rays.wgsl).

use crate::error::{Error, Result};
use crate::model::sources::rays::{MOST_UPLOADED, RayStorage, RayStream, UPLOADED_NUMBERS};
use crate::model::{SceneIr, SourceKind};
use crate::program::layout::kind_tables::KindTables;
use crate::program::layout::rng;
use std::sync::Arc;

/// The slots of the draws that pick a ray of a file: `SOURCE_U1` and `SOURCE_U2` of `rng_slots.wgsl`.
const SLOTS: [u32; 2] = [0, 1];

/// The rays of files, by source.
#[derive(Debug)]
pub(super) struct StreamedSources {
    of_sources: Vec<Option<StreamedSource>>,
    /// The wavelengths of the scene \[um\].
    wavelengths: Vec<f64>,
}

/// The rays of a file, and where their rows begin in the tables' buffer.
#[derive(Debug)]
struct StreamedSource {
    rays: Arc<dyn RayStream>,
    first: usize,
}

impl StreamedSources {
    pub(super) fn of(ir: &SceneIr, places: &KindTables) -> Self {
        let stream = |(number, kind): (usize, &SourceKind)| {
            let SourceKind::Rays(rays) = kind else { return None };
            let RayStorage::Streamed(rays) = &rays.set.rays else { return None };
            Some(StreamedSource { rays: rays.clone(), first: places.of_source(number)? })
        };
        let kinds = ir.sources.iter().map(|source| &source.kind);
        StreamedSources {
            of_sources: kinds.enumerate().map(stream).collect(),
            wavelengths: ir.wavelengths.clone(),
        }
    }

    /// True if rays of this source begin as rays that are uploaded.
    pub(super) fn has(&self, source: usize) -> bool {
        self.of_source(source).is_some()
    }

    /// The numbers of the rows for rays with these ids, and where the rows begin in the tables. None for a source whose rays are
    /// not uploaded.
    ///
    /// Both samplers draw a file's ray at random, by the keyed draws of [`rng`].
    ///
    /// # Errors
    /// If the file can no longer be read.
    pub(super) fn rows(&self, source: usize, seed: u64, ids: &[u64]) -> Result<Option<(usize, Vec<f64>)>> {
        let Some(stream) = self.of_source(source) else { return Ok(None) };
        if ids.len() > MOST_UPLOADED as usize {
            return Err(Error::Internal(format!("{} rays of a file are uploaded at once", ids.len())));
        }
        let draw = |id: u64| {
            let [low, high] = SLOTS.map(|slot| u64::from(rng::draw(seed, id, 0, slot)));
            (high << 32) | low
        };
        let rays = stream.rays.rays(seed, ids, &draw)?;
        let number_of = |own: f64| self.wavelengths.iter().position(|listed| *listed == own);
        let numbers = rays.iter().flat_map(|ray| {
            let wavelength = ray.wavelength.and_then(number_of).map_or(-1.0, |number| number as f64);
            let ([x, y, z], [l, m, n]) = (ray.position, ray.direction);
            let row: [f64; UPLOADED_NUMBERS] = [wavelength, x, y, z, l, m, n];
            row
        });
        Ok(Some((stream.first, numbers.collect())))
    }

    fn of_source(&self, number: usize) -> Option<&StreamedSource> {
        self.of_sources.get(number)?.as_ref()
    }
}
