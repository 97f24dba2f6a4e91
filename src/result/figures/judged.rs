//! The figures of a detector.

use crate::error::{Error, Result};
use crate::format::{percent, shown};
use crate::result::figures::crossings::Profile;
use crate::result::figures::field::{CellGeometry, Field};
use crate::result::figures::found::{Figure, Figures, Named, RegionFigures};
use crate::result::figures::noise::with_errors;
use crate::result::figures::region::Region;
use crate::result::picture::polar::sector;
use crate::result::{Detector, DetectorData, TraceResult};
use ndarray::{Array2, Axis};
use std::collections::BTreeMap;

/// What is asked of a map.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Asked {
    /// Parts of the map that get figures of their own.
    pub regions: Vec<Region>,
    /// Cells over which figures are found, columns and rows. None: the finest that are known to 1 %.
    pub cells: Option<[usize; 2]>,
}

/// Map error below which cells are fine enough.
const KNOWN: f64 = 0.01;
/// Fewest rows or columns of cells that are made of pixels by themselves.
const FEWEST_CELLS: usize = 16;

/// The figures of a detector of a result.
///
/// # Errors
/// [`Error::Usage`] if its light has no map over a plane, or if `asked.cells` does not fit it.
pub fn judge(result: &TraceResult, detector: &Detector, asked: &Asked) -> Result<Figures> {
    let has_no_map = || {
        let kind = detector.data.kind();
        Error::Usage(format!(
            "{} is a {kind} detector: only irradiance and far_field have figures",
            shown(&detector.name)
        ))
    };
    let field = Field::of_detector(detector).ok_or_else(has_no_map)?;
    let is_far_field = matches!(detector.data, DetectorData::FarField(_));
    let field = if is_far_field { field.as_disc() } else { field };
    let total = Total::of(result, detector, &field);
    let by = match asked.cells {
        Some(cells) => pixels_of(&field, cells, detector)?,
        None => total.fine_enough(&field),
    };
    let coarse = total.coarser(&field, by);
    let (rows, columns) = coarse.dim();
    let everywhere = Array2::ones(coarse.dim());
    let mut whole = match is_far_field {
        true => angles(&field, &total),
        false => Named::new(),
    };
    let smooth = total.error.map(|_| coarse.smoothed());
    let size = columns as f64 * coarse.measure.iter().sum::<f64>();
    let flux = Figure::unmoved(total.flux, total.error);
    whole.extend(evenness(&coarse, smooth.as_ref(), &everywhere, (flux, size)));
    if is_far_field {
        // Over all directions, evenness says nothing.
        whole.retain(|name, _| name == "max" || name == "flux" || name.ends_with("_deg"));
    } else {
        whole.extend(widths(&coarse, total.error.is_some()));
    }
    let of_region = |region: &Region| of_region(*region, &field, (&coarse, smooth.as_ref()), &total);
    let regions = asked.regions.iter().map(of_region).collect::<Result<_>>()?;
    let mut figures = Figures {
        unit: field.labels.value.1.replace('²', "^2"),
        flux_unit: field.labels.flux.into(),
        cells: [columns, rows],
        whole,
        regions,
        remarks: Vec::new(),
    };
    figures.remarks = remarks(&figures, &coarse, &total, asked.cells.is_none());
    Ok(figures)
}

/// The figures of every detector that has a map, by name.
pub fn judge_all(result: &TraceResult) -> BTreeMap<String, Figures> {
    let of =
        |detector: &Detector| Some((detector.name.clone(), judge(result, detector, &Asked::default()).ok()?));
    result.detectors.iter().filter_map(of).collect()
}

/// The flux of a detector, and how its cells hang together.
struct Total {
    flux: f64,
    error: Option<f64>,
    num_rays: f64,
    /// The variance of a sum of many cells over the variance if cells were independent. A ray that is splatted brings
    /// light to neighbours.
    splat: f64,
    are_draws: bool,
}

