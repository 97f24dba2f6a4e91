//! The panel on the right: what the cursor reads, the figures of the region, the ledger, and warnings.

use crate::format::{percent, significant, thousands};
use crate::result::few_rays::ENOUGH_RAYS;
use crate::result::figures::field::Labels;
use crate::result::figures::region::{EncircledEnergy, RegionOutline, Statistics};
use crate::result::{LedgerEntry, TraceResult};
use crate::viewer::model::{Picture, RegionFigures, Subject};
use crate::viewer::state::App;
use crate::viewer::views::{judged, polar_diagram, quiet, row, table, title, value, with_error};
use eframe::egui::{ScrollArea, Ui};

/// The panel on the right.
pub fn show(app: &mut App, ui: &mut Ui) {
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        if matches!(app.model.subject, Subject::Detector(_)) {
            cursor(app, ui);
            region(app, ui);
            polar_diagram::far_field(app, ui);
            judged::figures(app, ui);
        } else {
            polar_diagram::lamps(app, ui);
        }
        if let Some(result) = app.model.a() {
            ledger(ui, result);
            warnings(ui, result);
        }
        messages(app, ui);
    });
}

fn cursor(app: &mut App, ui: &mut Ui) {
    title(ui, "Cursor");
    let Ok(picture) = app.model.picture() else {
        return;
    };
    let Some(cursor) = app.cursor() else {
        ui.label(quiet(ui, "Point at the plot; click to pin a point."));
        return;
    };
    let labels = match picture.as_ref() {
        Picture::Map { field, .. } => field.labels,
        Picture::Spots(spots) => spots.labels,
    };
    let of_paths = app.model.shown_light().is_some();
    table(ui, "cursor", |ui| {
        let at = |name: &str| if cursor.pinned { format!("{name} (pinned)") } else { name.to_string() };
        row(ui, &at(labels.x.0), &value(cursor.at.0, labels.x.1));
        row(ui, &at(labels.y.0), &value(cursor.at.1, labels.y.1));
        if let Some((reading, hits, sigma)) = cursor.value {
            row(ui, labels.value.0, &value(reading, labels.value.1));
            // Of the light of single paths the rays are not counted cell by cell.
            if !of_paths {
                row(ui, "hits", &thousands(hits));
            }
            if labels.value.1 != "σ" {
                row(ui, "standard error", &value(sigma, labels.value.1));
            }
        } else if cursor.spot.is_none() {
            row(ui, labels.value.0, "nothing here");
        }
        if let Some(spot) = cursor.spot {
            row(ui, "ray", &spot.ray_id.to_string());
            row(ui, labels.value.0, &value(spot.flux, labels.value.1));
            row(ui, "wavelength", &format!("{} µm", significant(spot.wavelength, 6)));
        }
    });
}

fn region(app: &mut App, ui: &mut Ui) {
    let Some((figures, curve)) = app.region_figures() else {
        return;
    };
    let Ok(picture) = app.model.picture() else {
        return;
    };
    let region = app.model.marks().region;
    title(
        ui,
        match region.map(|region| region.outline) {
            None => "Whole plot",
            Some(RegionOutline::Rectangle) => "Rectangle",
            Some(RegionOutline::Ellipse) => "Ellipse",
        },
    );
    let labels = match picture.as_ref() {
        Picture::Map { field, .. } => field.labels,
        Picture::Spots(spots) => spots.labels,
    };
    let of_paths = app.model.shown_light().is_some();
    table(ui, "region", |ui| {
        if let Some(region) = region {
            let point = |(x, y): (f64, f64)| format!("{}, {}", value(x, ""), value(y, labels.x.1));
            row(ui, "centre", &point(region.centre));
            row(ui, "size", &point((2.0 * region.half.0, 2.0 * region.half.1)));
        }
        match figures {
            RegionFigures::Map(Some(figures)) => of_map(ui, &figures, &labels, of_paths),
            RegionFigures::Map(None) => row(ui, "cells", "none"),
            RegionFigures::Spots(figures) => {
                row(ui, "rays", &thousands(figures.num_rays));
                row(ui, "flux", &value(figures.flux, labels.flux));
                spot(ui, figures.centroid, figures.rms_radius, &labels);
                row(ui, "largest radius", &value(figures.largest_radius, labels.x.1));
            }
        }
        let difference = matches!(picture.as_ref(), Picture::Map { scale, .. } if scale.diverging);
        if let Some(curve) = curve.filter(|_| !difference) {
            encircled(ui, &curve, &labels);
        }
    });
}

