//! From exact sums to what users read.

use crate::error::Result;
use crate::model::{Interaction, SceneIr};
use crate::result::detectors::Sums;
use crate::result::uncertainty::worst_relative_error;
use crate::result::{
    Detector, Diagnostics, FluxUnit, Grouping, Ledger, PathTable, RayPaths, Recoating, Recorded, RunInfo,
    SurfaceKind, SurfaceResult, Tally, TraceResult, Uncertainty, check_shape, light_paths,
};
use crate::result::{photometry, wavelengths_apart};
use std::collections::BTreeMap;

impl TraceResult {
    /// Reads the sums of a trace of `ir` out into physical units, with the rows that the tally holds.
    ///
    /// # Errors
    /// [`Error::Internal`] if the tally is not one of this scene.
    pub fn new(ir: &SceneIr, run: &RunInfo, tally: &Tally) -> Result<TraceResult> {
        check_shape(ir, tally)?;
        TraceResult::with_rows(ir, run, tally, &Recorded::of_tally(ir, tally)?)
    }

    /// As [`TraceResult::new`], with rows that were recorded apart from the tally.
    ///
    /// # Errors
    /// [`Error::Internal`] if tally or rows belong to another scene, [`Error::File`] if the rows cannot be read.
    pub fn with_rows(ir: &SceneIr, run: &RunInfo, tally: &Tally, recorded: &Recorded) -> Result<TraceResult> {
        check_shape(ir, tally)?;
        let unit = FluxUnit::of_scene(ir, if run.partial { tally.launched.count } else { run.num_rays });
        let (apart, sums_apart) = (ir, tally);
        let (ir, tally) = wavelengths_apart::added_up(apart, sums_apart);
        let (ir, tally) = (&*ir, &*tally);
        let luminous = match run.photometric {
            true => photometry::of_detectors([apart, ir], [sums_apart, tally], unit, &run.color)?,
            false => vec![None; ir.detectors.len()],
        };
        let uncertainty = Uncertainty::new(ir, tally, unit);
        let total_flux_in = if run.partial { unit.watts(tally.launched.quanta) } else { ir.emitted_flux() };

        let detectors: Vec<Detector> = ir
            .detectors
            .iter()
            .zip(&tally.detectors)
            .zip(&recorded.databases)
            .zip(luminous)
            .map(|(((detector, cells), rows), luminous)| {
                let (rows, uncertainty, wavelengths) = (rows.as_ref(), &uncertainty, &ir.wavelengths);
                let seen = Detector::new(&Sums { detector, cells, rows, unit, uncertainty, wavelengths })?;
                Ok(Detector { luminous, ..seen })
            })
            .collect::<Result<_>>()?;
        let surfaces = surfaces(ir, tally, unit);
        let ledger = Ledger::new(ir, tally, unit);
        let total_flux_detected = total_flux(detectors.iter());
        let total_flux_tapped = total_flux(detectors.iter().filter(|detector| !detector.absorb));
        let total_flux_lost = ledger.depth.flux + ledger.roulette_loss.flux;

        let mut result = TraceResult {
            run: run.clone(),
            detectors,
            surfaces,
            num_rays_total: tally.launched.count,
            num_rays_absorbed: ledger.absorbed.count,
            num_rays_escaped: ledger.escaped.count,
            num_rays_flux_killed: ledger.roulette_loss.count,
            num_rays_depth_killed: ledger.depth.count,
            total_flux_in,
            total_flux_detected,
            total_flux_tapped,
            total_flux_absorbed: ledger.absorbed.flux,
            total_flux_bulk_absorbed: ledger.bulk.flux,
            total_flux_escaped: ledger.escaped.flux,
            total_flux_lost,
            flux_conservation_error: 0.0,
            relative_error: worst_relative_error(ir, tally).filter(|error| error.is_finite()),
            ledger,
            diagnostics: Diagnostics::default(),
            paths: path_table(ir, run, tally, unit),
            figures: BTreeMap::new(),
            gradients: Vec::new(),
            sources: match run.photometric {
                true => {
                    ir.sources.iter().map(|one| (one.name.clone(), photometry::of_source(ir, one))).collect()
                }
                false => Vec::new(),
            },
            ray_paths: RayPaths::new(ir, unit, recorded.paths.clone()),
        };
        result.flux_conservation_error = result.conservation_error();
        result.diagnostics = Diagnostics::of(ir, &result, tally, &uncertainty);
        Ok(result)
    }
}

/// The table of paths, each sequence a row.
fn path_table(ir: &SceneIr, run: &RunInfo, tally: &Tally, unit: FluxUnit) -> Option<PathTable> {
    let sums = tally.path_sums.as_ref()?;
    let (grouping, as_traced) = (Grouping::Sequence, Recoating::default());
    // Sobol's points have other errors than independent draws.
    let groups = light_paths::groups(ir, tally, sums, unit, grouping, run.sampler == "pcg", &as_traced);
    let launched = unit.watts(tally.launched.quanta);
    let rows = groups.into_iter().map(|group| match run.guide {
        Some(_) => group.row.with_worth(launched),
        None => group.row,
    });
    Some(PathTable::new(ir, sums, unit, grouping, None, rows, &as_traced))
}

/// Starts at 0, since the empty sum of floats is -0.
fn total_flux<'a>(detectors: impl Iterator<Item = &'a Detector>) -> f64 {
    detectors.fold(0.0, |sum, detector| sum + detector.total_flux)
}

fn surfaces(ir: &SceneIr, tally: &Tally, unit: FluxUnit) -> Vec<SurfaceResult> {
    ir.surfaces
        .iter()
        .zip(&tally.surfaces)
        .enumerate()
        .map(|(index, (surface, sums))| SurfaceResult {
            name: ir.surface_name(index),
            kind: match surface.interaction {
                Interaction::Refractive => SurfaceKind::Refractive,
                Interaction::Reflective { .. } => SurfaceKind::Reflective,
                Interaction::Absorbing => SurfaceKind::Absorbing,
            },
            reached: sums.reached,
            num_rays_absorbed: sums.absorbed.count,
            total_flux_absorbed: unit.watts(sums.absorbed.quanta),
        })
        .collect()
}
