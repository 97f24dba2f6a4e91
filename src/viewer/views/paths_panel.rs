//! The panel of paths: a table of the light on the detector that is shown, by what happened to it.

use crate::error::{Error, Result};
use crate::format::thousands;
use crate::result::{Grouping, LightPath};
use crate::viewer::export::{free_path, write_new};
use crate::viewer::following::RestOfLight;
use crate::viewer::light::{Light, ShownLight, TableStage};
use crate::viewer::model::Model;
use crate::viewer::state::App;
use crate::viewer::views::{quiet, title, value};
use eframe::egui::{
    self, Align2, Checkbox, Color32, FontId, Rect, Response, Role, ScrollArea, Sense, TextWrapMode, Ui,
    WidgetInfo, WidgetText, pos2, vec2,
};
use std::path::PathBuf;

/// Height of a row \[points\].
const HEIGHT: f32 = 21.0;
const TEXT: f32 = 12.5;

/// Columns of numbers: heading, its meaning, and where the column ends \[points\]. The sequence has the rest.
const COLUMNS: [(&str, &str, f32); 6] = [
    ("#", "The rank, by flux", 48.0),
    ("flux [W]", "Flux on the detector", 114.0),
    ("share [%]", "The fraction of all light on the detector", 174.0),
    ("rays", "Rays that brought the light", 242.0),
    ("refl.", "Specular reflections", 272.0),
    ("scat.", "Scatterings", 304.0),
];
/// Where the sequence begins \[points\].
const SEQUENCE: f32 = 316.0;

const GROUPINGS: [(Grouping, &str, &str); 3] = [
    (Grouping::Sequence, "sequence", "Each sequence of events is a row"),
    (Grouping::Faces, "faces", "What the same faces reflect and scatter in the same order is a row: a ghost"),
    (Grouping::Order, "order", "What was reflected and scattered equally often is a row"),
];

/// The panel.
pub fn show(app: &mut App, ui: &mut Ui) {
    ui.horizontal(|ui| {
        title(ui, "Paths of light");
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            if ui.button("Close").on_hover_text("Hides the table; what is shown stays").clicked() {
                app.model.light.is_open = false;
            }
        });
    });
    if app.model.scene().is_none() {
        ui.label("The scene file of these results was not found, so its light cannot be followed.");
        return;
    }
    match app.model.light.stage() {
        TableStage::None => offer(&mut app.model, ui),
        TableStage::Following(done) => {
            under_way(&app.model.light, ui, &format!("Light is followed: {} rays so far", thousands(done)));
        }
        TableStage::Listing => {
            ui.label("Rows are made of the sums");
        }
        TableStage::Failed(problem) => {
            ui.colored_label(ui.visuals().error_fg_color, problem);
            offer(&mut app.model, ui);
        }
        stage @ (TableStage::Mapping | TableStage::Listed) => {
            if stage == TableStage::Mapping {
                under_way(&app.model.light, ui, "The same rays are traced again, for maps of the first rows");
            }
            controls(app, ui);
            table(&mut app.model.light, ui);
        }
    }
}

fn offer(model: &mut Model, ui: &mut Ui) {
    let hint = format!(
        "Traces {} rays and sums up light by its path. A second trace draws maps of the first rows.",
        thousands(model.run.num_rays)
    );
    if ui.button("Follow light").on_hover_text(&hint).clicked() {
        model.follow_light();
    }
    ui.label(quiet(ui, hint));
}

fn under_way(light: &Light, ui: &mut Ui, text: &str) {
    ui.horizontal(|ui| {
        ui.label(text);
        if ui.button("End here").on_hover_text("Goes on with the rays so far").clicked() {
            light.stop();
        }
    });
}

fn controls(app: &mut App, ui: &mut Ui) {
    let light = &mut app.model.light;
    ui.horizontal_wrapped(|ui| {
        ui.label("One row:");
        let mut group = light.group();
        for (choice, name, hint) in GROUPINGS {
            ui.selectable_value(&mut group, choice, name).on_hover_text(hint);
        }
        light.set_group(group);
    });
    let has_maps = light.listing().is_some_and(|listing| listing.has_maps());
    ui.horizontal_wrapped(|ui| {
        ui.add_enabled_ui(has_maps, |ui| {
            ui.label("Tick:");
            if ui.button("All").clicked() {
                light.tick_all();
            }
            if ui.button("None").clicked() {
                light.tick_none();
            }
            let hint = "Every row whose light was reflected or scattered";
            if ui.button("All but the direct light").on_hover_text(hint).clicked() {
                light.tick_all_but_direct();
            }
        });
    });
    ui.horizontal_wrapped(|ui| {
        if ui.button("Export table").on_hover_text("Into the folder of exports, as CSV").clicked() {
            let outcome = export(app);
            app.model.report(outcome, |path| format!("written: {}", path.display()));
        }
        if ui.button("Follow again").on_hover_text("With the options on the left").clicked() {
            app.model.follow_light();
        }
    });
    let light = &app.model.light;
    if let Some(problem) = light.problem() {
        ui.colored_label(ui.visuals().error_fg_color, problem);
    }
    if let Some(listing) = light.listing() {
        let followed = &listing.followed;
        let name = followed.scene.ir.detectors.get(listing.detector).map_or("", |detector| &detector.name);
        let rays = thousands(followed.tally.launched.count);
        let rows = thousands(listing.table.paths.len() as u64);
        let maps = match (listing.has_maps(), light.stage()) {
            (true, _) => "",
            (false, TableStage::Mapping) => ", maps follow",
            (false, _) => ", without maps",
        };
        let text = format!("{name}: {rows} rows, of {rays} rays with seed {}{maps}", followed.options.seed);
        ui.label(quiet(ui, text).size(11.5));
    }
    ui.add_space(4.0);
}

