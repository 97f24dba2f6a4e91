//! The light of one field of a lens, which fills the entrance pupil as a sequential engine does.
//!
//! With p uniform in the unit disk, a ray starts at (`beam_radii[0]` p.x, `beam_radii[1]` p.y, 0) and runs along `chief` +
//! (`pupil_radii[0]` p.x, `pupil_radii[1]` p.y, 0). A field at infinity has parallel rays: its `pupil_radii` are 0. A field
//! at a finite distance has one point: its `beam_radii` are 0, and `chief` leads to the middle of the pupil.

use crate::Result;
use crate::model::sources::{Emission, Entry, SourceFunction, SourceKind, SourceWgsl, written};
use crate::model::{Outline, checks};
use crate::shaders::shader;

/// The pupil.
pub const PUPIL: SourceWgsl = SourceWgsl { name: "pupil", file: shader!("sources/pupil.wgsl"), num_steps: 1 };

/// Rays of one field through a pupil.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pupil {
    /// Semi-axes of the beam at z = 0, along x and y \[mm\].
    pub beam_radii: [f64; 2],
    /// A vector along the chief ray \[mm\], with z > 0.
    pub chief: [f64; 3],
    /// What the rim of the pupil adds to the vector, along x and y \[mm\].
    pub pupil_radii: [f64; 2],
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
    }
}

impl Entry for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        for (key, numbers) in
            [("beam_radii", &self.beam_radii[..]), ("chief", &self.chief), ("pupil_radii", &self.pupil_radii)]
        {
            for (i, &number) in numbers.iter().enumerate() {
                checks::position(format!("{}[{i}]", at(key)), number)?;
            }
        }
        checks::size(format!("{}[2]", at("chief")), self.chief[2])
    }

    fn kind(&self) -> SourceKind {
        let Written { beam_radii, chief, pupil_radii, .. } = *self;
        SourceKind::Pupil(Pupil { beam_radii, chief, pupil_radii })
    }
}

impl Emission for Pupil {
    fn kind(&self) -> SourceFunction {
        SourceFunction::Pupil
    }

    fn arguments(&self) -> Vec<f64> {
        [&self.beam_radii[..], &self.chief, &self.pupil_radii].concat()
    }

    fn births(&self) -> Outline {
        Outline::Disk { radius: self.beam_radii[0].abs().max(self.beam_radii[1].abs()) }
    }

    fn half_angle(&self) -> f64 {
        let [x, y, z] = self.chief;
        let [across, up] = self.pupil_radii;
        (x.abs() + across.abs()).hypot(y.abs() + up.abs()).atan2(z)
    }

    fn is_point(&self) -> bool {
        self.beam_radii == [0.0, 0.0]
    }
}
