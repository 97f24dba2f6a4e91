//! The plot of a detector: a map or a spot diagram, with the user's marks.

use crate::result::figures::field::{CellGeometry, Field};
use crate::result::figures::region::{Region, RegionOutline};
use crate::result::picture::Rgb;
use crate::result::picture::scale::{Palette, Scale, ScaleKind};
use crate::result::picture::ticks::ticks;
use crate::viewer::model::{Marks, Picture};
use crate::viewer::plot::{self, Plot, PlotFrame, ShownPlot, View};
use crate::viewer::screen_pixels;
use crate::viewer::settings::Tool;
use crate::viewer::spots::Spots;
use crate::viewer::state::{App, Cursor, Grab, Painted};
use crate::viewer::views::{controls, value};
use eframe::egui::{
    self, Align2, Color32, FontId, Painter, PointerButton, Pos2, Rect, Shape, Stroke, TextureOptions, Ui,
    pos2, vec2,
};
use std::sync::Arc;

/// Room for the colour bar and its labels \[points\].
const BAR: f32 = 104.0;
/// The distance within which the pointer can hold something \[points\].
const REACH: f32 = 9.0;
/// Marks are drawn light on dark, so that they show on any colour.
const MARK: Stroke = Stroke { width: 1.5, color: Color32::WHITE };
const SHADOW: Stroke = Stroke { width: 3.5, color: Color32::from_black_alpha(150) };

/// The middle of the window.
pub fn show(app: &mut App, ui: &mut Ui) {
    let picture = app.model.picture();
    controls::show(app, ui, picture.as_deref().ok());
    if app.model.shown_light().is_some() {
        light(app, ui);
    }
    let (rect, _) = ui.allocate_exact_size(ui.available_size(), egui::Sense::hover());
    match picture {
        Ok(picture) => plot(app, ui, rect, &picture),
        Err(problem) => {
            (app.frame, app.cursor) = (None, None);
            let font = FontId::proportional(16.0);
            let color = ui.visuals().weak_text_color();
            let galley = ui.painter().layout(problem, font, color, rect.width() * 0.7);
            ui.painter().galley(rect.center() - galley.size() / 2.0, galley, color);
        }
    }
}

/// Says which light is shown, and shows all light again.
fn light(app: &mut App, ui: &mut Ui) {
    let Some(caption) = app.model.light.caption() else { return };
    ui.horizontal(|ui| {
        if ui.button("All light").on_hover_text("Shows the whole map again").clicked() {
            app.model.light.show_whole();
        }
        ui.add(egui::Label::new(egui::RichText::new(caption).strong()).truncate());
    });
}

fn plot(app: &mut App, ui: &mut Ui, rect: Rect, picture: &Arc<Picture>) {
    let place = Rect::from_min_max(rect.min, pos2(rect.right() - BAR, rect.bottom()));
    let key = view_key(app);
    let mut view = app.views.get(&key).copied().flatten();
    let held = app.grab.is_some() || pressed_on_mark(app, ui, picture);
    let name = app.model.detector().map_or("Detector", |detector| detector.data.kind());
    let (home, labels, equal) = match picture.as_ref() {
        Picture::Map { field, .. } => {
            let home = View::new(field.x_range, field.y_range).padded(0.015);
            (home, field.labels, is_true_to_scale(field))
        }
        Picture::Spots(spots) => (View::new(spots.bounds.0, spots.bounds.1), spots.labels, true),
    };
    let plot = Plot {
        name: &format!("Plot: {}", name.replace('_', " ")),
        home,
        equal,
        x: labels.x,
        y: labels.y,
        log_y: false,
        grid: false,
        pans: app.model.settings.tool == Tool::Pan && !held,
        moves: true,
    };
    let marks = app.model.marks().clone();
    let shown = plot.show(ui, place, &mut view, |ui, painter, frame| {
        paint(app, ui, painter, frame, picture);
        if let Picture::Map { field, .. } = picture.as_ref()
            && field.geometry == CellGeometry::Polar
        {
            directions(painter, frame, field);
        }
        draw_marks(painter, frame, &marks, picture);
        if let Picture::Map { field, .. } = picture.as_ref() {
            note_means(ui, painter, frame, field);
        }
    });
    app.views.insert(key, view);
    app.frame = Some(shown.frame);
    drag(app, ui, &shown, picture);
    let cursor = read(app, &shown, picture);
    let changed = cursor.as_ref().map(Cursor::reads) != app.cursor.as_ref().map(Cursor::reads);
    app.cursor = cursor;
    if changed {
        // The panels that show the cursor were drawn before, so the window is drawn again.
        ui.ctx().request_repaint();
    }
    let bar = Rect::from_min_max(
        pos2(place.right(), shown.frame.rect.top()),
        pos2(rect.right(), shown.frame.rect.bottom()),
    );
    match picture.as_ref() {
        Picture::Map { field, scale, .. } => color_bar(app, ui, bar, field, scale),
        Picture::Spots(spots) => wavelength_bar(ui, bar, spots),
    }
}

