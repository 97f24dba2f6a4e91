//! The settings that the viewer keeps between starts.

use crate::folders::Folder;
use crate::result::picture::scale::{ColorMap, ScaleKind};
use crate::viewer::two_results::ComparisonMode;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The user's choices.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Settings {
    /// True: dark. False: light.
    pub dark: bool,
    /// How values become colours.
    pub scale: ScaleKind,
    /// Where the percentile scale ends \[%\].
    pub percentile: f64,
    /// Colours.
    pub color_map: ColorMap,
    /// True if A and B share one scale.
    pub common_scale: bool,
    /// What is shown of two results.
    #[serde(skip)]
    pub comparison: ComparisonMode,
    /// True: lumens. False: watts.
    pub photometric: bool,
    /// True: far field as a disc. False: with azimuth and polar angle as axes.
    pub polar: bool,
    /// True: rays of a database by direction. False: by place.
    pub directions: bool,
    /// What dragging does.
    pub tool: Tool,
    /// Colour of the rays of the side view.
    pub ray_color: RayColor,
    /// Plane of the side view.
    pub plane: Plane,
    /// Size of the window \[points\].
    pub window: (f32, f32),
}

/// What dragging in a plot does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Tool {
    /// Moves the view.
    Pan,
    /// Draws a line whose values are shown below.
    Profile,
    /// Draws a rectangle.
    Rectangle,
    /// Draws an ellipse.
    Ellipse,
}

/// What the colour of a ray shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum RayColor {
    /// The ray's number of events.
    Bounce,
    /// The ray's flux.
    Flux,
}

/// Plane of the side view: the horizontal axis, then the vertical one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names of the axes say it")]
pub enum Plane {
    ZY,
    ZX,
    XY,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            dark: true,
            scale: ScaleKind::Linear,
            percentile: 99.0,
            color_map: ColorMap::Inferno,
            common_scale: true,
            comparison: ComparisonMode::A,
            photometric: false,
            polar: true,
            directions: false,
            tool: Tool::Pan,
            ray_color: RayColor::Bounce,
            plane: Plane::ZY,
            window: (1440.0, 900.0),
        }
    }
}

impl Settings {
    /// The settings of the last time; the defaults if none can be read.
    pub fn load() -> Self {
        let text = Self::path().and_then(|path| std::fs::read_to_string(path).ok());
        text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default()
    }

    /// Saves the settings for the next start. If that fails, the next start has the defaults, without a complaint.
    pub fn save(&self) {
        let (Some(path), Ok(text)) = (Self::path(), serde_json::to_string_pretty(self)) else {
            return;
        };
        if let Some(folder) = path.parent() {
            let _ = std::fs::create_dir_all(folder);
        }
        let _ = std::fs::write(path, text);
    }

    fn path() -> Option<PathBuf> {
        Folder::Settings.path().map(|folder| folder.join("viewer.json"))
    }
}

impl Tool {
    /// All tools, with their names and keys.
    pub const ALL: [(Tool, &'static str, eframe::egui::Key); 4] = [
        (Tool::Pan, "Pan", eframe::egui::Key::P),
        (Tool::Profile, "Profile", eframe::egui::Key::L),
        (Tool::Rectangle, "Rectangle", eframe::egui::Key::R),
        (Tool::Ellipse, "Ellipse", eframe::egui::Key::E),
    ];
}

impl Plane {
    /// All planes, in the order of the menu.
    pub const ALL: [(Plane, &'static str); 3] = [(Plane::ZY, "z–y"), (Plane::ZX, "z–x"), (Plane::XY, "x–y")];

    /// Horizontal and vertical coordinate of a point.
    pub fn project(self, point: glam::DVec3) -> (f64, f64) {
        match self {
            Plane::ZY => (point.z, point.y),
            Plane::ZX => (point.z, point.x),
            Plane::XY => (point.x, point.y),
        }
    }

    /// Names of the axes.
    pub fn axes(self) -> (&'static str, &'static str) {
        match self {
            Plane::ZY => ("z", "y"),
            Plane::ZX => ("z", "x"),
            Plane::XY => ("x", "y"),
        }
    }
}
