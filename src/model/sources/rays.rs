//! Rays of a file: those that a maker measured of a lamp, or that another trace recorded.
//!
//! A ray of the trace takes one of the file's, drawn by its share of the light. Draws are independent, so that standard errors of
//! the draw hold; the file's rays in turn would be too even for them. The file's own noise is in no standard error.

use crate::Result;
use crate::model::checks;
use crate::model::shapes::Outline;
use crate::model::sources::{
    Emission, OwnFlux, SourceFunction, SourceKind, SourceWgsl, WrittenSource, written,
};
use crate::shaders::shader;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;

/// Its function.
pub const RAYS: SourceWgsl = SourceWgsl { name: "rays", file: shader!("sources/rays.wgsl"), num_steps: 1 };

/// Most rays of a file that are held, all wavelengths together: the shader's table has places for so many.
pub const MOST_RAYS: usize = (1 << 20) - 1;

/// Rays of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Rays {
    /// The rays.
    pub set: Arc<RaySet>,
}

/// The rays that a file holds, by wavelength.
#[derive(Clone, PartialEq)]
pub struct RaySet {
    /// The file's hash.
    pub sha256: String,
    /// What lengths were multiplied by.
    pub scale: f64,
    /// Rays of one wavelength each; or one group, of all wavelengths.
    pub groups: Vec<RayGroup>,
}

/// Rays of one wavelength.
#[derive(Clone, PartialEq)]
pub struct RayGroup {
    /// The wavelength \[um\]; none: rays of any wavelength.
    pub wavelength: Option<f64>,
    /// Start points in the source's frame \[mm\].
    pub positions: Vec<[f64; 3]>,
    /// Unit directions.
    pub directions: Vec<[f64; 3]>,
    /// Shares of the light, in any unit; above 0.
    pub shares: Vec<f64>,
}

/// The file's hash says what the rays are.
impl fmt::Debug for RaySet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let groups: Vec<_> = self.groups.iter().map(|group| (group.wavelength, group.shares.len())).collect();
        write!(f, "RaySet({} x {:?}, {groups:?})", self.sha256, self.scale)
    }
}

/// A ray file that a source names.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RayFileUsed {
    /// The source's name.
    pub source: String,
    /// The file, as the scene names it.
    pub file: String,
    /// Its hash.
    pub sha256: String,
    /// Its rays, those without light left out.
    pub num_rays: usize,
    /// The flux of its rays, in `unit`.
    pub flux: f64,
    /// `W` or `lm`; none if the file does not say.
    pub unit: Option<String>,
}

/// How rays of a file become rays of a trace.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
pub enum Order {
    /// Drawn by their flux, independently of each other.
    #[default]
    #[serde(rename = "drawn")]
    Drawn,
}

written! {
    /// Rays of a file: IES TM-25 (.tm25ray), a Zemax source file (.dat, .sdf), or the columns of a ray database (.npz).
    pub struct Written {
        /// The file, relative to the scene file.
        pub file: String,
        /// How rays are taken.
        #[serde(default)]
        pub order: Order,
        /// What lengths in the file are multiplied by.
        #[serde(default = "one")]
        pub scale: f64,
        /// The rays, once the file is read.
        #[serde(skip)]
        pub set: Option<Arc<RaySet>>,
        /// The flux of the file's rays, once the file is read and if it says a unit.
        #[serde(skip)]
        pub flux: Option<OwnFlux>,
    }
}

fn one() -> f64 {
    1.0
}

impl WrittenSource for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::between(at("scale"), self.scale, 1e-6, 1e6)
    }

    fn kind(&self) -> SourceKind {
        let none = || Arc::new(RaySet { sha256: String::new(), scale: 1.0, groups: Vec::new() });
        SourceKind::Rays(Rays { set: self.set.clone().unwrap_or_else(none) })
    }

    /// The scene's flux counts where it says one.
    fn own_flux(&self) -> Option<OwnFlux> {
        self.flux.filter(|_| self.total_flux.is_none() && self.total_flux_lumens.is_none())
    }
}

