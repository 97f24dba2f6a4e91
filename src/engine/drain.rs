//! How the sums of the device and of additions get into a tally.

use crate::engine::Engine;
use crate::engine::addition::Additions;
use crate::engine::readback::Readback;
use crate::engine::undrained::{Undrained, empty_tally};
use crate::error::{Error, Result};
use crate::program::SecondMoments;
use crate::program::layout::tables::ReachedMarks;
use crate::result::Tally;

/// Adds all sums since the last drain to a tally, and clears them.
pub(crate) fn drain(engine: &mut Engine, additions: &mut Additions, tally: &mut Tally) -> Result<()> {
    drain_device(engine, additions, tally)?;
    additions.each(|addition| addition.drain(engine, tally))?;
    let Undrained { launched, rays, .. } = std::mem::take(&mut engine.undrained);
    tally.launched += launched;
    tally.rays += &rays;
    engine.rows.drain(tally);
    Ok(())
}

/// Adds the sums of the device to a tally, and clears them.
fn drain_device(engine: &mut Engine, additions: &mut Additions, tally: &mut Tally) -> Result<()> {
    additions.each(|addition| addition.finish_pending(engine))?;
    engine.check_loops()?;
    engine.drain_sums(tally)?;
    if let Some(spilled) = engine.spilled.take() {
        *tally += &spilled;
    }
    Ok(())
}

/// Discards what an earlier trace left that failed half-way.
pub(crate) fn discard(engine: &mut Engine, additions: &mut Additions) -> Result<()> {
    additions.each(|addition| addition.discard(engine))?;
    if engine.undrained.counts > 0 {
        let nothing = &mut empty_tally(engine.ir);
        drain_device(engine, additions, nothing)?;
        engine.undrained = Undrained::default();
        engine.rows.drain(nothing);
    }
    Ok(())
}

impl Engine<'_> {
    /// A readback, which adds counters and sums to a tally.
    pub(crate) fn readback<'t>(&'t self, tally: &'t mut Tally) -> Readback<'t> {
        Readback::new(&self.plan.program.cells, self.plan.counted(), self.plan.rays.len(), tally)
    }

    fn drain_sums(&self, tally: &mut Tally) -> Result<()> {
        let mut readback = self.readback(tally);
        self.device.drain(&mut readback)?;
        readback.finish(self.plan.reached_marks());
        Ok(())
    }

    /// Moves the sums of the device to the host within a range, before counters overflow.
    pub(super) fn spill(&mut self) -> Result<()> {
        let mut spilled = self.spilled.take().unwrap_or_else(|| empty_tally(self.ir));
        self.drain_sums(&mut spilled)?;
        self.spilled = Some(spilled);
        Ok(())
    }

    /// Asks the device which primitives rays have reached, unless all are known. Later rays need not report these
    /// again.
    pub(crate) fn learn_reached(&mut self) -> Result<()> {
        let cells = &self.plan.program.cells;
        let are_known = self.undrained.reached.count_ones() as usize == self.ir.surfaces.len();
        if self.plan.reached_marks() == ReachedMarks::Bits && !are_known {
            self.undrained.reached |= self.device.counters.read_word(self.gpu, cells.reached)?;
        }
        Ok(())
    }

    /// Fails if the driver has left loops before their end (shaders/cpu/loops.many.wgsl).
    pub(crate) fn check_loops(&self) -> Result<()> {
        let program = &self.plan.program;
        if !program.options.has_long_loops(&program.features) || !self.device.take_cut_loops()? {
            return Ok(());
        }
        let (depth, budget) = (self.ir.sampling.split_depth, self.ir.sampling.split_budget);
        let has_splitting = program.splitting.is_some();
        let [.., has_gaussian] = program.features.splats;
        let advice = [
            (has_splitting, format!("a split_depth below {depth} or a split_budget below {budget}")),
            (has_gaussian, "a smaller splat_sigma".to_string()),
            (true, format!("a max_depth below {}", program.options.max_depth.min(1 << 16))),
            (program.options.moments != SecondMoments::None, "--standard-error off".to_string()),
        ];
        let advice: Vec<String> =
            advice.into_iter().filter(|(helps, _)| *helps).map(|(_, text)| text).collect();
        Err(Error::Device(format!(
            "the driver of `{}` cut the shader's loops short, as lavapipe does after 65,535 iterations for the rays of \
             one vector, and lost what they had still to do; use {} or another adapter",
            self.gpu.info.name,
            advice.join(", ")
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::options::TraceOptions;
    use crate::engine::pass_loop;
    use crate::engine::pipeline_cache::Shaders;
    use crate::engine::prepare::prepare;
    use crate::engine::test_scenes::TRAP;
    use crate::gpu::{AdapterChoice, Gpu};
    use crate::run::StandardError;

    #[test]
    fn sums_that_leave_the_device_within_a_range_are_the_same_bits() {
        if crate::gpu::list_adapters().is_empty() {
            return;
        }
        let gpu = Gpu::open(&AdapterChoice::default()).unwrap();
        let ir = crate::Scene::from_json(TRAP).unwrap().lower().unwrap();
        for standard_error in [StandardError::Off, StandardError::On] {
            let options =
                TraceOptions { num_rays: 5000, max_depth: 900, standard_error, ..Default::default() };
            let traced = |most_counts: Option<u64>| {
                let mut plain = Additions::default();
                let mut engine = prepare(&gpu, &ir, &options, &mut plain, Shaders::default()).unwrap();
                engine.most_counts = most_counts.unwrap_or(engine.most_counts);
                pass_loop::trace(&mut engine, &mut plain, empty_tally(&ir), |_| Ok(true)).unwrap()
            };
            let tally = traced(None);
            assert!(tally.depth_killed.count + tally.roulette_loss.count > 1000, "light is caught");
            assert!(traced(Some(0)) == tally && traced(Some(100_000)) == tally);
        }
    }
}
