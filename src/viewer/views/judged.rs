//! How even, how wide and how strong the light of a detector is, with standard errors; of a far field also the polar diagram.

use crate::format::thousands;
use crate::result::DetectorData;
use crate::result::figures::field::Field;
use crate::result::figures::{Asked, judge, text};
use crate::result::png::diagram;
use crate::viewer::model::Subject;
use crate::viewer::state::{App, Judged};
use crate::viewer::views::{quiet, title, value};
use eframe::egui::{Align2, Color32, FontId, RichText, Sense, Stroke, Ui, pos2, vec2};
use std::collections::BTreeMap;

/// Figures when they are asked for: they draw 200 noisy maps, which would hold up a trace's pictures.
pub(super) fn figures(app: &mut App, ui: &mut Ui) {
    let Subject::Detector(name) = app.model.subject.clone() else { return };
    let region = app.model.marks().region;
    let Some(result) = app.model.a() else { return };
    let Some(detector) = result.detector(&name) else { return };
    if !matches!(detector.data, DetectorData::Irradiance(_) | DetectorData::FarField(_)) {
        return;
    }
    title(ui, "Figures");
    let asks = ui.button("Figures with errors").on_hover_text(
        "Least, mean and largest value, Emin/Emean, Emin/Emax, widths, beam and field angle: of the detector, and of the region that is marked.",
    );
    if asks.clicked() {
        // Regions of a far field are cones, and a region of the plot is no cone.
        let regions = region.filter(|_| matches!(detector.data, DetectorData::Irradiance(_)));
        let asked = Asked { regions: regions.into_iter().collect(), cells: None };
        let found = judge(result, detector, &asked);
        let text = found.map_or_else(
            |error| error.to_string(),
            |figures| text(&BTreeMap::from([(name.clone(), figures)])),
        );
        app.judged = Some(Judged { detector: name.clone(), region, num_rays: result.num_rays_total, text });
    }
    let now = app.model.a().map_or(0, |result| result.num_rays_total);
    let is_shown = |judged: &&Judged| judged.detector == name && judged.region == region;
    let Some(judged) = app.judged.as_ref().filter(is_shown) else { return };
    ui.label(RichText::new(judged.text.trim_end()).monospace().size(11.0));
    if judged.num_rays != now {
        let rays = format!("of {} rays; ask again for more", thousands(judged.num_rays));
        ui.label(quiet(ui, rays));
    }
}

/// The polar diagram of the far field that is shown, if one is: intensity over the polar angle, with 0 below.
pub(super) fn polar_diagram(app: &App, ui: &mut Ui) {
    let Subject::Detector(name) = &app.model.subject else { return };
    let Some(detector) = app.model.a().and_then(|result| result.detector(name)) else { return };
    let DetectorData::FarField(pattern) = &detector.data else { return };
    let Some(field) = Field::of_detector(detector) else { return };
    let (field, reach) = (field.of_equal_solid_angles(), pattern.reach());
    let planes = diagram::planes(&field.values);
    let top = planes.iter().flat_map(|(_, halves, _)| halves).flatten().copied().fold(0.0, f64::max);
    if top <= 0.0 {
        return;
    }
    title(ui, "Polar diagram");
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
    for (_, halves, color) in &planes {
        let rows = halves[0].len() as f64;
        let side = |half: &[f64], sign: f64| -> Vec<_> {
            let point =
                |(row, value): (usize, &f64)| at(sign * reach * (row as f64 + 0.5) / rows, value / top);
            half.iter().enumerate().map(point).collect()
        };
        let mut line = side(&halves[1], -1.0);
        line.reverse();
        line.extend(side(&halves[0], 1.0));
        painter.line(line, Stroke::new(1.5, of_rgb(*color)));
    }
    let most = value(top, field.labels.value.1);
    painter.text(
        at(0.0, 1.0),
        Align2::CENTER_TOP,
        most,
        FontId::proportional(10.0),
        ui.visuals().text_color(),
    );
    ui.horizontal(|ui| {
        for (name, _, color) in &planes {
            ui.label(RichText::new(*name).color(of_rgb(*color)).small());
        }
    });
}

fn of_rgb([red, green, blue]: [u8; 3]) -> Color32 {
    Color32::from_rgb(red, green, blue)
}
