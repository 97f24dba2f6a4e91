//! Figures as lines of text.

use crate::format::{shown, significant};
use crate::result::figures::found::{Figure, Figures, Named};
use crate::result::figures::region::{Region, RegionOutline};
use std::collections::BTreeMap;
use std::fmt::Write;

/// The figures of detectors, by their names.
pub fn text(found: &BTreeMap<String, Figures>) -> String {
    let mut text = String::new();
    for (name, figures) in found {
        let [columns, rows] = figures.cells;
        let _ = writeln!(text, "{} ({columns} x {rows} cells)", shown(name));
        lines(&mut text, &figures.whole, figures, "");
        for region in &figures.regions {
            let _ = writeln!(text, "  {}", region_text(&region.region, figures));
            lines(&mut text, &region.figures, figures, "  ");
        }
        figures.remarks.iter().for_each(|remark| {
            let _ = writeln!(text, "  note: {remark}");
        });
    }
    text
}

fn region_text(region: &Region, figures: &Figures) -> String {
    let Region { centre: (x, y), half: (width, height), .. } = *region;
    match region.outline {
        RegionOutline::Rectangle => {
            format!("x {} to {} mm, y {} to {} mm", x - width, x + width, y - height, y + height)
        }
        RegionOutline::Ellipse if figures.is_of_directions() => format!("within {width} deg of the axis"),
        RegionOutline::Ellipse => format!("within {width} mm of ({x}, {y}) mm"),
    }
}

/// A line for each figure, with its unit.
fn lines(text: &mut String, named: &Named, figures: &Figures, indent: &str) {
    for (name, Figure { value, standard_error, .. }) in named {
        let (label, unit) = match name.as_str() {
            "flux" => ("flux", figures.flux_unit.as_str()),
            "min" | "mean" | "max" => (name.as_str(), figures.unit.as_str()),
            name if name.ends_with("_mm") => (name.trim_end_matches("_mm"), "mm"),
            name if name.ends_with("_deg") => (name.trim_end_matches("_deg"), "deg"),
            name => (name, ""),
        };
        let error = standard_error.map_or("-".into(), |error| significant(error, 2));
        let _ = writeln!(
            text,
            "  {indent}{:<18}{:>14} +- {:<12}{unit}",
            label.replace('_', " "),
            significant(*value, 5),
            error
        );
    }
}
