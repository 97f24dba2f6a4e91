//! Signs that a result should be read with care: Optiland's figures and thresholds, and those of the exact ledger.

use serde::{Deserialize, Serialize};

use crate::result::format::{percent, shown, significant, thousands};
use crate::result::{Detector, DetectorData, StageTime, Tally, TraceResult};
use crate::stopping::StoppedBy;

/// Warn when more than this fraction of the launched flux ended at the depth limit: the result is biased low.
const DEPTH_TRUNCATION: f64 = 1e-3;
/// Warn when Optiland's flux conservation error is above this.
const FLUX_CONSERVATION: f64 = 0.05;
/// Warn when roulette ended more than this fraction of the launched flux: unbiased, but noisy.
const ROULETTE: f64 = 1e-3;
/// Below this mean number of hits per pixel shot noise dominates a map (32 % at 10 hits).
const UNDERSAMPLED_HITS: f64 = 10.0;
/// Hits per pixel for 5 % relative error: 1 / 0.05^2.
const TARGET_HITS: f64 = 400.0;

/// How well one detector was sampled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DetectorDiagnostic {
    /// The detector.
    pub name: String,
    /// Rays recorded; 0 for a ray database, as in Optiland, whose database keeps no count. The table of detectors has
    /// the true number.
    pub num_rays_hit: u64,
    /// Pixels or directions; none for a ray database.
    pub num_pixels: Option<u64>,
    /// `num_rays_hit / num_pixels`; none for a ray database.
    pub mean_hits_per_pixel: Option<f64>,
    /// True below 10 mean hits per pixel.
    pub undersampled: bool,
    /// Rays that would bring the mean relative error to 5 %; none for a ray database or without any hit.
    pub rays_needed_for_5pct: Option<u64>,
}

/// Optiland's `Diagnostics`, field by field, and the warnings that follow.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Diagnostics {
    /// Fraction of the launched flux that ended at the depth limit.
    pub depth_truncated_flux_fraction: f64,
    /// Fraction of the launched flux that Russian roulette ended.
    pub rr_killed_flux_fraction: f64,
    /// Copy of [`TraceResult::flux_conservation_error`].
    pub flux_conservation_error: f64,
    /// Surfaces that no ray hit.
    pub unreached_geometry: Vec<String>,
    /// Detectors in scene order.
    pub detectors: Vec<DetectorDiagnostic>,
    /// Rays that left a solid which they had never entered.
    pub medium_stack_underflows: u64,
    /// True if some launched ray had no more rays in its budget where it was to be split: there branches were drawn.
    pub split_budget_saturated: bool,
    /// What the stages took on the device; left out unless they were timed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stage_times: Vec<StageTime>,
    /// One sentence per finding, the gravest first.
    pub warnings: Vec<String>,
}

impl DetectorDiagnostic {
    fn new(detector: &Detector, num_rays_total: u64) -> Self {
        let num_rays_hit = match detector.data {
            DetectorData::RayDatabase(_) => 0,
            DetectorData::Irradiance(_) | DetectorData::Spectral(_) | DetectorData::FarField(_) => {
                detector.num_rays_hit
            }
        };
        let num_pixels = detector.data.num_pixels();
        let mean = num_pixels.map(|pixels| num_rays_hit as f64 / pixels as f64);
        DetectorDiagnostic {
            name: detector.name.clone(),
            num_rays_hit,
            num_pixels,
            mean_hits_per_pixel: mean,
            undersampled: mean.is_some_and(|mean| mean < UNDERSAMPLED_HITS),
            rays_needed_for_5pct: mean
                .filter(|mean| *mean > 0.0)
                .map(|mean| (num_rays_total as f64 * (TARGET_HITS / mean)) as u64),
        }
    }

    fn warning(&self) -> Option<String> {
        let mean = self.mean_hits_per_pixel.filter(|mean| self.undersampled && *mean > 0.0)?;
        let remedy = self.rays_needed_for_5pct.map_or(String::new(), |rays| {
            format!("; about {} rays would bring the mean error to 5 %", thousands(rays))
        });
        Some(format!(
            "detector '{}' is undersampled: {} hits per pixel on average (below {UNDERSAMPLED_HITS}), so that its map is \
             mostly shot noise{remedy}",
            shown(&self.name),
            significant(mean, 3),
        ))
    }
}

impl Diagnostics {
    pub(crate) fn new(result: &TraceResult, tally: &Tally) -> Self {
        let unreached = result.surfaces.iter().filter(|surface| !surface.reached);
        let mut diagnostics = Diagnostics {
            depth_truncated_flux_fraction: result.fraction_of_launched(result.ledger.depth.flux),
            rr_killed_flux_fraction: result.fraction_of_launched(result.ledger.roulette_loss.flux),
            flux_conservation_error: result.flux_conservation_error,
            unreached_geometry: unreached.map(|surface| surface.name.clone()).collect(),
            detectors: result
                .detectors
                .iter()
                .map(|detector| DetectorDiagnostic::new(detector, result.num_rays_total))
                .collect(),
            medium_stack_underflows: tally.medium_stack_underflows,
            split_budget_saturated: tally.split_budget_saturated,
            stage_times: result.run.stage_times.clone(),
            warnings: Vec::new(),
        };
        diagnostics.warnings = diagnostics.all_warnings(result);
        diagnostics
    }

