//! Finds the sequences of paths: traces one ray of each path again, by a program that tells what happens to the ray.

use crate::engine::device::DeviceState;
use crate::engine::dispatch::submit_alone;
use crate::engine::dispatch_size::DispatchSize;
use crate::engine::limits::DispatchLimits;
use crate::engine::options::TraceOptions;
use crate::engine::plan::{Draft, Plan};
use crate::engine::rows::read_events;
use crate::engine::stages::{Additions, Stages};
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::sequence::{End, Sequence, SequenceKey, Step};
use crate::model::{SceneIr, ray_id};
use crate::program::layout::bindings;
use crate::program::layout::paths::Slot;
use crate::program::parsed::Parsed;
use crate::program::wgsl::extension::NoExtension;
use crate::program::{PathSums, Program, RayRange, events};
use glam::DVec3;
use std::collections::HashMap;
use std::sync::Arc;

/// A path that was found again.
#[derive(Debug, Clone)]
pub(crate) struct Found {
    pub(crate) sequence: Sequence,
    /// Where the ray came to the path's end, in the scene's frame \[mm\].
    pub(crate) position: DVec3,
}

/// A program that tells what happens to rays of a list.
pub(crate) struct Teller {
    plan: Plan,
    device: DeviceState,
    ids: wgpu::Buffer,
    is_strict: bool,
}

/// Most rays of a list.
const MOST_LISTED: u32 = 1 << 14;

impl Teller {
    /// Compiles the program.
    pub(crate) fn new(gpu: &Gpu, ir: &SceneIr, options: &TraceOptions) -> Result<Self> {
        let is_strict = options.is_strict(&gpu.info);
        let options = TraceOptions { path_table: false, batch_size: Some(MOST_LISTED), ..options.clone() };
        let mut draft = Draft::new(gpu, ir, &options)?;
        draft.program.path_sums = PathSums::Told;
        let parse = |wgsl, precision| Parsed::of(wgsl, precision).map(Arc::new);
        let limits = |program: &Program| DispatchLimits { processors: 1, ..DispatchLimits::of(program) };
        let plan = draft.compose(gpu, ir, &NoExtension, parse, limits)?;
        let stages = Stages::new(gpu, &plan.program, is_strict, &Additions::default())?;
        let ids = gpu.buffer("listed rays", u64::from(plan.batch) * 16)?;
        let additions =
            Additions { groups: vec![vec![(bindings::LISTED_IDS, ids.clone())]], stages: Vec::new() };
        let device = DeviceState::new(gpu, &plan.program, plan.batch, Arc::new(stages), &additions, None)?;
        Ok(Teller { plan, device, ids, is_strict })
    }

    /// Sets the seed of the draws.
    pub(crate) fn set_seed(&mut self, seed: u64) {
        self.plan.program.set_seed(seed);
        self.device.set_draws(&self.plan.program.rng_table);
    }

    /// The sequences of these keys. Each slot names a ray that took the path. Where arithmetic is not strict, another shader
    /// may round a ray onto another path: the sequence is then not found.
    pub(crate) fn tell(&mut self, slots: &[(SequenceKey, Slot)]) -> Result<HashMap<SequenceKey, Found>> {
        let mut found = HashMap::new();
        let splits = self.plan.program.splitting.is_some();
        for source in 0..self.plan.rays.len() {
            let of_source = slots.iter().filter(|(_, slot)| slot.source as usize == source);
            let mut rays: Vec<(u64, u64)> =
                of_source.map(|(_, slot)| ray_id::order(slot.ray, splits)).collect();
            rays.sort_unstable();
            rays.dedup();
            for rays in rays.chunks(self.plan.batch as usize) {
                self.tell_rays(source, rays, &mut found)?;
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

    fn tell_rays(
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
        queue.write_buffer(&self.ids, 8 * u64::from(self.plan.batch), bytemuck::cast_slice(&numbers));
        let range = RayRange::of(0, rays.len() as u32, source);
        let size = DispatchSize::new(self.plan.batch, 1, 1);
        // The sums of this trace are not read.
        submit_alone(&self.device, &self.plan, &range, size.submissions(), |_| Ok(()))?;
        self.device.check_loops_of_second_trace(&self.plan.program)?;
        let Some(buffer) = &self.device.events else {
            return Err(Error::Internal("a program that tells paths has no events".into()));
        };
        let splits = self.plan.program.splitting.is_some();
        let mut steps = HashMap::new();
        let mut ends = Vec::new();
        for event in read_events(&self.device, buffer, &self.plan, range.first)? {
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
