//! A trace in blocks of rays, each with sums of its own. Standard errors follow from the scatter of the blocks.

use crate::engine::budget::distribute;
use crate::engine::options::TraceOptions;
use crate::error::Result;
use crate::format::shown;
use crate::model::SceneIr;
use crate::result::{FluxSum, RaySpans, Tally};
use crate::run::Tracer;

/// Rays of a block, at most: a stop then loses little, and sums of derivatives are read before they can overflow.
pub(crate) const MOST_BLOCK_RAYS: u64 = 1 << 20;

/// The number of blocks of a trace, where there are so many at least.
pub(crate) fn num_blocks(num_rays: u64, least: u64) -> u64 {
    least.max(num_rays.div_ceil(MOST_BLOCK_RAYS)).min(num_rays)
}

/// The sums of some rays.
pub(crate) struct Traced {
    pub(crate) tally: Tally,
    /// False if the trace was stopped before the last of them.
    pub(crate) is_whole: bool,
    /// True if the trace was stopped, be it after the last of them.
    pub(crate) is_stopped: bool,
}

/// Traces on to the position `end` where so many rays were launched before, and these. The sums are of the new rays
/// alone, but for the rays that were launched. `keep_going` is as in [`Blocks::trace_to`].
pub(crate) fn trace_on(
    tracer: &mut Tracer,
    (launched, rays): (FluxSum, RaySpans),
    end: u64,
    mut keep_going: impl FnMut(u64) -> bool,
) -> Result<Traced> {
    let begun = Tally { launched, rays, ..tracer.empty_tally() };
    tracer.pause_at(end);
    let (mut is_whole, mut is_stopped) = (false, false);
    let tally = tracer.go_on_checked(begun, |progress| {
        is_whole = progress.position() >= end;
        is_stopped = !keep_going(progress.done);
        Ok(!is_stopped && !is_whole)
    })?;
    Ok(Traced { tally, is_whole, is_stopped })
}

/// The sums of the blocks so far.
pub(crate) struct Blocks {
    pub(crate) sums: Tally,
    num_blocks: u64,
    done: u64,
}

impl Blocks {
    /// Before the first of so many blocks.
    pub(crate) fn new(tracer: &Tracer, num_blocks: u64) -> Self {
        Blocks { sums: tracer.empty_tally(), num_blocks, done: 0 }
    }

    /// The position at which the next block ends.
    pub(crate) fn next_end(&self, tracer: &Tracer) -> u64 {
        let end = u128::from(tracer.num_rays()) * u128::from(self.done + 1) / u128::from(self.num_blocks);
        end as u64
    }

    /// Traces on to the position `end`, and gives the sums of these rays alone, which are not added yet. `keep_going`
    /// gets the rays done, and stops the trace by returning false: the sums are then of the rays that were traced.
    pub(crate) fn trace_to(
        &self,
        tracer: &mut Tracer,
        end: u64,
        keep_going: impl FnMut(u64) -> bool,
    ) -> Result<Traced> {
        let Tally { launched, rays, .. } = &self.sums;
        trace_on(tracer, (*launched, rays.clone()), end, keep_going)
    }

    /// Adds what [`Blocks::trace_to`] gave, and gives the sums of these rays alone: launched rays are theirs.
    pub(crate) fn add(&mut self, traced: Tally) -> Tally {
        let (launched, rays) = (traced.launched, traced.rays.clone());
        let before = std::mem::take(&mut self.sums.launched);
        let own = FluxSum { count: launched.count - before.count, quanta: launched.quanta - before.quanta };
        let mut block = Tally { launched: own, rays: Default::default(), ..traced };
        // Rows of ray databases do not help to find errors, and would take memory.
        block.detectors.iter_mut().for_each(|detector| detector.rows = Vec::new());
        self.sums += &block;
        (self.sums.launched, self.sums.rays) = (launched, rays);
        block
    }

    /// The block is traced to its end.
    pub(crate) fn end_block(&mut self) {
        self.done += 1;
    }
}

/// What to say of sources that launch fewer rays than there are blocks.
pub(crate) fn notes_of_few_rays(
    ir: &SceneIr,
    options: &TraceOptions,
    num_blocks: u64,
) -> Result<Vec<String>> {
    let launched = distribute(ir, options.budget(), options.shares.as_deref())?;
    let few = launched.iter().zip(&ir.sources).filter(|(rays, _)| rays.count < num_blocks);
    let notes = few.map(|(rays, source)| {
        format!(
            "source `{}` launches {} rays, fewer than the {num_blocks} blocks: errors of its light are too large",
            shown(&source.name),
            rays.count
        )
    });
    Ok(notes.collect())
}
