//! What a change does: two scenes, traced side by side by the same draws.
//!
//! Random numbers are keyed by rays, so both scenes can trace the same block of rays before the next one. The spread of the
//! blocks' differences gives the error ([`crate::result::difference::Spread`]). Of Sobol points, scrambles take the place of
//! blocks.

use crate::engine::budget::distribute;
use crate::engine::options::{StandardError, TraceOptions};
use crate::engine::pipeline_cache::Shaders;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::ray_id::NUM_REPLICATES;
use crate::model::{PathFilter, SceneIr};
use crate::program::{Precision, Sampler};
use crate::result::difference::{Pairing, Spread, with_sources_of};
use crate::result::{DetectorTally, FluxSum, FluxUnit, RunInfo, SceneDifference, Tally};
use crate::run::additions::ForAdapter;
use crate::run::blocks::{Blocks, MOST_BLOCK_RAYS, notes_of_few_rays, num_blocks};
use crate::run::precision::{self, ChosenPrecision, WantedPrecision};
use crate::run::{Next, PipelineCache, Run, Settled, Status, Tracer};
use crate::scene::Scene;
use std::sync::Arc;
use std::time::Instant;

/// Blocks of rays, at least: the error of an error is then 9 %.
const NUM_BLOCKS: u64 = 64;
/// Rays of the first step of a trace. Both scenes have traced the same rays after each step, so that a stop keeps them.
const FIRST_STEP_RAYS: u64 = 1 << 10;

/// Two scenes that launch the same rays.
pub struct Pair<'a> {
    a: &'a SceneIr,
    b: SceneIr,
    cache: Option<&'a PipelineCache>,
}

/// The difference A - B of a number that is computed from what detectors record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LossDifference {
    /// A - B.
    pub difference: f64,
    /// Its standard error; none from too few rays.
    pub standard_error: Option<f64>,
}

/// Two traces, side by side.
struct Sides {
    sums: [Tally; 2],
    num_rays: u64,
    run: RunInfo,
    notes: Vec<String>,
}

impl Run<'_> {
    /// Traces A and B, and gives A - B. The run is one of scene A; `b` is what was read of B. `next` gets how far both have
    /// come, and says how to go on. After a stop there is what both have traced.
    ///
    /// # Errors
    /// As [`Run::go`] and [`Pair::difference`].
    pub fn difference(
        self,
        pair: &Pair<'_>,
        b: &Scene,
        mut next: impl FnMut(&Status) -> Next,
    ) -> Result<SceneDifference> {
        let depth = pair.scenes().map(|ir| self.depth_of(ir)).into_iter().max();
        let run = Run { max_depth: self.max_depth.or(depth), ..self };
        let (gpu, wanted) = (run.device()?, run.precision);
        let settled = run.settle_by(&gpu, |options| pair.choose_precision(&gpu, options, wanted))?;
        let Settled { options, info } = run.guided(&gpu, settled, None)?;
        let num_rays = options.num_rays;
        let start = Instant::now();
        let found = pair.difference(&gpu, &options, |[a, b]| {
            let next = next(&Status::of_rays(a + b, 2 * num_rays, start.elapsed()));
            // A stop while shaders are compiled still has rays to keep.
            next == Next::GoOn || next == Next::Stop && b < FIRST_STEP_RAYS.min(num_rays)
        })?;
        let mut scene_warnings = info.scene_warnings;
        let of_b = b.warnings_in(options.precision);
        let new: Vec<String> = of_b.into_iter().filter(|warning| !scene_warnings.contains(warning)).collect();
        scene_warnings.extend(new);
        let RunInfo { partial, num_rays, .. } = found.run;
        let trace_time_sec = start.elapsed().as_secs_f64();
        let run = RunInfo { partial, num_rays, trace_time_sec, scene_warnings, ..info };
        Ok(SceneDifference { run, ..found })
    }
}

impl<'a> Pair<'a> {
    /// Pairs the sources of two scenes by their names.
    ///
    /// # Errors
    /// [`Error::Usage`] if a source of one is lacking in the other.
    pub fn new(a: &'a SceneIr, b: SceneIr) -> Result<Self> {
        Ok(Pair { b: with_sources_of(a, b)?, a, cache: None })
    }

    /// With compiled shaders of earlier traces, which are kept there.
    pub fn with_cache(self, cache: Option<&'a PipelineCache>) -> Self {
        Pair { cache, ..self }
    }

    /// A and B.
    pub fn scenes(&self) -> [&SceneIr; 2] {
        [self.a, &self.b]
    }