impl Total {
    fn of(result: &TraceResult, detector: &Detector, field: &Field) -> Self {
        let (flux, error) = match &detector.luminous {
            Some(seen) => (seen.flux_lm, seen.flux_lm_standard_error),
            None => (detector.total_flux, detector.total_flux_standard_error),
        };
        let has_errors = detector.data.result().map().is_some_and(|map| map.errors.is_some());
        let are_draws = result.run.sampler == "pcg";
        let mut total = Total {
            flux,
            error: error.filter(|error| has_errors && error.is_finite()),
            num_rays: result.num_rays_total as f64,
            splat: 1.0,
            are_draws,
        };
        if let Some(error) = total.error.filter(|_| are_draws) {
            let (rows, columns) = field.dim();
            let cells = (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column)));
            let squares: f64 = cells.map(|cell| total.squares(field, cell)).sum();
            let of_all = error.powi(2) + flux.powi(2) / total.num_rays;
            total.splat = if squares > 0.0 { (of_all / squares).max(1.0) } else { 1.0 };
        }
        total
    }

    /// The sum of the squares of what rays brought to a cell: its variance is that less the square of their sum over all rays.
    fn squares(&self, field: &Field, cell: (usize, usize)) -> f64 {
        (field.known_error(cell) * field.measure[cell.0]).powi(2)
            + field.flux_of(cell).powi(2) / self.num_rays
    }

    fn coarser(&self, field: &Field, by: usize) -> Field {
        if by == 1 {
            return field.clone();
        }
        let mut coarse = field.coarser(by);
        coarse.sigma *= self.splat.sqrt();
        coarse
    }

    /// Pixels along a side of the finest cells that are known to 1 %; 1 where errors are unknown.
    fn fine_enough(&self, field: &Field) -> usize {
        let (rows, columns) = field.dim();
        let divides = |by: &usize| {
            rows.is_multiple_of(*by) && columns.is_multiple_of(*by) && rows.min(columns) / by >= FEWEST_CELLS
        };
        let sizes: Vec<usize> = (1..=rows.min(columns)).filter(divides).collect();
        let is_known = |by: &&usize| error_of_cells(&self.coarser(field, **by)) <= KNOWN;
        let finest = if self.error.is_some() { sizes.iter().find(is_known).or(sizes.last()) } else { None };
        finest.copied().unwrap_or(1)
    }

    /// The flux in a part of the map, and its share of all flux. `shares` says which share of each cell belongs to the part.
    fn of_part(&self, field: &Field, shares: &Array2<f64>) -> (Figure, Option<Figure>) {
        let flux: f64 = shares.indexed_iter().map(|(cell, share)| share * field.flux_of(cell)).sum();
        // The variance of a sum over cells of these weights.
        let variance = |weight: &dyn Fn(f64) -> f64| {
            let of_cell = |(cell, share): ((usize, usize), &f64)| match self.are_draws {
                true => weight(*share).powi(2) * self.squares(field, cell),
                false => (weight(*share) * field.known_error(cell) * field.measure[cell.0]).powi(2),
            };
            self.splat * shares.indexed_iter().map(of_cell).sum::<f64>()
        };
        // Cells of one trace share its rays: what one has more, others have less.
        let in_common = if self.are_draws { flux.powi(2) / self.num_rays } else { 0.0 };
        let error = self.error.map(|_| (variance(&|share| share) - in_common).max(0.0).sqrt());
        let share = (self.flux > 0.0).then(|| {
            let value = flux / self.flux;
            // A ray in the part raises its share by less than the ray, and one beside it lowers it.
            let error = self.error.map(|_| variance(&|share| share - value).sqrt() / self.flux);
            Figure::unmoved(value, error)
        });
        (Figure::unmoved(flux, error), share)
    }
}

/// The errors of a map's cells over their values, as a mean weighted by flux. Of a far field, cells have equal solid angles.
fn error_of_cells(field: &Field) -> f64 {
    let equal = (field.geometry == CellGeometry::Polar).then(|| field.of_equal_solid_angles());
    let field = equal.as_ref().unwrap_or(field);
    let (mut errors, mut flux) = (0.0, 0.0);
    for ((row, column), _) in field.values.indexed_iter() {
        errors += field.known_error((row, column)) * field.measure[row];
        flux += field.flux_of((row, column));
    }
    if errors > 0.0 { errors / flux } else { 0.0 }
}

/// Pixels along a side of cells, of which a map has so many columns and rows.
fn pixels_of(field: &Field, [columns, rows]: [usize; 2], detector: &Detector) -> Result<usize> {
    let (all_rows, all_columns) = field.dim();
    let fits =
        columns > 0 && rows > 0 && all_columns.is_multiple_of(columns) && all_rows.is_multiple_of(rows);
    if fits && all_columns / columns == all_rows / rows {
        return Ok(all_columns / columns);
    }
    let fewest = (1..=all_rows.min(all_columns))
        .rev()
        .find(|by| all_rows.is_multiple_of(*by) && all_columns.is_multiple_of(*by));
    let fewest = fewest.unwrap_or(1);
    Err(Error::Usage(format!(
        "{columns} x {rows} cells are not made of whole pixels of {}, which has {all_columns} x {all_rows}; divide both by the \
         same number, down to {} x {}",
        shown(&detector.name),
        all_columns / fewest,
        all_rows / fewest
    )))
}

