//! Composes how the paths of rays are followed (shaders/paths): what words a path has, and how a filter decides.

use crate::error::{Error, Result};
use crate::guide;
use crate::model::path_filter::{Count, Events, Mark, Part, Pattern, Term};
use crate::model::{PathFilter, StepKind};
use crate::paths::ahead;
use crate::paths::layout::PathTableLayout;
use crate::paths::sums::PathSums;
use crate::program::Program;
use crate::program::addition::ShaderAddition;
use crate::program::input::ProgramInput;
use crate::program::wgsl::composition::Composition;
use crate::program::wgsl::constants::Constants;
use crate::program::wgsl::text::Text;
use crate::shaders::{ShaderFile, shader};
use std::fmt::Write;
use std::sync::Arc;

/// Words of a sequence's key, the first of a path.
const KEY_WORDS: usize = 3;

/// The bit of a path's marks that says that the path has an event.
pub(super) const HAS_EVENT: u32 = 31;

/// How a scene's shader follows paths.
#[derive(Debug)]
pub(super) struct PathShader {
    sums: PathSums,
    filter: Option<Arc<PathFilter>>,
    is_guided: bool,
    /// What the rows of the table are.
    pub(super) layout: PathTableLayout,
}

impl PathShader {
    pub(super) fn new(
        sums: PathSums,
        filter: Option<Arc<PathFilter>>,
        is_guided: bool,
        scene: &ProgramInput,
    ) -> Self {
        let layout = match sums {
            PathSums::Maps(_) => PathTableLayout::of_maps(scene.ir, sums.has_ends()),
            PathSums::None | PathSums::Totals { .. } | PathSums::Events { .. } => {
                PathTableLayout::of_totals(scene.ir, sums.has_ends(), scene.constant_weights)
            }
        };
        PathShader { sums, filter, is_guided, layout }
    }

    /// How the shader of a program follows paths.
    pub(super) fn of(program: &Program) -> Result<&Self> {
        let none = || Error::Internal("the program follows no paths".into());
        program.additions.get().ok_or_else(none)
    }
}

impl ShaderAddition for PathShader {
    fn replaces(&self) -> Vec<(&'static str, ShaderFile)> {
        let of_sums: &[_] = match self.sums {
            PathSums::Events { .. } => &[
                ("stages/ids", shader!("stages/ids.listed.wgsl")),
                ("stages/launched", shader!("stages/launched.listed.wgsl")),
            ],
            PathSums::Maps(_) => &[("sums/replicates", shader!("sums/replicates.by_path.wgsl"))],
            _ => &[],
        };
        let always = [
            (
                "stages/path",
                match self.ends_early() {
                    true => shader!("paths/followed.early.wgsl"),
                    false => shader!("paths/followed.wgsl"),
                },
            ),
            ("stages/lobe", shader!("paths/lobes.wgsl")),
            ("stages/family", shader!("paths/families.wgsl")),
            ("stages/queue_entry", shader!("paths/queued.wgsl")),
        ];
        [&always, of_sums].concat()
    }

    fn add(&self, composition: &Composition, text: &mut Text) -> Result<()> {
        text.files(self.files(composition));
        text.composed("paths::wgsl", &self.functions(composition));
        Ok(())
    }

    fn begin(&self) -> &'static str {
        if self.sums.has_table() { "    path_head = path_head_uniform;\n" } else { "" }
    }

    fn rows_per_ray(&self, max_depth: u32) -> u64 {
        match self.sums {
            // Each event, and the end.
            PathSums::Events { .. } => u64::from(max_depth + 2),
            PathSums::None | PathSums::Totals { .. } | PathSums::Maps(_) => 0,
        }
    }

    fn counts_events_unread(&self) -> bool {
        self.sums.has_table()
    }
}

impl PathShader {
    /// True if rays end as soon as no light of their paths can be kept any more.
    fn ends_early(&self) -> bool {
        self.is_guided && self.filter.is_some()
    }

