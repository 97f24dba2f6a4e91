//! Thousands of broken files: none may end the program, and what is read of them is finite.

use std::io::Cursor;

use super::tests::{FLUX_ONLY, SPECTRAL, TEXT, npz, npz_columns, tm25, zemax};
use super::*;
use crate::random::Draw;

const FILES: u64 = 2000;

/// A place in a file, most often in its first bytes or its last ones.
fn place_in(length: usize, dice: &mut Draw) -> usize {
    match dice.roll(4) {
        0 => dice.roll(length),
        1 => length.saturating_sub(1 + dice.roll(200)),
        2 => dice.roll(length.min(300)),
        _ => dice.roll(length.min(96)),
    }
}

/// Words in place of others: counts and numbers that may not be trusted.
const ODD: [u32; 8] = [0, 1, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 0x7fc0_0000, 0x7f80_0000, 0x0100_0000];

fn broken(file: &[u8], dice: &mut Draw) -> Vec<u8> {
    let mut bytes = file.to_vec();
    for _ in 0..=dice.roll(4) {
        let place = place_in(bytes.len(), dice).min(bytes.len());
        match dice.roll(5) {
            0 | 1 => bytes.iter_mut().skip(place).take(1).for_each(|byte| *byte ^= 1 << dice.roll(8)),
            2 => {
                let word = ODD[dice.roll(ODD.len())].to_le_bytes();
                bytes[place & !3..].iter_mut().zip(word).for_each(|(byte, odd)| *byte = odd);
            }
            3 => drop(bytes.splice(place..place, (0..=dice.roll(40)).map(|_| 0))),
            _ if dice.roll(2) == 0 => bytes.truncate(place),
            _ => drop(bytes.drain(place..(place + 1 + dice.roll(40)).min(bytes.len()))),
        }
    }
    bytes
}

/// Reads a file as a source does. True if all of it was taken.
fn is_taken(bytes: Vec<u8>, name: &str) -> bool {
    let length = bytes.len() as u64;
    let read = RayFile::of(Cursor::new(bytes), name).and_then(|mut file| {
        assert!(file.header().num_rays <= length);
        file.sha256()?;
        let sum = file.for_each(|_, ray| {
            let numbers = ray.position.iter().chain(&ray.direction).chain([&ray.flux]).chain(&ray.wavelength);
            assert!(numbers.copied().all(f64::is_finite) && ray.flux >= 0.0);
            Ok::<(), Error>(())
        })?;
        file.compare_total(sum)
    });
    read.inspect_err(|error| {
        assert!([&error.place, &error.problem, &error.remedy].iter().all(|text| !text.is_empty()));
        assert!(error.to_string().len() < 1000);
    })
    .is_ok()
}

fn broken_files_are_read(seed: u64, files: &[(Vec<u8>, &str)]) {
    let mut dice = Draw::new(seed);
    let mut num_taken = 0;
    for (file, name) in files {
        assert!(is_taken(file.clone(), name), "{name}");
    }
    for index in 0..FILES as usize {
        let (file, name) = &files[index % files.len()];
        num_taken += u64::from(is_taken(broken(file, &mut dice), name));
    }
    // Neither may all be refused, nor may all be taken: the files would be broken too much or too little.
    assert!((FILES / 50..FILES / 2).contains(&num_taken), "{num_taken} were taken");
}

#[test]
fn no_tm25_file_ends_the_program() {
    let mut spectral = tm25();
    (spectral.identifier, spectral.counts, spectral.flags[4]) = (3, [1, 1, 32], 0);
    spectral.after = 3_i32.to_le_bytes().to_vec();
    let pairs = [400.0_f32, 0.0, 500.0, 1.0, 600.0, 0.5];
    spectral.after.extend(pairs.iter().flat_map(|x| x.to_le_bytes()));
    spectral.after.resize(32 + 512 + 32, 0);
    spectral.rays = spectral.rays.chunks(7).flat_map(|ray| [ray, &[4.0]].concat()).collect();
    broken_files_are_read(1, &[(tm25().bytes(), "lamp.tm25ray"), (spectral.bytes(), "lamp.tm25ray")]);
}

#[test]
fn no_zemax_binary_file_ends_the_program() {
    let files = [(zemax(4, 0, 1, &FLUX_ONLY), "lamp.dat"), (zemax(4, 2, 0, &SPECTRAL), "lamp.sdf")];
    broken_files_are_read(2, &files);
}

#[test]
fn no_zemax_text_file_ends_the_program() {
    let rays = "0.125 -2.5 0 0 0 1 0.5\n".repeat(20);
    broken_files_are_read(3, &[(TEXT.into(), "lamp.txt"), (format!("20 4\n{rays}").into(), "lamp.txt")]);
}

#[test]
fn no_npz_file_ends_the_program() {
    broken_files_are_read(4, &[(npz(&npz_columns()), "det.npz")]);
}
