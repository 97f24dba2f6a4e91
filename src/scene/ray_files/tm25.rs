//! IES TM-25-13 ray files, `.tm25ray`, read.
//!
//! Source of the layout: IES TM-25-13, "Ray File Format for the Description of the Emission Properties of Light
//! Sources", section 4.7. The reader was checked against files of ams OSRAM, LightTools and TM25RaySetTools.
//!
//! A header of 36,288 bytes: file (256), known data flags (32), nine texts of 1000 UTF-32 characters. Then
//! spectral tables, zeros up to a multiple of 32 bytes, names of additional columns, an additional text, rays.
//! All is little-endian, lengths are in mm, wavelengths in nm.

use std::io::{Read, Seek};

use super::ray::{Error, FluxKind, Format, Header, LengthUnit, Result, Wavelengths};
use super::records::{Records, bytes_at, f32_at, head, i32_at, word};

/// First bytes of a file.
pub(super) const MAGIC: &[u8; 4] = b"TM25";
pub(super) const VERSION: i32 = 2013;
pub(super) const LUMINOUS_FLUX: usize = 12;
pub(super) const RADIANT_FLUX: usize = 16;
pub(super) const NUM_RAYS: usize = 20;
pub(super) const SPECTRAL_IDENTIFIER: usize = 60;
pub(super) const SINGLE_WAVELENGTH: usize = 64;
pub(super) const NUM_TABLES: usize = 76;
const NUM_ADDITIONAL: usize = 80;
const ADDITIONAL_TEXT: usize = 84;
pub(super) const FLAGS: usize = 256;
/// The columns that a flag stands for, in the order of the flags and of the columns.
const COLUMNS: [(&str, usize); 8] = [
    ("position", 3),
    ("direction", 3),
    ("radiant flux", 1),
    ("wavelength", 1),
    ("luminous flux", 1),
    ("Stokes parameters", 6),
    ("tristimulus values X and Z", 2),
    ("spectrum index", 1),
];
pub(super) const TEXTS: usize = 288;
pub(super) const TEXT_BYTES: usize = 4000;
pub(super) const HEADER: usize = TEXTS + 9 * TEXT_BYTES;
/// Tables end at a multiple of so many bytes.
pub(super) const ALIGNMENT: u64 = 32;
/// Bytes of the name of an additional column.
const NAME_BYTES: usize = 512;
/// Most pairs of a spectrum that are read.
const MAX_PAIRS: i32 = 1 << 16;
/// Most additional columns that are read.
const MAX_ADDITIONAL: i32 = 1000;
/// Micrometres in a nanometre.
pub(super) const NANOMETRE: f64 = 1e-3;

