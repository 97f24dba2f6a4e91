//! `.npz` files that `numpy.load(allow_pickle=False)` reads: Optiland's keys and shapes, float64 in C order, scalars as
//! 0-d arrays, plus `hits`, `standard_error`, `total_flux_standard_error` and `meta`.
//!
//! `meta` is a 0-d string of JSON: what the file holds, its units, and the trace it comes from. No file holds a time,
//! so equal results are equal files.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use ndarray_npy::{NpzWriter, WriteNpyError, WriteNpyExt};
use zip::write::SimpleFileOptions;

use crate::error::{Error, Result};
use crate::placing::step;
use crate::result::ray_rows::{self, Rows};

/// Takes the arrays of a result: into an `.npz` file, or into memory.
pub(crate) struct ArrayWriter(Destination);

enum Destination {
    /// An `.npz` file in the making.
    File { path: PathBuf, writer: Box<NpzWriter<BufWriter<UntilFailure>>> },
    /// Each array with its name, in the format `.npy`.
    Memory(Vec<(String, Vec<u8>)>),
}

/// A file that ignores all writes after one that failed. The archive's writer goes on to write its end, and would
/// complain on stderr if it could not.
struct UntilFailure {
    file: File,
    failed: bool,
    place: u64,
    end: u64,
}

impl UntilFailure {
    fn new(file: File) -> Self {
        UntilFailure { file, failed: false, place: 0, end: 0 }
    }

    /// What it does, unless it pretends to.
    fn act<T>(&mut self, pretended: T, act: impl FnOnce(&mut File) -> io::Result<T>) -> io::Result<T> {
        if self.failed {
            return Ok(pretended);
        }
        let done = act(&mut self.file);
        self.failed = done.as_ref().is_err_and(|error| error.kind() != io::ErrorKind::Interrupted);
        done
    }
}

impl Write for UntilFailure {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let length = self.act(bytes.len(), |file| file.write(bytes))?;
        self.place += length as u64;
        self.end = self.end.max(self.place);
        Ok(length)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.act((), Write::flush)
    }
}

impl Seek for UntilFailure {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let place = match to {
            SeekFrom::Start(place) => Some(place),
            SeekFrom::Current(by) => self.place.checked_add_signed(by),
            SeekFrom::End(by) => self.end.checked_add_signed(by),
        };
        let place = place.ok_or(io::ErrorKind::InvalidInput)?;
        self.place = self.act(place, |file| file.seek(to))?;
        Ok(self.place)
    }
}

impl ArrayWriter {
    pub(crate) fn create(path: &Path) -> Result<Self> {
        let file = File::create(path).map_err(|error| Error::file(path, error))?;
        let writer = Box::new(NpzWriter::new(BufWriter::new(UntilFailure::new(file))));
        Ok(ArrayWriter(Destination::File { path: path.into(), writer }))
    }

    pub(crate) fn in_memory() -> Self {
        ArrayWriter(Destination::Memory(Vec::new()))
    }

    /// Adds an array.
    pub(crate) fn add(&mut self, name: &str, array: &(impl WriteNpyExt + ?Sized)) -> Result<()> {
        self.add_with(
            name,
            array,
            SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored),
        )
    }

    fn add_with(
        &mut self,
        name: &str,
        array: &(impl WriteNpyExt + ?Sized),
        options: SimpleFileOptions,
    ) -> Result<()> {
        match &mut self.0 {
            Destination::File { path, writer } => {
                step();
                let added = writer.add_array_with_options(name, array, options);
                added.map_err(|error| unwritten(path, &error))
            }
            Destination::Memory(arrays) => {
                let mut bytes = Vec::new();
                array
                    .write_npy(&mut bytes)
                    .map_err(|error| Error::Internal(format!("array {name}: {error}")))?;
                arrays.push((name.into(), bytes));
                Ok(())
            }
        }
    }

    /// Adds a column of recorded rows, shape (n,), read as it is written.
    pub(crate) fn add_column<F: Fn(u64, &mut Vec<u8>)>(
        &mut self,
        name: &str,
        column: &Column<'_, F>,
    ) -> Result<()> {
        let stored = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
        self.add_with(name, column, stored.large_file(column.num_bytes() >= LARGE))
    }

    /// Adds a column of strings, shape (n,): what `texts` has for the rows' words.
    pub(crate) fn add_text_column(
        &mut self,
        name: &str,
        rows: &Rows,
        word: usize,
        texts: &BTreeMap<u64, &str>,
    ) -> Result<()> {
        let width = width_of(texts.values().copied());
        let texts: BTreeMap<u64, Vec<u8>> =
            texts.iter().map(|(&word, text)| (word, utf_32(text, width))).collect();
        let text = |word, bytes: &mut Vec<u8>| {
            bytes.extend_from_slice(texts.get(&word).map_or(&[], Vec::as_slice));
        };
        self.add_column(name, &Column::new(rows, word, &format!("<U{width}"), 4 * width, text))
    }

    /// Adds an array if it is there.
    pub(crate) fn add_optional(&mut self, name: &str, array: &Option<impl WriteNpyExt>) -> Result<()> {
        array.as_ref().map_or(Ok(()), |array| self.add(name, array))
    }

    /// Adds one string, 0-d.
    pub(crate) fn add_string(&mut self, name: &str, value: &str) -> Result<()> {
        self.add(name, &Text(value))
    }

    /// Ends the file, or returns the arrays that were kept in memory.
    pub(crate) fn finish(self) -> Result<Vec<(String, Vec<u8>)>> {
        let (path, writer) = match self.0 {
            Destination::Memory(arrays) => return Ok(arrays),
            Destination::File { path, writer } => (path, writer),
        };
        let buffer = writer.finish().map_err(|error| unwritten(&path, &error))?;
        let inner = buffer.into_inner().map_err(|error| Error::file(&path, error.error()))?;
        inner.file.sync_all().map_err(|error| Error::file(&path, error))?;
        Ok(Vec::new())
    }
}

