//! What happened to a ray, from its source up to an end: the sequence of a path.
//!
//! `S0 > T L1.front > R L1.back > R L1.front > T L1.back > image` is the sequence of a ghost of the lens `L1`. Each
//! part is a number of 32 bits, and three hashes of these numbers are the sequence's key. A ray carries its key, so
//! that a table can sum up rays by their sequences (shaders/paths/sequence.wgsl).

use crate::model::SceneIr;
use crate::model::surface_optics::splits;
use serde::{Deserialize, Serialize};

/// What a surface did to a ray that went on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum StepKind {
    /// The ray passed a refractive surface.
    Transmitted,
    /// The ray was reflected, by a mirror or by a refractive surface.
    Reflected,
    /// The ray was scattered to the other side of the surface.
    ScatteredThrough,
    /// The ray was scattered to the side that the ray came from.
    ScatteredBack,
}

/// One event of a ray that went on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Step {
    /// What happened.
    pub kind: StepKind,
    /// The surface's number in the scene.
    pub surface: u32,
}

/// Where a sequence ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum End {
    /// On the detector of this number. A ray that passes the detector goes on.
    Detector(u32),
    /// On the absorbing surface of this number.
    Absorbed(u32),
    /// The ray met nothing any more.
    Missed,
    /// The ray had as many events as a ray may have.
    DepthLimit,
    /// Russian roulette ended the ray.
    Roulette,
}

/// What happened to a ray, from its source up to an end.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Sequence {
    /// The source's number in the scene.
    pub source: u32,
    /// The events, the first one first. Passing a detector is no event.
    pub steps: Vec<Step>,
    /// Where the sequence ends.
    pub end: End,
}

/// Three hashes of a sequence. Two sequences of a full table share a key with a probability of 2^-61.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct SequenceKey(pub [u32; 3]);

/// The kinds of parts that are no steps. The kinds of steps come first, in their order.
const FROM_SOURCE: u32 = 4;
const ON_DETECTOR: u32 = 5;
const ON_ABSORBER: u32 = 6;
const ELSEWHERE: u32 = 7;

/// The first values of the three hashes, and their factors.
const SEEDS: [u32; 3] = [0x9E37_79B9, 0x85EB_CA6B, 0xC2B2_AE35];
const FACTORS: [u32; 3] = [0x2C1B_3C6D, 0x297A_2D39, 0xAC56_4B05];

impl StepKind {
    /// All kinds, in the order of their codes.
    pub const ALL: [StepKind; 4] =
        [StepKind::Transmitted, StepKind::Reflected, StepKind::ScatteredThrough, StepKind::ScatteredBack];

    /// The letters by which users know the kind.
    pub fn letters(self) -> &'static str {
        match self {
            StepKind::Transmitted => "T",
            StepKind::Reflected => "R",
            StepKind::ScatteredThrough => "ST",
            StepKind::ScatteredBack => "SR",
        }
    }

    /// True if the ray was scattered.
    pub fn is_scattered(self) -> bool {
        matches!(self, StepKind::ScatteredThrough | StepKind::ScatteredBack)
    }
}

/// The number of a part: its kind in the lowest three bits, and the number of the thing above.
fn code(kind: u32, number: u32) -> u32 {
    number << 3 | kind
}

impl Step {
    /// The step's number among the parts of sequences.
    pub fn code(self) -> u32 {
        code(self.kind as u32, self.surface)
    }

    /// The step of this number.
    pub fn of_code(code: u32) -> Option<Step> {
        let kind = *StepKind::ALL.get((code & 7) as usize)?;
        Some(Step { kind, surface: code >> 3 })
    }
}

impl End {
    /// The end's number among the parts of sequences.
    pub fn code(self) -> u32 {
        match self {
            End::Detector(number) => code(ON_DETECTOR, number),
            End::Absorbed(number) => code(ON_ABSORBER, number),
            End::Missed => code(ELSEWHERE, 0),
            End::DepthLimit => code(ELSEWHERE, 1),
            End::Roulette => code(ELSEWHERE, 2),
        }
    }

    /// The end of this number.
    pub fn of_code(code: u32) -> Option<End> {
        match (code & 7, code >> 3) {
            (ON_DETECTOR, number) => Some(End::Detector(number)),
            (ON_ABSORBER, number) => Some(End::Absorbed(number)),
            (ELSEWHERE, 0) => Some(End::Missed),
            (ELSEWHERE, 1) => Some(End::DepthLimit),
            (ELSEWHERE, 2) => Some(End::Roulette),
            _ => None,
        }
    }

    /// The end's place among all ends of a scene: detectors, then surfaces, then the others.
    pub fn place(self, ir: &SceneIr) -> usize {
        let (detectors, surfaces) = (ir.detectors.len(), ir.surfaces.len());
        match self {
            End::Detector(number) => number as usize,
            End::Absorbed(number) => detectors + number as usize,
            End::Missed => detectors + surfaces,
            End::DepthLimit => detectors + surfaces + 1,
            End::Roulette => detectors + surfaces + 2,
        }
    }

    /// All ends of a scene, in their places.
    pub fn all(ir: &SceneIr) -> Vec<End> {
        let detectors = (0..ir.detectors.len() as u32).map(End::Detector);
        let surfaces = (0..ir.surfaces.len() as u32).map(End::Absorbed);
        detectors.chain(surfaces).chain([End::Missed, End::DepthLimit, End::Roulette]).collect()
    }

