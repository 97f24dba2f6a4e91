//! Which paths of light are kept: an expression over the sequence of a path, as `--where` has it.
//!
//! `reflections == 2 and not scattered(mount)` keeps the ghosts of two reflections that the mount did not scatter. The
//! expression is decided where light is deposited, by what happened up to there. A shader decides by a few words of
//! state that each event changes (`paths::wgsl`); [`PathFilter::keeps`] decides by a whole sequence.

use crate::model::sequence::{End, Sequence, StepKind};

/// Most questions about single events in one expression: each has a bit.
pub const MOST_MARKS: usize = 31;

/// Most patterns in one expression.
pub const MOST_PATTERNS: usize = 4;

/// Most parts of a pattern.
pub const MOST_PARTS: usize = 31;

/// A filter of paths.
#[derive(Debug, Clone, PartialEq)]
pub struct PathFilter {
    /// The expression, as the user wrote it.
    pub text: String,
    /// What is decided.
    pub root: Term,
    /// The questions about single events, by the numbers that terms have.
    pub marks: Vec<Mark>,
    /// The patterns, by the numbers that terms have.
    pub patterns: Vec<Pattern>,
}

/// A part of an expression.
#[derive(Debug, Clone, PartialEq)]
pub enum Term {
    /// The term does not hold.
    Not(Box<Term>),
    /// Every term holds.
    All(Vec<Term>),
    /// Some term holds.
    Any(Vec<Term>),
    /// A number of events compares so with a constant.
    Compare(Count, Relation, u32),
    /// The mark of this number is set.
    Marked(usize),
    /// The sequence matches the pattern of this number.
    Matches(usize),
}

/// What is counted along a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Count {
    /// Specular reflections.
    Reflections,
    /// Scatterings, to either side.
    Scatterings,
    /// Passages of refractive surfaces that did not scatter.
    Transmissions,
    /// All events.
    Events,
}

/// How two numbers compare.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names say it")]
pub enum Relation {
    Equal,
    Unequal,
    Less,
    AtMost,
    Greater,
    AtLeast,
}

/// A question about single events, whose answer is a bit.
#[derive(Debug, Clone, PartialEq)]
pub enum Mark {
    /// The path begins at one of these sources.
    Source(Vec<u32>),
    /// Some event was one of these.
    Some(Events),
    /// The first event was one of these.
    First(Events),
    /// The last event was one of these.
    Last(Events),
}

/// Kinds of events on some surfaces.
#[derive(Debug, Clone, PartialEq)]
pub struct Events {
    /// The kinds.
    pub kinds: Vec<StepKind>,
    /// The numbers of the surfaces, ascending.
    pub surfaces: Vec<u32>,
}

/// The parts of a sequence, from the source to the detector. At most [`MOST_PARTS`].
#[derive(Debug, Clone, PartialEq)]
pub struct Pattern(pub Vec<Part>);

/// A part of a pattern.
#[derive(Debug, Clone, PartialEq)]
pub enum Part {
    /// Any number of parts.
    Anything,
    /// One of these sources.
    Source(Vec<u32>),
    /// One of these events.
    Step(Events),
    /// One of these detectors.
    Detector(Vec<u32>),
}

impl Count {
    /// All counts, by the names that users write.
    pub const ALL: [(&'static str, Count); 4] = [
        ("reflections", Count::Reflections),
        ("scatterings", Count::Scatterings),
        ("transmissions", Count::Transmissions),
        ("events", Count::Events),
    ];

    /// The kinds of events that are counted.
    pub fn kinds(self) -> &'static [StepKind] {
        match self {
            Count::Reflections => &[StepKind::Reflected],
            Count::Scatterings => &[StepKind::ScatteredThrough, StepKind::ScatteredBack],
            Count::Transmissions => &[StepKind::Transmitted],
            Count::Events => &StepKind::ALL,
        }
    }
}

impl Relation {
    /// All comparisons, by their signs. A sign that begins another one comes after it.
    pub const ALL: [(&'static str, Relation); 6] = [
        ("==", Relation::Equal),
        ("!=", Relation::Unequal),
        ("<=", Relation::AtMost),
        (">=", Relation::AtLeast),
        ("<", Relation::Less),
        (">", Relation::Greater),
    ];

    /// The sign.
    pub fn sign(self) -> &'static str {
        Relation::ALL.iter().find(|(_, known)| *known == self).map_or("", |(sign, _)| sign)
    }

