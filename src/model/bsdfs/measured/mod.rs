//! Measured scattering with azimuth: values over the angle of incidence, and over two angles about the specular direction.
//!
//! The radial angle is the angle from the specular direction. The azimuth turns about the specular direction, from 0
//! towards the normal. The azimuth grows counter-clockwise, looking against the specular ray (R. Rykowski, Zemax
//! tabular BSDF data file format). Values are linear in each angle. Beyond the last radial angle and below the surface
//! they are 0. Beyond the angles of incidence, the values of the nearest one count.

mod csv;
mod grid;
mod hemisphere;
mod table;
mod zemax;

use crate::model::bsdfs::measured::grid::{Grid, ScatterType};
pub use crate::model::bsdfs::measured::table::{MeasuredRow, MeasuredTable};
use crate::model::bsdfs::{
    Bsdf, BsdfContext, BsdfKind, BsdfWgsl, Labelled, Scattering, WrittenBsdf, other_side,
};
use crate::model::key_path::{key_of, quoted};
use crate::model::{Interaction, whole_files};
use crate::shaders::shader;
use crate::{Error, Result};
use schemars::JsonSchema;
use serde::Deserialize;
use std::path::Path;
use std::sync::Arc;

/// The table.
pub const MEASURED: BsdfWgsl = BsdfWgsl {
    name: "measured",
    file: shader!("bsdfs/measured.wgsl"),
    shared: None,
    has_table: true,
    toward: &[shader!("scatter_to/measured.wgsl")],
};

/// Largest file of a table \[bytes\].
const MAX_FILE_BYTES: u64 = 256 << 20;
/// Most numbers of the shaders' table: its places are reals, which f32 has exactly up to there.
const MAX_NUMBERS: usize = 1 << 24;

/// Values about the specular direction.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// The values, whatever the level.
    pub table: Arc<MeasuredTable>,
    /// What the values are multiplied by.
    pub level: f64,
}

/// A table in a scene file: from a file, or inline.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Written {
    /// A `.bsdf` file (Zemax tabular BSDF) or a `.csv` file with a header, relative to the scene file.
    #[serde(default)]
    pub path: Option<String>,
    /// Whether the light was measured that comes back, or the light that goes through.
    #[serde(default)]
    pub scatter_type: Option<ScatterType>,
    /// Angles of incidence, rising \[deg\].
    #[serde(default)]
    pub angle_of_incidence_deg: Option<Vec<f64>>,
    /// Azimuths about the specular direction, rising from 0 \[deg\]: to 360, or to 180 where the surface has a plane of symmetry;
    /// [0] where the azimuth does not count.
    #[serde(default)]
    pub scatter_azimuth_deg: Option<Vec<f64>>,
    /// Angles from the specular direction, rising from 0 \[deg\].
    #[serde(default)]
    pub scatter_radial_deg: Option<Vec<f64>>,
    /// By angle of incidence, azimuth and radial angle \[1/sr\].
    #[serde(default)]
    pub values: Option<Vec<Vec<Vec<f64>>>>,
    /// The share of the light that scatters, by angle of incidence; by default the integral of the values.
    #[serde(default)]
    pub tis: Option<Vec<f64>>,
}

impl WrittenBsdf for Written {
    /// The table is checked where it is read.
    fn check(&self, _: &dyn Fn(&str) -> String) -> Result<()> {
        Ok(())
    }

    fn bsdf(&self, surface: &Labelled<'_>, reading: &mut BsdfContext<'_>) -> Result<Bsdf> {
        let place = surface.place;
        let grid = self.grid(place, reading.folder)?;
        let table = Arc::new(match &self.path {
            Some(_) => grid.table(&|key| format!("{}, {key}", key_of(place, "path")))?,
            None => grid.table(&|key| key_of(place, key))?,
        });
        reading.warnings.extend(grid.warning(surface.name));
        if table.numbers(1.0).len() > MAX_NUMBERS {
            let problem = "the table has too many angles";
            return Err(Error::scene(surface.place, problem, "give fewer radial angles or azimuths"));
        }
        reading.warnings.extend(table.warnings(surface.name));
        Ok(Bsdf::Measured(Measured { table, level: 1.0 }))
    }
}

impl Written {
    fn grid(&self, place: &str, folder: &Path) -> Result<Grid> {
        let (incidence, azimuth, radial) =
            (&self.angle_of_incidence_deg, &self.scatter_azimuth_deg, &self.scatter_radial_deg);
        match (&self.path, incidence, azimuth, radial, &self.values) {
            (Some(path), None, None, None, None) if self.tis.is_none() && self.scatter_type.is_none() => {
                from_file(&key_of(place, "path"), path, folder)
            }
            (None, Some(incidence), Some(azimuth), Some(radial), Some(values)) => Ok(Grid {
                scatter_type: self.scatter_type.unwrap_or_default(),
                incidence: incidence.clone(),
                azimuth: azimuth.clone(),
                radial: radial.clone(),
                values: values.clone(),
                tis: self.tis.clone(),
            }),
            _ => Err(Error::scene(
                place,
                "a measured BSDF needs either `path` alone, or all of `angle_of_incidence_deg`, `scatter_azimuth_deg`, \
                 `scatter_radial_deg` and `values`",
                "name a file, or write the table here",
            )),
        }
    }
}

/// The format is known by the ending of the name.
fn from_file(place: &str, path: &str, folder: &Path) -> Result<Grid> {
    let full = folder.join(path);
    let problem = |err: String| {
        let remedy = "give the path of a .bsdf or .csv file, relative to the scene file";
        Error::scene(place, format!("{}: {err}", quoted(&full.display().to_string())), remedy)
    };
    let ending = full.extension().and_then(|ending| ending.to_str()).unwrap_or("").to_ascii_lowercase();
    let parse: fn(&str, &str) -> Result<Grid> = match ending.as_str() {
        "bsdf" => zemax::parse,
        "csv" => csv::parse,
        _ => return Err(problem("the name does not end in .bsdf or .csv".into())),
    };
    let bytes = whole_files::read(&full, MAX_FILE_BYTES).map_err(|err| problem(err.to_string()))?;
    parse(place, &whole_files::text(&bytes))
}

impl Scattering for Measured {
    fn kind(&self) -> BsdfKind {
        BsdfKind::Measured
    }

    fn transmissive_fraction(&self) -> f64 {
        if self.table.transmits { 1.0 } else { 0.0 }
    }

    fn counts(&self) -> Vec<(&'static str, u32)> {
        vec![("num_incidences", self.table.rows.len().max(2) as u32)]
    }

    fn table(&self) -> Vec<f64> {
        self.table.numbers(self.level)
    }

    /// Below the surface no direction lies.
    fn takes_whole_weights(&self) -> bool {
        true
    }

    fn keeps_level(&self) -> bool {
        true
    }

    fn by_tis(&self) -> Option<(f64, Bsdf)> {
        let tis = self.level * self.table.rows[0].scattered;
        Some((tis, Bsdf::Measured(Measured { level: self.level / tis, ..self.clone() })))
    }

    fn warning(&self, surface: &str, interaction: &Interaction) -> Option<String> {
        other_side(surface, interaction, self.transmissive_fraction())
    }
}

#[cfg(test)]
mod tests;
