//! Axes with a view that the user drags, zooms and moves by keys. Every plot of the window uses them.

use crate::format::significant;
use crate::result::picture::ticks::{Tick, decades, ticks, ticks_that_fit};
use eframe::egui::{
    self, Align2, Color32, EventFilter, FontId, Key, Pos2, Rect, Response, Role, Sense, Stroke, Ui, Vec2,
    WidgetInfo, pos2, vec2,
};

/// The part of a plane that is visible.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// From left to right.
    pub x: (f64, f64),
    /// From bottom to top.
    pub y: (f64, f64),
}

/// Where a view lies on the screen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlotFrame {
    /// The rectangle on the screen.
    pub rect: Rect,
    /// The part of the plane that is visible.
    pub view: View,
}

/// The properties of a plot.
pub struct Plot<'a> {
    /// Name of the plot, for users who do not see it.
    pub name: &'a str,
    /// The view until the user moves it.
    pub home: View,
    /// True if one unit is as long along x as along y.
    pub equal: bool,
    /// Name and unit of the horizontal axis.
    pub x: (&'a str, &'a str),
    /// Name and unit of the vertical axis.
    pub y: (&'a str, &'a str),
    /// True if the vertical axis counts decades; its values are then decimal logarithms.
    pub log_y: bool,
    /// True for light lines at the ticks.
    pub grid: bool,
    /// True if dragging with the first button moves the view; other buttons always do.
    pub pans: bool,
    /// True if the view can be zoomed and moved.
    pub moves: bool,
}

/// A plot on the screen.
pub struct ShownPlot {
    /// The user's actions on the plot.
    pub response: Response,
    /// The plot's place and view.
    pub frame: PlotFrame,
}

const LABEL_SIZE: f32 = 12.0;

impl View {
    /// A view of the plane between these bounds.
    pub fn new(x: (f64, f64), y: (f64, f64)) -> Self {
        View { x, y }
    }

    /// The view grown by a fraction on each side.
    pub fn padded(self, fraction: f64) -> Self {
        let pad = |(low, high): (f64, f64)| {
            let pad = fraction * (high - low);
            (low - pad, high + pad)
        };
        View { x: pad(self.x), y: pad(self.y) }
    }

    fn size(&self) -> (f64, f64) {
        (self.x.1 - self.x.0, self.y.1 - self.y.0)
    }

    /// The view grown along one axis, until a unit is as long along both axes.
    fn with_equal_units(self, rect: Rect) -> Self {
        let (width, height) = self.size();
        let unit = (width / f64::from(rect.width())).max(height / f64::from(rect.height()));
        let around = |(low, high): (f64, f64), length: f32| {
            let (middle, half) = (0.5 * (low + high), 0.5 * unit * f64::from(length));
            (middle - half, middle + half)
        };
        View { x: around(self.x, rect.width()), y: around(self.y, rect.height()) }
    }

    fn moved(self, dx: f64, dy: f64) -> Self {
        View { x: (self.x.0 + dx, self.x.1 + dx), y: (self.y.0 + dy, self.y.1 + dy) }
    }

    fn zoomed(self, about: (f64, f64), factor: f64) -> Self {
        let zoom = |(low, high): (f64, f64), at: f64| (at - (at - low) / factor, at + (high - at) / factor);
        View { x: zoom(self.x, about.0), y: zoom(self.y, about.1) }
    }

    /// True if the view is neither so small that digits run out nor so large that the data is a dot.
    pub fn is_sensible(&self, home: &View) -> bool {
        let (width, height) = self.size();
        let (home_width, home_height) = home.size();
        let sensible = |size: f64, home: f64, (low, high): (f64, f64)| {
            size > 1e-6 * home && size < 1e3 * home && size > 1e-9 * low.abs().max(high.abs())
        };
        sensible(width, home_width, self.x) && sensible(height, home_height, self.y)
    }
}

