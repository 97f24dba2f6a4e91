//! The bar at the top: the progress of the trace, and its controls.

use crate::format::{significant, thousands};
use crate::result::StoppedBy;
use crate::viewer::model::Model;
use crate::viewer::state::App;
use crate::viewer::tracing::State;
use crate::viewer::views::export_menu;
use eframe::egui::{self, ProgressBar, RichText, Ui};

/// Pauses the trace, or lets it go on.
pub fn toggle_pause(model: &Model) {
    if let Some(job) = model.job() {
        job.pause(job.state() != State::Paused);
    }
}

/// The bar at the top.
pub fn show(app: &mut App, ui: &mut Ui) {
    ui.add_space(4.0);
    ui.horizontal(|ui| {
        ui.label(RichText::new(&app.model.title).strong().size(15.0));
        if let Some(filter) = &app.model.run.filter {
            let text = RichText::new(format!("where {}", filter.text)).color(ui.visuals().warn_fg_color);
            let hint = format!("Detectors keep only the light whose path matches: {}", filter.text);
            ui.scope(|ui| {
                ui.set_max_width(260.0);
                ui.add(egui::Label::new(text).truncate()).on_hover_text(hint);
            });
        }
        ui.separator();
        buttons(app, ui);
        ui.separator();
        progress(&app.model, ui);
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            let dark = &mut app.model.settings.dark;
            if ui.button(if *dark { "Light" } else { "Dark" }).on_hover_text("Theme").clicked() {
                *dark = !*dark;
            }
            if ui
                .button("Copy command")
                .on_hover_text("The command that traces the same without a window")
                .clicked()
            {
                let command = app.model.command();
                ui.ctx().copy_text(command.clone());
                app.model.messages.push(format!("copied: {command}"));
            }
            export_menu::menu(app, ui);
        });
    });
    ui.add_space(2.0);
}

fn buttons(app: &mut App, ui: &mut Ui) {
    let running = app.model.job().is_some_and(|job| job.is_running());
    let paused = app.model.job().is_some_and(|job| job.state() == State::Paused);
    ui.add_enabled_ui(running, |ui| {
        let text = if paused { "Resume" } else { "Pause" };
        if ui.button(text).on_hover_text("Space").clicked() {
            toggle_pause(&app.model);
        }
        if ui.button("Stop").on_hover_text("Keeps what is traced").clicked()
            && let Some(job) = app.model.job()
        {
            job.stop();
        }
    });
    let text = if app.model.job().is_some() { "Restart" } else { "Trace" };
    let hint = "Traces with the options on the left";
    if ui.add_enabled(app.model.scene().is_some(), egui::Button::new(text)).on_hover_text(hint).clicked() {
        app.model.trace();
    }
}

fn progress(model: &Model, ui: &mut Ui) {
    let Some(job) = model.job() else {
        if let Some(result) = model.a() {
            let part = if result.run.partial { " (partial)" } else { "" };
            ui.label(format!("{} rays{part}", thousands(result.num_rays_total)));
        }
        return;
    };
    let (rays, seconds) = job.progress();
    let part = rays as f32 / job.num_rays.max(1) as f32;
    let text = match job.state() {
        State::Starting => "compiling the scene".to_string(),
        State::Finished if rays < job.num_rays => match model.a().and_then(|result| result.run.stopped_by) {
            Some(StoppedBy::TargetError) => "target met".into(),
            Some(StoppedBy::TimeLimit) => "time is up".into(),
            Some(StoppedBy::Interrupt) | None => format!("stopped at {:.0} %", 100.0 * part),
        },
        State::Finished => "done".into(),
        State::Paused => format!("paused at {:.0} %", 100.0 * part),
        State::Tracing | State::Failed(_) => format!("{:.0} %", 100.0 * part),
    };
    let bar = ProgressBar::new(part).desired_width(150.0).text(text);
    ui.add(bar);
    if rays > 0 && seconds > 0.0 {
        let rate = significant(rays as f64 / seconds / 1e6, 3);
        let error = model.a().and_then(|result| result.relative_error);
        let error =
            error.map_or(String::new(), |error| format!(", worst error {} %", significant(100.0 * error, 2)));
        let text = format!("{} of {} rays, {rate} M rays/s{error}", thousands(rays), thousands(job.num_rays));
        ui.label(text).on_hover_text(
            "error: the largest relative error of all detectors: of the flux, and of the map, the sum of the cells' \
             standard errors over the sum of their values",
        );
    }
}
