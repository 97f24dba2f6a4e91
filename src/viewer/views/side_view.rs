//! The scene from the side, with a few hundred recorded rays. A misplaced surface is seen at once.

use crate::format::thousands;
use crate::model::Detector;
use crate::result::PathColumns;
use crate::viewer::light::{Light, RaysOfPaths};
use crate::viewer::plot::{Colors, Plot, PlotFrame, View};
use crate::viewer::settings::{Plane, RayColor};
use crate::viewer::silhouettes::{Kind, Silhouette, home, silhouettes};
use crate::viewer::state::{App, side_view_key};
use crate::viewer::stray::{Part, Stray};
use crate::viewer::views::value;
use eframe::egui::{self, Align2, Color32, ComboBox, FontId, Painter, Shape, Stroke, Ui};
use glam::DVec3;
use std::sync::Arc;

/// The middle of the window.
pub fn show(app: &mut App, ui: &mut Ui) {
    let (paths, remark) = match app.model.light_rays() {
        None => (app.model.paths(), None),
        Some(rays) => of_light(&app.model.light, rays),
    };
    ui.horizontal_wrapped(|ui| {
        let settings = &mut app.model.settings;
        for (plane, name) in Plane::ALL {
            ui.selectable_value(&mut settings.plane, plane, name);
        }
        ui.separator();
        ui.label("Rays by");
        ui.selectable_value(&mut settings.ray_color, RayColor::Bounce, "bounce");
        ui.selectable_value(&mut settings.ray_color, RayColor::Flux, "flux");
        ui.separator();
        let (meaning, key) = color_key(settings.ray_color);
        ui.label(meaning);
        for (color, label) in key {
            swatch(ui, color, &label);
        }
        if paths.is_none() && remark.is_none() {
            ui.separator();
            ui.label("recording rays");
        }
    });
    stray(app, ui);
    if let Some(remark) = remark {
        ui.horizontal(|ui| {
            if ui.button("All light").on_hover_text("Shows all rays again").clicked() {
                app.model.light.show_whole();
            }
            ui.add(egui::Label::new(remark).truncate());
        });
    }
    let (rect, _) = ui.allocate_exact_size(ui.available_size(), egui::Sense::hover());
    let settings = app.model.settings.clone();
    let Some(scene) = app.model.scene() else {
        return;
    };
    let silhouettes = silhouettes(&scene.ir, settings.plane);
    let home = home(&silhouettes);
    let key = side_view_key(settings.plane);
    let mut view = app.views.get(&key).copied().flatten();
    let (x, y) = settings.plane.axes();
    let plot = Plot {
        name: "Plot: scene",
        home,
        equal: true,
        x: (x, "mm"),
        y: (y, "mm"),
        log_y: false,
        grid: true,
        pans: true,
        moves: true,
    };
    let shown = plot.show(ui, rect, &mut view, |ui, painter, frame| {
        if let Some(paths) = &paths {
            rays(painter, frame, paths, &settings.plane, settings.ray_color, reach(home));
        }
        draw_silhouettes(&silhouettes, &app.model.stray, painter, frame, ui);
    });
    app.frame = Some(shown.frame);
    app.views.insert(key, view);
}

