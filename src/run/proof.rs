//! The proof of a result: a hash of the sums of each range of rays, which anybody can trace again.
//!
//! A trace is cut into [`NUM_RANGES`] ranges of rays. Sums are integers and add up in any order. So the sums of a
//! range's rays alone are what the sums have gained since the range before. The SHA-256 of these is kept, and a
//! checksum of each part. Checksums are linear: over all ranges they add up to the result's checksum. So a result
//! cannot hold more or less than its ranges.
//!
//! The proof leaves out rows of ray databases, recorded paths and the table of paths. The proof also leaves out marks,
//! such as that a surface was reached. None of these add up.

use crate::engine::budget::{SourceRays, distribute, part};
use crate::error::{Error, Result};
use crate::format::thousands;
use crate::gpu::AdapterInfo;
use crate::model::SceneIr;
use crate::result::{DetectorTally, FluxSum, RaySpan, RaySpans, Tally};
use crate::run::{Progress, TraceOptions};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// Ranges of a trace.
pub const NUM_RANGES: u64 = 64;

/// Cells whose sums are read and hashed in about the time of a ray, as measured on processors.
const CELLS_PER_RAY: u64 = 16;

/// The end of ray ids.
const MOST_RAYS: u64 = 1 << 63;

/// The proof of a result: one for each trace whose sums were added up.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Proof {
    /// The traces.
    pub parts: Vec<PartProof>,
}

/// The proof of one trace.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PartProof {
    /// Rays that the trace was planned with.
    pub num_rays: u64,
    /// Id of the first ray.
    pub first_ray: u64,
    /// Number of rays of the larger trace of which this one is a part, if it is one.
    pub of_rays: Option<u64>,
    /// Name of the adapter.
    pub adapter: String,
    /// Its driver, and whether arithmetic was strict.
    pub driver: String,
    /// The ranges, each from the end of the one before.
    pub ranges: Vec<RangeProof>,
}

/// The proof of a range of rays.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RangeProof {
    /// The position of the trace at its end. A position counts the rays of all sources.
    pub end: u64,
    /// SHA-256 of its sums.
    pub sha256: [u8; 32],
    /// A checksum of what belongs to no detector, and then of each detector.
    pub checksums: Vec<u128>,
}

impl PartProof {
    fn new(options: &TraceOptions, adapter: &AdapterInfo) -> Self {
        PartProof {
            num_rays: options.num_rays,
            first_ray: options.first_ray,
            of_rays: options.of_rays,
            adapter: adapter.name.clone(),
            driver: options.driver(adapter),
            ranges: Vec::new(),
        }
    }

    /// True if these may be the ranges of a trace. A file with the right checksum may hold anything.
    pub(crate) fn is_sound(&self) -> bool {
        let ends = self.ranges.iter().map(|range| range.end);
        let end = self.first_ray.checked_add(self.num_rays).filter(|end| *end <= MOST_RAYS);
        std::iter::once(0).chain(ends).is_sorted_by(|one, next| one < next)
            && !self.ranges.is_empty()
            && end.is_some_and(|end| self.of_rays.is_none_or(|of_rays| (end..=MOST_RAYS).contains(&of_rays)))
    }

    /// The position at which the last range ends.
    pub fn end(&self) -> u64 {
        self.ranges.last().map_or(0, |range| range.end)
    }

    /// The positions between which a range lies.
    pub(crate) fn positions(&self, range: usize) -> [u64; 2] {
        [range.checked_sub(1).map_or(0, |before| self.ranges[before].end), self.ranges[range].end]
    }

    /// The same options, with the rays of this trace.
    pub(crate) fn options(&self, options: &TraceOptions) -> TraceOptions {
        let PartProof { num_rays, first_ray, of_rays, .. } = *self;
        TraceOptions { num_rays, first_ray, of_rays, ..options.clone() }
    }
}

