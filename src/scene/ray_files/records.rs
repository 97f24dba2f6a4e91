//! Rays as records of a fixed number of little-endian f32, which TM-25 and Zemax binary files have in common.

use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;

use super::ray::{Error, Picking, Ray, Result};

/// Bytes that are read at once.
const BLOCK: usize = 1 << 20;
/// Bytes of a number.
const ITEM: usize = 4;

/// Where the rays of a file lie, and which columns hold what. Position and direction are the first six.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Records {
    /// Byte of the first ray.
    pub start: u64,
    /// Numbers of a ray.
    pub num_items: usize,
    /// Millimetres in a unit of length.
    pub millimetres: f64,
    /// The column of the flux.
    pub flux: usize,
    /// The column of the wavelength, and micrometres in its unit.
    pub wavelength: Option<(usize, f64)>,
    /// The wavelength of all rays, if there is no column \[um\].
    pub single: Option<f64>,
}

impl Records {
    fn record(&self) -> usize {
        self.num_items * ITEM
    }

    /// The file must end with its last ray.
    pub(super) fn check_length(&self, num_rays: u64, length: u64) -> Result<()> {
        let end = u128::from(self.start) + u128::from(num_rays) * self.record() as u128;
        if end == u128::from(length) {
            return Ok(());
        }
        let problem = format!(
            "{num_rays} rays of {} bytes end at byte {end}, and the file has {length} bytes",
            self.record()
        );
        let remedy = if end > u128::from(length) {
            "the file is cut off, or its header is wrong: fetch or export it again"
        } else {
            "a ray file ends with its last ray: fetch or export it again"
        };
        Err(Error::at(self.start, problem, remedy))
    }

    /// Hands out those rays of a range that are wanted. Other rays are not decoded.
    pub(super) fn pick<E: From<Error>>(
        &self,
        reader: &mut (impl Read + Seek),
        range: Range<u64>,
        picking: &mut impl Picking<E>,
    ) -> std::result::Result<(), E> {
        let record = self.record();
        let byte_of = |ray: u64| self.start + ray * record as u64;
        let at = |ray: u64| format!("byte {}", byte_of(ray));
        reader
            .seek(SeekFrom::Start(byte_of(range.start)))
            .map_err(|error| Error::io(at(range.start), &error))?;
        let most = (BLOCK / record).max(1) as u64;
        let mut block = Vec::new();
        let mut first = range.start;
        while first < range.end {
            let count = most.min(range.end - first);
            block.resize(count as usize * record, 0);
            reader.read_exact(&mut block).map_err(|error| Error::io(at(first), &error))?;
            for (ray, bytes) in (first..).zip(block.chunks_exact(record)) {
                if picking.wants(ray, item(bytes, self.flux), self.wavelength(bytes))? {
                    let place = || format!("ray {ray}, byte {}", byte_of(ray));
                    picking.take(ray, &self.ray(bytes).checked(place)?)?;
                }
            }
            first += count;
        }
        Ok(())
    }

    fn wavelength(&self, bytes: &[u8]) -> Option<f64> {
        match self.wavelength {
            Some((column, micrometres)) => Some(item(bytes, column) * micrometres),
            None => self.single,
        }
    }

    fn ray(&self, bytes: &[u8]) -> Ray {
        let item = |column: usize| item(bytes, column);
        Ray {
            position: [0, 1, 2].map(|column| item(column) * self.millimetres),
            direction: [3, 4, 5].map(item),
            flux: item(self.flux),
            wavelength: self.wavelength(bytes),
        }
    }
}

fn item(bytes: &[u8], column: usize) -> f64 {
    f32_at(bytes, column * ITEM).into()
}

/// Four bytes from a place on; 0 for those that are not there.
pub(super) fn word(bytes: &[u8], at: usize) -> [u8; 4] {
    std::array::from_fn(|index| bytes.get(at + index).copied().unwrap_or(0))
}

pub(super) fn i32_at(bytes: &[u8], at: usize) -> i32 {
    i32::from_le_bytes(word(bytes, at))
}

pub(super) fn f32_at(bytes: &[u8], at: usize) -> f32 {
    f32::from_le_bytes(word(bytes, at))
}

/// The first bytes of a file, so many of them.
pub(super) fn head(reader: &mut (impl Read + Seek), num_bytes: usize, length: u64) -> Result<Vec<u8>> {
    if length < num_bytes as u64 {
        return Err(Error::at(
            length,
            format!("the file ends within its header of {num_bytes} bytes"),
            "the file is cut off: fetch or export it again",
        ));
    }
    bytes_at(reader, 0, num_bytes)
}

/// Bytes from a place on. The caller has checked that the file holds as many.
pub(super) fn bytes_at(reader: &mut (impl Read + Seek), start: u64, num_bytes: usize) -> Result<Vec<u8>> {
    let mut bytes = vec![0; num_bytes];
    let read = reader.seek(SeekFrom::Start(start)).and_then(|_| reader.read_exact(&mut bytes));
    read.map_err(|error| Error::io(format!("byte {start}"), &error))?;
    Ok(bytes)
}