fn view_key(app: &App) -> String {
    let settings = &app.model.settings;
    format!("{:?} {} {}", app.model.subject, settings.polar, settings.directions)
}

/// True if the plot is true to scale. With a more extreme ratio of sides, the narrow side would vanish. Angles along
/// both axes are no lengths.
fn is_true_to_scale(field: &Field) -> bool {
    let (width, height) = (field.x_range.1 - field.x_range.0, field.y_range.1 - field.y_range.0);
    let angles = field.labels.x.1 == "°" && field.geometry == CellGeometry::Rectangles;
    !angles && width / height < 8.0 && height / width < 8.0
}

/// The colours of a map or of differences.
fn palette(app: &App, ui: &Ui, scale: &Scale) -> Palette {
    let [r, g, b, _] = plot::Colors::of(ui).ground.to_array();
    Palette::of_window(app.model.settings.color_map, scale, [r, g, b])
}

fn color32([r, g, b]: Rgb) -> Color32 {
    Color32::from_rgb(r, g, b)
}

/// Draws the texture, and makes it anew after a change.
fn paint(app: &mut App, ui: &Ui, painter: &Painter, frame: &PlotFrame, picture: &Arc<Picture>) {
    let scale = ui.pixels_per_point();
    let size = size_of(ui, frame);
    let ground = plot::Colors::of(ui).ground;
    let palette = match picture.as_ref() {
        Picture::Map { scale, .. } => palette(app, ui, scale),
        Picture::Spots(_) => palette(app, ui, &Scale::fit(ScaleKind::Linear, 100.0, [])),
    };
    let fresh = app.painted.as_ref().is_some_and(|painted| {
        Arc::ptr_eq(&painted.picture, picture)
            && (painted.view, painted.size) == (frame.view, size)
            && painted.palette == palette
    });
    if !fresh {
        let image = match picture.as_ref() {
            Picture::Map { field, pyramid, scale, colors, .. } => {
                screen_pixels::map(field, pyramid, colors.as_deref(), (scale, &palette), &frame.view, size)
            }
            Picture::Spots(spots) => {
                let color = |wavelength: f64| wavelength_color(ui, wavelength, spots.wavelengths);
                let radius = if spots.spots.len() > 5_000 { 1.2 } else { 2.0 };
                screen_pixels::spots(spots, color, ground, &frame.view, size, radius * f64::from(scale))
            }
        };
        let texture = match app.painted.take() {
            Some(mut painted) => {
                painted.texture.set(image, TextureOptions::NEAREST);
                painted.texture
            }
            None => ui.ctx().load_texture("plot", image, TextureOptions::NEAREST),
        };
        app.painted = Some(Painted { picture: picture.clone(), view: frame.view, size, palette, texture });
    }
    if let Some(painted) = &app.painted {
        let whole = Rect::from_min_max(Pos2::ZERO, pos2(1.0, 1.0));
        painter.image(painted.texture.id(), frame.rect, whole, Color32::WHITE);
    }
}