/// Which surfaces the sources light and a detector sees: a question, and the key of the answer.
fn stray(app: &mut App, ui: &mut Ui) {
    let model = &mut app.model;
    let Some(scene) = model.scene() else { return };
    let has_area = |detector: &&Detector| detector.kind.is_placed();
    let names: Vec<String> =
        scene.ir.detectors.iter().filter(has_area).map(|detector| detector.name.clone()).collect();
    let Some(first) = names.first().cloned() else { return };
    ui.horizontal_wrapped(|ui| {
        let mut chosen = model.stray.detector.clone().unwrap_or(first);
        ui.label("Stray light on");
        let choice = ComboBox::from_id_salt("stray light").selected_text(&chosen).show_ui(ui, |ui| {
            names.iter().for_each(|name| {
                ui.selectable_value(&mut chosen, name.clone(), name);
            });
        });
        choice.response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::ComboBox, true, "Stray light on"));
        if model.stray.detector.as_ref().is_some_and(|known| *known != chosen) {
            model.stray.clear();
        }
        model.stray.detector = Some(chosen.clone());
        let button = egui::Button::new("Lit and seen");
        let hint = "Colours surfaces by whether sources light them and whether the detector sees them, straight or by mirrors and lenses";
        if ui.add_enabled(!model.stray.is_asked(), button).on_hover_text(hint).clicked() {
            model.ask_for_stray(&chosen);
        }
        match model.stray.found() {
            Some(Err(problem)) => {
                let problem = problem.to_owned();
                ui.colored_label(ui.visuals().error_fg_color, problem);
            }
            Some(Ok(found)) => {
                for (part, meaning) in [
                    (Part::LitAndSeen, "lit and seen"),
                    (Part::Lit, "lit"),
                    (Part::Seen, "seen"),
                ] {
                    swatch(ui, stray_color(part), meaning);
                }
                if let Some(worst) = found.first().filter(|worst| worst.sends[0] > 0.0) {
                    ui.separator();
                    ui.label(format!("most from {}: {}", worst.name, value(worst.sends[0], "W")));
                }
            }
            None if model.stray.is_asked() => {
                ui.label("tracing");
            }
            None => {}
        }
    });
}

fn stray_color(part: Part) -> Color32 {
    match part {
        Part::LitAndSeen => Color32::from_rgb(225, 45, 45),
        Part::Lit => Color32::from_rgb(235, 150, 30),
        Part::Seen => Color32::from_rgb(70, 120, 235),
    }
}

/// The rays of the light that is shown, and what is to be said of them.
fn of_light(light: &Light, rays: RaysOfPaths) -> (Option<Arc<PathColumns>>, Option<String>) {
    let caption = light.caption().unwrap_or_default();
    match rays {
        RaysOfPaths::Searching => (None, Some(format!("Rays are being looked for. {caption}"))),
        RaysOfPaths::Missing(problem) => (None, Some(format!("No rays: {problem}. {caption}"))),
        RaysOfPaths::Found(rays) => {
            let searched = thousands(rays.num_searched);
            let remark = format!("{} of the first {searched} rays. {caption}", rays.num_arrivals);
            (Some(rays.columns.clone()), Some(remark))
        }
    }
}

/// The length at which an escaping ray is drawn, in a scene that fills this view.
fn reach(View { x, y }: View) -> f64 {
    0.3125 * (x.1 - x.0).hypot(y.1 - y.0)
}

/// Draws what stands in the scene, and the names of detectors and sources.
fn draw_silhouettes(
    silhouettes: &[Silhouette],
    stray: &Stray,
    painter: &Painter,
    frame: &PlotFrame,
    ui: &Ui,
) {
    let colors = Colors::of(ui);
    let dark = ui.visuals().dark_mode;
    let pick = |on_dark: Color32, on_light: Color32| if dark { on_dark } else { on_light };
    for Silhouette { kind, curves, name } in silhouettes {
        let part = stray.part(name).filter(|_| !matches!(kind, Kind::Detector | Kind::Source));
        let color = match kind {
            _ if part.is_some() => part.map_or(Color32::GRAY, stray_color),
            Kind::Refractive => pick(Color32::from_rgb(140, 200, 255), Color32::from_rgb(20, 90, 170)),
            Kind::Reflective => pick(Color32::from_gray(225), Color32::from_gray(40)),
            Kind::Absorbing => pick(Color32::from_gray(130), Color32::from_gray(130)),
            Kind::Detector => pick(Color32::from_rgb(110, 225, 140), Color32::from_rgb(0, 120, 50)),
            Kind::Source => pick(Color32::from_rgb(255, 190, 80), Color32::from_rgb(190, 100, 0)),
        };
        let is_wide = matches!(kind, Kind::Detector | Kind::Source) || part == Some(Part::LitAndSeen);
        let width = if is_wide { 2.5 } else { 1.5 };
        for points in curves {
            if let [point] = points.as_slice() {
                painter.circle_filled(frame.place(*point), 4.0, color);
            } else {
                let points = points.iter().map(|point| frame.place(*point)).collect();
                painter.add(Shape::line(points, Stroke::new(width, color)));
            }
        }
    }
    let mut taken: Vec<egui::Rect> = Vec::new();
    let is_named = |silhouette: &&Silhouette| matches!(silhouette.kind, Kind::Detector | Kind::Source);
    for Silhouette { name, curves, .. } in silhouettes.iter().filter(is_named) {
        let points = curves.iter().flatten();
        let Some(at) = points.max_by(|a, b| a.1.total_cmp(&b.1)) else { continue };
        let galley = painter.layout_no_wrap(name.clone(), FontId::proportional(12.0), colors.text);
        let place = frame.place(*at) - egui::vec2(0.0, 5.0);
        let rect = Align2::CENTER_BOTTOM.anchor_size(place, galley.size());
        // Sources often stand in one place. One name there is easier to read than all on top of one another.
        if !taken.iter().any(|other| other.intersects(rect)) {
            painter.rect_filled(rect.expand(2.0), 2.0, colors.ground.gamma_multiply(0.8));
            painter.galley(rect.min, galley, colors.text);
            taken.push(rect);
        }
    }
}

