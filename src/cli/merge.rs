//! `nsq-gpu merge`: adds up the results of several traces.

use crate::cli::console::{read_scene, say};
use crate::cli::pictures::PictureArgs;
use crate::cli::trace::Printed;
use crate::error::{Error, Result};
use crate::format::path_text;
use crate::model::{Precision, SceneIr};
use crate::result::wavelengths_apart;
use crate::result::{GuideInfo, PathTally, RaySpans, RunInfo, Tally, TraceResult, output};
use crate::run::checkpoint::{Checkpoint, Identity, scene_of_hash};
use crate::run::proof::Proof;
use crate::scene::Scene;
use std::path::{Path, PathBuf};

/// Arguments of `nsq-gpu merge`.
#[derive(clap::Args)]
pub struct Args {
    /// Folders that `trace -o` wrote, or files of `--checkpoint`.
    #[arg(required = true, num_args = 2.., value_name = "RESULT")]
    results: Vec<PathBuf>,
    /// Write the result of all rays into this folder.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    #[command(flatten)]
    pictures: PictureArgs,
    /// Say the result in lumens, lux and candela as well. Of light of several wavelengths that takes results of trace
    /// --photometric, which say so by themselves.
    #[arg(long)]
    photometric: bool,
    /// The scene file, if it was moved.
    #[arg(long, value_name = "SCENE")]
    scene: Option<PathBuf>,
    /// Print report.json instead of the text report.
    #[arg(long)]
    json: bool,
}

/// Adds the sums, writes the files, and returns the text for stdout.
pub fn run(args: &Args) -> Result<String> {
    let parts: Vec<Checkpoint> =
        args.results.iter().map(|path| Checkpoint::read(path)).collect::<Result<_>>()?;
    let first = &parts[0].identity;
    let path = args.scene.clone().or_else(|| first.scene.as_ref().map(PathBuf::from));
    let path =
        path.ok_or_else(|| Error::Usage("the scene of the results is not known; name it by --scene".into()))?;
    let scene = read_scene(&path).map_err(|error| match error {
        Error::File { path, problem } if args.scene.is_none() => {
            Error::file(path, format!("{problem}; --scene names the scene where it has moved"))
        }
        other => other,
    })?;
    let Some(mut ir) = scene_of_hash(scene.lower()?, parts[0].identity.scene_hash) else {
        return Err(Error::Usage(format!(
            "the scene in {} is not, or no longer, the one that {} was traced of; name that one by --scene",
            path_text(&path),
            args.results[0].display()
        )));
    };
    let is_photometric = args.photometric || scene.is_photometric();
    if args.photometric && ir.wavelengths.len() > 1 && !wavelengths_apart::is_apart(&ir) {
        return Err(Error::Usage("--photometric: the results were traced without it".into()));
    }
    check(&args.results, &parts, &ir)?;
    first.set_sampling(&mut ir);
    let pictures = args.pictures.style(&ir, is_photometric || wavelengths_apart::is_apart(&ir))?;
    if let Some(dir) = &args.output {
        let real = |path: &Path| path.canonicalize().ok();
        let is_input = |result: &&PathBuf| {
            real(dir).is_some_and(|dir| {
                real(result) == Some(dir.clone())
                    || real(result).is_some_and(|file| file.parent() == Some(&dir))
            })
        };
        if let Some(result) = args.results.iter().find(is_input) {
            let problem = format!(
                "holds {}, which is added up and would be lost; name another folder",
                result.display()
            );
            return Err(Error::file(dir, problem));
        }
        let names = ir.detectors.iter().map(|detector| detector.name.as_str());
        let colored = scene.color_detectors();
        let ray_paths = parts.iter().any(|part| !part.tally.paths.is_empty());
        let paths = parts.iter().any(|part| part.tally.path_sums.is_some());
        output::check(
            dir,
            &output::file_names(names, pictures.map(|_| &colored[..]), ray_paths, paths, true),
        )?;
    }
    let merged = merge(&ir, &parts)?;
    if merged.tally.path_sums.as_ref().is_some_and(PathTally::is_too_large) {
        return Err(Error::Usage(
            "the results have more paths together than their tables have rows, and no part knows which of them then have \
             rows; trace the parts with a larger --path-rows"
                .into(),
        ));
    }
    let chosen = || parts.iter().filter_map(|part| part.tally.path_sums.as_ref()?.chosen.as_ref());
    if merged.tally.path_sums.as_ref().is_some_and(|sums| sums.is_closed)
        && chosen().zip(chosen().skip(1)).any(|(one, next)| one != next)
    {
        return Err(Error::Usage(
            "the tables of paths do not add up: each part chose its own paths for its rows; trace the parts with --of-rays, \
             or with a larger --path-rows"
                .into(),
        ));
    }
    say(&on_the_bits(&ir, &parts, &merged.tally.rays));
    let photometric = is_photometric || wavelengths_apart::is_apart(&ir);
    let color = if photometric { scene.color_detectors() } else { Vec::new() };
    let split_depth = ir.sampling.split_depth;
    let info = RunInfo { photometric, color, split_depth, ..run_info(&path, &scene, &merged) };
    let result = TraceResult::new(&ir, &info, &merged.tally)?;
    let printed = Printed { json: args.json, pictures };
    crate::cli::trace::deliver(&result, || merged.to_bytes().map(Some), args.output.as_deref(), printed)
}

