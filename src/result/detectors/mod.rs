//! What detectors recorded: the list of kinds, and what each must say of its result.
//!
//! Each kind stands in one file here, beside the detector in src/model/detectors/. Writers, readers and comparisons ask
//! [`DetectorResult`]; they know no kind.

pub(crate) mod bins;
pub mod far_field;
pub mod irradiance;
pub mod ray_database;
pub mod spectral;

pub use crate::result::detectors::far_field::FarFieldPattern;
pub use crate::result::detectors::irradiance::IrradianceMap;
pub use crate::result::detectors::ray_database::{RayColumns, RayDatabase};
pub use crate::result::detectors::spectral::SpectralMap;

use crate::error::{Error, Result};
use crate::model::{self, DetectorFunction, DetectorKind};
use crate::result::luminous::Luminous;
use crate::result::npz::ArrayWriter;
pub(crate) use crate::result::png::charts::Span;
use crate::result::png::charts::{Drawn, Head};
use crate::result::ray_rows::Rows;
use crate::result::stored::Stored;
use crate::result::{DetectorTally, FluxUnit, Uncertainty};
use ndarray::{Array, ArrayViewD, Dimension};
use serde_json::Value;
use std::path::Path;
use std::sync::Arc;

/// Makes `DetectorData` of the list: how a result is made of sums, how it is read back, and what it says of itself.
macro_rules! list {
    ($($(#[doc = $doc:literal])+ $name:ident($file:ident::$type:ident);)+) => {
        /// A recording, by kind of detector.
        #[derive(Debug, Clone, PartialEq)]
        pub enum DetectorData {
            $($(#[doc = $doc])+ $name($file::$type),)+
        }

        impl DetectorData {
            /// What a detector's sums and rows say.
            pub(crate) fn new(sums: &Sums<'_>) -> Result<Self> {
                match &sums.detector.kind {
                    $(DetectorKind::$name(kind) => $file::$type::new(kind, sums).map(DetectorData::$name),)+
                    DetectorKind::Apart(_) => {
                        Err(Error::Internal("a result is made before its wavelengths are added up".into()))
                    }
                }
            }

            /// What a folder of results holds of a detector. `None` if `kind` is unknown.
            pub(crate) fn read(kind: &str, stored: Stored) -> Result<Option<Self>> {
                $(if kind == DetectorFunction::$name.name() {
                    return $file::$type::read(stored).map(|read| Some(DetectorData::$name(read)));
                })+
                Ok(None)
            }

            fn function(&self) -> DetectorFunction {
                match self {
                    $(DetectorData::$name(_) => DetectorFunction::$name,)+
                }
            }

            /// What the kind says of it.
            pub(crate) fn result(&self) -> &dyn DetectorResult {
                match self {
                    $(DetectorData::$name(result) => result,)+
                }
            }
        }
    };
}

list! {
    /// Flux per area.
    Irradiance(irradiance::IrradianceMap);
    /// Flux per area and wavelength bin.
    Spectral(spectral::SpectralMap);
    /// Flux per solid angle.
    FarField(far_field::FarFieldPattern);
    /// Rays.
    RayDatabase(ray_database::RayDatabase);
}

/// What a result is made of.
pub(crate) struct Sums<'a> {
    /// The detector.
    pub detector: &'a model::Detector,
    /// Its cells.
    pub cells: &'a DetectorTally,
    /// The rays that it kept, if it stores rays.
    pub rows: Option<&'a Arc<Rows>>,
    /// What a weight is in watts.
    pub unit: FluxUnit,
    /// Where standard errors come from.
    pub uncertainty: &'a Uncertainty,
    /// Wavelengths of the scene \[um\].
    pub wavelengths: &'a [f64],
}

/// What writers, comparisons, diagnostics and the viewer ask of a result.
pub(crate) trait DetectorResult {
    /// Its cells; none if it stores rays, of which then nothing is known but their sum.
    fn map(&self) -> Option<CellMap<'_>>;

    /// Adds its arrays to an `.npz` file.
    fn write(&self, file: &mut ArrayWriter) -> Result<()>;

    /// Units of the arrays in the file, of its totals as well.
    fn units(&self) -> &'static [(&'static str, &'static str)];

    /// Draws it to a `.png` file.
    fn picture(&self, path: &Path, head: &Head) -> Drawn;

    /// What its entry of the report has beside the keys of every detector.
    fn entry(&self) -> Vec<(&'static str, Value)> {
        Vec::new()
    }

    /// Cells, or rows.
    fn num_items(&self) -> u64 {
        self.map().map_or(0, |map| map.values.len() as u64)
    }

    /// Flux of what it kept, if it dropped a part \[W\].
    fn kept_flux(&self) -> Option<f64> {
        None
    }

    /// Flux of all that it recorded, if it may have dropped a part \[W\].
    fn recorded_flux(&self) -> Option<f64> {
        None
    }

    /// True if it records wavelengths, so that watts become lumens without asking for a wavelength.
    fn tells_wavelengths(&self) -> bool {
        false
    }

    /// What should be read with care in it. `name` is the detector's as it is shown.
    fn warning(&self, _name: &str, _num_rays_hit: u64) -> Option<String> {
        None
    }
}

/// Values, their errors and hits, cell by cell. The first two indices are rows and columns.
pub(crate) struct CellMap<'a> {
    /// What users read.
    pub values: ArrayViewD<'a, f64>,
    /// Its standard errors, where they are known.
    pub errors: Option<ArrayViewD<'a, f64>>,
    /// Rays.
    pub hits: ArrayViewD<'a, u64>,
    /// Sizes of the cells of each row: flux over value.
    pub sizes: Vec<f64>,
    /// True if all cells have one size.
    pub are_alike: bool,
    /// What the columns span.
    pub x: Span,
    /// What the rows span.
    pub y: Span,
    /// What the values are, and their unit.
    pub quantity: (&'static str, &'static str),
}

impl<'a> CellMap<'a> {
    /// Irradiance over a rectangle of pixels, width and height \[mm\].
    pub(crate) fn of_pixels<D: Dimension>(
        (width, height): (f64, f64),
        values: &'a Array<f64, D>,
        errors: Option<&'a Array<f64, D>>,
        hits: &'a Array<u64, D>,
    ) -> Self {
        let (ny, nx) = (values.shape()[0], values.shape()[1]);
        let span = |name, size: f64| Span { label: (name, "mm"), range: (-size / 2.0, size / 2.0) };
        CellMap {
            values: values.view().into_dyn(),
            errors: errors.map(|errors| errors.view().into_dyn()),
            hits: hits.view().into_dyn(),
            sizes: vec![width * height / (nx * ny) as f64; ny],
            are_alike: true,
            x: span("x", width),
            y: span("y", height),
            quantity: ("Irradiance", "W/mm²"),
        }
    }

    /// The same cells with what the eye saw in them.
    pub(crate) fn in_units_of(self, seen: &'a Luminous) -> Self {
        let quantity = seen.quantity();
        let sizes = self.sizes.iter().map(|size| size / seen.per_size()).collect();
        let (values, errors) = (seen.map.view(), seen.standard_error.as_ref().map(|errors| errors.view()));
        CellMap { values, errors, sizes, are_alike: false, quantity, ..self }
    }

    /// Rows times columns. Wavelength bins do not count, as in Optiland's diagnostics.
    pub(crate) fn num_pixels(&self) -> u64 {
        self.values.shape().iter().take(2).product::<usize>() as u64
    }
}

impl DetectorData {
    /// Optiland's name of the kind.
    pub fn kind(&self) -> &'static str {
        self.function().name()
    }

    /// Pixels, or directions; none for a ray database. Wavelength bins do not count, as in Optiland's diagnostics.
    pub fn num_pixels(&self) -> Option<u64> {
        self.result().map().map(|map| map.num_pixels())
    }
}