/// Flux, least, mean and largest value of a part, and how even the part is. Only cells that belong to the part by half at
/// least count for the least and the largest value. The mean is the flux of the part over its size, with the error of the
/// flux, because neighbouring pixels may share rays. Noise is added to the map `smooth`; without it there are no errors.
fn evenness(
    field: &Field,
    smooth: Option<&Field>,
    shares: &Array2<f64>,
    (flux, size): (Figure, f64),
) -> Named {
    let mean = Figure::unmoved(flux.value / size, flux.standard_error.map(|error| error / size));
    let is_polar = field.geometry == CellGeometry::Polar;
    let mean_of_cells = |field: &Field| {
        let (mut flux, mut size) = (0.0, 0.0);
        for (cell, &share) in shares.indexed_iter() {
            flux += share * field.flux_of(cell);
            size += share * field.measure[cell.0];
        }
        (size > 0.0).then(|| flux / size)
    };
    // Noise moves the mean as it moves the cells.
    let scale =
        mean_of_cells(field).filter(|of_cells| *of_cells > 0.0).map_or(1.0, |of_cells| mean.value / of_cells);
    let of = |field: &Field| {
        let equal;
        let field = if is_polar {
            equal = field.of_equal_solid_angles();
            &equal
        } else {
            field
        };
        let (mut least, mut peak) = (f64::INFINITY, f64::NEG_INFINITY);
        for (cell, _) in shares.indexed_iter().filter(|(_, share)| **share >= 0.5) {
            least = least.min(field.values[cell]);
            peak = peak.max(field.values[cell]);
        }
        let mean = mean_of_cells(field).map(|mean| scale * mean);
        let ratio = |value: f64| value.is_finite().then_some(value);
        [
            least.is_finite().then_some(least),
            peak.is_finite().then_some(peak),
            mean.and_then(|mean| ratio(least / mean)),
            ratio(least / peak),
        ]
    };
    let names = ["min", "max", "min_over_mean", "min_over_max"];
    let mut found = named(names, with_errors(field, smooth, of));
    found.extend([("mean".to_string(), mean), ("flux".to_string(), flux)]);
    found
}

fn named<const N: usize>(names: [&str; N], figures: [Option<Figure>; N]) -> Named {
    let found = names.into_iter().zip(figures).filter_map(|(name, figure)| Some((name.to_string(), figure?)));
    found.collect()
}

/// Full widths at half maximum, through the largest cell along both axes.
fn widths(field: &Field, has_errors: bool) -> Named {
    let (rows, columns) = field.dim();
    let of = |field: &Field| {
        let peak =
            field.values.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).map_or((0, 0), |(cell, _)| cell);
        let through = |axis: Axis, index: usize, places: Vec<f64>| Profile {
            places,
            values: field.values.index_axis(axis, index).to_vec(),
            errors: vec![0.0; field.values.index_axis(axis, index).len()],
        };
        let x = through(Axis(0), peak.0, (0..columns).map(|column| field.centre((0, column)).0).collect());
        let y = through(Axis(1), peak.1, (0..rows).map(|row| field.centre((row, 0)).1).collect());
        [x.width(0.5), y.width(0.5)]
    };
    named(["fwhm_x_mm", "fwhm_y_mm"], with_errors(field, has_errors.then_some(field), of))
}

/// Full angles in which the intensity is at least half (beam), or a tenth (field), of the largest. Each is given for
/// the mean over all azimuths, and in the planes C0 and C90.
fn angles(field: &Field, total: &Total) -> Named {
    let (_, columns) = field.dim();
    let all: Vec<usize> = (0..columns).collect();
    let planes = [[0.0, 180.0], [90.0, -90.0]].map(|plane| plane.map(|azimuth| sector(columns, azimuth)));
    let of = |field: &Field| {
        let both = |sides: [&[usize]; 2], part: f64| {
            let profiles = sides.map(|side| over_polar_angles(field, side));
            let peak = profiles
                .iter()
                .filter_map(|side| side.peak().map(|peak| side.values[peak]))
                .fold(0.0, f64::max);
            let ends = profiles.map(|side| side.outermost(part * peak).filter(|_| peak > 0.0));
            Some(ends[0]? + ends[1]?)
        };
        let [c0, c90] = &planes;
        let [c0, c90] = [c0, c90].map(|[one, other]| [one.as_slice(), other.as_slice()]);
        let mean = [all.as_slice(), all.as_slice()];
        [both(mean, 0.5), both(c0, 0.5), both(c90, 0.5), both(mean, 0.1), both(c0, 0.1), both(c90, 0.1)]
    };
    let names = [
        "beam_angle_deg",
        "beam_angle_c0_deg",
        "beam_angle_c90_deg",
        "field_angle_deg",
        "field_angle_c0_deg",
        "field_angle_c90_deg",
    ];
    named(names, with_errors(field, total.error.map(|_| field), of))
}

