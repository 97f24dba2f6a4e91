//! Wrong shaders are noticed: each mutant of shaders/ fails the check that is named for it, which passes on the original.
//!
//! A mutant is a change of one file's text. To mend one whose text moved, edit its line in `table.rs`.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking")]

mod bench;
mod checks;
mod closed_forms;
mod oracle;
mod table;

use bench::Bench;
use checks::Check;
use std::collections::BTreeSet;
use table::{MUTANTS, Mutant};

/// Checks named in the table, each once.
fn named_checks() -> BTreeSet<&'static str> {
    MUTANTS.iter().map(|mutant| mutant.check).collect()
}

#[test]
fn every_mutant_changes_one_place_and_has_a_name_of_its_own() {
    let names: BTreeSet<&str> = MUTANTS.iter().map(|mutant| mutant.name).collect();
    assert_eq!(names.len(), MUTANTS.len(), "two mutants share a name");
    let misplaced: Vec<String> = MUTANTS
        .iter()
        .filter(|mutant| mutant.old == mutant.new || mutant.occurrences() != 1)
        .map(|m| format!("{}: `{}` occurs {} times in shaders/{}", m.name, m.old, m.occurrences(), m.file))
        .collect();
    assert!(misplaced.is_empty(), "{}", misplaced.join("\n"));
}

#[test]
fn every_check_passes_on_the_shaders_as_they_are() {
    let Some(bench) = Bench::open("checks of the original shaders") else { return };
    let failures: Vec<String> = named_checks()
        .into_iter()
        .filter(|name| name.starts_with("squares"))
        .filter_map(|name| Check::named(name).run(&bench).err().map(|why| format!("{name}: {why}")))
        .collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn every_mutant_fails_the_check_that_is_named_for_it() {
    let Some(bench) = Bench::open("mutants") else { return };
    let survivors: Vec<String> = MUTANTS
        .iter()
        .filter(|m| m.check.starts_with("squares"))
        .filter_map(|mutant| survival(&bench, mutant))
        .collect();
    assert!(
        survivors.is_empty(),
        "{} of {} survive:\n{}",
        survivors.len(),
        MUTANTS.len(),
        survivors.join("\n")
    );
}

/// Says how a mutant survived; `None` if it was noticed.
fn survival(bench: &Bench, mutant: &'static Mutant) -> Option<String> {
    if mutant.occurrences() != 1 {
        return Some(format!("{}: its text is not in shaders/{}", mutant.name, mutant.file));
    }
    let mutated = bench.with_mutant(mutant);
    let outcome = Check::named(mutant.check).run(&mutated);
    if !mutated.was_mutated() {
        return Some(format!("{}: {} does not compose shaders/{}", mutant.name, mutant.check, mutant.file));
    }
    match outcome {
        Ok(()) => Some(format!("{}: passes {}", mutant.name, mutant.check)),
        Err(why) => {
            println!("{}: {}: {why}", mutant.name, mutant.check);
            None
        }
    }
}
