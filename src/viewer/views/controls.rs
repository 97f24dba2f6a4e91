//! The controls above a plot: what dragging does, and how values become colours.

use crate::result::DetectorData;
use crate::result::picture::scale::{ColorMap, ScaleKind};
use crate::viewer::model::Picture;
use crate::viewer::settings::Tool;
use crate::viewer::state::App;
use eframe::egui::{self, ComboBox, DragValue, Slider, Ui};

/// The line of controls above a detector.
pub fn show(app: &mut App, ui: &mut Ui, picture: Option<&Picture>) {
    ui.horizontal_wrapped(|ui| {
        for (tool, name, key) in Tool::ALL {
            let hint = format!("{} · key {}", purpose(tool), key.name());
            ui.selectable_value(&mut app.model.settings.tool, tool, name).on_hover_text(hint);
        }
        if matches!(app.model.settings.tool, Tool::Rectangle | Tool::Ellipse)
            || app.model.marks().region.is_some()
        {
            let hint = "Figures of the whole plot again";
            if ui.button("Clear").on_hover_text(hint).clicked() {
                app.model.marks().region = None;
            }
        }
        ui.separator();
        if matches!(picture, Some(Picture::Spots(_))) {
            let settings = &mut app.model.settings;
            ui.selectable_value(&mut settings.directions, false, "Spot diagram");
            ui.selectable_value(&mut settings.directions, true, "Directions");
        } else {
            scale(app, ui);
        }
        ui.separator();
        units(app, ui);
        let far_field =
            app.model.detector().is_some_and(|detector| matches!(detector.data, DetectorData::FarField(_)));
        if far_field {
            ui.separator();
            let settings = &mut app.model.settings;
            let cells = "In cells of equal solid angle: near the pole neighbours share their mean";
            ui.selectable_value(&mut settings.polar, true, "Polar").on_hover_text(cells);
            ui.selectable_value(&mut settings.polar, false, "Cartesian");
        }
    });
    wavelengths(app, ui);
}

fn purpose(tool: Tool) -> &'static str {
    match tool {
        Tool::Pan => "Drag to move, scroll to zoom, double-click for the whole",
        Tool::Profile => "Drag a line: its values are shown below",
        Tool::Rectangle => "Drag a rectangle: its figures are shown on the right",
        Tool::Ellipse => "Drag an ellipse: its figures are shown on the right",
    }
}

fn scale(app: &mut App, ui: &mut Ui) {
    let settings = &mut app.model.settings;
    for (kind, name) in ScaleKind::ALL {
        ui.selectable_value(&mut settings.scale, kind, name);
    }
    if settings.scale == ScaleKind::Percentile {
        let percentile = DragValue::new(&mut settings.percentile).range(50.0..=100.0).speed(0.05);
        ui.add(percentile.suffix(" %").max_decimals(2))
            .on_hover_text("Of the cells that are not zero, so many lie within the colours");
    }
    let name = ColorMap::ALL.iter().find(|(map, _)| *map == settings.color_map).map_or("", |(_, name)| name);
    let maps = ComboBox::from_id_salt("colours").width(74.0).selected_text(name);
    let maps = maps.show_ui(ui, |ui| {
        for (map, name) in ColorMap::ALL {
            ui.selectable_value(&mut settings.color_map, map, name);
        }
    });
    maps.response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::ComboBox, true, "Colours"));
}

fn units(app: &mut App, ui: &mut Ui) {
    let tells_wavelengths = app
        .model
        .detector()
        .is_some_and(|detector| detector.luminous.is_some() || detector.data.result().tells_wavelengths());
    let settings = &mut app.model.settings;
    ui.selectable_value(&mut settings.photometric, false, "W");
    ui.selectable_value(&mut settings.photometric, true, "lm")
        .on_hover_text("Photometric units by the CIE 1931 curve");
    if settings.photometric && !tells_wavelengths {
        let wavelength = DragValue::new(&mut app.model.wavelength).range(0.1..=20.0).speed(0.001);
        ui.add(wavelength.suffix(" µm").max_decimals(4)).on_hover_text(
            "This detector does not keep wavelengths apart: all its flux counts as light of this one",
        );
    }
}

/// The slider of a spectral detector.
fn wavelengths(app: &mut App, ui: &mut Ui) {
    let Some(map) = app.model.spectral() else {
        return;
    };
    let edges = map.wavelength_edges.to_vec();
    let last = map.wavelengths.len() - 1;
    ui.horizontal(|ui| {
        let bin = &mut app.model.bin;
        if ui.selectable_label(bin.is_none(), "All wavelengths").clicked() {
            *bin = None;
        }
        let mut at = bin.unwrap_or(0).min(last);
        ui.spacing_mut().slider_width = (ui.available_width() - 210.0).clamp(80.0, 420.0);
        let text = move |bin: f64| {
            let bin = (bin as usize).min(last);
            format!("{:.4} to {:.4} µm", edges[bin], edges[bin + 1])
        };
        let slider = Slider::new(&mut at, 0..=last).custom_formatter(move |bin, _| text(bin));
        let response = ui.add(slider);
        response.widget_info(|| egui::WidgetInfo::slider(true, at as f64, "Wavelength"));
        if response.changed() {
            *bin = Some(at);
        }
    });
}
