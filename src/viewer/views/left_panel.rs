//! The panel on the left: what there is to see, the comparison, and the options of the next trace.

use crate::format::with_prefix;
use crate::program::Precision;
use crate::result::Detector;
use crate::viewer::model::{Model, Subject, count};
use crate::viewer::state::App;
use crate::viewer::two_results::ComparisonMode;
use crate::viewer::views::{quiet, title, value};
use eframe::egui::{self, DragValue, ScrollArea, TextEdit, Ui};
use std::path::PathBuf;
use std::time::Duration;

/// The panel on the left.
pub fn show(app: &mut App, ui: &mut Ui) {
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        title(ui, "Detectors");
        for name in app.model.detector_names() {
            let detector = app.model.a().and_then(|result| result.detector(&name));
            if entry(ui, &app.model.subject, &name, detector) {
                app.model.subject = Subject::Detector(name);
                app.model.bin = None;
            }
        }
        title(ui, "Scene");
        ui.horizontal_wrapped(|ui| scene(&mut app.model, ui));
        title(ui, "Compare");
        compare(app, ui);
        title(ui, "Next trace");
        options(app, ui);
    });
}

fn scene(model: &mut Model, ui: &mut Ui) {
    let missing = "The scene file of these results was not found";
    let shown = model.subject == Subject::Scene;
    let button = egui::Button::selectable(shown, "Side view with rays");
    let response = ui.add_enabled(model.scene().is_some(), button);
    if response.on_hover_text("S").on_disabled_hover_text(missing).clicked() {
        toggle_scene(model);
    }
    let button = egui::Button::selectable(model.light.is_open, "Paths");
    let hint = "A table of the light on the detector, by what happened to it";
    let response = ui.add_enabled(model.scene().is_some(), button);
    if response.on_hover_text(hint).on_disabled_hover_text(missing).clicked() {
        model.light.is_open = !model.light.is_open;
    }
}

/// Shows the scene, or the first detector again.
pub fn toggle_scene(model: &mut Model) {
    if model.subject != Subject::Scene && model.scene().is_some() {
        model.subject = Subject::Scene;
    } else if let Some(name) = model.detector_names().into_iter().next() {
        model.subject = Subject::Detector(name);
    }
}

fn entry(ui: &mut Ui, subject: &Subject, name: &str, detector: Option<&Detector>) -> bool {
    let shown = matches!(subject, Subject::Detector(shown) if shown == name);
    let clicked = ui.add(egui::Button::selectable(shown, name).truncate()).clicked();
    let line = match detector {
        Some(detector) => {
            let kind = detector.data.kind().replace('_', " ");
            let few = detector.few_rays.map_or(String::new(), |few| {
                format!(" · {}, at most {}", few.text(), value(few.upper_bound_95, "W"))
            });
            let rays = rounded(detector.num_rays_hit);
            format!("{kind} · {} · {rays} rays{few}", value(detector.total_flux, "W"))
        }
        None => "no rays yet".into(),
    };
    ui.indent(name, |ui| ui.add(egui::Label::new(quiet(ui, line).size(11.5)).wrap()));
    clicked
}

/// A count that need not be exact: 1.15 M.
fn rounded(rays: u64) -> String {
    if rays < 1_000_000 { count(rays) } else { with_prefix(rays as f64, "") }
}

