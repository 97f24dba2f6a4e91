//! Which surfaces are to blame for stray light: those that a source lights, those that a detector sees, and those that are both.
//!
//! A surface that a source lights and that a detector sees can send light after one scattering. That is the first list of a stray-light
//! analysis: illuminated and critical objects (Fest, Stray Light Analysis and Control, SPIE 2013, section 1.3).

use crate::error::{Error, Result};
use crate::format::shown;
use crate::model::key_path::did_you_mean;
use crate::model::shapes::Outline;
use crate::model::sources::extended::Extended;
use crate::model::{Frame, Interaction, SceneIr, Source, SourceKind, Step, StepKind};
use crate::result::Tally;
use crate::run::pst::is_far_field;
use crate::run::rounds::{Rounds, in_rounds};
use crate::run::{Collect, Next, RecordPaths, Run, Session, Status, TraceOptions};
use crate::scene::Scene;
use glam::{DMat3, DVec3};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::f64::consts::FRAC_PI_2;
use std::time::Duration;

/// What a surface has to do with a detector.
#[derive(Debug, Clone, PartialEq)]
pub struct Blame {
    /// The surface.
    pub name: String,
    /// The flux that the sources send there, straight or by mirrors and lenses, and not by scattering \[W\].
    pub receives: f64,
    /// The detected flux that scattered at this surface, first or later \[W\], and its standard error between rounds of rays.
    pub sends: [f64; 2],
    /// The share of the detector's view that the surface fills, straight or by mirrors and lenses. Directions count by their cosine.
    pub seen: f64,
}

/// A surface that scatters at least so much of its light ends specular paths.
const SCATTERS_MOST: f64 = 0.5;
/// Most rays of the traces that record where rays go.
const MOST_RECORDED: u64 = 200_000;

/// What each surface has to do with a detector. The surfaces that send most to the detector come first. `model` is what
/// [`Scene::lower`] made of `scene`. `options` say how many rays are traced, and their table of paths has `path_rows`
/// rows. `ask` and `next` are as in [`crate::run::pst::Pst::go`].
///
/// # Errors
/// [`Error::Usage`] if there is no such detector. [`Error::Interrupted`] if a trace was cancelled. The errors of
/// [`Run::go`].
pub fn blame(
    (scene, model): (&Scene, &SceneIr),
    detector: &str,
    session: &mut Session,
    (options, path_rows): (&TraceOptions, u32),
    mut ask: impl for<'r> FnMut(Run<'r>) -> Result<Run<'r>>,
    mut next: impl FnMut(&Status) -> Next,
) -> Result<Vec<Blame>> {
    let names = || model.detectors.iter().map(|detector| detector.name.as_str());
    let number = names().position(|name| name == detector).ok_or_else(|| {
        Error::Usage(format!("`{}` is no detector; {}", shown(detector), did_you_mean(detector, names())))
    })?;
    let specular = without_scattering(model);
    let backward = backward(&specular, number)?;
    let mut go = |model: &SceneIr, options: TraceOptions, record: RecordPaths| {
        let run = Run::of(scene, model).options(options);
        let run = session.run(ask(run)?, None)?.record_paths(record);
        run.go_with(|pass| Ok(next(&pass.status)))
    };
    let recorded = |num_rays: u64| TraceOptions {
        num_rays: num_rays.min(MOST_RECORDED),
        collect: Collect::Light,
        path_filter: None,
        guide: None,
        ..options.clone()
    };
    let lit = go(&specular, recorded(options.num_rays), RecordPaths::All)?;
    let seen = go(&backward, recorded(options.num_rays), RecordPaths::All)?;
    let receives = met(&lit.result, false)?;
    let seen = met(&seen.result, true)?;
    let by_path = in_rounds(TraceOptions {
        collect: Collect::Paths { rows: path_rows, ends: false },
        ..options.clone()
    });
    let run = session.run(ask(Run::of(scene, model).options(by_path))?, None)?;
    let mut rounds = Rounds::default();
    run.pass_time(Duration::ZERO).go_with(|pass| {
        let wanted = next(&pass.status);
        let tally = pass.tally()?;
        rounds.add(tally, scattered(tally, number));
        Ok(wanted)
    })?;
    let of = |surface: usize| {
        let name = model.surface_name(surface);
        Blame {
            receives: receives.get(&name).copied().unwrap_or(0.0),
            sends: rounds.share(&surface).map(|share| share * model.emitted_flux()),
            seen: seen.get(&name).copied().unwrap_or(0.0),
            name,
        }
    };
    let mut found: Vec<Blame> = (0..model.surfaces.len()).map(of).collect();
    found.sort_by(|one, other| {
        let key = |blame: &Blame| [blame.sends[0], blame.receives * blame.seen, blame.receives, blame.seen];
        key(other).partial_cmp(&key(one)).unwrap_or(std::cmp::Ordering::Equal)
    });
    Ok(found)
}

