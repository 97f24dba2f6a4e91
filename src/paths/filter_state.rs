//! Composes how a filter of paths decides: marks, numbers of events, and places in patterns, which each event changes.

use crate::model::path_filter::{Count, Events, Mark, Part, Pattern, Term};
use crate::model::{PathFilter, StepKind};
use std::fmt::Write;

/// The bit of a path's marks that says that the path has an event.
pub(super) const HAS_EVENT: u32 = 31;

/// Where a filter keeps its state among the words of a path: marks, numbers of events, and places in patterns.
pub(super) struct FilterState<'a> {
    pub(super) filter: &'a PathFilter,
    pub(super) counts: Vec<Count>,
    first: usize,
}

impl<'a> FilterState<'a> {
    pub(super) fn of(filter: &'a PathFilter, first: usize) -> Self {
        FilterState { filter, counts: filter.counts(), first }
    }

    pub(super) fn marks(&self) -> String {
        format!("path[{}]", self.first)
    }

    pub(super) fn count(&self, number: usize) -> String {
        format!("path[{}]", self.first + 1 + number)
    }

    pub(super) fn places(&self, number: usize) -> String {
        format!("path[{}]", self.first + 1 + self.counts.len() + number)
    }

    /// The word after the last.
    pub(super) fn end(&self) -> usize {
        self.first + 1 + self.counts.len() + self.filter.patterns.len()
    }

    /// Which parts of a pattern a part of a path matches, and the places in the pattern after that.
    pub(super) fn functions(&self, text: &mut String) {
        for (number, pattern) in self.filter.patterns.iter().enumerate() {
            let _ = writeln!(
                text,
                "fn places_{number}_after(kind: u32, number: u32) -> u32 {{\n    var matched = 0u;"
            );
            for (bit, condition) in bits_of_parts(pattern) {
                let _ = writeln!(text, "    matched |= select(0u, {}u, {condition});", 1_u32 << bit);
            }
            let (places, anywhere) = (self.places(number), pattern.anywhere());
            let _ = writeln!(
                text,
                "    let next = ({places} & {anywhere}u) | (({places} & matched) << 1u);\n    \
                 return next | ((next & {anywhere}u) << 1u);\n}}"
            );
        }
    }

    pub(super) fn begin(&self) -> String {
        let mut text = format!("    {} = 0u;\n", self.marks());
        for number in 0..self.counts.len() {
            let _ = writeln!(text, "    {} = 0u;", self.count(number));
        }
        for (number, pattern) in self.filter.patterns.iter().enumerate() {
            let _ = writeln!(text, "    {} = {}u;", self.places(number), pattern.start());
        }
        text
    }

    pub(super) fn extend(&self) -> String {
        let marks = self.marks();
        let mut text = String::new();
        for (bit, mark) in self.filter.marks.iter().enumerate() {
            let bit = 1_u32 << bit;
            let _ = match mark {
                Mark::Source(sources) => {
                    let is_it = part_of("FROM_SOURCE", sources);
                    writeln!(text, "    {marks} |= select(0u, {bit}u, {is_it});")
                }
                Mark::Some(events) => {
                    writeln!(text, "    {marks} |= select(0u, {bit}u, {});", is_step(events))
                }
                Mark::First(events) => {
                    let is_first = format!("(({marks} >> {HAS_EVENT}u) == 0u)");
                    writeln!(text, "    {marks} |= select(0u, {bit}u, {is_first} & {});", is_step(events))
                }
                Mark::Last(events) => {
                    writeln!(
                        text,
                        "    {marks} = ({marks} & {}u) | select(0u, {bit}u, {});",
                        !bit,
                        is_step(events)
                    )
                }
            };
        }
        let _ = writeln!(text, "    {marks} |= select(0u, {}u, kind < FROM_SOURCE);", 1_u32 << HAS_EVENT);
        for (number, count) in self.counts.iter().enumerate() {
            let kinds = is_kind(count.kinds());
            let _ = writeln!(text, "    {} += select(0u, 1u, {kinds});", self.count(number));
        }
        for number in 0..self.filter.patterns.len() {
            let _ = writeln!(text, "    {} = places_{number}_after(kind, number);", self.places(number));
        }
        text
    }

