//! Lamps: intensity as a table over two angles, as makers measure it.
//!
//! The polar angle gamma is 0 along local +z. The azimuth C is 0 along local x, and 90 degrees along local y: photometry of
//! type C (CIE 121:1996, IES LM-63-19). Between the angles of the table intensity is linear in each of them. Beyond the
//! polar angles intensity is 0.
//!
//! A direction is drawn by the exact inverse of the table's distribution, so that all rays weigh the same. The polar angle
//! comes first, by the flux between polar angles and by Newton's method within an interval. The azimuth follows, by the flux
//! around that cone and by a quadratic equation within an interval.

use crate::Result;
use crate::model::key_path::key_of;
use crate::model::sources::{
    Emission, OwnFlux, SourceFunction, SourceKind, SourceWgsl, WrittenSource, written,
};
use crate::model::{Outline, PolarTable, checks};
use crate::shaders::shader;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Its function.
pub const TABULATED: SourceWgsl =
    SourceWgsl { name: "tabulated", file: shader!("sources/tabulated.wgsl"), num_steps: 1 };

/// Most values of a table as written, once its symmetry is unfolded.
const MAX_VALUES: usize = 1 << 20;

/// Rays from a point or an area whose directions follow a table.
#[derive(Debug, Clone, PartialEq)]
pub struct Tabulated {
    /// Where rays are born; of a point, a disk without an extent.
    pub area: Outline,
    /// The intensity.
    pub table: Arc<PolarTable>,
}

/// A lamp file that a source names.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LampFile {
    /// The source's name.
    pub source: String,
    /// The file, as the scene names it.
    pub file: String,
    /// Its hash.
    pub sha256: String,
    /// Light that the table stands for \[lm\].
    pub lumens: f64,
}

/// What a number of a table stands for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
pub enum IntensityUnits {
    /// A share: the source's flux is given beside the table.
    #[default]
    #[serde(rename = "relative")]
    Relative,
    /// W/sr.
    #[serde(rename = "W/sr")]
    Radiant,
    /// Candela.
    #[serde(rename = "cd")]
    Luminous,
}

/// Intensities: a row for each azimuth, or the one row of a lamp of revolution.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Rows {
    /// The same around the axis.
    Revolution(Vec<f64>),
    /// A row for each azimuth.
    Azimuths(Vec<Vec<f64>>),
}

impl Rows {
    fn rows(&self) -> Vec<&[f64]> {
        match self {
            Rows::Revolution(row) => vec![row],
            Rows::Azimuths(rows) => rows.iter().map(Vec::as_slice).collect(),
        }
    }
}

written! {
    /// A lamp: intensity over polar angles and azimuths, from a point, a rectangle or a disk.
    pub struct Written {
        /// A maker's file, relative to the scene file: IES LM-63 (.ies) or EULUMDAT (.ldt), instead of angles and intensities.
        #[serde(default)]
        pub file: Option<String>,
        /// Angles gamma from the axis, rising \[deg\].
        #[serde(default)]
        pub polar_angles_deg: Vec<f64>,
        /// Planes C, rising from 0 \[deg\]: to 360, or to 180 or 90 where the lamp is symmetric; [0] for a lamp of
        /// revolution.
        #[serde(default = "revolution")]
        pub azimuth_angles_deg: Vec<f64>,
        /// Intensity: a row for each plane, or one row.
        #[serde(default = "no_rows")]
        pub intensity: Rows,
        /// Units of the intensity; `W/sr` and `cd` say the flux as well.
        #[serde(default)]
        pub intensity_units: IntensityUnits,
        /// Width of the rectangle where rays are born, along local x \[mm\].
        #[serde(default)]
        pub width: Option<f64>,
        /// Its height, along local y \[mm\].
        #[serde(default)]
        pub height: Option<f64>,
        /// Radius of the disk where rays are born \[mm\], instead of width and height; 0 for a point.
        #[serde(default)]
        pub radius: Option<f64>,
    }
}

fn revolution() -> Vec<f64> {
    vec![0.0]
}

fn no_rows() -> Rows {
    Rows::Azimuths(Vec::new())
}

