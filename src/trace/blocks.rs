//! A trace in blocks of rays, each with sums of its own: the blocks' scatter tells errors.

use crate::engine::budget::distribute;
use crate::engine::options::TraceOptions;
use crate::error::Result;
use crate::format::shown;
use crate::model::SceneIr;
use crate::result::{FluxSum, Tally};
use crate::trace::Tracer;

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

    /// Traces the next block, and gives its own sums; none if `keep_going`, which gets the rays done, stops the trace before
    /// the block's last ray. The block is not added yet.
    pub(crate) fn trace_next(
        &self,
        tracer: &mut Tracer,
        mut keep_going: impl FnMut(u64) -> bool,
    ) -> Result<Option<Tally>> {
        let num_rays = tracer.num_rays();
        let end = u128::from(num_rays) * u128::from(self.done + 1) / u128::from(self.num_blocks);
        let end = end as u64;
        let Tally { launched, rays, .. } = &self.sums;
        let begun = Tally { launched: *launched, rays: rays.clone(), ..tracer.empty_tally() };
        tracer.pause_at(end);
        let (mut is_stopped, mut is_whole) = (false, false);
        let tally = tracer.go_on(begun, |progress| {
            is_whole = progress.position() >= end;
            is_stopped = !keep_going(progress.done);
            Ok(!is_stopped && !is_whole)
        })?;
        Ok((!is_stopped || is_whole && self.done + 1 == self.num_blocks).then_some(tally))
    }

    /// Adds what [`Blocks::trace_next`] gave, and gives the block's sums alone: launched rays are those of the block.
    pub(crate) fn add(&mut self, traced: Tally) -> Tally {
        let (launched, rays) = (traced.launched, traced.rays.clone());
        let before = std::mem::take(&mut self.sums.launched);
        let own = FluxSum { count: launched.count - before.count, quanta: launched.quanta - before.quanta };
        let mut block = Tally { launched: own, rays: Default::default(), ..traced };
        // Rows of ray databases tell no errors, and would take memory.
        block.detectors.iter_mut().for_each(|detector| detector.rows = Vec::new());
        self.sums += &block;
        (self.sums.launched, self.sums.rays) = (launched, rays);
        self.done += 1;
        block
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
