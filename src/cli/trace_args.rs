//! The options of a trace that `nsq-gpu trace` and the requests of `nsq-gpu serve` share.

use crate::cli::output_file::OutputFile;
use crate::cli::quantity;
use crate::count;
use crate::engine::options::MOST_PATH_ROWS;
use crate::error::{Error, Result};
use crate::format::shown;
use crate::guide::Guide;
use crate::guide::learn::Wanted;
use crate::model::scatter_sampling::{DEFAULT_SHARE, Refusal, RequestedTarget, TargetRequest, resolve, set};
use crate::model::{PathFilter, ReflectProb, Sampling, SceneIr};
use crate::program::{Precision, Sampler};
use crate::run::precision::WantedPrecision;
use crate::run::{Collect, Run, StandardError, Strict, TraceOptions};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// Options of one trace, which commands of several refuse.
const OF_ONE_TRACE: [&str; 6] =
    ["target-error", "time-limit", "first-ray", "of-rays", "paths", "standard-error"];

/// What is traced, how precisely, and when the trace stops.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct TraceArgs {
    /// Rays to launch, at most where a target or a time limit is given: 250000, 1e7, 10M.
    #[arg(
        short = 'n',
        long,
        default_value = "1e6",
        value_parser = count::parse,
        value_name = "N",
        allow_negative_numbers = true
    )]
    pub(crate) num_rays: u64,
    /// Id of the first ray; 0 unless given. Results of disjoint rays can be merged. Rows of ray databases and paths
    /// then stay in memory, to be written with the sums, as with --checkpoint.
    #[arg(long, value_parser = count::parse, value_name = "N")]
    pub(crate) first_ray: Option<u64>,
    /// The rays are a part of a trace of N rays, which the sources share. Needed only to merge results bit for bit, for
    /// a scene of several sources.
    #[arg(long, value_parser = count::parse, value_name = "N")]
    pub(crate) of_rays: Option<u64>,
    /// Stop when every detector's relative error is at most X: 1%, 0.01. Both the error of its flux and the error of
    /// its map count. The latter is the sum of the pixels' standard errors over the sum of their values. Exit code 6 if
    /// the rays or the time end before.
    #[arg(long, value_name = "X", value_parser = quantity::parse_fraction)]
    pub(crate) target_error: Option<f64>,
    /// Stop after this time: 30s, 5m, 1.5h.
    #[arg(long, value_name = "TIME", value_parser = quantity::parse_time)]
    pub(crate) time_limit: Option<Duration>,
    /// Sum second moments, for standard errors of cells and totals: auto does where it costs little. With --sampler
    /// sobol, on scrambles the points in 16 independent ways, and gives the errors between them; auto does not.
    #[arg(long, value_enum, default_value_t = StandardErrorArg::Auto, value_name = "WHEN")]
    pub(crate) standard_error: StandardErrorArg,
    /// Seed of every random draw.
    #[arg(long, default_value_t = 0)]
    pub(crate) seed: u64,
    /// Largest number of events (surfaces and detectors) of a ray. By default twice the number of surfaces that do not
    /// absorb, but at least 16, Optiland's default; with --resume, the file's number.
    #[arg(long, value_name = "N")]
    pub(crate) max_depth: Option<u32>,
    /// Russian roulette starts below this fraction of a new ray's flux, or the scene's rr_start_flux if that is larger.
    #[arg(long, default_value_t = 1e-6, value_name = "X")]
    pub(crate) min_flux_fraction: f64,
    /// Most rays per dispatch. The number changes memory and speed, but not the result.
    #[arg(long, value_parser = count::parse, value_name = "N")]
    pub(crate) batch_size: Option<u64>,
    /// Precision: auto takes the least expensive that keeps positions to a hundredth of a pixel, predicted from the
    /// scene.
    #[arg(long, value_enum, default_value_t = PrecisionArg::Auto)]
    pub(crate) precision: PrecisionArg,
    /// Draws: Optiland's random numbers, or Sobol points, with which a map's error falls faster.
    #[arg(long, value_enum, default_value_t = SamplerArg::Pcg)]
    pub(crate) sampler: SamplerArg,
    /// Neither fuse nor reorder arithmetic, so that every form of the shaders gives the same bits; only on Vulkan.
    #[arg(long, value_enum, default_value_t = StrictArg::Auto, default_missing_value = "on", num_args = 0..=1, require_equals = true)]
    pub(crate) strict: StrictArg,
    /// Sum up light by its path: which surfaces reflected it, let it pass or scattered it, from its source to a detector.
    #[arg(long, value_enum, default_value_t = PathsArg::Off, value_name = "WHEN")]
    pub(crate) paths: PathsArg,
    /// Most rows of the table of paths. Where there are more paths, the ones of most flux among the first 2^20 rays
    /// have a row, and all other light is summed up by its detector.
    #[arg(long, value_parser = count::parse, default_value = "262144", value_name = "N")]
    pub(crate) path_rows: u64,
    /// Keep only the light whose path matches, on maps, spectra, ray databases and in detected flux:
    /// "reflections == 2 and not scattered(mount)".
    #[arg(long = "where", value_name = "EXPR")]
    pub(crate) filter: Option<String>,
    /// Guide rays to rare light, such as the ghosts of coated lenses and what faint scatterers send: to what --where keeps, to
    /// one detector in a table of paths, or else to all detectors. A pilot learns how. Weights make up for it, so all sums
    /// stay right on average. By default a ray may then have four events for each surface, and not two.
    #[arg(long, value_enum, default_value_t = GuideArg::Off, default_missing_value = "on", num_args = 0..=1, require_equals = true,
        value_name = "WHEN", conflicts_with = "guide_from")]
    pub(crate) guide: GuideArg,
    /// Guide rays by this file, which --guide-to wrote: for the parts of a trace, or for two scenes that are compared.
    #[arg(long, value_name = "FILE")]
    pub(crate) guide_from: Option<PathBuf>,
    /// Write what guided the rays to this file. It replaces only a guide.
    #[arg(long, value_name = "FILE", requires = "guide")]
    pub(crate) guide_to: Option<PathBuf>,
    /// Override the scene's rr_start_flux.
    #[arg(long, value_name = "X")]
    pub(crate) rr_start_flux: Option<f64>,
    /// Override the scene's reflect_prob: fresnel, auto or a number in 0..=1.
    #[arg(long, value_name = "P", value_parser = parse_reflect_prob)]
    pub(crate) reflect_prob: Option<ReflectProb>,
    /// Override the scene's split_depth: rays of fewer events are split at refractive surfaces; 0 splits none.
    #[arg(long, value_name = "N")]
    pub(crate) split_depth: Option<u32>,
    /// With this probability rays scatter where a share of the light does, at all surfaces or at one; `*` stands for any
    /// characters. Weights are exact.
    #[arg(long, value_name = "[SURFACE=]P", value_parser = parse_scatter_prob)]
    pub(crate) scatter_prob: Vec<(Option<String>, f64)>,
    /// This share of the rays that a surface scatters goes towards a detector or another surface, 0.5 if none is given. Weights are
    /// exact. Cones, spheres and disks stand in the scene file.
    #[arg(long, value_name = "SURFACE=TARGET[:SHARE]", value_parser = parse_scatter_to)]
    pub(crate) scatter_to: Vec<TargetRequest>,
}