/// The light on a detector by each surface that scattered it \[quanta\]. Light that several scattered counts for each.
fn scattered(tally: &Tally, detector: usize) -> BTreeMap<usize, f64> {
    let mut light = BTreeMap::new();
    let Some(sums) = &tally.path_sums else { return light };
    for (sequence, sum) in sums.rows.iter().filter(|(sequence, _)| sequence.end.detector() == Some(detector))
    {
        let scatters =
            |step: &&Step| matches!(step.kind, StepKind::ScatteredBack | StepKind::ScatteredThrough);
        let surfaces: BTreeSet<usize> =
            sequence.steps.iter().filter(scatters).map(|step| step.surface as usize).collect();
        for surface in surfaces {
            *light.entry(surface).or_default() += sum.quanta as f64;
        }
    }
    light
}

/// The flux that surfaces meet, by their names; or the share of all flux, of which each ray counts once.
fn met(result: &crate::result::TraceResult, as_share: bool) -> Result<HashMap<String, f64>> {
    let Some(paths) = &result.ray_paths else { return Ok(HashMap::new()) };
    let columns = paths.columns()?;
    let mut flux: HashMap<String, f64> = HashMap::new();
    let mut known: HashMap<(i64, &str), ()> = HashMap::new();
    let mut all = 0.0;
    for (i, kind) in columns.event_type.iter().enumerate() {
        let name = columns.component_name[i].as_str();
        match *kind {
            "birth" => all += columns.flux[i],
            "hit" if !as_share || known.insert((columns.ray_id[i], name), ()).is_none() => {
                *flux.entry(name.into()).or_default() += columns.flux[i];
            }
            _ => {}
        }
    }
    if as_share && all > 0.0 {
        flux.values_mut().for_each(|value| *value /= all);
    }
    Ok(flux)
}

/// The scene with specular light alone: what scatters most of its light absorbs.
fn without_scattering(model: &SceneIr) -> SceneIr {
    let mut specular = model.clone();
    for surface in &mut specular.surfaces {
        if surface.scatter.take().is_some_and(|scatter| scatter.fraction >= SCATTERS_MOST) {
            surface.interaction = Interaction::Absorbing;
            surface.coating = None;
        }
    }
    specular.scatter_sampling.clear();
    specular
}

/// The scene with the detector as the source, to both of its sides.
fn backward(specular: &SceneIr, number: usize) -> Result<SceneIr> {
    let mut model = specular.clone();
    let detector = model.detectors.remove(number);
    let area = detector.outline();
    if area == Outline::Infinite || is_far_field(&detector.kind) {
        return Err(Error::Usage(format!(
            "the detector `{}` has no area, so that nothing can be said of what it sees; name one of type irradiance",
            shown(&detector.name)
        )));
    }
    let template = model.sources.first().cloned();
    let Some(template) = template else { return Ok(model) };
    let side = |rotation: DMat3| Source {
        name: format!("{} {}", detector.name, if rotation == DMat3::IDENTITY { "front" } else { "back" }),
        frame: Frame { rotation: detector.frame.rotation * rotation, ..detector.frame },
        kind: SourceKind::Extended(Extended { area, half_angle: FRAC_PI_2 }),
        total_flux: 0.5,
        ..template.clone()
    };
    model.sources = vec![side(DMat3::IDENTITY), side(DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)))];
    Ok(model)
}
