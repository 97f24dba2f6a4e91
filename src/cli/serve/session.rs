//! What a session keeps from one request to the next: the device, and compiled shaders.

use crate::cli::console::named;
use crate::cli::progress::Status;
use crate::cli::serve::requests::TraceRequest;
use crate::error::{Error, Result};
use crate::gpu::{AdapterChoice, Gpu};
use crate::model::SceneIr;
use crate::result::{RunInfo, StoppedBy, TraceResult};
use crate::run::gradients::{Differentiated, How, LossGradient, LossWithEdges};
use crate::run::stopping::Stopping;
use crate::run::{Progress, RecordPaths, Shelf, Strict, TraceOptions, Tracer, precision};
use crate::scene::Scene;
use ndarray::ArrayD;
use std::time::Instant;

/// Most rays of a trace whose numbers are live. In a longer one the rays take longer than compiling, and a shader with
/// the numbers compiled in traces them faster.
const MOST_LIVE_RAYS: u64 = 1_000_000;

/// How a trace goes on after a pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Next {
    /// To its last ray.
    GoOn,
    /// It ends, and the rays that were traced are a partial result.
    Stop,
    /// It ends, and there is no result.
    Cancel,
}

/// The gradient of a loss, and what light does that crosses edges.
pub(crate) struct LossFound {
    pub(crate) gradient: LossGradient,
    /// By differences of two traces, parameter by parameter, where that was asked for.
    pub(crate) with_edges: Vec<LossWithEdges>,
    /// Parameters whose derivatives a short difference of two traces does not confirm, where that was asked for.
    pub(crate) not_confirmed: Vec<(usize, LossWithEdges)>,
}

/// The device of a session, and its compiled shaders.
pub(crate) struct Session {
    choice: AdapterChoice,
    opened: Option<Opened>,
}

struct Opened {
    gpu: Gpu,
    shelf: Shelf,
}

impl Session {
    /// A session on this adapter, which is opened when it is first needed.
    pub(crate) fn new(choice: AdapterChoice) -> Self {
        Session { choice, opened: None }
    }

    /// Opens the device, unless it is open.
    pub(crate) fn open(&mut self) -> Result<&Gpu> {
        if self.opened.is_none() {
            self.opened = Some(Opened { gpu: Gpu::open(&self.choice)?, shelf: Shelf::new() });
        }
        self.opened.as_ref().map(|opened| &opened.gpu).ok_or_else(|| Error::Internal("no device".into()))
    }

    /// Closes the device, which may be lost. The next request opens another.
    pub(crate) fn close(&mut self) {
        self.opened = None;
    }

    /// The number of compiled shaders that are kept, and the bytes of their texts.
    pub(crate) fn shaders(&self) -> [usize; 2] {
        self.opened.as_ref().map_or([0, 0], |opened| [opened.shelf.len(), opened.shelf.num_bytes()])
    }

    /// Traces. `next` gets the status after each pass, and says how to go on.
    pub(crate) fn trace(
        &mut self,
        request: &TraceRequest,
        next: impl FnMut(&Status) -> Next,
    ) -> Result<TraceResult> {
        self.job(request, |job| match request.gradient.is_empty() {
            true => job.trace(next),
            false => job.differentiate(next),
        })
    }

    /// Differentiates the loss that a request has adjoints of.
    pub(crate) fn loss_gradient(
        &mut self,
        request: &TraceRequest,
        adjoints: &[(String, ArrayD<f64>)],
        keep_going: impl FnMut(&Status) -> bool,
    ) -> Result<LossFound> {
        self.job(request, |job| job.differentiate_loss(adjoints, keep_going))
    }

    fn job<T>(&mut self, request: &TraceRequest, act: impl FnOnce(Job) -> Result<T>) -> Result<T> {
        let start = Instant::now();
        let scene =
            Scene::with_numbers(&request.scene, &request.folder, &request.set).map_err(
                |error| match &request.name {
                    Some(name) => named(error, name),
                    None => error,
                },
            )?;
        let mut ir = scene.lower()?;
        request.args.override_sampling(&mut ir)?;
        self.open()?;
        let Some(Opened { gpu, shelf }) = &self.opened else {
            return Err(Error::Internal("no device".into()));
        };
        act(Job { request, scene: &scene, ir: &ir, gpu, shelf, start })
    }
}

/// One trace.
struct Job<'a> {
    request: &'a TraceRequest,
    scene: &'a Scene,
    ir: &'a SceneIr,
    gpu: &'a Gpu,
    shelf: &'a Shelf,
    start: Instant,
}

