//! The scene from the side, with a few hundred recorded rays. A misplaced surface is seen at once.

use crate::format::thousands;
use crate::model::shapes::{Geometry, circle};
use crate::model::{Frame as LocalFrame, Interaction, Mesh, SceneIr};
use crate::result::PathColumns;
use crate::viewer::light::{Light, RaysOfPaths};
use crate::viewer::plot::{Colors, Plot, PlotFrame, View};
use crate::viewer::settings::{Plane, RayColor};
use crate::viewer::state::App;
use eframe::egui::{self, Align2, Color32, FontId, Painter, Shape, Stroke, Ui};
use glam::DVec3;
use std::sync::Arc;

/// Points of a curve.
type Curve = Vec<DVec3>;

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
    let drawing = Drawing::new(&scene.ir, settings.plane);
    let key = format!("scene {:?}", settings.plane);
    let mut view = app.views.get(&key).copied().flatten();
    let (x, y) = settings.plane.axes();
    let plot = Plot {
        name: "Plot: scene",
        home: drawing.bounds.padded(0.06),
        equal: true,
        x: (x, "mm"),
        y: (y, "mm"),
        log_y: false,
        grid: true,
        pans: true,
        moves: true,
    };
    plot.show(ui, rect, &mut view, |ui, painter, frame| {
        if let Some(paths) = &paths {
            rays(painter, frame, paths, &settings.plane, settings.ray_color, drawing.reach());
        }
        drawing.draw(painter, frame, ui);
    });
    app.views.insert(key, view);
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

/// The surfaces, detectors and sources of a scene, as curves in a plane.
struct Drawing {
    curves: Vec<(Vec<(f64, f64)>, Kind)>,
    names: Vec<((f64, f64), String)>,
    bounds: View,
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Refractive,
    Reflective,
    Absorbing,
    Detector,
    Source,
}

impl Drawing {
    fn new(ir: &SceneIr, plane: Plane) -> Self {
        let mut drawing = Drawing {
            curves: Vec::new(),
            names: Vec::new(),
            bounds: View::new((f64::INFINITY, f64::NEG_INFINITY), (f64::INFINITY, f64::NEG_INFINITY)),
        };
        for surface in &ir.surfaces {
            let kind = match surface.interaction {
                Interaction::Refractive => Kind::Refractive,
                Interaction::Reflective { .. } => Kind::Reflective,
                Interaction::Absorbing => Kind::Absorbing,
            };
            drawing.add(&curves(&surface.frame, &*surface.shape, &ir.meshes, plane), kind, plane);
        }
        for detector in &ir.detectors {
            // The disk of a far-field detector has no place in the scene.
            if !detector.kind.is_placed() {
                continue;
            }
            let curves = curves(&detector.frame, &detector.outline(), &[], plane);
            drawing.add(&curves, Kind::Detector, plane);
            drawing.name(&curves, &detector.name, plane);
        }
        for source in &ir.sources {
            let curves = match source.kind.is_point() {
                true => vec![vec![source.frame.origin]],
                false => curves(&source.frame, &source.kind.births(), &[], plane),
            };
            drawing.add(&curves, Kind::Source, plane);
            drawing.name(&curves, &source.name, plane);
        }
        if !drawing.bounds.x.0.is_finite() {
            drawing.bounds = View::new((-1.0, 1.0), (-1.0, 1.0));
        }
        // A scene in one plane or on one axis still needs an area for drawing.
        let size = (drawing.bounds.x.1 - drawing.bounds.x.0).max(drawing.bounds.y.1 - drawing.bounds.y.0);
        let least = if size > 0.0 { 0.05 * size } else { 1.0 };
        for range in [&mut drawing.bounds.x, &mut drawing.bounds.y] {
            if range.1 - range.0 < least {
                *range = (range.0 - least, range.1 + least);
            }
        }
        drawing
    }

