//! A table as a file has it, before its symmetry is unfolded.

use crate::model::bsdfs::measured::hemisphere::within_hemisphere;
use crate::model::bsdfs::measured::table::{MeasuredRow, MeasuredTable};
use crate::model::key_path::quoted;
use crate::model::{PolarTable, checks};
use crate::{Error, Result};
use schemars::JsonSchema;
use serde::Deserialize;

/// Largest value of a table \[1/sr\].
const MAX_VALUE: f64 = 1e12;
/// A full turn \[deg\].
const TURN: f64 = 360.0;

/// The light that was measured.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
pub enum ScatterType {
    /// What comes back.
    #[default]
    #[serde(rename = "BRDF")]
    Reflected,
    /// What goes through.
    #[serde(rename = "BTDF")]
    Transmitted,
}

/// Values over three angles \[deg\].
#[derive(Debug, Clone)]
pub(super) struct Grid {
    pub scatter_type: ScatterType,
    pub incidence: Vec<f64>,
    pub azimuth: Vec<f64>,
    pub radial: Vec<f64>,
    /// By angle of incidence, azimuth and radial angle \[1/sr\].
    pub values: Vec<Vec<Vec<f64>>>,
    /// The share that scatters, by angle of incidence; more than 1 where a table was divided by its own level.
    pub tis: Option<Vec<f64>>,
}

impl Grid {
    /// The table that is traced. Refuses what is none; `at` gives the place of a key.
    pub fn table(&self, at: &dyn Fn(&str) -> String) -> Result<MeasuredTable> {
        check_angles(&at("angle_of_incidence_deg"), &self.incidence, 90.0)?;
        check_angles(&at("scatter_azimuth_deg"), &self.azimuth, TURN)?;
        check_angles(&at("scatter_radial_deg"), &self.radial, 180.0)?;
        if self.radial[0] != 0.0 || self.radial.len() < 2 {
            let problem = "the angles from the specular direction are no range that begins there";
            let remedy = "give at least two angles, the first one 0";
            return Err(Error::scene(at("scatter_radial_deg"), problem, remedy));
        }
        let closing = self.closing(&at("scatter_azimuth_deg"))?;
        self.check_values(&at("values"))?;
        if let Some(tis) = &self.tis {
            check_count(&at("tis"), tis.len(), self.incidence.len(), "angles of incidence")?;
        }
        let rows = 0..self.incidence.len();
        Ok(MeasuredTable {
            transmits: self.scatter_type == ScatterType::Transmitted,
            rows: rows.map(|i| self.row(i, closing, &at("tis"))).collect::<Result<_>>()?,
        })
    }

    fn check_values(&self, place: &str) -> Result<()> {
        check_count(place, self.values.len(), self.incidence.len(), "angles of incidence")?;
        for (i, rows) in self.values.iter().enumerate() {
            let place = format!("{place}[{i}]");
            check_count(&place, rows.len(), self.azimuth.len(), "azimuths")?;
            for (j, row) in rows.iter().enumerate() {
                let place = format!("{place}[{j}]");
                check_count(&place, row.len(), self.radial.len(), "radial angles")?;
                for (k, value) in row.iter().enumerate() {
                    checks::between(format!("{place}[{k}]"), *value, 0.0, MAX_VALUE)?;
                }
            }
        }
        let is_dark = self.values.iter().flatten().flatten().all(|value| *value == 0.0);
        let remedy = "give at least one value above 0, or remove the bsdf";
        if is_dark { checks::refuse(place, "the table scatters nothing", remedy) } else { Ok(()) }
    }

    /// What was measured at an angle of incidence, with the energy that is stated. `place` is where the shares stand.
    fn row(&self, i: usize, closing: Closing, place: &str) -> Result<MeasuredRow> {
        let (incidence_deg, mut values) = (self.incidence[i], self.around(i, closing));
        let measured = within_hemisphere(&values, incidence_deg);
        let stated = self.tis.as_ref().map(|tis| tis[i]);
        if let Some(share) = stated {
            let place = format!("{place}[{i}]");
            checks::between(place.clone(), share, 0.0, MAX_VALUE)?;
            if share > 0.0 && measured <= 0.0 {
                let problem =
                    format!("{share} of the light scatters, and the values at {incidence_deg} degrees are 0");
                return Err(Error::scene(place, problem, "give the values, or a share of 0"));
            }
        }
        let scattered = stated.unwrap_or(measured);
        if measured > 0.0 {
            values.rows.iter_mut().flatten().for_each(|value| *value *= scattered / measured);
        }
        Ok(MeasuredRow { incidence_deg, values, scattered, measured })
    }

