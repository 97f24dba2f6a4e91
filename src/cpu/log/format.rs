//! The deposit log, for the host to add up (`shaders/cpu/log/ends.logged.wgsl`).

use crate::model::{Detector, DetectorKind, SceneIr, Splat};
use crate::program::features::Features;
use crate::program::layout::tables::Cells;
use crate::program::{Precision, ProgramOptions, SecondMoments};

/// The bits of an entry that name its cell.
pub const CELL_BITS: u32 = 22;

/// Deeper traces log no passes: a ray may make as many as it has events.
const MAX_LOGGED_DEPTH: u32 = 255;

/// What the log of a program holds.
#[derive(Debug, Clone, PartialEq)]
pub struct DepositLog {
    /// How an entry is written.
    pub format: EntryFormat,
    /// What entries say about bilinear taps.
    pub taps: LoggedTaps,
    /// Most entries of a ray that passes detectors, beside the entry of its end. Zero where the device adds up what
    /// rays leave in passing.
    pub max_passes: u32,
    /// Per detector, from the first cell on.
    pub grids: Vec<Grid>,
    /// The weight that each source's rays are born with.
    pub weights: Vec<f64>,
}

/// How an entry is laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EntryFormat {
    /// What it is alone, in 32 bits: sums follow from counts (entries.counts.wgsl).
    Counts,
    /// 64-bit integers: what it is, and the f32 of its weight; the f32 of the fractions (entries.packed.wgsl).
    Packed,
    /// f64: what it is, its weight, the fractions (entries.reals.wgsl).
    Reals,
}

/// What entries say about bilinear taps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LoggedTaps {
    /// Nothing: no detector has bilinear taps.
    None,
    /// Which cells they are, and how far between them the position is.
    Fractions,
    /// The position alone, on the only detector that has bilinear taps.
    Positions {
        /// Its grid.
        grid: Grid,
        /// Entries have the weight: rays do not keep the one that they are born with.
        has_weights: bool,
    },
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
    /// Its columns and rows.
    pub size: [u32; 2],
}

/// True of a detector whose rays spread over many pixels. The device adds these up.
fn is_gaussian(kind: &DetectorKind) -> bool {
    kind.grid().is_some_and(|grid| matches!(grid.splat, Splat::Gaussian { .. }))
}

/// True if what rays leave on the detector in passing is logged, where a log is kept.
pub fn logs_passes(detector: &Detector, max_depth: u32) -> bool {
    !detector.absorb && !is_gaussian(&detector.kind) && max_depth <= MAX_LOGGED_DEPTH
}

/// What entries say about taps. A position has no room for the detector, or for whether the ray passes.
fn taps(ir: &SceneIr, grids: &[Grid], max_passes: u32, keeps_weight: bool) -> LoggedTaps {
    let bilinear =
        |detector: &Detector| detector.kind.grid().is_some_and(|grid| grid.splat == Splat::Bilinear);
    let mut with_taps = grids.iter().zip(&ir.detectors).filter(|(_, detector)| bilinear(detector));
    match (with_taps.next(), with_taps.next()) {
        (None, _) => LoggedTaps::None,
        (Some((&grid, detector)), None) if detector.kind.is_plain_grid() && max_passes == 0 => {
            LoggedTaps::Positions { grid, has_weights: !keeps_weight }
        }
        _ => LoggedTaps::Fractions,
    }
}

impl DepositLog {
    /// The log of a scene. `None` where the device adds up: always in pairs of f32, and in f32 on a driver without
    /// 64-bit integers, such as SwiftShader. The device also adds up where rays are split, because a launched ray then
    /// has many ends. Where cells or their replicates are many, the host's caches would not hold them, and the device
    /// adds up.
    pub fn of(
        ir: &SceneIr,
        features: &Features,
        cells: &Cells,
        options: &ProgramOptions,
        counts_alone: bool,
    ) -> Option<Self> {
        let has_replicates = options.moments == SecondMoments::Replicates;
        let format = match (options.precision, options.native) {
            (Precision::Df64, _) => return None,
            _ if counts_alone => EntryFormat::Counts,
            (Precision::F32, true) => EntryFormat::Packed,
            (Precision::F32, false) => return None,
            (Precision::F64, _) => EntryFormat::Reals,
        };
        let is_large = cells.num_cells > 1 << CELL_BITS;
        if has_replicates || features.splits || is_large {
            return None;
        }
        let grids = cells.detectors.iter().zip(&ir.detectors).map(|(&first, detector)| {
            let size = detector.kind.grid().map_or([1; 2], |grid| [grid.num_pixels_x, grid.num_pixels_y]);
            let column = detector.kind.num_bins() as usize;
            Grid { first: first as usize, column, row: column * size[0] as usize, size }
        });
        let grids: Vec<Grid> = grids.collect();
        let logs_passes = ir.detectors.iter().any(|detector| logs_passes(detector, options.max_depth));
        let max_passes = if logs_passes { options.max_depth } else { 0 };
        let taps = taps(ir, &grids, max_passes, features.keeps_weight);
        Some(DepositLog { format, taps, max_passes, grids, weights: options.weights.clone() })
    }

    /// Words of an entry (`LOG_WORDS`), of [`DepositLog::word_bytes`] each.
    pub fn num_words(&self) -> u32 {
        let weights = u32::from(self.logs_weights());
        match (self.format, self.taps) {
            (EntryFormat::Counts, _) => 1,
            (EntryFormat::Packed, LoggedTaps::None) => 1,
            (EntryFormat::Packed, LoggedTaps::Fractions) => 2,
            (EntryFormat::Packed, LoggedTaps::Positions { .. }) => 1 + weights,
            (EntryFormat::Reals, LoggedTaps::None) => 2,
            (EntryFormat::Reals, LoggedTaps::Fractions) => 4,
            (EntryFormat::Reals, LoggedTaps::Positions { .. }) => 2 + weights,
        }
    }

    /// True if entries have positions in place of taps (`LOGS_POSITIONS`).
    pub fn logs_positions(&self) -> bool {
        matches!(self.taps, LoggedTaps::Positions { .. })
    }

    /// True if entries have weights (`LOGS_WEIGHTS`).
    pub fn logs_weights(&self) -> bool {
        self.format != EntryFormat::Counts
            && !matches!(self.taps, LoggedTaps::Positions { has_weights: false, .. })
    }

    /// Bytes of a word.
    pub fn word_bytes(&self) -> u32 {
        match self.format {
            EntryFormat::Counts => 4,
            EntryFormat::Packed | EntryFormat::Reals => 8,
        }
    }
}