    /// The end as users read it, the last part of a sequence.
    pub fn text(self, ir: &SceneIr) -> String {
        match self {
            End::Detector(number) => ir.detectors[number as usize].name.clone(),
            End::Absorbed(surface) => format!("A {}", ir.surface_name(surface as usize)),
            End::Missed => "M".into(),
            End::DepthLimit => "depth limit".into(),
            End::Roulette => "roulette".into(),
        }
    }

    /// The detector, if the sequence ends on one.
    pub fn detector(self) -> Option<usize> {
        match self {
            End::Detector(number) => Some(number as usize),
            End::Absorbed(_) | End::Missed | End::DepthLimit | End::Roulette => None,
        }
    }

    /// True if a ray comes to the end by one sequence at most. Several lead there only where rays are split or pass a
    /// detector.
    pub(crate) fn is_exclusive(self, ir: &SceneIr) -> bool {
        !splits(ir) && self.detector().is_none_or(|number| ir.detectors[number].absorb)
    }
}

impl SequenceKey {
    /// The key of a sequence that has only its source.
    fn of_source(source: u32) -> Self {
        SequenceKey(SEEDS).extended(code(FROM_SOURCE, source))
    }

    /// The key after one more part.
    fn extended(self, code: u32) -> Self {
        let [x, y, z] = self.0;
        let hash = |hash: u32, factor: u32| {
            let mixed = (hash ^ code).wrapping_mul(factor);
            mixed ^ (mixed >> 15)
        };
        SequenceKey([hash(x, FACTORS[0]), hash(y, FACTORS[1]), hash(z, FACTORS[2])])
    }

    /// The key as tables hold it: a word of 0 says that there is none.
    fn stored(self) -> Self {
        SequenceKey(self.0.map(|word| word.max(1)))
    }
}

impl Sequence {
    /// The key by which tables hold the sequence.
    pub fn key(&self) -> SequenceKey {
        let codes = self.steps.iter().map(|step| step.code()).chain([self.end.code()]);
        codes.fold(SequenceKey::of_source(self.source), SequenceKey::extended).stored()
    }

    /// The number of specular reflections.
    pub fn reflections(&self) -> usize {
        self.steps.iter().filter(|step| step.kind == StepKind::Reflected).count()
    }

    /// The number of scatterings.
    pub fn scatterings(&self) -> usize {
        self.steps.iter().filter(|step| step.kind.is_scattered()).count()
    }

    /// The steps as users know them: letters, and the surface's name. `A` is absorption, `M` a miss; both are last.
    pub fn named_steps(&self, ir: &SceneIr) -> Vec<[String; 2]> {
        let named = |letters: &str, surface: u32| [letters.to_string(), ir.surface_name(surface as usize)];
        let steps = self.steps.iter().map(|step| named(step.kind.letters(), step.surface));
        let last = match self.end {
            End::Absorbed(surface) => Some(named("A", surface)),
            End::Missed => Some(["M".to_string(), String::new()]),
            End::Detector(_) | End::DepthLimit | End::Roulette => None,
        };
        steps.chain(last).collect()
    }

    /// The sequence as users read it, such as `lamp > T L1.front > T L1.back > image`.
    pub fn text(&self, ir: &SceneIr) -> String {
        let source = ir.sources[self.source as usize].name.clone();
        let name =
            |step: &Step| format!("{} {}", step.kind.letters(), ir.surface_name(step.surface as usize));
        let parts = [source].into_iter().chain(self.steps.iter().map(name)).chain([self.end.text(ir)]);
        parts.collect::<Vec<_>>().join(" > ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    fn sequence(steps: &[(usize, u32)]) -> Sequence {
        let steps = steps.iter().map(|&(kind, surface)| Step { kind: StepKind::ALL[kind], surface });
        Sequence { source: 0, steps: steps.collect(), end: End::Detector(0) }
    }

    #[test]
    fn codes_tell_parts_apart() {
        let steps: Vec<Step> = (0..4).flat_map(|kind| sequence(&[(kind, 0), (kind, 77)]).steps).collect();
        assert!(steps.iter().all(|step| Step::of_code(step.code()) == Some(*step)));
        let ends = [End::Detector(3), End::Absorbed(3), End::Missed, End::DepthLimit, End::Roulette];
        assert!(ends.iter().all(|end| End::of_code(end.code()) == Some(*end)));
        let codes: HashSet<u32> =
            steps.iter().map(|step| step.code()).chain(ends.iter().map(|end| end.code())).collect();
        assert_eq!(codes.len(), steps.len() + ends.len());
        assert!(ends.iter().all(|end| Step::of_code(end.code()).is_none()));
    }

    /// Sequences of light that is reflected to and fro are much alike. For 2^20 of them, any two words of the keys are
    /// all unlike. Each word alone has only as many doubles as chance gives: 2^40 / 2^33 = 128.
    #[test]
    fn keys_of_like_sequences_are_unlike() {
        let sequences = (0..1 << 20).map(|bits: u32| {
            let steps: Vec<(usize, u32)> = (0..20).map(|at| (bits as usize >> at & 1, at % 4)).collect();
            sequence(&steps).key().0
        });
        let keys: Vec<[u32; 3]> = sequences.collect();
        for (a, b) in [(0, 1), (0, 2), (1, 2)] {
            let pairs: HashSet<(u32, u32)> = keys.iter().map(|key| (key[a], key[b])).collect();
            assert_eq!(pairs.len(), keys.len());
        }
        for word in 0..3 {
            let words: HashSet<u32> = keys.iter().map(|key| key[word]).collect();
            assert!(keys.len() - words.len() < 200, "{} doubles of word {word}", keys.len() - words.len());
        }
    }
}
