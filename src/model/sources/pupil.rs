//! The light of one field of a lens, which fills the entrance pupil as a sequential engine does.
//!
//! With p uniform in the unit disk, a ray starts at (`beam_radii[0]` p.x, `beam_radii[1]` p.y, 0) and runs along `chief` +
//! (`pupil_radii[0]` p.x, `pupil_radii[1]` p.y, 0). A field at infinity has parallel rays: its `pupil_radii` are 0. A field
//! at a finite distance has one point: its `beam_radii` are 0, and `chief` leads to the middle of the pupil.
//!
//! Rays that are aimed at the stop of a wide-angle lens fill the pupil unevenly, and by wavelength. What they add to start
//! and vector is a polynomial of p for each wavelength.

use crate::Result;
use crate::model::sources::{Emission, SourceFunction, SourceKind, SourceWgsl, WrittenSource, written};
use crate::model::{Outline, checks, coefficient_rows};
use crate::shaders::shader;
use schemars::JsonSchema;
use serde::Deserialize;
use std::sync::Arc;

/// The pupil.
pub const PUPIL: SourceWgsl = SourceWgsl { name: "pupil", file: shader!("sources/pupil.wgsl"), num_steps: 1 };

/// Rays of one field through a pupil.
#[derive(Debug, Clone, PartialEq)]
pub struct Pupil {
    /// Semi-axes of the beam at z = 0, along x and y \[mm\].
    pub beam_radii: [f64; 2],
    /// A vector along the chief ray \[mm\], with z > 0.
    pub chief: [f64; 3],
    /// What the rim of the pupil adds to the vector, along x and y \[mm\].
    pub pupil_radii: [f64; 2],
    /// What aimed rays add, by wavelength; empty for none.
    pub aimed: Arc<[Aim]>,
}

/// What rays of one wavelength add that are aimed at the stop: `table[i][j]` of p.x^i p.y^j.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Aim {
    /// Wavelength \[um\].
    pub wavelength: f64,
    /// To where rays start, along x \[mm\].
    #[serde(default)]
    pub x: Vec<Vec<f64>>,
    /// To where rays start, along y \[mm\].
    #[serde(default)]
    pub y: Vec<Vec<f64>>,
    /// To the vector, along x \[mm\].
    #[serde(default)]
    pub vector_x: Vec<Vec<f64>>,
    /// To the vector, along y \[mm\].
    #[serde(default)]
    pub vector_y: Vec<Vec<f64>>,
}

/// Highest power of p.x, and of p.y.
const HIGHEST_POWER: usize = 15;

