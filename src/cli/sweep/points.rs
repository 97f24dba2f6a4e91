//! The points of a sweep, as JSON, as comma-separated values, and as tables for people.

use crate::format::{csv_text, digits_beside, pretty_json, shown, significant};
use crate::result::few_rays;
use crate::run::sweep::{SweepFlux, SweepFluxes, SweepPoint, Swept};
use serde_json::{Map, Value, json};
use std::fmt::Write;

impl SweepPoint {
    fn entry(&self) -> Value {
        let numbers: Map<String, Value> =
            self.numbers.iter().map(|(name, value)| (name.clone(), json!(value))).collect();
        match &self.outcome {
            Ok(SweepFluxes { seed, num_rays, fluxes }) => {
                let flux = |flux: &SweepFlux| {
                    let mut entry = json!({"flux": flux.flux, "standard_error": flux.error});
                    few_rays::add_to(&mut entry, flux.few_rays);
                    (flux.name.clone(), entry)
                };
                let fluxes: Map<String, Value> = fluxes.iter().map(flux).collect();
                json!({"index": self.index, "set": numbers, "seed": seed, "num_rays": num_rays, "fluxes": fluxes})
            }
            Err(problem) => json!({"index": self.index, "set": numbers, "error": problem}),
        }
    }
}

impl Swept {
    pub(super) fn is_of_tolerances(&self) -> bool {
        self.nominal.is_some()
    }

