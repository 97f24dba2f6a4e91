//! What the figures of a detector are.

use crate::result::figures::region::Region;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A figure with its error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// The value.
    pub value: f64,
    /// Its standard error. `None` if errors of cells are unknown.
    pub standard_error: Option<f64>,
    /// By how much noise as large as the map's own moves the value. `None` if errors of cells are unknown. The value is
    /// not corrected.
    pub noise_bias: Option<f64>,
}

impl Figure {
    /// A figure that noise does not move, such as a flux.
    pub(super) fn unmoved(value: f64, standard_error: Option<f64>) -> Self {
        Figure { value, standard_error, noise_bias: standard_error.map(|_| 0.0) }
    }

    /// True if noise moves it by more than its standard error.
    pub fn is_moved(&self) -> bool {
        self.noise_bias.zip(self.standard_error).is_some_and(|(bias, error)| bias.abs() > error)
    }
}

/// The figures of a detector.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// The unit of the map, such as lx.
    pub unit: String,
    /// The unit of the flux: W or lm.
    pub flux_unit: String,
    /// Cells of the map over which figures are found, columns and rows.
    pub cells: [usize; 2],
    /// Figures of the whole map, by their names, which end in their unit where that is not the map's.
    pub whole: Named,
    /// Figures of each region that was asked for.
    pub regions: Vec<RegionFigures>,
    /// What should be read with care.
    pub remarks: Vec<String>,
}

impl Figures {
    /// True of a far field, whose regions are cones [deg]. Regions of other detectors are in mm.
    pub(super) fn is_of_directions(&self) -> bool {
        self.unit == "cd" || self.unit.ends_with("/sr")
    }
}

/// Figures by their names.
pub type Named = BTreeMap<String, Figure>;

/// The figures of a region.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RegionFigures {
    /// The region.
    pub region: Region,
    /// Its figures.
    pub figures: Named,
}
