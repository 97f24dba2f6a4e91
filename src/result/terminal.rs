//! The result as text for a terminal.

use std::fmt::Write;

use crate::format::{plain, shown, significant, thousands};
use crate::result::StoppedBy;
use crate::result::figures;
use crate::result::photometry;
use crate::result::{GuideInfo, LedgerEntry, PathTable, Recoated, TraceResult, few_rays, gradients};

/// Rows of the table of paths that a report of a trace shows.
const TOP_PATHS: usize = 10;

impl TraceResult {
    /// The report: how the trace was run, where the flux went, what the detectors read, whether the ledger closes, and
    /// warnings.
    pub fn report(&self) -> String {
        let paths = self.paths.as_ref().map(|table| table.text(TOP_PATHS));
        let is_without_edges =
            self.run.stopped_by.is_none() && self.gradients.iter().all(|row| row.with_edges.is_none());
        let gradients = (!self.gradients.is_empty()).then(|| {
            let table = gradients::table(&self.gradients, &self.detectors, self.ledger.launched.flux);
            table + if is_without_edges { gradients::WITHOUT_EDGES } else { "" }
        });
        let parts = [self.header(), self.flux_table(), self.detector_table()];
        let luminous = self.run.photometric.then(|| photometry::table(self));
        let figures = (!self.figures.is_empty()).then(|| figures::text(&self.figures));
        let last = [self.ledger_line(), self.warning_list()];
        parts
            .into_iter()
            .chain(luminous)
            .chain(figures)
            .chain(gradients)
            .chain(paths)
            .chain(last)
            .collect::<Vec<_>>()
            .join("\n")
    }

    pub(crate) fn header(&self) -> String {
        let run = &self.run;
        let scene = run.scene.as_ref().map_or(String::new(), |scene| format!(" of {}", plain(scene)));
        let partial = if run.partial {
            match run.stopped_by {
                Some(StoppedBy::TargetError) => format!(" (of at most {})", thousands(run.num_rays)),
                _ => format!(" (partial: {} requested)", thousands(run.num_rays)),
            }
        } else {
            String::new()
        };
        let sampler = if run.sampler == "pcg" { String::new() } else { format!(" ({})", run.sampler) };
        let precision = match run.precision_reason.as_str() {
            "" => String::new(),
            reason => format!("{}: {reason}\n", run.precision),
        };
        let driver = if run.driver.is_empty() { String::new() } else { format!(", {}", run.driver) };
        let filter = match &run.filter {
            Some(text) => format!("only light whose path matches: {}\n", plain(text)),
            None => String::new(),
        };
        let guide = run.guide.as_ref().map_or(String::new(), GuideInfo::line);
        let processor = if run.has_no_gpu { "no GPU was found: this is your processor\n" } else { "" };
        format!(
            "{} {}: {} rays{partial}{scene}\nseed {}{sampler}, max_depth {}, {} on {}{driver}\n{filter}{guide}{processor}{precision}{}",
            run.program,
            run.version,
            thousands(self.num_rays_total),
            run.seed,
            run.max_depth,
            run.precision,
            run.adapter,
            self.timing(),
        )
    }

    /// How long the trace took, and in a line of its own when it began. Empty if it was not measured.
    fn timing(&self) -> String {
        let run = &self.run;
        if run.trace_time_sec == 0.0 {
            return String::new();
        }
        let from_start =
            |sec| format!("{} s from the start of the command to the first rays\n", significant(sec, 3));
        let first_rays = run.first_rays_sec.map(from_start);
        let before = match run.num_rays_before {
            0 => String::new(),
            rays => format!("; went on from {} rays", thousands(rays)),
        };
        format!(
            "{} s of tracing, {} rays/s{before}\n{}",
            significant(run.trace_time_sec, 3),
            thousands(run.rays_per_sec(self.num_rays_total).round() as u64),
            first_rays.unwrap_or_default(),
        )
    }

    /// One line per bin of the ledger that took something; the main ones always.
    fn flux_table(&self) -> String {
        const ALWAYS: [&str; 4] = ["launched", "detected", "absorbed", "escaped"];
        let mut table = format!("{:<18}{:>14}{:>14}{:>18}\n", "flux", "W", "% of launched", "rays or events");
        let lines = self.ledger.sources().into_iter().chain(self.ledger.destinations());
        for (name, entry) in lines.filter(|(name, entry)| ALWAYS.contains(name) || entry.count > 0) {
            self.flux_line(&mut table, name, entry);
        }
        if self.ledger.tapped.count > 0 {
            self.flux_line(&mut table, "read in passing", self.ledger.tapped);
        }
        table
    }

    fn flux_line(&self, table: &mut String, name: &str, entry: LedgerEntry) {
        let share = format!("{:.4}", 100.0 * self.fraction_of_launched(entry.flux));
        let flux = significant(entry.flux, 7);
        let _ = writeln!(table, "{name:<18}{flux:>14}{share:>14}{:>18}", thousands(entry.count));
    }