    fn holds(self, left: u32, right: u32) -> bool {
        match self {
            Relation::Equal => left == right,
            Relation::Unequal => left != right,
            Relation::Less => left < right,
            Relation::AtMost => left <= right,
            Relation::Greater => left > right,
            Relation::AtLeast => left >= right,
        }
    }
}

impl Events {
    fn hold(&self, kind: StepKind, surface: u32) -> bool {
        self.kinds.contains(&kind) && self.surfaces.binary_search(&surface).is_ok()
    }
}

impl PathFilter {
    /// The numbers of events that the expression asks for, each once.
    pub fn counts(&self) -> Vec<Count> {
        fn add(term: &Term, counts: &mut Vec<Count>) {
            match term {
                Term::Not(inner) => add(inner, counts),
                Term::All(terms) | Term::Any(terms) => terms.iter().for_each(|term| add(term, counts)),
                Term::Compare(count, ..) if !counts.contains(count) => counts.push(*count),
                Term::Compare(..) | Term::Marked(_) | Term::Matches(_) => {}
            }
        }
        let mut counts = Vec::new();
        add(&self.root, &mut counts);
        counts
    }

    /// True if light of this sequence is kept.
    pub fn keeps(&self, sequence: &Sequence) -> bool {
        self.holds(&self.root, sequence)
    }

    fn holds(&self, term: &Term, sequence: &Sequence) -> bool {
        match term {
            Term::Not(inner) => !self.holds(inner, sequence),
            Term::All(terms) => terms.iter().all(|term| self.holds(term, sequence)),
            Term::Any(terms) => terms.iter().any(|term| self.holds(term, sequence)),
            Term::Compare(count, comparison, constant) => {
                let counted = sequence.steps.iter().filter(|step| count.kinds().contains(&step.kind));
                comparison.holds(counted.count() as u32, *constant)
            }
            Term::Marked(number) => self.marks[*number].is_set(sequence),
            Term::Matches(number) => self.patterns[*number].matches(sequence),
        }
    }
}

impl Mark {
    fn is_set(&self, sequence: &Sequence) -> bool {
        let mut steps = sequence.steps.iter();
        match self {
            Mark::Source(sources) => sources.contains(&sequence.source),
            Mark::Some(events) => steps.any(|step| events.hold(step.kind, step.surface)),
            Mark::First(events) => steps.next().is_some_and(|step| events.hold(step.kind, step.surface)),
            Mark::Last(events) => steps.next_back().is_some_and(|step| events.hold(step.kind, step.surface)),
        }
    }
}

impl Pattern {
    /// Bits of the places where any number of parts may stand.
    pub fn anywhere(&self) -> u32 {
        (0..)
            .zip(&self.0)
            .filter(|(_, part)| **part == Part::Anything)
            .fold(0, |bits, (at, _)| bits | 1 << at)
    }

    /// The set of places before the first part: bit i says that the first i parts are matched.
    pub fn start(&self) -> u32 {
        self.closed(1)
    }

    /// A place where anything may stand may also be empty. Two such places never follow each other.
    fn closed(&self, places: u32) -> u32 {
        places | ((places & self.anywhere()) << 1)
    }

    fn after(&self, places: u32, matching: impl Fn(&Part) -> bool) -> u32 {
        let bits = (0..).zip(&self.0).filter(|(_, part)| matching(part));
        let matched = bits.fold(0, |bits, (at, _)| bits | 1 << at);
        self.closed((places & self.anywhere()) | ((places & matched) << 1))
    }

    fn matches(&self, sequence: &Sequence) -> bool {
        let source = |part: &Part| matches!(part, Part::Source(all) if all.contains(&sequence.source));
        let mut places = self.after(self.start(), source);
        for step in &sequence.steps {
            let one = |part: &Part| matches!(part, Part::Step(all) if all.hold(step.kind, step.surface));
            places = self.after(places, one);
        }
        let end = |part: &Part| match (part, sequence.end) {
            (Part::Detector(all), End::Detector(number)) => all.contains(&number),
            _ => false,
        };
        places = self.after(places, end);
        places >> self.0.len() & 1 == 1
    }
}