impl WrittenSource for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        self.check_area(at)?;
        check_rising(&at("polar_angles_deg"), &self.polar_angles_deg, [0.0, 180.0])?;
        if self.polar_angles_deg.len() < 2 {
            return checks::refuse(
                at("polar_angles_deg"),
                "a table needs two angles",
                "give at least two angles",
            );
        }
        check_rising(&at("azimuth_angles_deg"), &self.azimuth_angles_deg, [0.0, 360.0])?;
        self.check_symmetry(at)?;
        self.check_rows(at)
    }

    fn kind(&self) -> SourceKind {
        let area = match (self.width, self.height, self.radius) {
            (Some(width), Some(height), None) => Outline::Rectangle { width, height },
            (.., radius) => Outline::Disk { radius: radius.unwrap_or(0.0) },
        };
        SourceKind::Tabulated(Tabulated { area, table: Arc::new(self.table()) })
    }

    fn own_flux(&self) -> Option<OwnFlux> {
        match self.intensity_units {
            IntensityUnits::Relative => None,
            IntensityUnits::Radiant => Some(OwnFlux::Watts(self.table().flux())),
            IntensityUnits::Luminous => Some(OwnFlux::Lumens(self.table().flux())),
        }
    }
}

/// Angles in a range, one above the other.
fn check_rising(place: &str, angles: &[f64], [low, high]: [f64; 2]) -> Result<()> {
    for (i, &angle) in angles.iter().enumerate() {
        checks::between(format!("{place}[{i}]"), angle, low, high)?;
        if i > 0 && angle <= angles[i - 1] {
            return checks::refuse(
                format!("{place}[{i}]"),
                format!("{angle} is not above {}", angles[i - 1]),
                "give angles in rising order",
            );
        }
    }
    Ok(())
}

impl Written {
    fn check_area(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        match (self.width, self.height, self.radius) {
            (None, None, None) => Ok(()),
            (None, None, Some(0.0)) => Ok(()),
            (None, None, Some(radius)) => checks::size(at("radius"), radius),
            // A line has one extent.
            (Some(0.0), Some(height), None) => checks::size(at("height"), height),
            (Some(width), Some(0.0), None) => checks::size(at("width"), width),
            (Some(width), Some(height), None) => {
                checks::size(at("width"), width)?;
                checks::size(at("height"), height)
            }
            (_, _, Some(_)) => checks::refuse(
                at("radius"),
                "it stands beside a width or a height",
                "give a rectangle or a disk",
            ),
            (Some(_), None, None) => checks::refuse(at("width"), "the height is missing", "give both"),
            (None, Some(_), None) => checks::refuse(at("height"), "the width is missing", "give both"),
        }
    }

    /// Planes end where a symmetry lets them.
    fn check_symmetry(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        let (place, angles) = (at("azimuth_angles_deg"), &self.azimuth_angles_deg);
        match (angles.first(), angles.last()) {
            (Some(0.0), Some(0.0 | 90.0 | 180.0 | 360.0)) => Ok(()),
            (Some(0.0), Some(last)) => checks::refuse(
                place,
                format!("the planes end at {last} degrees"),
                "end them at 360; or at 180 or 90, if the lamp is symmetric; or give [0] for a lamp of revolution",
            ),
            _ => checks::refuse(place, "the planes do not begin at 0 degrees", "begin with the plane C = 0"),
        }
    }

    fn check_rows(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        let (place, rows) = (at("intensity"), self.intensity.rows());
        let [num_rows, num_values] = [self.azimuth_angles_deg.len(), self.polar_angles_deg.len()];
        if rows.len() != num_rows {
            let problem = format!("{} rows for {num_rows} planes", rows.len());
            return checks::refuse(place, problem, "give a row of intensities for each azimuth angle");
        }
        if 4 * num_rows * num_values > MAX_VALUES {
            let problem = format!("{} values are too many", num_rows * num_values);
            return checks::refuse(place, problem, format!("give at most {} values", MAX_VALUES / 4));
        }
        for (i, row) in rows.iter().enumerate() {
            let place = format!("{place}[{i}]");
            if row.len() != num_values {
                let problem = format!("{} values for {num_values} polar angles", row.len());
                return checks::refuse(place, problem, "give an intensity for each polar angle");
            }
            for (j, &value) in row.iter().enumerate() {
                /// Largest intensity, so that no sum overflows.
                const MOST: f64 = 1e30;
                checks::between(format!("{place}[{j}]"), value, 0.0, MOST)?;
            }
        }
        if self.azimuth_angles_deg.last() == Some(&360.0) && rows.first() != rows.last() {
            return checks::refuse(place, "the planes of 0 and 360 degrees differ", "give both the same row");
        }
        if self.table().flux() <= 0.0 {
            return checks::refuse(place, "the table has no light", "give at least one intensity above 0");
        }
        Ok(())
    }

