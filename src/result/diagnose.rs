//! What should be read with care in a result, with Optiland's thresholds.

use crate::format::{listed, percent, shown, significant, thousands};
use crate::model::sequence::Sequence;
use crate::model::surface_optics::branches_scatter;
use crate::model::{SceneIr, depth};
use crate::result::wrong_side_warnings;
use crate::result::{
    Detector, DetectorDiagnostic, DetectorTally, Diagnostics, StoppedBy, Tally, TraceResult, Uncertainty,
};

/// Warn when more than this fraction of the launched flux ended at the depth limit: the result is biased low.
const DEPTH_TRUNCATION: f64 = 1e-3;
/// Warn when roulette ended more than this fraction of the launched flux: unbiased, but noisy.
const ROULETTE: f64 = 1e-3;
/// Optiland calls a detector undersampled below this mean number of hits per pixel.
const UNDERSAMPLED_HITS: f64 = 10.0;
/// Warn when the error of a map is above this: the error of 10 hits in each lit pixel.
const UNDERSAMPLED_ERROR: f64 = 0.32;
/// The warning says how many rays bring it to this.
const GOOD_ERROR: f64 = 0.05;
/// Hits per pixel for 5 % relative error: 1 / 0.05^2.
const TARGET_HITS: f64 = 400.0;

impl DetectorDiagnostic {
    fn new(detector: &Detector, num_rays_total: u64) -> Self {
        let num_pixels = detector.data.num_pixels();
        // Optiland's ray database keeps no count.
        let num_rays_hit = num_pixels.map_or(0, |_| detector.num_rays_hit);
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
}

/// Says which maps are mostly noise. Where second moments were not summed, a cell's error is its value over the root of its
/// hits.
fn undersampled(
    detector: &Detector,
    sums: &DetectorTally,
    uncertainty: &Uncertainty,
    num_rays: u64,
) -> Option<String> {
    if detector.few_rays.is_some() {
        return None;
    }
    let map = uncertainty.of_map(sums).or_else(|| uncertainty.of_map_by_hits(sums))?;
    let error = Some(map.relative()).filter(|error| error.is_finite() && *error > UNDERSAMPLED_ERROR)?;
    let remedy = map.factor_to(GOOD_ERROR).map_or(String::new(), |factor| {
        format!("; about {} rays would bring it to 5 %", thousands(rounded(num_rays as f64 * factor)))
    });
    Some(format!(
        "detector '{}' is undersampled: the standard errors of its cells add up to {} % of what they hold, so that its map is \
         mostly shot noise{remedy}",
        shown(&detector.name),
        significant(100.0 * error, 2),
    ))
}

/// Says of a flux that it rests on few rays, and what can be said of it all the same. A dark detector has a warning of its
/// own, unless a filter may keep it dark.
fn few_rays(detector: &Detector, is_filtered: bool) -> Option<String> {
    let few = detector.few_rays.filter(|few| few.rests_on > 0 || is_filtered)?;
    Some(format!(
        "the flux of detector '{}' {}. It is below {} W, with 95 % confidence. Trace more rays; how many cannot be said yet",
        shown(&detector.name),
        few.text(),
        significant(few.upper_bound_95, 2),
    ))
}

/// A number to two digits, as no estimate is better than that.
fn rounded(count: f64) -> u64 {
    let unit = 10_f64.powf((count.max(1.0).log10().floor() - 1.0).max(0.0));
    ((count / unit).round() * unit) as u64
}

impl Diagnostics {
    /// The signs in a result, made of these sums.
    pub(crate) fn of(ir: &SceneIr, result: &TraceResult, tally: &Tally, uncertainty: &Uncertainty) -> Self {
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
            wrong_sides: wrong_side_warnings::of(ir, tally),
            split_budget_saturated: tally.split_budget_saturated,
            stage_times: result.run.stage_times.clone(),
            warnings: Vec::new(),
            grave: Vec::new(),
        };
        diagnostics.warn(ir, result, tally, uncertainty);
        diagnostics
    }

    fn warn(&mut self, ir: &SceneIr, result: &TraceResult, tally: &Tally, uncertainty: &Uncertainty) {
        let mut grave = broken_books(result);
        let mut warnings = grave.clone();
        warnings.extend(partial(result));
        warnings.extend(result.run.precision_warning.iter().cloned());
        warnings.extend(result.run.scene_warnings.iter().cloned());
        let maps =
            result.detectors.iter().zip(&tally.detectors).filter_map(|(detector, sums)| {
                undersampled(detector, sums, uncertainty, result.num_rays_total)
            });
        let without_rays = sources_without_rays(ir, result, tally);
        let unfinished: Vec<String> = without_rays
            .into_iter()
            .chain(self.cut_off(ir, result))
            .chain(unlit(result).filter(|_| result.run.filter.is_none()))
            .chain(maps)
            .chain(
                result
                    .detectors
                    .iter()
                    .filter_map(|detector| few_rays(detector, result.run.filter.is_some())),
            )
            .collect();
        warnings.extend(unfinished.iter().cloned());
        warnings.extend(self.roulette());
        warnings.extend(self.unreached());
        warnings.extend(result.detectors.iter().filter_map(|detector| {
            detector.data.result().warning(&shown(&detector.name), detector.num_rays_hit)
        }));
        warnings.extend(self.underflows());
        warnings.extend(self.wrong_sides.iter().flat_map(|found| found.warnings.iter().cloned()));
        warnings.extend(self.saturated());
        warnings.extend(without_errors(ir, result, tally));
        grave.extend(unfinished);
        let turned = self.wrong_sides.iter().filter(|found| found.has_turned);
        grave.extend(turned.flat_map(|found| found.warnings.iter().cloned()));
        (self.warnings, self.grave) = (warnings, grave);
    }

