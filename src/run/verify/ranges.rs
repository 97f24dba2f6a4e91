//! Whether ranges of rays, traced again, give the bits of a proof.

use crate::error::Result;
use crate::format::thousands;
use crate::gpu::{AdapterChoice, Gpu};
use crate::model::{Precision, SceneIr, ray_id, surface_optics};
use crate::result::output::TALLY;
use crate::result::{DetectorData, FluxSum, RaySpans, RunInfo, Tally, TraceResult};
use crate::run::blocks::trace_on;
use crate::run::checkpoint::{Checkpoint, Identity};
use crate::run::precision::WantedPrecision;
use crate::run::proof::{Proof, RangeProof, Sums, rays_between};
use crate::run::verify::finding::Finding;
use crate::run::verify::like::{options_like, word_of};
use crate::run::{Run, StandardError, Strict, TraceOptions, Tracer};
use crate::scene::Scene;
use serde::Serialize;
use serde_json::Value;
use std::sync::Arc;

/// What the ranges of a proof say.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Proven {
    /// Ranges of the proof, over all parts.
    pub num_ranges: usize,
    /// Rays that they cover.
    pub num_rays: u64,
    /// Those that were traced again.
    pub sampled: Vec<SampledRange>,
    /// What traced them.
    pub adapter: String,
}

/// A range that was traced again.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SampledRange {
    /// The number of the part, from 0 on.
    pub part: usize,
    /// The number of the range within it, from 0 on.
    pub range: usize,
    /// Its rays.
    pub num_rays: u64,
    /// True if they gave the same bits.
    pub is_same: bool,
    /// True if they must: the trace was made here, by this version.
    pub is_promised: bool,
}

impl Proven {
    /// True if every range that was traced again gave the same bits.
    pub fn is_same(&self) -> bool {
        self.sampled.iter().all(|range| range.is_same)
    }

    /// What cannot be, whatever traced the ranges.
    pub(super) fn findings(&self) -> Vec<Finding> {
        let broken = self.sampled.iter().filter(|range| range.is_promised && !range.is_same);
        let said = broken.map(|range| {
            let problem = format!("its {} rays, traced again, give other sums", thousands(range.num_rays));
            Finding::at(TALLY, &place(range.part, range.range), &problem)
        });
        said.collect()
    }
}

fn place(part: usize, range: usize) -> String {
    format!("part {part}, range {range} of the proof")
}

/// Compares the sums with their proof: the ranges are the rays that were traced, and their checksums add up.
pub(super) fn check(
    stored: &TraceResult,
    (sums, proof): (&Checkpoint, &Proof),
    ir: &SceneIr,
    findings: &mut Vec<Finding>,
) -> Result<u64> {
    let mut covered = RaySpans::default();
    let mut num_rays = 0;
    let expected = Sums::of(&sums.tally).checksums();
    let mut added = vec![0_u128; expected.len()];
    let mut wrong = |place: String, problem: &str| findings.push(Finding::at(TALLY, &place, problem));
    let options = options_of(stored, &sums.identity, ir)?;
    for (number, part) in proof.parts.iter().enumerate() {
        if !part.is_sound() {
            wrong(format!("part {number} of the proof"), "has ranges that no trace has");
            return Ok(0);
        }
        let rays = rays_between(ir, &part.options(&options), [0, part.end()])?;
        let count = rays.spans().iter().map(|span| span.count).sum::<u64>();
        num_rays = u64::saturating_add(num_rays, count);
        covered += &rays;
        for RangeProof { checksums, .. } in &part.ranges {
            added.iter_mut().zip(checksums).for_each(|(sum, checksum)| *sum = sum.wrapping_add(*checksum));
        }
    }
    if num_rays < sums.tally.launched.count {
        return Ok(num_rays);
    }
    if covered != sums.tally.rays || num_rays != sums.tally.launched.count {
        wrong("the proof".into(), "is of other rays than the sums");
        return Ok(0);
    }
    let names =
        std::iter::once("the ledger").chain(ir.detectors.iter().map(|detector| detector.name.as_str()));
    for (name, _) in names.zip(added.iter().zip(&expected)).filter(|(_, (added, expected))| added != expected)
    {
        wrong(name.into(), "is not the sum of the ranges of the proof");
    }
    Ok(num_rays)
}

/// Traces some ranges again. Which ones follows from the hash of the result.
pub(super) fn trace(
    (stored, report): (&TraceResult, &Value),
    scene: &Scene,
    ir: &SceneIr,
    (sums, proof): (&Checkpoint, &Proof),
    (sha256, sample): (&str, u32),
    adapter: &AdapterChoice,
    findings: &mut Vec<Finding>,
) -> Result<Proven> {
    let gpu = Gpu::open(adapter)?;
    let options = options_of(stored, &sums.identity, ir)?;
    let all = proof.parts.iter().enumerate();
    let mut places: Vec<(usize, usize)> =
        all.flat_map(|(part, ranges)| (0..ranges.ranges.len()).map(move |range| (part, range))).collect();
    let mut proven =
        Proven { num_ranges: places.len(), num_rays: 0, sampled: Vec::new(), adapter: gpu.info.name.clone() };
    choose(&mut places, sample as usize, sha256);
    for (number, part) in proof.parts.iter().enumerate() {
        let chosen: Vec<usize> =
            places.iter().filter(|(part, _)| *part == number).map(|(_, range)| *range).collect();
        if chosen.is_empty() {
            continue;
        }
        let strict = if part.driver.ends_with(", strict") { Strict::On } else { Strict::Off };
        let options = TraceOptions { strict, ..part.options(&options) };
        let wanted = WantedPrecision::Exactly(options.precision);
        let run =
            Run::of(scene, ir).options(options).max_depth(sums.identity.max_depth).precision(wanted).on(&gpu);
        let options = run.settle(&gpu)?.options;
        let is_promised = sums.identity.version == env!("CARGO_PKG_VERSION")
            && (&part.adapter, &part.driver) == (&gpu.info.name, &options.driver(&gpu.info));
        let mut tracer = Tracer::new(&gpu, ir, &options)?;
        for range in chosen {
            let tally = trace_range(&mut tracer, ir, &options, part.positions(range))?;
            let is_same = Sums::of(&tally).sha256() == part.ranges[range].sha256;
            let num_rays = tally.launched.count;
            proven.sampled.push(SampledRange { part: number, range, num_rays, is_same, is_promised });
            if is_same {
                compare_rows((stored, report), ir, &tally, &place(number, range), findings)?;
            }
        }
    }
    Ok(proven)
}