/// The rays of a trace from one position to another.
pub(crate) fn rays_between(ir: &SceneIr, options: &TraceOptions, [first, end]: [u64; 2]) -> Result<RaySpans> {
    let sources: Vec<SourceRays> =
        part(distribute(ir, options.budget(), options.shares.as_deref())?, options)?;
    let length = sources.iter().map(|rays| rays.count).sum();
    let mut set = RaySpans::default();
    for (source, rays) in (0..).zip(&sources) {
        let [before, done] = [first, end].map(|position| rays.done(position.min(length), length));
        set += RaySpan { first: rays.first + before, count: done - before, source };
    }
    Ok(set)
}

/// Refuses a proof that would cost more than the trace.
pub(crate) fn check_cost(ir: &SceneIr, num_rays: u64) -> Result<()> {
    let cells: u64 = ir.detectors.iter().map(|detector| detector.num_cells() as u64).sum();
    let least = cells.saturating_mul(NUM_RANGES) / CELLS_PER_RAY;
    if num_rays >= least {
        return Ok(());
    }
    Err(Error::Usage(format!(
        "--proof would cost more than the trace: the sums of {} pixels would be hashed {NUM_RANGES} times for {} rays; \
         give -n {} or more, fewer pixels, or leave out --proof",
        thousands(cells),
        thousands(num_rays),
        thousands(least)
    )))
}

/// The integers of a tally that add up, in lists: first what belongs to no detector, then several lists of each detector.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Sums(Vec<Vec<Vec<u128>>>);

impl Sums {
    pub(crate) fn of(tally: &Tally) -> Self {
        let of_detectors = tally.detectors.iter().map(lists);
        Sums(std::iter::once(vec![others(tally)]).chain(of_detectors).collect())
    }

    /// What these have gained since sums of fewer rays.
    fn since(&self, before: &Sums) -> Self {
        let gained = |after: &[u128], before: &[u128]| {
            let before = before.iter().copied().chain(std::iter::repeat(0));
            after.iter().zip(before).map(|(after, before)| after.wrapping_sub(before)).collect()
        };
        let none = Vec::new();
        let groups = self.0.iter().enumerate().map(|(group, lists)| {
            let before = before.0.get(group).unwrap_or(&none);
            lists
                .iter()
                .enumerate()
                .map(|(list, after)| gained(after, before.get(list).map_or(&[], Vec::as_slice)))
                .collect()
        });
        Sums(groups.collect())
    }

    pub(crate) fn sha256(&self) -> [u8; 32] {
        let mut hasher = Sha256::new();
        hasher.update(b"nsq-gpu: sums of a range of rays, 1");
        let mut bytes = Vec::new();
        for lists in &self.0 {
            // Where rays keep their weight, all sums of a cell follow from its hits.
            let first = lists.get(HITS);
            for (number, list) in lists.iter().enumerate() {
                let factor = first.filter(|_| number > HITS).and_then(|hits| factor(hits, list));
                match factor {
                    Some(factor) => {
                        hasher.update([1]);
                        hasher.update(factor.to_le_bytes());
                    }
                    None => hash_list(&mut hasher, list, &mut bytes),
                }
            }
        }
        hasher.finalize().into()
    }

    /// A polynomial over each group, modulo 2^128. Its factors are odd, so that no change of one integer goes unnoticed.
    pub(crate) fn checksums(&self) -> Vec<u128> {
        let of_list = |list: &Vec<u128>| {
            list.iter()
                .rev()
                .fold(0_u128, |sum, value| sum.wrapping_mul(FACTOR_OF_PLACE).wrapping_add(*value))
        };
        let of_group = |lists: &Vec<Vec<u128>>| {
            let add = |sum: u128, list| sum.wrapping_mul(FACTOR_OF_LIST).wrapping_add(of_list(list));
            lists.iter().fold(0, add)
        };
        self.0.iter().map(of_group).collect()
    }
}

/// The place of the hits among the lists of a detector.
const HITS: usize = 2;
/// Factors of the checksums: odd, with bits by chance (the digits of pi, and of e).
const FACTOR_OF_PLACE: u128 = 0x243F_6A88_85A3_08D3_1319_8A2E_0370_7345;
const FACTOR_OF_LIST: u128 = 0xB7E1_5162_8AED_2A6A_BF71_5880_9CF4_F3C7;