    fn add(&mut self, curves: &[Curve], kind: Kind, plane: Plane) {
        for curve in curves {
            let points: Vec<(f64, f64)> = curve.iter().map(|point| plane.project(*point)).collect();
            for (x, y) in &points {
                let wider = |range: &mut (f64, f64), at: f64| *range = (range.0.min(at), range.1.max(at));
                wider(&mut self.bounds.x, *x);
                wider(&mut self.bounds.y, *y);
            }
            self.curves.push((points, kind));
        }
    }

    fn name(&mut self, curves: &[Curve], name: &str, plane: Plane) {
        let points = || curves.iter().flatten().map(|point| plane.project(*point));
        if let Some(top) = points().max_by(|a, b| a.1.total_cmp(&b.1)) {
            self.names.push((top, name.to_string()));
        }
    }

    /// The length at which an escaping ray is drawn.
    fn reach(&self) -> f64 {
        let View { x, y } = self.bounds;
        0.35 * (x.1 - x.0).hypot(y.1 - y.0)
    }

    fn draw(&self, painter: &Painter, frame: &PlotFrame, ui: &Ui) {
        let colors = Colors::of(ui);
        let dark = ui.visuals().dark_mode;
        let pick = |on_dark: Color32, on_light: Color32| if dark { on_dark } else { on_light };
        for (points, kind) in &self.curves {
            let color = match kind {
                Kind::Refractive => pick(Color32::from_rgb(140, 200, 255), Color32::from_rgb(20, 90, 170)),
                Kind::Reflective => pick(Color32::from_gray(225), Color32::from_gray(40)),
                Kind::Absorbing => pick(Color32::from_gray(130), Color32::from_gray(130)),
                Kind::Detector => pick(Color32::from_rgb(110, 225, 140), Color32::from_rgb(0, 120, 50)),
                Kind::Source => pick(Color32::from_rgb(255, 190, 80), Color32::from_rgb(190, 100, 0)),
            };
            let width = if matches!(kind, Kind::Detector | Kind::Source) { 2.5 } else { 1.5 };
            if let [point] = points.as_slice() {
                painter.circle_filled(frame.place(*point), 4.0, color);
            } else {
                let points = points.iter().map(|point| frame.place(*point)).collect();
                painter.add(Shape::line(points, Stroke::new(width, color)));
            }
        }
        let mut taken: Vec<egui::Rect> = Vec::new();
        for (at, name) in &self.names {
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
}

/// A surface as curves: its section with the plane through its axis that faces the viewer, its rims and its edges.
fn curves(frame: &LocalFrame, shape: &dyn Geometry, meshes: &[Mesh], plane: Plane) -> Vec<Curve> {
    let radial = radial(frame, plane);
    let section = shape.section().into_iter();
    let section = section.map(|curve| curve.iter().map(|p| radial * p.x + DVec3::Z * p.y).collect());
    // Seen from the side, a rim is a line through the surface, which would only hide the surface's shape.
    let (across, up) = plane.project(frame.rotation * DVec3::Z);
    let from_the_side = across.hypot(up) > 0.95;
    let rims = shape.rims().into_iter().filter(|_| !from_the_side).map(|(radius, z)| circle(radius, z));
    let curves = section.chain(rims).chain(shape.edges(meshes));
    curves.map(|curve: Curve| placed(frame, &curve)).collect()
}

fn placed(frame: &LocalFrame, curve: &[DVec3]) -> Curve {
    curve.iter().map(|&point| frame.rotation * point + frame.origin).collect()
}

/// The local direction, at a right angle to the axis, that appears longest along the vertical of the view.
fn radial(frame: &LocalFrame, plane: Plane) -> DVec3 {
    let along = |axis: DVec3| plane.project(frame.rotation * axis);
    // The combination of local x and y with the largest part along the vertical, then along the horizontal.
    let ((hx, vx), (hy, vy)) = (along(DVec3::X), along(DVec3::Y));
    let vertical = DVec3::new(vx, vy, 0.0);
    let horizontal = DVec3::new(hx, hy, 0.0);
    let best = if vertical.length() >= horizontal.length() - 1e-9 { vertical } else { horizontal };
    best.try_normalize().unwrap_or(DVec3::Y)
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