/// The sums of the rays between two positions of a trace alone.
fn trace_range(
    tracer: &mut Tracer,
    ir: &SceneIr,
    options: &TraceOptions,
    [first, end]: [u64; 2],
) -> Result<Tally> {
    let before = rays_between(ir, options, [0, first])?;
    let count = before.spans().iter().map(|span| span.count).sum();
    let launched = FluxSum { count, quanta: 0 };
    let mut tally = trace_on(tracer, (launched, before), end, |_| true)?.tally;
    tally.launched.count -= count;
    tally.rays = rays_between(ir, options, [first, end])?;
    Ok(tally)
}

/// Keeps so many places, as the hash says.
fn choose(places: &mut Vec<(usize, usize)>, sample: usize, sha256: &str) {
    let sample = sample.min(places.len());
    for number in 0..sample {
        let word = word_of(&format!("range {number} of {sha256}"), 8);
        let other = number + (word % (places.len() - number) as u64) as usize;
        places.swap(number, other);
    }
    places.truncate(sample);
    places.sort_unstable();
}

/// The options of the trace whose sums these are, but for its rays. The report agrees with the sums about all of them.
fn options_of(stored: &TraceResult, identity: &Identity, ir: &SceneIr) -> Result<TraceOptions> {
    let precision = [Precision::F32, Precision::Df64, Precision::F64];
    Ok(TraceOptions {
        precision: precision
            .into_iter()
            .find(|tier| tier.name() == identity.precision)
            .unwrap_or(Precision::F64),
        standard_error: match identity.standard_error.as_str() {
            "on" => StandardError::On,
            "off" => StandardError::Off,
            _ => StandardError::Auto,
        },
        guide: identity.guide.clone().map(Arc::new),
        ..options_like(&stored.run, ir)?
    })
}

/// Compares the rows of ray databases, which no hash of sums holds, with rows of rays that were traced again.
fn compare_rows(
    (stored, report): (&TraceResult, &Value),
    ir: &SceneIr,
    tally: &Tally,
    place: &str,
    findings: &mut Vec<Finding>,
) -> Result<()> {
    let rays = tally.rays.clone();
    let splits = surface_optics::splits(ir);
    let is_of_range = |id: u64| {
        let launched = if splits { id % ray_id::MOST_LAUNCHED } else { id };
        rays.spans().iter().any(|span| (span.first..span.end()).contains(&launched))
    };
    let num_rays = if stored.run.partial { stored.num_rays_total } else { stored.run.num_rays };
    let run = RunInfo { num_rays, partial: false, ..stored.run.clone() };
    let again = TraceResult::new(ir, &run, tally)?;
    for (stored, again) in stored.detectors.iter().zip(&again.detectors) {
        let (DetectorData::RayDatabase(stored_rows), DetectorData::RayDatabase(again)) =
            (&stored.data, &again.data)
        else {
            continue;
        };
        let (file, again) = (stored_rows.columns()?, again.columns()?);
        let row = |columns: &crate::result::RayColumns, row: usize| {
            let reals =
                columns.position.iter().chain(&columns.direction).chain([&columns.flux, &columns.wavelength]);
            (columns.ray_id[row], reals.map(|column| column[row].to_bits()).collect::<Vec<u64>>())
        };
        let kept: Vec<_> = (0..file.ray_id.len())
            .filter(|index| is_of_range(file.ray_id[*index]))
            .map(|index| row(&file, index))
            .collect();
        let all: Vec<_> = (0..again.ray_id.len()).map(|index| row(&again, index)).collect();
        // A capped database keeps the last rows of all.
        let is_same = if stored_rows.truncated { all.ends_with(&kept) } else { all == kept };
        if !is_same {
            let problem = format!("its rays of {place}, traced again, are others");
            let file = report["detectors"][&stored.name]["file"].as_str().unwrap_or(&stored.name);
            findings.push(Finding::at(file, "rows", &problem));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sample_follows_from_the_hash_and_has_each_range_equally_often() {
        let chosen = |hash: &str, sample| {
            let mut places: Vec<(usize, usize)> = (0..64).map(|range| (0, range)).collect();
            choose(&mut places, sample, hash);
            places
        };
        assert_eq!(chosen("a", 3), chosen("a", 3));
        assert_eq!(chosen("a", 100).len(), 64);
        let mut counts = [0_u32; 64];
        for hash in 0..6400 {
            let places = chosen(&hash.to_string(), 3);
            assert!(places.len() == 3 && places.is_sorted_by(|one, next| one < next));
            places.iter().for_each(|(_, range)| counts[*range] += 1);
        }
        // 300 each, within five standard deviations.
        assert!(counts.iter().all(|count| count.abs_diff(300) < 87), "{counts:?}");
    }
}
