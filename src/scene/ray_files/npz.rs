//! Columns of a ray database, `.npz`.
//!
//! Source of the layout: NumPy's `numpy.lib.format` (`.npy`) in a zip archive, as `numpy.savez` writes it. The columns
//! are as `nsq-gpu trace` writes them for a ray database: `x`, `y`, `z` in mm, `L`, `M`, `N`, `flux` in W, and
//! `wavelength` in um. `ray_id` is not read.
//!
//! The members are stored, not compressed. So any ray is found by its number, and a range is read without
//! the rest.

use std::io::{self, BufReader, Read, Seek};
use std::ops::Range;

use zip::{CompressionMethod, ZipArchive};

use super::ray::{Error, FluxKind, Format, Header, LengthUnit, Ray, Result, Wavelengths};
use super::records::{bytes_at, word};

/// First bytes of an archive, and of one without members.
pub(super) const MAGIC: [&[u8; 4]; 2] = [b"PK\x03\x04", b"PK\x05\x06"];
/// The columns, in the order of [`Columns`].
const NAMES: [&str; 8] = ["x", "y", "z", "L", "M", "N", "flux", "wavelength"];
const FLUX: usize = 6;
/// The one that may be missing.
const WAVELENGTH: usize = 7;
/// Rays that are read at once.
const BLOCK: u64 = 1 << 14;
/// Longest header of an array that is read \[bytes\].
const MAX_HEADER: u64 = 1 << 16;
const REMEDY: &str = "a column is an uncompressed array of f8 of shape (n,), as numpy.savez writes it";

/// Bytes of a number.
const ITEM: u64 = 8;

/// The byte at which each column of a file begins.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Columns(Vec<u64>);

pub(super) fn open(reader: &mut (impl Read + Seek), length: u64) -> Result<(Header, Columns)> {
    let mut archive =
        ZipArchive::new(BufReader::new(&mut *reader)).map_err(|error| damaged("the archive", error))?;
    let mut members = Vec::new();
    for name in NAMES {
        let Some(index) = archive.index_for_name(&format!("{name}.npy")) else {
            if name == NAMES[WAVELENGTH] {
                continue;
            }
            let remedy = "a ray file has the columns x, y, z, L, M, N, flux, and wavelength";
            return Err(Error::new("the archive", format!("there is no column `{name}`"), remedy));
        };
        let member = archive.by_index_raw(index).map_err(|error| damaged(name, error))?;
        if member.compression() != CompressionMethod::Stored || member.encrypted() {
            return Err(Error::new(name, "the column is compressed or encrypted", REMEDY));
        }
        let (start, size) = (member.data_start(), member.size());
        if start.checked_add(size).is_none_or(|end| end > length) {
            let problem = format!("{size} bytes from byte {start} on are beyond the file's {length}");
            return Err(Error::new(name, problem, "the file is cut off: fetch or export it again"));
        }
        drop(member);
        // Reading a member to its end compares its check sum.
        let mut member = archive.by_index(index).map_err(|error| damaged(name, error))?;
        let copied = io::copy(&mut member, &mut io::sink());
        copied.map_err(|error| match error.kind() == io::ErrorKind::InvalidData {
            true => damaged(name, "the column's bytes do not have the archive's check sum"),
            false => Error::io(name, &error),
        })?;
        members.push((name, start, size));
    }
    drop(archive);
    let mut columns = Columns(Vec::new());
    let mut num_rays = 0;
    for (index, (name, start, size)) in members.into_iter().enumerate() {
        let (start, count) = column(reader, name, start, size)?;
        num_rays = if index == 0 { count } else { num_rays };
        // A database without rays has one flux and one wavelength of 0.
        if count != num_rays && !(num_rays == 0 && count == 1 && index >= FLUX) {
            let problem = format!("the column has {count} numbers, and `x` has {num_rays}");
            return Err(Error::new(name, problem, "all columns have one number for each ray"));
        }
        columns.0.push(start);
    }
    let has_wavelengths = columns.0.len() > WAVELENGTH;
    let header = Header {
        format: Format::Npz,
        num_rays,
        unit: LengthUnit::MILLIMETRE,
        flux_kind: Some(FluxKind::Radiant),
        total_flux: None,
        wavelengths: if has_wavelengths { Wavelengths::PerRay } else { Wavelengths::None },
        description: String::new(),
        remarks: Vec::new(),
    };
    Ok((header, columns))
}