impl<'a> Job<'a> {
    fn trace(&self, mut next: impl FnMut(&Status) -> Next) -> Result<TraceResult> {
        let Job { request, ir, gpu, start, .. } = self;
        let args = &request.args;
        let options = self.options()?;
        let pilot = |ir: &SceneIr, options: &TraceOptions| self.tracer(ir, options)?.trace(|_| true);
        let choice = precision::choose_by(gpu, ir, &options, args.wanted(), pilot)?;
        let options = TraceOptions { precision: choice.precision, ..options };
        let mut tracer = self.tracer(ir, &options)?;
        let begun = tracer.empty_tally();
        let mut stopping = Stopping::new(ir, args.target_error, args.time_limit);
        stopping.prepare(&mut tracer, &begun)?;
        let mut stopped_by = None;
        let trace_start = Instant::now();
        let tally = tracer.go_on_checked(begun, |progress: &mut Progress| {
            stopped_by = stopping.after_pass(ir, progress)?;
            match next(&Status::of(progress, &stopping, args, 0)) {
                Next::GoOn => {}
                Next::Stop => stopped_by = Some(StoppedBy::Interrupt),
                Next::Cancel => return Err(Error::Interrupted),
            }
            Ok(stopped_by.is_none())
        })?;
        let partial = tally.launched.count < tracer.num_rays();
        let run = RunInfo {
            num_rays: tracer.num_rays(),
            precision_reason: choice.reason,
            precision_warning: choice.warning,
            trace_time_sec: trace_start.elapsed().as_secs_f64(),
            first_rays_sec: tracer.first_end().map(|end| (end - *start).as_secs_f64()),
            scene_warnings: self.scene.warnings_in(options.precision),
            partial,
            stopped_by: stopped_by.filter(|_| partial),
            target_error: args.target_error,
            has_no_gpu: gpu.info.class.stands_in_for_gpu(),
            ..options.run_info(&gpu.info)
        };
        TraceResult::new(ir, &run, &tally)
    }

    /// The scene, and the parameters by which it is differentiated.
    fn differentiated(&self) -> Result<Differentiated> {
        let request = self.request;
        let named_error = |error| match &request.name {
            Some(name) => named(error, name),
            None => error,
        };
        let change = |ir: &mut SceneIr| request.args.override_sampling(ir);
        Differentiated::new(&request.scene, &request.folder, &request.set, &request.gradient, change)
            .map_err(named_error)
    }

    /// The gradient of a loss.
    fn differentiate_loss(
        &self,
        adjoints: &[(String, ArrayD<f64>)],
        mut keep_going: impl FnMut(&Status) -> bool,
    ) -> Result<LossFound> {
        let Job { request, gpu, .. } = self;
        if request.gradient.is_empty() {
            return Err(Error::Usage(
                "a loss has adjoints and no parameters; name some in `gradient`".into(),
            ));
        }
        self.refuse_options_of_one_trace("adjoints")?;
        let scene = self.differentiated()?;
        let mut of_all: Vec<Vec<f64>> = scene.adjoint_lengths().map(|num| vec![0.0; num]).collect();
        for (name, adjoints) in adjoints {
            let known = scene.ir.detectors.iter().position(|detector| detector.name == *name);
            let known = known
                .ok_or_else(|| Error::Usage(format!("adjoints of `{name}`: no detector has this name")))?;
            of_all[known] = scene.adjoints_of(known, adjoints)?;
        }
        let (options, _) = Job { ir: &scene.ir, ..*self }.live_options()?;
        let start = Instant::now();
        let shelf = Some(self.shelf);
        let with_edges = request.gradient_edges;
        let how = How { shelf, with_edges, ..How::default() };
        let num_rays = options.num_rays * (1 + self.passes_of_edges());
        let mut keep_going = |rays: u64| keep_going(&Status::of_rays(rays, num_rays, start.elapsed()));
        let gradient = scene.loss_gradient(gpu, &options, how, &of_all, &mut keep_going)?;
        let (mut edges, mut not_confirmed) = (Vec::new(), Vec::new());
        if with_edges {
            let keep_going = |rays| keep_going(options.num_rays + rays);
            edges = scene.loss_with_edges(gpu, &options, shelf, &of_all, keep_going)?;
        } else if request.check_edges {
            let keep_going = |_| keep_going(options.num_rays);
            not_confirmed = scene.not_confirmed(gpu, &options, shelf, &of_all, &gradient, keep_going)?;
        }
        Ok(LossFound { gradient, with_edges: edges, not_confirmed })
    }

