//! Wrong shaders are noticed: each mutant of shaders/ fails the check that is named for it, which passes on the original.
//!
//! A mutant is a change of one file's text. To mend one whose text moved, edit its line in `table.rs`.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking")]

mod bench;
mod checks;
mod closed_forms;
mod oracle;
#[path = "../../benches/src/stability.rs"]
#[allow(dead_code, reason = "the table is for people")]
mod stability;
mod table;
#[path = "../zoo/mod.rs"]
mod zoo;

use bench::Bench;
use checks::Check;
use libtest_mimic::{Arguments, Completion, Failed, Trial};
use std::collections::BTreeSet;
use std::num::NonZeroUsize;
use std::process::ExitCode;
use std::sync::LazyLock;
use table::{MUTANTS, Mutant};

/// A test for the table, one for each check on the shaders as they are, and one for each mutant. Two of three mutants wait for
/// `make test-long`, and so do errors in what an implementation logs for the host. Where a device is lost, those after it on
/// that device fail as well: the first one tells why. `--nocapture` shows how mutants were noticed.
fn main() -> ExitCode {
    let mut arguments = Arguments::from_args();
    arguments.test_threads = arguments.test_threads.or_else(threads_of_environment);
    let shows_how = arguments.nocapture;
    let table = Trial::test("table", every_mutant_changes_one_place_and_has_a_name_of_its_own);
    let originals = zoo::in_turn(named_checks()).map(|name| {
        let passes = move || Ok(Check::named(name).run(&Bench::of_originals())?);
        on_the_device(format!("original: {name}"), passes)
    });
    let few: BTreeSet<usize> = zoo::in_turn((0..MUTANTS.len()).step_by(3)).collect();
    let mutants = MUTANTS.iter().enumerate().map(|(place, mutant)| {
        let trial = on_the_device(format!("mutant: {}", mutant.name), move || is_noticed(mutant, shows_how));
        trial.with_ignored_flag(!few.contains(&place) || mutant.file.starts_with("cpu/log/"))
    });
    let trials = std::iter::once(table).chain(originals).chain(mutants).collect();
    libtest_mimic::run(&arguments, trials).exit_code()
}

/// As many as tests of the standard harness would have.
fn threads_of_environment() -> Option<usize> {
    let count = std::env::var("RUST_TEST_THREADS").ok()?;
    Some(count.parse::<NonZeroUsize>().expect("RUST_TEST_THREADS is a positive number").get())
}

/// A test that is skipped where no adapter has what all need.
fn on_the_device(name: String, test: impl FnOnce() -> Result<(), Failed> + Send + 'static) -> Trial {
    static IS_POSSIBLE: LazyLock<bool> = LazyLock::new(bench::is_possible);
    Trial::ignorable_test(name, || match *IS_POSSIBLE {
        true => test().map(|()| Completion::Completed),
        false => Ok(Completion::ignored_with("no adapter with 64-bit floats and integers")),
    })
}

/// Checks named in the table, each once.
fn named_checks() -> BTreeSet<&'static str> {
    MUTANTS.iter().map(|mutant| mutant.check).collect()
}

fn every_mutant_changes_one_place_and_has_a_name_of_its_own() -> Result<(), Failed> {
    let names: BTreeSet<&str> = MUTANTS.iter().map(|mutant| mutant.name).collect();
    assert_eq!(names.len(), MUTANTS.len(), "two mutants share a name");
    let misplaced: Vec<String> = MUTANTS.iter().filter_map(misplacement).collect();
    if misplaced.is_empty() { Ok(()) } else { Err(misplaced.join("\n").into()) }
}

/// Says why a mutant is none; `None` if it is one.
fn misplacement(mutant: &Mutant) -> Option<String> {
    let (occurrences, Mutant { name, old, file, .. }) = (mutant.occurrences(), mutant);
    (mutant.old == mutant.new || occurrences != 1)
        .then(|| format!("{name}: `{old}` occurs {occurrences} times in shaders/{file}"))
}

fn is_noticed(mutant: &'static Mutant, shows_how: bool) -> Result<(), Failed> {
    if let Some(why) = misplacement(mutant) {
        return Err(why.into());
    }
    let mutated = Bench::of_mutant(mutant);
    let outcome = Check::named(mutant.check).run(&mutated);
    if !mutated.was_mutated() {
        return Err(format!("{} does not compose shaders/{}", mutant.check, mutant.file).into());
    }
    let Err(how) = outcome else { return Err(format!("survives: passes {}", mutant.check).into()) };
    if shows_how {
        println!("{}: {}: {how}", mutant.name, mutant.check);
    }
    Ok(())
}