impl Aim {
    /// Each table with its key.
    fn tables(&self) -> [(&'static str, &Vec<Vec<f64>>); 4] {
        [("x", &self.x), ("y", &self.y), ("vector_x", &self.vector_x), ("vector_y", &self.vector_y)]
    }

    fn check(&self, place: &str) -> Result<()> {
        for (key, rows) in self.tables() {
            let place = format!("{place}.{key}");
            if rows.len() > HIGHEST_POWER + 1 || rows.iter().any(|row| row.len() > HIGHEST_POWER + 1) {
                return checks::refuse(
                    place,
                    "it goes beyond the highest power",
                    format!("give powers up to {HIGHEST_POWER}"),
                );
            }
            for (i, row) in rows.iter().enumerate() {
                for (j, &number) in row.iter().enumerate() {
                    checks::position(format!("{place}[{i}][{j}]"), number)?;
                }
            }
        }
        Ok(())
    }

    /// Its tables for shaders/sources/aimed.table.wgsl, one after the other.
    fn numbers(&self) -> Vec<f64> {
        self.tables().into_iter().flat_map(|(_, rows)| coefficient_rows::backwards(rows)).collect()
    }

    /// More than what each table adds anywhere.
    fn most(&self) -> [f64; 4] {
        self.tables().map(|(_, rows)| rows.iter().flatten().map(|number| number.abs()).sum())
    }
}

written! {
    /// The light of one field of a lens, which fills the entrance pupil uniformly: with p in the unit disk, rays start at
    /// beam_radii p and run along chief + pupil_radii p.
    pub struct Written {
        /// Semi-axes of the beam at z = 0, along x and y \[mm\]; 0 and 0 for a field at a finite distance.
        #[serde(default)]
        pub beam_radii: [f64; 2],
        /// A vector along the chief ray \[mm\], with z > 0.
        pub chief: [f64; 3],
        /// What the rim of the pupil adds to the vector, along x and y \[mm\]; 0 and 0 for a field at infinity.
        #[serde(default)]
        pub pupil_radii: [f64; 2],
        /// What aimed rays add: an entry for each wavelength of the spectrum, or none.
        #[serde(default)]
        pub aimed: Vec<Aim>,
    }
}

impl WrittenSource for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        for (key, numbers) in
            [("beam_radii", &self.beam_radii[..]), ("chief", &self.chief), ("pupil_radii", &self.pupil_radii)]
        {
            for (i, &number) in numbers.iter().enumerate() {
                checks::position(format!("{}[{i}]", at(key)), number)?;
            }
        }
        for (i, aim) in self.aimed.iter().enumerate() {
            let place = format!("{}[{i}]", at("aimed"));
            aim.check(&place)?;
            let is_emitted = self.spectrum.wavelengths.contains(&aim.wavelength);
            if !is_emitted || self.aimed[..i].iter().any(|other| other.wavelength == aim.wavelength) {
                let problem =
                    format!("{} um is no wavelength of the spectrum, or is listed twice", aim.wavelength);
                return checks::refuse(
                    format!("{place}.wavelength"),
                    problem,
                    "give each wavelength of the spectrum once",
                );
            }
        }
        if !self.aimed.is_empty() && self.aimed.len() < self.spectrum.wavelengths.len() {
            let problem =
                format!("{} entries for {} wavelengths", self.aimed.len(), self.spectrum.wavelengths.len());
            return checks::refuse(at("aimed"), problem, "give each wavelength of the spectrum once");
        }
        checks::size(format!("{}[2]", at("chief")), self.chief[2])
    }

    fn kind(&self) -> SourceKind {
        let Written { beam_radii, chief, pupil_radii, ref aimed, .. } = *self;
        SourceKind::Pupil(Pupil { beam_radii, chief, pupil_radii, aimed: aimed.clone().into() })
    }
}

impl Pupil {
    /// More than what aiming adds anywhere, to start and vector along x and y \[mm\].
    fn most_aimed(&self) -> [f64; 4] {
        self.aimed.iter().map(Aim::most).fold([0.0; 4], |most, one| [0, 1, 2, 3].map(|i| one[i].max(most[i])))
    }
}

impl Emission for Pupil {
    fn kind(&self) -> SourceFunction {
        SourceFunction::Pupil
    }

    fn arguments(&self) -> Vec<f64> {
        /// Where there is no table.
        const NONE: f64 = -1.0;
        [&self.beam_radii[..], &self.chief, &self.pupil_radii, &[NONE]].concat()
    }

    /// The places of the tables of each wavelength of the scene, or -1; then these.
    fn table(&self, wavelengths: &[f64]) -> Vec<f64> {
        if self.aimed.is_empty() {
            return Vec::new();
        }
        let mut places = Vec::new();
        let mut tables = Vec::new();
        for wavelength in wavelengths {
            let aim = self.aimed.iter().find(|aim| aim.wavelength == *wavelength);
            places.push(aim.map_or(-1.0, |_| (wavelengths.len() + tables.len()) as f64));
            tables.extend(aim.map(Aim::numbers).unwrap_or_default());
        }
        [places, tables].concat()
    }

    fn births(&self) -> Outline {
        let [x, y, ..] = self.most_aimed();
        Outline::Disk { radius: (self.beam_radii[0].abs() + x).max(self.beam_radii[1].abs() + y) }
    }

    fn half_angle(&self) -> f64 {
        let [x, y, z] = self.chief;
        let [across, up] = self.pupil_radii;
        let [.., aimed_x, aimed_y] = self.most_aimed();
        (x.abs() + across.abs() + aimed_x).hypot(y.abs() + up.abs() + aimed_y).atan2(z)
    }

    fn is_aimed(&self) -> bool {
        !self.aimed.is_empty()
    }

    fn is_point(&self) -> bool {
        let [x, y, ..] = self.most_aimed();
        [self.beam_radii, [x, y]] == [[0.0; 2]; 2]
    }
}
