//! A run as it goes: device, options, precision, passes, result.

use crate::engine::pipeline_cache::Shaders;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::SceneIr;
use crate::program::Precision;
use crate::result::output::file_system_of;
use crate::result::{Recording, RunInfo, StoppedBy, Tally, TraceResult};
use crate::run::additions::ForAdapter;
use crate::run::checkpoint::{self, Checkpoint, Identity};
use crate::run::outcome::{Outcome, Saved};
use crate::run::precision::{self, ChosenPrecision, WantedPrecision};
use crate::run::proof::{self, Proof, ProofKeeper};
use crate::run::status::{Next, Status};
use crate::run::stopping::Stopping;
use crate::run::{Device, Progress, RowStorage, Run, Saves, StandardError, Strict, TraceOptions, Tracer};
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Most rays of a trace whose numbers are live. In a longer one the rays take longer than compiling, and a shader with
/// the numbers compiled in traces them faster.
const MOST_LIVE_RAYS: u64 = 1_000_000;

/// Strict arithmetic where the adapter allows it, unless the user says otherwise: for live numbers and for proofs.
/// [`Strict::holds`] is the rule of other traces, and `TraceOptions::is_strict` the rule of light by its path.
fn strict_where_possible(asked: Strict, gpu: &Gpu) -> Strict {
    match asked {
        Strict::Auto if gpu.info.strict => Strict::On,
        asked => asked,
    }
}

/// The options and the header of the report, settled on a device before the tracer is made. The tracer is made from the
/// options. The header is there before the first ray, so that each pass can have a report.
#[derive(Debug, Clone)]
pub struct Settled {
    /// The options, with precision and depth.
    pub options: TraceOptions,
    /// What the report says about them.
    pub info: RunInfo,
}

/// A trace after one of its passes.
pub struct Pass<'p, 't, 'a> {
    /// How far the trace has come.
    pub status: Status,
    progress: &'p mut Progress<'t, 'a>,
    model: &'p SceneIr,
    info: &'p RunInfo,
}

impl Pass<'_, '_, '_> {
    /// The sums of all rays so far.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn tally(&mut self) -> Result<&Tally> {
        self.progress.tally()
    }

    /// The result of all rays so far.
    ///
    /// # Errors
    /// As [`Pass::tally`].
    pub fn result(&mut self) -> Result<TraceResult> {
        let tally = self.progress.tally()?;
        let partial = tally.launched.count < self.info.num_rays;
        let trace_time_sec = self.status.elapsed.as_secs_f64();
        TraceResult::new(self.model, &RunInfo { trace_time_sec, partial, ..self.info.clone() }, tally)
    }
}

impl<'a> Run<'a> {
    /// Traces all rays.
    ///
    /// # Errors
    /// [`Error::NoAdapter`] if no adapter fits. [`Error::Usage`] for options that make no sense, or that the device cannot do.
    /// [`Error::File`] if sums cannot be read. [`Error::Device`] if the device fails.
    pub fn go(self) -> Result<Outcome> {
        self.go_with(|_| Ok(Next::GoOn))
    }

    /// As [`Run::go`]. After each pass of some 40 ms, `after_pass` may look at the sums so far, and says how to go on.
    ///
    /// # Errors
    /// As [`Run::go`]. [`Error::Interrupted`] if the trace was cancelled. Any error of `after_pass`.
    pub fn go_with(
        mut self,
        after_pass: impl FnMut(&mut Pass<'_, '_, '_>) -> Result<Next>,
    ) -> Result<Outcome> {
        let resumed = self.resumed.take();
        if let Some((_, Checkpoint { identity, proof, .. })) = &resumed {
            self.max_depth = self.max_depth.or(Some(identity.max_depth));
            self.has_proof |= proof.is_some();
        }
        if self.has_proof {
            self.check_proof()?;
        }
        let gpu = self.device()?;
        let gpu: &Gpu = &gpu;
        // Where f32 is asked for, the predicted error of f32 is only reported, and no ray needs to wait for it. So a
        // second device predicts it in a thread, while the first device traces. `trace` asks for it after the last ray.
        let is_reported = self.precision == WantedPrecision::Exactly(Precision::F32);
        if !is_reported || self.predicts_first || self.cache.is_some() {
            return self.trace(gpu, self.settle(gpu)?, resumed, after_pass, || None);
        }
        let asked = ChosenPrecision { precision: Precision::F32, reason: "asked for".into(), warning: None };
        let settled = self.settled(gpu, self.options_on(gpu), asked.clone());
        let (model, options, wanted) = (&*self.model, settled.options.clone(), self.precision);
        std::thread::scope(|scope| {
            let predict = || precision::choose(&gpu.open_again()?, model, &options, wanted);
            let predicted = scope.spawn(predict);
            self.trace(gpu, settled, resumed, after_pass, || {
                let predicted = predicted.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
                // A failed prediction is no reason to lose the result.
                Some(predicted.unwrap_or_else(|error| ChosenPrecision {
                    warning: Some(format!("the error of f32 could not be predicted: {error}")),
                    ..asked
                }))
            })
        })
    }

    /// The device: opened, unless it is open.
    pub(crate) fn device(&self) -> Result<Cow<'a, Gpu>> {
        match &self.device {
            Device::Open(gpu) => Ok(Cow::Borrowed(*gpu)),
            Device::Choice(choice) => Gpu::open(choice).map(Cow::Owned),
        }
    }

