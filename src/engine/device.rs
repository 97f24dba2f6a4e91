//! A program on a device: pipelines, buffers, and the stages of a batch.

use crate::engine::intake::Intake;
use crate::engine::sums::DeviceSums;
use crate::error::{Error, Result};
use crate::gpu::{self, Gpu};
use crate::program::layout::bindings;
use crate::program::{self, Program, SecondMoments};
use crate::software::logs::{DeviceLogs, Rays};
use crate::software::path::side_path;
use std::cell::OnceCell;

/// A device, and what the traces of a program take of it.
pub(crate) struct DeviceState {
    pub(crate) gpu: Gpu,
    /// What the program's buffers take of it.
    pub(crate) bytes: u64,
    trace_new: wgpu::ComputePipeline,
    trace_nominal: Option<wgpu::ComputePipeline>,
    /// Stages of the side paths, each compiled when it is first needed.
    trace_sides: Vec<OnceCell<wgpu::ComputePipeline>>,
    compiler: Compiler,
    /// What follows rays that outlive a dispatch, where some can.
    rounds: Option<Rounds>,
    /// Group 0; one for each log of ends, where there are logs.
    scenes: Vec<wgpu::BindGroup>,
    /// Group 1 with the queues in either direction; rays that survive a new range go to the first queue.
    queues: [wgpu::BindGroup; 2],
    pub(crate) range: wgpu::Buffer,
    pub(crate) emitter: wgpu::Buffer,
    pub(crate) counts: wgpu::Buffer,
    pub(crate) rng_table: wgpu::Buffer,
    /// The ids of rays that strayed from the nominal path, as a dispatch reads them.
    pub(crate) strays: Option<wgpu::Buffer>,
    pub(crate) sums: DeviceSums,
    pub(crate) tops: Option<DeviceSums>,
    pub(crate) counters: DeviceSums,
    pub(crate) events: Option<wgpu::Buffer>,
}

/// What it takes to compile a stage.
struct Compiler {
    gpu: Gpu,
    bindings: Vec<gpu::compute::Binding>,
    /// Of the groups, in their order.
    layouts: [wgpu::BindGroupLayout; 2],
    /// All stages, where each has no module of its own.
    shader: Option<wgpu::ShaderModule>,
}

/// The stages that follow the rays in a queue, again and again.
struct Rounds {
    advance: wgpu::ComputePipeline,
    advancing: wgpu::BindGroup,
    trace_queued: wgpu::ComputePipeline,
    /// As many as the queue has work for.
    workgroups: wgpu::Buffer,
}

/// One dispatch of a stage.
pub(crate) struct Stage<'a> {
    pub(crate) name: &'static str,
    pipeline: &'a wgpu::ComputePipeline,
    groups: [Option<&'a wgpu::BindGroup>; 2],
    workgroups: Workgroups<'a>,
}

#[derive(Clone, Copy)]
enum Workgroups<'a> {
    Of([u32; 3]),
    /// As many as the device has counted.
    Counted(&'a wgpu::Buffer),
}

impl Stage<'_> {
    pub(crate) fn record(&self, pass: &mut wgpu::ComputePass) {
        pass.set_pipeline(self.pipeline);
        for (index, group) in (0..).zip(self.groups.into_iter().flatten()) {
            pass.set_bind_group(index, group, &[]);
        }
        match self.workgroups {
            Workgroups::Of([x, y, z]) => pass.dispatch_workgroups(x, y, z),
            Workgroups::Counted(counts) => pass.dispatch_workgroups_indirect(counts, 0),
        }
    }
}

impl Compiler {
    fn new(gpu: &Gpu, program: &Program, strict: bool) -> Result<Self> {
        let bindings = gpu::compute::bindings_of(&program.module);
        check_bindings(gpu, program, &bindings)?;
        let layouts = [("scene", bindings::SCENE), ("queues", bindings::QUEUES)];
        let layouts = layouts.map(|(label, group)| gpu.bind_group_layout(label, &bindings, group));
        let shader = (!strict).then(|| gpu.shader("trace", program.source()));
        Ok(Compiler { gpu: gpu.clone(), bindings, layouts, shader })
    }