    /// Light that the depth limit took, where it is much, or where a detector is dark that it might have lit.
    fn cut_off(&self, ir: &SceneIr, result: &TraceResult) -> Option<String> {
        let fraction = self.depth_truncated_flux_fraction;
        // A filter keeps detectors dark as well.
        let dark = if result.run.filter.is_some() { Vec::new() } else { dark_detectors(result) };
        if fraction <= DEPTH_TRUNCATION && (dark.is_empty() || fraction == 0.0) {
            return None;
        }
        let dark = match dark.as_slice() {
            [] => "paths with more events are missing".into(),
            dark => format!(
                "paths with more events are missing, and {} got no light",
                listed(dark.iter().map(String::as_str))
            ),
        };
        let max_depth = result.run.max_depth;
        let deeper = depth::deeper(ir, max_depth);
        let cure = if deeper > max_depth {
            format!("give --max-depth {deeper}, in Python NsqGpuBackend(max_depth={deeper})")
        } else {
            "no depth is larger, and roulette alone ends light that nothing absorbs; give a larger --rr-start-flux".into()
        };
        let fraction = percent(fraction);
        Some(format!(
            "{fraction} of the launched flux ended at the depth limit of {max_depth} events: {dark}; {cure}"
        ))
    }

    fn roulette(&self) -> Option<String> {
        (self.rr_killed_flux_fraction > ROULETTE).then(|| {
            format!(
                "Russian roulette ended {} of the launched flux: unbiased, but noisy; if the noise matters, give a smaller \
                 --rr-start-flux, or rr_start_flux of the scene's sampling",
                percent(self.rr_killed_flux_fraction)
            )
        })
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
             noisier; if the noise matters, raise split_budget of the scene's sampling"
                .into()
        })
    }

    fn underflows(&self) -> Option<String> {
        (self.medium_stack_underflows > 0).then(|| {
            format!(
                "{} time(s) a ray left a solid that it had never entered. This is right in three cases: rays are born inside a \
                 solid, faces of a solid scatter, or a single face stands in air. Elsewhere, some surface has its media on the \
                 wrong sides",
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
    (result.run.partial && result.num_rays_total < result.run.num_rays).then(|| {
        format!(
            "{why}: {} of {} rays; fluxes are scaled to all that the sources emit",
            thousands(result.num_rays_total),
            thousands(result.run.num_rays)
        )
    })
}

/// Why standard errors that were asked for are missing.
fn without_errors(ir: &SceneIr, result: &TraceResult, tally: &Tally) -> Vec<String> {
    let paths = tally.path_sums.as_ref();
    let mut warnings = Vec::new();
    if tally.moments_overflowed || paths.is_some_and(|paths| paths.squares_overflowed) {
        warnings.push(
            "standard errors are missing: a few rays are so heavy that their squares outgrew the sums. A ray becomes heavy \
             where --scatter-prob or --reflect-prob makes rare what most of the light does: give smaller ones"
                .into(),
        );
    }
    if paths.is_some() && result.run.sampler == "sobol" {
        warnings.push(
            "paths have no standard errors: Sobol points are no independent draws; --sampler pcg has errors"
                .into(),
        );
    }
    let scattered = |sequence: &Sequence| sequence.scatterings() > 0;
    if branches_scatter(ir) && paths.is_some_and(|paths| paths.rows.keys().any(scattered)) {
        warnings.push(
            "rows of scattered light have no standard errors: rays are split (split_depth of the scene's sampling) at faces \
             that scatter, so one ray may bring light twice by one path"
                .into(),
        );
    }
    warnings
}

fn dark_detectors(result: &TraceResult) -> Vec<String> {
    let dark = result.detectors.iter().filter(|detector| detector.num_rays_hit == 0);
    dark.map(|detector| shown(&detector.name)).collect()
}

fn unlit(result: &TraceResult) -> Option<String> {
    let names = dark_detectors(result);
    (!names.is_empty()).then(|| {
        format!(
            "no ray reached {} detector(s): {}; check where they stand and how they are turned",
            names.len(),
            names.join(", ")
        )
    })
}

/// Sources that no ray was left for. A single source has all rays, and a part of a trace may have none of a source.
fn sources_without_rays(ir: &SceneIr, result: &TraceResult, tally: &Tally) -> Option<String> {
    let is_part = result.run.of_rays.is_some_and(|all| all > result.num_rays_total);
    if is_part || ir.sources.len() < 2 {
        return None;
    }
    let counts = tally.rays.counts(ir.sources.len());
    let without = ir.sources.iter().zip(counts).filter(|(_, count)| *count == 0);
    let names: Vec<String> = without.map(|(source, _)| shown(&source.name)).collect();
    (!names.is_empty()).then(|| {
        format!(
            "{} of {} sources have no ray: {}; their light is missing; launch at least {} rays, and a thousand times as many \
             for a result",
            thousands(names.len() as u64),
            thousands(ir.sources.len() as u64),
            listed(names.iter().map(String::as_str)),
            thousands(ir.sources.len() as u64)
        )
    })
}
