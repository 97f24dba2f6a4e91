//! `trace --rays-out`: the rays of a ray database as a ray file, which a source of another scene names.

use crate::cli::console::say;
use crate::cli::output_file::OutputFile;
use crate::error::{Error, Result};
use crate::format::shown;
use crate::model::{DetectorKind, SceneIr};
use crate::result::{DetectorData, TraceResult};
use crate::scene::ray_files::{FluxKind, Ray, Tm25Labels, Tm25Writer, Wavelengths};
use std::io::Cursor;
use std::path::Path;

/// The file, and the detector whose rays it gets.
#[derive(Debug)]
pub(super) struct RaysOut {
    file: OutputFile,
    detector: String,
}

impl RaysOut {
    /// Looks at the scene and the place of the file, before the first ray.
    pub(super) fn new(path: &Path, ir: &SceneIr, scene: &Path) -> Result<Self> {
        let is_tm25 = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("tm25ray"));
        if !is_tm25 {
            let problem =
                "--rays-out writes IES TM-25: end the name in .tm25ray; -o writes the same rays as NAME.npz";
            return Err(Error::file(path, problem));
        }
        let is_database = |kind: &DetectorKind| matches!(kind, DetectorKind::RayDatabase(_));
        let databases: Vec<&str> = ir
            .detectors
            .iter()
            .filter(|detector| is_database(&detector.kind))
            .map(|detector| detector.name.as_str())
            .collect();
        let [detector] = databases[..] else {
            return Err(Error::Usage(format!(
                "--rays-out takes the rays of the one detector of type ray_database, and the scene has {}",
                databases.len()
            )));
        };
        let file = OutputFile::new(path, false, scene, |_| false)?;
        Ok(RaysOut { file, detector: detector.into() })
    }

    /// Writes the rays.
    pub(super) fn write(&self, result: &TraceResult) -> Result<()> {
        let none = || Error::Internal(format!("no rays of `{}`", shown(&self.detector)));
        let detector = result.detector(&self.detector).ok_or_else(none)?;
        let DetectorData::RayDatabase(rays) = &detector.data else { return Err(none()) };
        let columns = rays.columns()?;
        let refused = |error: crate::scene::ray_files::Error| Error::Usage(format!("--rays-out: {error}"));
        let first = columns.wavelength.first().copied();
        let wavelengths = match first {
            Some(one) if columns.wavelength.iter().all(|wavelength| *wavelength == one) => {
                Wavelengths::One(one)
            }
            Some(_) => Wavelengths::PerRay,
            None => Wavelengths::None,
        };
        let labels = Tm25Labels {
            flux_kind: FluxKind::Radiant,
            wavelengths,
            name: self.detector.clone(),
            software: concat!("nsq-gpu ", env!("CARGO_PKG_VERSION")).into(),
            date: String::new(),
        };
        let mut bytes = Cursor::new(Vec::new());
        let mut file = Tm25Writer::new(&mut bytes, labels).map_err(refused)?;
        for i in 0..columns.flux.len() {
            let ray = Ray {
                position: [0, 1, 2].map(|axis| columns.position[axis][i]),
                direction: [0, 1, 2].map(|axis| columns.direction[axis][i]),
                flux: columns.flux[i],
                wavelength: Some(columns.wavelength[i]),
            };
            file.push(&ray).map_err(refused)?;
        }
        file.finish().map_err(refused)?;
        let path = self.file.write(bytes.get_ref())?;
        say(&format!("written: {}, {} rays", path.display(), columns.flux.len()));
        Ok(())
    }
}