/// The factor by which all numbers of a list differ from another's, if it is one factor for all.
fn factor(of: &[u128], list: &[u128]) -> Option<u128> {
    let place = of.iter().position(|number| *number != 0)?;
    let factor = list.get(place)? / of[place];
    let is_multiple = |(number, value): (&u128, &u128)| number.wrapping_mul(factor) == *value;
    (factor != 0 && of.len() == list.len() && of.iter().zip(list).all(is_multiple)).then_some(factor)
}

/// Hashes a list: the number of its integers, how many bytes the largest of them takes, and so many bytes of each. A
/// list whose last integers are 0 has the hash of a shorter one. So sums that were never begun have the hash of zeros.
fn hash_list(hasher: &mut Sha256, list: &[u128], bytes: &mut Vec<u8>) {
    let length = list.iter().rposition(|value| *value != 0).map_or(0, |last| last + 1);
    let bits = list.iter().fold(0, |bits, value| bits | value);
    let width = (u128::BITS - bits.leading_zeros()).div_ceil(8) as usize;
    bytes.clear();
    bytes.push(0);
    bytes.extend((length as u64).to_le_bytes());
    bytes.push(width as u8);
    list[..length].iter().for_each(|value| bytes.extend_from_slice(&value.to_le_bytes()[..width]));
    hasher.update(bytes);
}

fn others(tally: &Tally) -> Vec<u128> {
    let pair = |sum: &FluxSum| [u128::from(sum.count), sum.quanta];
    let lines = [
        &tally.launched,
        &tally.escaped,
        &tally.depth_killed,
        &tally.roulette_loss,
        &tally.roulette_gain,
        &tally.bulk,
        &tally.importance_loss,
        &tally.importance_gain,
        &tally.coating,
        &tally.bsdf_loss,
        &tally.bsdf_gain,
        &tally.filtered_out,
    ];
    let of_surfaces = tally.surfaces.iter().flat_map(|surface| {
        let [count, quanta] = pair(&surface.absorbed);
        [count, quanta, surface.entered_twice.into(), surface.ended_inside.into()]
    });
    let counts = [tally.medium_stack_underflows, tally.invalid_deposits].map(u128::from);
    lines.into_iter().flat_map(pair).chain(counts).chain(of_surfaces).collect()
}

fn lists(sums: &DetectorTally) -> Vec<Vec<u128>> {
    let recorded = vec![sums.recorded.count.into(), sums.recorded.quanta, sums.ended_inside.into()];
    let totals = sums.totals.iter().flat_map(|moments| [moments.quanta, moments.squares]).collect();
    let hits = sums.hits.iter().map(|hits| u128::from(*hits)).collect();
    vec![recorded, totals, hits, sums.quanta.clone(), sums.squares.clone(), sums.replicates.clone()]
}

/// Keeps the proof of a trace while it runs.
pub(crate) struct ProofKeeper {
    parts: Vec<PartProof>,
    own: PartProof,
    before: Sums,
    num_rays: u64,
    position: u64,
}

impl ProofKeeper {
    /// For a trace of so many rays that goes on from a position, with the sums and the proof that it had there.
    pub(crate) fn new(
        ir: &SceneIr,
        options: &TraceOptions,
        adapter: &AdapterInfo,
        (num_rays, position): (u64, u64),
        begun: &Tally,
        proof: Option<Proof>,
    ) -> Result<Self> {
        let mut parts = proof.map_or_else(Vec::new, |proof| proof.parts);
        let mut own = PartProof::new(options, adapter);
        // The sums of several traces are whole, and nothing is traced.
        if let [begun] = parts.as_slice()
            && (begun.num_rays, begun.first_ray, begun.of_rays) == (own.num_rays, own.first_ray, own.of_rays)
        {
            own = parts.remove(0);
        }
        let covers_all = rays_between(ir, options, [0, own.end()])? == begun.rays;
        if !covers_all && (parts.is_empty() || position < num_rays) {
            return Err(Error::Usage(
                "the sums that the trace should go on from have no proof of all their rays; leave out --proof, or begin anew".into(),
            ));
        }
        let position = position.max(own.end());
        Ok(ProofKeeper { parts, own, before: Sums::of(begun), num_rays, position })
    }