/// The `--precision` argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum PrecisionArg {
    /// f64 on a processor. On a GPU f32, unless the error predicted for the scene is too large; then f64, or df64 where
    /// there is no f64.
    Auto,
    /// 32-bit floats.
    F32,
    /// Pairs of 32-bit floats: 48 bits, on adapters whose arithmetic passes a test.
    Df64,
    /// 64-bit floats.
    F64,
}

/// The `--photometric` argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::Args)]
pub(crate) struct PhotometricArg {
    /// Say results in lumens, lux and candela as well, for any spectrum. `auto` does where a source says its flux in lumens or
    /// its intensity in candela, and where a detector has a color. Light of each wavelength then has pixels of its own while rays are traced.
    #[arg(long = "photometric", value_enum, default_value_t = When::Auto, default_missing_value = "on", num_args = 0..=1,
        require_equals = true, value_name = "WHEN")]
    when: When,
}

/// When results are photometric.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum When {
    /// Where a source says its flux in lumens or its intensity in candela, or a detector has a color.
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

impl PhotometricArg {
    /// The run, whose results are photometric if that is asked for, or if the scene is.
    pub(crate) fn set<'a>(&self, run: Run<'a>) -> Result<Run<'a>> {
        let scene = run.scene();
        if self.is_on(scene.is_photometric()) {
            return run.photometric();
        }
        match scene.color_detectors().first() {
            Some(name) => Err(Error::Usage(format!(
                "--photometric=off: the detector `{}` has a `color`, which is photometric; leave one of them out",
                shown(name)
            ))),
            None => Ok(run),
        }
    }

    /// True if results are photometric, of a scene that is photometric or not.
    pub(crate) fn is_on(self, is_photometric: bool) -> bool {
        self.when == When::On || (self.when == When::Auto && is_photometric)
    }

    /// True if somebody asks for it.
    pub(crate) fn is_asked_for(&self) -> bool {
        self.when == When::On
    }
}

