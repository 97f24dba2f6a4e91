//! A program on a device: its pipelines, its buffers, and the groups that bind them.

use crate::engine::intake::Intake;
use crate::engine::sums::DeviceSums;
use crate::error::{Error, Result};
use crate::gpu::{self, Gpu};
use crate::program::layout::bindings;
use crate::program::{self, Program, SecondMoments};
use std::cell::{Cell, OnceCell};

/// A device, with the pipelines and buffers of a program's traces.
pub(crate) struct DeviceState {
    pub(crate) gpu: Gpu,
    /// The memory that the program's buffers take \[bytes\].
    pub(crate) bytes: u64,
    /// Follows new rays.
    trace_new: FirstStage,
    /// Stages that a strategy has added, which follow new rays in place of `trace_new`.
    added: Vec<(AddedStage, OnceCell<FirstStage>)>,
    compiler: Compiler,
    /// The stages for rays that outlive a dispatch, where there can be such rays.
    pub(super) rounds: Option<Rounds>,
    /// Group 0, once for each list of buffers that a strategy adds.
    pub(super) scenes: Vec<wgpu::BindGroup>,
    /// Group 1, with the queues in either direction. Rays that survive a new range go to the first queue.
    pub(super) queues: [wgpu::BindGroup; 2],
    pub(super) range: wgpu::Buffer,
    pub(super) source: wgpu::Buffer,
    pub(super) counts: wgpu::Buffer,
    pub(super) rng_table: wgpu::Buffer,
    pub(super) sums: DeviceSums,
    pub(super) tops: Option<DeviceSums>,
    pub(super) counters: DeviceSums,
    /// Rows for the host, where the scene or the user asks for them.
    pub(super) events: Option<wgpu::Buffer>,
}

/// What a strategy adds to a device.
#[derive(Debug)]
pub(crate) struct Additions {
    /// Bindings of group 0 beside the program's. There is one group for each list; the plain list is empty.
    pub(crate) groups: Vec<Vec<(u32, wgpu::Buffer)>>,
    /// Entry points that the engine does not know.
    pub(crate) stages: Vec<AddedStage>,
}

/// An entry point that follows rays from their birth to their end, in place of the plain stages.
#[derive(Debug, Clone)]
pub(crate) struct AddedStage {
    /// The name where stages are timed.
    pub(crate) name: &'static str,
    pub(crate) entry_point: String,
    /// True: compiled together with the plain stages. False: compiled when it is first needed.
    pub(crate) at_once: bool,
}

impl Default for Additions {
    fn default() -> Self {
        Additions { groups: vec![Vec::new()], stages: Vec::new() }
    }
}

/// A stage that follows rays from their birth.
pub(super) struct FirstStage {
    pub(super) name: &'static str,
    pub(super) pipeline: wgpu::ComputePipeline,
    /// True if the stage was dispatched before.
    pub(super) has_begun: Cell<bool>,
}

/// What it takes to compile a stage.
struct Compiler {
    gpu: Gpu,
    bindings: Vec<gpu::compute::Binding>,
    /// The layouts of the groups, in their order.
    layouts: [wgpu::BindGroupLayout; 2],
    /// The module of all stages; `None` if each stage has a module of its own.
    shader: Option<wgpu::ShaderModule>,
}

/// The stages that follow the rays in a queue, again and again.
pub(super) struct Rounds {
    pub(super) advance: wgpu::ComputePipeline,
    pub(super) advancing: wgpu::BindGroup,
    pub(super) trace_queued: wgpu::ComputePipeline,
    /// The number of workgroups for the rays in the queue.
    pub(super) workgroups: wgpu::Buffer,
}

impl FirstStage {
    fn new(name: &'static str, pipeline: wgpu::ComputePipeline) -> Self {
        FirstStage { name, pipeline, has_begun: Cell::new(false) }
    }
}