/// Writes the table as it is shown.
pub fn export(app: &App) -> Result<PathBuf> {
    let none = || Error::Usage("there is no table of paths yet; follow light in the panel of paths".into());
    let listing = app.model.light.listing().ok_or_else(none)?;
    let name =
        listing.followed.scene.ir.detectors.get(listing.detector).map_or("", |detector| &detector.name);
    let folder = PathBuf::from(app.export_folder.trim());
    std::fs::create_dir_all(&folder).map_err(|error| Error::file(&folder, error))?;
    let path = free_path(&folder, &format!("{name}_table_of_paths"), ".csv");
    write_new(path, &listing.table.to_csv())
}

/// A line of the table: a row, or the light without maps.
struct Line {
    cells: [String; 6],
    /// What is drawn of the sequence.
    short: String,
    sequence: String,
    hint: String,
    is_shown: bool,
    /// None if it cannot be ticked.
    tick: Option<bool>,
}

fn table(light: &mut Light, ui: &mut Ui) {
    ui.spacing_mut().item_spacing.y = 0.0;
    header(ui);
    let rest = light.listing().and_then(|listing| listing.rest());
    // Without maps all light is in the rows.
    let rest = rest.filter(|_| light.listing().is_some_and(|listing| listing.has_maps()));
    let num_rows = light.rows().len();
    let num_lines = num_rows + usize::from(rest.is_some());
    if num_lines == 0 {
        ui.label("No light came to this detector.");
    }
    ScrollArea::vertical().auto_shrink([false, false]).show_rows(ui, HEIGHT, num_lines, |ui, lines| {
        for index in lines {
            let line = match (light.rows().get(index), &rest) {
                (Some(row), _) => of_row(light, index, row),
                (None, Some(rest)) => of_rest(light, rest),
                (None, None) => continue,
            };
            let (response, ticked) = draw(ui, &line, index);
            match ticked {
                Some(is_ticked) if index < num_rows => light.tick(index, is_ticked),
                Some(is_ticked) => light.tick_rest(is_ticked),
                None => {}
            }
            if response.clicked() && index < num_rows {
                light.click(index);
            }
        }
    });
}

fn number(value: f64) -> String {
    format!("{value:.3e}")
}

fn of_row(light: &Light, index: usize, row: &LightPath) -> Line {
    let has_map = light.listing().is_some_and(|listing| listing.has_map(index));
    let mut hint = row.sequence.clone();
    if let Some(few) = row.few_rays {
        hint +=
            &format!("\n{}: flux at most {} W, with 95 % confidence", few.text(), number(few.upper_bound_95));
    } else if let Some(error) = row.standard_error.filter(|error| error.is_finite()) {
        hint += &format!("\nflux {} ± {} W", number(row.flux), number(error));
    }
    if let Some([x, y]) = row.centroid {
        hint += &format!("\ncentroid {}, {}", value(x, ""), value(y, "mm"));
    }
    if let Some(radius) = row.rms_radius {
        hint += &format!("\nRMS radius {}", value(radius, "mm"));
    }
    if let Some(peak) = row.peak_irradiance {
        hint += &format!("\npeak {}", value(peak, "W/mm²"));
    }
    match (has_map, light.stage()) {
        (true, _) => {}
        (false, TableStage::Mapping) => hint += "\nits map is being traced, if it is one of the first rows",
        (false, _) => hint += "\nno map: only the first rows have one",
    }
    Line {
        cells: [
            row.rank.to_string(),
            number(row.flux),
            format!("{:.4}", 100.0 * row.share),
            thousands(row.num_rays),
            row.reflections.to_string(),
            row.scatterings.to_string(),
        ],
        short: short(light, row),
        sequence: row.sequence.clone(),
        hint,
        is_shown: light.shown() == ShownLight::Row(index),
        tick: has_map.then(|| light.is_ticked(index)),
    }
}