    fn all_warnings(&self, result: &TraceResult) -> Vec<String> {
        let mut warnings = broken_books(result);
        warnings.extend(partial(result));
        warnings.extend(result.run.precision_warning.iter().cloned());
        warnings.extend(result.run.scene_warnings.iter().cloned());
        warnings.extend(self.flux_warnings(result.ledger.closes()));
        warnings.extend(self.unreached());
        warnings.extend(unlit(result));
        warnings.extend(self.detectors.iter().filter_map(DetectorDiagnostic::warning));
        warnings.extend(result.detectors.iter().filter_map(truncated_database));
        warnings.extend(self.underflows());
        warnings.extend(self.saturated());
        warnings
    }

    fn flux_warnings(&self, ledger_closes: bool) -> Vec<String> {
        let mut warnings = Vec::new();
        if self.depth_truncated_flux_fraction > DEPTH_TRUNCATION {
            warnings.push(format!(
                "{} of the launched flux ended at the depth limit: paths with more events are missing; raise max_depth if \
                 they matter",
                percent(self.depth_truncated_flux_fraction)
            ));
        }
        if self.flux_conservation_error > FLUX_CONSERVATION {
            let meaning = if ledger_closes {
                "the exact ledger closes, so this is flux that Optiland's formula has no term for: loss at mirrors, \
                 coatings and scattering surfaces, and weight gained or lost by roulette and importance sampling"
            } else {
                "the exact ledger does not close either"
            };
            warnings.push(format!(
                "flux_conservation_error, Optiland's figure, is {}: {meaning}",
                percent(self.flux_conservation_error)
            ));
        }
        if self.rr_killed_flux_fraction > ROULETTE {
            warnings.push(format!(
                "Russian roulette ended {} of the launched flux: unbiased, but noisy; lower rr_start_flux if the noise \
                 matters",
                percent(self.rr_killed_flux_fraction)
            ));
        }
        warnings
    }

    fn unreached(&self) -> Option<String> {
        (!self.unreached_geometry.is_empty()).then(|| {
            format!(
                "no ray hit {} surface(s): {}; check where they stand and how they are turned, unless they are spare",
                self.unreached_geometry.len(),
                self.unreached_geometry.iter().map(|name| shown(name)).collect::<Vec<_>>().join(", ")
            )
        })
    }

    fn saturated(&self) -> Option<String> {
        self.split_budget_saturated.then(|| {
            "splitting used up the split_budget of some launched rays, whose later branches were drawn: unbiased, but \
             noisier; raise split_budget if the noise matters"
                .into()
        })
    }

    fn underflows(&self) -> Option<String> {
        (self.medium_stack_underflows > 0).then(|| {
            format!(
                "{} time(s) a ray left a solid that it had never entered: expected of rays born inside a solid, where faces \
                 of a solid scatter, and at a lone face in air, such as a coated pellicle; otherwise the sides of some \
                 surface have the wrong media",
                thousands(self.medium_stack_underflows)
            )
        })
    }
}

/// What must never happen, in capitals, because no figure of such a result can be trusted.
fn broken_books(result: &TraceResult) -> Vec<String> {
    let ledger = &result.ledger;
    let mut warnings = Vec::new();
    if ledger.imbalance_quanta != 0 {
        warnings.push(format!(
            "THE LEDGER DOES NOT CLOSE: {} quanta ({} W) unaccounted for; this is a defect of the program, please report \
             it with the scene",
            ledger.imbalance_quanta,
            significant(ledger.imbalance_flux, 6)
        ));
    }
    if ledger.invalid_deposits > 0 {
        warnings.push(format!(
            "INVALID DEPOSITS: {} deposits were not finite or too large for any sum, or rays ended nowhere; this is a \
             defect of the program, please report it with the scene",
            thousands(ledger.invalid_deposits)
        ));
    }
    if !result.run.partial && result.num_rays_total != result.run.num_rays {
        warnings.push(format!(
            "RAYS ARE MISSING: {} launched, {} requested; this is a defect of the program, please report it with the scene",
            thousands(result.num_rays_total),
            thousands(result.run.num_rays)
        ));
    }
    warnings
}

fn partial(result: &TraceResult) -> Option<String> {
    let why = match result.run.stopped_by {
        Some(StoppedBy::TargetError) => return None,
        Some(StoppedBy::TimeLimit) => "stopped at the time limit",
        Some(StoppedBy::Interrupt) | None => "partial result",
    };
    result.run.partial.then(|| {
        format!(
            "{why}: {} of {} rays; fluxes are scaled to all that the sources emit",
            thousands(result.num_rays_total),
            thousands(result.run.num_rays)
        )
    })
}

fn unlit(result: &TraceResult) -> Option<String> {
    let unlit = result.detectors.iter().filter(|detector| detector.num_rays_hit == 0);
    let names: Vec<String> = unlit.map(|detector| shown(&detector.name)).collect();
    (!names.is_empty()).then(|| {
        format!(
            "no ray reached {} detector(s): {}; check where they stand and how they are turned",
            names.len(),
            names.join(", ")
        )
    })
}

fn truncated_database(detector: &Detector) -> Option<String> {
    match &detector.data {
        DetectorData::RayDatabase(rays) if rays.truncated => Some(format!(
            "ray database '{}' kept the last {} of {} rays: its total_flux counts the kept rays only, the ledger all",
            shown(&detector.name),
            thousands(rays.num_rays()),
            thousands(detector.num_rays_hit)
        )),
        DetectorData::RayDatabase(_)
        | DetectorData::Irradiance(_)
        | DetectorData::Spectral(_)
        | DetectorData::FarField(_) => None,
    }
}