fn compare(app: &mut App, ui: &mut Ui) {
    if let Some(b) = app.model.b() {
        let name = b.name.clone();
        ui.horizontal_wrapped(|ui| {
            for (comparison, name) in ComparisonMode::ALL {
                ui.selectable_value(&mut app.model.settings.comparison, comparison, name);
            }
        });
        ui.label(quiet(ui, format!("B: {name}")).size(11.5));
        ui.checkbox(&mut app.model.settings.common_scale, "Common scale");
        if ui.button("End comparison").clicked() {
            app.model.drop_b();
        }
        return;
    }
    let held = ui.add_enabled(app.model.a().is_some(), egui::Button::new("Hold as B"));
    if held.on_hover_text("Keeps what is shown, to compare the next trace with it").clicked() {
        app.model.hold_as_b();
    }
    ui.horizontal(|ui| {
        let width = (ui.available_width() - 62.0).max(60.0);
        let edit = TextEdit::singleline(&mut app.compare_path).hint_text("folder of results");
        let label = ui.add(edit.desired_width(width)).on_hover_text("Or drop a folder on the window");
        label.widget_info(|| egui::WidgetInfo::labeled(egui::Role::TextInput, true, "Folder of B"));
        if ui.button("Open").clicked() {
            let path = PathBuf::from(app.compare_path.trim());
            let outcome = app.model.compare_with(&path);
            app.model.report(outcome, |()| format!("B is {}", path.display()));
        }
    });
}

fn options(app: &mut App, ui: &mut Ui) {
    let App { model, num_rays, .. } = app;
    ui.add_enabled_ui(model.scene().is_some(), |ui| {
        egui::Grid::new("options").num_columns(2).spacing([10.0, 4.0]).show(ui, |ui| {
            let label = ui.label("Rays");
            let edit = ui.add(TextEdit::singleline(num_rays).desired_width(96.0)).labelled_by(label.id);
            match crate::count::parse(num_rays) {
                Ok(rays) if rays > 0 && edit.changed() => model.run.num_rays = rays,
                Ok(rays) if rays == model.run.num_rays => {}
                // Text that is no count is kept only while the user types.
                _ if !edit.has_focus() => *num_rays = model.run.num_rays.to_string(),
                _ => {
                    edit.on_hover_text("Write 250000, 1e7 or 10M");
                    ui.colored_label(ui.visuals().error_fg_color, "?");
                }
            }
            ui.end_row();
            let label = ui.label("Seed");
            ui.add(DragValue::new(&mut model.run.seed)).labelled_by(label.id);
            ui.end_row();
            let label = ui.label("Largest depth");
            ui.add(DragValue::new(&mut model.run.max_depth).range(1..=10_000)).labelled_by(label.id);
            ui.end_row();
            let label = ui.label("Precision");
            let name = |precision: Option<Precision>| precision.map_or("auto", Precision::name);
            let precision = &mut model.run.precision;
            egui::ComboBox::from_id_salt("precision")
                .selected_text(name(*precision))
                .show_ui(ui, |ui| {
                    for choice in [None, Some(Precision::F32), Some(Precision::Df64), Some(Precision::F64)] {
                        ui.selectable_value(precision, choice, name(choice));
                    }
                })
                .response
                .labelled_by(label.id);
            ui.end_row();
            optional(ui, "Target error", &mut model.run.target_error, 0.01, |ui, error| {
                let mut percent = 100.0 * *error;
                let value = DragValue::new(&mut percent).range(0.001..=100.0).speed(0.01).max_decimals(3);
                if ui.add(value.suffix(" %")).changed() {
                    *error = percent / 100.0;
                }
            });
            optional(ui, "Time limit", &mut model.run.time_limit, Duration::from_secs(30), |ui, limit| {
                let mut seconds = limit.as_secs_f64();
                let value = DragValue::new(&mut seconds).range(0.1..=1e6).speed(0.1).max_decimals(1);
                if ui.add(value.suffix(" s")).changed() {
                    *limit = Duration::from_secs_f64(seconds);
                }
            });
        });
    });
}

/// A row for an option that can be left out.
fn optional<T: Copy>(
    ui: &mut Ui,
    name: &str,
    option: &mut Option<T>,
    first: T,
    edit: impl FnOnce(&mut Ui, &mut T),
) {
    let mut on = option.is_some();
    if ui.checkbox(&mut on, name).changed() {
        *option = on.then_some(first);
    }
    match option {
        Some(value) => edit(ui, value),
        None => {
            ui.label(quiet(ui, "none"));
        }
    }
    ui.end_row();
}