impl RayGroup {
    /// Rows of the shader's table, one for each ray. A row has the share of its draws that stay there, the row that
    /// gets the other draws, position and direction.
    fn rows(&self) -> Vec<f64> {
        let count = self.shares.len();
        let mean = self.shares.iter().sum::<f64>() / count.max(1) as f64;
        // Walker's rows, as Vose makes them: one row that has too little takes from one that has too much.
        let mut left: Vec<f64> = self.shares.iter().map(|share| share / mean).collect();
        let (mut stays, mut other) = (vec![1.0; count], (0..count).collect::<Vec<_>>());
        let (mut small, mut large): (Vec<usize>, Vec<usize>) = (0..count).partition(|i| left[*i] < 1.0);
        while let (Some(poor), Some(rich)) = (small.pop(), large.last().copied()) {
            (stays[poor], other[poor]) = (left[poor], rich);
            left[rich] -= 1.0 - left[poor];
            if left[rich] < 1.0 {
                small.extend(large.pop());
            }
        }
        let row = |i: usize| {
            let ([x, y, z], [l, m, n]) = (self.positions[i], self.directions[i]);
            [stays[i], other[i] as f64, x, y, z, l, m, n]
        };
        (0..count).flat_map(row).collect()
    }
}

impl Emission for Rays {
    fn kind(&self) -> SourceFunction {
        SourceFunction::Rays
    }

    fn arguments(&self) -> Vec<f64> {
        /// Where there is no table yet.
        const NONE: f64 = -1.0;
        vec![NONE]
    }

    /// For each wavelength of the scene, where its rays begin, counted from here; then each group: the number of its rays, and
    /// their rows.
    fn table(&self, wavelengths: &[f64]) -> Vec<f64> {
        let groups = &self.set.groups;
        let mut starts = vec![0.0; groups.len()];
        let mut rows: Vec<f64> = Vec::new();
        for (start, group) in starts.iter_mut().zip(groups) {
            *start = (wavelengths.len() + rows.len()) as f64;
            rows.push(group.shares.len() as f64);
            rows.extend(group.rows());
        }
        let start_of = |wavelength: &f64| {
            let of = |group: &RayGroup| group.wavelength.is_none_or(|own| own == *wavelength);
            groups.iter().position(of).map_or(0.0, |group| starts[group])
        };
        wavelengths.iter().map(start_of).chain(rows).collect()
    }

    /// A disk about the frame's axis. Rays may be born above and below it: [`Emission::heights`].
    fn births(&self) -> Outline {
        let positions = self.set.groups.iter().flat_map(|group| &group.positions);
        let reach = positions.map(|[x, y, _]| x.hypot(*y));
        Outline::Disk { radius: reach.fold(0.0, f64::max) }
    }

    fn heights(&self) -> [f64; 2] {
        let positions = self.set.groups.iter().flat_map(|group| &group.positions);
        let heights = positions.map(|[.., z]| *z);
        heights.fold([0.0, 0.0], |[low, high], z| [f64::min(low, z), f64::max(high, z)])
    }

    fn half_angle(&self) -> f64 {
        let directions = self.set.groups.iter().flat_map(|group| &group.directions);
        let angles = directions.map(|[l, m, n]| l.hypot(*m).atan2(*n));
        angles.fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each ray has its share of the draws: its own row's, and those that other rows hand over.
    #[test]
    fn rows_have_the_shares_of_the_file() {
        let shares = vec![1.0, 5.0, 0.25, 2.0, 0.0625, 1.75, 9.0];
        let all: f64 = shares.iter().sum();
        let group = RayGroup {
            wavelength: None,
            positions: vec![[0.0; 3]; shares.len()],
            directions: vec![[0.0, 0.0, 1.0]; shares.len()],
            shares: shares.clone(),
        };
        let rows = group.rows();
        let mut found = vec![0.0; shares.len()];
        for (i, row) in rows.chunks(8).enumerate() {
            assert!((0.0..=1.0).contains(&row[0]), "{row:?}");
            found[i] += row[0];
            found[row[1] as usize] += 1.0 - row[0];
        }
        for (found, share) in found.iter().zip(&shares) {
            let expected = share / all * shares.len() as f64;
            assert!((found - expected).abs() < 1e-12, "{found} and {expected}");
        }
    }
}