/// The `--guide` argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum GuideArg {
    /// A pilot learns a guide.
    On,
    /// Rays choose their branches as light does.
    Off,
}

/// The `--paths` argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum PathsArg {
    /// Paths are summed up.
    On,
    /// Paths are not followed.
    Off,
}

/// The `--strict` argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum StrictArg {
    /// On processors, where it costs nothing.
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

/// The `--sampler` argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum SamplerArg {
    /// Optiland's keyed PCG32, bit for bit.
    Pcg,
    /// Owen-scrambled Sobol points, one point a ray.
    Sobol,
}

/// The `--standard-error` argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum StandardErrorArg {
    /// Where every detector ends a ray and takes it in one cell, and always with --target-error. Where surfaces scatter
    /// by a table or a Harvey-Shack lobe, also in up to four cells.
    Auto,
    /// Always, even where rays are spread over pixels or pass detectors.
    On,
    /// Never.
    Off,
}

fn parse_reflect_prob(text: &str) -> std::result::Result<ReflectProb, String> {
    match text {
        "fresnel" => Ok(ReflectProb::Fresnel),
        "auto" => Ok(ReflectProb::Auto),
        number => match number.parse::<f64>() {
            Ok(p) if (0.0..=1.0).contains(&p) => Ok(ReflectProb::Constant(p)),
            _ => Err(format!("`{text}` is neither fresnel, auto nor a number in 0..=1")),
        },
    }
}

fn parse_scatter_prob(text: &str) -> std::result::Result<(Option<String>, f64), String> {
    let (name, number) = text.rsplit_once('=').map_or((None, text), |(name, number)| (Some(name), number));
    let prob = number.parse().map_err(|_| format!("`{number}` is no number; write 0.5, or M1=0.5"))?;
    Ok((name.map(str::to_owned), prob))
}

fn parse_scatter_to(text: &str) -> std::result::Result<TargetRequest, String> {
    let form = || {
        format!(
            "`{text}` names no target; write SURFACE=TARGET or SURFACE=TARGET:SHARE, such as M1=image:0.5"
        )
    };
    let (surface, rest) = text.split_once('=').ok_or_else(form)?;
    let (target, share) = match rest.rsplit_once(':') {
        Some((target, share)) => (target, share.parse().map_err(|_| form())?),
        None => (rest, DEFAULT_SHARE),
    };
    Ok(TargetRequest { surface: surface.into(), target: RequestedTarget::Named(target.into()), share })
}

