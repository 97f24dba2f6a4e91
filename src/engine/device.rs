//! A program on a device: its stages, its buffers, and the groups that bind them.

use crate::engine::readback::Readback;
use crate::engine::stages::{ExtraBindings, RoundStages, Stages};
use crate::engine::sums::DeviceSums;
use crate::error::{Error, Result};
use crate::gpu::{self, Gpu};
use crate::program::layout::bindings;
use crate::program::{self, Program};
use std::sync::Arc;

/// A device, with the pipelines and buffers of a program's traces.
pub(crate) struct DeviceState {
    pub(crate) gpu: Gpu,
    pub(super) stages: Arc<Stages>,
    /// The buffers for rays that outlive a dispatch, where there can be such rays.
    pub(super) rounds: Option<Rounds>,
    /// Group 0, once for each list of buffers that additions bring.
    pub(super) scenes: Vec<wgpu::BindGroup>,
    /// Group 1, with the queues in either direction. Rays that survive a new range go to the first queue.
    pub(super) queues: [wgpu::BindGroup; 2],
    pub(super) range: wgpu::Buffer,
    pub(super) source: wgpu::Buffer,
    /// The uniforms of additions, by source ([`Program::uploads`]).
    pub(super) uploads: Vec<wgpu::Buffer>,
    /// The tables of shapes and sources, where there are any. Rays of files are uploaded there.
    pub(super) tables: Option<wgpu::Buffer>,
    pub(super) counts: wgpu::Buffer,
    pub(super) rng_table: wgpu::Buffer,
    pub(super) sums: DeviceSums,
    pub(super) tops: Option<DeviceSums>,
    pub(super) counters: DeviceSums,
    /// Rows for the host, where the scene or the user asks for them.
    pub(crate) events: Option<wgpu::Buffer>,
}

/// The buffers of the stages that follow the rays in a queue.
pub(super) struct Rounds {
    pub(super) advancing: wgpu::BindGroup,
    /// The number of workgroups for the rays in the queue.
    pub(super) workgroups: wgpu::Buffer,
}

impl DeviceState {
    pub(crate) fn new(
        gpu: &Gpu,
        program: &Program,
        batch: u32,
        stages: Arc<Stages>,
        extra: &ExtraBindings,
    ) -> Result<Self> {
        let compiler = &stages.compiler;
        let [scene_layout, queue_layout] = &compiler.layouts;
        let has_queue = program.options.has_queue();
        let counts = gpu.buffer("queue counts", 16)?;
        let rounds = stages.rounds.as_ref().map(|stages| Rounds::new(gpu, stages, &counts)).transpose()?;
        let sums = DeviceSums::new(gpu, &program.sums.sums)?;
        let tops = program.sums.tops.as_ref().map(|tops| DeviceSums::new(gpu, tops)).transpose()?;
        let counters = DeviceSums::new(gpu, &program.sums.counters)?;
        let range_bytes = stride_of(program, "Range")? as usize;
        let range = gpu.constant_buffer("range", &vec![0; range_bytes]);
        let source =
            gpu.constant_buffer("source", program.source_uniforms.first().map_or(&[], Vec::as_slice));
        let uploads: Vec<(u32, wgpu::Buffer)> = program
            .uploads
            .iter()
            .map(|(number, of_sources)| (*number, gpu.constant_buffer("an upload", &of_sources[0])))
            .collect();
        let events = match program.max_events_per_ray {
            0 => None,
            per_ray => {
                let rows = per_ray * u64::from(batch);
                Some(gpu.buffer("the rows", rows * stride_of(program, "Event")?)?)
            }
        };
        let is_image = |number: u32| {
            let is_it = |binding: &gpu::compute::Binding| {
                (binding.group, binding.number) == (bindings::SCENE, number)
            };
            compiler
                .bindings
                .iter()
                .any(|binding| is_it(binding) && binding.access == gpu::compute::Access::Texels)
        };
        let (images, buffers): (Vec<_>, Vec<_>) =
            program.buffers.iter().partition(|(number, _)| is_image(*number));
        let image =
            |(number, bytes): &(u32, Vec<u8>)| (*number, gpu.scene_texels(bytes, program::TEXELS_PER_LINE));
        let images: Vec<(u32, wgpu::TextureView)> = images.into_iter().map(image).collect();
        let buffer = |(number, bytes): &(u32, Vec<u8>)| Ok((*number, gpu.scene_buffer(bytes)?));
        let constants: Vec<(u32, wgpu::Buffer)> = buffers.into_iter().map(buffer).collect::<Result<_>>()?;
        let rng_table = gpu.constant_buffer("draws", &program.rng_table);
        let mut scene: Vec<(u32, &wgpu::Buffer)> =
            vec![(bindings::RANGE, &range), (bindings::RNG_TABLE, &rng_table)];
        scene.extend(
            [Some(&sums), tops.as_ref(), Some(&counters)]
                .into_iter()
                .flatten()
                .flat_map(DeviceSums::bindings),
        );
        if !program.source_uniforms.is_empty() {
            scene.push((bindings::SOURCE, &source));
        }
        scene.extend(events.as_ref().map(|events| (bindings::EVENTS, events)));
        scene.extend(constants.iter().chain(&uploads).map(|(number, buffer)| (*number, buffer)));
        let group = |added: &Vec<(u32, wgpu::Buffer)>| {
            let added = added.iter().map(|(number, buffer)| (*number, buffer));
            gpu.bind_group("scene", scene_layout, scene.iter().copied().chain(added), &images)
        };
        let scenes = extra.groups.iter().map(group).collect();

        let queue_bytes = if has_queue { u64::from(batch) * stride_of_queue(program)? } else { 0 };
        let queue =
            [gpu.buffer("the first queue", queue_bytes)?, gpu.buffer("the second queue", queue_bytes)?];
        let direction = |from: usize, to: usize| {
            let mut buffers = vec![(bindings::QUEUE_COUNTS, &counts)];
            if has_queue {
                buffers.extend([(bindings::QUEUE_IN, &queue[from]), (bindings::QUEUE_OUT, &queue[to])]);
            }
            gpu.bind_group("queues", queue_layout, buffers, &[])
        };
        let queues = [direction(1, 0), direction(0, 1)];
        gpu.check()?;
        Ok(DeviceState {
            gpu: gpu.clone(),
            stages,
            rounds,
            scenes,
            queues,
            range,
            source,
            uploads: uploads.into_iter().map(|(_, buffer)| buffer).collect(),
            tables: constants
                .into_iter()
                .find(|(number, _)| *number == bindings::TABLES)
                .map(|(_, buffer)| buffer),
            counts,
            rng_table,
            sums,
            tops,
            counters,
            events,
        })
    }

