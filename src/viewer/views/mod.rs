//! The parts of the window, one file each.

pub mod controls;
pub mod curves_below;
pub mod detector_plot;
pub mod export_menu;
pub mod judged;
pub mod left_panel;
pub mod paths_panel;
pub mod polar_diagram;
pub mod right_panel;
pub mod run_bar;
pub mod side_view;

use crate::format;
use eframe::egui::{self, RichText, Ui};

/// A value with its unit, for people.
pub(super) fn value(value: f64, unit: &str) -> String {
    if value.is_nan() {
        return "–".into();
    }
    match unit {
        // Prefixes are for units that take them.
        "" | "1" | "σ" | "°" | "mm" => with_plain_unit(value, unit),
        _ => format::with_prefix(value, unit).replace('-', "−"),
    }
}

fn with_plain_unit(value: f64, unit: &str) -> String {
    let number = format::significant(value, 4).replace('-', "−");
    match unit {
        "" | "1" => number,
        "°" => format!("{number}°"),
        _ => format!("{number} {unit}"),
    }
}

/// A value with its standard error, if the error is known.
pub(super) fn with_error(value: f64, sigma: f64, unit: &str) -> String {
    let known = sigma > 0.0;
    if !known || unit == "σ" {
        return self::value(value, unit);
    }
    let (factor, prefix) = format::si_prefix(value);
    // As many digits as the error justifies.
    let digits = (value.abs() / sigma).log10().ceil().clamp(1.0, 6.0) as usize + 1;
    let number = format::significant(value / factor, digits).replace('-', "−");
    format!("{number} ± {} {prefix}{unit}", format::significant(sigma / factor, 2))
}

/// A line of a table: a name on the left, a value on the right.
pub(super) fn row(ui: &mut Ui, name: &str, value: &str) {
    ui.label(quiet(ui, name));
    ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| ui.label(value));
    ui.end_row();
}

/// A table of two columns over the whole width.
pub(super) fn table(ui: &mut Ui, name: &str, rows: impl FnOnce(&mut Ui)) {
    egui::Grid::new(name).num_columns(2).spacing([10.0, 3.0]).min_col_width(70.0).show(ui, rows);
}

/// Less important text, still easy to read.
pub(super) fn quiet(ui: &Ui, text: impl Into<String>) -> RichText {
    RichText::new(text).color(ui.visuals().text_color().gamma_multiply(0.8))
}

/// The title of a part.
pub(super) fn title(ui: &mut Ui, text: &str) {
    ui.add_space(8.0);
    ui.label(RichText::new(text).strong().size(14.0));
    ui.add_space(2.0);
}
