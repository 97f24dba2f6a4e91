//! Ray files: the rays of a light source, as makers measure them or as another trace recorded them.
//!
//! Four formats are read: IES TM-25-13, binary and text source files of Zemax OpticStudio, and the columns of
//! a ray database. TM-25 is written too; columns are what a trace writes for its detectors. Each module names the source of its layout.
//!
//! Files may hold 2e7 rays and come from anywhere. Rays are handed out by ranges, so memory is constant.
//! Sizes are checked against the file's before memory is taken, and messages name a byte, a line or a ray.

#[cfg(test)]
mod broken;
mod npz;
mod ray;
mod records;
mod sum;
#[cfg(test)]
mod tests;
mod tm25;
mod tm25_writer;
mod zemax;
mod zemax_text;

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::Path;
use std::time::SystemTime;

use crate::format::hex;
use sha2::{Digest, Sha256};

pub use ray::{Error, FluxKind, Format, Header, LengthUnit, Picking, Ray, Result, Wavelengths};
pub use tm25_writer::{Tm25Labels, Tm25Writer};

use npz::Columns;
use records::Records;
use sum::Sum;
use zemax_text::Lines;

/// Rays that are read at once where all are wanted.
const CHUNK: u64 = 1 << 14;
/// Up to this relative difference, a stated flux differs from the sum of the rays by rounding. This is eight roundings
/// of the f32 that both are kept in. Programs that sum in f32 have more than one.
const ROUNDED_FLUX: f64 = 1.0 / (1 << 20) as f64;

/// A ray file that is open: a file on disk, or bytes that were handed over.
#[derive(Debug)]
pub struct RayFile<R = File> {
    reader: R,
    length: u64,
    header: Header,
    layout: Layout,
}

/// Where the rays lie.
#[derive(Debug)]
enum Layout {
    Records(Records),
    Lines(Lines),
    Columns(Columns),
}

/// Length, and the time of the last change: another state, another content.
pub type FileState = (u64, Option<SystemTime>);

/// The state of a file.
///
/// # Errors
/// If there is no such file.
pub fn state_of(path: &Path) -> Result<FileState> {
    let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    match path.metadata() {
        Ok(found) if found.is_file() => Ok((found.len(), found.modified().ok())),
        _ => Err(Error::new(name, "there is no such file", "name a ray file")),
    }
}

impl RayFile {
    /// The state of the file that is open.
    ///
    /// # Errors
    /// If the system does not say.
    pub fn state(&self) -> Result<FileState> {
        let found = self.reader.metadata().map_err(|error| Error::io("the file", &error))?;
        Ok((found.len(), found.modified().ok()))
    }

    /// Opens a file and reads its header.
    ///
    /// # Errors
    /// If it cannot be read, is of no known format, or its header and size contradict each other.
    pub fn open(path: &Path) -> Result<Self> {
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        state_of(path)?;
        let file = File::open(path).map_err(|error| Error::io(name.as_str(), &error))?;
        RayFile::of(file, &name)
    }
}

impl<R: Read + Seek> RayFile<R> {
    /// As [`RayFile::open`]. The first bytes decide the format. The name decides for text alone.
    ///
    /// # Errors
    /// As [`RayFile::open`].
    pub fn of(mut reader: R, name: &str) -> Result<Self> {
        let length = reader.seek(SeekFrom::End(0)).map_err(|error| Error::io(name, &error))?;
        let start = records::bytes_at(&mut reader, 0, length.min(64) as usize)?;
        let first = records::word(&start, 0);
        let (header, layout) = if first == *tm25::MAGIC {
            let (header, records) = tm25::open(&mut reader, length)?;
            (header, Layout::Records(records))
        } else if npz::MAGIC.contains(&&first) {
            let (header, columns) = npz::open(&mut reader, length)?;
            (header, Layout::Columns(columns))
        } else if zemax::VERSIONS.contains(&i32::from_le_bytes(first)) {
            let (header, records) = zemax::open(&mut reader, length)?;
            (header, Layout::Records(records))
        } else if is_text(name, &start) {
            let (header, lines) = zemax_text::open(&mut reader, length)?;
            (header, Layout::Lines(lines))
        } else {
            return Err(unknown(name, first));
        };
        Ok(RayFile { reader, length, header, layout })
    }

    /// What the file says before its rays.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Size of the file \[bytes\].
    pub fn num_bytes(&self) -> u64 {
        self.length
    }

    /// Puts the rays of a range in place of what the vector holds. Any range may be read at any time.
    ///
    /// # Errors
    /// If the file has fewer rays, cannot be read, or holds a wrong ray. A ray is wrong by a direction of another
    /// length than 1, a flux below 0, or a number that is not finite.
    pub fn read(&mut self, range: Range<u64>, rays: &mut Vec<Ray>) -> Result<()> {
        rays.clear();
        self.check_range(&range)?;
        match &mut self.layout {
            Layout::Records(records) => records.pick(&mut self.reader, range, rays),
            Layout::Lines(lines) => lines.read(&mut self.reader, range, rays),
            Layout::Columns(columns) => columns.read(&mut self.reader, range, rays),
        }
    }

