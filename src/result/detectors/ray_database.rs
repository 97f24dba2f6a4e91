//! Every ray that crossed a detector.

use std::path::Path;
use std::sync::Arc;

use glam::DVec3;
use ndarray::Array1;
use serde_json::{Value, json};

use crate::error::{Error, Result};
use crate::format::thousands;
use crate::model::{self, Frame};
use crate::result::detectors::{CellMap, DetectorResult, Sums};
use crate::result::npz::{ArrayWriter, Column};
use crate::result::png::charts::{self, Drawn, Head};
use crate::result::ray_rows::{self, Rows};
use crate::result::stored::Stored;
use crate::result::{FluxUnit, QUANTA_PER_WEIGHT, RayRow};

/// Rays at a detector, in global coordinates, by launched ray, then id, then event ([`crate::model::ray_id::order`]): an order
/// that no batch size changes. The rows may lie on disk; [`RayDatabase::columns`] brings them into memory.
#[derive(Debug, Clone)]
pub struct RayDatabase {
    /// The detector's frame.
    pub frame: Frame,
    /// True if `max_rays` dropped rows: the first ones in the order above.
    pub truncated: bool,
    /// Flux of the rows kept \[W\].
    pub kept_flux: f64,
    /// Flux of all rows recorded \[W\].
    pub recorded_flux: f64,
    rows: Arc<Rows>,
    unit: FluxUnit,
    wavelengths: Vec<f64>,
}

/// The rows of a ray database in memory. All arrays have shape (n,).
#[derive(Debug, Clone, PartialEq)]
pub struct RayColumns {
    /// Ray ids.
    pub ray_id: Array1<u64>,
    /// Positions \[mm\]: x, y, z.
    pub position: [Array1<f64>; 3],
    /// Direction cosines: L, M, N.
    pub direction: [Array1<f64>; 3],
    /// Flux per ray \[W\].
    pub flux: Array1<f64>,
    /// Wavelengths \[um\].
    pub wavelength: Array1<f64>,
}

/// What was recorded in all, of which a database may keep a part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordedRays {
    /// Rays.
    pub num_rays: u64,
    /// Flux of those kept \[W\].
    pub kept_flux: f64,
    /// Flux of all \[W\].
    pub recorded_flux: f64,
}

/// Equal frames and columns; how they are stored does not matter.
impl PartialEq for RayDatabase {
    fn eq(&self, other: &Self) -> bool {
        (self.frame, self.truncated, self.kept_flux, self.recorded_flux)
            == (other.frame, other.truncated, other.kept_flux, other.recorded_flux)
            && self.columns() == other.columns()
    }
}

impl RayDatabase {
    /// A database of rays in memory, which stand in the order of this program's files.
    ///
    /// # Errors
    /// The errors of [`RowWriter::push`](crate::result::RowWriter::push).
    pub fn of_columns(frame: Frame, columns: &RayColumns, recorded: RecordedRays) -> Result<Self> {
        let mut wavelengths: Vec<f64> = columns.wavelength.to_vec();
        wavelengths.sort_by(f64::total_cmp);
        wavelengths.dedup();
        let rows = (0..columns.ray_id.len()).map(|row| RayRow {
            ray_id: columns.ray_id[row],
            bounce: 0,
            wavelength: wavelengths.partition_point(|other| *other < columns.wavelength[row]) as u32,
            position: [0, 1, 2].map(|axis| columns.position[axis][row]),
            direction: [0, 1, 2].map(|axis| columns.direction[axis][row]),
            weight: columns.flux[row],
        });
        let rows = Rows::of_rays(rows)?;
        Ok(RayDatabase {
            frame,
            truncated: rows.len() < recorded.num_rays,
            kept_flux: recorded.kept_flux,
            recorded_flux: recorded.recorded_flux,
            rows,
            // A weight of 1 is 1 W.
            unit: FluxUnit::new(1.0, 1),
            wavelengths,
        })
    }

    pub(crate) fn new(_: &model::RayDatabase, sums: &Sums<'_>) -> Result<Self> {
        let Sums { detector, cells, unit, .. } = *sums;
        let rows = sums.rows.ok_or_else(|| Error::Internal(format!("no rows for `{}`", detector.name)))?;
        let recorded_flux = unit.watts(cells.total().quanta);
        let truncated = rows.len() < rows.num_recorded();
        let kept_flux = if truncated { unit.watts(quanta(rows)?) } else { recorded_flux };
        Ok(RayDatabase {
            frame: detector.frame,
            truncated,
            kept_flux,
            recorded_flux,
            rows: rows.clone(),
            unit,
            wavelengths: sums.wavelengths.into(),
        })
    }

    pub(crate) fn read(mut stored: Stored) -> Result<Self> {
        let frame = stored.frame()?;
        let position = [stored.array("x")?, stored.array("y")?, stored.array("z")?];
        let direction = [stored.array("L")?, stored.array("M")?, stored.array("N")?];
        let ray_id: Array1<u64> = stored.array("ray_id")?;
        let (mut flux, mut wavelength): (Array1<f64>, Array1<f64>) =
            (stored.array("flux")?, stored.array("wavelength")?);
        let rows = ray_id.len();
        if rows == 0 {
            // Optiland writes one flux and one wavelength of 0 for a database without rays.
            (flux, wavelength) = (Array1::zeros(0), Array1::zeros(0));
        }
        let columns = position.iter().chain(&direction).chain([&flux, &wavelength]);
        stored.check(columns.into_iter().all(|column| column.len() == rows))?;
        let columns = RayColumns { ray_id, position, direction, flux, wavelength };
        let kept_flux = stored.entry.total_flux;
        RayDatabase::of_columns(
            frame,
            &columns,
            RecordedRays {
                num_rays: stored.entry.num_rays_hit,
                kept_flux,
                recorded_flux: stored.entry.total_flux_recorded.unwrap_or(kept_flux),
            },
        )
    }