impl PlotFrame {
    /// The place on the screen of a point of the plane.
    pub fn place(&self, (x, y): (f64, f64)) -> Pos2 {
        let part = |at: f64, (low, high): (f64, f64)| ((at - low) / (high - low)) as f32;
        pos2(
            self.rect.left() + part(x, self.view.x) * self.rect.width(),
            self.rect.bottom() - part(y, self.view.y) * self.rect.height(),
        )
    }

    /// The point of the plane at a place on the screen.
    pub fn point(&self, place: Pos2) -> (f64, f64) {
        let along = |part: f32, (low, high): (f64, f64)| low + f64::from(part) * (high - low);
        (
            along((place.x - self.rect.left()) / self.rect.width(), self.view.x),
            along((self.rect.bottom() - place.y) / self.rect.height(), self.view.y),
        )
    }
}

impl Plot<'_> {
    /// Shows the axes in `rect`, and moves the view as the user wants. `draw` paints the contents.
    pub fn show(
        &self,
        ui: &mut Ui,
        rect: Rect,
        view: &mut Option<View>,
        draw: impl FnOnce(&Ui, &egui::Painter, &PlotFrame),
    ) -> ShownPlot {
        let font = FontId::proportional(LABEL_SIZE);
        let y_ticks = |view: &View, height: f32| {
            let count = (height / 34.0).clamp(2.0, 9.0) as usize;
            if self.log_y { powers(view.y, count) } else { ticks(view.y, count) }
        };
        // Labels determine the width of the margin, but the margin does not change the choice of labels.
        let height = rect.height() - 44.0;
        let shown = view.unwrap_or(self.home);
        let widest = y_ticks(&shown, height)
            .iter()
            .map(|(_, label)| text_width(ui, label, &font))
            .fold(18.0, f32::max);
        let inner = Rect::from_min_max(
            pos2(rect.left() + widest.ceil() + 30.0, rect.top() + 8.0),
            pos2(rect.right() - 12.0, rect.bottom() - 38.0),
        );
        let home = if self.equal { self.home.with_equal_units(inner) } else { self.home };
        let response = ui.interact(inner, ui.scope_id().with(self.name), Sense::click_and_drag());
        response.widget_info(|| WidgetInfo::labeled(Role::Image, ui.is_enabled(), self.name));
        let mut frame = PlotFrame { rect: inner, view: view.unwrap_or(home) };
        if self.equal {
            frame.view = frame.view.with_equal_units(inner);
        }
        if self.moves {
            let moved = self.moved(ui, &response, frame, home);
            if moved == Some(home) {
                *view = None;
            } else if let Some(moved) = moved.filter(|moved| moved.is_sensible(&home)) {
                *view = Some(moved);
            }
            frame.view = moved.filter(|moved| moved.is_sensible(&home)).unwrap_or(frame.view);
        }
        let painter = ui.painter_at(inner);
        let colors = Colors::of(ui);
        painter.rect_filled(inner, 0.0, colors.ground);
        let x_ticks = horizontal_ticks(ui, &frame, &font);
        let y_ticks = y_ticks(&frame.view, inner.height());
        if self.grid {
            for (at, _) in &x_ticks {
                painter.vline(frame.place((*at, 0.0)).x, inner.y_range(), Stroke::new(1.0, colors.grid));
            }
            for (at, _) in &y_ticks {
                painter.hline(inner.x_range(), frame.place((0.0, *at)).y, Stroke::new(1.0, colors.grid));
            }
        }
        draw(ui, &painter, &frame);
        self.axes(ui, rect, &frame, (&x_ticks, &y_ticks), &colors);
        let stroke = if response.has_focus() { ui.visuals().selection.stroke.color } else { colors.line };
        ui.painter().rect_stroke(inner, 0.0, Stroke::new(1.0, stroke), egui::StrokeKind::Outside);
        ShownPlot { response, frame }
    }

    fn axes(
        &self,
        ui: &Ui,
        rect: Rect,
        frame: &PlotFrame,
        (x_ticks, y_ticks): (&[Tick], &[Tick]),
        colors: &Colors,
    ) {
        let font = FontId::proportional(LABEL_SIZE);
        let painter = ui.painter();
        let inner = frame.rect;
        for (at, label) in x_ticks {
            let x = frame.place((*at, 0.0)).x;
            painter.vline(x, inner.bottom()..=inner.bottom() + 4.0, Stroke::new(1.0, colors.line));
            painter.text(pos2(x, inner.bottom() + 5.0), Align2::CENTER_TOP, label, font.clone(), colors.text);
        }
        for (at, label) in y_ticks {
            let y = frame.place((0.0, *at)).y;
            painter.hline(inner.left() - 4.0..=inner.left(), y, Stroke::new(1.0, colors.line));
            painter.text(pos2(inner.left() - 6.0, y), Align2::RIGHT_CENTER, label, font.clone(), colors.text);
        }
        let name = |(name, unit): (&str, &str)| match unit {
            "" => name.to_string(),
            unit => format!("{name} [{unit}]"),
        };
        painter.text(
            pos2(inner.center().x, rect.bottom() - 1.0),
            Align2::CENTER_BOTTOM,
            name(self.x),
            font.clone(),
            colors.text,
        );
        let galley = painter.layout_no_wrap(name(self.y), font, colors.text);
        let at = pos2(rect.left() + 1.0, inner.center().y + galley.size().x / 2.0);
        painter.add(
            egui::epaint::TextShape::new(at, galley, colors.text).with_angle(-std::f32::consts::FRAC_PI_2),
        );
    }

    /// The view that the user asks for; `home` if the view should follow the data again.
    fn moved(&self, ui: &mut Ui, response: &Response, frame: PlotFrame, home: View) -> Option<View> {
        if response.double_clicked() {
            return Some(home);
        }
        let unit = |(low, high): (f64, f64), length: f32| (high - low) / f64::from(length);
        let (dx, dy) = (unit(frame.view.x, frame.rect.width()), unit(frame.view.y, frame.rect.height()));
        let mut view = frame.view;
        let pans = (self.pans && response.dragged_by(egui::PointerButton::Primary))
            || response.dragged_by(egui::PointerButton::Middle)
            || response.dragged_by(egui::PointerButton::Secondary);
        if pans {
            let Vec2 { x, y } = response.drag_delta();
            view = view.moved(-f64::from(x) * dx, f64::from(y) * dy);
        }
        if response.hovered()
            && let Some(place) = response.hover_pos()
        {
            let (scroll, pinch) = ui.input(|input| (input.smooth_scroll_delta().y, input.zoom_delta()));
            let factor = f64::from(pinch) * (f64::from(scroll) / 200.0).exp();
            if factor != 1.0 {
                view = view.zoomed(frame.point(place), factor);
            }
        }
        if response.clicked() || response.drag_started() {
            response.request_focus();
        }
        if response.has_focus() {
            match self.keys(ui, response, frame, view) {
                Keys::Home => return Some(home),
                Keys::View(moved) => view = moved,
            }
        }
        (view != frame.view).then_some(view)
    }

    fn keys(&self, ui: &mut Ui, response: &Response, frame: PlotFrame, view: View) -> Keys {
        const STEP: f64 = 0.1;
        const ZOOM: f64 = 1.25;
        let filter = EventFilter { horizontal_arrows: true, vertical_arrows: true, ..EventFilter::default() };
        ui.memory_mut(|memory| memory.set_focus_lock_filter(response.id, filter));
        let pressed = |key| ui.input(|input| input.key_pressed(key) && !input.modifiers.shift);
        if pressed(Key::Num0) || pressed(Key::Home) {
            return Keys::Home;
        }
        let (width, height) = frame.view.size();
        let middle = frame.point(frame.rect.center());
        let mut view = view;
        for (key, dx, dy) in [
            (Key::ArrowLeft, -1.0, 0.0),
            (Key::ArrowRight, 1.0, 0.0),
            (Key::ArrowUp, 0.0, 1.0),
            (Key::ArrowDown, 0.0, -1.0),
        ] {
            if pressed(key) {
                view = view.moved(dx * STEP * width, dy * STEP * height);
            }
        }
        if ui.input(|input| input.key_pressed(Key::Plus) || input.key_pressed(Key::Equals)) {
            view = view.zoomed(middle, ZOOM);
        }
        if pressed(Key::Minus) {
            view = view.zoomed(middle, 1.0 / ZOOM);
        }
        Keys::View(view)
    }
}