/// The sequence without what all rows of the table share.
fn short(light: &Light, row: &LightPath) -> String {
    let end = row.detector.as_ref().map_or(String::new(), |name| format!(" > {name}"));
    let text = row.sequence.strip_suffix(&end).unwrap_or(&row.sequence);
    if light.group() != Grouping::Faces {
        return text.into();
    }
    let turns: Vec<&str> = text.split(" > ").filter(|part| *part != "*").collect();
    if turns.is_empty() { "direct".into() } else { turns.join(" > ") }
}

fn of_rest(light: &Light, rest: &RestOfLight) -> Line {
    let rows = thousands(rest.num_rows as u64);
    let direct = if rest.may_be_direct { "\nSome of it may be direct light." } else { "" };
    Line {
        cells: [
            String::new(),
            number(rest.flux),
            format!("{:.4}", 100.0 * rest.share),
            thousands(rest.num_rays),
            String::new(),
            String::new(),
        ],
        short: format!("the rest: {rows} rows"),
        sequence: format!("the rest: {rows} rows without a map of their own"),
        hint: format!("All light on the detector, less the light of the rows with maps.{direct}"),
        is_shown: false,
        tick: Some(light.rest_is_ticked()),
    }
}

fn header(ui: &mut Ui) {
    let (rect, _) = ui.allocate_exact_size(vec2(ui.available_width(), HEIGHT), Sense::hover());
    let color = ui.visuals().text_color().gamma_multiply(0.8);
    let font = FontId::proportional(11.5);
    let mut begin = 24.0;
    for (name, meaning, end) in COLUMNS {
        let place = pos2(rect.left() + end, rect.center().y);
        ui.painter().text(place, Align2::RIGHT_CENTER, name, font.clone(), color);
        let area =
            Rect::from_min_max(pos2(rect.left() + begin, rect.top()), pos2(rect.left() + end, rect.bottom()));
        ui.interact(area, ui.scope_id().with(("heading", name)), Sense::hover()).on_hover_text(meaning);
        begin = end;
    }
    let place = pos2(rect.left() + SEQUENCE, rect.center().y);
    ui.painter().text(place, Align2::LEFT_CENTER, "sequence", font, color);
    let line = ui.visuals().widgets.noninteractive.bg_stroke;
    ui.painter().hline(rect.x_range(), rect.bottom(), line);
}

/// Draws a line; true if the tick was changed.
fn draw(ui: &mut Ui, line: &Line, index: usize) -> (Response, Option<bool>) {
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), HEIGHT), Sense::click());
    response.widget_info(|| WidgetInfo::selected(Role::Button, true, line.is_shown, &line.sequence));
    let visuals = ui.visuals();
    let (ground, color) = match (line.is_shown, response.hovered() || response.has_focus()) {
        (true, _) => (visuals.selection.bg_fill, visuals.selection.stroke.color),
        (false, true) => (visuals.widgets.hovered.weak_bg_fill, visuals.text_color()),
        (false, false) if index % 2 == 1 => (visuals.faint_bg_color, visuals.text_color()),
        (false, false) => (Color32::TRANSPARENT, visuals.text_color()),
    };
    ui.painter().rect_filled(rect, 2.0, ground);
    let font = FontId::proportional(TEXT);
    for ((_, _, end), text) in COLUMNS.iter().zip(&line.cells) {
        let place = pos2(rect.left() + end, rect.center().y);
        ui.painter().text(place, Align2::RIGHT_CENTER, text, font.clone(), color);
    }
    let width = (rect.width() - SEQUENCE - 4.0).max(20.0);
    let text = WidgetText::from(line.short.as_str());
    let galley = text.into_galley(ui, Some(TextWrapMode::Truncate), width, font);
    let place = pos2(rect.left() + SEQUENCE, rect.center().y - galley.size().y / 2.0);
    ui.painter().galley(place, galley, color);
    let response = response.on_hover_text(&line.hint);
    let mut is_ticked = line.tick.unwrap_or(false);
    let area = Rect::from_min_size(rect.min + vec2(3.0, 0.0), vec2(20.0, HEIGHT));
    let builder =
        egui::UiBuilder::new().max_rect(area).layout(egui::Layout::left_to_right(egui::Align::Center));
    let mut corner = ui.new_child(builder);
    let label = match line.cells[0].as_str() {
        "" => "Tick the rest".to_string(),
        rank => format!("Tick path {rank}"),
    };
    let tick = corner.add_enabled(line.tick.is_some(), Checkbox::without_text(&mut is_ticked));
    tick.widget_info(|| WidgetInfo::selected(Role::CheckBox, line.tick.is_some(), is_ticked, &label));
    (response, tick.changed().then_some(is_ticked))
}