/// Shows a note where a pixel of the screen stands for several cells.
fn note_means(ui: &Ui, painter: &Painter, frame: &PlotFrame, field: &Field) {
    let (x, y) = screen_pixels::cells_per_pixel(field, &frame.view, size_of(ui, frame));
    if field.geometry == CellGeometry::Polar || x.max(y) < 1.5 {
        return;
    }
    let cells = |cells: f64| crate::format::significant(cells.max(1.0), 2);
    let text = format!("each pixel: mean of about {} × {} cells", cells(x), cells(y));
    let galley = painter.layout_no_wrap(text, FontId::proportional(11.0), Color32::from_white_alpha(200));
    let at = frame.rect.right_bottom() - galley.size() - vec2(7.0, 5.0);
    let ground = Rect::from_min_size(at, galley.size()).expand2(vec2(4.0, 2.0));
    painter.rect_filled(ground, 3.0, Color32::from_black_alpha(150));
    painter.galley(at, galley, Color32::WHITE);
}

/// Width and height of the plot \[pixels of the screen\].
fn size_of(ui: &Ui, frame: &PlotFrame) -> [usize; 2] {
    let scale = ui.pixels_per_point();
    [frame.rect.width(), frame.rect.height()].map(|side| (side * scale).round().max(1.0) as usize)
}

/// A false colour for a wavelength: short ones blue, long ones red, evenly bright. Most of the wavelengths are not
/// visible.
fn wavelength_color(ui: &Ui, wavelength: f64, (shortest, longest): (f64, f64)) -> Color32 {
    let part = if longest > shortest { (wavelength - shortest) / (longest - shortest) } else { 0.35 };
    let part = if ui.visuals().dark_mode { 0.25 + 0.75 * part } else { 0.85 * part };
    let color = if ui.visuals().dark_mode { colorous::COOL } else { colorous::PLASMA };
    color32(color.eval_continuous(part).into_array())
}

/// Draws rings of the polar angle and spokes of the azimuth.
fn directions(painter: &Painter, frame: &PlotFrame, field: &Field) {
    let faint = Stroke::new(1.0, Color32::from_white_alpha(46));
    let limit = field.x_range.1;
    let at =
        |theta: f64, phi: f64| frame.place((theta * phi.to_radians().cos(), theta * phi.to_radians().sin()));
    let centre = frame.place((0.0, 0.0));
    let span = (frame.view.x.1 - frame.view.x.0).min(frame.view.y.1 - frame.view.y.0);
    let step = [1.0, 2.0, 5.0, 10.0, 15.0, 30.0].into_iter().find(|step| span / step < 9.0).unwrap_or(30.0);
    let rings = (limit / step).floor() as i32;
    for ring in 1..=rings {
        let theta = f64::from(ring) * step;
        painter.circle_stroke(centre, at(theta, 0.0).x - centre.x, faint);
        let place = at(theta, 45.0);
        if ring < rings {
            let color = Color32::from_white_alpha(150);
            painter.text(
                place,
                Align2::CENTER_CENTER,
                format!("{theta}°"),
                FontId::proportional(11.0),
                color,
            );
        }
    }
    for phi in (0..360).step_by(30) {
        painter.line_segment([at(step.min(limit), f64::from(phi)), at(limit, f64::from(phi))], faint);
    }
}

fn outlined(painter: &Painter, shape: impl Fn(Stroke) -> Shape) {
    painter.add(shape(SHADOW));
    painter.add(shape(MARK));
}

fn draw_marks(painter: &Painter, frame: &PlotFrame, marks: &Marks, picture: &Picture) {
    if let Some(region) = marks.region {
        let rect = region_rect(frame, &region);
        outlined(painter, |stroke| match region.outline {
            RegionOutline::Rectangle => Shape::rect_stroke(rect, 0.0, stroke, egui::StrokeKind::Middle),
            RegionOutline::Ellipse => Shape::ellipse_stroke(rect.center(), rect.size() / 2.0, stroke),
        });
        corners(&region).iter().for_each(|corner| handle(painter, frame.place(*corner)));
    }
    if let Picture::Map { field, .. } = picture {
        let line = marks.line.unwrap_or_else(|| default_line(field));
        let [start, end] = line.map(|point| frame.place(point));
        if marks.line.is_some() {
            outlined(painter, |stroke| Shape::line_segment([start, end], stroke));
            [start, end].iter().for_each(|place| handle(painter, *place));
        } else {
            let stroke = Stroke::new(1.0, Color32::from_white_alpha(110));
            painter.extend(Shape::dashed_line(&[start, end], stroke, 6.0, 5.0));
        }
    }
    if let Some(pin) = marks.pin {
        let place = frame.place(pin);
        for (a, b) in [(vec2(-7.0, 0.0), vec2(7.0, 0.0)), (vec2(0.0, -7.0), vec2(0.0, 7.0))] {
            outlined(painter, |stroke| Shape::line_segment([place + a, place + b], stroke));
        }
    }
}

