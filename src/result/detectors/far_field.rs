//! Flux per solid angle over directions.

use crate::error::Result;
use crate::model::FarField;
use crate::result::detectors::bins::{bin_centres, bin_edges, shaped};
use crate::result::detectors::{CellMap, DetectorResult, Span, Sums};
use crate::result::npz::ArrayWriter;
use crate::result::png::charts::{Drawn, Head};
use crate::result::png::diagram;
use crate::result::stored::Stored;
use crate::result::tally::map_lit;
use ndarray::{Array1, Array2};
use std::path::Path;

/// Intensity over directions in the detector's frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FarFieldPattern {
    /// Intensity \[W/sr\], shape (n_theta, n_phi).
    pub intensity: Array2<f64>,
    /// Centres of the polar angle bins, from local z \[deg\], shape (n_theta,).
    pub theta: Array1<f64>,
    /// Centres of the azimuth bins, from local x towards local y \[deg\], shape (n_phi,).
    pub phi: Array1<f64>,
    /// Rays per bin, shape (n_theta, n_phi).
    pub hits: Array2<u64>,
    /// Standard error of `intensity` \[W/sr\], shape (n_theta, n_phi); `None` if second moments were not summed. It
    /// is 0 where no ray came, which says nothing of a longer trace.
    pub standard_error: Option<Array2<f64>>,
}

impl FarFieldPattern {
    pub(crate) fn new(kind: &FarField, sums: &Sums<'_>) -> Result<Self> {
        let Sums { cells, unit, uncertainty, .. } = *sums;
        let (rows, columns) = (kind.num_theta as usize, kind.num_phi as usize);
        let reach = if kind.sphere { 180.0 } else { 90.0 };
        let solid_angle = solid_angles(rows, columns, reach);
        // Both hemispheres are summed from their own axis on.
        let rows_of_one = if kind.sphere { rows / 2 } else { rows };
        let size = |cell: usize| solid_angle[cell / columns % rows_of_one];
        let intensity = map_lit(&cells.quanta, |cell, quanta| unit.watts(quanta) / size(cell));
        let errors = uncertainty.of_cells(cells, size).map(|errors| kind.by_polar_angle(errors));
        let hits = map_lit(&cells.hits, |_, hits| hits);
        Ok(FarFieldPattern {
            intensity: shaped((rows, columns), kind.by_polar_angle(intensity))?,
            theta: bin_centres(0.0, reach, rows),
            phi: bin_centres(-180.0, 180.0, columns),
            hits: shaped((rows, columns), kind.by_polar_angle(hits))?,
            standard_error: errors.map(|errors| shaped((rows, columns), errors)).transpose()?,
        })
    }

    /// The largest polar angle \[deg\]: 90, with both hemispheres folded into one, or 180.
    pub fn reach(&self) -> f64 {
        if self.theta.last().is_some_and(|last| *last > 90.0) { 180.0 } else { 90.0 }
    }

    /// Solid angles of the cells of each ring \[sr\].
    pub(crate) fn solid_angles(&self) -> Vec<f64> {
        let (rows, columns) = self.intensity.dim();
        solid_angles(rows, columns, self.reach()).to_vec()
    }

    pub(crate) fn read(mut stored: Stored) -> Result<Self> {
        let pattern = FarFieldPattern {
            intensity: stored.array("intensity")?,
            theta: stored.array("theta")?,
            phi: stored.array("phi")?,
            hits: stored.array("hits")?,
            standard_error: stored.optional("standard_error")?,
        };
        let shape = (pattern.theta.len(), pattern.phi.len());
        stored.check(
            pattern.intensity.dim() == shape
                && pattern.hits.dim() == shape
                && pattern.standard_error.as_ref().is_none_or(|errors| errors.dim() == shape)
                && !pattern.hits.is_empty(),
        )?;
        Ok(pattern)
    }
}

impl DetectorResult for FarFieldPattern {
    fn map(&self) -> Option<CellMap<'_>> {
        Some(CellMap {
            values: self.intensity.view().into_dyn(),
            errors: self.standard_error.as_ref().map(|errors| errors.view().into_dyn()),
            hits: self.hits.view().into_dyn(),
            sizes: self.solid_angles(),
            are_alike: false,
            x: Span { label: ("azimuth φ", "°"), range: (-180.0, 180.0) },
            y: Span { label: ("polar angle θ", "°"), range: (0.0, self.reach()) },
            quantity: ("Intensity", "W/sr"),
        })
    }

    fn write(&self, file: &mut ArrayWriter) -> Result<()> {
        file.add("intensity", &self.intensity)?;
        file.add("theta", &self.theta)?;
        file.add("phi", &self.phi)?;
        file.add("hits", &self.hits)?;
        file.add_optional("standard_error", &self.standard_error)
    }

    fn units(&self) -> &'static [(&'static str, &'static str)] {
        &[
            ("intensity", "W/sr"),
            ("theta", "deg"),
            ("phi", "deg"),
            ("total_flux", "W"),
            ("hits", "rays"),
            ("standard_error", "W/sr"),
            ("total_flux_standard_error", "W"),
        ]
    }

    fn picture(&self, path: &Path, head: &Head) -> Drawn {
        diagram::far_field(path, head, &self.intensity, (self.reach(), &self.solid_angles()))
    }
}

/// Optiland's: sin(theta centre) times the widths.
fn solid_angles(rows: usize, columns: usize, reach: f64) -> Array1<f64> {
    // A file may have no bins, and then it lacks a second edge.
    let width = |edges: Vec<f64>| edges.windows(2).next().map_or(0.0, |bin| (bin[1] - bin[0]).to_radians());
    let d_theta = width(bin_edges(0.0, reach, rows));
    let d_phi = width(bin_edges(-180.0, 180.0, columns));
    bin_centres(0.0, reach, rows).mapv(|centre| centre.to_radians().sin() * d_theta * d_phi)
}