    /// True if the host receives rows.
    pub(crate) fn keeps_rows(&self) -> bool {
        self.events.is_some()
    }

    /// Replaces the table of draws.
    pub(crate) fn set_draws(&self, rng_table: &[u8]) {
        self.gpu.queue.write_buffer(&self.rng_table, 0, rng_table);
    }

    /// Passes the sums to `readback`, and clears them.
    pub(crate) fn drain(&self, readback: &mut Readback) -> Result<()> {
        self.counters.read(&self.gpu, |counter, count| readback.count(counter, count as u64))?;
        for sums in [Some(&self.sums), self.tops.as_ref()].into_iter().flatten() {
            sums.read(&self.gpu, |cell, quanta| readback.sum(cell, quanta))?;
        }
        self.clear_sums();
        Ok(())
    }

    /// Fails if the driver has left loops before their end, in a trace beside the main one.
    pub(crate) fn check_loops_of_second_trace(&self, program: &Program) -> Result<()> {
        if program.options.has_long_loops(&program.features) && self.take_cut_loops()? {
            return Err(Error::Device(format!(
                "the driver of `{}` cut the shader's loops short where rays were traced again for their paths; use a smaller \
                 split_depth or max_depth, or another adapter",
                self.gpu.info.name
            )));
        }
        Ok(())
    }

    /// Waits for the device, and asks how many rays live on.
    pub(crate) fn num_queued(&self) -> Result<u32> {
        const OUTGOING: u64 = 4;
        let bytes = self.gpu.read_at(&self.counts, OUTGOING, 4)?;
        Ok(bytemuck::pod_read_unaligned(&bytes))
    }

    /// Forgets the rows for the host of a dispatch.
    pub(crate) fn forget_rows(&self) {
        if self.keeps_rows() {
            self.gpu.queue.write_buffer(&self.counts, 0, &[0; 12]);
        }
    }

    /// Clears the sums.
    pub(crate) fn clear_sums(&self) {
        let Gpu { device, queue, .. } = &self.gpu;
        let mut encoder = device.create_command_encoder(&Default::default());
        for sums in [Some(&self.sums), self.tops.as_ref(), Some(&self.counters)].into_iter().flatten() {
            sums.clear(&mut encoder);
        }
        queue.submit([encoder.finish()]);
    }

    /// True if the driver has left a loop early since the last call.
    pub(crate) fn take_cut_loops(&self) -> Result<bool> {
        const CUT_LOOPS: u64 = 12;
        let was_cut = self.gpu.read_at(&self.counts, CUT_LOOPS, 4)?.iter().any(|&byte| byte != 0);
        if was_cut {
            self.gpu.queue.write_buffer(&self.counts, CUT_LOOPS, &[0; 4]);
        }
        Ok(was_cut)
    }
}

impl Rounds {
    fn new(gpu: &Gpu, stages: &RoundStages, counts: &wgpu::Buffer) -> Result<Self> {
        let workgroups = gpu.buffer("workgroups", 12)?;
        let buffers = [(bindings::COUNTS, counts), (bindings::WORKGROUPS, &workgroups)];
        let advancing = gpu.bind_group("advance", &stages.advancing, buffers, &[]);
        Ok(Rounds { advancing, workgroups })
    }
}

/// Bytes of an entry of a queue, of a program whose rays can outlive a dispatch.
pub(crate) fn stride_of_queue(program: &Program) -> Result<u64> {
    let module = &program.module;
    let queue =
        module.global_variables.iter().find(|(_, variable)| variable.name.as_deref() == Some("queue_in"));
    match queue.map(|(_, variable)| &module.types[variable.ty].inner) {
        Some(naga::TypeInner::Array { stride, .. }) => Ok(u64::from(*stride)),
        _ => Err(Error::Internal("the program has no queue".into())),
    }
}

/// The stride of an array of the program's struct with this name \[bytes\].
pub(crate) fn stride_of(program: &Program, name: &str) -> Result<u64> {
    Ok(crate::program::layout::reals::StructLayout::of(&program.module, name)?.stride as u64)
}
