//! A difference as text for a terminal.

use crate::format::{plain, score, shown, significant, thousands};
use crate::result::difference::{DetectorDifference, FluxDifference, SceneDifference};
use crate::result::few_rays;
use std::fmt::Write;

impl SceneDifference {
    /// How both were traced, then a line for each flux, and for each map its largest difference.
    pub fn text(&self) -> String {
        let mut text = self.head();
        let rows =
            self.detectors.iter().map(|detector| &detector.flux).chain(&self.totals).chain(&self.surfaces);
        let widest = rows.map(|row| shown(&row.name).chars().count()).max().unwrap_or(0);
        let width = widest.max("detector".len()) + 2;
        let title = |name: &str| {
            let columns = ["A [W]", "B [W]", "A - B [W]", "error [W]", "sigmas"];
            let [a, b, difference, error, sigmas] = columns;
            format!("\n{name:<width$}{a:>13}{b:>13}{difference:>13}{error:>11}{sigmas:>9}\n")
        };
        text += &title("detector");
        for detector in &self.detectors {
            let _ = writeln!(text, "{:<width$}{}", shown(&detector.flux.name), columns(&detector.flux));
            if let Some(largest) = largest(detector) {
                let _ = writeln!(text, "  {largest}");
            }
            detector.note.iter().for_each(|note| {
                let _ = writeln!(text, "  {note}");
            });
        }
        for (name, rows) in [("light", &self.totals), ("surface", &self.surfaces)] {
            if !rows.is_empty() {
                text += &title(name);
                rows.iter().for_each(|row| {
                    let _ = writeln!(text, "{:<width$}{}", shown(&row.name), columns(row));
                });
            }
        }
        let mut all =
            self.detectors.iter().map(|detector| &detector.flux).chain(&self.totals).chain(&self.surfaces);
        if all.any(|row| row.few_rays.is_some()) {
            text.push('\n');
            text += few_rays::FOOTNOTE;
        }
        if !self.notes.is_empty() {
            text.push('\n');
        }
        self.notes.iter().for_each(|note| {
            let _ = writeln!(text, "{note}");
        });
        text
    }

    fn head(&self) -> String {
        let run = &self.run;
        let partial = match run.partial {
            true => format!(" (partial: {} requested)", thousands(run.num_rays)),
            false => String::new(),
        };
        let filter = match &run.filter {
            Some(text) => format!("only light whose path matches: {}\n", plain(text)),
            None => String::new(),
        };
        let blocks = if run.sampler == "pcg" { "blocks of rays" } else { "scrambles of the points" };
        format!(
            "A: {}\nB: {}\n{} rays{partial} of each, by the same draws\nseed {} ({}), max_depth {}, {} on {}\n{filter}errors from {} {blocks}\n",
            self.names[0],
            self.names[1],
            thousands(self.num_rays),
            run.seed,
            run.sampler,
            run.max_depth,
            run.precision,
            run.adapter,
            self.num_blocks,
        )
    }
}

fn columns(row: &FluxDifference) -> String {
    let error = few_rays::error_or_bound(row.few_rays, row.standard_error);
    let score = match row.few_rays {
        Some(_) => "-".into(),
        None => score(row.difference, row.standard_error, row.largest()),
    };
    format!(
        "{:>13}{:>13}{:>13}{error:>11}{score:>9}{}",
        significant(row.a, 7),
        significant(row.b, 7),
        significant(row.difference, 3),
        few_rays::remark(row.few_rays)
    )
}

/// The cell that differs most.
fn largest(detector: &DetectorDifference) -> Option<String> {
    let map = detector.map.as_ref()?;
    let (_, unit) = map.sides[0].data.result().map()?.quantity;
    let (index, value) = map.values.indexed_iter().max_by(|(_, a), (_, b)| a.abs().total_cmp(&b.abs()))?;
    if *value == 0.0 {
        return Some("map: no cell differs".into());
    }
    let index: Vec<usize> = (0..map.values.ndim()).map(|axis| index[axis]).collect();
    let error = map
        .errors
        .as_ref()
        .map_or(String::new(), |errors| format!(" ± {}", significant(errors[&index[..]], 2)));
    Some(format!("map: at most {}{error} {unit}, in cell {index:?}", significant(*value, 3)))
}