    fn pipeline(&self, program: &Program, entry_point: &str) -> Result<wgpu::ComputePipeline> {
        let shader = match &self.shader {
            Some(shader) => shader,
            None => &self.gpu.strict_shader(entry_point, &program.module, &self.bindings)?,
        };
        Ok(self.gpu.pipeline(entry_point, shader, &self.layouts.each_ref(), &[]))
    }
}

impl DeviceState {
    pub(crate) fn new(
        gpu: &Gpu,
        program: &Program,
        batch: u32,
        strict: bool,
        logs: Option<&DeviceLogs>,
    ) -> Result<Self> {
        let compiler = Compiler::new(gpu, program, strict)?;
        let [scene_layout, queue_layout] = &compiler.layouts;
        let has_queue = program.options.has_queue();
        let pipeline = |entry_point| compiler.pipeline(program, entry_point);
        let counts = gpu.buffer("queue counts", 16)?;
        // To compile one takes lavapipe a tenth of a second and more.
        let others = || -> Result<_> {
            let trace_nominal = program.nominal.as_ref().map(|_| pipeline("trace_nominal")).transpose()?;
            let rounds = || Rounds::new(gpu, program, &counts, pipeline("trace_queued")?);
            Ok((trace_nominal, has_queue.then(rounds).transpose()?))
        };
        let has_others = program.nominal.is_some() || has_queue;
        let (trace_new, others) =
            side_by_side(|| pipeline(program.entry_point()), has_others.then_some(others))?;
        let trace_new = trace_new?;
        let (trace_nominal, rounds) = others.transpose()?.unwrap_or_default();

        let sums = DeviceSums::new(gpu, &program.sums.sums)?;
        let tops = program.sums.tops.as_ref().map(|tops| DeviceSums::new(gpu, tops)).transpose()?;
        let counters = DeviceSums::new(gpu, &program.sums.counters)?;
        let range = gpu.constant_buffer("range", &vec![0; stride_of(program, "Range")? as usize]);
        let emitter = gpu.constant_buffer("emitter", program.emitters.first().map_or(&[], Vec::as_slice));
        let events = match program.options.has_events(&program.features) {
            true => {
                let rows = program.max_events_per_ray * u64::from(batch);
                Some(gpu.buffer("the rows", rows * stride_of(program, "Event")?)?)
            }
            false => None,
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
        let strays = match program.nominal {
            Some(_) => Some(gpu.buffer("rays that strayed", u64::from(batch) * 8)?),
            None => None,
        };
        let rng_table = gpu.constant_buffer("draws", &program.rng_table);
        let mut scene: Vec<(u32, &wgpu::Buffer)> =
            vec![(bindings::RANGE, &range), (bindings::RNG_TABLE, &rng_table)];
        scene.extend(
            [Some(&sums), tops.as_ref(), Some(&counters)]
                .into_iter()
                .flatten()
                .flat_map(DeviceSums::bindings),
        );
        if !program.emitters.is_empty() {
            scene.push((bindings::EMITTER, &emitter));
        }
        scene.extend(events.as_ref().map(|events| (bindings::EVENTS, events)));
        scene.extend(strays.as_ref().map(|strays| (bindings::REJECTED, strays)));
        scene.extend(constants.iter().map(|(number, buffer)| (*number, buffer)));
        let logs = logs.map_or(vec![None], |logs| logs.bindings().map(Some).into());
        let log_bytes: u64 = logs.iter().flatten().map(|(_, log)| log.size()).sum();
        let group = |log| gpu.bind_group("scene", scene_layout, scene.iter().copied().chain(log), &images);
        let scenes = logs.into_iter().map(group).collect();

        let queue_bytes = if has_queue { u64::from(batch) * stride_of(program, "QueuedRay")? } else { 0 };
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
        let stray_bytes = strays.as_ref().map_or(0, wgpu::Buffer::size);
        Ok(DeviceState {
            gpu: gpu.clone(),
            bytes: program.device_bytes() + log_bytes + stray_bytes + 2 * queue_bytes,
            trace_new,
            trace_nominal,
            trace_sides: program.side_paths.iter().map(|_| OnceCell::new()).collect(),
            compiler,
            rounds,
            scenes,
            queues,
            range,
            emitter,
            counts,
            rng_table,
            strays,
            sums,
            tops,
            counters,
            events,
        })
    }

    /// Compiles the stage that such rays go through, unless it is.
    pub(crate) fn prepare(&self, program: &Program, rays: &Rays) -> Result<()> {
        let Rays::OfSide { side, .. } = *rays else { return Ok(()) };
        let Some(stage) = self.trace_sides.get(side).filter(|stage| stage.get().is_none()) else {
            return Ok(());
        };
        let pipeline = self.compiler.pipeline(program, &side_path::entry_point(side))?;
        stage.get_or_init(|| pipeline);
        Ok(())
    }

    /// The stage of the path that such rays are to take, with its name, if it has one.
    pub(crate) fn trace_path(&self, rays: &Rays) -> Option<(&'static str, &wgpu::ComputePipeline)> {
        match rays {
            Rays::OfRange => self.trace_nominal.as_ref().map(|stage| ("trace_nominal", stage)),
            Rays::OfSide { side, .. } => Some(("trace_side", self.trace_sides.get(*side)?.get()?)),
            Rays::Strayed => None,
        }
    }

    /// The stages of one batch, in their order; `log` is the log of ends that they write.
    pub(crate) fn stages(
        &self,
        new_workgroups: [u32; 3],
        num_rounds: usize,
        log: usize,
        rays: &Rays,
    ) -> impl Iterator<Item = Stage<'_>> {
        let scene = &self.scenes[log];
        let (name, pipeline, rounds) = match self.trace_path(rays) {
            Some((name, trace_path)) => (name, trace_path, None),
            None => ("trace_new", &self.trace_new, self.rounds.as_ref()),
        };
        let first = Stage {
            name,
            pipeline,
            groups: [Some(scene), Some(&self.queues[0])],
            workgroups: Workgroups::Of(new_workgroups),
        };
        let rounds = rounds.into_iter().flat_map(move |rounds| {
            (1..num_rounds).flat_map(move |round| {
                let advance = Stage {
                    name: "advance",
                    pipeline: &rounds.advance,
                    groups: [Some(&rounds.advancing), None],
                    workgroups: Workgroups::Of([1, 1, 1]),
                };
                let trace_queued = Stage {
                    name: "trace_queued",
                    pipeline: &rounds.trace_queued,
                    groups: [Some(scene), Some(&self.queues[round % 2])],
                    workgroups: Workgroups::Counted(&rounds.workgroups),
                };
                [advance, trace_queued]
            })
        });
        std::iter::once(first).chain(rounds)
    }

