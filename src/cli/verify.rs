//! `nsq-gpu verify`: says what of a result is proven.

use crate::cli::device_args::DeviceArgs;
use crate::error::{Error, Result};
use crate::format::{pretty_json, shown, significant, thousands};
use crate::run::verify::{
    DEFAULT_SAMPLE, Finding, NUM_RANGES, OtherRays, Proven, SampledRange, Verdict, Verification, Verify,
};
use std::fmt::Write;
use std::path::PathBuf;

/// Most findings that are printed; `--json` has all.
const MOST_FINDINGS: usize = 20;

/// Arguments of `nsq-gpu verify`.
#[derive(clap::Args)]
#[command(after_help = "Example: nsq-gpu verify results --scene lens.json\n\n\
    Exit codes: 0 where the result holds (`verdict` says how much is proven), 6 where it is damaged or the scene does not \
    give it, 3 where there is no result.")]
pub struct Args {
    /// Folder that `trace -o` or `merge -o` wrote.
    result: PathBuf,
    /// The scene that was traced. Otherwise the path that the result has of it is taken.
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Ranges of the proof that are traced again. Without a proof so many 64ths of the result's rays are traced, but at least
    /// 65536 rays.
    #[arg(long, default_value_t = DEFAULT_SAMPLE, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=NUM_RANGES as i64))]
    sample: u32,
    #[command(flatten)]
    device: DeviceArgs,
    /// Print JSON instead of the text.
    #[arg(long)]
    json: bool,
}

/// Returns the text, or an error if the result does not hold.
pub fn run(args: &Args) -> Result<String> {
    let question =
        Verify::of(&args.result).scene(args.scene.clone()).sample(args.sample).adapter(args.device.choice());
    let found = question.go()?;
    let text = match args.json {
        true => pretty_json(&found).map_err(|error| Error::Internal(error.to_string()))?,
        false => text(&found),
    };
    let result = args.result.display();
    let failure = match found.verdict {
        Verdict::Proven | Verdict::Consistent => return Ok(text),
        Verdict::Whole => Error::Usage(format!(
            "{result}: the files are whole, and nothing more is known: {}",
            missing(&found)
        )),
        Verdict::Damaged => Error::Tolerance(format!("{result} is damaged")),
        Verdict::Different => Error::Tolerance(format!("{result} is not what the scene gives")),
    };
    crate::cli::console::ended(text, Some(failure))
}

/// What was missing, so that no ray was traced.
fn missing(found: &Verification) -> &str {
    found.notes.last().map_or("", String::as_str)
}

fn text(found: &Verification) -> String {
    let mut text = String::new();
    let mut line = |what: &str, said: &str| {
        let _ = writeln!(text, "{what:<10}{said}");
    };
    line("result", &found.result.display().to_string());
    line("files", &files(found));
    if found.has_sums {
        line("sums", "report and arrays are what the sums give, and the ledger closes");
    }
    if let Some(scene) = &found.scene {
        line("scene", &scene.display().to_string());
    }
    if let Some(proof) = &found.proof {
        line("proof", &ranges(proof));
    }
    if let Some(rays) = &found.other_rays {
        line("rays", &other_rays(rays));
    }
    found.notes.iter().for_each(|note| line("note", note));
    found.findings.iter().take(MOST_FINDINGS).for_each(|finding| line("wrong", &said(finding)));
    if let Some(more) = found.findings.len().checked_sub(MOST_FINDINGS).filter(|more| *more > 0) {
        line("wrong", &format!("and {more} more; --json has all"));
    }
    line("verdict", verdict(found.verdict));
    text
}

fn files(found: &Verification) -> String {
    let files = &found.files;
    let others = match files.others.as_slice() {
        [] => String::new(),
        others => format!(
            "; not of the result: {}",
            others.iter().map(|name| shown(name)).collect::<Vec<_>>().join(", ")
        ),
    };
    match files.has_hashes {
        true => format!("{} compared with their hashes{others}", files.num_checked),
        false => format!("no hashes{others}"),
    }
}

fn ranges(proof: &Proven) -> String {
    let num_rays: u64 = proof.sampled.iter().map(|range| range.num_rays).sum();
    let several = proof.sampled.iter().any(|range| range.part > 0);
    let name = |range: &SampledRange| match several {
        true => format!("{} of part {}", range.range, range.part),
        false => range.range.to_string(),
    };
    let names: Vec<String> = proof.sampled.iter().map(name).collect();
    let num_same = proof.sampled.iter().filter(|range| range.is_same).count();
    format!(
        "ranges {} of {} traced again on {}, {} rays: {num_same} of {} have the same bits",
        names.join(", "),
        proof.num_ranges,
        proof.adapter,
        thousands(num_rays),
        names.len()
    )
}

fn other_rays(rays: &OtherRays) -> String {
    let lines = rays.ledger.iter().filter_map(|line| line.score);
    let totals = rays.detectors.detectors.iter().filter_map(|detector| detector.total?.score);
    let largest = lines.chain(totals).fold(0.0_f64, |largest, score| largest.max(score.abs()));
    format!(
        "{} others, seed {}, in {} on {}: the largest difference is {} standard errors",
        thousands(rays.num_rays),
        rays.seed,
        rays.precision,
        rays.adapter,
        significant(largest, 2)
    )
}

fn said(finding: &Finding) -> String {
    let Finding { file, place, problem } = finding;
    let file = shown(file);
    if place.is_empty() {
        format!("{file}: {problem}")
    } else {
        format!("{file}: {}: {problem}", shown(place))
    }
}

fn verdict(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Proven => {
            "proven: the ranges that were traced again have the bits of the proof, and all ranges add up to the result"
        }
        Verdict::Consistent => "consistent: other rays of the scene give the same within chance",
        Verdict::Whole => "whole: the files are as they were written",
        Verdict::Damaged => "damaged: this is not what was written",
        Verdict::Different => "different: the scene does not give this result",
    }
}
