//! A trace is a fold: `Tally += pass(range of ray ids)`.
//!
//! A pass runs a range of rays on the device, where sums are integers and draws are keyed by the ray's id; so
//! the sum over passes does not depend on how the rays were cut into ranges. Progress, interruption, limits, targets and
//! checkpoints are callers of the fold: after each pass they may ask for all that was summed up so far ([`Progress`]).
//!
//! Sources take turns: each pass takes the same share of every source's rays, so that what is done at any moment is a
//! fair sample of the scene.

use crate::engine::budget::{EmitterRays, distribute, part};
use crate::engine::device::{DeviceState, Stage, stride_of};
use crate::engine::dispatch_size::DispatchSize;
use crate::engine::intake::{Counted, Intake};
use crate::engine::options::check_options;
use crate::engine::pace::Pace;
use crate::error::{Error, Result};
use crate::gpu::profile::Profile;
use crate::gpu::{Gpu, processors};
use crate::model::{SceneIr, Sensor, Splat, ray_id};
use crate::program::layout::tables::ReachedMarks;
use crate::program::{
    self, Features, Precision, Program, ProgramOptions, RayRange, Sampler, SecondMoments, Splitting, df64,
    events,
};
use crate::result::{
    Booking, PathEvent, PathEventKind, QUANTA_PER_WEIGHT, RayRow, RaySet, RaySpan, Recorded, Recording,
    SensorTally, StageTime, SurfaceTally, Tally, check_shape,
};
use crate::software::logs::{EndLogs, Rays};
use crate::software::path::pilot;
use std::collections::HashSet;
use std::time::{Duration, Instant};

pub mod auto_precision;
pub mod checkpoint;
pub mod stopping;

pub use crate::engine::options::{RecordPaths, StandardError, Strict, TraceOptions};

/// Rays in one dispatch of a trace with no limit of its own.
pub(crate) const DEFAULT_BATCH: u32 = 1 << 18;
/// Where they log their ends: the log stays in a processor's caches, and dispatches are long against what each costs.
const DEFAULT_LOGGED_BATCH: u32 = 1 << 17;
/// Where they log places alone, or with weights, which are mostly few words a ray.
const DEFAULT_PLACES_BATCH: u32 = 1 << 18;
/// Families seldom have more rays than this, whatever they are allowed: batches are the smaller by no more.
const MANY_RAYS: u64 = 8;
/// Workgroups of a dispatch that keep a processor busy until its end.
const WORKGROUPS_PER_PROCESSOR: u32 = 4;
/// Rows for the host in one pass.
const MAX_EVENTS: u32 = 1 << 18;
/// A pass should keep the device for about so long: a desktop stays usable and no watchdog fires.
const PASS_TIME: Duration = Duration::from_millis(40);
/// A second device saves a tenth of the time and more, and takes a fifth of a second to open: it pays where so much is left.
const SECOND_DEVICE_PAYS_SEC: f64 = 2.0;
/// It needs as much memory as the first, which may be so much \[bytes\].
const SECOND_DEVICE_BYTES: u64 = 64 << 20;
/// Counters are 32 bits wide: they are drained before they can overflow.
const MAX_COUNTS_UNDRAINED: u64 = 1 << 31;
const MAX_COUNTS_PER_PASS: u64 = MAX_COUNTS_UNDRAINED / 4;

/// A scene ready to trace on a device.
pub struct Tracer<'a> {
    gpu: &'a Gpu,
    ir: &'a SceneIr,
    options: TraceOptions,
    program: Program,
    rays: Vec<EmitterRays>,
    num_rays: u64,
    moments: MomentSource,
    /// Most rays of a dispatch: there is room for so many.
    batch: u32,
    /// Rays of a dispatch that follows no path known beforehand.
    size: DispatchSize,
    /// One, or two that take turns.
    devices: Vec<DeviceState>,
    end_logs: Option<EndLogs>,
    /// Passes since the sums were drained.
    num_passes: u64,
    /// Primitives that rays have reached since the sums were drained, a bit each.
    reached: u32,
    counts_undrained: u64,
    launched: Booking,
    launched_rays: RaySet,
    pause: Option<u64>,
    pass_time: Duration,
    /// A second device has not been opened, nor tried in vain.
    takes_second_device: bool,
    num_submissions: u64,
    /// Stages that a device has been given: the number of the device, and of the path unless the stage is trace_new.
    begun: HashSet<(usize, Option<usize>)>,
    /// A stage has begun since the pass did: drivers compile at that, and the time of the pass tells nothing of others.
    is_compiling: bool,
    /// When the first pass of all had ended, where each is waited for.
    first_end: Option<Instant>,
    events: Vec<DeviceEvent>,
    /// One for each emitter.
    recordings: Vec<Recording>,
    profile: Option<Profile>,
}

/// A row as the device wrote it; positions are relative to the scene's centre.
struct DeviceEvent {
    kind: u32,
    subject: u32,
    row: RayRow,
}

/// Where second moments come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum MomentSource {
    /// Nobody asked for them.
    Nowhere,
    /// Every ray weighs the same for life and ends in one cell: the hits say it all.
    Hits,
    /// The device sums them.
    Device,
    /// The device keeps a sum for each of several scrambles of Sobol's points.
    Replicates,
}

impl MomentSource {
    fn of(ir: &SceneIr, options: &TraceOptions, weights: &[f64], roulette_threshold: f64) -> Self {
        let keeps_weight = || Features::of(ir, weights, roulette_threshold, options.max_depth).keeps_weight;
        let is_cheap = !program::features::splits(ir)
            && ir.sensors.iter().all(crate::program::layout::tables::takes_rays_whole);
        let is_needed = hits_say_little(ir);
        match options.standard_error {
            StandardError::Off => MomentSource::Nowhere,
            asked if options.sampler == Sampler::Sobol => match asked {
                StandardError::On => MomentSource::Replicates,
                StandardError::Auto | StandardError::Off => MomentSource::Nowhere,
            },
            _ if crate::program::layout::tables::cells_hold_totals(ir) && keeps_weight() => {
                MomentSource::Hits
            }
            StandardError::Auto if !is_cheap && !is_needed => MomentSource::Nowhere,
            StandardError::Auto | StandardError::On => MomentSource::Device,
        }
    }
}