    /// What a point is called.
    pub(super) fn kind(&self) -> &'static str {
        if self.is_of_tolerances() { "sample" } else { "point" }
    }

    /// Which of the points this is, for people: `point 2 (L1.r1 = 50)`.
    pub(super) fn label(&self, point: &SweepPoint) -> String {
        let set = point.numbers.iter().map(|(name, value)| format!("{} = {value}", shown(name)));
        format!("{} {} ({})", self.kind(), point.index, set.collect::<Vec<_>>().join(", "))
    }

    fn num_refused(&self) -> usize {
        self.refused().count()
    }

    /// All points; of tolerances also the scene as it is, and quantiles of each flux. Fluxes are in W.
    pub(super) fn document(&self) -> String {
        let mut document = json!({
            "num_points": self.num_points,
            "num_refused": self.num_refused(),
            "partial": self.is_partial(),
            "points": self.points.iter().map(SweepPoint::entry).collect::<Vec<_>>(),
        });
        if let Some(nominal) = &self.nominal {
            let mut entry = nominal.entry();
            entry.as_object_mut().into_iter().for_each(|entry| drop(entry.shift_remove("index")));
            document["nominal"] = entry;
            let of_each = self.quantiles().into_iter().map(|row| {
                let [least, low, middle, high, most] = row.quantiles;
                (row.name, json!({"minimum": least, "5%": low, "50%": middle, "95%": high, "maximum": most}))
            });
            document["quantiles"] = Value::Object(of_each.collect());
        }
        pretty_json(&document).unwrap_or_default()
    }

    fn columns(&self) -> Vec<Column> {
        let Some(first) = self.points.first() else { return Vec::new() };
        let column = |kind, name: &str, value: &dyn Fn(&SweepPoint) -> Option<f64>| Column {
            kind,
            name: name.into(),
            values: self.points.iter().map(value).collect(),
        };
        let numbers = (0..).zip(&first.numbers);
        let mut columns: Vec<Column> = numbers
            .map(|(i, (name, _)): (usize, _)| {
                column(ColumnKind::Number, name, &|point| Some(point.numbers[i].1))
            })
            .collect();
        let fluxes = self.points.iter().find_map(SweepPoint::traced).map_or(&[][..], |traced| &traced.fluxes);
        for (i, SweepFlux { name, .. }) in fluxes.iter().enumerate() {
            let flux = |point: &SweepPoint| point.traced().map(|traced| traced.fluxes[i].flux);
            let error = |point: &SweepPoint| point.traced().and_then(|traced| traced.fluxes[i].error);
            columns.push(column(ColumnKind::Flux, name, &flux));
            let errors = column(ColumnKind::Error, name, &error);
            columns.extend(errors.values.iter().any(Option::is_some).then_some(errors));
            let bound = |point: &SweepPoint| Some(point.traced()?.fluxes[i].few_rays?.upper_bound_95);
            let bounds = column(ColumnKind::Bound, name, &bound);
            columns.extend(bounds.values.iter().any(Option::is_some).then_some(bounds));
        }
        columns
    }

    /// A line of a title each, then a line a point. A number that is not known is an empty cell. If a point lacks its
    /// numbers, a last column says why.
    pub(super) fn csv(&self) -> String {
        let columns = self.columns();
        let title = |Column { kind, name, .. }: &Column| match kind {
            ColumnKind::Number => csv_text(name),
            ColumnKind::Flux => csv_text(&format!("{name} [W]")),
            ColumnKind::Error => csv_text(&format!("{name} standard error [W]")),
            ColumnKind::Bound => csv_text(&format!("{name} upper bound 95 % [W]")),
        };
        let has_problems = self.is_partial() || self.num_refused() > 0;
        let line = |cells: Vec<String>, problem: &str| {
            let problem = has_problems.then(|| csv_text(problem));
            cells.into_iter().chain(problem).collect::<Vec<_>>().join(",") + "\n"
        };
        let mut text = line(columns.iter().map(title).collect(), "problem");
        for (i, point) in self.points.iter().enumerate() {
            let cell = |column: &Column| column.values[i].map_or(String::new(), |value| format!("{value:?}"));
            let problem = point.outcome.as_ref().err().map_or("", String::as_str);
            text += &line(columns.iter().map(cell).collect(), problem);
        }
        if self.is_partial() {
            let problem = format!("partial: {} of {} points", self.points.len(), self.num_points);
            text += &line(vec![String::new(); columns.len()], &problem);
        }
        text
    }

    /// The text for stdout.
    pub(super) fn text(&self) -> String {
        let mut text = if self.is_of_tolerances() { self.quantile_table() } else { self.table() };
        if self.is_partial() {
            let _ = writeln!(text, "partial: {} of {} points", self.points.len(), self.num_points);
        }
        text
    }

    fn table(&self) -> String {
        let columns = self.columns();
        // A bound stands in the place of the error.
        let is_apart = |at: usize| {
            columns[at].kind != ColumnKind::Bound || at == 0 || columns[at - 1].kind != ColumnKind::Error
        };
        let shown_columns: Vec<usize> = (0..columns.len()).filter(|at| is_apart(*at)).collect();
        let title = |at: &usize| match (columns[*at].kind, shown(&columns[*at].name)) {
            (ColumnKind::Number, name) => format!("{name:>14}"),
            (ColumnKind::Flux, name) => format!("{:>18}", format!("{name} [W]")),
            (ColumnKind::Error | ColumnKind::Bound, _) => format!("{:>12}", "error"),
        };
        let mut text = shown_columns.iter().map(title).collect::<String>() + "\n";
        for i in 0..self.points.len() {
            // What a column that follows has of the point, if it is of this kind.
            let next = |at: usize, kind: ColumnKind| {
                columns.get(at + 1).filter(|column| column.kind == kind).and_then(|column| column.values[i])
            };
            let cell = |at: &usize| {
                let value = columns[*at].values[i];
                let known = |digits: usize| value.map_or("-".into(), |value| significant(value, digits));
                let bound = match columns[*at].kind {
                    ColumnKind::Number => return format!("{:>14}", known(8)),
                    ColumnKind::Flux => {
                        let error = next(*at, ColumnKind::Error);
                        return format!("{:>18}", known(digits_beside(value.unwrap_or(0.0), error)));
                    }
                    ColumnKind::Error => next(*at, ColumnKind::Bound),
                    ColumnKind::Bound => value,
                };
                format!("{:>12}", bound.map(few_rays::bound).unwrap_or_else(|| known(2)))
            };
            text += &(shown_columns.iter().map(cell).collect::<String>() + "\n");
        }
        if columns.iter().any(|column| column.kind == ColumnKind::Bound) {
            text += few_rays::FOOTNOTE;
        }
        text
    }

    fn quantile_table(&self) -> String {
        let (num_samples, num_refused) = (self.points.len(), self.num_refused());
        let of_which = match num_refused {
            0 => String::new(),
            1 => ", without 1 that cannot be".into(),
            _ => format!(", without {num_refused} that cannot be"),
        };
        let mut text = format!(
            "{} samples{of_which}\n{:<18}{:>14}{:>14}{:>14}{:>14}{:>14}{:>14}\n",
            num_samples - num_refused,
            "flux [W]",
            "as it is",
            "minimum",
            "5 %",
            "50 %",
            "95 %",
            "maximum"
        );
        for row in self.quantiles() {
            let _ = write!(text, "{:<18}{:>14}", shown(&row.name), significant(row.nominal, 7));
            row.quantiles.iter().for_each(|value| {
                let _ = match value {
                    Some(value) => write!(text, "{:>14}", significant(*value, 7)),
                    None => write!(text, "{:>14}", "-"),
                };
            });
            text.push('\n');
        }
        text
    }
}

/// A column of the points: a number, a flux, or a flux's standard error where some point has one.
struct Column {
    kind: ColumnKind,
    name: String,
    values: Vec<Option<f64>>,
}

#[derive(Clone, Copy, PartialEq)]
enum ColumnKind {
    Number,
    Flux,
    Error,
    Bound,
}
