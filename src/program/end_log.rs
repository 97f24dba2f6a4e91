//! The log of where rays end, for the host to add up (`shaders/lib/ends_logged.wgsl`).

use super::features::Features;
use super::lowered::{self, Cells};
use super::{Precision, ProgramOptions, SecondMoments};
use crate::ir::SceneIr;

/// Binding of the ends' cells.
pub const CELLS: u32 = 20;
/// Binding of their weights and shares.
pub const WEIGHTS: u32 = 21;

/// The bits of an end that name its cell.
pub const CELL_BITS: u32 = 22;

/// What the log of a program holds.
#[derive(Debug, Clone, PartialEq)]
pub struct EndLog {
    /// Rows of weights and shares.
    pub num_rows: u32,
    /// What weights and shares are.
    pub real: Real,
    /// Ends have no weight, and the host need only count: sums follow from the counts.
    pub counts_alone: bool,
    /// Per detector, from the first cell on.
    pub grids: Vec<Grid>,
}

/// What weights and shares are in the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Real {
    /// 32-bit floats.
    F32,
    /// 64-bit floats.
    F64,
}

/// How the cells of a detector lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    /// Its first cell.
    pub first: usize,
    /// Cells from one column to the next.
    pub column: usize,
    /// Cells from one row to the next.
    pub row: usize,
}

impl EndLog {
    /// The log of a scene. None where rays are split, because a launched ray then has many ends; where there are so many
    /// cells, or replicates of them, that the host would not find them in its caches; and none of pairs of f32.
    pub fn of(
        ir: &SceneIr,
        features: &Features,
        cells: &Cells,
        options: &ProgramOptions,
        counts_alone: bool,
    ) -> Option<Self> {
        let has_replicates = options.moments == SecondMoments::Replicates;
        let real = match options.precision {
            Precision::F32 => Real::F32,
            Precision::F64 => Real::F64,
            Precision::Df64 => return None,
        };
        let is_large = cells.num_cells > 1 << CELL_BITS;
        if !options.host_sums || has_replicates || features.splits || is_large {
            return None;
        }
        let num_rows = if features.splats[1] { 4 } else { u32::from(!counts_alone) };
        let grids = cells.sensors.iter().zip(&ir.sensors).map(|(&first, sensor)| {
            let column = lowered::num_bins(&sensor.kind) as usize;
            let row = column * sensor.kind.grid().map_or(1, |grid| grid.num_pixels_x as usize);
            Grid { first: first as usize, column, row }
        });
        Some(EndLog { num_rows, real, counts_alone, grids: grids.collect() })
    }
}