    /// Hands over what was summed up, and clears it.
    pub(crate) fn drain(&self, intake: &mut Intake) -> Result<()> {
        let Gpu { device, queue, .. } = &self.gpu;
        self.counters.read(&self.gpu, |counter, count| intake.count(counter, count as u64))?;
        for sums in [Some(&self.sums), self.tops.as_ref()].into_iter().flatten() {
            sums.read(&self.gpu, |cell, quanta| intake.sum(cell, quanta))?;
        }
        let mut encoder = device.create_command_encoder(&Default::default());
        for sums in [Some(&self.sums), self.tops.as_ref(), Some(&self.counters)].into_iter().flatten() {
            sums.clear(&mut encoder);
        }
        queue.submit([encoder.finish()]);
        Ok(())
    }

    /// True if the driver has left a loop before its end since the last time.
    pub(crate) fn take_cut_loops(&self) -> Result<bool> {
        const CUT_LOOPS: u64 = 12;
        let was_cut = self.gpu.read_at(&self.counts, CUT_LOOPS, 4)?.iter().any(|&byte| byte != 0);
        if was_cut {
            self.gpu.queue.write_buffer(&self.counts, CUT_LOOPS, &[0; 4]);
        }
        Ok(was_cut)
    }
}

/// What two give, the second of which runs in a thread of its own, if there is one.
fn side_by_side<A, B: Send>(
    first: impl FnOnce() -> A,
    second: Option<impl FnOnce() -> B + Send>,
) -> Result<(A, Option<B>)> {
    /// As large as that of a main thread: compilers recurse.
    const STACK_BYTES: usize = 8 << 20;
    std::thread::scope(|scope| {
        let thread = |second| std::thread::Builder::new().stack_size(STACK_BYTES).spawn_scoped(scope, second);
        let no_thread = |error| Error::Device(format!("no thread to compile a stage: {error}"));
        let second = second.map(thread).transpose().map_err(no_thread)?;
        let first = first();
        let join = |thread: std::thread::ScopedJoinHandle<B>| {
            thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        };
        Ok((first, second.map(join)))
    })
}

