//! Detectors: the list of them, and what each must say of itself.
//!
//! Each detector stands in one file here. Its function stands in one file of shaders/detectors/, and its result in one
//! file of src/result/detectors/. docs/adding-a-kind.md says how to add one. A detector is the plane z = 0 of its own
//! frame. Lengths are in mm, angles in rad.

pub mod apart;
pub mod far_field;
pub mod grid;
pub mod irradiance;
pub mod ray_database;
pub mod spectral;

pub use crate::model::detectors::apart::Apart;
pub use crate::model::detectors::far_field::{FAR_FIELD_RADIUS, FarField};
pub use crate::model::detectors::ray_database::RayDatabase;
pub use crate::model::detectors::spectral::Spectral;

use crate::Result;
use crate::model::detectors::grid::{ArrivalError, GridRow, PixelGrid};
use crate::model::list::kinds;
use crate::model::shapes::Outline;
use crate::model::written::CoordinateSystem;
use crate::shaders::ShaderFile;

kinds! {
    DetectorKind: Detection,
    functions DetectorFunction: DetectorWgsl,
    /// A detector, by its `type`.
    written "Detector": WrittenDetector;
    /// Flux over pixels.
    Irradiance(irradiance::PixelGrid) by Irradiance = IRRADIANCE;
    /// Flux over pixels and wavelengths.
    Spectral(spectral::Spectral) by Spectral = SPECTRAL;
    /// Flux over directions.
    FarField(far_field::FarField) by FarField = FAR_FIELD, FarFieldSphere(5) = FAR_FIELD_SPHERE;
    /// Every ray.
    RayDatabase(ray_database::RayDatabase) by RayDatabase(3) = RAY_DATABASE;
    unwritten {
        /// Light of each wavelength kept apart.
        Apart(apart::Apart) by ApartFarField = APART_FAR_FIELD, ApartSphere(6) = APART_SPHERE;
    }
}