fn handle(painter: &Painter, place: Pos2) {
    painter.circle(place, 4.0, Color32::WHITE, Stroke::new(1.0, Color32::from_black_alpha(180)));
}

fn region_rect(frame: &PlotFrame, region: &Region) -> Rect {
    let ((x, y), (width, height)) = (region.centre, region.half);
    Rect::from_two_pos(frame.place((x - width, y - height)), frame.place((x + width, y + height)))
}

fn corners(region: &Region) -> [(f64, f64); 4] {
    let ((x, y), (width, height)) = (region.centre, region.half);
    [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(u, v)| (x + u * width, y + v * height))
}

/// The line along x through the middle.
pub fn default_line(field: &Field) -> [(f64, f64); 2] {
    let y = 0.5 * (field.y_range.0 + field.y_range.1);
    [(field.x_range.0, y), (field.x_range.1, y)]
}

/// The mark under the pointer, if it can be dragged.
fn grab_at(marks: &Marks, tool: Tool, frame: &PlotFrame, picture: &Picture, place: Pos2) -> Option<Grab> {
    let near = |point: (f64, f64)| frame.place(point).distance(place) < REACH;
    let at = frame.point(place);
    if let Picture::Map { field, .. } = picture {
        let line = marks.line.unwrap_or_else(|| default_line(field));
        if marks.line.is_some()
            && let Some(end) = line.iter().position(|end| near(*end))
        {
            return Some(Grab::End(end));
        }
        let [start, end] = line.map(|point| frame.place(point));
        if distance_to_segment(place, start, end) < REACH {
            return Some(Grab::Line { last: at });
        }
    }
    let region = marks.region?;
    let corners = corners(&region);
    if let Some(corner) = corners.iter().position(|corner| near(*corner)) {
        return Some(Grab::Corner { fixed: corners[(corner + 2) % 4] });
    }
    let draws = matches!(tool, Tool::Rectangle | Tool::Ellipse);
    (draws && region.contains(at)).then_some(Grab::Region { last: at })
}

fn distance_to_segment(place: Pos2, start: Pos2, end: Pos2) -> f32 {
    let along = end - start;
    let part = ((place - start).dot(along) / along.length_sq().max(1e-6)).clamp(0.0, 1.0);
    (start + along * part).distance(place)
}

/// True if the button went down on a mark: dragging then moves the mark, not the view.
fn pressed_on_mark(app: &mut App, ui: &Ui, picture: &Picture) -> bool {
    let origin = ui.input(|input| input.pointer.press_origin());
    let (Some(place), Some(frame)) = (origin, app.frame) else {
        return false;
    };
    let tool = app.model.settings.tool;
    frame.rect.contains(place) && grab_at(app.model.marks(), tool, &frame, picture, place).is_some()
}

fn drag(app: &mut App, ui: &Ui, shown: &ShownPlot, picture: &Picture) {
    let ShownPlot { response, frame } = shown;
    let tool = app.model.settings.tool;
    let pointer = ui.input(|input| (input.pointer.press_origin(), input.pointer.interact_pos()));
    if response.drag_started_by(PointerButton::Primary)
        && let (Some(origin), _) = pointer
    {
        let at = frame.point(origin);
        let marks = app.model.marks();
        app.grab = grab_at(marks, tool, frame, picture, origin);
        if app.grab.is_none() {
            app.grab = begin(marks, tool, at, picture);
        }
    }
    if let (Some(grab), (_, Some(place)), true) =
        (app.grab, pointer, response.dragged_by(PointerButton::Primary))
    {
        let at = frame.point(place);
        app.grab = Some(moved(app.model.marks(), grab, at, picture));
    }
    if response.drag_stopped() {
        app.grab = None;
        let marks = app.model.marks();
        let empty = |region: &Region| {
            let size = region_rect(frame, region).size();
            size.x < 3.0 || size.y < 3.0
        };
        marks.region = marks.region.filter(|region| !empty(region));
    }
    if response.clicked() {
        let pin = response.interact_pointer_pos().map(|place| frame.point(place));
        let marks = app.model.marks();
        // A click on the pin removes it.
        let on_pin =
            marks.pin.zip(pin).is_some_and(|(old, new)| frame.place(old).distance(frame.place(new)) < REACH);
        marks.pin = pin.filter(|_| !on_pin);
    }
}