impl Rounds {
    fn new(
        gpu: &Gpu,
        program: &Program,
        counts: &wgpu::Buffer,
        trace_queued: wgpu::ComputePipeline,
    ) -> Result<Self> {
        let workgroups = gpu.buffer("workgroups", 12)?;
        let bindings = [bindings::COUNTS, bindings::WORKGROUPS].map(|number| gpu::compute::Binding {
            group: bindings::BETWEEN,
            number,
            access: gpu::compute::Access::ReadWrite,
        });
        let layout = gpu.bind_group_layout("advance", &bindings, bindings::BETWEEN);
        let shader = gpu.shader("advance", &crate::program::wgsl::compose::advance());
        let size = f64::from(program.options.workgroup_size);
        let advance = gpu.pipeline("advance", &shader, &[&layout], &[("workgroup_size", size)]);
        let advancing = gpu.bind_group(
            "advance",
            &layout,
            [(bindings::COUNTS, counts), (bindings::WORKGROUPS, &workgroups)],
            &[],
        );
        Ok(Rounds { advance, advancing, trace_queued, workgroups })
    }
}

/// What a scene's shaders bind must be what the adapter can bind at once: more of the sums, more parts.
fn check_bindings(gpu: &Gpu, program: &Program, bindings: &[gpu::compute::Binding]) -> Result<()> {
    let most = gpu.device.limits().max_storage_buffers_per_shader_stage as usize;
    let is_storage = |binding: &&gpu::compute::Binding| match binding.access {
        gpu::compute::Access::Uniform | gpu::compute::Access::Texels => false,
        gpu::compute::Access::Read | gpu::compute::Access::ReadWrite => true,
    };
    let storage = bindings.iter().filter(is_storage).count();
    if storage <= most {
        return Ok(());
    }
    let parts: Vec<u64> = program.sums.all().flat_map(|buffer| buffer.part_bytes()).collect();
    let advice = match program.options.moments {
        SecondMoments::None => "fewer pixels",
        SecondMoments::Squares | SecondMoments::Replicates => "fewer pixels, --standard-error off",
    };
    Err(Error::Device(format!(
        "the scene needs {storage} storage buffers, {} of them for {} bytes of sums, and the adapter `{}` binds at most \
         {most}, each of at most {} bytes; use {advice} or another adapter",
        parts.len(),
        parts.iter().sum::<u64>(),
        gpu.info.name,
        gpu.largest_binding(),
    )))
}

/// Bytes from one struct of that name to the next in an array of the program's.
pub(crate) fn stride_of(program: &Program, name: &str) -> Result<u64> {
    Ok(crate::program::layout::records::StructLayout::of(&program.module, name)?.stride as u64)
}