/// Makes what scene files have of a detector: the keys of all detectors around its own.
macro_rules! written {
    (
        $(#[$attribute:meta])*
        pub struct $name:ident {
            $($(#[$key_attribute:meta])* pub $key:ident: $type:ty,)*
        }
    ) => {
        #[derive(Debug, Clone, PartialEq, serde::Deserialize, schemars::JsonSchema)]
        #[serde(deny_unknown_fields)]
        $(#[$attribute])*
        pub struct $name {
            /// Unique name.
            pub name: String,
            /// Position and orientation.
            pub cs: $crate::model::written::CoordinateSystem,
            $($(#[$key_attribute])* pub $key: $type,)*
            /// Whether a hit ends the ray.
            #[serde(default = "crate::model::detectors::default_absorb")]
            pub absorb: bool,
        }

        impl $crate::model::detectors::HasShared for $name {
            fn shared(&self) -> $crate::model::detectors::Shared<'_> {
                let $name { name, cs, absorb, .. } = self;
                $crate::model::detectors::Shared { name, cs, absorb: *absorb }
            }
        }
    };
}
use written;

/// What the shaders have of a detector.
#[derive(Debug)]
pub struct DetectorWgsl {
    /// The name of the kind, in scene files and results as well. Its function is
    /// `record_<name>(ray: Ray, detector: Detector, ends: bool)`; of one that stores rays, `index: u32` precedes `ends`.
    pub name: &'static str,
    /// The file that holds it.
    pub file: ShaderFile,
    /// What it writes.
    pub records: Records,
}

/// What a detector's function writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Records {
    /// Sums alone.
    Cells,
    /// Sums, in the bin of the ray's wavelength.
    Bins,
    /// A row for the host, and one sum.
    Rays,
}

/// What the program, the predictions, the checks of scenes and the viewer ask of a detector.
pub trait Detection: std::fmt::Debug {
    /// The function that records on it.
    fn function(&self) -> DetectorFunction;

    /// The outline of its plane.
    fn outline(&self) -> Outline;

    /// How many sums it keeps, such as pixels times wavelength bins; none if it stores rays. They stand in C order, the
    /// wavelength bin last.
    fn num_cells(&self) -> usize;

    /// The same detector with one cell, or with the bins of one pixel.
    fn with_single_cell(&self) -> DetectorKind;

    /// Its cells as the shaders have them.
    fn grid_row(&self) -> GridRow;

    /// Its pixels, if it has any.
    fn grid(&self) -> Option<&PixelGrid> {
        None
    }

    /// True if each pixel is one cell, which follows from a ray's position alone.
    fn is_plain_grid(&self) -> bool {
        false
    }

    /// Wavelength bins of a pixel.
    fn num_bins(&self) -> u32 {
        1
    }

    /// The bin of a wavelength \[um\].
    fn bin(&self, _wavelength: f64) -> u32 {
        0
    }

    /// How many cells away a ray may arrive, if such errors show in what it records.
    fn cells_off(&self, _error: &ArrivalError) -> Option<f64> {
        None
    }

    /// How many rays it keeps, the last ones, if it stores rays and there is a limit.
    fn max_rays(&self) -> Option<u64> {
        None
    }

    /// True if it stands somewhere, and pictures of the scene show it.
    fn is_placed(&self) -> bool {
        true
    }
}

impl DetectorKind {
    /// True if it stores the rays that it records.
    pub fn stores_rays(&self) -> bool {
        self.function().stores_rays()
    }

    /// A detector in its place that stores all rays that it records.
    pub(crate) fn as_ray_database(&self) -> DetectorKind {
        let [width, height] = match self.outline() {
            Outline::Rectangle { width, height } => [width, height],
            Outline::Disk { radius } => [2.0 * radius; 2],
            Outline::Infinite => [f64::INFINITY; 2],
        };
        DetectorKind::RayDatabase(RayDatabase { width, height, max_rays: None })
    }
}

impl DetectorFunction {
    /// The name of the kind, in the shaders, in scene files and in results.
    pub fn name(self) -> &'static str {
        self.wgsl().name
    }

    /// True if it stores the rays that it records.
    pub fn stores_rays(self) -> bool {
        self.wgsl().records == Records::Rays
    }

    /// True if it reads the table of wavelength bins.
    pub fn reads_bins(self) -> bool {
        self.wgsl().records == Records::Bins
    }
}

/// What all detectors of scene files have.
pub struct Shared<'a> {
    name: &'a str,
    cs: &'a CoordinateSystem,
    absorb: bool,
}

/// What `written` gives to each file's `Written`.
pub trait HasShared {
    /// The keys of all detectors.
    fn shared(&self) -> Shared<'_>;
}

/// What each file's `Written` does: the numbers of a detector as scene files have them.
pub trait WrittenDetector: HasShared {
    /// Refuses numbers that no detector has. `at` gives the place of a key.
    ///
    /// # Errors
    /// [`crate::Error::Scene`] with the place and a remedy.
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()>;

    /// How many sums it would keep, if they can be counted.
    fn num_cells(&self) -> Option<u64>;

    /// The detector, with what the block says of it.
    fn kind(&self, extra: Option<&DetectorExtra>) -> DetectorKind;

    /// The wavelengths that its bins span \[um\], if it has bins.
    fn band(&self) -> Option<[f64; 2]> {
        None
    }

    /// True if colour is asked of it.
    fn sees_color(&self) -> bool {
        false
    }
}

/// What a detector sees colour in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize, schemars::JsonSchema)]
pub enum ColorSpace {
    /// X, Y and Z of the CIE 1931 observer of 2 degrees.
    #[serde(rename = "xyz")]
    Xyz,
}

impl Written {
    /// The user's name for it.
    pub fn name(&self) -> &str {
        self.entry().shared().name
    }

    /// Position and orientation.
    pub fn cs(&self) -> &CoordinateSystem {
        self.entry().shared().cs
    }

    /// Whether a hit ends the ray.
    pub fn absorb(&self) -> bool {
        self.entry().shared().absorb
    }

    /// True if it stores the rays that it records, whose number may be limited.
    pub fn stores_rays(&self) -> bool {
        self.entry().kind(None).stores_rays()
    }
}

impl std::ops::Deref for Written {
    type Target = dyn WrittenDetector;

    fn deref(&self) -> &Self::Target {
        self.entry()
    }
}

/// Additions to a detector.
#[derive(Debug, Clone, Default, PartialEq, serde::Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DetectorExtra {
    /// Ray database: keep only the last so many rays; 0 or null for all.
    pub max_rays: Option<u64>,
}

/// A detector ends the rays that it records, unless a scene file says otherwise.
fn default_absorb() -> bool {
    true
}
