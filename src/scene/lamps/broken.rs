//! Thousands of broken files: none may end the program, and each message names a line and a cure.

use super::{Lamp, Malformed, read_eulumdat, read_ies, write_eulumdat, write_ies};
use crate::random::Draw;

const FILES: u64 = 2000;

/// A number in place of another: none of them may be trusted.
const ODD: [&str; 14] = [
    "-1",
    "NaN",
    "1e400",
    "-1e400",
    "inf",
    "99999999999999999999",
    "0",
    "4294967296",
    "1,5",
    "",
    "0.5",
    "90",
    "1e308",
    "é",
];

fn flip(text: &str, dice: &mut Draw) -> String {
    let mut bytes = text.as_bytes().to_vec();
    for _ in 0..=dice.roll(8) {
        let place = dice.roll(bytes.len());
        if let Some(byte) = bytes.get_mut(place) {
            *byte ^= 1 << dice.roll(8);
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

fn change_lines(text: &str, dice: &mut Draw, is_dropped: bool) -> String {
    let mut lines: Vec<&str> = text.lines().collect();
    for _ in 0..=dice.roll(3) {
        let place = dice.roll(lines.len());
        match lines.get(place).copied() {
            Some(_) if is_dropped => drop(lines.remove(place)),
            Some(line) => lines.insert(place, line),
            None => {}
        }
    }
    lines.join("\n")
}

fn change_numbers(text: &str, dice: &mut Draw) -> String {
    let mut words: Vec<&str> = text.split_inclusive([' ', '\n']).collect();
    for _ in 0..=dice.roll(3) {
        // The first numbers, which are counts and factors, as often as the others.
        let reach = if dice.roll(2) == 0 { 40 } else { words.len() };
        let place = dice.roll(reach.min(words.len()));
        let end = if words[place].ends_with('\n') { "\n" } else { " " };
        words.splice(place..=place, [ODD[dice.roll(ODD.len())], end]);
    }
    words.concat()
}

fn break_up(text: &str, dice: &mut Draw) -> String {
    match dice.roll(6) {
        0 => flip(text, dice),
        1 => change_lines(text, dice, true),
        2 => change_lines(text, dice, false),
        3 => text.chars().take(dice.roll(text.chars().count())).collect(),
        _ => change_numbers(text, dice),
    }
}

/// Reads broken files; those that are still whole are written and read again. Returns how many were refused.
fn survive(files: &[String], seed: u64, read: fn(&str) -> Result<Lamp, Malformed>) -> usize {
    let mut refused = 0;
    for number in 0..FILES {
        let mut dice = Draw::new(seed + number);
        let broken = break_up(&files[dice.roll(files.len())], &mut dice);
        match read(&broken) {
            Ok(lamp) => check_whole(&lamp),
            Err(err) => {
                refused += 1;
                let line = err.place.strip_prefix("line ").and_then(|line| line.parse::<usize>().ok());
                let lines = broken.lines().count().max(1);
                assert!(line.is_some_and(|line| (1..=lines).contains(&line)), "{err:?}");
                assert!(!err.problem.is_empty() && !err.remedy.is_empty(), "{err:?}");
                assert!(err.problem.len() < 300 && !err.problem.contains(char::is_control), "{err:?}");
            }
        }
    }
    refused
}

fn check_whole(lamp: &Lamp) {
    assert_eq!(lamp.intensity.len(), lamp.azimuth_angles_deg.len());
    assert!(lamp.intensity.iter().all(|row| row.len() == lamp.polar_angles_deg.len()));
    assert!(lamp.intensity.iter().flatten().all(|value| *value >= 0.0 && value.is_finite()));
    assert!(lamp.polar_angles_deg.is_sorted() && lamp.azimuth_angles_deg.is_sorted());
    assert!(lamp.azimuth_angles_deg == [0.0] || lamp.azimuth_angles_deg.last() == Some(&360.0));
    assert_eq!(lamp.intensity.first(), lamp.intensity.last());
    assert!(lamp.lumens().is_finite());
    let written = write_ies(lamp);
    let again = read_ies(&written).unwrap();
    assert_eq!(write_ies(&again), written);
    if let Ok(written) = write_eulumdat(lamp) {
        let again = read_eulumdat(&written).unwrap();
        assert_eq!(write_eulumdat(&again).unwrap(), written);
    }
}

fn samples() -> Vec<Lamp> {
    let full = "IESNA:LM-63-2002\n[TEST] 1\n[MANUFAC] Maker\nTILT=NONE\n\
                2 900 1 3 5 1 2 0.1 0.2 0.05\n1 1 20\n\
                0 45 90\n0 90 180 270 360\n10 8 1\n10 7 2\n10 6 0\n10 5 3\n10 8 1\n";
    let round = "IES:LM-63-2019\nTILT=NONE\n1 -1 1 4 1 1 1 -0.5 -0.5 0 1 1.1 20\n0 60 90 180\n0\n10 8 4 1\n";
    [full, round].map(|text| read_ies(text).unwrap()).to_vec()
}

#[test]
fn broken_ies_files_name_a_line_and_a_cure() {
    let quadrant =
        "Label\nTILT=NONE\n1 100 2 3 3 1 1 0 0 0\n1 1 20\n0 45 90\n0 30 90\n10 8 1\n9 7 2\n8 6 0\n";
    let about_c90 = "IESNA91\nTILT=NONE\n1 -1 1 2 3 1 1 -1 0 0\n1 1 0\n90 180\n90 200 270\n1,8\n9 7\n8 6\n";
    let mut files: Vec<String> = samples().iter().map(write_ies).collect();
    files.extend([quadrant, about_c90].map(str::to_owned));
    let refused = survive(&files, 1, read_ies);
    assert!((1000..FILES as usize).contains(&refused), "{refused}");
}

#[test]
fn broken_eulumdat_files_name_a_line_and_a_cure() {
    let mut files: Vec<String> = samples().iter().map(|lamp| write_eulumdat(lamp).unwrap()).collect();
    // Of the four planes of the full table, symmetries store three or two.
    let full = files[0].clone();
    let lines: Vec<&str> = full.lines().collect();
    for (symmetry, stored) in [("2", 3), ("3", 3), ("4", 2)] {
        let mut lines: Vec<&str> = lines[..lines.len() - 3 * (4 - stored)].to_vec();
        lines[2] = symmetry;
        let file = lines.join("\n");
        assert!(read_eulumdat(&file).is_ok());
        files.push(file);
    }
    let refused = survive(&files, 77, read_eulumdat);
    assert!((1000..FILES as usize).contains(&refused), "{refused}");
}