enum Keys {
    Home,
    View(View),
}

/// The colours of axes.
pub struct Colors {
    /// The ground behind the data.
    pub ground: Color32,
    /// Light lines.
    pub grid: Color32,
    /// Axes.
    pub line: Color32,
    /// Labels.
    pub text: Color32,
    /// The first curve.
    pub curve: Color32,
    /// The second curve.
    pub second: Color32,
}

impl Colors {
    /// The colours of the theme.
    pub fn of(ui: &Ui) -> Self {
        let visuals = ui.visuals();
        if visuals.dark_mode {
            Colors {
                ground: Color32::from_gray(38),
                grid: Color32::from_gray(54),
                line: Color32::from_gray(92),
                text: Color32::from_gray(190),
                curve: Color32::from_rgb(255, 176, 66),
                second: Color32::from_rgb(110, 190, 255),
            }
        } else {
            Colors {
                ground: Color32::from_gray(250),
                grid: Color32::from_gray(228),
                line: Color32::from_gray(150),
                text: Color32::from_gray(60),
                curve: Color32::from_rgb(200, 90, 0),
                second: Color32::from_rgb(0, 100, 190),
            }
        }
    }
}

/// Ticks of the horizontal axis, whose labels stand side by side.
fn horizontal_ticks(ui: &Ui, frame: &PlotFrame, font: &FontId) -> Vec<Tick> {
    let width = |label: &str| text_width(ui, label, font);
    let fits = |ticks: &[Tick]| {
        let widest = ticks.iter().map(|(_, label)| width(label)).fold(0.0, f32::max);
        (widest + 18.0) * ticks.len() as f32 <= frame.rect.width()
    };
    ticks_that_fit(frame.view.x, 11, fits).unwrap_or_default()
}

