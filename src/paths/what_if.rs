//! What other coatings would do: warnings about a table with new coatings, and the faces whose coatings matter most.

use crate::engine::options::TraceOptions;
use crate::error::Result;
use crate::model::{SceneIr, Sequence};
use crate::paths::rows::{TableOptions, Traced, flux_unit, listed};
use crate::program::Sampler;
use crate::result::coating_rank::{self, BrightestGhost, GHOST_REFLECTIONS, Ghost, Ghosts};
use crate::result::light_paths::Group;
use crate::result::{FluxUnit, Grouping, PathTally, Recoating, Tally};

/// Checks that the table has the light of the new coatings, and adds warnings to it.
///
/// # Errors
/// [`crate::Error::Usage`] if the factor of some path is not known.
pub fn check_recoating(
    ir: &SceneIr,
    trace: &TraceOptions,
    tally: &Tally,
    options: &TableOptions,
) -> Result<Vec<String>> {
    let Some(sums) = tally.path_sums.as_ref().filter(|_| !options.recoating.is_empty()) else {
        return Ok(Vec::new());
    };
    let rows = as_traced(ir, trace, tally, sums, options);
    options.recoating.check(ir, rows.iter().map(|group| group.sequences[0]))?;
    let unit = flux_unit(ir, tally, trace.num_rays);
    let paths = rows.iter().map(|group| (group.sequences[0], group.row.flux));
    let mut warnings = options.recoating.warnings(ir, paths);
    warnings.extend(without_row(sums, unit, options.detector));
    Ok(warnings)
}

/// Adds the rank of the coatings to a table.
pub fn rank_coatings(
    ir: &SceneIr,
    trace: &TraceOptions,
    tally: &Tally,
    options: &TableOptions,
    traced: &mut Traced,
) {
    let empty = PathTally::default();
    let sums = tally.path_sums.as_ref().unwrap_or(&empty);
    let rows = as_traced(ir, trace, tally, sums, options);
    let groups = listed(ir, tally, sums, flux_unit(ir, tally, trace.num_rays), trace.sampler, options);
    let paths = rows.iter().map(|group| Ghost {
        sequence: group.sequences[0],
        flux: group.row.flux,
        standard_error: group.row.standard_error,
    });
    let ghosts = Ghosts { brightest: brightest(traced, &groups), ..Ghosts::among(ir, paths) };
    traced.table.coatings = Some(coating_rank::rank(ir, &options.recoating, &ghosts));
    traced.table.coating_warnings.extend(coating_rank::warnings(ir, &ghosts));
}

/// The listed paths, each for itself, with the coatings of the trace.
fn as_traced<'a>(
    ir: &SceneIr,
    trace: &TraceOptions,
    tally: &Tally,
    sums: &'a PathTally,
    options: &TableOptions,
) -> Vec<Group<'a>> {
    let options =
        TableOptions { group: Grouping::Sequence, recoating: Recoating::default(), ..options.clone() };
    let sampler: Sampler = trace.sampler;
    listed(ir, tally, sums, flux_unit(ir, tally, trace.num_rays), sampler, &options)
}

/// The row of the highest peak among ghosts. Rows are sorted, and groups have the sequences of rows.
fn brightest<'a>(traced: &Traced, groups: &[Group<'a>]) -> Option<BrightestGhost<'a>> {
    let rows = traced.table.paths.iter().zip(&traced.sequences);
    let ghosts = rows.filter(|(row, _)| row.reflections as usize >= GHOST_REFLECTIONS);
    let peaks = ghosts.filter_map(|(row, sequence)| Some((row.peak_irradiance?, sequence)));
    let (peak_irradiance, first): (f64, &Sequence) = peaks.max_by(|(a, _), (b, _)| a.total_cmp(b))?;
    let group = groups.iter().find(|group| group.sequences[0] == first)?;
    Some(BrightestGhost { sequences: group.sequences.clone(), peak_irradiance })
}

/// Light of paths without a row keeps its coatings.
fn without_row(sums: &PathTally, unit: FluxUnit, detector: Option<usize>) -> Option<String> {
    let is_listed = |detector_of_end: Option<usize>| detector.is_none() || detector_of_end == detector;
    let other = sums.other.iter().filter(|(end, _)| is_listed(end.detector()));
    let quanta: u128 = other.map(|(_, sum)| sum.quanta).sum();
    (quanta > 0).then(|| {
        let flux = crate::format::significant(unit.watts(quanta), 4);
        format!(
            "{flux} W of light without a row keeps the coatings of the trace; --path-rows gives more rows"
        )
    })
}