/// True where rays without weight hit detectors, as a table or a Harvey-Shack lobe leaves them, so that the number of hits says
/// nothing of the error; but where squares would be many or dear, nobody sums them unasked.
fn hits_say_little(ir: &SceneIr) -> bool {
    const MOST_CELLS: usize = 1 << 22;
    let is_near = |sensor: &Sensor| {
        sensor.absorb && sensor.kind.grid().is_none_or(|grid| !matches!(grid.splat, Splat::Gaussian { .. }))
    };
    crate::program::layout::bsdf::kinds(ir).into_iter().any(crate::program::layout::bsdf::BsdfKind::has_table)
        && !program::features::splits(ir)
        && ir.sensors.iter().all(is_near)
        && ir.sensors.iter().map(Sensor::num_cells).sum::<usize>() <= MOST_CELLS
}

impl<'a> Tracer<'a> {
    /// Prepares a scene: composes, compiles and packs.
    ///
    /// # Errors
    /// [`Error::Usage`] for options that make no sense or that the device cannot do, [`Error::Device`] if the scene does
    /// not fit it.
    pub fn new(gpu: &'a Gpu, ir: &'a SceneIr, options: &TraceOptions) -> Result<Self> {
        Self::with_wgsl_edit(gpu, ir, options, |wgsl| wgsl)
    }

    /// As [`Tracer::new`], with a change of the composed text: for tests that must notice a wrong shader.
    #[doc(hidden)]
    pub fn with_wgsl_edit(
        gpu: &'a Gpu,
        ir: &'a SceneIr,
        options: &TraceOptions,
        edit: impl FnOnce(String) -> String,
    ) -> Result<Self> {
        check_options(gpu, options)?;
        let rays = part(distribute(ir, options.budget())?, options)?;
        let primitives = ir.surfaces.len() + ir.sensors.len();
        let weights: Vec<f64> = rays.iter().map(|r| r.weight).collect();
        let roulette_threshold = options.min_flux_fraction.max(ir.sampling.rr_start_flux);
        let moments = MomentSource::of(ir, options, &weights, roulette_threshold);
        let events_per_dispatch = match moments {
            // A ray's crossings are known to the invocation that traces it alone.
            MomentSource::Device if ir.sensors.iter().any(|sensor| !sensor.absorb) => options.max_depth,
            _ => options.events_per_dispatch.min(options.max_depth),
        };
        let mut program_options = ProgramOptions {
            precision: options.precision,
            native: gpu.int64,
            host_sums: options.host_sums.unwrap_or(gpu.prefers_host_sums()),
            baked: options.baked.unwrap_or(primitives <= program::MAX_BAKED_PRIMITIVES),
            tree: options.tree.unwrap_or(true),
            uniform_bytes: gpu.uniform_table_bytes(),
            texel_bytes: options
                .texel_bytes
                .unwrap_or_else(|| gpu.texel_table_bytes(program::TEXELS_PER_LINE)),
            max_depth: options.max_depth,
            roulette_threshold,
            events_per_dispatch,
            workgroup_size: options.workgroup_size,
            most_rays_per_invocation: options
                .rays_per_invocation
                .unwrap_or_else(|| most_rays_per_invocation(gpu, options)),
            side_by_side: options.side_by_side.unwrap_or(gpu.info.is_cpu()),
            lanes: lanes_together(gpu, options),
            vector_lanes: gpu.vector_lanes(),
            paths: options.paths.sampling(options.budget()),
            weights,
            sampler: options.sampler,
            moments: match moments {
                MomentSource::Nowhere | MomentSource::Hits => SecondMoments::None,
                MomentSource::Device => SecondMoments::Squares,
                MomentSource::Replicates => SecondMoments::Replicates,
            },
            nominal: None,
            side_paths: Vec::new(),
            part_bytes: options.part_bytes.unwrap_or(gpu.largest_binding()),
        };
        if let Some(paths) = pilot::find(gpu, ir, options, &program_options)? {
            program_options.nominal = Some(paths.nominal);
            program_options.side_paths =
                if options.side_paths == Some(false) { Vec::new() } else { paths.sides };
        }
        let program = Program::with_wgsl_edit(ir, program_options, options.seed, edit)?;
        check_families(&program, options)?;
        let batch = batch_size(gpu, &program, options);
        let end_logs = match &program.end_log {
            Some(log) => {
                let path = program.path_log.clone();
                let mut logs = EndLogs::new(gpu, log.clone(), path, &program.cells, batch)?;
                let num_expected = (!options.may_end_early).then_some(options.num_rays);
                logs.follow_sides(&program.side_paths, num_expected, options.side_paths == Some(true));
                Some(logs)
            }
            None => None,
        };
        let strict = options.strict.holds(&gpu.info);
        let logs = end_logs.as_ref().map(|logs| &logs.devices()[0]);
        let device = DeviceState::new(gpu, &program, batch, strict, logs)?;
        let size = DispatchSize::new(batch, least_rays(gpu, &program), counts_per_ray(&program));
        Ok(Tracer {
            gpu,
            ir,
            options: options.clone(),
            program,
            moments,
            num_rays: rays.iter().map(|rays| rays.count).sum(),
            rays,
            batch,
            size,
            devices: vec![device],
            end_logs,
            reached: 0,
            counts_undrained: 0,
            num_passes: 0,
            launched: Booking::default(),
            launched_rays: RaySet::default(),
            pause: None,
            pass_time: PASS_TIME,
            takes_second_device: true,
            num_submissions: 0,
            begun: HashSet::new(),
            is_compiling: false,
            first_end: None,
            events: Vec::new(),
            recordings: Vec::new(),
            profile: None,
        })
    }