    /// How the azimuths go on to a full turn.
    fn closing(&self, place: &str) -> Result<Closing> {
        let step = self.azimuth.windows(2).last().map_or(0.0, |ends| ends[1] - ends[0]);
        let last = self.azimuth.last().copied().unwrap_or(0.0);
        match (self.azimuth[0], last) {
            (0.0, 0.0) => Ok(Closing::Alike),
            (0.0, TURN) => Ok(Closing::Closed),
            (0.0, 180.0) => Ok(Closing::Mirrored),
            // Angles in text are rounded.
            (0.0, last) if (last + step - TURN).abs() < 1e-6 * TURN => Ok(Closing::First),
            (0.0, last) => Err(Error::scene(
                place,
                format!("the azimuths end at {last} degrees"),
                "end them at 360, or at 180 where the surface has a plane of symmetry; or give [0] where the azimuth does not count",
            )),
            _ => Err(Error::scene(
                place,
                "the azimuths do not begin at 0 degrees",
                "begin with 0, the direction from the specular light to the normal",
            )),
        }
    }

    /// The values at an angle of incidence, all around the specular direction.
    fn around(&self, i: usize, closing: Closing) -> PolarTable {
        let mut planes: Vec<(f64, Vec<f64>)> =
            self.azimuth.iter().copied().zip(self.values[i].iter().cloned()).collect();
        match closing {
            Closing::Alike | Closing::First => planes.push((TURN, planes[0].1.clone())),
            Closing::Mirrored => {
                let images: Vec<_> =
                    planes.iter().rev().skip(1).map(|(angle, row)| (TURN - angle, row.clone())).collect();
                planes.extend(images);
            }
            Closing::Closed => {}
        }
        let (azimuth, rows) = planes.into_iter().map(|(angle, row)| (angle.to_radians(), row)).unzip();
        let polar = self.radial.iter().map(|angle| angle.to_radians()).collect();
        PolarTable { polar, azimuth, rows }
    }

    /// What the user should know of light beyond the radial angles.
    pub fn warning(&self, name: &str) -> Option<String> {
        /// A share of the brightest value that a cut leaves.
        const CUT: f64 = 0.01;
        let largest = self.values.iter().flatten().flatten().copied().fold(0.0, f64::max);
        let at_end = self.values.iter().flatten().filter_map(|row| row.last().copied()).fold(0.0, f64::max);
        let last = self.radial[self.radial.len() - 1];
        (last < 90.0 && at_end > CUT * largest).then(|| {
            format!(
                "the BSDF of {} ends {last} degrees from the specular direction, where it is still {:.2} % of its largest \
                 value; beyond it is 0",
                quoted(name),
                100.0 * at_end / largest
            )
        })
    }
}

/// How azimuths go on to a full turn.
#[derive(Clone, Copy)]
enum Closing {
    /// One stands for all.
    Alike,
    /// They do so already.
    Closed,
    /// By their mirror images.
    Mirrored,
    /// With the first one.
    First,
}

fn check_angles(place: &str, angles: &[f64], most: f64) -> Result<()> {
    if angles.is_empty() {
        return checks::refuse(place, "there is no angle", "give at least one");
    }
    for (i, angle) in angles.iter().enumerate() {
        checks::between(format!("{place}[{i}]"), *angle, 0.0, most)?;
        if i > 0 && *angle <= angles[i - 1] {
            let problem = format!("{angle} does not exceed the angle before it");
            return checks::refuse(
                format!("{place}[{i}]"),
                problem,
                "give the angles in rising order, each once",
            );
        }
    }
    Ok(())
}

fn check_count(place: &str, found: usize, wanted: usize, what: &str) -> Result<()> {
    if found == wanted {
        return Ok(());
    }
    let problem = format!("it has {found} entries for {wanted} {what}");
    checks::refuse(place, problem, "give one for each")
}
