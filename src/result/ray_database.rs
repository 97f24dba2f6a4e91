//! Every ray that crossed a detector.

use glam::DVec3;
use ndarray::Array1;

use crate::error::Result;
use crate::ir::{Frame, ray_id};
use crate::result::npz::NpzFile;
use crate::result::{FluxUnit, QUANTA_PER_WEIGHT, RayRow, SensorTally};

/// Rays at a detector, in global coordinates, by launched ray, then id, then event ([`ray_id::order`]): an order that no
/// batch size changes.
#[derive(Debug, Clone, PartialEq)]
pub struct RayDatabase {
    /// The detector's frame.
    pub frame: Frame,
    /// Ray ids, shape (n,).
    pub ray_id: Array1<u64>,
    /// Positions \[mm\], three arrays of shape (n,): x, y, z.
    pub position: [Array1<f64>; 3],
    /// Direction cosines, three arrays of shape (n,): L, M, N.
    pub direction: [Array1<f64>; 3],
    /// Flux per ray \[W\], shape (n,).
    pub flux: Array1<f64>,
    /// Wavelengths \[um\], shape (n,).
    pub wavelength: Array1<f64>,
    /// True if `max_rays` dropped rows: the first ones in the order above.
    pub truncated: bool,
    /// Flux of the rows kept \[W\].
    pub kept_flux: f64,
}

impl RayDatabase {
    pub(crate) fn new(
        frame: Frame,
        max_rays: Option<u64>,
        sums: &SensorTally,
        unit: FluxUnit,
        wavelengths: &[f64],
    ) -> Self {
        let mut rows: Vec<&RayRow> = sums.rows.iter().collect();
        rows.sort_by_key(|row| (ray_id::order(row.ray_id), row.bounce));
        let keep =
            max_rays.map_or(rows.len(), |limit| rows.len().min(usize::try_from(limit).unwrap_or(usize::MAX)));
        let rows = rows.split_off(rows.len() - keep);
        let column =
            |value: &dyn Fn(&RayRow) -> f64| rows.iter().map(|row| value(row)).collect::<Array1<f64>>();
        RayDatabase {
            frame,
            ray_id: rows.iter().map(|row| row.ray_id).collect(),
            position: [0, 1, 2].map(|axis| column(&|row| row.position[axis])),
            direction: [0, 1, 2].map(|axis| column(&|row| row.direction[axis])),
            flux: column(&|row| unit.watts_of_weight(row.weight)),
            wavelength: column(&|row| wavelengths[row.wavelength as usize]),
            truncated: (rows.len() as u64) < sums.recorded.count,
            kept_flux: unit.watts(rows.iter().map(|row| (row.weight * QUANTA_PER_WEIGHT) as u128).sum()),
        }
    }

    /// Rows kept.
    pub fn num_rays(&self) -> usize {
        self.flux.len()
    }

    /// Where the rays crossed, in the detector's frame: x and y \[mm\].
    pub fn local_points(&self) -> Vec<(f64, f64)> {
        let [x, y, z] = &self.position;
        let to_local = self.frame.rotation.transpose();
        let local = |row: usize| to_local * (DVec3::new(x[row], y[row], z[row]) - self.frame.origin);
        (0..self.num_rays()).map(local).map(|point| (point.x, point.y)).collect()
    }

    /// Writes the columns under Optiland's names. An empty database is written as Optiland writes one: no positions,
    /// one flux and one wavelength of 0.
    pub(crate) fn write(&self, file: &mut NpzFile) -> Result<()> {
        for (name, column) in ["x", "y", "z"].iter().zip(&self.position) {
            file.add(name, column)?;
        }
        for (name, column) in ["L", "M", "N"].iter().zip(&self.direction) {
            file.add(name, column)?;
        }
        let one_zero = Array1::zeros(1);
        let empty = self.flux.is_empty();
        file.add("flux", if empty { &one_zero } else { &self.flux })?;
        file.add("wavelength", if empty { &one_zero } else { &self.wavelength })?;
        file.add("ray_id", &self.ray_id)
    }

    /// Units of the arrays in the file.
    pub(crate) const UNITS: &'static [(&'static str, &'static str)] = &[
        ("x", "mm"),
        ("y", "mm"),
        ("z", "mm"),
        ("L", "1"),
        ("M", "1"),
        ("N", "1"),
        ("flux", "W"),
        ("wavelength", "um"),
        ("ray_id", "1"),
    ];
}
