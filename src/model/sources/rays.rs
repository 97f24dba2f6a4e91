//! Rays of a file: those that a maker measured of a lamp, or that another trace recorded.
//!
//! A ray of the trace takes one of the file's, drawn by its share of the light. Draws are independent, so that standard errors of
//! the draw hold. The file's own noise is in no standard error.
//!
//! The rays of a small file lie in a table of the shader, which draws from it. A large file stays on its disk: before each
//! dispatch, the host draws the file's rays that the dispatch begins with, and uploads them.

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

/// The function of rays that the host uploads.
pub const STREAMED_RAYS: SourceWgsl =
    SourceWgsl { name: "streamed_rays", file: shader!("sources/streamed_rays.wgsl"), num_steps: 1 };

/// Most rays of a file that are held, all wavelengths together: the shader's table has places for so many.
pub const MOST_RAYS: usize = (1 << 20) - 1;

/// Most rays that the host uploads for a dispatch.
pub const MOST_UPLOADED: u32 = 1 << 18;

/// Numbers of an uploaded ray: the number of its wavelength in the scene or -1, position and direction.
pub const UPLOADED_NUMBERS: usize = 7;

/// Rays of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Rays {
    /// The rays.
    pub set: Arc<FileRays>,
}

/// The rays that a file holds.
#[derive(Clone)]
pub struct FileRays {
    /// The file's hash.
    pub sha256: String,
    /// What lengths were multiplied by.
    pub scale: f64,
    /// Where they are.
    pub rays: RayStorage,
    /// Where they begin, and where they go.
    bounds: Bounds,
}

/// Where the rays of a file are.
#[derive(Clone)]
pub enum RayStorage {
    /// In memory: rays of one wavelength each; or one group, of all wavelengths.
    Held(Vec<RayGroup>),
    /// In the file.
    Streamed(Arc<dyn RayStream>),
}

/// Rays that stay in their file until a dispatch begins with them.
pub trait RayStream: fmt::Debug + Send + Sync {
    /// The file's rays that rays of the trace begin with, one for each id. `draw` gives 64 random bits for an id, which depend on
    /// the seed.
    ///
    /// # Errors
    /// If the file can no longer be read, or is another one by now.
    fn rays(&self, seed: u64, ids: &[u64], draw: &dyn Fn(u64) -> u64) -> Result<Vec<StreamedRay>>;

    /// How rays are taken.
    fn order(&self) -> Order;
}

/// A ray of a file, as a source begins with it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StreamedRay {
    /// Its wavelength, of those that the source lists \[um\]; none if it has none of its own.
    pub wavelength: Option<f64>,
    /// Start point in the source's frame \[mm\].
    pub position: [f64; 3],
    /// Unit direction.
    pub direction: [f64; 3],
}

/// What contains all rays of a file.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Bounds {
    /// The largest distance of a start point from the axis \[mm\].
    radius: f64,
    /// The lowest and the highest start point, or 0 \[mm\].
    heights: [f64; 2],
    /// The largest angle of a direction with the axis \[rad\].
    half_angle: f64,
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

impl Bounds {
    /// Takes in a ray.
    pub fn add(&mut self, [x, y, z]: [f64; 3], [l, m, n]: [f64; 3]) {
        self.radius = self.radius.max(x.hypot(y));
        self.heights = [self.heights[0].min(z), self.heights[1].max(z)];
        self.half_angle = self.half_angle.max(l.hypot(m).atan2(n));
    }
}

impl FileRays {
    /// Rays in memory.
    pub fn held(sha256: String, scale: f64, groups: Vec<RayGroup>) -> Self {
        let mut bounds = Bounds::default();
        for group in &groups {
            group.positions.iter().zip(&group.directions).for_each(|(p, d)| bounds.add(*p, *d));
        }
        FileRays { sha256, scale, rays: RayStorage::Held(groups), bounds }
    }

    /// Rays that stay in their file.
    pub fn streamed(sha256: String, scale: f64, stream: Arc<dyn RayStream>, bounds: Bounds) -> Self {
        FileRays { sha256, scale, rays: RayStorage::Streamed(stream), bounds }
    }
}

/// The file's hash says what the rays are.
impl PartialEq for FileRays {
    fn eq(&self, other: &Self) -> bool {
        let order = |set: &FileRays| match &set.rays {
            RayStorage::Held(_) => Order::Drawn,
            RayStorage::Streamed(stream) => stream.order(),
        };
        (&self.sha256, self.scale, order(self)) == (&other.sha256, other.scale, order(other))
    }
}

impl fmt::Debug for FileRays {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "FileRays({} x {:?}, ", self.sha256, self.scale)?;
        match &self.rays {
            RayStorage::Held(groups) => {
                let groups: Vec<_> =
                    groups.iter().map(|group| (group.wavelength, group.shares.len())).collect();
                write!(f, "{groups:?})")
            }
            RayStorage::Streamed(stream) => write!(f, "{stream:?})"),
        }
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
    /// In their order, and from the first one again after the last. All rays must have the same flux.
    #[serde(rename = "in_order")]
    InOrder,
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
        pub set: Option<Arc<FileRays>>,
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
        let none = || Arc::new(FileRays::held(String::new(), 1.0, Vec::new()));
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
        match &self.set.rays {
            RayStorage::Held(_) => SourceFunction::Rays,
            RayStorage::Streamed(_) => SourceFunction::StreamedRays,
        }
    }

    fn arguments(&self) -> Vec<f64> {
        /// Where there is no table yet.
        const NONE: f64 = -1.0;
        vec![NONE]
    }

    /// For each wavelength of the scene, where its rays begin, counted from here; then each group: the number of its rays, and
    /// their rows. Of rays that are uploaded: room for them.
    fn table(&self, wavelengths: &[f64]) -> Vec<f64> {
        let RayStorage::Held(groups) = &self.set.rays else {
            return vec![0.0; MOST_UPLOADED as usize * UPLOADED_NUMBERS];
        };
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
        Outline::Disk { radius: self.set.bounds.radius }
    }

    fn heights(&self) -> [f64; 2] {
        self.set.bounds.heights
    }

    fn half_angle(&self) -> f64 {
        self.set.bounds.half_angle
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
