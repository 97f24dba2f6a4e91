//! Flux over a rectangle of pixels.

pub use crate::model::detectors::grid::PixelGrid;

use crate::Result;
use crate::model::detectors::grid::{self, ArrivalError, GridRow, SplatKind};
use crate::model::detectors::{
    ColorSpace, Detection, DetectorExtra, DetectorFunction, DetectorKind, DetectorWgsl, Records,
    WrittenDetector, written,
};
use crate::model::shapes::Outline;
use crate::shaders::shader;

/// Its function, which deposits into pixels.
pub const IRRADIANCE: DetectorWgsl =
    DetectorWgsl { name: "irradiance", file: shader!("detectors/irradiance.wgsl"), records: Records::Cells };

written! {
    /// Flux over pixels.
    #[schemars(rename = "IrradianceDetector")]
    pub struct Written {
        /// Full width \[mm\].
        pub width: f64,
        /// Full height \[mm\].
        pub height: f64,
        /// Pixels along x.
        #[serde(default = "grid::default_pixels")]
        pub num_pixels_x: u32,
        /// Pixels along y.
        #[serde(default = "grid::default_pixels")]
        pub num_pixels_y: u32,
        /// How flux is spread over pixels.
        #[serde(default)]
        pub splat: SplatKind,
        /// Standard deviation of a Gaussian splat \[pixels\]; 0 for none.
        #[serde(default = "grid::default_sigma")]
        pub splat_sigma: f64,
        /// `xyz`: the detector sees colour, and results are photometric.
        #[serde(default)]
        pub color: Option<ColorSpace>,
    }
}

impl WrittenDetector for Written {
    fn sees_color(&self) -> bool {
        self.color.is_some()
    }

    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        grid::check_rectangle(at, self.width, self.height)?;
        grid::check_count(at("num_pixels_x"), self.num_pixels_x)?;
        grid::check_count(at("num_pixels_y"), self.num_pixels_y)?;
        self.splat.check(at, self.splat_sigma)
    }

    fn num_cells(&self) -> Option<u64> {
        grid::product(&[self.num_pixels_x, self.num_pixels_y])
    }

    fn kind(&self, _: Option<&DetectorExtra>) -> DetectorKind {
        DetectorKind::Irradiance(PixelGrid {
            width: self.width,
            height: self.height,
            num_pixels_x: self.num_pixels_x,
            num_pixels_y: self.num_pixels_y,
            splat: self.splat.of_width(self.splat_sigma),
        })
    }
}

impl Detection for PixelGrid {
    fn function(&self) -> DetectorFunction {
        DetectorFunction::Irradiance
    }

    fn outline(&self) -> Outline {
        Outline::Rectangle { width: self.width, height: self.height }
    }

    fn num_cells(&self) -> usize {
        self.num_pixels()
    }

    fn with_single_cell(&self) -> DetectorKind {
        DetectorKind::Irradiance(self.with_single_pixel())
    }

    fn grid_row(&self) -> GridRow {
        self.row()
    }

    fn grid(&self) -> Option<&PixelGrid> {
        Some(self)
    }

    fn is_plain_grid(&self) -> bool {
        true
    }

    fn cells_off(&self, error: &ArrivalError) -> Option<f64> {
        Some(self.pixels_off(error))
    }
}