    /// The composed program.
    pub fn program(&self) -> &Program {
        &self.program
    }

    /// Devices that take turns.
    #[doc(hidden)]
    pub fn num_devices(&self) -> usize {
        self.devices.len()
    }

    /// Submissions of all traces.
    #[doc(hidden)]
    pub fn num_submissions(&self) -> u64 {
        self.num_submissions
    }

    /// How many rays of the last trace were to keep to the nominal path, and how many of them strayed; then the same of each
    /// side path.
    #[doc(hidden)]
    pub fn num_along_paths(&self) -> Vec<[u64; 2]> {
        let counts = |logs: &EndLogs| {
            std::iter::once(logs.num_followed_and_strayed()).chain(logs.num_along_sides()).collect()
        };
        self.end_logs.as_ref().map_or_else(Vec::new, counts)
    }

    /// Other draws from now on, with what was compiled for the ones before.
    pub fn set_seed(&mut self, seed: u64) {
        self.options.seed = seed;
        let table = self.program.set_seed(seed);
        self.devices.iter().for_each(|device| device.gpu.queue.write_buffer(&device.rng_table, 0, table));
    }

    /// Passes should take about so long from now on, but a dispatch at least, whose rays then take no longer, unless they are
    /// few. It never changes a result.
    pub fn set_pass_time(&mut self, time: Duration) {
        self.pass_time = time;
    }

    /// When the first rays of this tracer's first trace were traced; none before.
    pub fn first_end(&self) -> Option<Instant> {
        self.end_logs.as_ref().map_or(self.first_end, EndLogs::first_end)
    }

    /// Times the stages of what is traced from now on, on one device: side by side, stages of two would be told to take what
    /// they wait for each other. The sums stay the same bits; the trace becomes slower.
    ///
    /// # Errors
    /// [`Error::Usage`] if the adapter has no timestamps, or too few for so deep a trace.
    pub fn enable_profile(&mut self) -> Result<()> {
        self.profile = Some(Profile::new(self.gpu, 2 * self.num_rounds() as u64)?);
        self.devices.truncate(1);
        self.begun.retain(|(device, _)| *device == 0);
        self.end_logs.as_mut().into_iter().for_each(EndLogs::keep_first_device);
        Ok(())
    }

    /// Gives the rows of what is traced from now on to recordings, pass by pass, instead of the tally: so memory need not
    /// grow with the rays. Each source has its own, which gets them in the order of (ray id, event), because a source's ids
    /// ascend from pass to pass.
    pub fn record_to(&mut self, recording: impl Fn() -> Recording) {
        self.recordings = self.rays.iter().map(|_| recording()).collect();
    }

    /// What was recorded since [`Tracer::record_to`], sources in order; none without it.
    ///
    /// # Errors
    /// [`Error::File`] if a file cannot be read or written.
    pub fn take_recorded(&mut self) -> Result<Option<Recorded>> {
        let mut parts = std::mem::take(&mut self.recordings).into_iter();
        let Some(mut all) = parts.next() else { return Ok(None) };
        parts.try_for_each(|part| all.append(part.finish()))?;
        Ok(Some(all.finish()))
    }

    /// What the stages took on the device; nothing unless they were timed.
    pub fn stage_times(&self) -> Vec<StageTime> {
        let sums = self.profile.iter().flat_map(Profile::times);
        sums.map(|sum| StageTime {
            stage: sum.stage.into(),
            num_dispatches: sum.num_dispatches,
            time_sec: sum.seconds,
        })
        .collect()
    }