    /// The files that paths need, beside those of slots.
    fn files(&self, composition: &Composition) -> Vec<ShaderFile> {
        let sums = match self.sums {
            PathSums::None => shader!("paths/sums.none.wgsl"),
            PathSums::Totals { .. } => shader!("paths/sums.totals.wgsl"),
            PathSums::Maps(_) => shader!("paths/sums.maps.wgsl"),
            PathSums::Events { .. } => shader!("paths/sums.events.wgsl"),
        };
        let replayed = match composition.features.splits {
            true => shader!("paths/replayed.families.wgsl"),
            false => shader!("paths/replayed.alone.wgsl"),
        };
        let files = [
            (true, sums),
            (matches!(self.sums, PathSums::Events { .. }), replayed),
            (self.sums != PathSums::None, shader!("paths/sequence.wgsl")),
            (self.sums.has_table(), shader!("paths/table.wgsl")),
            (self.filter.is_some(), shader!("paths/filter_out.wgsl")),
        ];
        files.into_iter().filter(|(is_needed, _)| *is_needed).map(|(_, file)| file).collect()
    }

    fn functions(&self, composition: &Composition) -> String {
        let has_key = self.sums != PathSums::None;
        let filter = self.filter.as_deref();
        let state = filter.map(|filter| FilterState::of(filter, if has_key { KEY_WORDS } else { 0 }));
        let num_words = state.as_ref().map_or(if has_key { KEY_WORDS } else { 0 }, |state| state.end());
        let mut constants = Constants::default();
        let of_guide = if self.is_guided { guide::wgsl::num_path_words(self.filter.is_some()) } else { 0 };
        constants.uint("PATH_WORDS", (num_words + of_guide).max(1) as u32);
        if self.is_guided {
            constants.uint("GUIDE_NODE", num_words as u32);
            constants.uint("GUIDE_RATIO", num_words as u32 + 1);
            constants.uint("GUIDE_ALONE", num_words as u32 + 2);
        }
        constants.uint("NUM_DETECTORS", composition.ir.detectors.len() as u32);
        constants.bool("PATHS_HAVE_ENDS", self.sums.has_ends());
        if self.sums.has_table() {
            constants.uint("NUM_ENDS", self.layout.num_ends);
            constants.uint("PATH_ROW_WORDS", self.layout.row_words);
            constants.bool("PATH_WEIGHTS_VARY", !composition.constant_weights);
        }
        if has_key {
            let index_bits = composition.splitting.map_or(u32::BITS, |splitting| splitting.index_bits());
            constants.uint("PATH_INDEX_MASK", u32::MAX >> (u32::BITS - index_bits));
        }
        if let Some(filtered) = composition.cells.filtered {
            constants.uint("CELL_FILTERED", filtered);
        }
        let mut text = constants.text().to_string();
        // The number of a ray within its family, in the bits of its index above the place in the dispatch.
        let number = if composition.splitting.is_some() { "index >> INDEX_BITS" } else { "0u" };
        let _ = writeln!(text, "fn family_number(index: u32) -> u32 {{\n    return {number};\n}}");
        let [begin, extend] =
            if has_key { ["    begin_key();\n", "    extend_key(kind, number);\n"] } else { ["", ""] };
        let (mut begin, mut extend) = (begin.to_string(), extend.to_string());
        let mut keeps = "    return true;\n".to_string();
        match &state {
            Some(state) => {
                state.functions(&mut text);
                begin.push_str(&state.begin());
                match self.ends_early() {
                    true => {
                        ahead::functions(state, composition.ir, &mut text);
                        extend.push_str("    extend_filter(kind, number);\n");
                    }
                    false => extend.push_str(&state.extend()),
                }
                keeps = state.keeps();
            }
            None => text.push_str("fn filter_out(weight: real, ends: bool) {}\n"),
        }
        if self.is_guided {
            extend.push_str("    extend_guide(kind, number);\n");
        }
        let _ = write!(
            text,
            "fn start_path() {{\n{begin}}}\n\
             fn extend_path(kind: u32, number: u32) {{\n{extend}}}\n\
             fn keeps_path(index: u32) -> bool {{\n{keeps}}}\n"
        );
        text
    }
}

/// Where a filter keeps its state among the words of a path: marks, numbers of events, and places in patterns.
pub(super) struct FilterState<'a> {
    pub(super) filter: &'a PathFilter,
    pub(super) counts: Vec<Count>,
    first: usize,
}

impl<'a> FilterState<'a> {
    fn of(filter: &'a PathFilter, first: usize) -> Self {
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
    fn end(&self) -> usize {
        self.first + 1 + self.counts.len() + self.filter.patterns.len()
    }

    /// Which parts of a pattern a part of a path matches, and the places in the pattern after that.
    fn functions(&self, text: &mut String) {
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

    fn begin(&self) -> String {
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

    fn keeps(&self) -> String {
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
