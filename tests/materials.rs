//! The material catalog against the package: `tests/data/materials.json` is what Optiland itself answered
//! (`python/tools/make_catalog.py --oracle`).

use clap::Parser;
use nsq_gpu::Error;
use nsq_gpu::cli::materials::{Args, run};
use nsq_gpu::scene::materials::{CatalogEntry, entries, names, resolve, search};
use proptest::prelude::*;
use serde::Deserialize;

#[derive(Deserialize)]
struct Oracle {
    optiland: String,
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    name: String,
    entry: String,
    ambiguous: bool,
    wavelengths: Vec<f64>,
    n: Vec<Option<f64>>,
    k: Vec<Option<f64>>,
}

fn oracle() -> Oracle {
    serde_json::from_str(include_str!("data/materials.json")).expect("the oracle follows its layout")
}

fn entry(name: &str) -> &'static CatalogEntry {
    resolve(name).expect("the catalog has it").entry
}

/// Relative difference; where the package has no real value, ours must not have one either.
fn deviation(ours: f64, theirs: Option<f64>) -> f64 {
    match theirs {
        Some(theirs) if ours == theirs => 0.0,
        Some(theirs) => ((ours - theirs) / theirs).abs(),
        None if ours.is_finite() => f64::INFINITY,
        None => 0.0,
    }
}

#[test]
fn sample_is_large_enough() {
    let oracle = oracle();
    assert_eq!(oracle.optiland, nsq_gpu::scene::materials::OPTILAND_VERSION);
    assert!(oracle.cases.len() >= 300);
    assert!(oracle.cases.iter().all(|case| case.wavelengths.len() >= 5));
}

#[test]
fn n_and_k_equal_the_package() {
    let mut worst: f64 = 0.0;
    for case in oracle().cases {
        let entry = entry(&case.name);
        for (i, &wavelength) in case.wavelengths.iter().enumerate() {
            for (what, ours, theirs) in
                [("n", entry.n(wavelength), case.n[i]), ("k", entry.k(wavelength), case.k[i])]
            {
                let deviation = deviation(ours, theirs);
                assert!(
                    deviation <= 1e-12,
                    "{what} of {} at {wavelength} um: {ours:e} against {theirs:?}",
                    case.name
                );
                worst = worst.max(deviation);
            }
        }
    }
    eprintln!("largest relative deviation: {worst:e}");
}

#[test]
fn names_mean_the_entries_that_the_package_takes() {
    for case in oracle().cases {
        let resolved = resolve(&case.name).unwrap();
        assert_eq!(resolved.entry.path, case.entry, "{}", case.name);
        assert_eq!(!resolved.warnings.is_empty(), case.ambiguous, "{}: {:?}", case.name, resolved.warnings);
    }
}

#[test]
fn bk7_has_its_published_index() {
    approx::assert_abs_diff_eq!(entry("N-BK7").n(0.5876), 1.51679844, epsilon = 5e-9);
}

#[test]
fn case_does_not_matter() {
    assert_eq!(entry("n-bk7").path, "glass/schott/N-BK7");
    assert_eq!(entry("N-Bk7").path, "glass/schott/N-BK7");
}

#[test]
fn sf6_is_the_gas_and_the_warning_names_the_glass() {
    let resolved = resolve("SF6").unwrap();
    assert_eq!(resolved.entry.path, "main/SF6/Vukovic");
    assert!((resolved.entry.n(0.5876) - 1.0007).abs() < 1e-4);
    let [warning] = resolved.warnings.as_slice() else { panic!("one warning, not {:?}", resolved.warnings) };
    assert!(warning.contains("main/SF6/Vukovic"), "{warning}");
    assert!(warning.contains("if the glass is meant, write \"glass/schott/SF6\""), "{warning}");
}

#[test]
fn a_guess_of_the_search_is_called_one() {
    let resolved = resolve("pet").unwrap();
    assert_eq!(resolved.entry.path, "main/C/Peter");
    assert!(resolved.warnings[0].contains("guesses"), "{:?}", resolved.warnings);
}

#[test]
fn a_path_names_its_entry_without_doubt() {
    let resolved = resolve("glass/schott/SF6").unwrap();
    assert_eq!(resolved.warnings, Vec::<String>::new());
    assert!((resolved.entry.n(0.5876) - 1.805).abs() < 1e-3);
    for entry in entries() {
        assert_eq!(resolve(&entry.path).unwrap().entry.path, entry.path);
    }
}

#[test]
fn unknown_names_get_the_nearest() {
    let unknown = resolve("N-BK77").unwrap_err();
    assert_eq!(unknown.suggestions[0], "N-BK7");
    assert!(unknown.to_string().contains("N-BK77"), "{unknown}");
    assert_eq!(resolve("magnesium fluoride").unwrap_err().suggestions[0], "MgF2");
    assert!(resolve("SCHOTT N-BK7").unwrap_err().suggestions.contains(&"N-BK7".to_string()));
}

#[test]
fn names_of_omitted_entries_are_refused_with_the_reason() {
    let refused = resolve("toluene").unwrap_err();
    assert!(refused.reason.as_ref().is_some_and(|reason| reason.contains("C7H8 - toluene")), "{refused}");
    assert!(resolve("Brannon").unwrap_err().to_string().contains("k without n"));
    assert!(resolve("Segelstein").unwrap_err().to_string().contains("too large"));
}

