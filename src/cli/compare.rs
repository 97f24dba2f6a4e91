//! `nsq-gpu compare`: tests whether two results differ by more than chance.

use crate::error::{Error, Result};
use crate::format::{pretty_json, shown, significant, thousands};
use crate::result::TraceResult;
use crate::result::comparison::{DetectorComparison, ResultComparison, compare};
use std::fmt::Write;
use std::path::PathBuf;

/// Arguments of `nsq-gpu compare`.
#[derive(clap::Args)]
pub struct Args {
    /// Folder that `trace -o` wrote.
    a: PathBuf,
    /// Another such folder.
    b: PathBuf,
    /// Largest difference of one number that chance is assumed to explain, in standard errors. For the largest of many
    /// cells, the limit is the value that is as rare.
    #[arg(long, default_value_t = 5.0, value_name = "X", value_parser = parse_sigmas)]
    sigmas: f64,
    /// Print JSON instead of the table.
    #[arg(long)]
    json: bool,
}

fn parse_sigmas(text: &str) -> std::result::Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| (1.0..=30.0).contains(number));
    number.ok_or_else(|| format!("`{text}` is not a number in 1..=30"))
}

/// Returns the table, or an error if the two results disagree.
pub fn run(args: &Args) -> Result<String> {
    let (a, b) = (TraceResult::read(&args.a)?, TraceResult::read(&args.b)?);
    for (path, result) in [(&args.a, &a), (&args.b, &b)] {
        if result.run.is_unchecked {
            crate::cli::console::say(&result.run.unchecked_notice(path));
        }
    }
    let found = compare(&a, &b, args.sigmas);
    let text = match args.json {
        true => pretty_json(&found).map_err(|error| Error::Internal(error.to_string()))?,
        false => {
            header(&args.a, "A", &a) + &header(&args.b, "B", &b) + "\n" + &table(&found) + &notes(&found)
        }
    };
    if found.agree {
        return Ok(text);
    }
    crate::cli::console::print(&text)?;
    let apart = found.detectors.iter().filter(|detector| !detector.agree);
    let names: Vec<String> = apart.map(|detector| format!("'{}'", shown(&detector.name))).collect();
    Err(Error::Tolerance(format!("A and B disagree on {}", names.join(", "))))
}

fn header(path: &std::path::Path, side: &str, result: &TraceResult) -> String {
    let run = &result.run;
    format!(
        "{side}: {}, {} rays, seed {}, {} ({})\n",
        path.display(),
        thousands(result.num_rays_total),
        run.seed,
        run.precision,
        run.sampler
    )
}

fn table(found: &ResultComparison) -> String {
    let widest =
        found.detectors.iter().map(|detector| shown(&detector.name).chars().count()).max().unwrap_or(0);
    let width = widest.max(8) + 2;
    let mut table = format!(
        "{:<width$}{:>13}{:>13}{:>12}{:>11}{:>8}{:>10}{:>8}{:>9}{:>7}\n",
        "detector", "A [W]", "B [W]", "A - B [W]", "sigma [W]", "sigmas", "cells", "rms", "largest", "limit"
    );
    for detector in &found.detectors {
        let _ = writeln!(table, "{:<width$}{}", shown(&detector.name), line(detector));
    }
    table
}

fn line(detector: &DetectorComparison) -> String {
    let number =
        |value: Option<f64>, digits: usize| value.map_or("-".into(), |value| significant(value, digits));
    let [a, b] = detector.total_flux.map(|flux| number(flux, 7));
    let total = detector.total;
    let difference = number(total.map(|total| total.difference), 2);
    let sigma = number(total.map(|total| total.sigma), 2);
    let score = match total {
        Some(total) => total.score.map_or("inf".into(), |score| format!("{score:.1}")),
        None => "-".into(),
    };
    let mut line = format!("{a:>13}{b:>13}{difference:>12}{sigma:>11}{score:>8}");
    if let Some(map) = &detector.map {
        let largest = match map.largest_score {
            Some(score) => format!("{score:.1}"),
            None if map.num_cells == 0 => "-".into(),
            None => "inf".into(),
        };
        let cells = thousands(map.num_cells);
        let _ = write!(line, "{cells:>10}{:>8.2}{largest:>9}{:>7.1}", map.rms_score, map.limit);
    }
    if !detector.agree {
        line += "  DISAGREE";
    }
    if let Some(problem) = &detector.problem {
        let _ = write!(line, ": {problem}");
    }
    line
}

fn notes(found: &ResultComparison) -> String {
    let mut text = String::from(
        "\ncells: those in which each side has 12 hits or more, or would be expected to\nrms, largest: of (A - B) / sigma over \
         the cells; chance alone gives an rms near 1, and a largest value below the limit\n",
    );
    if found.errors_from_hits {
        text += "some standard errors are not in the files (`trace --standard-error on`): value / sqrt(hits) instead\n";
    }
    if found.same_draws {
        text += "A and B have the same seed, and so the same draws: of one scene, they differ less than chance would have it\n";
    }
    text
}