    /// Traces every ray, in passes of about 40 ms; after each one `keep_going` is told how many rays are
    /// done, and stops the trace by returning false.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn trace(&mut self, mut keep_going: impl FnMut(u64) -> bool) -> Result<Tally> {
        self.go_on(self.empty_tally(), |progress| Ok(keep_going(progress.done)))
    }

    /// Traces the rays that `begun` lacks, and gives the sum of all. After each pass `keep_going` is shown the progress,
    /// may take a snapshot of the sums, and stops the trace by returning false.
    ///
    /// # Errors
    /// [`Error::Usage`] if `begun` is not the beginning of this trace, [`Error::Device`] if the device fails, and
    /// whatever `keep_going` fails with.
    pub fn go_on(
        &mut self,
        begun: Tally,
        mut keep_going: impl FnMut(&mut Progress<'_, 'a>) -> Result<bool>,
    ) -> Result<Tally> {
        // What a trace before this one left that failed half-way.
        self.end_logs.as_mut().into_iter().for_each(EndLogs::discard);
        if self.counts_undrained > 0 {
            self.drain(&mut self.empty_tally())?;
        }
        let mut position = self.position_after(&begun)?;
        check_shape(self.ir, &begun)?;
        let mut tally = begun;
        let mut pass_rays = u64::from(self.rays_per_dispatch());
        let mut pace = Pace::default();
        let start = Instant::now();
        while position < self.num_rays {
            let mut end = self.num_rays.min(position + pass_rays);
            if let Some(pause) = self.pause.filter(|pause| *pause > position) {
                end = end.min(pause);
            }
            let pass_start = Instant::now();
            self.pass(position, end)?;
            let pass_time = pass_start.elapsed();
            if !std::mem::take(&mut self.is_compiling) {
                pace.note(end - position, pass_time);
                pass_rays = self.next_pass_rays(end - position, pass_time);
            }
            position = end;
            if self.counts_undrained
                > MAX_COUNTS_UNDRAINED.saturating_sub(pass_rays * counts_per_ray(&self.program))
            {
                self.drain(&mut tally)?;
            }
            let mut progress = Progress {
                done: self.done(position),
                num_rays: self.num_rays,
                elapsed: start.elapsed(),
                position,
                tracer: self,
                tally: &mut tally,
            };
            if !keep_going(&mut progress)? {
                break;
            }
            self.consider_second_device(&pace, self.num_rays - position)?;
        }
        self.drain(&mut tally)?;
        if self.rays.len() > 1 {
            tally.sort_rows(self.ir);
        }
        Ok(tally)
    }

    /// Opens a second device if that pays for so many rays as are left, or is asked for.
    fn consider_second_device(&mut self, pace: &Pace, rays_left: u64) -> Result<()> {
        let is_possible = self.takes_second_device
            && rays_left > 0
            && self.profile.is_none()
            && self.devices[0].events.is_none()
            && self.devices[0].bytes <= SECOND_DEVICE_BYTES;
        let pays = || {
            let seconds_left = pace.seconds_for(rays_left);
            self.gpu.prefers_two_devices() && seconds_left.is_some_and(|left| left >= SECOND_DEVICE_PAYS_SEC)
        };
        if is_possible && self.options.second_device.unwrap_or_else(pays) {
            self.takes_second_device = false;
            self.open_second_device()?;
        }
        Ok(())
    }

    /// Where none can be opened, the first goes on alone.
    fn open_second_device(&mut self) -> Result<()> {
        let Some(logs) = &mut self.end_logs else { return Ok(()) };
        let strict = self.options.strict.holds(&self.gpu.info);
        let opened = self.gpu.open_again().and_then(|gpu| {
            let own_logs = logs.logs_on(&gpu)?;
            let device = DeviceState::new(&gpu, &self.program, self.batch, strict, Some(&own_logs))?;
            Ok((device, own_logs))
        });
        if let Ok((device, own_logs)) = opened {
            logs.add_device(own_logs)?;
            self.devices.push(device);
        }
        Ok(())
    }

    /// Rays in all.
    pub fn num_rays(&self) -> u64 {
        self.num_rays
    }

    /// Ends a pass at a position, if it lies ahead: so that what is decided there does not depend on the batch size or on
    /// the speed of the device.
    pub fn pause_at(&mut self, position: u64) {
        self.pause = Some(position);
    }

    /// Rays that are done at a position.
    fn done(&self, position: u64) -> u64 {
        self.rays.iter().map(|rays| rays.done(position, self.num_rays)).sum()
    }

    /// Ids of the rays that are done at a position.
    fn rays_done(&self, position: u64) -> RaySet {
        let mut set = RaySet::default();
        for (emitter, rays) in (0..).zip(&self.rays) {
            set += RaySpan { first: rays.first, count: rays.done(position, self.num_rays), emitter };
        }
        set
    }

    /// Where a trace goes on that has come as far as `begun`.
    ///
    /// # Errors
    /// [`Error::Usage`] if `begun` is not the beginning of this trace.
    pub fn position_after(&self, begun: &Tally) -> Result<u64> {
        let (mut low, mut high) = (0, self.num_rays);
        while low < high {
            let middle = low + (high - low) / 2;
            if self.done(middle) < begun.launched.count { low = middle + 1 } else { high = middle }
        }
        if self.rays_done(low) == begun.rays {
            return Ok(low);
        }
        Err(Error::Usage("the rays that were traced before are not the first rays of this trace".into()))
    }

    /// So many rays that the next pass takes about as long as passes should.
    fn next_pass_rays(&self, rays: u64, elapsed: Duration) -> u64 {
        let ratio = self.pass_time.as_secs_f64() / elapsed.as_secs_f64().max(1e-6);
        let dispatch = u64::from(self.rays_per_dispatch());
        let wanted = (rays as f64 * ratio.min(4.0)) as u64;
        let most = MAX_COUNTS_PER_PASS / counts_per_ray(&self.program);
        // Rows for the host are fetched once a pass, and there is room for those of one dispatch.
        let limit = if self.devices[0].events.is_some() { dispatch } else { most.max(dispatch) };
        wanted.clamp(1, limit).next_multiple_of(dispatch).min(limit.max(dispatch))
    }

    /// Most rays of a range: those of the nominal path take so little time that they are always a batch.
    fn rays_per_dispatch(&self) -> u32 {
        let pays = |logs| self.program.nominal.is_some() && path_pays(&self.program, &self.options, logs);
        if self.end_logs.as_ref().is_some_and(pays) { self.batch } else { self.size.rays() }
    }

    /// Traces from position `first` to `end` into the device's sums.
    fn pass(&mut self, first: u64, end: u64) -> Result<()> {
        let start = Instant::now();
        let ranges = self.ranges(first, end);
        let num_ranges = ranges.len().max(1) as u32;
        for range in ranges {
            match &mut self.end_logs {
                Some(logs) if !path_pays(&self.program, &self.options, logs) => {
                    logs.strays().list(&range);
                }
                _ => self.dispatch(&range, Rays::OfRange)?,
            }
            // Enough for two, so that lists of many side paths do not grow long.
            self.follow_sides(range.emitter, 2 * self.batch as usize)?;
            self.retrace_strays(range.emitter, self.size.rays())?;
            self.launched += self.launch(&range);
            let (count, emitter) = (u64::from(range.count), range.emitter as u32);
            self.launched_rays += RaySpan { first: range.first, count, emitter };
            self.counts_undrained += u64::from(range.count) * counts_per_ray(&self.program);
            if self.devices[0].events.is_some() {
                self.fetch_events(&range)?;
            }
        }
        if self.end_logs.is_none() {
            self.gpu.wait()?;
            self.first_end.get_or_insert_with(Instant::now);
            if !self.is_compiling {
                let rays = ((end - first) / u64::from(num_ranges)) as u32;
                self.size.note(rays, start.elapsed() / num_ranges, self.pass_time);
            }
        }
        self.num_passes += 1;
        // Asking waits for the device, which logs keep busy from one pass to the next.
        if self.num_passes.is_power_of_two() {
            self.learn_reached()?;
            self.check_loops()?;
        }
        Ok(())
    }

    /// Ends what passes have left under way, so that the device never waits between them: logs that are not added up,
    /// rays that strayed and wait.
    fn settle(&mut self) -> Result<()> {
        self.finish_logs()?;
        while self.follow_last_sides()? {
            self.finish_logs()?;
        }
        for emitter in 0..self.rays.len() {
            self.retrace_strays(emitter, 1)?;
        }
        self.finish_logs()
    }

    fn finish_logs(&mut self) -> Result<()> {
        self.end_logs.as_mut().map_or(Ok(()), EndLogs::finish)
    }

    /// Traces rays of an emitter that have strayed from the nominal path along those side paths that the device follows whose
    /// turn it is, while so many wait for these; false if there were fewer.
    fn follow_sides(&mut self, emitter: usize, at_least: usize) -> Result<bool> {
        let mut were_enough = false;
        while let Some(logs) = &mut self.end_logs
            && let (device, _) = logs.turn()
            && let Some((side, ids)) =
                logs.strays().take_of_side(emitter, device, at_least, self.batch as usize)
        {
            were_enough = true;
            let range = self.listed(emitter, &ids);
            self.dispatch(&range, Rays::OfSide { side, ids })?;
        }
        Ok(were_enough)
    }

    /// The same of all emitters, however few wait, unless that does not pay.
    fn follow_last_sides(&mut self) -> Result<bool> {
        self.end_logs.as_mut().into_iter().for_each(|logs| logs.strays().give_up_few());
        let mut were_any = false;
        for device in 0..self.devices.len() {
            for emitter in 0..self.rays.len() {
                self.pass_turn_to(device)?;
                were_any |= self.follow_sides(emitter, 1)?;
            }
        }
        Ok(were_any)
    }

    /// The number of the device whose turn it is, and the one of its logs.
    fn turn(&self) -> (usize, usize) {
        self.end_logs.as_ref().map_or((0, 0), EndLogs::turn)
    }

    fn pass_turn_to(&mut self, device: usize) -> Result<()> {
        self.end_logs.as_mut().map_or(Ok(()), |logs| logs.pass_turn_to(device))
    }

    /// Traces the rays of an emitter that have strayed from the nominal path and follow no other, while so many wait. As long as
    /// these are few, the first device does: so it alone compiles the stage.
    fn retrace_strays(&mut self, emitter: usize, at_least: u32) -> Result<()> {
        while let Some(logs) = &mut self.end_logs
            && logs.strays().num(emitter) >= at_least as usize
        {
            if path_pays(&self.program, &self.options, logs) {
                logs.pass_turn_to(0)?;
            }
            let ids = logs.strays().take(emitter, self.size.rays() as usize);
            let range = self.listed(emitter, &ids);
            self.dispatch(&range, Rays::Strayed)?;
        }
        Ok(())
    }

    /// A range of rays with these ids, of which the device is told whose turn it is.
    fn listed(&self, emitter: usize, ids: &[u64]) -> RayRange {
        let device = &self.devices[self.turn().0];
        if let Some(buffer) = &device.strays {
            device.gpu.queue.write_buffer(buffer, 0, bytemuck::cast_slice(ids));
        }
        let log_stride = self.end_logs.as_ref().map_or(0, EndLogs::stride);
        RayRange { first: 0, count: ids.len() as u32, emitter, log_stride, reached: self.reached }
    }

    /// Asks the device which primitives its rays have reached, until it knows of all: so that the rays to come need not
    /// tell it again.
    fn learn_reached(&mut self) -> Result<()> {
        let cells = &self.program.cells;
        if self.reached_marks() != ReachedMarks::Bits
            || self.reached.count_ones() as usize == self.ir.surfaces.len()
        {
            return Ok(());
        }
        for device in &self.devices {
            self.reached |= device.counters.read_word(&device.gpu, cells.reached)?;
        }
        Ok(())
    }

    fn reached_marks(&self) -> ReachedMarks {
        let Program { cells, features, options, .. } = &self.program;
        cells.reached_marks(features, options.baked)
    }

    /// What a range is born with.
    fn launch(&self, range: &RayRange) -> Booking {
        let quanta = self.birth_quanta(range.emitter);
        Booking { count: u64::from(range.count), quanta: quanta * u128::from(range.count) }
    }

    /// The weight of an emitter's new rays, quantised as the device does it.
    fn birth_quanta(&self, emitter: usize) -> u128 {
        let weight = self.options.precision.nearest(self.rays[emitter].weight);
        (weight * QUANTA_PER_WEIGHT).floor() as u128
    }

    /// Ranges of one dispatch each, of one emitter.
    fn ranges(&self, first: u64, end: u64) -> Vec<RayRange> {
        let most = u64::from(self.rays_per_dispatch());
        let log_stride = self.end_logs.as_ref().map_or(0, EndLogs::stride);
        let reached = self.reached;
        let mut ranges = Vec::new();
        for (emitter, rays) in self.rays.iter().enumerate() {
            let last = rays.first + rays.done(end, self.num_rays);
            let mut next = rays.first + rays.done(first, self.num_rays);
            while next < last {
                let count = (last - next).min(most) as u32;
                ranges.push(RayRange { first: next, count, emitter, log_stride, reached });
                next += u64::from(count);
            }
        }
        ranges
    }

    /// One batch: new rays through their first events, then the survivors until none can be left.
    fn dispatch(&mut self, range: &RayRange, rays: Rays) -> Result<()> {
        let num_rounds = self.num_rounds();
        let (number, log) = self.turn();
        let device = &self.devices[number];
        let gpu = &device.gpu;
        device.prepare(&self.program, &rays)?;
        if let Some(emitter) = self.program.emitters.get(range.emitter) {
            gpu.queue.write_buffer(&device.emitter, 0, emitter);
        }
        let rays_per_invocation = match (device.trace_path(&rays), &rays) {
            (Some(_), Rays::OfRange) => self.program.nominal_rays_per_invocation(),
            (Some(_), _) => self.program.side_rays_per_invocation(),
            (None, _) => self.program.options.rays_per_invocation(&self.program.features),
        };
        let rays_per_workgroup = self.options.workgroup_size * rays_per_invocation;
        let (x, y) = grid(range.count.div_ceil(rays_per_workgroup), gpu);
        let path = match (device.trace_path(&rays), &rays) {
            (Some(_), Rays::OfSide { side, .. }) => Some(1 + side),
            (path, _) => path.map(|_| 0),
        };
        let is_first = self.begun.insert((number, path));
        self.is_compiling |= is_first;
        let is_timed = path.is_none() && !is_first;
        if is_first && gpu.info.is_cpu() {
            // A driver may try at a stage's first dispatch what compiling it for the numbers of one range would save. Lavapipe
            // (Mesa 22.3) takes a shader that grew for one that shrank, and then compiles it anew for every range; one that
            // begins at ray 0 makes none grow. So the first dispatch is such a one, of no workgroups.
            let from_zero = self.program.range_bytes(&RayRange { first: 0, ..*range })?;
            gpu.queue.write_buffer(&device.range, 0, &from_zero);
            let stages: Vec<Stage> = device.stages([0, 0, 1], num_rounds, log, &rays).collect();
            submit(gpu, &stages, stages.len(), None);
        }
        gpu.queue.write_buffer(&device.range, 0, &self.program.range_bytes(range)?);
        let stages: Vec<Stage> = device.stages([x, y, 1], num_rounds, log, &rays).collect();
        let per_submission = stages.len().div_ceil(self.size.submissions());
        self.num_submissions += stages.len().div_ceil(per_submission) as u64;
        let submission = submit(gpu, &stages, per_submission, self.profile.as_mut());
        if let Some(logs) = &mut self.end_logs {
            logs.submitted(*range, rays, submission, is_timed)?;
            let times = logs.take_times();
            times.iter().for_each(|&(rays, time)| self.size.note(rays, time, self.pass_time));
        }
        if let Some(profile) = &mut self.profile {
            profile.collect(gpu)?;
        }
        gpu.check()
    }

    /// Dispatches until no ray can be left.
    fn num_rounds(&self) -> usize {
        self.options.max_depth.div_ceil(self.program.options.events_per_dispatch) as usize
    }

    /// Takes the rows of a range.
    fn fetch_events(&mut self, range: &RayRange) -> Result<()> {
        let DeviceState { gpu, counts: device_counts, events: Some(buffer), .. } = &self.devices[0] else {
            return Ok(());
        };
        let counts = gpu.read(device_counts, 12)?;
        let num_events = u32::from_le_bytes([counts[8], counts[9], counts[10], counts[11]]);
        let layout = crate::program::layout::records::StructLayout::of(&self.program.module, "Event")?;
        let size = u64::from(num_events) * layout.stride as u64;
        if size > buffer.size() {
            return Err(Error::Internal(format!("{num_events} rows do not fit the buffer")));
        }
        let bytes = gpu.read(buffer, size)?;
        let decode = self.event_decoder(&layout, range.first)?;
        let mut events: Vec<DeviceEvent> = bytes.chunks_exact(layout.stride).map(decode).collect();
        gpu.queue.write_buffer(device_counts, 0, &[0; 12]);
        let splits = self.program.splitting.is_some();
        events.sort_unstable_by_key(|event| (event.row.order(splits), event.kind));
        match self.recordings.get_mut(range.emitter) {
            Some(recording) => events.into_iter().try_for_each(|event| event.record(recording))?,
            None => self.events.append(&mut events),
        }
        Ok(())
    }

    /// Reads the rows of the range that began at ray `first`.
    fn event_decoder(
        &self,
        layout: &crate::program::layout::records::StructLayout,
        first: u64,
    ) -> Result<impl Fn(&[u8]) -> DeviceEvent + use<>> {
        let at = |field: &str| layout.offset(field);
        let [kind, subject, index, bounce, wavelength] =
            [at("kind")?, at("subject")?, at("index")?, at("bounce")?, at("wavelength")?];
        let position = [at("position_x")?, at("position_y")?, at("position_z")?];
        let direction = [at("direction_x")?, at("direction_y")?, at("direction_z")?];
        let weight = at("weight")?;
        let centre = self.program.centre.to_array();
        let precision = self.options.precision;
        let splitting = self.program.splitting;
        Ok(move |row: &[u8]| {
            let uint = |at: usize| u32::from_le_bytes(row[at..at + 4].try_into().unwrap_or_default());
            let real = |at: usize| match precision {
                Precision::F32 => f64::from(f32::from_bits(uint(at))),
                Precision::Df64 => df64::join([at, at + 4].map(|at| f32::from_bits(uint(at)))),
                Precision::F64 => f64::from_le_bytes(row[at..at + 8].try_into().unwrap_or_default()),
            };
            DeviceEvent {
                kind: uint(kind),
                subject: uint(subject),
                row: RayRow {
                    ray_id: ray_id_of(splitting, first, uint(index)),
                    bounce: uint(bounce),
                    wavelength: uint(wavelength),
                    position: [0, 1, 2].map(|axis| real(position[axis]) + centre[axis]),
                    direction: direction.map(real),
                    weight: real(weight),
                },
            }
        })
    }

    /// A tally of no rays, in the scene's shape.
    pub fn empty_tally(&self) -> Tally {
        let sensors = self.ir.sensors.iter().map(|sensor| SensorTally {
            quanta: vec![0; sensor.num_cells()],
            hits: vec![0; sensor.num_cells()],
            ..Default::default()
        });
        Tally {
            sensors: sensors.collect(),
            surfaces: vec![SurfaceTally::default(); self.ir.surfaces.len()],
            ..Default::default()
        }
    }

    /// Adds what the device has summed up since the last drain, and clears it.
    fn drain(&mut self, tally: &mut Tally) -> Result<()> {
        self.settle()?;
        self.check_loops()?;
        self.note_nominal_path(tally);
        let cells = &self.program.cells;
        let (counted, num_emitters) = (self.counted(), self.rays.len());
        let marks = self.reached_marks();
        for device in &self.devices {
            // One for each: bits of what was reached do not add up, and cells that overflow tell so on their device.
            let mut intake = Intake::new(cells, counted, num_emitters, tally);
            device.drain(&mut intake)?;
            intake.finish(marks);
        }
        if let Some(logs) = &mut self.end_logs {
            let ends = logs.take(cells)?;
            let mut intake = Intake::new(cells, counted, num_emitters, tally);
            (0..)
                .zip(ends.counts.iter().copied())
                .filter(|(_, count)| *count > 0)
                .for_each(|(i, count)| intake.count(i, count));
            (0..)
                .zip(ends.quanta())
                .filter(|(_, sum)| *sum > 0)
                .for_each(|(cell, sum)| intake.sum(cell, sum));
            intake.finish(marks);
        }
        self.reached = 0;
        self.num_passes = 0;
        self.counts_undrained = 0;
        tally.launched += std::mem::take(&mut self.launched);
        tally.rays += &std::mem::take(&mut self.launched_rays);
        for event in self.events.drain(..) {
            match event.path_event() {
                Some(path_event) => tally.paths.push(path_event),
                None => tally.sensors[event.subject as usize].rows.push(event.row),
            }
        }
        Ok(())
    }

    /// Notes what the rays of this trace have reached that kept to the nominal path, or to a side path.
    fn note_nominal_path(&self, tally: &mut Tally) {
        let (Some(nominal), Some(logs)) = (&self.program.nominal, &self.end_logs) else { return };
        let sides = self.program.side_paths.iter().map(|side| &side.path).zip(logs.num_along_sides());
        let paths = std::iter::once((nominal, logs.num_followed_and_strayed())).chain(sides);
        let kept = paths.filter(|(_, [num_followed, num_strayed])| num_followed > num_strayed);
        for event in kept.flat_map(|(path, _)| &path.events) {
            let surface = tally.surfaces.get_mut(event.primitive);
            surface.into_iter().for_each(|surface| surface.reached = true);
        }
    }

    /// Fails if the driver has left loops before their end (shaders/software/rounds.many.wgsl).
    fn check_loops(&self) -> Result<()> {
        if !self.program.options.has_many_rounds(&self.program.features) {
            return Ok(());
        }
        let mut were_cut = false;
        for device in &self.devices {
            were_cut |= device.take_cut_loops()?;
        }
        if !were_cut {
            return Ok(());
        }
        let (depth, budget) = (self.ir.sampling.split_depth, self.ir.sampling.split_budget);
        let has_splitting = self.program.splitting.is_some();
        let [.., has_gaussian] = self.program.features.splats;
        let advice = [
            (has_splitting, format!("a split_depth below {depth} or a split_budget below {budget}")),
            (has_gaussian, "a smaller splat_sigma".to_string()),
            (true, format!("a max_depth below {}, --standard-error off", self.options.max_depth)),
        ];
        let advice: Vec<String> =
            advice.into_iter().filter(|(helps, _)| *helps).map(|(_, text)| text).collect();
        Err(Error::Device(format!(
            "the driver of `{}` cut the shader's loops short, as lavapipe does after 65,535 rounds for the rays of one \
             vector, and lost what they had still to do; use {} or another adapter",
            self.gpu.info.name,
            advice.join(", ")
        )))
    }

    /// What counts tell beside themselves.
    fn counted(&self) -> Counted {
        let square = square_of_birth_weight(self.rays[0].weight, self.options.precision);
        Counted {
            quanta: self.program.constant_weights.then(|| self.birth_quanta(0)),
            square: (self.moments == MomentSource::Hits).then_some(square),
        }
    }
}

