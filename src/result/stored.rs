//! What a folder of results holds of one detector: its entry of the report, and its `.npz` file.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use ndarray::{Array, Dimension};
use ndarray_npy::npy::header::Header;
use ndarray_npy::{NpzReader, ReadableElement};
use serde::Deserialize;
use zip::{CompressionMethod, ZipArchive};

use crate::error::{Error, Result};
use crate::model::Frame;
use crate::result::FewRays;

/// What the report says of one detector.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct DetectorEntry {
    pub kind: String,
    pub absorb: bool,
    pub total_flux: f64,
    #[serde(default)]
    pub total_flux_standard_error: Option<f64>,
    #[serde(default)]
    pub total_flux_recorded: Option<f64>,
    #[serde(flatten)]
    pub few_rays: Option<FewRays>,
    #[serde(default)]
    pub title: Option<String>,
    pub num_rays_hit: u64,
    pub file: Option<String>,
    #[serde(default)]
    width: Option<f64>,
    #[serde(default)]
    height: Option<f64>,
    #[serde(default)]
    frame: Option<FrameEntry>,
}

#[derive(Debug, Clone, Deserialize)]
pub(crate) struct FrameEntry {
    origin: [f64; 3],
    axes: [[f64; 3]; 3],
}

/// An entry of a report, and the `.npz` file that it names.
pub(crate) struct Stored {
    /// What the report says.
    pub entry: DetectorEntry,
    name: String,
    report: PathBuf,
    path: PathBuf,
    reader: NpzReader<BufReader<File>>,
}

/// Refuses an archive that claims to hold more than it has bytes, before anything is unpacked: this program stores arrays as
/// they are.
fn check_claims(file: &File) -> std::result::Result<(), String> {
    let length = file.metadata().map_err(|error| error.to_string())?.len();
    let mut archive = ZipArchive::new(BufReader::new(file)).map_err(|error| error.to_string())?;
    for index in 0..archive.len() {
        let mut member = archive.by_index(index).map_err(|error| error.to_string())?;
        let (name, size) = (member.name().to_string(), member.size());
        let claims = |what: &str, bytes: u128| {
            Err(format!(
                "`{name}` {what} {bytes} bytes, in a file of {length}: this program did not write it"
            ))
        };
        if member.compression() != CompressionMethod::Stored || size > length {
            return claims("would unpack to", size.into());
        }
        let Ok(header) = Header::from_reader(&mut member) else { continue };
        // Each number or letter takes one byte at least.
        let num_items =
            header.shape.iter().try_fold(1_u128, |product, &side| product.checked_mul(side as u128));
        let num_items = num_items.unwrap_or(u128::MAX);
        if num_items > size.into() {
            return claims("claims more than", num_items);
        }
    }
    Ok(())
}

impl Stored {
    /// Opens the file of a detector, whose entry stands in a report.
    pub(crate) fn open(report: PathBuf, name: &str, entry: DetectorEntry, path: PathBuf) -> Result<Self> {
        let reader = open(&path)?;
        Ok(Stored { entry, name: name.into(), report, path, reader })
    }

    fn missing(&self, what: &str) -> Error {
        Error::file(&self.report, format!("has no {what} of detector '{}'", self.name))
    }

    /// Width and height \[mm\].
    pub(crate) fn size(&self) -> Result<(f64, f64)> {
        let width = self.entry.width.ok_or_else(|| self.missing("width"))?;
        self.entry.height.ok_or_else(|| self.missing("height")).map(|height| (width, height))
    }

    /// The frame that the detector stood in.
    pub(crate) fn frame(&self) -> Result<Frame> {
        let FrameEntry { origin, axes } = self.entry.frame.as_ref().ok_or_else(|| self.missing("frame"))?;
        Ok(Frame { origin: DVec3::from_array(*origin), rotation: DMat3::from_cols_array_2d(axes) })
    }

    pub(crate) fn array<T: ReadableElement, D: Dimension>(&mut self, name: &str) -> Result<Array<T, D>> {
        self.reader.by_name(name).map_err(|error| Error::file(&self.path, format!("`{name}`: {error}")))
    }

    /// An array that a trace without standard errors does not write.
    pub(crate) fn optional<T: ReadableElement, D: Dimension>(
        &mut self,
        name: &str,
    ) -> Result<Option<Array<T, D>>> {
        let names = self.reader.names().map_err(|error| Error::file(&self.path, error))?;
        if names.iter().any(|other| other.trim_end_matches(".npy") == name) {
            self.array(name).map(Some)
        } else {
            Ok(None)
        }
    }

    /// The shapes must fit, since whoever shows the arrays indexes them together.
    pub(crate) fn check(&self, fits: bool) -> Result<()> {
        if fits { Ok(()) } else { Err(Error::file(&self.path, "the shapes of its arrays do not fit")) }
    }
}

fn open(path: &Path) -> Result<NpzReader<BufReader<File>>> {
    if !path.is_file() {
        return Err(Error::file(path, "is no file"));
    }
    let file = File::open(path).map_err(|error| Error::file(path, error))?;
    check_claims(&file).map_err(|problem| Error::file(path, problem))?;
    NpzReader::new(BufReader::new(file)).map_err(|error| Error::file(path, error))
}