fn of_map(ui: &mut Ui, figures: &Statistics, labels: &Labels, of_paths: bool) {
    let unit = labels.value.1;
    row(ui, "cells", &thousands(figures.num_cells));
    if !of_paths {
        row(ui, "hits", &thousands(figures.hits));
    }
    // A sum of ratios is not a flux.
    if unit != "σ" {
        // The spread of few rays is no estimate of the error.
        let is_of_few = !of_paths && figures.hits < ENOUGH_RAYS;
        let sigma = if is_of_few { f64::NAN } else { figures.flux_sigma };
        let remark = if is_of_few { " (few rays)" } else { "" };
        row(ui, "flux", &(with_error(figures.flux, sigma, labels.flux) + remark));
    }
    row(ui, "mean", &value(figures.mean, unit));
    row(ui, "peak", &value(figures.peak, unit));
    if labels.value.0.contains('−') {
        return;
    }
    let (x, y) = figures.peak_at;
    row(ui, "peak at", &format!("{}, {}", value(x, ""), value(y, labels.x.1)));
    row(ui, "min / max", &value(figures.uniformity, ""));
    row(ui, "rms / mean", &value(figures.variation, ""));
    // Azimuth and polar angle are no lengths, so a distance between them means nothing.
    if labels.x.0 == labels.y.0 || labels.x.1 == "mm" || labels.x.0.starts_with('θ') {
        spot(ui, figures.centroid, figures.rms_radius, labels);
    }
}

fn spot(ui: &mut Ui, centroid: (f64, f64), rms_radius: f64, labels: &Labels) {
    row(ui, "centroid", &format!("{}, {}", value(centroid.0, ""), value(centroid.1, labels.x.1)));
    row(ui, "RMS radius", &value(rms_radius, labels.x.1));
}

fn encircled(ui: &mut Ui, curve: &EncircledEnergy, labels: &Labels) {
    for fraction in [0.5, 0.9] {
        let name = format!("{:.0} % within", 100.0 * fraction);
        row(ui, &name, &value(curve.radius_of(fraction), labels.x.1));
    }
}

fn ledger(ui: &mut Ui, result: &TraceResult) {
    title(ui, "Ledger");
    let ledger = &result.ledger;
    let line = |ui: &mut Ui, name: &str, entry: LedgerEntry| {
        if entry.quanta > 0 {
            let share = percent(result.fraction_of_launched(entry.flux));
            row(ui, name, &format!("{} · {share}", value(entry.flux, "W")));
        }
    };
    table(ui, "ledger", |ui| {
        ledger.sources().into_iter().for_each(|(name, entry)| line(ui, name, entry));
        ledger.destinations().into_iter().for_each(|(name, entry)| line(ui, name, entry));
    });
    if ledger.closes() {
        ui.label(quiet(ui, "closes to the last quantum"));
    } else {
        let text = format!("DOES NOT CLOSE: {} quanta", ledger.imbalance_quanta);
        ui.colored_label(ui.visuals().error_fg_color, text);
    }
}

fn warnings(ui: &mut Ui, result: &TraceResult) {
    let warnings = &result.diagnostics.warnings;
    if warnings.is_empty() {
        return;
    }
    title(ui, &format!("Warnings ({})", warnings.len()));
    for warning in warnings {
        ui.colored_label(ui.visuals().warn_fg_color, warning);
        ui.add_space(3.0);
    }
}

fn messages(app: &mut App, ui: &mut Ui) {
    if app.model.messages.is_empty() {
        return;
    }
    title(ui, "Messages");
    const SHOWN: usize = 6;
    for message in app.model.messages.iter().rev().take(SHOWN) {
        ui.label(message);
    }
    if ui.button("Clear messages").clicked() {
        app.model.messages.clear();
    }
}