impl Compiler {
    fn new(gpu: &Gpu, program: &Program, strict: bool) -> Result<Self> {
        let bindings = gpu::compute::bindings_of(&program.module);
        check_bindings(gpu, program, &bindings)?;
        let layouts = [("scene", bindings::SCENE), ("queues", bindings::QUEUES)];
        let layouts = layouts.map(|(label, group)| gpu.bind_group_layout(label, &bindings, group));
        let shader = (!strict).then(|| gpu.shader("trace", program.device_wgsl()));
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
        additions: &Additions,
    ) -> Result<Self> {
        let compiler = Compiler::new(gpu, program, strict)?;
        let [scene_layout, queue_layout] = &compiler.layouts;
        let has_queue = program.options.has_queue();
        let pipeline = |entry_point| compiler.pipeline(program, entry_point);
        let counts = gpu.buffer("queue counts", 16)?;
        // Compiling one takes lavapipe a tenth of a second and more.
        let added_at_once: Vec<&AddedStage> = additions.stages.iter().filter(|stage| stage.at_once).collect();
        let others = || -> Result<_> {
            let added = added_at_once.iter().map(|stage| pipeline(&stage.entry_point));
            let added = added.collect::<Result<Vec<_>>>()?;
            let rounds = || Rounds::new(gpu, program, &counts, pipeline("trace_queued")?);
            Ok((added, has_queue.then(rounds).transpose()?))
        };
        let has_others = !added_at_once.is_empty() || has_queue;
        let (trace_new, others) =
            side_by_side(|| pipeline(program.entry_point()), has_others.then_some(others))?;
        let trace_new = FirstStage::new("trace_new", trace_new?);
        let (added_at_once, rounds) = others.transpose()?.unwrap_or_default();
        let added = added_stages(&additions.stages, added_at_once);

        let sums = DeviceSums::new(gpu, &program.sums.sums)?;
        let tops = program.sums.tops.as_ref().map(|tops| DeviceSums::new(gpu, tops)).transpose()?;
        let counters = DeviceSums::new(gpu, &program.sums.counters)?;
        let range = gpu.constant_buffer("range", &vec![0; stride_of(program, "Range")? as usize]);
        let source =
            gpu.constant_buffer("source", program.source_uniforms.first().map_or(&[], Vec::as_slice));
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
        scene.extend(constants.iter().map(|(number, buffer)| (*number, buffer)));
        let group = |added: &Vec<(u32, wgpu::Buffer)>| {
            let added = added.iter().map(|(number, buffer)| (*number, buffer));
            gpu.bind_group("scene", scene_layout, scene.iter().copied().chain(added), &images)
        };
        let scenes = additions.groups.iter().map(group).collect();

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
        Ok(DeviceState {
            gpu: gpu.clone(),
            bytes: program.device_bytes() + 2 * queue_bytes,
            trace_new,
            added,
            compiler,
            rounds,
            scenes,
            queues,
            range,
            source,
            counts,
            rng_table,
            sums,
            tops,
            counters,
            events,
        })
    }

    /// The stage that follows rays from their birth: the plain one, or one that a strategy has added. An added stage is
    /// compiled now if it was not before.
    pub(super) fn first_stage(&self, program: &Program, added: Option<usize>) -> Result<&FirstStage> {
        let Some((stage, compiled)) = added.and_then(|number| self.added.get(number)) else {
            return Ok(&self.trace_new);
        };
        if let Some(compiled) = compiled.get() {
            return Ok(compiled);
        }
        let pipeline = self.compiler.pipeline(program, &stage.entry_point)?;
        Ok(compiled.get_or_init(|| FirstStage::new(stage.name, pipeline)))
    }

    /// True if the host receives rows.
    pub(crate) fn keeps_rows(&self) -> bool {
        self.events.is_some()
    }

    /// Replaces the table of draws.
    pub(crate) fn set_draws(&self, rng_table: &[u8]) {
        self.gpu.queue.write_buffer(&self.rng_table, 0, rng_table);
    }

    /// Passes the sums to `intake`, and clears them.
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

/// The stages that a strategy adds, with the compiled pipelines of those compiled at once.
fn added_stages(
    stages: &[AddedStage],
    compiled: Vec<wgpu::ComputePipeline>,
) -> Vec<(AddedStage, OnceCell<FirstStage>)> {
    let mut compiled = compiled.into_iter();
    let with_pipeline = |stage: &AddedStage| {
        let pipeline = if stage.at_once { compiled.next() } else { None };
        let first = pipeline.map(|pipeline| FirstStage::new(stage.name, pipeline));
        (stage.clone(), first.map_or_else(OnceCell::new, OnceCell::from))
    };
    stages.iter().map(with_pipeline).collect()
}

/// Runs two functions, the second (if any) in a thread of its own, and returns both results.
fn side_by_side<A, B: Send>(
    first: impl FnOnce() -> A,
    second: Option<impl FnOnce() -> B + Send>,
) -> Result<(A, Option<B>)> {
    /// As large as the stack of a main thread, because compilers recurse.
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

/// Fails if a scene's shaders bind more storage buffers than the adapter allows. More sums mean more parts.
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

/// The stride of an array of the program's struct with this name \[bytes\].
pub(crate) fn stride_of(program: &Program, name: &str) -> Result<u64> {
    Ok(crate::program::layout::records::StructLayout::of(&program.module, name)?.stride as u64)
}
