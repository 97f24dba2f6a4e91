//! Every ray that crosses a rectangle.

use crate::Result;
use crate::model::detectors::grid::{self, GridRow};
use crate::model::detectors::{
    Detection, DetectorExtra, DetectorFunction, DetectorKind, DetectorWgsl, Records, WrittenDetector, written,
};
use crate::model::shapes::Outline;
use crate::shaders::shader;

/// Its function, which appends a row.
pub const RAY_DATABASE: DetectorWgsl = DetectorWgsl {
    name: "ray_database",
    file: shader!("detectors/ray_database.wgsl"),
    records: Records::Rays,
};

/// Every ray that crosses a rectangle, in global coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayDatabase {
    /// Full width along local x \[mm\].
    pub width: f64,
    /// Full height along local y \[mm\].
    pub height: f64,
    /// Keep only the last so many rows.
    pub max_rays: Option<u64>,
}

written! {
    /// Every ray through a rectangle.
    #[schemars(rename = "RayDatabaseDetector")]
    pub struct Written {
        /// Full width \[mm\].
        pub width: f64,
        /// Full height \[mm\].
        pub height: f64,
    }
}

impl WrittenDetector for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        grid::check_rectangle(at, self.width, self.height)
    }

    fn num_cells(&self) -> Option<u64> {
        Some(0)
    }

    fn kind(&self, extra: Option<&DetectorExtra>) -> DetectorKind {
        // Optiland's 0 stands for no limit.
        let max_rays = extra.and_then(|extra| extra.max_rays).filter(|limit| *limit > 0);
        DetectorKind::RayDatabase(RayDatabase { width: self.width, height: self.height, max_rays })
    }
}

impl Detection for RayDatabase {
    fn function(&self) -> DetectorFunction {
        DetectorFunction::RayDatabase
    }

    fn outline(&self) -> Outline {
        Outline::Rectangle { width: self.width, height: self.height }
    }

    fn num_cells(&self) -> usize {
        0
    }

    fn with_single_cell(&self) -> DetectorKind {
        DetectorKind::RayDatabase(*self)
    }

    fn grid_row(&self) -> GridRow {
        GridRow {
            half_width: self.width / 2.0,
            half_height: self.height / 2.0,
            pitch_x: self.width,
            pitch_y: self.height,
            num_x: 1,
            num_y: 1,
        }
    }

    fn max_rays(&self) -> Option<u64> {
        self.max_rays
    }
}
