//! Coatings of a scene file: checks, and their values at the wavelengths of the scene.

use crate::model;
use crate::model::key_path::key_of;
use crate::scene::json::{Coating, TabulatedCoating};
use crate::scene::surfaces::look_up;
use crate::scene::validate::{check_no_repeats, check_reflectance};
use crate::{Error, Result};

/// R + T may exceed 1 by the rounding of decimal fractions.
const ROUNDING: f64 = 1e-12;
/// Cosines of neighbouring angles differ by so much at least, so that they differ in f32.
const LEAST_STEP: f64 = 1e-6;
/// Most angles of a table.
const MAX_ANGLES: usize = 1 << 16;

impl Coating {
    /// Checks all that needs no other part of the scene.
    pub(super) fn check(&self, place: &str) -> Result<()> {
        match self {
            Coating::Simple { reflectance, transmittance } => {
                check_reflectance(&key_of(place, "reflectance"), reflectance)?;
                check_reflectance(&key_of(place, "transmittance"), transmittance)
            }
            Coating::Tabulated(table) => table.check(place),
        }
    }

    /// The coating at the wavelengths of the scene \[um\].
    pub(super) fn at(&self, wavelengths: &[f64], place: &str) -> Result<model::Coating> {
        match self {
            Coating::Simple { reflectance, transmittance } => {
                let reflectance = reflectance.at(wavelengths, &key_of(place, "reflectance"))?;
                let transmittance = transmittance.at(wavelengths, &key_of(place, "transmittance"))?;
                for ((&r, &t), wavelength) in reflectance.iter().zip(&transmittance).zip(wavelengths) {
                    check_sum(key_of(place, "transmittance"), r, t, &format!("{wavelength} um"))?;
                }
                Ok(model::Coating::Simple(model::SimpleCoating { reflectance, transmittance }))
            }
            Coating::Tabulated(table) => table.at(wavelengths, place).map(model::Coating::Tabulated),
        }
    }
}

fn check_sum(place: String, r: f64, t: f64, at: &str) -> Result<()> {
    if r + t <= 1.0 + ROUNDING {
        return Ok(());
    }
    Err(Error::scene(
        place,
        format!("the coating gives more light than it gets: R = {r} and T = {t} at {at}"),
        "give R + T <= 1; what is left of 1 is absorbed",
    ))
}

impl TabulatedCoating {
    /// Each table with its key.
    fn tables(&self) -> [(&'static str, &Vec<Vec<f64>>); 4] {
        [
            ("reflectance", &self.reflectance),
            ("transmittance", &self.transmittance),
            ("reflectance_back", &self.reflectance_back),
            ("transmittance_back", &self.transmittance_back),
        ]
    }

    fn check(&self, place: &str) -> Result<()> {
        check_no_repeats(place, &self.wavelengths)?;
        self.check_angles(&key_of(place, "angles"))?;
        for (key, rows) in self.tables() {
            let place = key_of(place, key);
            let (num_rows, num_wavelengths) = (rows.len(), self.wavelengths.len());
            if num_rows != num_wavelengths {
                let problem = format!("{num_rows} rows for {num_wavelengths} wavelengths");
                return Err(Error::scene(place, problem, "give one row per wavelength"));
            }
            for (i, row) in rows.iter().enumerate() {
                self.check_row(&format!("{place}[{i}]"), row)?;
            }
        }
        for (keys, r, t) in [
            ("transmittance", &self.reflectance, &self.transmittance),
            ("transmittance_back", &self.reflectance_back, &self.transmittance_back),
        ] {
            for (i, (r, t)) in r.iter().zip(t).enumerate() {
                for (j, (&r, &t)) in r.iter().zip(t).enumerate() {
                    let at = format!("{} um and {} degrees", self.wavelengths[i], self.angles[j]);
                    check_sum(format!("{}[{i}][{j}]", key_of(place, keys)), r, t, &at)?;
                }
            }
        }
        Ok(())
    }

    fn check_angles(&self, place: &str) -> Result<()> {
        let advice = "give ascending angles from the normal in degrees, from 0 to 90, both included";
        let num = self.angles.len();
        if !(2..=MAX_ANGLES).contains(&num) {
            return Err(Error::scene(
                place,
                format!("the table has {num} angles, not 2 to {MAX_ANGLES}"),
                advice,
            ));
        }
        for (i, wanted) in [(0, 0.0), (num - 1, 90.0)] {
            if self.angles[i] != wanted {
                let problem = format!("the angle is {}, not {wanted}", self.angles[i]);
                return Err(Error::scene(format!("{place}[{i}]"), problem, advice));
            }
        }
        for (i, pair) in self.angles.windows(2).enumerate() {
            let place = format!("{place}[{}]", i + 1);
            if !(pair[0] < pair[1] && pair[1] <= 90.0) {
                let problem = format!("{} does not exceed the angle before it", pair[1]);
                return Err(Error::scene(place, problem, advice));
            }
            if cosine(pair[0]) - cosine(pair[1]) < LEAST_STEP {
                return Err(Error::scene(
                    place,
                    format!(
                        "{} and {} degrees lie too close: their cosines differ by less than {LEAST_STEP}",
                        pair[0], pair[1]
                    ),
                    "leave one of the two out; near 0 degrees a step of 0.1 is enough",
                ));
            }
        }
        Ok(())
    }

    fn check_row(&self, place: &str, row: &[f64]) -> Result<()> {
        let num_angles = self.angles.len();
        if row.len() != num_angles {
            let problem = format!("{} values for {num_angles} angles", row.len());
            return Err(Error::scene(place, problem, "give one value per angle"));
        }
        match row.iter().position(|value| !(0.0..=1.0).contains(value)) {
            None => Ok(()),
            Some(j) => Err(Error::scene(
                format!("{place}[{j}]"),
                format!("{} is not between 0 and 1", row[j]),
                "give the fraction of the light, from 0 to 1",
            )),
        }
    }

    /// Angles ascend, and so cosines come in the reverse order.
    fn at(&self, wavelengths: &[f64], place: &str) -> Result<model::TabulatedCoating> {
        let indices: Vec<f64> = (0..self.wavelengths.len()).map(|i| i as f64).collect();
        let rows = look_up(&self.wavelengths, &indices, wavelengths, place)?;
        let row = |i: usize| {
            let [r, t, r_back, t_back] =
                self.tables().map(|(_, rows)| rows[i].iter().rev().copied().collect::<Vec<f64>>());
            model::CoatingRow {
                reflectance: r,
                transmittance: t,
                reflectance_back: r_back,
                transmittance_back: t_back,
            }
        };
        Ok(model::TabulatedCoating {
            cosines: self.angles.iter().rev().map(|&angle| cosine(angle)).collect(),
            rows: rows.into_iter().map(|i| row(i as usize)).collect(),
        })
    }
}

/// The cosine of an angle \[deg\]; of a right angle exactly 0.
fn cosine(degrees: f64) -> f64 {
    if degrees == 90.0 { 0.0 } else { degrees.to_radians().cos() }
}