/// Ticks between decimal logarithms.
fn powers(range: (f64, f64), count: usize) -> Vec<Tick> {
    let label = |value: f64| match value.log10().floor() as i32 {
        -2..=3 => significant(value, 1),
        _ => format!("{value:.0e}"),
    };
    decades(range, count).map(|value| (value.log10(), label(value))).collect()
}

/// Width of a label \[points\].
pub fn text_width(ui: &Ui, text: &str, font: &FontId) -> f32 {
    ui.painter().layout_no_wrap(text.into(), font.clone(), Color32::WHITE).size().x
}

/// A stripe of colours with its ticks; `colors` run from bottom to top.
pub fn color_bar(ui: &Ui, rect: Rect, colors: &[Color32], labels: &[(f32, String)]) {
    let painter = ui.painter();
    let line = Colors::of(ui);
    let font = FontId::proportional(LABEL_SIZE);
    let height = rect.height() / colors.len() as f32;
    for (index, color) in colors.iter().enumerate() {
        let bottom = rect.bottom() - index as f32 * height;
        // A little overlap hides the seams.
        let stripe = Rect::from_min_max(
            pos2(rect.left(), (bottom - height - 0.5).max(rect.top())),
            pos2(rect.right(), bottom),
        );
        painter.rect_filled(stripe, 0.0, *color);
    }
    painter.rect_stroke(rect, 0.0, Stroke::new(1.0, line.line), egui::StrokeKind::Outside);
    for (part, label) in labels {
        let y = rect.bottom() - part * rect.height();
        painter.hline(rect.right()..=rect.right() + 4.0, y, Stroke::new(1.0, line.line));
        painter.text(
            rect.right_top() + vec2(7.0, y - rect.top()),
            Align2::LEFT_CENTER,
            label,
            font.clone(),
            line.text,
        );
    }
}
