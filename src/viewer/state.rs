//! The state of the window: the model, and the user's present actions.

use crate::result::figures::field::Cell;
use crate::result::figures::region::Region;
use crate::result::picture::scale::Palette;
use crate::viewer::model::{Analysis, Model, Picture, Subject};
use crate::viewer::plot::{PlotFrame, View};
use crate::viewer::settings::Plane;
use crate::viewer::spots::Spot;
use eframe::egui::TextureHandle;
use std::collections::HashMap;
use std::sync::Arc;

/// The window over a [`Model`].
pub struct App {
    /// The model that is shown.
    pub model: Model,
    /// Views that the user has moved, by plot.
    pub(super) views: HashMap<String, Option<View>>,
    /// What the cursor reads.
    pub(super) cursor: Option<Cursor>,
    /// What is being dragged.
    pub(super) grab: Option<Grab>,
    /// Frame of the plot in the middle, in the last frame of the window.
    pub(super) frame: Option<PlotFrame>,
    pub(super) painted: Option<Painted>,
    pub(super) figures: Option<CachedFigures>,
    /// Figures with errors, as they were asked for last.
    pub(super) judged: Option<Judged>,
    /// Folder of B, as it is typed.
    pub(super) compare_path: String,
    /// Folder of exports, as it is typed.
    pub(super) export_folder: String,
    /// The rays of the next trace, as they are typed.
    pub(super) num_rays: String,
    /// Number of frames after which the window closes, for tests in a real window.
    pub frames_left: Option<u32>,
}

/// What the cursor reads.
#[derive(Debug, Clone, PartialEq)]
pub struct Cursor {
    /// The place of the cursor.
    pub at: (f64, f64),
    /// The cell, if the plot is a map.
    pub cell: Option<Cell>,
    /// Value, hits and standard error of the cell.
    pub value: Option<(f64, u64, f64)>,
    /// The ray, if the plot shows a database.
    pub spot: Option<Spot>,
    /// True if the cursor stays where the user clicked.
    pub pinned: bool,
}

/// What the pointer holds while it drags in the plot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Grab {
    /// A corner of a region; the other corner is fixed.
    Corner { fixed: (f64, f64) },
    /// A whole region, and the last place of the pointer.
    Region { last: (f64, f64) },
    /// An end of the line.
    End(usize),
    /// The whole line, and the last place of the pointer.
    Line { last: (f64, f64) },
}

/// A picture as a texture, and the inputs of the drawing.
pub(super) struct Painted {
    pub picture: Arc<Picture>,
    pub view: View,
    pub size: [usize; 2],
    pub palette: Palette,
    pub texture: TextureHandle,
}

/// Figures of a region, and the inputs of the computation.
pub(super) struct CachedFigures {
    pub picture: Arc<Picture>,
    pub region: Region,
    pub analysis: Analysis,
}

impl Cursor {
    /// What the cursor reads, to the bit, so that an unknown value equals itself.
    pub(super) fn reads(&self) -> impl PartialEq + use<> {
        let value = self.value.map(|(value, hits, sigma)| (value.to_bits(), hits, sigma.to_bits()));
        (self.at, self.cell, value, self.spot, self.pinned)
    }
}

impl App {
    /// The window of a model.
    pub fn new(model: Model) -> Self {
        App {
            num_rays: model.run.num_rays.to_string(),
            export_folder: ".".into(),
            compare_path: String::new(),
            model,
            views: HashMap::new(),
            cursor: None,
            grab: None,
            frame: None,
            painted: None,
            figures: None,
            judged: None,
            frames_left: None,
        }
    }

    /// Shows a part of the scene from the side \[mm\]. The view grows along one axis until a millimetre is as long along
    /// both.
    pub fn show_side_view(&mut self, plane: Plane, view: View) {
        self.model.subject = Subject::Scene;
        self.model.settings.plane = plane;
        self.views.insert(side_view_key(plane), Some(view));
    }

    /// Sets the folder of exports.
    pub fn set_export_folder(&mut self, folder: &std::path::Path) {
        self.export_folder = folder.display().to_string();
    }

    /// What the cursor reads.
    pub fn cursor(&self) -> Option<&Cursor> {
        self.cursor.as_ref()
    }

    /// The place of the plot in the middle when it was drawn last.
    pub fn frame(&self) -> Option<PlotFrame> {
        self.frame
    }

    /// Figures of the region that is shown, and how its flux is spread around the centroid.
    pub fn region_figures(&mut self) -> Option<Analysis> {
        let picture = self.model.picture().ok()?;
        let Some(region) = self.model.marks().region else {
            return self.model.analysis();
        };
        let cached = self.figures.as_ref();
        if !cached.is_some_and(|cached| Arc::ptr_eq(&cached.picture, &picture) && cached.region == region) {
            let analysis = picture.analysis(Some(region));
            self.figures = Some(CachedFigures { picture, region, analysis });
        }
        self.figures.as_ref().map(|cached| cached.analysis.clone())
    }
}

/// Figures with errors, as text, and what they are of.
pub(super) struct Judged {
    pub detector: String,
    pub region: Option<Region>,
    pub num_rays: u64,
    pub text: String,
}

/// The key of a side view's [`View`].
pub(super) fn side_view_key(plane: Plane) -> String {
    format!("scene {plane:?}")
}
