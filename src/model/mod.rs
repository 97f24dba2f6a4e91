//! The scene as the tracer sees it: flat surfaces, media, sources and detectors, with Optiland's names for each kind.
//!
//! Lengths are in mm, wavelengths in um, flux in W, angles in rad. A [`Frame`] maps local to global coordinates. The
//! origin of the global frame is where the user put it; the program re-centres the scene later, in f64. Everything that
//! depends on the wavelength is a table over [`SceneIr::wavelengths`], because a source's spectrum is a list of
//! discrete wavelengths.
//!
//! The model also holds how scene files write each kind, so that a new kind is one file here. The type `Written` of a
//! kind is what serde reads, and gives the kind's part of the JSON schema. [`written`] has what many entries share.

pub mod bsdfs;
pub(crate) mod checks;
mod coating;
mod coefficient_rows;
pub mod color;
pub mod depth;
pub mod detectors;
pub mod double_word;
pub mod guide;
pub(crate) mod key_path;
mod list;
pub(crate) mod mesh;
pub mod path_filter;
pub mod photometry;
pub(crate) mod polar_table;
mod precision;
pub mod primitives;
pub mod ray_id;
pub mod scatter_sampling;
pub mod sequence;
pub mod shapes;
pub mod sides;
pub mod sources;
pub mod surface_optics;
pub(crate) mod whole_files;
pub mod written;

pub use crate::model::bsdfs::{
    Bsdf, BsdfKind, BsdfTable, HarveyShack, KCorrelation, Lambertian, Measured, MeasuredRow, MeasuredTable,
    Scatter, Specular, Tabulated,
};
pub use crate::model::coating::{Coating, CoatingRow, SimpleCoating, TabulatedCoating};
pub use crate::model::detectors::grid::{PixelGrid, Splat};
pub use crate::model::detectors::{
    Apart, Detection, DetectorFunction, DetectorKind, FAR_FIELD_RADIUS, FarField, RayDatabase, Spectral,
};
pub use crate::model::mesh::{Mesh, area_vector, unit_normal};
pub use crate::model::path_filter::PathFilter;
pub use crate::model::polar_table::PolarTable;
pub use crate::model::precision::Precision;
pub use crate::model::scatter_sampling::ScatterSampling;
pub use crate::model::sequence::{End, Sequence, SequenceKey, Step, StepKind};
pub use crate::model::shapes::{
    Annulus, Aperture, AsphereProfile, ClippedConic, Conic, Frustum, MeshId, Outline, Shape, ShapeKind,
    Sphere,
};
pub use crate::model::sources::{Collimated, Extended, Point, Pupil, SourceFunction, SourceKind};
use glam::{DMat3, DVec3};

/// Index into [`SceneIr::media`].
pub type MediumId = usize;

/// A proven-valid scene, lowered to what a ray can meet. Defaults are filled in, frames are global, components are
/// surfaces, and media are tables.
///
/// IR is short for intermediate representation: it stands between the scene of a file and the program of a device.
/// Variables of this type are called `ir`.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneIr {
    /// Every wavelength that some source emits, ascending and distinct \[um\].
    pub wavelengths: Vec<f64>,
    /// Media; index 0 is vacuum.
    pub media: Vec<Medium>,
    /// Surfaces in list order: of two hit at the same distance, the first wins.
    pub surfaces: Vec<Surface>,
    /// Triangle meshes, each once, however often it is placed.
    pub meshes: Vec<Mesh>,
    /// Sources in list order: rays are numbered across them in this order.
    pub sources: Vec<Source>,
    /// Detectors in list order; a surface at the same distance wins over a detector.
    pub detectors: Vec<Detector>,
    /// How rare branches are sampled.
    pub sampling: Sampling,
    /// How scattering is drawn on purpose, surface by surface. Empty where scattering is drawn by BSDFs alone.
    pub scatter_sampling: Vec<ScatterSampling>,
    /// What shaders must allow for beyond what the scene shows.
    pub allowed: Allowance,
}

/// What shaders allow for although the scene does not show it: a derivative by an angle turns a frame that is not turned.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Allowance {
    /// Every frame may be turned.
    pub turned: bool,
    /// Every medium may absorb.
    pub absorbing: bool,
    /// Every sphere may become another conic.
    pub conic: bool,
}

impl SceneIr {
    /// The name of a surface: Optiland's label, such as `L1.front`; `component_3` if it has none.
    pub fn surface_name(&self, surface: usize) -> String {
        match self.surfaces[surface].name.as_str() {
            "" => format!("component_{surface}"),
            name => name.to_string(),
        }
    }

    /// The flux that all sources emit \[W\].
    pub fn emitted_flux(&self) -> f64 {
        self.sources.iter().map(|source| source.total_flux).sum()
    }
}

/// A local coordinate system: `global = rotation * local + origin`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Origin in global coordinates \[mm\].
    pub origin: DVec3,
    /// Rotation whose columns are the local axes in global coordinates.
    pub rotation: DMat3,
}

impl Frame {
    /// The frame as seen from a point, as the device has it.
    pub fn relative_to(self, centre: DVec3) -> Frame {
        Frame { origin: self.origin - centre, ..self }
    }
}