#[test]
fn data_is_clamped_or_extrapolated_with_a_warning() {
    let glass = entry("N-BK7");
    assert_eq!(glass.range_warnings(&[0.3, 0.5876, 2.5]), Vec::<String>::new());
    let warnings = glass.range_warnings(&[0.5876, 2.6]);
    assert_eq!(warnings.len(), 2, "{warnings:?}");
    assert!(warnings[0].contains("extrapolated at 2.6 um"), "{warnings:?}");
    assert!(!warnings[0].contains("nm"), "{warnings:?}");
    assert!(glass.range_warnings(&[550.0])[0].ends_with("at 550 um; are these nm? 550 nm are 0.55 um"));
    assert_ne!(glass.n(2.6), glass.n(2.5));
    assert_eq!(glass.k(2.6), glass.k(2.5));
    let metal = entry("Ag");
    assert_eq!(metal.n(0.01), metal.n(0.1879));
    assert!(metal.range_warnings(&[0.01])[0].contains("nearest sample"));
}

#[test]
fn unphysical_data_is_a_defect() {
    assert_eq!(entry("N-BK7").defects(&[0.3, 0.5876, 2.5]), Vec::<String>::new());
    assert_eq!(
        entry("main/Al2O3/Querry-e").defects(&[0.21]),
        ["main/Al2O3/Querry-e: k is negative at 0.21 um"]
    );
    let metamaterial = entry("other/exotic/metamaterials/Valentine");
    let (low, high) = metamaterial.dispersion().range();
    let negative =
        [low, (low + high) / 2.0, high].into_iter().find(|&wavelength| metamaterial.n(wavelength) <= 0.0);
    assert!(metamaterial.defects(&[negative.unwrap()])[0].contains("n is not a positive number"));
    assert_eq!(
        entry("N-BK7").defects(&[0.077]).len(),
        1,
        "the formula is imaginary just below its resonance"
    );
}

#[test]
fn missing_extinction_is_zero() {
    let gas = entry("SF6");
    assert!(gas.extinction().is_none());
    assert_eq!(gas.k(0.7), 0.0);
}

#[test]
fn catalog_is_small_and_sound() {
    let packed = include_bytes!("../src/scene/catalog.bin");
    assert!(packed.len() < 1_000_000, "{} bytes", packed.len());
    assert!(names().count() > 3500);
    for entry in entries() {
        let (low, high) = entry.dispersion().range();
        assert!(low <= high && entry.n(low).is_finite() && entry.k(low).is_finite(), "{}", entry.path);
    }
}

#[test]
fn every_name_resolves() {
    for name in names() {
        assert!(resolve(name).is_ok(), "{name}");
    }
}

#[test]
fn search_needs_every_word() {
    let found = search("CALCIUM fluoride");
    assert!(found.iter().any(|entry| entry.path == "main/CaF2/Malitson"));
    assert!(found.iter().all(|entry| entry.title.to_lowercase().contains("fluoride")));
}

#[derive(clap::Parser)]
struct Command {
    #[command(flatten)]
    materials: Args,
}

fn materials(arguments: &[&str]) -> nsq_gpu::Result<String> {
    let command =
        Command::try_parse_from(["materials"].iter().chain(arguments)).expect("the options are right");
    run(&command.materials)
}

#[test]
fn command_shows_the_entry_its_source_and_n() {
    let text = materials(&["N-BK7", "--wavelengths", "0.4861,0.5876"]).unwrap();
    for expected in ["glass/schott/N-BK7", "SCHOTT Zemax catalog", "0.3 to 2.5 um", "1.51679844", "CC0"] {
        assert!(text.contains(expected), "{expected} in\n{text}");
    }
    assert!(!text.contains("warning"), "{text}");
}

#[test]
fn command_warns_of_ambiguous_names_and_of_the_range() {
    let text = materials(&["SF6", "--wavelengths", "0.5876"]).unwrap();
    assert_eq!(text.matches("warning: ").count(), 2, "{text}");
}

#[test]
fn command_refuses_what_it_cannot_show() {
    for (arguments, expected) in [
        (&["N-BK77"] as &[&str], "N-BK7"),
        (&["N-BK7", "--wavelengths", "0"], "0 um"),
        (&["--search", "unobtainium"], "unobtainium"),
    ] {
        let error = materials(arguments).unwrap_err();
        assert!(matches!(&error, Error::Usage(text) if text.contains(expected)), "{error}");
    }
}

#[test]
fn command_lists_and_counts() {
    assert!(materials(&["--search", "N-BK7"]).unwrap().contains("glass/schott/N-BK7 "));
    assert!(materials(&[]).unwrap().contains("CC0"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn resolve_never_panics(name in any::<String>(), wavelength in any::<f64>()) {
        match resolve(&name) {
            Ok(resolved) => { let _ = (resolved.entry.n(wavelength), resolved.entry.k(wavelength)); }
            Err(unknown) => prop_assert!(unknown.to_string().contains(&name)),
        }
    }

    #[test]
    fn evaluation_never_panics(index in 0..entries().len(), wavelength in any::<f64>()) {
        let entry = &entries()[index];
        let _ = (entry.n(wavelength), entry.k(wavelength), entry.range_warnings(&[wavelength]));
    }
}
