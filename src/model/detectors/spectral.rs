//! Flux over pixels and wavelength bins.

use crate::Result;
use crate::model::checks;
use crate::model::detectors::grid::{self, ArrivalError, GridRow, PixelGrid, SplatKind};
use crate::model::detectors::{
    Detection, DetectorExtra, DetectorFunction, DetectorKind, DetectorWgsl, Records, WrittenDetector, written,
};
use crate::model::shapes::Outline;
use crate::shaders::shader;

/// Its function, which deposits into the pixels of the wavelength's bin.
pub const SPECTRAL: DetectorWgsl =
    DetectorWgsl { name: "spectral", file: shader!("detectors/spectral.wgsl"), records: Records::Bins };

/// Ends of a band above are nanometres by mistake \[um\]; Optiland's limit.
const MAX_BAND: f64 = 100.0;

/// Flux over pixels and wavelength bins.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectral {
    /// The pixels.
    pub grid: PixelGrid,
    /// Bin edges, ascending \[um\]; wavelengths outside are counted in the end bins.
    pub wavelength_edges: Vec<f64>,
}

written! {
    /// Flux over pixels and wavelengths.
    #[schemars(rename = "SpectralDetector")]
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
        /// Lower end of the first bin \[um\], which also counts what is shorter.
        #[serde(default = "violet")]
        pub wl_min: f64,
        /// Upper end of the last bin \[um\], which also counts what is longer.
        #[serde(default = "red")]
        pub wl_max: f64,
        /// Wavelength bins.
        #[serde(default = "hundred")]
        pub num_bins: u32,
        /// How flux is spread over pixels.
        #[serde(default)]
        pub splat: SplatKind,
        /// Standard deviation of a Gaussian splat \[pixels\]; 0 for none.
        #[serde(default = "grid::default_sigma")]
        pub splat_sigma: f64,
    }
}

impl WrittenDetector for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        grid::check_rectangle(at, self.width, self.height)?;
        grid::check_count(at("num_pixels_x"), self.num_pixels_x)?;
        grid::check_count(at("num_pixels_y"), self.num_pixels_y)?;
        grid::check_count(at("num_bins"), self.num_bins)?;
        check_band_end(at("wl_min"), self.wl_min)?;
        check_band_end(at("wl_max"), self.wl_max)?;
        if self.wl_min >= self.wl_max {
            let problem = format!("wl_max = {} um is not above wl_min = {} um", self.wl_max, self.wl_min);
            return checks::refuse(at("wl_max"), problem, "give wl_min < wl_max");
        }
        self.splat.check(at, self.splat_sigma)
    }

    fn num_cells(&self) -> Option<u64> {
        grid::product(&[self.num_pixels_x, self.num_pixels_y, self.num_bins])
    }

    fn band(&self) -> Option<[f64; 2]> {
        Some([self.wl_min, self.wl_max])
    }

    fn kind(&self, _: Option<&DetectorExtra>) -> DetectorKind {
        let grid = PixelGrid {
            width: self.width,
            height: self.height,
            num_pixels_x: self.num_pixels_x,
            num_pixels_y: self.num_pixels_y,
            splat: self.splat.of_width(self.splat_sigma),
        };
        let wavelength_edges = edges(self.wl_min, self.wl_max, self.num_bins);
        DetectorKind::Spectral(Spectral { grid, wavelength_edges })
    }
}

/// The end of a band \[um\]: it may lie beyond every wavelength.
fn check_band_end(place: String, value: f64) -> Result<()> {
    if value > MAX_BAND && value.is_finite() {
        let remedy = format!("if these are nanometres, divide by 1000: {}", value / 1000.0);
        return checks::refuse(place, format!("{value} um is above {MAX_BAND} um"), remedy);
    }
    checks::between(place, value, 0.0, MAX_BAND)
}

/// Bin edges by the arithmetic of `numpy.linspace`, so that a wavelength on an edge falls as it does in Optiland.
fn edges(start: f64, stop: f64, bins: u32) -> Vec<f64> {
    let step = (stop - start) / f64::from(bins);
    let mut edges: Vec<f64> = (0..=bins).map(|i| f64::from(i) * step + start).collect();
    if let Some(last) = edges.last_mut() {
        *last = stop;
    }
    edges
}

fn violet() -> f64 {
    0.4
}

fn red() -> f64 {
    0.7
}

fn hundred() -> u32 {
    100
}

impl Detection for Spectral {
    fn function(&self) -> DetectorFunction {
        DetectorFunction::Spectral
    }

    fn outline(&self) -> Outline {
        Outline::Rectangle { width: self.grid.width, height: self.grid.height }
    }

    fn num_cells(&self) -> usize {
        self.grid.num_pixels() * (self.wavelength_edges.len() - 1)
    }

    fn with_single_cell(&self) -> DetectorKind {
        let grid = self.grid.with_single_pixel();
        DetectorKind::Spectral(Spectral { grid, wavelength_edges: self.wavelength_edges.clone() })
    }

    fn grid_row(&self) -> GridRow {
        self.grid.row()
    }

    fn grid(&self) -> Option<&PixelGrid> {
        Some(&self.grid)
    }

    fn num_bins(&self) -> u32 {
        self.wavelength_edges.len() as u32 - 1
    }

    /// Optiland's `searchsorted(edges, wavelength, "right") - 1`, clamped.
    fn bin(&self, wavelength: f64) -> u32 {
        let above = self.wavelength_edges.partition_point(|edge| *edge <= wavelength);
        above.saturating_sub(1).min(self.wavelength_edges.len() - 2) as u32
    }

    fn cells_off(&self, error: &ArrivalError) -> Option<f64> {
        Some(self.grid.pixels_off(error))
    }
}