    /// Rows kept.
    pub fn num_rays(&self) -> u64 {
        self.rows.len()
    }

    /// All rows in memory at once.
    ///
    /// # Errors
    /// The errors of [`Rows::for_each`].
    pub fn columns(&self) -> Result<RayColumns> {
        let rows = self.rows.to_vec()?;
        let reals = |value: &dyn Fn(usize) -> f64| (0..rows.len()).map(value).collect::<Array1<f64>>();
        Ok(RayColumns {
            ray_id: rows.iter().map(|row| row.ray.ray_id).collect(),
            position: [0, 1, 2].map(|axis| reals(&|i| rows[i].ray.position[axis])),
            direction: [0, 1, 2].map(|axis| reals(&|i| rows[i].ray.direction[axis])),
            flux: reals(&|i| self.unit.watts_of_weight(rows[i].ray.weight)),
            wavelength: reals(&|i| self.wavelengths[rows[i].ray.wavelength as usize]),
        })
    }

    /// Calls `take` with the place of each ray in the detector's frame, x and y \[mm\], and its wavelength \[um\].
    ///
    /// # Errors
    /// The errors of [`Rows::for_each`].
    pub fn for_each_point(&self, mut take: impl FnMut((f64, f64), f64)) -> Result<()> {
        let to_local = self.frame.rotation.transpose();
        self.rows.for_each(|event| {
            let point = to_local * (DVec3::from_array(event.ray.position) - self.frame.origin);
            take((point.x, point.y), self.wavelengths[event.ray.wavelength as usize]);
        })
    }
}

impl DetectorResult for RayDatabase {
    fn map(&self) -> Option<CellMap<'_>> {
        None
    }

    /// Writes the columns under Optiland's names. An empty database is written as Optiland writes one: no positions,
    /// one flux and one wavelength of 0.
    fn write(&self, file: &mut ArrayWriter) -> Result<()> {
        let rows = &self.rows;
        for (word, name) in (ray_rows::POSITION..).zip(["x", "y", "z", "L", "M", "N"]) {
            file.add_column(name, &Column::real(rows, word, |x| x))?;
        }
        if rows.is_empty() {
            file.add("flux", &Array1::<f64>::zeros(1))?;
            file.add("wavelength", &Array1::<f64>::zeros(1))?;
        } else {
            file.add_column(
                "flux",
                &Column::real(rows, ray_rows::WEIGHT, |weight| self.unit.watts_of_weight(weight)),
            )?;
            file.add_column("wavelength", &Column::wavelength(rows, &self.wavelengths))?;
        }
        file.add_column(
            "ray_id",
            &Column::new(rows, ray_rows::RAY_ID, "<u8", 8, |word, bytes| bytes.extend(word.to_le_bytes())),
        )
    }

    fn units(&self) -> &'static [(&'static str, &'static str)] {
        &[
            ("x", "mm"),
            ("y", "mm"),
            ("z", "mm"),
            ("L", "1"),
            ("M", "1"),
            ("N", "1"),
            ("flux", "W"),
            ("wavelength", "um"),
            ("ray_id", "1"),
        ]
    }

    fn picture(&self, path: &Path, head: &Head) -> Drawn {
        charts::spots(path, head, self.num_rays(), |take| self.for_each_point(take))
    }

    fn entry(&self) -> Vec<(&'static str, Value)> {
        let Frame { origin, rotation } = self.frame;
        vec![
            ("num_rays_stored", json!(self.num_rays())),
            ("total_flux_recorded", json!(self.recorded_flux)),
            ("frame", json!({ "origin": origin.to_array(), "axes": rotation.to_cols_array_2d() })),
        ]
    }

    fn num_items(&self) -> u64 {
        self.num_rays()
    }

    fn kept_flux(&self) -> Option<f64> {
        self.truncated.then_some(self.kept_flux)
    }

    fn recorded_flux(&self) -> Option<f64> {
        Some(self.recorded_flux)
    }

    fn tells_wavelengths(&self) -> bool {
        true
    }

    fn warning(&self, name: &str, num_rays_hit: u64) -> Option<String> {
        self.truncated.then(|| {
            format!(
                "ray database '{name}' kept the last {} of {} rays: its total_flux counts the kept rays only, the \
                 ledger all",
                thousands(self.num_rays()),
                thousands(num_rays_hit)
            )
        })
    }
}

/// The weight of the rows kept, each rounded down as the device does it.
fn quanta(rows: &Rows) -> Result<u128> {
    let mut sum: u128 = 0;
    rows.for_each_block(ray_rows::WEIGHT, |weights| {
        let quanta = weights.iter().map(|&bits| (f64::from_bits(bits) * QUANTA_PER_WEIGHT) as u128);
        // A file may hold rows of any weight.
        sum = quanta.fold(sum, u128::saturating_add);
        Ok(())
    })?;
    Ok(sum)
}