pub(super) fn open(reader: &mut (impl Read + Seek), length: u64) -> Result<(Header, Records)> {
    let bytes = head(reader, HEADER, length)?;
    let refused = |at: usize, problem: String, remedy: &str| Error::at(at as u64, problem, remedy);
    let version = i32_at(&bytes, 4);
    if version != VERSION {
        return Err(refused(
            4,
            format!("the version is {version}"),
            "version 2013 is read: export the rays as that",
        ));
    }
    let flags = flags(&bytes)?;
    let [_, _, has_radiant, has_wavelength, has_luminous, ..] = flags;
    let column_of = |flag: usize| (0..flag).filter(|&flag| flags[flag]).map(|flag| COLUMNS[flag].1).sum();
    let (flux_kind, flux, total_at) = match (has_radiant, has_luminous) {
        (true, _) => (FluxKind::Radiant, column_of(2), RADIANT_FLUX),
        (false, true) => (FluxKind::Luminous, column_of(4), LUMINOUS_FLUX),
        (false, false) => {
            let problem = "its rays have neither radiant nor luminous flux".into();
            return Err(refused(FLAGS + 8, problem, "set one of the two flags; the standard asks for it"));
        }
    };
    let total = f64::from(f32_at(&bytes, total_at));
    if total < 0.0 || total.is_infinite() {
        let remedy = "it is 0 or more, or NaN if it is unknown";
        return Err(refused(total_at, format!("the total flux is {total}"), remedy));
    }
    let mut place = HEADER as u64;
    let tables = tables(reader, &bytes, &mut place, length)?;
    let single = f64::from(f32_at(&bytes, SINGLE_WAVELENGTH));
    let wavelengths = match i32_at(&bytes, SPECTRAL_IDENTIFIER) {
        0 => Ok(Wavelengths::None),
        1 if single.is_finite() && single > 0.0 => Ok(Wavelengths::One(single * NANOMETRE)),
        1 => Err((format!("1, and a wavelength of {single} nm"), "identifier 1 goes with one above 0")),
        2 if has_wavelength => Ok(Wavelengths::PerRay),
        2 => Err(("2, without a wavelength of each ray".into(), "set the wavelength flag at byte 268")),
        3 if tables.count == 1 => Ok(Wavelengths::Spectrum(tables.first)),
        3 => Err((
            format!("3, with {} spectral tables", tables.count),
            "identifier 3 goes with one for all rays",
        )),
        4 => Err((
            "4: rays choose among several spectra".into(),
            "export a wavelength for each ray (identifier 2), or one file for each spectrum",
        )),
        other => Err((
            other.to_string(),
            "0 none, 1 one wavelength, 2 one for each ray, 3 one spectrum, 4 several",
        )),
    };
    let wavelengths = wavelengths.map_err(|(problem, remedy)| {
        refused(SPECTRAL_IDENTIFIER, format!("the spectral identifier is {problem}"), remedy)
    })?;
    let names = additional_names(reader, &bytes, &mut place, length)?;
    let mut remarks = unused(&flags, &wavelengths);
    if !names.is_empty() {
        remarks.push(format!("the additional columns of its rays are not used: {}", names.join(", ")));
    }
    let records = Records {
        start: place,
        num_items: column_of(COLUMNS.len()) + names.len(),
        millimetres: 1.0,
        flux,
        wavelength: (wavelengths == Wavelengths::PerRay).then(|| (column_of(3), NANOMETRE)),
        single: if let Wavelengths::One(single) = wavelengths { Some(single) } else { None },
    };
    let [low, high] = [NUM_RAYS, NUM_RAYS + 4].map(|at| u64::from(u32::from_le_bytes(word(&bytes, at))));
    let num_rays = low | high << 32;
    records.check_length(num_rays, length)?;
    let texts = [0, 1].map(|index| text(&bytes[TEXTS + index * TEXT_BYTES..][..TEXT_BYTES]));
    let header = Header {
        format: Format::Tm25,
        num_rays,
        unit: LengthUnit::MILLIMETRE,
        flux_kind: Some(flux_kind),
        // Makers write 0 for what they do not know, as well as NaN.
        total_flux: (total > 0.0).then_some(total),
        wavelengths,
        description: texts.map(|text| text.trim().to_string()).join(" ").trim().into(),
        remarks,
    };
    Ok((header, records))
}

fn flags(bytes: &[u8]) -> Result<[bool; 8]> {
    let mut flags = [false; 8];
    for (index, (flag, (name, _))) in flags.iter_mut().zip(COLUMNS).enumerate() {
        let at = FLAGS + 4 * index;
        let value = i32_at(bytes, at);
        // Position and direction are always there.
        let is_right = if index < 2 { value == 1 } else { value == 0 || value == 1 };
        if !is_right {
            let problem = format!("the flag of the {name} is {value}");
            let remedy = "flags are 0 or 1, and 1 for position and direction";
            return Err(Error::at(at as u64, problem, remedy));
        }
        *flag = value == 1;
    }
    Ok(flags)
}

/// The spectral tables of a file: how many, and the first one, in um.
struct Tables {
    count: i32,
    first: Vec<(f64, f64)>,
}

