//! Files of the repository that tests read.
#![allow(dead_code, reason = "each test binary compiles the helpers and uses its part of them")]

use std::path::{Path, PathBuf};

/// A file or folder of the repository.
pub fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// The names of the JSON files in a folder of the repository, in order.
pub fn json_files(folder: &str) -> Vec<String> {
    let entries = std::fs::read_dir(repository(folder)).unwrap();
    let paths = entries.map(|entry| entry.unwrap().path());
    let mut names: Vec<String> = paths
        .filter(|path| path.extension().is_some_and(|extension| extension == "json"))
        .map(|path| path.file_stem().unwrap().to_str().unwrap().to_string())
        .collect();
    names.sort();
    names
}

/// In so many turns a test has every case.
pub const NUM_TURNS: usize = 3;

/// The cases of this run, of all cases of a test that takes long. `NSQ_GPU_TURN` is a number, whose remainder chooses a third
/// of them, and of two cases one. Without it, or where it is `all`, they are all of them. `make test` counts commits, so three
/// in a row have all.
///
/// Of two lists in one loop only one may be in turn. In both, each turn would pair the same cases again.
pub fn in_turn<T>(cases: impl IntoIterator<Item = T>) -> impl Iterator<Item = T> {
    let turn = turn();
    let cases: Vec<T> = cases.into_iter().collect();
    let num_turns = cases.len().clamp(1, NUM_TURNS);
    let is_of_this = move |case: usize| turn.is_none_or(|turn| is_of_turn(case, turn, num_turns));
    cases.into_iter().enumerate().filter(move |(case, _)| is_of_this(*case)).map(|(_, case)| case)
}

/// The number of this run; `None` if it has all cases.
pub fn turn() -> Option<usize> {
    let turn = std::env::var("NSQ_GPU_TURN").ok().filter(|turn| turn != "all");
    turn.map(|turn| turn.parse().expect("NSQ_GPU_TURN is a number or `all`"))
}

/// Tests take tiers, filters and policies by the number of a scene. So a turn has no fixed remainder of these numbers.
pub fn is_of_turn(case: usize, turn: usize, num_turns: usize) -> bool {
    (case + case / num_turns) % num_turns == turn % num_turns
}

/// The scenes of this run, with their numbers.
pub fn scenes_in_turn() -> impl Iterator<Item = (usize, String)> {
    in_turn(json_files("scenes").into_iter().enumerate())
}
