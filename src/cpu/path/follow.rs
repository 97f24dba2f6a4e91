//! How rays follow paths. All rays follow the hot path first. Rays that fail one of its guards follow a side trace, or
//! the plain stages.

use crate::cpu::log::buffers::{LogBuffers, Rays};
use crate::cpu::path::pays;
use crate::cpu::request::CpuShader;
use crate::cpu::{Cpu, Override};
use crate::engine::Engine;
use crate::error::Result;
use crate::program::{Program, RayRange};
use crate::result::Tally;

impl Cpu {
    /// Whether new rays should follow the hot path, if there is one: always where that was asked for.
    pub(in crate::cpu) fn path_pays(&self, program: &Program) -> bool {
        let pays = |logs: &LogBuffers| pays::pays(logs.num_followed_and_failed());
        CpuShader::of_program(program).hot_path.is_none()
            || self.overrides.hot_path == Override::Always
            || self.logs.as_ref().is_none_or(pays)
    }

    /// Traces rays of a source that failed a guard of the hot path along a side trace, if so many wait for one. False
    /// if fewer wait.
    pub(in crate::cpu) fn follow_sides(
        &mut self,
        engine: &mut Engine,
        source: usize,
        at_least: usize,
    ) -> Result<bool> {
        let most = engine.plan.batch as usize;
        let mut were_enough = false;
        while let Some(logs) = &mut self.logs
            && let Some((side, ids)) = logs.fallback().take_of_side(source, at_least, most)
        {
            were_enough = true;
            let range = self.listed(engine, source, &ids);
            self.dispatch(engine, &range, Rays::OfSide { side, ids })?;
        }
        Ok(were_enough)
    }

    /// The same of all sources, however few wait, unless that does not pay.
    pub(in crate::cpu) fn follow_last_sides(&mut self, engine: &mut Engine) -> Result<bool> {
        self.logs.as_mut().into_iter().for_each(|logs| logs.fallback().give_up_few());
        let mut were_any = false;
        for source in 0..engine.plan.rays.len() {
            were_any |= self.follow_sides(engine, source, 1)?;
        }
        Ok(were_any)
    }

    /// Traces by the plain stages the rays of a source that failed a guard and wait for no side trace, while so many
    /// wait.
    pub(in crate::cpu) fn trace_fallback(
        &mut self,
        engine: &mut Engine,
        source: usize,
        at_least: u32,
    ) -> Result<()> {
        while let Some(logs) = &mut self.logs
            && logs.fallback().num(source) >= at_least as usize
        {
            let ids = logs.fallback().take(source, engine.size.rays() as usize);
            let range = self.listed(engine, source, &ids);
            self.dispatch(engine, &range, Rays::Fallback)?;
        }
        Ok(())
    }

    /// A range of rays with these ids, which the device gets.
    fn listed(&self, engine: &Engine, source: usize, ids: &[u64]) -> RayRange {
        if let Some(buffer) = &self.ids {
            engine.gpu.queue.write_buffer(buffer, 0, bytemuck::cast_slice(ids));
        }
        let log_stride = self.logs.as_ref().map_or(0, LogBuffers::stride);
        let reached = engine.undrained.reached;
        RayRange { first: 0, count: ids.len() as u32, source, log_stride, reached }
    }

    /// Marks in a tally what the rays of this trace have reached that kept to a path.
    pub(in crate::cpu) fn mark_paths_reached(&self, program: &Program, tally: &mut Tally) {
        let added = CpuShader::of_program(program);
        let (Some(main), Some(logs)) = (&added.hot_path, &self.logs) else { return };
        let sides = added.side_traces.iter().map(|side| &side.path).zip(logs.num_along_sides());
        let paths = std::iter::once((main, logs.num_followed_and_failed())).chain(sides);
        let kept = paths.filter(|(_, [num_followed, num_failed])| num_followed > num_failed);
        for event in kept.flat_map(|(path, _)| &path.events) {
            let surface = tally.surfaces.get_mut(event.primitive);
            surface.into_iter().for_each(|surface| surface.reached = true);
        }
    }
}