/// Draws the recorded rays, segment by segment.
fn rays(painter: &Painter, frame: &PlotFrame, paths: &PathColumns, plane: &Plane, by: RayColor, reach: f64) {
    let point = |row: usize| {
        let [x, y, z] = &paths.position;
        DVec3::new(x[row], y[row], z[row])
    };
    let brightest = paths.flux.iter().copied().fold(0.0, f64::max);
    for row in 1..paths.ray_id.len() {
        if paths.ray_id[row] != paths.ray_id[row - 1] {
            continue;
        }
        let from = point(row - 1);
        let escaped = paths.component_name[row] == "escaped" && paths.event_type[row] == "death";
        let to = if escaped {
            let [l, m, n] = &paths.direction;
            from + DVec3::new(l[row], m[row], n[row]) * reach
        } else {
            point(row)
        };
        let color = match by {
            RayColor::Bounce => bounce_color(paths.bounce[row]),
            RayColor::Flux => flux_color(paths.flux[row] / brightest),
        };
        let ends = [frame.place(plane.project(from)), frame.place(plane.project(to))];
        painter.line_segment(ends, Stroke::new(0.8, color.gamma_multiply(if escaped { 0.25 } else { 0.55 })));
    }
}

/// The colour for a number of events so far. The first few differ most.
fn bounce_color(bounce: i32) -> Color32 {
    gradient(colorous::TURBO, 0.12 + 0.8 * (1.0 - (-f64::from(bounce) / 5.0).exp()))
}

/// The colour for a share of flux. All rays three decades or more below the brightest are equally faint.
fn flux_color(share: f64) -> Color32 {
    gradient(colorous::INFERNO, 0.25 + 0.65 * (share.max(1e-3).log10() / 3.0 + 1.0))
}

/// The meaning of the colours of rays.
fn color_key(by: RayColor) -> (&'static str, Vec<(Color32, String)>) {
    match by {
        RayColor::Bounce => {
            let color = |bounce: &i32| (bounce_color(*bounce), bounce.to_string());
            ("events before:", [0, 1, 2, 4, 8, 16].iter().map(color).collect())
        }
        RayColor::Flux => {
            let shares = [(1.0, "1"), (0.1, "0.1"), (0.01, "0.01"), (1e-3, "0.001 or less")];
            let color = |(share, label): &(f64, &str)| (flux_color(*share), label.to_string());
            ("of the brightest:", shares.iter().map(color).collect())
        }
    }
}

/// A colour and what it means.
fn swatch(ui: &mut Ui, color: Color32, label: &str) {
    // Both stay together, even in a narrow window.
    let font = egui::TextStyle::Body.resolve(ui.style());
    let text = ui.painter().layout_no_wrap(label.into(), font, ui.visuals().text_color());
    let size = egui::vec2(18.0 + text.size().x, text.size().y);
    let (rect, _) = ui.allocate_exact_size(size, egui::Sense::hover());
    let patch = Align2::LEFT_CENTER.anchor_size(rect.left_center(), egui::vec2(14.0, 10.0));
    ui.painter().rect_filled(patch, 2.0, color);
    ui.painter().galley(rect.min + egui::vec2(18.0, 0.0), text, ui.visuals().text_color());
}

fn gradient(gradient: colorous::Gradient, part: f64) -> Color32 {
    let color = gradient.eval_continuous(part.clamp(0.0, 1.0));
    Color32::from_rgb(color.r, color.g, color.b)
}