    /// Hands out those rays of a range that are wanted. Of records, other rays are neither decoded nor checked, which is several
    /// times as fast where few are wanted.
    ///
    /// # Errors
    /// As [`RayFile::read`], and what `picking` returns.
    pub fn pick<E: From<Error>>(
        &mut self,
        range: Range<u64>,
        picking: &mut impl Picking<E>,
    ) -> std::result::Result<(), E> {
        self.check_range(&range)?;
        if let Layout::Records(records) = &self.layout {
            return records.pick(&mut self.reader, range, picking);
        }
        let mut rays = Vec::new();
        self.read(range.clone(), &mut rays)?;
        for (number, ray) in range.zip(&rays) {
            if picking.wants(number, ray.flux, ray.wavelength)? {
                picking.take(number, ray)?;
            }
        }
        Ok(())
    }

    fn check_range(&self, range: &Range<u64>) -> Result<()> {
        let num_rays = self.header.num_rays;
        if range.start > range.end || range.end > num_rays {
            let problem =
                format!("the file has {num_rays} rays, and {}..{} were asked for", range.start, range.end);
            return Err(Error::new(format!("ray {}", range.start), problem, "ask for rays that it has"));
        }
        Ok(())
    }

    /// Calls `take` with all rays in order, and their numbers. Returns their flux, in the unit of [`Header::flux_kind`]: what
    /// the file launches.
    ///
    /// # Errors
    /// The errors of [`RayFile::read`] and of `take`, and if the sum is beyond f64.
    pub fn for_each<E: From<Error>>(
        &mut self,
        mut take: impl FnMut(u64, &Ray) -> std::result::Result<(), E>,
    ) -> std::result::Result<f64, E> {
        let num_rays = self.header.num_rays;
        let mut sum = Sum::default();
        let mut rays = Vec::new();
        let mut first = 0;
        // Once without rays as well: lines may follow.
        loop {
            let end = num_rays.min(first + CHUNK);
            self.read(first..end, &mut rays)?;
            for (index, ray) in (first..).zip(&rays) {
                take(index, ray)?;
                sum.add(ray.flux);
            }
            first = end;
            if first == num_rays {
                break;
            }
        }
        let sum = sum.value();
        if sum.is_finite() {
            return Ok(sum);
        }
        let problem = "their flux is beyond f64";
        Err(Error::new("the sum of all rays", problem, "state it in a larger unit").into())
    }

    /// The flux of all rays, as [`RayFile::for_each`] gives it.
    ///
    /// # Errors
    /// The errors of [`RayFile::for_each`].
    #[cfg(test)]
    fn sum_flux(&mut self) -> Result<f64> {
        self.for_each(|_, _| Ok(()))
    }

    /// Compares the flux of all rays with what the header states, to within the rounding of the format.
    ///
    /// The header of a Zemax file binds nothing, since OpticStudio does not read its flux. There a difference is
    /// a remark.
    ///
    /// # Errors
    /// If a total that binds differs. The error names both.
    pub fn compare_total(&self, sum: f64) -> Result<Option<String>> {
        let Some(total) = self.header.total_flux else { return Ok(None) };
        if (sum - total).abs() <= ROUNDED_FLUX * sum.max(total) {
            return Ok(None);
        }
        let unit = self.header.flux_kind.map_or("", FluxKind::unit);
        let problem = format!("it states {total} {unit}, and the flux of its rays is {sum} {unit} in all");
        if self.header.format == Format::ZemaxBinary {
            return Ok(Some(format!("the header's flux is not used: {problem}")));
        }
        let remedy = "say which of the two holds: correct the file, or give the flux in the scene";
        Err(Error::new("the header", problem, remedy))
    }

    /// The SHA-256 of the whole file, in hexadecimal.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn sha256(&mut self) -> Result<String> {
        let mut hash = Sha256::new();
        let mut block = vec![0; 1 << 16];
        self.reader.seek(SeekFrom::Start(0)).map_err(|error| Error::io("byte 0", &error))?;
        let mut place: u64 = 0;
        loop {
            match self.reader.read(&mut block) {
                Ok(0) => break,
                Ok(num_bytes) => {
                    hash.update(&block[..num_bytes]);
                    place += num_bytes as u64;
                }
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(Error::io(format!("byte {place}"), &error)),
            }
        }
        Ok(hex(&hash.finalize()))
    }
}

fn extension(name: &str) -> String {
    name.rsplit_once('.').map_or(String::new(), |(_, extension)| extension.to_ascii_lowercase())
}

/// A file that may be a text source file: by its name, and because it holds no bytes that text has not.
fn is_text(name: &str, start: &[u8]) -> bool {
    let is_letter = |byte: &u8| matches!(byte, b' '..=b'~' | b'\t' | b'\r' | b'\n');
    matches!(extension(name).as_str(), "dat" | "sdf" | "txt") && start.iter().all(is_letter)
}

fn unknown(name: &str, first: [u8; 4]) -> Error {
    let problem = match (extension(name).as_str(), i32::from_be_bytes(first)) {
        ("tm25ray", _) => format!("it does not begin with `TM25`, but with the bytes {first:02x?}"),
        (_, version) if zemax::VERSIONS.contains(&version) => {
            "it is a Zemax source file in big-endian order".into()
        }
        _ => format!("its format is unknown: it begins with the bytes {first:02x?}"),
    };
    let remedy = "give rays as IES TM-25 (.tm25ray), Zemax source file (.dat, .sdf) or npz of a ray database";
    Error::new("byte 0", problem, remedy)
}
