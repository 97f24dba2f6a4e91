//! Looks ahead: whether light of a path that has come so far may still be kept by a filter.
//!
//! A filter's expression is evaluated in three values: certainly true, certainly false, or not decided. Events to come
//! only add to counts, set marks and move patterns on, so each part of an expression has its own rule.

use crate::model::path_filter::{Mark, Relation, Term};
use crate::model::{Interaction, SceneIr};
use crate::paths::filter_state::{FilterState, HAS_EVENT, is_number, joined};
use std::fmt::Write;

/// Conditions in WGSL: that an expression may come to hold, and that it may come to fail.
struct Possible {
    holds: String,
    fails: String,
}

impl Possible {
    fn of(holds: impl Into<String>, fails: impl Into<String>) -> Self {
        Possible { holds: holds.into(), fails: fails.into() }
    }
}

/// The filter's functions, for a filter of this state.
pub fn functions(state: &FilterState, ir: &SceneIr, text: &mut String) {
    let scatterers: Vec<u32> = (0..)
        .zip(&ir.surfaces)
        .filter(|(_, surface)| surface.scatter.is_some() && surface.interaction == Interaction::Refractive)
        .map(|(number, _)| number)
        .collect();
    let _ = write!(
        text,
        "fn extend_filter(kind: u32, number: u32) {{\n{}}}\n\
         fn may_match() -> bool {{\n    return {};\n}}\n\
         fn may_scatter(number: u32) -> bool {{\n    return {};\n}}\n",
        state.extend(),
        possible(state, &state.filter.root).holds,
        is_number(&scatterers),
    );
}

fn possible(state: &FilterState, term: &Term) -> Possible {
    let all = |terms: &[Term]| -> (Vec<String>, Vec<String>) {
        terms.iter().map(|term| possible(state, term)).map(|Possible { holds, fails }| (holds, fails)).unzip()
    };
    match term {
        Term::Not(inner) => {
            let Possible { holds, fails } = possible(state, inner);
            Possible::of(fails, holds)
        }
        Term::All(terms) => {
            let (holds, fails) = all(terms);
            Possible::of(joined(&holds, " & "), joined(&fails, " | "))
        }
        Term::Any(terms) => {
            let (holds, fails) = all(terms);
            Possible::of(joined(&holds, " | "), joined(&fails, " & "))
        }
        Term::Compare(count, relation, constant) => {
            let number = state.counts.iter().position(|known| known == count).unwrap_or_default();
            let now = |sign: &str| format!("({} {sign} {constant}u)", state.count(number));
            // A count can only grow.
            match relation {
                Relation::Equal | Relation::AtMost => Possible::of(now("<="), "true"),
                Relation::Less => Possible::of(now("<"), "true"),
                Relation::Unequal | Relation::Greater => Possible::of("true", now("<=")),
                Relation::AtLeast => Possible::of("true", now("<")),
            }
        }
        Term::Marked(bit) => {
            let is_set = format!("(({} & {}u) != 0u)", state.marks(), 1_u32 << bit);
            match state.filter.marks[*bit] {
                Mark::Source(_) => Possible::of(is_set.clone(), format!("!{is_set}")),
                Mark::Some(_) => Possible::of("true", format!("!{is_set}")),
                Mark::First(_) => {
                    let is_open = format!("(({} >> {HAS_EVENT}u) == 0u)", state.marks());
                    Possible::of(format!("({is_set} | {is_open})"), format!("!{is_set}"))
                }
                Mark::Last(_) => Possible::of("true", "true"),
            }
        }
        Term::Matches(number) => {
            // At least the detector is to come: a pattern that is matched to its last part comes too early.
            let open = (1_u32 << state.filter.patterns[*number].0.len()) - 1;
            Possible::of(format!("(({} & {open}u) != 0u)", state.places(*number)), "true")
        }
    }
}
