//! The stages of a program, compiled for a device. They depend on the program's text alone, not on the contents of its
//! buffers: programs of the same text share them ([`crate::engine::pipeline_cache`]).
//!
//! A stage here is an entry point, which is dispatched, and timed by a name: `trace_new`, `advance`, `trace_queued`, or
//! one of an addition. Comments of shaders/stages also call the steps within an entry point stages, such as generate
//! and interact.

use crate::error::{Error, Result};
use crate::gpu::{self, Gpu};
use crate::program::layout::bindings;
use crate::program::{Program, SecondMoments};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

/// The bindings and stages that additions have on a device beside the engine's own.
#[derive(Debug, Clone)]
pub(crate) struct ExtraBindings {
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

impl Default for ExtraBindings {
    fn default() -> Self {
        ExtraBindings { groups: vec![Vec::new()], stages: Vec::new() }
    }
}

impl ExtraBindings {
    /// Some bindings in the one group.
    pub(crate) fn of(bindings: impl IntoIterator<Item = (u32, wgpu::Buffer)>) -> Self {
        ExtraBindings { groups: vec![bindings.into_iter().collect()], stages: Vec::new() }
    }

    /// Together with the bindings of another addition: each group of one has the bindings of each group of the other.
    pub(crate) fn with(self, other: ExtraBindings) -> Self {
        let both = |one: &Vec<(u32, wgpu::Buffer)>| {
            let one = one.clone();
            other.groups.iter().map(move |two| [one.clone(), two.clone()].concat())
        };
        ExtraBindings {
            groups: self.groups.iter().flat_map(both).collect(),
            stages: [self.stages, other.stages].concat(),
        }
    }
}

/// A stage that follows rays from their birth.
pub(crate) struct FirstStage {
    pub(super) name: &'static str,
    pub(super) pipeline: wgpu::ComputePipeline,
    /// True if the stage was dispatched before.
    has_begun: AtomicBool,
}

impl FirstStage {
    fn new(name: &'static str, pipeline: wgpu::ComputePipeline) -> Self {
        FirstStage { name, pipeline, has_begun: AtomicBool::new(false) }
    }

    /// True if the stage was dispatched before.
    pub(super) fn has_begun(&self) -> bool {
        self.has_begun.load(Ordering::Relaxed)
    }

    /// Notes a dispatch. True if it is the first.
    pub(super) fn begin(&self) -> bool {
        !self.has_begun.swap(true, Ordering::Relaxed)
    }
}

/// The compiled stages of a program.
pub(crate) struct Stages {
    /// Follows new rays.
    trace_new: FirstStage,
    /// Stages that an addition has brought, which follow new rays in place of `trace_new`.
    added: Vec<(AddedStage, OnceLock<FirstStage>)>,
    pub(super) compiler: Compiler,
    /// The stages for rays that outlive a dispatch, where there can be such rays.
    pub(super) rounds: Option<RoundStages>,
}

/// The stages that follow the rays in a queue, again and again.
pub(super) struct RoundStages {
    pub(super) advance: wgpu::ComputePipeline,
    /// The layout of the group of `advance`.
    pub(super) advancing: wgpu::BindGroupLayout,
    pub(super) trace_queued: wgpu::ComputePipeline,
}

/// What it takes to compile a stage.
pub(super) struct Compiler {
    gpu: Gpu,
    pub(super) bindings: Vec<gpu::compute::Binding>,
    /// The layouts of the groups, in their order.
    pub(super) layouts: [wgpu::BindGroupLayout; 2],
    /// The module of all stages; `None` if each stage has a module of its own.
    shader: Option<wgpu::ShaderModule>,
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

impl Stages {
    /// Compiles a program's own stages, and those that additions bring at once.
    pub(crate) fn new(gpu: &Gpu, program: &Program, strict: bool, extra: &ExtraBindings) -> Result<Self> {
        let compiler = Compiler::new(gpu, program, strict)?;
        let has_queue = program.options.has_queue();
        let pipeline = |entry_point| compiler.pipeline(program, entry_point);
        // Compiling one takes lavapipe a tenth of a second and more.
        let added_at_once: Vec<&AddedStage> = extra.stages.iter().filter(|stage| stage.at_once).collect();
        let others = || -> Result<_> {
            let added = added_at_once.iter().map(|stage| pipeline(&stage.entry_point));
            let added = added.collect::<Result<Vec<_>>>()?;
            let rounds = || pipeline("trace_queued").map(|stage| RoundStages::new(gpu, program, stage));
            Ok((added, has_queue.then(rounds).transpose()?))
        };
        let has_others = !added_at_once.is_empty() || has_queue;
        let (trace_new, others) =
            side_by_side(|| pipeline(program.entry_point), has_others.then_some(others))?;
        let trace_new = FirstStage::new("trace_new", trace_new?);
        let (added_at_once, rounds) = others.transpose()?.unwrap_or_default();
        let added = added_stages(&extra.stages, added_at_once);
        Ok(Stages { trace_new, added, compiler, rounds })
    }

    /// The stage that follows rays from their birth: the plain one, or one that an addition has brought. An added stage is
    /// compiled now if it was not before.
    pub(super) fn first(&self, program: &Program, added: Option<usize>) -> Result<&FirstStage> {
        let Some((stage, compiled)) = added.and_then(|number| self.added.get(number)) else {
            return Ok(&self.trace_new);
        };
        if let Some(compiled) = compiled.get() {
            return Ok(compiled);
        }
        let pipeline = self.compiler.pipeline(program, &stage.entry_point)?;
        Ok(compiled.get_or_init(|| FirstStage::new(stage.name, pipeline)))
    }
}

impl RoundStages {
    fn new(gpu: &Gpu, program: &Program, trace_queued: wgpu::ComputePipeline) -> Self {
        let bindings = [bindings::COUNTS, bindings::WORKGROUPS].map(|number| gpu::compute::Binding {
            group: bindings::BETWEEN,
            number,
            access: gpu::compute::Access::ReadWrite,
        });
        let advancing = gpu.bind_group_layout("advance", &bindings, bindings::BETWEEN);
        let shader = gpu.shader("advance", &crate::program::wgsl::compose::advance());
        let size = f64::from(program.options.workgroup_size);
        let advance = gpu.pipeline("advance", &shader, &[&advancing], &[("workgroup_size", size)]);
        RoundStages { advance, advancing, trace_queued }
    }
}

/// The stages that additions bring, with the compiled pipelines of those compiled at once.
fn added_stages(
    stages: &[AddedStage],
    compiled: Vec<wgpu::ComputePipeline>,
) -> Vec<(AddedStage, OnceLock<FirstStage>)> {
    let mut compiled = compiled.into_iter();
    let with_pipeline = |stage: &AddedStage| {
        let pipeline = if stage.at_once { compiled.next() } else { None };
        let first = pipeline.map(|pipeline| FirstStage::new(stage.name, pipeline));
        (stage.clone(), first.map_or_else(OnceLock::new, OnceLock::from))
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
