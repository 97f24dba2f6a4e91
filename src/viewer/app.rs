//! The window: panels around the plot of the detector that is shown.

use crate::viewer::field::Cell;
use crate::viewer::model::{Analysis, Model, Picture, Subject};
use crate::viewer::plot::{Frame, View};
use crate::viewer::region::Region;
use crate::viewer::settings::Tool;
use crate::viewer::spots::Spot;
use crate::viewer::{raster, views};
use eframe::egui::{self, CentralPanel, Key, Modifiers, Panel, TextureHandle, Ui};
use std::collections::HashMap;
use std::sync::Arc;

/// The window over a [`Model`].
pub struct App {
    /// What is shown.
    pub model: Model,
    /// Views that the user has moved, by plot.
    pub(super) views: HashMap<String, Option<View>>,
    /// What the cursor reads.
    pub(super) cursor: Option<Cursor>,
    /// What is being dragged.
    pub(super) grab: Option<Grab>,
    /// Where the plot in the middle was in the last frame.
    pub(super) frame: Option<Frame>,
    pub(super) painted: Option<Painted>,
    pub(super) figures: Option<CachedFigures>,
    /// Folder of B, as it is typed.
    pub(super) compare_path: String,
    /// Folder of exports, as it is typed.
    pub(super) export_folder: String,
    /// The rays of the next trace, as they are typed.
    pub(super) num_rays: String,
    /// The window should be closed after so many frames: for tests in a real window.
    pub frames_left: Option<u32>,
}

/// What the cursor reads.
#[derive(Debug, Clone, PartialEq)]
pub struct Cursor {
    /// Where it is.
    pub at: (f64, f64),
    /// The cell, of a map.
    pub cell: Option<Cell>,
    /// Value, hits and standard error of the cell.
    pub value: Option<(f64, u64, f64)>,
    /// The ray, of a database.
    pub spot: Option<Spot>,
    /// It stays where the user clicked.
    pub pinned: bool,
}

/// What the pointer holds while it drags in the plot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Grab {
    /// A corner of a region; the other one stays.
    Corner { fixed: (f64, f64) },
    /// A whole region: where the pointer was.
    Region { last: (f64, f64) },
    /// An end of the line.
    End(usize),
    /// The whole line: where the pointer was.
    Line { last: (f64, f64) },
}

/// A picture as a texture, and what it was made from.
pub(super) struct Painted {
    pub picture: Arc<Picture>,
    pub view: View,
    pub size: [usize; 2],
    pub colors: raster::Colors,
    pub texture: TextureHandle,
}

/// Figures of a region, and what they were made from.
pub(super) struct CachedFigures {
    pub picture: Arc<Picture>,
    pub region: Region,
    pub analysis: Analysis,
}

impl Cursor {
    /// What it reads, to the bit: a value that is not known equals itself.
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
            frames_left: None,
        }
    }

    /// One frame.
    pub fn ui(&mut self, ui: &mut Ui) {
        self.model.poll();
        let theme = if self.model.settings.dark { egui::Theme::Dark } else { egui::Theme::Light };
        ui.ctx().set_theme(theme);
        self.shortcuts(ui);
        self.dropped_files(ui);
        Panel::top("run").show(ui, |ui| views::run::show(self, ui));
        Panel::left("detectors")
            .default_size(228.0)
            .size_range(190.0..=360.0)
            .show(ui, |ui| views::detectors::show(self, ui));
        Panel::right("figures")
            .default_size(272.0)
            .size_range(240.0..=420.0)
            .show(ui, |ui| views::figures::show(self, ui));
        if matches!(self.model.subject, Subject::Detector(_)) {
            Panel::bottom("curves")
                .resizable(true)
                .default_size(230.0)
                .size_range(140.0..=480.0)
                .show(ui, |ui| views::curves::show(self, ui));
        }
        CentralPanel::default().show(ui, |ui| match &self.model.subject {
            Subject::Scene => views::scene::show(self, ui),
            Subject::Detector(_) => views::detector::show(self, ui),
        });
    }

    /// Where exports go.
    pub fn set_export_folder(&mut self, folder: &std::path::Path) {
        self.export_folder = folder.display().to_string();
    }

    /// What the cursor reads.
    pub fn cursor(&self) -> Option<&Cursor> {
        self.cursor.as_ref()
    }

    /// Where the plot in the middle was drawn last.
    pub fn frame(&self) -> Option<Frame> {
        self.frame
    }

    /// Figures of the region that is shown, and how its flux lies about the centroid.
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

    /// Keys that work wherever nothing is typed.
    fn shortcuts(&mut self, ui: &Ui) {
        if ui.ctx().text_edit_focused() {
            return;
        }
        let pressed = |key| ui.input(|input| input.key_pressed(key) && input.modifiers == Modifiers::NONE);
        for (tool, _, key) in Tool::ALL {
            if pressed(key) {
                self.model.settings.tool = tool;
            }
        }
        let names = self.model.detector_names();
        for (key, step) in [(Key::PageDown, 1), (Key::PageUp, names.len().max(1) - 1)] {
            if let (true, Subject::Detector(name)) = (pressed(key), &self.model.subject) {
                let at = names.iter().position(|other| other == name).unwrap_or(0);
                if let Some(next) = names.get((at + step) % names.len().max(1)) {
                    self.model.subject = Subject::Detector(next.clone());
                }
            }
        }
        if pressed(Key::S) {
            views::detectors::toggle_scene(&mut self.model);
        }
        if pressed(Key::Space) {
            views::run::toggle_pause(&self.model);
        }
    }

    /// A folder of results that is dropped on the window becomes B.
    fn dropped_files(&mut self, ui: &Ui) {
        let paths: Vec<std::path::PathBuf> =
            ui.input(|input| input.raw.dropped_files.iter().map(|file| file.path().to_path_buf()).collect());
        for path in paths {
            let outcome = self.model.compare_with(&path);
            self.model.report(outcome, |()| format!("B is {}", path.display()));
        }
    }
}

impl eframe::App for App {
    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        App::ui(self, ui);
        let size = ui.ctx().content_rect().size();
        self.model.settings.window = (size.x, size.y);
        if let Some(left) = &mut self.frames_left {
            *left = left.saturating_sub(1);
            if *left == 0 && self.model.is_idle() {
                ui.ctx().send_viewport_cmd(egui::ViewportCommand::Close);
            }
            ui.ctx().request_repaint();
        }
    }

    fn on_exit(&mut self) {
        self.model.settings.save();
    }
}