fn begin(marks: &mut Marks, tool: Tool, at: (f64, f64), picture: &Picture) -> Option<Grab> {
    match tool {
        Tool::Pan => None,
        Tool::Profile if matches!(picture, Picture::Map { .. }) => {
            marks.line = Some([at, at]);
            Some(Grab::End(1))
        }
        Tool::Profile => None,
        Tool::Rectangle | Tool::Ellipse => {
            let outline =
                if tool == Tool::Ellipse { RegionOutline::Ellipse } else { RegionOutline::Rectangle };
            marks.region = Some(Region::between(outline, at, at));
            Some(Grab::Corner { fixed: at })
        }
    }
}

fn moved(marks: &mut Marks, grab: Grab, at: (f64, f64), picture: &Picture) -> Grab {
    let shift = |point: (f64, f64), last: (f64, f64)| (point.0 + at.0 - last.0, point.1 + at.1 - last.1);
    match grab {
        Grab::Corner { fixed } => {
            if let Some(region) = &mut marks.region {
                *region = Region::between(region.outline, fixed, at);
            }
            grab
        }
        Grab::Region { last } => {
            if let Some(region) = &mut marks.region {
                region.centre = shift(region.centre, last);
            }
            Grab::Region { last: at }
        }
        Grab::End(end) => {
            if let Some(line) = &mut marks.line {
                line[end] = at;
            }
            grab
        }
        Grab::Line { last } => {
            if let Picture::Map { field, .. } = picture {
                let line = marks.line.unwrap_or_else(|| default_line(field));
                marks.line = Some(line.map(|point| shift(point, last)));
            }
            Grab::Line { last: at }
        }
    }
}

/// What the pointer reads, or the pin if the pointer is elsewhere.
fn read(app: &mut App, shown: &ShownPlot, picture: &Picture) -> Option<Cursor> {
    let ShownPlot { response, frame } = shown;
    let hovered = response.hover_pos().filter(|place| frame.rect.contains(*place));
    let at = hovered.map(|place| frame.point(place)).or(app.model.marks().pin)?;
    let mut cursor = Cursor { at, cell: None, value: None, spot: None, pinned: hovered.is_none() };
    match picture {
        Picture::Map { field, .. } => {
            cursor.cell = field.cell_at(at.0, at.1);
            cursor.value = cursor.cell.map(|cell| (field.values[cell], field.hits[cell], field.sigma[cell]));
        }
        Picture::Spots(spots) => {
            let unit = (frame.view.x.1 - frame.view.x.0) / f64::from(frame.rect.width());
            cursor.spot = spots.nearest(at, 12.0 * unit).copied();
        }
    }
    Some(cursor)
}

/// The colours with their values. Zero has a place of its own below.
fn color_bar(app: &App, ui: &Ui, rect: Rect, field: &Field, scale: &Scale) {
    let palette = palette(app, ui, scale);
    let (name, unit) = field.labels.value;
    let text = plot::Colors::of(ui).text;
    let font = FontId::proportional(12.0);
    let (factor, prefix) = scale.prefix(unit);
    let title = format!("{name}\n[{prefix}{unit}]");
    let left = rect.left() + 6.0;
    let galley = ui.painter().layout(title, font.clone(), text, rect.right() - left);
    let top = rect.top() + galley.size().y + 8.0;
    ui.painter().galley(pos2(left, rect.top()), galley, text);
    if scale.high <= scale.low && !scale.diverging {
        zero_key(ui, &palette, pos2(left, top), "0 everywhere");
        return;
    }
    let bottom = if scale.diverging { rect.bottom() - 4.0 } else { rect.bottom() - 30.0 };
    let bar = Rect::from_min_max(pos2(left, top), pos2(left + 18.0, bottom));
    let colors: Vec<Color32> = (0..=255).map(|level| color32(palette.at(f64::from(level) / 255.0))).collect();
    plot::color_bar(ui, bar, &colors, &labels(scale, factor, bar.height()));
    if !scale.diverging {
        zero_key(ui, &palette, pos2(left, rect.bottom() - 18.0), "0");
    }
}