impl DeviceEvent {
    /// An event of a path; none if the row is one of a ray database.
    fn path_event(&self) -> Option<PathEvent> {
        let index = self.subject as usize;
        let kind = match (self.kind, self.subject) {
            (events::RECORDED, _) => return None,
            (events::BIRTH, _) => PathEventKind::Birth(index),
            (events::SURFACE, _) => PathEventKind::Surface(index),
            (events::SENSOR, _) => PathEventKind::Sensor(index),
            (_, events::ESCAPED) => PathEventKind::Escaped,
            (_, events::DEPTH_KILLED) => PathEventKind::DepthKilled,
            (..) => PathEventKind::FluxKilled,
        };
        Some(PathEvent { ray: self.row, kind })
    }

    fn record(self, recording: &mut Recording) -> Result<()> {
        match self.path_event() {
            Some(event) => recording.event(&event),
            None => recording.ray(self.subject as usize, self.row),
        }
    }
}

/// How far a trace is, after a pass.
pub struct Progress<'t, 'a> {
    /// Rays done, those included that the trace began with.
    pub done: u64,
    /// Rays in all.
    pub num_rays: u64,
    /// Time since the trace began, or was taken up again.
    pub elapsed: Duration,
    position: u64,
    tracer: &'t mut Tracer<'a>,
    tally: &'t mut Tally,
}