    fn detector_table(&self) -> String {
        let widest =
            self.detectors.iter().map(|detector| shown(&detector.name).chars().count()).max().unwrap_or(0);
        let width = widest.max(16) + 2;
        let mut table = format!(
            "{:<width$}{:<14}{:>14}{:>14}{:>14}{:>16}\n",
            "detector", "kind", "W", "std. error", "map error", "rays"
        );
        for detector in &self.detectors {
            let passing = if detector.absorb { "" } else { "  (transmissive)" };
            let of_map = detector.mean_relative_error().filter(|error| error.is_finite());
            let _ = writeln!(
                table,
                "{:<width$}{:<14}{:>14}{:>14}{:>14}{:>16}{passing}{}",
                shown(&detector.name),
                detector.data.kind(),
                significant(detector.total_flux, 7),
                few_rays::error_or_bound(detector.few_rays, detector.total_flux_standard_error),
                of_map.map_or("-".into(), |error| format!("{} %", significant(100.0 * error, 2))),
                thousands(detector.num_rays_hit),
                few_rays::remark(detector.few_rays),
            );
        }
        if self.detectors.iter().any(|detector| detector.few_rays.is_some()) {
            table.push_str(few_rays::FOOTNOTE);
        }
        let has_unknown = self.detectors.iter().any(|detector| detector.total_flux_standard_error.is_none());
        if has_unknown && self.gradients.is_empty() {
            table.push_str("-: not computed; --standard-error on gives it\n");
        }
        table
    }

    fn ledger_line(&self) -> String {
        let ledger = &self.ledger;
        if ledger.closes() {
            format!("ledger closes: 0 quanta of {}\n", ledger.launched.quanta)
        } else {
            format!(
                "LEDGER DOES NOT CLOSE: {} quanta of {} unaccounted for, {} invalid deposits\n",
                ledger.imbalance_quanta, ledger.launched.quanta, ledger.invalid_deposits
            )
        }
    }

    pub(crate) fn warning_list(&self) -> String {
        match self.diagnostics.warnings.as_slice() {
            [] => "no warnings\n".into(),
            warnings => warnings.iter().map(|warning| format!("warning: {warning}\n")).collect(),
        }
    }
}

/// `recoated: L1.back, R 0.01 -> 0.002, T 0.99 -> 0.998`
fn recoated_line(face: &Recoated) -> String {
    let change = |old: f64, new: f64| format!("{} -> {}", significant(old, 4), significant(new, 4));
    let transmittances = face.old_transmittance.zip(face.transmittance);
    let of_t = transmittances.map_or(String::new(), |(old, new)| format!(", T {}", change(old, new)));
    format!("recoated: {}, R {}{of_t}\n", shown(&face.face), change(face.old_reflectance, face.reflectance))
}

impl PathTable {
    /// The first rows for a terminal, and what the others sum up to.
    pub fn text(&self, top: usize) -> String {
        let shown_rows = &self.paths[..top.min(self.paths.len())];
        let has_places = shown_rows.iter().any(|row| row.rms_radius.is_some());
        let has_peaks = shown_rows.iter().any(|row| row.peak_irradiance.is_some());
        let has_worth = shown_rows.iter().any(|row| row.plain_rays.is_some());
        let mut text = self.recoated.iter().map(recoated_line).collect::<String>();
        let _ = write!(text, "{:<6}{:>12}{:>12}{:>12}{:>14}", "path", "W", "std. error", "% of end", "rays");
        if has_worth {
            let _ = write!(text, "{:>12}", "plain rays");
        }
        if has_places {
            let _ = write!(text, "{:>12}{:>12}{:>12}", "x mm", "y mm", "rms mm");
        }
        if has_peaks {
            let _ = write!(text, "{:>14}", "peak W/mm2");
        }
        text.push_str("  sequence\n");
        let known = |value: Option<f64>, digits| value.map_or("-".into(), |value| significant(value, digits));
        for row in shown_rows {
            let _ = write!(
                text,
                "{:<6}{:>12}{:>12}{:>12}{:>14}",
                row.rank,
                significant(row.flux, 5),
                few_rays::error_or_bound(row.few_rays, row.standard_error),
                significant(100.0 * row.share, 4),
                thousands(row.num_rays),
            );
            if has_worth {
                let worth = row.plain_rays.map_or("-".into(), |rays| format!("{rays:.1e}"));
                let _ = write!(text, "{worth:>12}");
            }
            if has_places {
                let of_axis = |axis: usize| known(row.centroid.map(|centroid| centroid[axis]), 4);
                let _ = write!(text, "{:>12}{:>12}{:>12}", of_axis(0), of_axis(1), known(row.rms_radius, 4));
            }
            if has_peaks {
                let _ = write!(text, "{:>14}", known(row.peak_irradiance, 4));
            }
            let _ = writeln!(text, "  {}{}", plain(&row.sequence), few_rays::remark(row.few_rays));
        }
        if shown_rows.iter().any(|row| row.few_rays.is_some()) {
            text.push_str(few_rays::FOOTNOTE);
        }
        let hidden = &self.paths[shown_rows.len()..];
        if !hidden.is_empty() {
            let _ = writeln!(text, "{} more rows", thousands(hidden.len() as u64));
        }
        let why = match self.is_closed {
            true => "there are more paths than rows (--path-rows)",
            false => "rays that were traced again took other paths, as arithmetic is not strict here",
        };
        for light in &self.other {
            let _ = writeln!(
                text,
                "{} W of {} rays to {} have no row: {why}",
                significant(light.flux, 5),
                thousands(light.num_rays),
                shown(&light.end),
            );
        }
        text
    }
}