fn zero_key(ui: &Ui, palette: &Palette, at: Pos2, label: &str) {
    let colors = plot::Colors::of(ui);
    let swatch = Rect::from_min_size(at, vec2(18.0, 16.0));
    let zero = color32(palette.zero);
    ui.painter().rect(swatch, 0.0, zero, Stroke::new(1.0, colors.line), egui::StrokeKind::Outside);
    let place = swatch.right_center() + vec2(7.0, 0.0);
    ui.painter().text(place, Align2::LEFT_CENTER, label, FontId::proportional(12.0), colors.text);
}

fn labels(scale: &Scale, factor: f64, height: f32) -> Vec<(f32, String)> {
    let count = (height / 40.0).clamp(2.0, 8.0) as usize;
    let end = |part: f32, sign: &str, value: f64| {
        (part, format!("{sign}{}", crate::format::significant(value / factor, 3)))
    };
    let mut labels: Vec<(f32, String)> = scale
        .ticks(factor, count)
        .into_iter()
        .filter(|(value, _)| scale.diverging || *value > 0.0)
        .map(|(value, label)| (scale.part(value * factor) as f32, label))
        .collect();
    if scale.is_log() && labels.len() < 2 {
        labels = vec![end(0.0, "", scale.low), end(1.0, "", scale.high)];
    } else if scale.is_log() && scale.cut {
        labels[0].1.insert(0, '≤');
    }
    if scale.saturated {
        labels.retain(|(part, _)| *part < 1.0 - 14.0 / height);
        labels.push(end(1.0, "≥", scale.high));
    }
    labels
}

fn wavelength_bar(ui: &Ui, rect: Rect, spots: &Spots) {
    let text = plot::Colors::of(ui).text;
    let left = rect.left() + 6.0;
    let font = FontId::proportional(12.0);
    let galley = ui.painter().layout("Wavelength\n[µm]".into(), font, text, rect.right() - left);
    let top = rect.top() + galley.size().y + 8.0;
    ui.painter().galley(pos2(left, rect.top()), galley, text);
    if spots.spots.is_empty() {
        return;
    }
    let mut distinct: Vec<f64> = spots.spots.iter().map(|spot| spot.wavelength).collect();
    distinct.sort_by(f64::total_cmp);
    distinct.dedup();
    const MOST: usize = 12;
    if distinct.len() <= MOST {
        for (index, wavelength) in distinct.iter().rev().enumerate() {
            let place = pos2(left + 6.0, top + 8.0 + 20.0 * index as f32);
            ui.painter().circle_filled(place, 5.0, wavelength_color(ui, *wavelength, spots.wavelengths));
            let label = value(*wavelength, "");
            let at = place + vec2(12.0, 0.0);
            ui.painter().text(at, Align2::LEFT_CENTER, label, FontId::proportional(12.0), text);
        }
        return;
    }
    let (low, high) = spots.wavelengths;
    let colors: Vec<Color32> = (0..128)
        .map(|index| wavelength_color(ui, low + (high - low) * f64::from(index) / 127.0, (low, high)))
        .collect();
    let bar = Rect::from_min_max(pos2(left, top), pos2(left + 18.0, rect.bottom() - 4.0));
    let labels: Vec<(f32, String)> = ticks((low, high), 6)
        .into_iter()
        .map(|(at, label)| (((at - low) / (high - low)) as f32, label))
        .collect();
    plot::color_bar(ui, bar, &colors, &labels);
}
