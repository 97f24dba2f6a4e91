//! Finds the sequences of paths: traces one ray of each path again, by a program that reports what happens to the ray.

use crate::engine::device::DeviceState;
use crate::engine::dispatch::write_streamed;
use crate::engine::dispatch_size::DispatchSize;
use crate::engine::options::{Collect, TraceOptions};
use crate::engine::pipeline_cache::Shaders;
use crate::engine::plan::TracePlan;
use crate::engine::retrace::{After, Batch, Retrace, Retracing, trace_again};
use crate::engine::rows::read_events;
use crate::engine::stages::ExtraBindings;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::sequence::{End, Sequence, SequenceKey, Step};
use crate::model::{SceneIr, ray_id};
use crate::paths::followed::FollowedPaths;
use crate::paths::layout::Slot;
use crate::program::layout::bindings;
use crate::program::{RayRange, events};
use crate::result::RaySpan;
use glam::DVec3;
use std::collections::HashMap;
use std::time::Instant;

/// A path that was found again.
#[derive(Debug, Clone)]
pub(crate) struct Found {
    pub(crate) sequence: Sequence,
    /// Where the ray came to the path's end, in the scene's frame \[mm\].
    pub(crate) position: DVec3,
}

/// A program that reports what happens to rays of a list.
pub(crate) struct PathReplay {
    again: Retrace,
    device: DeviceState,
    ids: wgpu::Buffer,
    is_strict: bool,
}

/// Most rays of a list.
const MOST_LISTED: u32 = 1 << 14;

/// The rays of a list are traced in one dispatch.
struct Once;

impl Retracing for Once {
    fn after(&mut self, range: &RayRange, _start: Instant) -> Result<After> {
        Ok(After::Next(Batch { rays: range.count.into(), submissions: 1 }))
    }
}

impl PathReplay {
    /// Compiles the program for the rays of a plan, if no earlier trace has.
    pub(crate) fn new(gpu: &Gpu, ir: &SceneIr, plan: &TracePlan) -> Result<Self> {
        let options = &plan.options;
        let is_strict = options.is_strict(&gpu.info);
        let ends = matches!(options.collect, Collect::Paths { ends: true, .. });
        let collect = Collect::Events { ends };
        let options = TraceOptions { collect, batch_size: Some(MOST_LISTED), ..options.clone() };
        let additions = FollowedPaths::additions(&options);
        let again =
            Retrace::new(gpu, ir, &options, additions, Shaders { cache: plan.cache.as_ref(), edit: None })?;
        let ids = gpu.buffer("listed rays", u64::from(again.plan.batch) * 16)?;
        let device = again.open(gpu, ExtraBindings::of([(bindings::LISTED_IDS, ids.clone())]))?;
        Ok(PathReplay { again, device, ids, is_strict })
    }

    /// Sets the seed of the draws.
    pub(crate) fn set_seed(&mut self, seed: u64) {
        self.again.plan.program.set_seed(seed);
        self.device.set_draws(&self.again.plan.program.rng_table);
    }

    /// The sequences of these keys. Each slot names a ray that took the path. Where arithmetic is not strict, another shader
    /// may round a ray onto another path: the sequence is then not found.
    pub(crate) fn find(&mut self, slots: &[(SequenceKey, Slot)]) -> Result<HashMap<SequenceKey, Found>> {
        let mut found = HashMap::new();
        let splits = self.again.plan.program.splitting.is_some();
        for source in 0..self.again.plan.rays.len() {
            let of_source = slots.iter().filter(|(_, slot)| slot.source as usize == source);
            let mut rays: Vec<(u64, u64)> =
                of_source.map(|(_, slot)| ray_id::order(slot.ray, splits)).collect();
            rays.sort_unstable();
            rays.dedup();
            for rays in rays.chunks(self.again.plan.batch as usize) {
                self.find_rays(source, rays, &mut found)?;
            }
        }
        let is_missing = |(key, _): &&(SequenceKey, Slot)| !found.contains_key(key);
        match slots.iter().find(is_missing).filter(|_| self.is_strict) {
            None => Ok(found),
            Some((_, slot)) => Err(Error::Internal(format!(
                "ray {} was traced again, and did not take the path that the table has of it",
                slot.ray
            ))),
        }
    }

    fn find_rays(
        &mut self,
        source: usize,
        rays: &[(u64, u64)],
        found: &mut HashMap<SequenceKey, Found>,
    ) -> Result<()> {
        let queue = &self.device.gpu.queue;
        // The launched rays, then their children's numbers.
        let launched: Vec<u64> = rays.iter().map(|(launched, _)| *launched).collect();
        let numbers: Vec<u64> = rays.iter().map(|(_, number)| *number).collect();
        queue.write_buffer(&self.ids, 0, bytemuck::cast_slice(&launched));
        queue.write_buffer(&self.ids, 8 * u64::from(self.again.plan.batch), bytemuck::cast_slice(&numbers));
        write_streamed(&self.device, &self.again.plan.program, source, &launched)?;
        let span = RaySpan { first: 0, count: rays.len() as u64, source: source as u32 };
        let submissions = DispatchSize::new(self.again.plan.batch, 1, 1).submissions();
        let batch = Batch { rays: span.count, submissions };
        // The sums of this trace are not read.
        trace_again(&self.device, &self.again.plan, &[span], batch, &mut Once)?;
        let Some(buffer) = &self.device.events else {
            return Err(Error::Internal("a program that reports paths has no events".into()));
        };
        let splits = self.again.plan.program.splitting.is_some();
        let mut steps = HashMap::new();
        let mut ends = Vec::new();
        for event in read_events(&self.device, buffer, &self.again.plan, span.first)? {
            // The place in the list, and the number within the family.
            let (place, number) = ray_id::order(event.row.ray_id, splits);
            match event.kind {
                events::PATH_STEP => {
                    steps.insert((place, number, event.row.bounce), event.subject);
                }
                events::PATH_END => ends.push((place, number, event)),
                _ => {}
            }
        }
        for (place, number, end) in ends {
            // What happened to a ray before it came into being happened to the ray from which it was split.
            let of_lineage = |bounce: u32| {
                let number = number & ((1 << (bounce + 1).min(ray_id::NUMBER_BITS)) - 1);
                steps.get(&(place, number, bounce)).and_then(|code| Step::of_code(*code))
            };
            let Some(end_of_path) = End::of_code(end.subject) else {
                return Err(Error::Internal(format!("a path has the unknown end {}", end.subject)));
            };
            let sequence = Sequence {
                source: source as u32,
                steps: (0..end.row.bounce).filter_map(of_lineage).collect(),
                end: end_of_path,
            };
            found.insert(sequence.key(), Found { sequence, position: DVec3::from_array(end.row.position) });
        }
        Ok(())
    }
}
