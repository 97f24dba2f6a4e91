//! The rays that passes have launched since the sums were drained.

use crate::engine::limits::counts_unasked;
use crate::engine::plan::TracePlan;
use crate::model::SceneIr;
use crate::program::RayRange;
use crate::result::{DetectorTally, FluxSum, RaySpan, RaySpans, SurfaceTally, Tally};

/// The rays launched since the sums were drained.
#[derive(Debug, Default)]
pub(crate) struct Undrained {
    pub(super) launched: FluxSum,
    pub(crate) rays: RaySpans,
    /// An upper bound of every counter.
    pub(crate) counts: u64,
    /// As many of these were spilled by the device.
    spilled: u64,
    num_passes: u64,
    /// The primitives that rays have reached, a bit each, as far as the device was asked.
    pub(crate) reached: u32,
}

impl Undrained {
    /// Adds a range.
    pub(crate) fn launch(&mut self, plan: &TracePlan, range: &RayRange) {
        let (count, source) = (u64::from(range.count), range.source as u32);
        self.launched += plan.births(range);
        self.rays += RaySpan { first: range.first, count, source };
        self.counts += count * counts_unasked(&plan.program);
    }

    /// Adds rounds in which counters may count so much. True if the device must spill its sums first, for
    /// counters to stay below `most`. Ranges of the present pass may not be added yet: they count at most 2^29, and 2^31 +
    /// 2^29 < 2^32.
    pub(crate) fn go_on(&mut self, counts: u64, most: u64) -> bool {
        let must_spill = self.counts - self.spilled + counts > most;
        if must_spill {
            self.spilled = self.counts;
        }
        self.counts += counts;
        must_spill
    }

    /// Counts a pass, and says whether to ask the device now which primitives were reached. Asking waits for the device,
    /// which an addition may keep busy from one pass to the next; so the answer is true ever more rarely.
    pub(crate) fn should_ask_after_pass(&mut self) -> bool {
        self.num_passes += 1;
        self.num_passes.is_power_of_two()
    }
}

/// A tally without rays, in the scene's shape.
pub(crate) fn empty_tally(ir: &SceneIr) -> Tally {
    let detectors = ir.detectors.iter().map(|detector| DetectorTally {
        quanta: vec![0; detector.num_cells()],
        hits: vec![0; detector.num_cells()],
        ..Default::default()
    });
    Tally {
        detectors: detectors.collect(),
        surfaces: vec![SurfaceTally::default(); ir.surfaces.len()],
        ..Default::default()
    }
}