    /// The precision that both scenes need.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn choose_precision(
        &self,
        gpu: &Gpu,
        options: &TraceOptions,
        wanted: WantedPrecision,
    ) -> Result<ChosenPrecision> {
        let fineness = |choice: &ChosenPrecision| match choice.precision {
            Precision::F32 => 0,
            Precision::Df64 => 1,
            Precision::F64 => 2,
        };
        let [a, b] = self.scenes().map(|ir| {
            let options = self.options_of(ir, options)?;
            precision::choose(gpu, ir, &options, wanted)
        });
        let (a, b) = (a?, b?);
        Ok(if fineness(&b) > fineness(&a) { b } else { a })
    }

    /// The largest weight with which a source's rays are born, of each scene.
    fn largest_births(&self, options: &TraceOptions) -> Result<[f64; 2]> {
        let [a, b] = self.scenes().map(|ir| {
            let options = self.options_of(ir, options)?;
            let rays = distribute(ir, options.budget(), options.shares.as_deref())?;
            Ok(rays.iter().map(|rays| rays.weight).fold(0.0, f64::max))
        });
        Ok([a?, b?])
    }

    /// Traces both scenes, and gives A - B. `keep_going` gets the rays done by either scene, after each pass, and stops both
    /// by returning false.
    ///
    /// All options hold of both scenes. A filter of paths is read again for each, because each has surfaces of its own. The
    /// rays are shared by the fluxes of A's sources, unless the options have shares.
    ///
    /// # Errors
    /// [`Error::Usage`] for options that make no sense, or scenes without a detector in common. [`Error::Interrupted`] if no
    /// step of rays was done by both. [`Error::Device`] if the device fails.
    pub fn difference(
        &self,
        gpu: &Gpu,
        options: &TraceOptions,
        keep_going: impl FnMut([u64; 2]) -> bool,
    ) -> Result<SceneDifference> {
        let pairing = Pairing::new(self.scenes())?;
        let is_sobol = options.sampler == Sampler::Sobol;
        let mut spreads = [Spread::default(), Spread::default()];
        let of_block = |of_block: &[Tally; 2], units: [FluxUnit; 2]| {
            if !is_sobol {
                let num_rays = of_block[0].launched.count;
                let [a, b] = [0, 1].map(|side| pairing.figures(side, &of_block[side], units[side]));
                let (a, b) = (a?, b?);
                spreads[0].add(num_rays, &less(&a.lines, &b.lines));
                spreads[1].add(num_rays, &less(&a.detected, &b.detected));
            }
            Ok(())
        };
        let Sides { sums, num_rays, run, notes } = self.trace(gpu, options, of_block, keep_going)?;
        if is_sobol {
            let units = self.scenes().map(|ir| FluxUnit::of_scene(ir, num_rays));
            self.add_scrambles(&pairing, &sums, units, &mut spreads[1])?;
        }
        let done = sums[0].launched.count;
        // After a stop, the rays so far share all flux that the sources emit.
        let units = self.scenes().map(|ir| FluxUnit::of_scene(ir, done));
        let scale = num_rays as f64 / done as f64;
        let [a, b] = &sums;
        let births = self.largest_births(options)?;
        let mut found = pairing.difference([a, b], births, units, spreads.each_ref(), scale)?;
        found.notes.extend(notes);
        Ok(SceneDifference { run, ..found })
    }

    /// How much larger the loss of A is than the loss of B. `adjoints` says for each detector what the loss gains by a
    /// watt in each cell \[1/W\]; `keep_going` as in [`Pair::difference`].
    ///
    /// # Errors
    /// As [`Pair::difference`]. [`Error::Interrupted`] if the traces were stopped.
    pub(crate) fn loss_difference(
        &self,
        gpu: &Gpu,
        options: &TraceOptions,
        adjoints: &[Vec<f64>],
        keep_going: impl FnMut([u64; 2]) -> bool,
    ) -> Result<LossDifference> {
        let mut spread = Spread::default();
        let mut difference = 0.0;
        let of_block = |of_block: &[Tally; 2], units: [FluxUnit; 2]| {
            let [a, b] = [0, 1].map(|side| loss(&of_block[side], units[side], adjoints));
            difference += a - b;
            spread.add(of_block[0].launched.count, &[a - b]);
            Ok(())
        };
        let sides = self.trace(gpu, options, of_block, keep_going)?;
        if sides.run.partial {
            return Err(Error::Interrupted);
        }
        Ok(LossDifference { difference, standard_error: spread.errors().map(|errors| errors[0]) })
    }

    /// Traces both scenes block by block. `of_block` gets the sums of each block of both, and what a weight is worth.
    fn trace(
        &self,
        gpu: &Gpu,
        options: &TraceOptions,
        mut of_block: impl FnMut(&[Tally; 2], [FluxUnit; 2]) -> Result<()>,
        mut keep_going: impl FnMut([u64; 2]) -> bool,
    ) -> Result<Sides> {
        let scenes = self.scenes();
        let is_sobol = options.sampler == Sampler::Sobol;
        let options = [self.options_of(scenes[0], options)?, self.options_of(scenes[1], options)?];
        let mut tracers =
            [self.tracer(gpu, scenes[0], &options[0])?, self.tracer(gpu, scenes[1], &options[1])?];
        let num_rays = tracers[0].num_rays();
        let units = scenes.map(|ir| FluxUnit::of_scene(ir, num_rays));
        let num_blocks = if is_sobol { 1 } else { num_blocks(num_rays, NUM_BLOCKS) };
        let mut blocks = tracers.each_ref().map(|tracer| Blocks::new(tracer, num_blocks));
        let (mut done, mut is_stopped) = ([0; 2], false);
        'blocks: for number in 0..num_blocks {
            let end = blocks[0].next_end(&tracers[0]);
            // Where one block is all there is so far, a stop within it keeps its steps.
            let steps = if number == 0 { steps(end) } else { vec![end] };
            let mut sums = tracers.each_ref().map(Tracer::empty_tally);
            for end in steps {
                let mut traced = Vec::new();
                for side in 0..2 {
                    let of_side = blocks[side].trace_to(&mut tracers[side], end, |rays| {
                        done[side] = rays;
                        keep_going(done)
                    })?;
                    is_stopped = of_side.is_stopped;
                    // Of what B has not traced, there is no difference.
                    if !of_side.is_whole || is_stopped && side == 0 {
                        break 'blocks;
                    }
                    traced.push(of_side.tally);
                }
                for (side, traced) in traced.into_iter().enumerate() {
                    sums[side] += &blocks[side].add(traced);
                }
                if is_stopped {
                    break;
                }
            }
            blocks.iter_mut().for_each(Blocks::end_block);
            of_block(&sums, units)?;
            if is_stopped {
                break;
            }
        }
        let sums = blocks.map(|blocks| blocks.sums);
        let done = sums[0].launched.count;
        if done == 0 {
            return Err(Error::Interrupted);
        }
        let notes = if is_sobol { Vec::new() } else { notes_of_few_rays(self.a, &options[0], num_blocks)? };
        let run = RunInfo { partial: done < num_rays, num_rays, ..options[0].run_info(&gpu.info) };
        Ok(Sides { sums, num_rays, run, notes })
    }

    /// The options of one scene's trace.
    fn options_of(&self, ir: &SceneIr, options: &TraceOptions) -> Result<TraceOptions> {
        let filter = options.path_filter.as_ref();
        let filter = filter.map(|filter| PathFilter::parse(&filter.text, ir)).transpose()?;
        let of_a = || self.a.sources.iter().map(|source| source.total_flux).collect();
        let is_sobol = options.sampler == Sampler::Sobol;
        Ok(TraceOptions {
            shares: options.shares.clone().or_else(|| Some(of_a())),
            path_filter: filter.map(Arc::new),
            standard_error: if is_sobol { StandardError::On } else { StandardError::Off },
            ..options.clone()
        })
    }

    fn tracer<'s>(&'s self, gpu: &'s Gpu, ir: &'s SceneIr, options: &TraceOptions) -> Result<Tracer<'s>> {
        let shaders = Shaders { cache: self.cache, edit: None };
        Tracer::with(gpu, ir, options, ForAdapter::WhatPays, shaders)
    }

    /// Adds what each scramble of the points sums up to.
    fn add_scrambles(
        &self,
        pairing: &Pairing<'_>,
        sums: &[Tally; 2],
        units: [FluxUnit; 2],
        spread: &mut Spread,
    ) -> Result<()> {
        let rays = sums[0].rays.counts_by_remainder(u64::from(NUM_REPLICATES));
        for (scramble, num_rays) in rays.into_iter().enumerate() {
            let of_side = |side: usize| {
                pairing.detected(side, &sums[side], units[side], |number| {
                    let all = &sums[side].detectors[number];
                    let size = all.quanta.len().max(1);
                    let quanta = all.replicates.get(scramble * size..(scramble + 1) * size);
                    let quanta = quanta
                        .ok_or_else(|| Error::Internal("the scrambles of points have no sums".into()))?;
                    Ok(match all.quanta.is_empty() {
                        true => DetectorTally {
                            recorded: FluxSum { count: 0, quanta: quanta[0] },
                            ..Default::default()
                        },
                        false => DetectorTally {
                            quanta: quanta.to_vec(),
                            hits: vec![0; size],
                            ..Default::default()
                        },
                    })
                })
            };
            spread.add(num_rays, &less(&of_side(0)?, &of_side(1)?));
        }
        Ok(())
    }
}

/// The ends of steps to a position: twice as long each time, and never longer than a block.
fn steps(end: u64) -> Vec<u64> {
    let ends = std::iter::successors(Some(FIRST_STEP_RAYS), |end| Some(end + (*end).min(MOST_BLOCK_RAYS)));
    ends.take_while(|step| *step < end).chain([end]).collect()
}

fn less(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

/// What a loss is, by what it gains by a watt in each cell.
fn loss(tally: &Tally, unit: FluxUnit, adjoints: &[Vec<f64>]) -> f64 {
    let of_detector = |(detector, adjoints): (&DetectorTally, &Vec<f64>)| {
        let cells = detector.quanta_of_cells();
        adjoints.iter().zip(cells.iter()).map(|(adjoint, quanta)| adjoint * unit.watts(*quanta)).sum::<f64>()
    };
    tally.detectors.iter().zip(adjoints).map(of_detector).sum()
}