fn damaged(place: &str, error: impl ToString) -> Error {
    Error::new(place, error.to_string(), "the archive is damaged: fetch or export it again")
}

/// The first byte of the numbers in a member of the archive, and how many there are.
fn column(reader: &mut (impl Read + Seek), name: &str, start: u64, size: u64) -> Result<(u64, u64)> {
    let refused = |problem: &str| Error::new(format!("{name}, byte {start}"), problem, REMEDY);
    // Magic, version, and the length of the text, in two bytes or four.
    let bytes = bytes_at(reader, start, size.min(MAX_HEADER) as usize)?;
    let (text, text_bytes) = match (bytes.starts_with(b"\x93NUMPY"), bytes.get(6)) {
        (true, Some(1)) => (10, u32::from_le_bytes(word(&bytes, 8)) & 0xffff),
        (true, Some(2 | 3)) => (12, u32::from_le_bytes(word(&bytes, 8))),
        _ => return Err(refused("the column is no NumPy array of version 1 to 3")),
    };
    let data = text + text_bytes as usize;
    let dictionary = bytes.get(text..data).map(String::from_utf8_lossy);
    let dictionary = dictionary.ok_or_else(|| refused("the array's header is longer than the column"))?;
    let value = |key: &str| dictionary.split_once(key).map(|(_, rest)| rest.trim_start_matches([' ', ':']));
    if !value("'descr'").is_some_and(|descr| descr.starts_with("'<f8'")) {
        return Err(refused("its numbers are no little-endian f8"));
    }
    let shape = value("'shape'").and_then(|shape| shape.strip_prefix('(')?.split_once(",)"));
    let count = shape.and_then(|(count, _)| count.trim().parse::<u64>().ok());
    let count = count.ok_or_else(|| refused("the shape of the array is not (n,)"))?;
    if u128::from(count) * u128::from(ITEM) + data as u128 != u128::from(size) {
        return Err(refused(&format!("{count} numbers do not fill the column's {size} bytes")));
    }
    Ok((start + data as u64, count))
}

impl Columns {
    /// Appends the rays of a range that the file holds.
    pub(super) fn read(
        &self,
        reader: &mut (impl Read + Seek),
        range: Range<u64>,
        rays: &mut Vec<Ray>,
    ) -> Result<()> {
        let mut first = range.start;
        while first < range.end {
            let count = BLOCK.min(range.end - first);
            let blocks =
                self.0.iter().map(|start| bytes_at(reader, start + first * ITEM, (count * ITEM) as usize));
            let blocks = blocks.collect::<Result<Vec<_>>>()?;
            for row in 0..count {
                let number = |column: usize| f64_at(&blocks[column], (row * ITEM) as usize);
                let ray = Ray {
                    position: [0, 1, 2].map(number),
                    direction: [3, 4, 5].map(number),
                    flux: number(FLUX),
                    wavelength: (self.0.len() > WAVELENGTH).then(|| number(WAVELENGTH)),
                };
                rays.push(ray.checked(|| format!("ray {}", first + row))?);
            }
            first += count;
        }
        Ok(())
    }
}

fn f64_at(bytes: &[u8], at: usize) -> f64 {
    let [low, high] = [at, at + 4].map(|at| u64::from(u32::from_le_bytes(word(bytes, at))));
    f64::from_bits(low | high << 32)
}