impl Progress<'_, '_> {
    /// The sums of all rays so far. The device's sums are fetched for it, once a pass.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn tally(&mut self) -> Result<&Tally> {
        if self.tracer.counts_undrained > 0 {
            self.tracer.drain(self.tally)?;
        }
        Ok(self.tally)
    }

    /// Where the trace is between 0 and `num_rays`; for a lone source, the rays done.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// See [`Tracer::pause_at`].
    pub fn pause_at(&mut self, position: u64) {
        self.tracer.pause_at(position);
    }
}

/// The id of a ray with this index in the range that began at ray `first`.
fn ray_id_of(splitting: Option<Splitting>, first: u64, index: u32) -> u64 {
    let (position, number) = splitting.map_or((index, 0), |splitting| splitting.parts(index));
    ray_id::of(first + u64::from(position), number)
}

/// What a ray that has kept its weight adds to the second moments; rounded up, as the device does it.
fn square_of_birth_weight(weight: f64, precision: Precision) -> u128 {
    let weight = precision.nearest(weight);
    (precision.nearest(weight * weight) * QUANTA_PER_WEIGHT).ceil() as u128
}

/// Submits stages, so many at once, to be timed or not; gives the last submission.
fn submit(
    gpu: &Gpu,
    stages: &[Stage],
    per_submission: usize,
    mut profile: Option<&mut Profile>,
) -> wgpu::SubmissionIndex {
    let mut parts = stages.chunks(per_submission).peekable();
    loop {
        let part = parts.next().unwrap_or_default();
        let is_last = parts.peek().is_none();
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        match &mut profile {
            Some(profile) => {
                let mut record =
                    |stage: &Stage| stage.record(&mut profile.begin_pass(&mut encoder, stage.name));
                part.iter().for_each(&mut record);
                if is_last {
                    profile.resolve(&mut encoder);
                }
            }
            None => {
                let descriptor = wgpu::ComputePassDescriptor { label: Some("trace"), timestamp_writes: None };
                let mut pass = encoder.begin_compute_pass(&descriptor);
                part.iter().for_each(|stage| stage.record(&mut pass));
            }
        }
        let submission = gpu.queue.submit([encoder.finish()]);
        if is_last {
            return submission;
        }
    }
}