    pub(super) fn keeps(&self) -> String {
        let mut text = "    let kind = select(ON_DETECTOR, ELSEWHERE, index == NONE);\n".to_string();
        for (number, pattern) in self.filter.patterns.iter().enumerate() {
            let last = pattern.0.len();
            let _ = writeln!(
                text,
                "    let matches_{number} = (places_{number}_after(kind, index) >> {last}u) != 0u;"
            );
        }
        let _ = writeln!(text, "    return {};", self.holds(&self.filter.root));
        text
    }

    fn holds(&self, term: &Term) -> String {
        let joined = |terms: &[Term], sign: &str| {
            let terms: Vec<String> = terms.iter().map(|term| self.holds(term)).collect();
            joined(&terms, sign)
        };
        match term {
            Term::Not(inner) => format!("!{}", self.holds(inner)),
            Term::All(terms) => joined(terms, " & "),
            Term::Any(terms) => joined(terms, " | "),
            Term::Compare(count, comparison, constant) => {
                let number = self.counts.iter().position(|known| known == count).unwrap_or_default();
                format!("({} {} {constant}u)", self.count(number), comparison.sign())
            }
            Term::Marked(bit) => format!("(({} & {}u) != 0u)", self.marks(), 1_u32 << bit),
            Term::Matches(number) => format!("matches_{number}"),
        }
    }
}

/// The bits of a pattern's parts, and the conditions under which a part of a path matches them.
fn bits_of_parts(pattern: &Pattern) -> Vec<(usize, String)> {
    let condition = |part: &Part| match part {
        Part::Anything => None,
        Part::Source(sources) => Some(part_of("FROM_SOURCE", sources)),
        Part::Step(events) => Some(is_step(events)),
        Part::Detector(detectors) => Some(part_of("ON_DETECTOR", detectors)),
    };
    let parts = pattern.0.iter().enumerate();
    parts.filter_map(|(at, part)| Some((at, condition(part)?))).collect()
}

fn is_step(events: &Events) -> String {
    format!("({} & {})", is_kind(&events.kinds), is_number(&events.surfaces))
}

fn part_of(kind: &str, numbers: &[u32]) -> String {
    format!("((kind == {kind}) & {})", is_number(numbers))
}

fn is_kind(kinds: &[StepKind]) -> String {
    match kinds.len() == StepKind::ALL.len() {
        true => "(kind < FROM_SOURCE)".into(),
        false => any(kinds.iter().map(|kind| format!("(kind == {}u)", *kind as u32))),
    }
}

/// True if `number` is one of these, which ascend: neighbours are asked for at once.
pub(super) fn is_number(numbers: &[u32]) -> String {
    let runs = numbers.chunk_by(|a, b| a + 1 == *b);
    any(runs.map(|run| match run {
        [one] => format!("(number == {one}u)"),
        run => {
            let (first, last) = (run[0], run[run.len() - 1]);
            format!("((number >= {first}u) & (number <= {last}u))")
        }
    }))
}

fn any(conditions: impl Iterator<Item = String>) -> String {
    match conditions.collect::<Vec<_>>().as_slice() {
        [] => "false".into(),
        conditions => joined(conditions, " | "),
    }
}

/// Conditions joined by a sign, in brackets by halves: a compiler's stack need not hold a long chain.
pub(super) fn joined(conditions: &[String], sign: &str) -> String {
    match conditions {
        [one] => one.clone(),
        conditions => {
            let (first, second) = conditions.split_at(conditions.len() / 2);
            format!("({}{sign}{})", joined(first, sign), joined(second, sign))
        }
    }
}
