//! Sweeps: runs of one scene with other numbers.
//!
//! A compiled shader serves all points. A point that cannot be, such as a lens of negative thickness, is kept with the
//! reason, and the others are traced.

mod values;

pub use crate::run::sweep::values::{
    Axis, Distribution, MOST_POINTS, NamedNumbers, Tolerance, combinations, samples,
};

use crate::error::{Error, Result};
use crate::format::shown;
use crate::result::{FewRays, TraceResult};
use crate::run::{Next, Run, Session, Status};
use crate::scene::Scene;
use std::path::PathBuf;

/// A scene and the points at which it is traced.
#[derive(Debug, Clone, Default)]
pub struct Sweep {
    /// The text of the scene.
    pub text: String,
    /// The folder from which files are looked for that the scene names.
    pub folder: PathBuf,
    /// What errors call the scene.
    pub name: String,
    /// What is set at each point: [`combinations`] of values, or [`samples`] of tolerances.
    pub points: Vec<NamedNumbers>,
    /// The first point is the scene as it is.
    pub has_nominal: bool,
}

/// What a sweep found: the points that were traced, and those that cannot be.
#[derive(Debug)]
pub struct Swept {
    /// How many points there were to be, without the scene as it is.
    pub num_points: usize,
    /// The scene as it is, of tolerances.
    pub nominal: Option<SweepPoint>,
    /// The points.
    pub points: Vec<SweepPoint>,
    /// What ended the sweep before its last point. The points before it took their time, and are kept.
    pub failure: Option<Error>,
}

/// What was set at a point, and what was found.
#[derive(Debug, Clone)]
pub struct SweepPoint {
    /// Its place among all points, from 0 on.
    pub index: usize,
    /// What was set.
    pub numbers: NamedNumbers,
    /// What was found, or why the point cannot be.
    pub outcome: std::result::Result<SweepFluxes, String>,
}

/// The fluxes of a point that was traced.
#[derive(Debug, Clone)]
pub struct SweepFluxes {
    /// The seed of the draws.
    pub seed: u64,
    /// Rays launched.
    pub num_rays: u64,
    /// The flux on each detector, then totals.
    pub fluxes: Vec<SweepFlux>,
}

/// A flux of a point.
#[derive(Debug, Clone)]
pub struct SweepFlux {
    /// The name of its detector, or of a total.
    pub name: String,
    /// \[W\]
    pub flux: f64,
    /// Its standard error \[W\], where that is known.
    pub error: Option<f64>,
    /// What is known of a flux that rests on few rays.
    pub few_rays: Option<FewRays>,
}

/// A flux over the samples of tolerances.
#[derive(Debug, Clone)]
pub struct Quantiles {
    /// The name of its detector, or of a total.
    pub name: String,
    /// The flux of the scene as it is \[W\].
    pub nominal: f64,
    /// The least, the quantiles of 5, 50 and 95 %, and the most \[W\]. `None` if there is no sample.
    pub quantiles: [Option<f64>; 5],
}

impl Sweep {
    /// Traces every point. `ask` gets the place and the run of each point, and may ask for more. `next` gets how far a
    /// point's trace has come, and says how to go on. A point that is cancelled is left out, and ends the sweep.
    /// `after_point` gets each result.
    pub fn go(
        self,
        session: &mut Session,
        mut ask: impl for<'r> FnMut(usize, Run<'r>) -> Result<Run<'r>>,
        mut next: impl FnMut(&Status) -> Next,
        mut after_point: impl FnMut(&TraceResult),
    ) -> Swept {
        let Sweep { text, folder, name, points, has_nominal } = self;
        let num_before = usize::from(has_nominal);
        let num_points = points.len().saturating_sub(num_before);
        let (mut found, mut failure) = (Vec::new(), None);
        for (place, numbers) in points.into_iter().enumerate() {
            let mut trace = || {
                if let Some((name, value)) = numbers.iter().find(|(_, value)| !value.is_finite()) {
                    return Err(Error::scene(shown(name), format!("is {value}"), "give a finite number"));
                }
                let scene = Scene::with_numbers(&text, &folder, &numbers);
                let run = Run::new(scene.map_err(|error| error.in_scene(&name))?)?;
                let run = session.run(ask(place, run)?, None)?;
                run.go_with(|pass| Ok(next(&pass.status)))
            };
            let outcome = match trace() {
                Ok(outcome) => {
                    after_point(&outcome.result);
                    Ok(SweepFluxes::of(&outcome.result))
                }
                Err(Error::Scene { place, problem, remedy }) => Err(format!("{place}: {problem}; {remedy}")),
                Err(error) => {
                    failure = Some(error);
                    break;
                }
            };
            // Samples are counted without the scene as it is, which comes first.
            found.push(SweepPoint { index: place.saturating_sub(num_before), numbers, outcome });
        }
        let nominal = (has_nominal && !found.is_empty()).then(|| found.remove(0));
        Swept { num_points, nominal, points: found, failure }
    }
}

impl SweepFluxes {
    fn of(result: &TraceResult) -> Self {
        let detectors = result.detectors.iter().map(|detector| SweepFlux {
            name: detector.name.clone(),
            flux: detector.total_flux,
            error: detector.total_flux_standard_error,
            few_rays: detector.few_rays,
        });
        let totals = [
            ("absorbed", result.total_flux_absorbed),
            ("bulk absorbed", result.total_flux_bulk_absorbed),
            ("escaped", result.total_flux_escaped),
            ("lost", result.total_flux_lost),
        ];
        // A detector may have the name of a total.
        let label = |name: &str| match result.detector(name) {
            Some(_) => format!("{name} (total)"),
            None => name.into(),
        };
        let totals =
            totals.map(|(name, flux)| SweepFlux { name: label(name), flux, error: None, few_rays: None });
        SweepFluxes {
            seed: result.run.seed,
            num_rays: result.num_rays_total,
            fluxes: detectors.chain(totals).collect(),
        }
    }
}

impl SweepPoint {
    /// What was found, if the point was traced.
    pub fn traced(&self) -> Option<&SweepFluxes> {
        self.outcome.as_ref().ok()
    }
}

impl Swept {
    /// True if a stop came before the last point.
    pub fn is_partial(&self) -> bool {
        self.points.len() < self.num_points
    }

    /// The points that cannot be.
    pub fn refused(&self) -> impl Iterator<Item = &SweepPoint> {
        self.points.iter().filter(|point| point.outcome.is_err())
    }

    /// Each flux over the samples of tolerances.
    pub fn quantiles(&self) -> Vec<Quantiles> {
        let nominal =
            self.nominal.as_ref().and_then(SweepPoint::traced).map_or(&[][..], |traced| &traced.fluxes);
        let rows = nominal.iter().enumerate().map(|(i, SweepFlux { name, flux, .. })| {
            let traced = self.points.iter().filter_map(SweepPoint::traced);
            let mut values: Vec<f64> = traced.map(|traced| traced.fluxes[i].flux).collect();
            values.sort_by(f64::total_cmp);
            // Between two samples the quantile is interpolated (Hyndman and Fan 1996, definition 7).
            let quantile = |share: f64| {
                let place = share * (values.len().saturating_sub(1)) as f64;
                let (low, high) = (place.floor() as usize, place.ceil() as usize);
                Some(values.get(low)? + (values.get(high)? - values.get(low)?) * place.fract())
            };
            let quantiles = [0.0, 0.05, 0.5, 0.95, 1.0].map(quantile);
            Quantiles { name: name.clone(), nominal: *flux, quantiles }
        });
        rows.collect()
    }
}