/// An archive that could not be written. The message is the first of all causes: what the system said.
fn unwritten(path: &Path, error: &(dyn std::error::Error + 'static)) -> Error {
    let cause = std::iter::successors(Some(error), |error| error.source()).last().unwrap_or(error);
    Error::file(path, cause)
}

/// A member of an archive from this size on needs a header of its own kind \[bytes\]; the `.npy` header is counted in.
const LARGE: u64 = u32::MAX as u64 - (1 << 16);

/// One word of recorded rows as a column of a file.
pub(crate) struct Column<'a, F> {
    rows: &'a Rows,
    word: usize,
    descr: String,
    item_bytes: usize,
    /// Appends what the file holds for a row's word.
    encode: F,
}

impl<'a, F: Fn(u64, &mut Vec<u8>)> Column<'a, F> {
    /// A column of NumPy's type `descr`, of `item_bytes` bytes each.
    pub(crate) fn new(rows: &'a Rows, word: usize, descr: &str, item_bytes: usize, encode: F) -> Self {
        Column { rows, word, descr: descr.into(), item_bytes, encode }
    }

    fn num_bytes(&self) -> u64 {
        self.rows.len() * self.item_bytes as u64
    }
}

/// Encodes a word as an f64.
type Encode<'a> = Box<dyn Fn(u64, &mut Vec<u8>) + 'a>;

impl<'a> Column<'a, Encode<'a>> {
    /// A column of what `value` makes of the reals in `word`.
    pub(crate) fn real(rows: &'a Rows, word: usize, value: impl Fn(f64) -> f64 + 'a) -> Self {
        Column::f64(rows, word, move |word| value(f64::from_bits(word)))
    }

    /// The column of wavelengths.
    pub(crate) fn wavelength(rows: &'a Rows, wavelengths: &'a [f64]) -> Self {
        Column::f64(rows, ray_rows::BOUNCE_AND_WAVELENGTH, |word| wavelengths[ray_rows::wavelength_of(word)])
    }

    fn f64(rows: &'a Rows, word: usize, value: impl Fn(u64) -> f64 + 'a) -> Self {
        let encode: Encode<'a> = Box::new(move |word, bytes| bytes.extend(value(word).to_le_bytes()));
        Column::new(rows, word, "<f8", 8, encode)
    }
}

impl<F: Fn(u64, &mut Vec<u8>)> WriteNpyExt for Column<'_, F> {
    fn write_npy<W: Write>(&self, mut writer: W) -> std::result::Result<(), WriteNpyError> {
        writer.write_all(&npy_header(&self.descr, &format!("({},)", self.rows.len())))?;
        let mut bytes = Vec::new();
        let written = self.rows.for_each_block(self.word, |words| {
            bytes.clear();
            words.iter().for_each(|&word| (self.encode)(word, &mut bytes));
            writer.write_all(&bytes)
        });
        written.map_err(io::Error::other)?;
        Ok(writer.flush()?)
    }
}

/// A string as NumPy keeps it, which `ndarray-npy` has no element for.
struct Text<'a>(&'a str);

impl WriteNpyExt for Text<'_> {
    fn write_npy<W: Write>(&self, mut writer: W) -> std::result::Result<(), WriteNpyError> {
        let width = width_of([self.0]);
        writer.write_all(&npy_header(&format!("<U{width}"), "()"))?;
        writer.write_all(&utf_32(self.0, width))?;
        Ok(writer.flush()?)
    }
}

/// Characters of the longest text.
fn width_of<'a>(texts: impl IntoIterator<Item = &'a str>) -> usize {
    texts.into_iter().map(|text| text.chars().count()).max().unwrap_or(0).max(1)
}

/// UTF-32 of a fixed width, padded with zeros.
fn utf_32(text: &str, width: usize) -> Vec<u8> {
    let padded = text.chars().map(u32::from).chain(std::iter::repeat(0)).take(width);
    padded.flat_map(u32::to_le_bytes).collect()
}

/// The header of format 1.0: magic, version, length, dictionary, padded so that the data starts at a multiple of 64.
fn npy_header(descr: &str, shape: &str) -> Vec<u8> {
    const PREFIX: usize = 10;
    let dictionary = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    let length = (PREFIX + dictionary.len() + 1).next_multiple_of(64) - PREFIX;
    let mut header = b"\x93NUMPY\x01\x00".to_vec();
    header.extend((length as u16).to_le_bytes());
    header.extend(format!("{dictionary:<width$}\n", width = length - 1).into_bytes());
    header
}