/// The mean over some azimuths, by the polar angle.
fn over_polar_angles(field: &Field, columns: &[usize]) -> Profile {
    let (rows, _) = field.dim();
    let num = columns.len() as f64;
    let cells = |row: usize| columns.iter().map(move |&column| (row, column));
    Profile {
        places: (0..rows).map(|row| field.polar_angle(row as f64 + 0.5)).collect(),
        values: (0..rows).map(|row| cells(row).map(|cell| field.values[cell]).sum::<f64>() / num).collect(),
        errors: (0..rows)
            .map(|row| cells(row).map(|cell| field.known_error(cell).powi(2)).sum::<f64>().sqrt() / num)
            .collect(),
    }
}

fn of_region(
    region: Region,
    field: &Field,
    (coarse, smooth): (&Field, Option<&Field>),
    total: &Total,
) -> Result<RegionFigures> {
    let shares = region.shares(field);
    if !shares.iter().any(|share| *share > 0.0) {
        let problem = match region.share_outside(field) < 1.0 {
            true => {
                "a region is smaller than an eighth of a pixel; give a larger one, or the detector more pixels"
            }
            false => "a region lies outside of the map",
        };
        return Err(Error::Usage(problem.into()));
    }
    let (flux, share) = total.of_part(field, &shares);
    let size: f64 = shares.indexed_iter().map(|((row, _), share)| share * field.measure[row]).sum();
    let mut figures = evenness(coarse, smooth, &region.shares(coarse), (flux, size));
    figures.extend(share.map(|share| ("share".to_string(), share)));
    Ok(RegionFigures { region, figures })
}

fn remarks(figures: &Figures, coarse: &Field, total: &Total, chose_cells: bool) -> Vec<String> {
    let mut remarks = Vec::new();
    if total.error.is_none() {
        remarks.push("the result has no standard errors of its map: trace with --standard-error on".into());
    }
    let error = error_of_cells(coarse);
    if chose_cells && total.error.is_some() && error > 2.0 * KNOWN {
        let [columns, rows] = figures.cells;
        remarks.push(format!(
            "cells of {columns} x {rows} are known to {} alone, so the least is too low and the largest too high: trace more rays, \
             or take fewer cells with --cells",
            percent(error)
        ));
    }
    let all =
        std::iter::once(&figures.whole).chain(figures.regions.iter().map(|region| &region.figures)).flatten();
    let mut moved: Vec<&str> =
        all.filter(|(_, figure)| figure.is_moved()).map(|(name, _)| name.as_str()).collect();
    moved.sort_unstable();
    moved.dedup();
    if !moved.is_empty() {
        remarks.push(format!(
            "noise moves {} by more than a standard error: trace more rays, or take larger cells",
            moved.join(", ")
        ));
    }
    for (number, of_region) in (1..).zip(&figures.regions) {
        let outside = of_region.region.share_outside(coarse);
        if outside > 0.01 {
            remarks.push(format!(
                "{:.0} % of region {number} lies outside of the map: its figures are of the rest, and not of all its light",
                100.0 * outside
            ));
        }
    }
    let is_far_field = coarse.geometry == CellGeometry::Polar;
    if is_far_field && total.flux > 0.0 && !figures.whole.contains_key("beam_angle_deg") {
        remarks
            .push("no beam angle: the peak is not known to 10 %, or light does not fall to its half".into());
    }
    for (key, name) in [("beam_angle_deg", "beam angle"), ("field_angle_deg", "field angle")] {
        // Maps have no such angles.
        if figures.whole.get(key).is_some_and(|angle| angle.value < 10.0 * coarse.finest()) {
            remarks.push(format!("{name} is less than five bins of the polar angle a side: take finer bins"));
        }
    }
    if !is_far_field {
        for (axis, range, cells) in
            [("x", coarse.x_range, figures.cells[0]), ("y", coarse.y_range, figures.cells[1])]
        {
            let pitch = (range.1 - range.0) / cells as f64;
            match figures.whole.get(&format!("fwhm_{axis}_mm")[..]) {
                Some(width) if width.value < 5.0 * pitch => {
                    remarks.push(format!(
                        "fwhm {axis} is less than five cells: trace more rays, or take more pixels"
                    ));
                }
                Some(_) | None => {}
            }
        }
    }
    remarks
}
