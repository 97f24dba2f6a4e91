//! Draws polar diagrams: the polar angle 0 points down.

use crate::format::shown;
use crate::result::picture::Rgb;
use crate::viewer::model::Subject;
use crate::viewer::polar::{Diagram, of_far_field};
use crate::viewer::state::App;
use crate::viewer::views::{quiet, title, value};
use eframe::egui::{Align2, Color32, FontId, RichText, Sense, Stroke, Ui, pos2, vec2};

/// Diagrams that are drawn at most.
const MOST_LAMPS: usize = 4;

/// The polar diagram of the far field that is shown, if one is.
pub(super) fn far_field(app: &App, ui: &mut Ui) {
    let Subject::Detector(name) = &app.model.subject else { return };
    let Some(detector) = app.model.a().and_then(|result| result.detector(name)) else { return };
    if let Some(diagram) = of_far_field(detector).filter(|diagram| diagram.top() > 0.0) {
        title(ui, "Polar diagram");
        draw(ui, &diagram);
    }
}

/// The polar diagrams of the lamps of the scene.
pub(super) fn lamps(app: &App, ui: &mut Ui) {
    let Some(scene) = app.model.scene() else { return };
    let lamps = &scene.lamps;
    if lamps.is_empty() {
        return;
    }
    title(ui, "Lamps");
    for (names, diagram) in lamps.iter().take(MOST_LAMPS) {
        let names: Vec<String> = names.iter().map(|name| shown(name)).collect();
        ui.label(names.join(", "));
        draw(ui, diagram);
    }
    if lamps.len() > MOST_LAMPS {
        ui.label(quiet(ui, format!("and {} more lamps", lamps.len() - MOST_LAMPS)));
    }
}

fn draw(ui: &mut Ui, diagram: &Diagram) {
    let Diagram { reach, unit, curves } = diagram;
    let (reach, top) = (*reach, diagram.top());
    let width = ui.available_width().min(260.0);
    let radius = 0.5 * width - 12.0;
    let height = if reach > 90.0 { width } else { radius + 24.0 };
    let (rect, _) = ui.allocate_exact_size(vec2(width, height), Sense::hover());
    let middle = pos2(rect.center().x, if reach > 90.0 { rect.center().y } else { rect.top() + 12.0 });
    let at = |angle: f64, part: f64| {
        let (sin, cos) = angle.to_radians().sin_cos();
        middle + vec2((f64::from(radius) * part * sin) as f32, (f64::from(radius) * part * cos) as f32)
    };
    let painter = ui.painter_at(rect);
    let grid = Stroke::new(1.0, ui.visuals().widgets.noninteractive.bg_stroke.color);
    for ring in [0.25, 0.5, 0.75, 1.0] {
        let circle = (-60..=60).map(|step| at(reach / 60.0 * f64::from(step), ring)).collect();
        painter.line(circle, grid);
    }
    for step in -6_i32..=6 {
        let angle = 30.0 * f64::from(step);
        if angle.abs() <= reach {
            painter.line_segment([middle, at(angle, 1.0)], grid);
        }
    }
    for curve in curves {
        let line = curve.points.iter().map(|(angle, value)| at(*angle, value / top)).collect();
        painter.line(line, Stroke::new(1.5, of_rgb(curve.color)));
    }
    painter.text(
        at(0.0, 1.0),
        Align2::CENTER_TOP,
        value(top, unit),
        FontId::proportional(10.0),
        ui.visuals().text_color(),
    );
    ui.horizontal(|ui| {
        for curve in curves {
            ui.label(RichText::new(curve.name).color(of_rgb(curve.color)).small());
        }
    });
}

fn of_rgb([red, green, blue]: Rgb) -> Color32 {
    Color32::from_rgb(red, green, blue)
}