    /// What the run traces with on a device: for those who trace by a [`Tracer`] of their own.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn settle(&self, gpu: &Gpu) -> Result<Settled> {
        self.settle_by(gpu, |options| {
            let pilot = |ir: &SceneIr, options: &TraceOptions| self.tracer(gpu, ir, options)?.trace(|_| true);
            precision::choose_by(gpu, &self.model, options, self.precision, pilot)
        })
    }

    /// As [`Run::settle`]. `choose` chooses the precision.
    pub(crate) fn settle_by(
        &self,
        gpu: &Gpu,
        choose: impl FnOnce(&TraceOptions) -> Result<ChosenPrecision>,
    ) -> Result<Settled> {
        let options = self.options_on(gpu);
        let choice = choose(&options)?;
        Ok(self.settled(gpu, options, choice))
    }

    /// The options on a device, but for the precision.
    fn options_on(&self, gpu: &Gpu) -> TraceOptions {
        let options = self.options.clone();
        // Only strict arithmetic gives the same bits with live numbers and without. Only then do other machines repeat
        // the bits of a proof.
        let strict = match self.cache.is_some() || self.has_proof {
            true => strict_where_possible(options.strict, gpu),
            false => options.strict,
        };
        let live = match self.cache {
            Some(_) => self.live.unwrap_or(options.num_rays <= MOST_LIVE_RAYS),
            None => options.live,
        };
        TraceOptions {
            max_depth: self.max_depth.unwrap_or_else(|| self.depth_of(&self.model)),
            standard_error: match self.target_error {
                Some(_) => StandardError::On,
                None => options.standard_error,
            },
            may_end_early: options.may_end_early || self.target_error.is_some() || self.time_limit.is_some(),
            strict,
            live,
            ..options
        }
        .tuned(&gpu.info)
    }

    fn settled(&self, gpu: &Gpu, options: TraceOptions, choice: ChosenPrecision) -> Settled {
        let options = TraceOptions { precision: choice.precision, ..options };
        let info = RunInfo {
            scene: self.name.clone(),
            precision_reason: choice.reason,
            precision_warning: choice.warning,
            scene_warnings: self.scene.warnings_in(options.precision),
            lamp_files: self.scene.lamp_files.clone(),
            ray_files: self.scene.ray_files.clone(),
            photometric: self.photometric,
            color: if self.photometric { self.scene.color_detectors() } else { Vec::new() },
            target_error: self.target_error,
            split_depth: self.model.sampling.split_depth,
            has_no_gpu: gpu.stands_in_for_gpu(),
            ..options.run_info(&gpu.info)
        };
        Settled { options, info }
    }

    /// A tracer of a scene: with shaders of the cache where numbers are live.
    fn tracer<'s>(&self, gpu: &'s Gpu, ir: &'s SceneIr, options: &TraceOptions) -> Result<Tracer<'s>> {
        let shaders = Shaders { cache: self.cache.filter(|_| options.live), edit: None };
        Tracer::with(gpu, ir, options, ForAdapter::WhatPays, shaders)
    }

    /// Traces. `predicted` is called after the last ray. It gives the choice of precision, if a second device predicted
    /// meanwhile ([`Run::go_with`]).
    fn trace(
        &self,
        gpu: &Gpu,
        settled: Settled,
        resumed: Option<(PathBuf, Checkpoint)>,
        mut after_pass: impl FnMut(&mut Pass<'_, '_, '_>) -> Result<Next>,
        predicted: impl FnOnce() -> Option<ChosenPrecision>,
    ) -> Result<Outcome> {
        let model = &*self.model;
        let begun_by = resumed.as_ref().and_then(|(_, sums)| sums.identity.guide.as_ref());
        let Settled { options, mut info } = self.guided(gpu, settled, begun_by)?;
        let rows = match self.saves.is_some() || resumed.is_some() {
            true => &RowStorage::Sums,
            false => &self.rows,
        };
        let identity = Identity::new(model, self.name.clone(), &options, &gpu.info);
        let identity = if *rows == RowStorage::Sums { identity } else { identity.with_paths_apart() };
        let same_file =
            resumed.as_ref().filter(|(path, _)| self.saves.as_ref().is_some_and(|to| to.path == *path));
        let rays_resumed = same_file.map(|(_, sums)| sums.tally.launched.count);
        let begun = resumed.map(|(path, sums)| self.beginning(&path, &identity, sums)).transpose()?;
        let (begun, proof) = begun.map_or((None, None), |(tally, proof)| (Some(tally), proof));
        let rays_there = match (&self.saves, rays_resumed) {
            (Some(_), Some(rays)) => rays,
            (Some(saves), None) => checkpoint::rays_in(&saves.path, &identity, saves.overwrite)?,
            (None, _) => 0,
        };
        let mut tracer = self.tracer(gpu, model, &options)?;
        if let Some(time) = self.pass_time {
            tracer.set_pass_time(time);
        }
        match rows {
            RowStorage::Sums => {}
            RowStorage::Disk(dir) => {
                let folder = file_system_of(dir)?;
                tracer.record_to(|| Recording::in_folder(model, &folder));
            }
            RowStorage::Counted => tracer.record_to(|| Recording::counted(model)),
        }
        if self.has_profile {
            tracer.enable_profile()?;
        }
        let begun = begun.unwrap_or_else(|| tracer.empty_tally());
        info.num_rays = tracer.num_rays();
        info.num_rays_before = begun.launched.count;
        let mut stopping = Stopping::new(model, self.target_error, self.time_limit);
        stopping.begin(&mut tracer, &begun)?;
        let mut keeper = None;
        if self.has_proof {
            let place = (tracer.num_rays(), tracer.position_after(&begun)?);
            let new = ProofKeeper::new(model, &options, &gpu.info, place, &begun, proof)?;
            tracer.pause_before(place.1, new.next_end(place.1));
            keeper = Some(new);
        }
        let mut stopped_by = None;
        let mut last_checkpoint = Instant::now();
        let start = Instant::now();
        let tally = tracer.go_on_checked(begun, |progress| {
            stopped_by = stopping.after_pass(model, progress)?;
            keeper.as_mut().map_or(Ok(()), |keeper| keeper.after_pass(progress))?;
            let status = Status::of(progress, &stopping, info.num_rays_before);
            match after_pass(&mut Pass { status, progress, model, info: &info })? {
                Next::GoOn => {}
                Next::Stop => stopped_by = Some(StoppedBy::Interrupt),
                Next::Cancel => return Err(Error::Interrupted),
            }
            if let Some(Saves { path, interval, .. }) = &self.saves
                && progress.done >= rays_there
                && last_checkpoint.elapsed() >= *interval
            {
                // The disk may have room again at the next checkpoint, and no ray is lost. A failure at the end is an
                // error.
                let tally = progress.tally()?;
                let proof = keeper.as_ref().map(|keeper| keeper.so_far(tally));
                if let Err(error) = checkpoint::write(path, &identity, tally, proof.as_ref()) {
                    (self.say)(&format!("no checkpoint now: {error}"));
                }
                last_checkpoint = Instant::now();
            }
            Ok(stopped_by.is_none())
        })?;
        info.trace_time_sec = start.elapsed().as_secs_f64();
        let proof = keeper.map(|keeper| keeper.so_far(&tally));
        let saved = match &self.saves {
            None => Saved::NoFile,
            Some(_) if tally.launched.count < rays_there => Saved::Kept(rays_there),
            Some(saves) => checkpoint::write(&saves.path, &identity, &tally, proof.as_ref())
                .map_or_else(Saved::Failed, |()| Saved::Written),
        };
        if let Some(choice) = predicted() {
            (info.precision_reason, info.precision_warning) = (choice.reason, choice.warning);
        }
        info.partial = tally.launched.count < tracer.num_rays();
        info.stopped_by = stopped_by.filter(|_| info.partial);
        info.first_rays_sec = tracer.first_end().map(|end| (end - self.start).as_secs_f64());
        info.stage_times = tracer.stage_times();
        let result = match tracer.take_recorded()? {
            Some(recorded) => TraceResult::with_rows(model, &info, &tally, &recorded)?,
            None => TraceResult::new(model, &info, &tally)?,
        };
        let found_paths = tracer.found_paths().into_iter().map(|(path, at)| (path.clone(), at)).collect();
        Ok(Outcome { result, tally, identity, proof, options, found_paths, saved })
    }

    /// Refuses a proof that makes no sense.
    fn check_proof(&self) -> Result<()> {
        if self.options.strict == Strict::Off {
            return Err(Error::Usage(
                "a proof needs strict arithmetic, so that others get the same bits; leave out --strict=off"
                    .into(),
            ));
        }
        proof::check_cost(&self.model, self.options.num_rays)
    }

    /// The sums from which the trace goes on, which a file had, and their proof.
    fn beginning(
        &self,
        file: &Path,
        identity: &Identity,
        resumed: Checkpoint,
    ) -> Result<(Tally, Option<Proof>)> {
        let differences = identity.differences_from_beginning(&resumed.identity);
        resumed.check_rows(file, "--checkpoint")?;
        if !differences.is_empty() {
            let differences = differences.join("; ");
            return Err(Error::Usage(format!("{} is of another trace: {differences}", file.display())));
        }
        resumed.check(file, &self.model)?;
        if !identity.same_device(&resumed.identity) {
            let (file, Identity { adapter, driver, .. }) = (file.display(), &resumed.identity);
            (self.say)(&format!(
                "{file} comes from another adapter or driver, {adapter} ({driver}): the bits may differ from an \
                 unbroken trace's"
            ));
        }
        Ok((resumed.tally, resumed.proof))
    }
}