    /// The end of the range that begins at a position, or that it lies in.
    pub(crate) fn next_end(&self, position: u64) -> u64 {
        let end = |number: u128| (u128::from(self.num_rays) * number / u128::from(NUM_RANGES)) as u64;
        (1..=u128::from(NUM_RANGES)).map(end).find(|end| *end > position).unwrap_or(self.num_rays)
    }

    /// Looks whether a range ends with this pass.
    pub(crate) fn after_pass(&mut self, progress: &mut Progress<'_, '_>) -> Result<()> {
        let before = std::mem::replace(&mut self.position, progress.position());
        if before < self.position && self.next_end(before) <= self.position {
            self.end_range(progress.tally()?);
        }
        progress.pause_before(self.next_end(self.position));
        Ok(())
    }

    fn end_range(&mut self, tally: &Tally) {
        if self.own.end() < self.position {
            let sums = Sums::of(tally);
            self.own.ranges.push(self.range(&sums));
            self.before = sums;
        }
    }

    fn range(&self, sums: &Sums) -> RangeProof {
        let gained = sums.since(&self.before);
        RangeProof { end: self.position, sha256: gained.sha256(), checksums: gained.checksums() }
    }

    /// The proof of the rays so far, whose sums these are. A range that is not done is a shorter one.
    pub(crate) fn so_far(&self, tally: &Tally) -> Proof {
        let mut own = self.own.clone();
        if own.end() < self.position {
            own.ranges.push(self.range(&Sums::of(tally)));
        }
        let own = (!own.ranges.is_empty()).then_some(own);
        Proof { parts: self.parts.iter().cloned().chain(own).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tally(numbers: &[u128]) -> Tally {
        let detector = DetectorTally {
            quanta: numbers.to_vec(),
            hits: numbers.iter().map(|number| *number as u64 & 0xFFFF).collect(),
            ..DetectorTally::default()
        };
        let escaped = FluxSum { count: 3, quanta: numbers[0] };
        Tally { detectors: vec![detector], escaped, ..Tally::default() }
    }

    #[test]
    fn what_a_range_gains_does_not_depend_on_what_was_there() {
        let (first, second) = (tally(&[5, 0, 1 << 80]), tally(&[1 << 100, 7, 0]));
        let mut both = first.clone();
        both += &second;
        let gained = Sums::of(&both).since(&Sums::of(&first));
        assert_eq!(gained.sha256(), Sums::of(&second).sha256());
        // Sums that were never begun are the same as sums of 0.
        let begun = Sums::of(&both).since(&Sums::of(&Tally::default()));
        assert_eq!(begun.sha256(), Sums::of(&both).sha256());
        let checksums = [&first, &second].map(|tally| Sums::of(tally).checksums());
        let added: Vec<u128> =
            checksums[0].iter().zip(&checksums[1]).map(|(a, b)| a.wrapping_add(*b)).collect();
        assert_eq!(added, Sums::of(&both).checksums());
    }

    #[test]
    fn every_number_counts() {
        let sums = Sums::of(&tally(&[5, 0, 1 << 80]));
        for group in 0..sums.0.len() {
            for list in 0..sums.0[group].len() {
                for number in 0..sums.0[group][list].len() {
                    for bit in [0, 63, 64, 127] {
                        let mut changed = sums.clone();
                        changed.0[group][list][number] ^= 1 << bit;
                        assert_ne!(changed.sha256(), sums.sha256());
                        let differ: Vec<bool> =
                            changed.checksums().iter().zip(sums.checksums()).map(|(a, b)| *a != b).collect();
                        assert!(differ[group] && differ.iter().filter(|differ| **differ).count() == 1);
                    }
                }
            }
        }
        // Numbers that change places.
        let [one, other] = [tally(&[5, 7]), tally(&[7, 5])].map(|tally| Sums::of(&tally));
        assert!(one.sha256() != other.sha256() && one.checksums()[1] != other.checksums()[1]);
    }
}