/// Adds the sums of all parts, which were checked.
fn merge(ir: &SceneIr, parts: &[Checkpoint]) -> Result<Checkpoint> {
    let mut tally = Tally::zeros(ir);
    for part in parts {
        tally += &part.tally;
        let together = |problem| Error::Usage(format!("what the results come to together {problem}"));
        tally.check_sums().map_err(together)?;
    }
    tally.sort_rows(ir);
    let all = |value: fn(&Identity) -> &String| {
        let mut values: Vec<&str> = parts.iter().map(|part| value(&part.identity).as_str()).collect();
        values.sort_unstable();
        values.dedup();
        values.join(" and ")
    };
    let same_whole = parts.iter().all(|part| part.identity.of_rays == parts[0].identity.of_rays);
    let identity = Identity {
        num_rays: tally.launched.count,
        first_ray: parts.iter().map(|part| part.identity.first_ray).min().unwrap_or_default(),
        of_rays: parts[0].identity.of_rays.filter(|_| same_whole),
        adapter: all(|identity| &identity.adapter),
        driver: all(|identity| &identity.driver),
        ..parts[0].identity.clone()
    };
    let proofs = parts.iter().filter_map(|part| part.proof.clone());
    let proof = proofs.reduce(|all, proof| Proof { parts: [all.parts, proof.parts].concat() });
    Ok(Checkpoint { identity, tally, proof })
}

/// Refuses results that cannot be added: of different traces, or of the same rays.
fn check(paths: &[PathBuf], parts: &[Checkpoint], ir: &SceneIr) -> Result<()> {
    paths.iter().zip(parts).try_for_each(|(path, part)| part.check_rows(path, "--first-ray"))?;
    for (path, part) in paths.iter().zip(parts) {
        let differences = parts[0].identity.differences(&part.identity);
        if !differences.is_empty() {
            return Err(Error::Usage(format!(
                "{} does not add up with {}: {}",
                path.display(),
                paths[0].display(),
                differences.join("; ")
            )));
        }
    }
    paths.iter().zip(parts).try_for_each(|(path, part)| part.check(path, ir))?;
    for (index, (path, part)) in paths.iter().zip(parts).enumerate() {
        for (other_path, other) in paths.iter().zip(parts).take(index) {
            if let Some((first, end)) = part.tally.rays.overlap(&other.tally.rays) {
                return Err(Error::Usage(format!(
                    "{} and {} both hold the rays {first} to {}; give each trace its own by --first-ray",
                    other_path.display(),
                    path.display(),
                    end - 1
                )));
            }
        }
    }
    Ok(())
}

/// Says whether one run would have given the same bits, and if not, why.
fn on_the_bits(ir: &SceneIr, parts: &[Checkpoint], rays: &RaySpans) -> String {
    let first = &parts[0].identity;
    let mut reasons = Vec::new();
    if !parts.iter().all(|part| part.identity.same_device(first)) {
        reasons.push(
            "the parts come from different adapters or drivers, which may round differently".to_string(),
        );
    }
    let shares_agree = parts.iter().all(|part| part.identity.of_rays.is_some())
        && parts.iter().all(|part| part.identity.of_rays == first.of_rays);
    if ir.sources.len() > 1 && !shares_agree {
        reasons.push(
            "the sources share the rays of each part on their own (--of-rays makes parts of one trace)"
                .to_string(),
        );
    }
    let gaps = (0..ir.sources.len())
        .any(|source| rays.spans().iter().filter(|span| span.source as usize == source).count() > 1);
    if gaps {
        reasons.push("there are gaps between the parts' rays".to_string());
    }
    match reasons.as_slice() {
        [] => "merged: the sums are one run's, bit for bit".into(),
        reasons => format!("merged: not the bits of one run: {}", reasons.join("; ")),
    }
}

fn run_info(path: &Path, scene: &Scene, merged: &Checkpoint) -> RunInfo {
    let identity = &merged.identity;
    RunInfo {
        scene: Some(path.display().to_string()),
        num_rays: merged.tally.launched.count,
        seed: identity.seed,
        max_depth: identity.max_depth,
        min_flux_fraction: identity.min_flux_fraction,
        precision: identity.precision.clone(),
        sampler: identity.sampler.clone(),
        adapter: identity.adapter.clone(),
        driver: identity.driver.clone(),
        scene_warnings: scene.warnings_in(match identity.precision.as_str() {
            "f32" => Precision::F32,
            _ => Precision::F64,
        }),
        lamp_files: scene.lamp_files.clone(),
        ray_files: scene.ray_files.clone(),
        guide: identity.guide.as_ref().map(GuideInfo::of),
        filter: Some(identity.path_filter.clone()).filter(|filter| filter != "none"),
        first_ray: identity.first_ray,
        of_rays: identity.of_rays,
        ..RunInfo::default()
    }
}