fn tables(reader: &mut (impl Read + Seek), head: &[u8], place: &mut u64, length: u64) -> Result<Tables> {
    let count = i32_at(head, NUM_TABLES);
    let mut tables = Tables { count, first: Vec::new() };
    if count < 0 {
        let problem = format!("the number of spectral tables is {count}");
        return Err(Error::at(NUM_TABLES as u64, problem, "it is 0 or more"));
    }
    let start = *place;
    for table in 0..count {
        let refused = |problem: String, remedy| Error::at(*place, problem, remedy);
        if *place + 4 > length {
            let problem = format!("the file ends before spectral table {} of {count}", table + 1);
            return Err(refused(problem, "fetch or export it again"));
        }
        let num_pairs = i32_at(&bytes_at(reader, *place, 4)?, 0);
        if !(1..=MAX_PAIRS).contains(&num_pairs) {
            let problem = format!("spectral table {} has {num_pairs} pairs", table + 1);
            return Err(refused(problem, "a spectrum has 1 to 65536 pairs of wavelength and weight"));
        }
        let end = *place + 4 + 8 * num_pairs as u64;
        if end > length {
            let problem =
                format!("spectral table {} ends at byte {end}, and the file at {length}", table + 1);
            return Err(refused(problem, "fetch or export it again"));
        }
        if table == 0 {
            tables.first = spectrum(&bytes_at(reader, *place + 4, 8 * num_pairs as usize)?, *place + 4)?;
        }
        *place = end;
    }
    *place = start + (*place - start).next_multiple_of(ALIGNMENT);
    Ok(tables)
}

/// Pairs of wavelength \[um\] and weight. `start` is their place in the file.
fn spectrum(bytes: &[u8], start: u64) -> Result<Vec<(f64, f64)>> {
    let mut spectrum: Vec<(f64, f64)> = Vec::with_capacity(bytes.len() / 8);
    for (at, pair) in (start..).step_by(8).zip(bytes.chunks_exact(8)) {
        let [wavelength, weight] = [0, 4].map(|at| f64::from(f32_at(pair, at)));
        let last = spectrum.last().map_or(0.0, |&(last, _)| last);
        let is_right =
            wavelength.is_finite() && wavelength * NANOMETRE > last && weight.is_finite() && weight >= 0.0;
        if !is_right {
            let problem = format!("the spectrum has the pair {wavelength} nm, {weight}");
            let remedy = "wavelengths rise from above 0, and weights are 0 or more";
            return Err(Error::at(at, problem, remedy));
        }
        spectrum.push((wavelength * NANOMETRE, weight));
    }
    Ok(spectrum)
}

/// Names of the additional columns. `place` then leads to the first ray.
fn additional_names(
    reader: &mut (impl Read + Seek),
    head: &[u8],
    place: &mut u64,
    length: u64,
) -> Result<Vec<String>> {
    let [count, text_bytes] = [NUM_ADDITIONAL, ADDITIONAL_TEXT].map(|at| i32_at(head, at));
    if !(0..=MAX_ADDITIONAL).contains(&count) {
        let problem = format!("the number of additional columns is {count}");
        return Err(Error::at(NUM_ADDITIONAL as u64, problem, "0 to 1000 are read"));
    }
    let num_bytes = count as usize * NAME_BYTES;
    let end = *place + num_bytes as u64 + u64::from(text_bytes.unsigned_abs());
    if text_bytes < 0 || end > length {
        let problem =
            format!("{count} additional columns and a text of {text_bytes} bytes, in a file of {length}");
        return Err(Error::at(NUM_ADDITIONAL as u64, problem, "the file is cut off, or its header is wrong"));
    }
    let bytes = bytes_at(reader, *place, num_bytes)?;
    *place = end;
    Ok(bytes.chunks_exact(NAME_BYTES).map(|name| format!("`{}`", text(name))).collect())
}

/// What a user should know of columns that are there and are not used.
fn unused(flags: &[bool; 8], wavelengths: &Wavelengths) -> Vec<String> {
    let [.., wavelength, luminous, stokes, tristimulus, index] = *flags;
    let unused = [
        (wavelength && *wavelengths != Wavelengths::PerRay, 3),
        (luminous && flags[2], 4),
        (stokes, 5),
        (tristimulus, 6),
        (index, 7),
    ];
    let remark = |name: &str| format!("the columns of its rays for {name} are not used");
    unused.iter().filter(|(is_unused, _)| *is_unused).map(|&(_, flag)| remark(COLUMNS[flag].0)).collect()
}

/// UTF-32 up to the first zero.
fn text(bytes: &[u8]) -> String {
    let letters = bytes.chunks_exact(4).map(|letter| u32::from_le_bytes(word(letter, 0)));
    letters.take_while(|&letter| letter != 0).map(|c| char::from_u32(c).unwrap_or('\u{fffd}')).collect()
}