/// The precision that the argument asks for.
pub fn wanted(precision: PrecisionArg) -> WantedPrecision {
    match precision {
        PrecisionArg::F32 => WantedPrecision::Exactly(Precision::F32),
        PrecisionArg::Df64 => WantedPrecision::Exactly(Precision::Df64),
        PrecisionArg::F64 => WantedPrecision::Exactly(Precision::F64),
        PrecisionArg::Auto => WantedPrecision::Auto,
    }
}

impl TraceArgs {
    /// Most rows of the table of paths.
    pub(crate) fn path_rows(&self) -> Result<u32> {
        let rows = u32::try_from(self.path_rows).ok().filter(|rows| (1..=MOST_PATH_ROWS).contains(rows));
        rows.ok_or_else(|| {
            Error::Usage(format!("--path-rows is {}; it must lie in 1..={MOST_PATH_ROWS}", self.path_rows))
        })
    }

    /// The run, with what these arguments ask for.
    pub(crate) fn set<'a>(&self, run: Run<'a>) -> Result<Run<'a>> {
        let options = self.options(run.model())?;
        self.set_others(run.options(options), None)
    }

    /// The run, with what these arguments ask for but for its options. Rays are guided to a detector, if to one.
    pub(crate) fn set_others<'a>(&self, run: Run<'a>, detector: Option<usize>) -> Result<Run<'a>> {
        let filter = run.options_so_far().path_filter.clone();
        let guided_to = Wanted { detector, filter, ..Wanted::default() };
        let mut run = run.precision(wanted(self.precision));
        if let Some(path) = &self.guide_from {
            run = run.guide_by(Arc::new(Guide::read(path)?));
        } else if self.guide == GuideArg::On {
            run = run.guide(guided_to);
        }
        if let Some(max_depth) = self.max_depth {
            run = run.max_depth(max_depth);
        }
        if let Some(limit) = self.time_limit {
            run = run.time_limit(limit);
        }
        match self.target_error {
            Some(target) => run.target_error(target),
            None => Ok(run),
        }
    }

    pub(crate) fn options(&self, ir: &SceneIr) -> Result<TraceOptions> {
        if self.standard_error == StandardErrorArg::Off && self.target_error.is_some() {
            return Err(Error::Usage(
                "--target-error needs standard errors; leave out --standard-error off".into(),
            ));
        }
        let filter = self.filter.as_ref().map(|text| PathFilter::parse(text, ir)).transpose()?;
        let rows = self.path_rows()?;
        Ok(TraceOptions {
            collect: match self.paths {
                PathsArg::On => Collect::Paths { rows, ends: false },
                PathsArg::Off => Collect::Light,
            },
            path_filter: filter.map(Arc::new),
            num_rays: self.num_rays,
            seed: self.seed,
            min_flux_fraction: self.min_flux_fraction,
            batch_size: self.batch_size.map(|n| n.min(u64::from(u32::MAX)) as u32),
            sampler: match self.sampler {
                SamplerArg::Pcg => Sampler::Pcg,
                SamplerArg::Sobol => Sampler::Sobol,
            },
            strict: match self.strict {
                StrictArg::Auto => Strict::Auto,
                StrictArg::On => Strict::On,
                StrictArg::Off => Strict::Off,
            },
            first_ray: self.first_ray.unwrap_or(0),
            of_rays: self.of_rays,
            standard_error: match self.standard_error {
                StandardErrorArg::Auto => StandardError::Auto,
                StandardErrorArg::On => StandardError::On,
                StandardErrorArg::Off => StandardError::Off,
            },
            ..Default::default()
        })
    }

    /// The first option given that belongs to a single trace: when it ends, which part it is, what else it sums up. Commands
    /// that trace several times refuse what they cannot hand on.
    pub(crate) fn of_one_trace(&self) -> Option<&'static str> {
        let given = [
            self.target_error.is_some(),
            self.time_limit.is_some(),
            self.first_ray.is_some(),
            self.of_rays.is_some(),
            self.paths == PathsArg::On,
            self.standard_error == StandardErrorArg::On,
        ];
        OF_ONE_TRACE.into_iter().zip(given).find_map(|(name, is_given)| is_given.then_some(name))
    }

    /// Leaves options that a command refuses out of its help: options of one trace but for `kept`, --guide-to, and `refused`.
    pub(crate) fn in_help(arg: clap::Arg, kept: &[&str], refused: &[&str]) -> clap::Arg {
        let is_hidden = arg.get_long().is_some_and(|name| {
            let is_of_one_trace = OF_ONE_TRACE.contains(&name) && !kept.contains(&name);
            is_of_one_trace || name == "guide-to" || refused.contains(&name)
        });
        if is_hidden { arg.hide(true) } else { arg }
    }

    /// Refuses the file of a guide where none is written. `of` says what writes none.
    pub(crate) fn refuse_guide_to(&self, of: &str) -> Result<()> {
        match self.guide_to {
            Some(_) => Err(Error::Usage(format!(
                "{of} writes no guide; let `nsq-gpu trace SCENE --guide --guide-to FILE` write it, and give it by --guide-from FILE"
            ))),
            None => Ok(()),
        }
    }

    /// The file to which what guided the rays is to go, if there is one.
    pub(crate) fn guide_file(&self, scene: &Path) -> Result<Option<OutputFile>> {
        let place = |path: &PathBuf| OutputFile::new(path, false, scene, |path| Guide::read(path).is_ok());
        self.guide_to.as_ref().map(place).transpose()
    }

    /// What is wrong with an option of scattering, with the option.
    fn scattering(&self, Refusal { key, problem, remedy }: Refusal) -> Error {
        let number = key.split(['[', ']']).nth(1).and_then(|number| number.parse::<usize>().ok());
        let option = match number.and_then(|number| self.scatter_to.get(number)) {
            Some(TargetRequest { surface, target: RequestedTarget::Named(target), .. }) => {
                format!("--scatter-to {surface}={target}")
            }
            _ => "--scatter-prob".into(),
        };
        Error::Usage(format!("{option}: {problem}; {remedy}"))
    }

    /// Overrides the sampling of a scene. Options of scattering take the place of the file's.
    pub(crate) fn override_sampling(&self, ir: &mut SceneIr) -> Result<()> {
        if let Some(reflect_prob) = self.reflect_prob {
            ir.sampling.reflect_prob = reflect_prob;
        }
        if !self.scatter_prob.is_empty() || !self.scatter_to.is_empty() {
            let found = resolve(ir, &self.scatter_prob, &self.scatter_to)
                .map_err(|refusal| self.scattering(refusal))?;
            set(ir, found);
        }
        if let Some(rr_start_flux) = self.rr_start_flux {
            if !(0.0..=1e30).contains(&rr_start_flux) {
                return Err(Error::Usage(format!(
                    "--rr-start-flux is {rr_start_flux}; it must lie in 0..=1e30"
                )));
            }
            ir.sampling.rr_start_flux = rr_start_flux;
        }
        if let Some(split_depth) = self.split_depth {
            if split_depth > Sampling::MAX_SPLIT_DEPTH {
                let most = Sampling::MAX_SPLIT_DEPTH;
                return Err(Error::Usage(format!(
                    "--split-depth is {split_depth}; it must lie in 0..={most}"
                )));
            }
            ir.sampling.split_depth = split_depth;
        }
        Ok(())
    }
}

/// Writes what guided the rays of a trace.
pub(crate) fn write_guide(file: Option<OutputFile>, options: &TraceOptions) -> Result<()> {
    match (file, &options.guide) {
        (Some(file), Some(guide)) => file.write(guide.to_json()?.as_bytes()).map(drop),
        _ => Ok(()),
    }
}
