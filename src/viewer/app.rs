//! The window: panels around the plot of the detector that is shown.

use crate::viewer::model::Subject;
use crate::viewer::settings::Tool;
use crate::viewer::views;
use eframe::egui::{self, CentralPanel, Key, Modifiers, Panel, Ui};

pub use crate::viewer::state::{App, Cursor};

/// Width of a window that has room for all panels \[points\].
const WIDE: f32 = 1280.0;

impl App {
    /// Draws one frame.
    pub fn ui(&mut self, ui: &mut Ui) {
        self.model.poll();
        let theme = if self.model.settings.dark { egui::Theme::Dark } else { egui::Theme::Light };
        ui.ctx().set_theme(theme);
        self.shortcuts(ui);
        self.dropped_files(ui);
        Panel::top("run").show(ui, |ui| views::run_bar::show(self, ui));
        Panel::left("detectors")
            .default_size(228.0)
            .size_range(190.0..=360.0)
            .show(ui, |ui| views::left_panel::show(self, ui));
        // In a narrow window the figures give way to the table of paths.
        let has_paths = self.model.light.is_open;
        if !has_paths || ui.ctx().content_rect().width() >= WIDE {
            Panel::right("figures")
                .default_size(272.0)
                .size_range(240.0..=420.0)
                .show(ui, |ui| views::right_panel::show(self, ui));
        }
        if has_paths {
            let most = (ui.available_width() - 260.0).max(340.0);
            Panel::right("paths")
                .resizable(true)
                .default_size(500.0_f32.min(most))
                .size_range(340.0..=most)
                .show(ui, |ui| views::paths_panel::show(self, ui));
        }
        if matches!(self.model.subject, Subject::Detector(_)) {
            Panel::bottom("curves")
                .resizable(true)
                .default_size(230.0)
                .size_range(140.0..=480.0)
                .show(ui, |ui| views::curves_below::show(self, ui));
        }
        CentralPanel::default().show(ui, |ui| match &self.model.subject {
            Subject::Scene => views::side_view::show(self, ui),
            Subject::Detector(_) => views::detector_plot::show(self, ui),
        });
    }

    /// Handles keys that work wherever nothing is typed.
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
            views::left_panel::toggle_scene(&mut self.model);
        }
        if pressed(Key::Space) {
            views::run_bar::toggle_pause(&self.model);
        }
    }

    /// Takes a folder of results that is dropped on the window as B.
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