/// So few rays that every processor has workgroups enough, or a graphics processor some.
fn least_rays(gpu: &Gpu, program: &Program) -> u32 {
    let num_processors = if gpu.info.is_cpu() { processors::count() as u32 } else { 16 };
    let rays_per_workgroup =
        program.options.workgroup_size * program.options.rays_per_invocation(&program.features);
    WORKGROUPS_PER_PROCESSOR * num_processors * rays_per_workgroup
}

/// Workgroups as a grid, within the limit of one dimension.
fn grid(workgroups: u32, gpu: &Gpu) -> (u32, u32) {
    let limit = gpu.device.limits().max_compute_workgroups_per_dimension;
    let y = workgroups.div_ceil(limit).max(1);
    (workgroups.div_ceil(y), y)
}

/// What splitting could make of the launched rays must have ids, and be counted.
fn check_families(program: &Program, options: &TraceOptions) -> Result<()> {
    if program.splitting.is_none() {
        return Ok(());
    }
    // A larger id would be that of another ray's child.
    if options.first_ray.saturating_add(options.num_rays) > ray_id::MOST_LAUNCHED {
        return Err(Error::Usage(format!(
            "{} rays from ray {} on are too many where rays are split: their ids end at {}",
            options.num_rays,
            options.first_ray,
            ray_id::MOST_LAUNCHED
        )));
    }
    if counts_per_ray(program) > MAX_COUNTS_PER_PASS {
        return Err(Error::Usage(format!(
            "a launched ray may become {} rays of up to {} events each, more than can be counted; lower split_budget or \
             max_depth",
            program.most_rays(),
            options.max_depth
        )));
    }
    Ok(())
}