    /// How often all rays are traced for what crosses edges.
    fn passes_of_edges(&self) -> u64 {
        if self.request.gradient_edges { 2 * self.request.gradient.len() as u64 } else { 0 }
    }

    /// Refuses options that derivatives cannot heed. `what` the request has beside them.
    fn refuse_options_of_one_trace(&self, what: &str) -> Result<()> {
        let records = (self.request.record_paths != RecordPaths::None).then_some("record-paths");
        match self.request.args.of_one_trace().or(records) {
            Some(name) => Err(Error::Usage(format!(
                "options.{} and {what} do not go together; give one of them up",
                name.replace('-', "_")
            ))),
            None => Ok(()),
        }
    }

    /// Traces with derivatives.
    fn differentiate(&self, mut next: impl FnMut(&Status) -> Next) -> Result<TraceResult> {
        let Job { request, gpu, .. } = self;
        self.refuse_options_of_one_trace("gradient")?;
        let scene = self.differentiated()?;
        let (options, choice) = Job { ir: &scene.ir, ..*self }.live_options()?;
        let start = Instant::now();
        let (shelf, with_edges) = (Some(self.shelf), request.gradient_edges);
        let how = How { shelf, without_errors: !request.gradient_errors, with_edges, ..How::default() };
        let num_rays = (scene.num_passes() + self.passes_of_edges()) * options.num_rays;
        let (mut last, mut is_first) = (Next::GoOn, true);
        let mut keep_going = |rays| {
            last = next(&Status::of_rays(rays, num_rays, start.elapsed()));
            // A stop while shaders are compiled still has rays to keep.
            last == Next::GoOn || last == Next::Stop && std::mem::take(&mut is_first)
        };
        let (mut gradients, tally) = scene.gradients(gpu, &options, how, &mut keep_going)?;
        let has_all = gradients.len() == request.gradient.len() * scene.ir.detectors.len();
        let mut is_whole = has_all && tally.launched.count == options.num_rays;
        if with_edges && is_whole {
            let done = scene.num_passes() * options.num_rays;
            let keep_going = |rays| keep_going(done + rays);
            match scene.add_edges(gpu, &options, shelf, &mut gradients, keep_going) {
                Err(Error::Interrupted) => is_whole = false,
                added => added?,
            }
        }
        if !is_whole && last == Next::Cancel {
            return Err(Error::Interrupted);
        }
        let run = RunInfo {
            partial: !is_whole,
            stopped_by: (!is_whole).then_some(StoppedBy::Interrupt),
            precision_reason: choice.reason,
            precision_warning: choice.warning,
            trace_time_sec: start.elapsed().as_secs_f64(),
            scene_warnings: self.scene.warnings_in(options.precision),
            has_no_gpu: gpu.info.class.stands_in_for_gpu(),
            ..options.run_info(&gpu.info)
        };
        Ok(TraceResult { gradients, ..TraceResult::new(&scene.ir, &run, &tally)? })
    }

    /// Options of a trace with derivatives, whose numbers are live, and why it has its precision.
    fn live_options(&self) -> Result<(TraceOptions, precision::Choice)> {
        let options = self.options()?;
        let pilot = |ir: &SceneIr, options: &TraceOptions| self.tracer(ir, options)?.trace(|_| true);
        let choice = precision::choose_by(self.gpu, self.ir, &options, self.request.args.wanted(), pilot)?;
        Ok((TraceOptions { precision: choice.precision, live: true, ..options }, choice))
    }

    fn options(&self) -> Result<TraceOptions> {
        let Job { request, ir, gpu, .. } = self;
        let args = &request.args;
        let options = args.options(ir)?;
        let strict = match options.strict {
            // Only with strict arithmetic a shader with live numbers gives the bits of the command's.
            Strict::Auto if gpu.info.strict => Strict::On,
            asked => asked,
        };
        Ok(TraceOptions {
            max_depth: args.max_depth.unwrap_or_else(|| crate::model::depth::of_scene(ir)),
            strict,
            live: request.live.unwrap_or(options.num_rays <= MOST_LIVE_RAYS),
            paths: request.record_paths,
            ..options
        }
        .tuned(&gpu.info))
    }

    /// A tracer of a scene: with shaders of the shelf where numbers are live.
    fn tracer<'s>(&'s self, ir: &'s SceneIr, options: &TraceOptions) -> Result<Tracer<'s>> {
        match options.live {
            true => Tracer::on_shelf(self.gpu, ir, options, self.shelf),
            false => Tracer::new(self.gpu, ir, options),
        }
    }
}