    /// The table all around the axis.
    fn table(&self) -> PolarTable {
        let rows = self.intensity.rows().into_iter().map(<[f64]>::to_vec);
        let mut planes: Vec<Plane> = self.azimuth_angles_deg.iter().copied().zip(rows).collect();
        // The one plane of a lamp of revolution stands for all.
        if let [(_, row)] = &planes[..] {
            planes = vec![(0.0, row.clone()), (360.0, row.clone())];
        }
        while planes.last().is_some_and(|(last, _)| (90.0..360.0).contains(last)) {
            planes = mirrored(planes);
        }
        let (azimuth, rows) = planes.into_iter().map(|(angle, row)| (angle.to_radians(), row)).unzip();
        PolarTable {
            polar: self.polar_angles_deg.iter().map(|angle| angle.to_radians()).collect(),
            azimuth,
            rows,
        }
    }

    /// Its keys that a file fills. `place` is the source's.
    pub(crate) fn file_and_table(&self, place: &str) -> Result<Option<&str>> {
        let of_table = [
            ("polar_angles_deg", !self.polar_angles_deg.is_empty()),
            ("azimuth_angles_deg", self.azimuth_angles_deg != [0.0]),
            ("intensity", !self.intensity.rows().iter().all(|row| row.is_empty())),
            ("intensity_units", self.intensity_units != IntensityUnits::Relative),
        ];
        let given = of_table.iter().find(|(_, is_given)| *is_given);
        match (&self.file, given) {
            (Some(_), Some((key, _))) => Err(crate::Error::scene(
                key_of(place, "file"),
                format!("the source has `{key}` as well, which the file says"),
                "give the file, or angles and intensities",
            )),
            (file, _) => Ok(file.as_deref()),
        }
    }
}

/// A plane C \[deg\] and its intensities.
pub(crate) type Plane = (f64, Vec<f64>);

/// Planes from C0 on, and behind the last one their mirror images about it.
pub(crate) fn mirrored(mut planes: Vec<Plane>) -> Vec<Plane> {
    let about = planes.last().map_or(0.0, |(angle, _)| *angle);
    let images: Vec<Plane> =
        planes.iter().rev().skip(1).map(|(angle, row)| (2.0 * about - angle, row.clone())).collect();
    planes.extend(images);
    planes
}

impl Emission for Tabulated {
    fn kind(&self) -> SourceFunction {
        SourceFunction::Tabulated
    }

    fn arguments(&self) -> Vec<f64> {
        /// Where there is no table yet.
        const NONE: f64 = -1.0;
        match self.area {
            Outline::Rectangle { width, height } => vec![width, height, 0.0, NONE],
            Outline::Disk { radius } => vec![0.0, 0.0, radius, NONE],
            Outline::Infinite => vec![0.0, 0.0, 0.0, NONE],
        }
    }

    fn table(&self, _: &[f64]) -> Vec<f64> {
        self.table.numbers()
    }

    fn births(&self) -> Outline {
        self.area
    }

    /// The last angle below which there is light.
    fn half_angle(&self) -> f64 {
        let table = &self.table;
        let is_lit = |k: &usize| table.rows.iter().any(|row| row[*k] > 0.0);
        let last = (0..table.polar.len()).rev().find(is_lit).unwrap_or(0);
        table.polar[(last + 1).min(table.polar.len() - 1)]
    }

    fn is_point(&self) -> bool {
        self.area == Outline::Disk { radius: 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_of_a_half_and_a_quarter_are_mirrored() {
        let text = serde_json::json!({"name": "L", "cs": {}, "spectrum": {"wavelengths": [0.55], "weights": [1.0]},
            "polar_angles_deg": [0, 90], "azimuth_angles_deg": [0, 30, 90], "intensity": [[1, 1], [2, 2], [3, 3]]});
        let written: Written = serde_json::from_value(text).unwrap();
        let table = written.table();
        let angles: Vec<f64> = table.azimuth.iter().map(|angle| angle.to_degrees().round()).collect();
        assert_eq!(angles, [0.0, 30.0, 90.0, 150.0, 180.0, 210.0, 270.0, 330.0, 360.0]);
        let values: Vec<f64> = table.rows.iter().map(|row| row[0]).collect();
        assert_eq!(values, [1.0, 2.0, 3.0, 2.0, 1.0, 2.0, 3.0, 2.0, 1.0]);
    }
}