/// Most events of one launched ray and its children, with where they end.
fn counts_per_ray(program: &Program) -> u64 {
    program.most_rays() * u64::from(program.options.max_depth + 1)
}

fn batch_size(gpu: &Gpu, program: &Program, options: &TraceOptions) -> u32 {
    let default = match program.end_log {
        Some(_) if program.path_log.is_some() => DEFAULT_PLACES_BATCH,
        Some(_) => DEFAULT_LOGGED_BATCH,
        None => DEFAULT_BATCH / program.most_rays().min(MANY_RAYS) as u32,
    };
    let wanted = options.batch_size.unwrap_or(default).min(options.num_rays.min(1 << 30) as u32);
    let events = match program.max_events_per_ray {
        0 => u32::MAX,
        per_ray => (u64::from(MAX_EVENTS) / per_ray).max(1) as u32,
    };
    let queued = match (program.options.has_queue(), stride_of(program, "QueuedRay")) {
        (true, Ok(stride)) => {
            (gpu.device.limits().max_storage_buffer_binding_size / stride).min(1 << 30) as u32
        }
        _ => u32::MAX,
    };
    let counted = (MAX_COUNTS_PER_PASS / counts_per_ray(program)).min(1 << 30) as u32;
    let families = program.splitting.map_or(u32::MAX, |splitting| 1 << splitting.index_bits());
    let logged = program.end_log.as_ref().map_or(u32::MAX, |log| log.max_rays(program.path_log.as_ref()));
    wanted.min(logged).min(events).min(queued).min(counted).min(families).max(1)
}

/// Whether new rays should follow the nominal path, if there is one: always where that was asked for.
fn path_pays(program: &Program, options: &TraceOptions, logs: &EndLogs) -> bool {
    program.nominal.is_none()
        || options.nominal_path == Some(true)
        || pilot::pays(logs.num_followed_and_strayed())
}

/// Lanes that store together: 1 where workgroups are not made of whole subgroups.
fn lanes_together(gpu: &Gpu, options: &TraceOptions) -> u32 {
    let is_wanted = options.stores_together.unwrap_or(gpu.prefers_stores_together());
    if is_wanted && options.workgroup_size.is_multiple_of(gpu.lanes) { gpu.lanes } else { 1 }
}

/// So few rays an invocation that a dispatch has several workgroups for each processor.
fn most_rays_per_invocation(gpu: &Gpu, options: &TraceOptions) -> u32 {
    const MOST: u64 = 8;
    if !gpu.info.is_cpu() {
        return 1;
    }
    let processors = processors::count() as u64;
    let dispatch_rays = options.num_rays.min(options.batch_size.unwrap_or(DEFAULT_LOGGED_BATCH).into());
    (dispatch_rays
        / (u64::from(WORKGROUPS_PER_PROCESSOR) * processors * u64::from(options.workgroup_size.max(1))))
    .clamp(1, MOST) as u32
}