/// A homogeneous medium.
#[derive(Debug, Clone, PartialEq)]
pub struct Medium {
    /// What messages call it.
    pub name: String,
    /// True for vacuum only: a ray that enters it has left every solid.
    pub ambient: bool,
    /// Refractive index per wavelength of the scene.
    pub n: Vec<f64>,
    /// Extinction coefficient per wavelength of the scene.
    pub k: Vec<f64>,
}

impl Medium {
    /// True if it takes from rays of some wavelength.
    pub fn absorbs(&self) -> bool {
        self.k.iter().any(|&k| k != 0.0)
    }
}

/// One surface that a ray can meet.
#[derive(Debug, Clone, PartialEq)]
pub struct Surface {
    /// Optiland's label, such as `L1.front`.
    pub name: String,
    /// The frame of its shape.
    pub frame: Frame,
    /// Its shape, in its frame.
    pub shape: Shape,
    /// What it does to a ray.
    pub interaction: Interaction,
    /// Its coating, if it is refractive; of a mirror, one by angle.
    pub coating: Option<Coating>,
    /// How it scatters, if it does and is not absorbing.
    pub scatter: Option<Scatter>,
    /// Medium on the side that the geometric normal points away from.
    pub front: MediumId,
    /// Medium on the side that the geometric normal points to.
    pub back: MediumId,
}

/// What a surface does to a ray.
#[derive(Debug, Clone, PartialEq)]
pub enum Interaction {
    /// Fresnel reflection or refraction between the media of its two sides.
    Refractive,
    /// Specular reflection.
    Reflective {
        /// Reflectance per wavelength of the scene, in \[0, 1\].
        reflectance: Vec<f64>,
    },
    /// The ray ends here.
    Absorbing,
}

/// A source of rays.
#[derive(Debug, Clone, PartialEq)]
pub struct Source {
    /// The user's name for it.
    pub name: String,
    /// Position and orientation; local +z is the axis.
    pub frame: Frame,
    /// How rays are born.
    pub kind: SourceKind,
    /// Emitted flux \[W\].
    pub total_flux: f64,
    /// Discrete spectrum.
    pub spectrum: Spectrum,
    /// Medium that the rays are born in.
    pub medium: MediumId,
}

/// A discrete spectrum.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    /// Indices into [`SceneIr::wavelengths`], in the user's order.
    pub wavelengths: Vec<usize>,
    /// Cumulative weights, normalised: the last is 1. Wavelength i is drawn when cdf\[i-1\] < u <= cdf\[i\].
    pub cdf: Vec<f64>,
}

/// A detector.
#[derive(Debug, Clone, PartialEq)]
pub struct Detector {
    /// The user's name for it.
    pub name: String,
    /// Position and orientation; the detector is the plane local z = 0.
    pub frame: Frame,
    /// What it records.
    pub kind: DetectorKind,
    /// True if it ends the rays that it records.
    pub absorb: bool,
}

/// How rare branches are sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sampling {
    /// Probability of drawing reflection at a refractive surface.
    pub reflect_prob: ReflectProb,
    /// Russian roulette starts below this fraction of the mean flux of a new ray.
    pub rr_start_flux: f64,
    /// A ray of fewer events than this is split at a refractive surface: both branches are followed. 0: never.
    pub split_depth: u32,
    /// Largest number of split rays alive at once for a launched ray; reflected branches are followed to their ends first.
    /// A fraction, such as 4.3, allows a fifth ray in 30 % of the families.
    pub split_budget: f64,
}

impl Default for Sampling {
    /// Optiland's.
    fn default() -> Self {
        Sampling {
            reflect_prob: ReflectProb::Fresnel,
            rr_start_flux: 1e-3,
            split_depth: 0,
            split_budget: 4.0,
        }
    }
}

impl Sampling {
    /// Largest `split_depth`: each event has its bit in a ray's id.
    pub const MAX_SPLIT_DEPTH: u32 = ray_id::NUMBER_BITS;
}

/// Probability of drawing reflection at a refractive surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ReflectProb {
    /// The Fresnel reflectance R itself.
    Fresnel,
    /// R clipped to \[0.25, 0.75\].
    Auto,
    /// A constant.
    Constant(f64),
}

impl SceneIr {
    /// The medium that is vacuum.
    pub const VACUUM: MediumId = 0;
}

impl Detector {
    /// The outline of the detector's plane.
    pub fn outline(&self) -> Outline {
        self.kind.outline()
    }

    /// How many sums the detector keeps: [`Detection::num_cells`].
    pub fn num_cells(&self) -> usize {
        self.kind.num_cells()
    }
}

impl SceneIr {
    /// The scene with detectors of one cell: a pilot trace, whose paths are all that is looked at, has the same ones.
    pub fn with_single_cells(&self) -> Self {
        let mut ir = self.clone();
        ir.detectors.iter_mut().for_each(|detector| detector.kind = detector.kind.with_single_cell());
        ir
    }

    /// The scene with detectors that store the rays that they record: a pilot trace sees which these are.
    pub fn with_ray_databases(&self) -> Self {
        let mut ir = self.clone();
        ir.detectors.iter_mut().for_each(|detector| detector.kind = detector.kind.as_ray_database());
        ir
    }
}
