//! Exports what is shown to files.

use crate::error::{Error, Result};
use crate::result::{Detector, TraceResult, npz_files, output, png};
use crate::viewer::export::{fields_csv, free_path, spots_csv, write_new};
use crate::viewer::model::{Picture, Subject};
use crate::viewer::state::App;
use crate::viewer::views::paths_panel;
use eframe::egui::{TextEdit, Ui};
use std::path::{Path, PathBuf};

/// The menu of exports.
pub fn menu(app: &mut App, ui: &mut Ui) {
    ui.menu_button("Export", |ui| {
        ui.label("Into the folder");
        let edit = ui.add(TextEdit::singleline(&mut app.export_folder).desired_width(260.0));
        edit.widget_info(|| {
            eframe::egui::WidgetInfo::labeled(eframe::egui::Role::TextInput, true, "Export folder")
        });
        ui.separator();
        for (name, format) in [
            ("Figure of the detector (PNG)", Format::Png),
            ("Values that are shown (CSV)", Format::Csv),
            ("Arrays of the detector (npz)", Format::Npz),
            ("Table of paths (CSV)", Format::Paths),
            ("All results (folder)", Format::All),
        ] {
            if ui.button(name).clicked() {
                let outcome = write(app, format);
                app.model.report(outcome, |path| format!("written: {}", path.display()));
                ui.close();
            }
        }
    });
}

#[derive(Clone, Copy)]
enum Format {
    Png,
    Csv,
    Npz,
    Paths,
    All,
}

fn write(app: &mut App, format: Format) -> Result<PathBuf> {
    if let Format::Paths = format {
        return paths_panel::export(app);
    }
    let folder = PathBuf::from(app.export_folder.trim());
    std::fs::create_dir_all(&folder).map_err(|error| Error::file(&folder, error))?;
    let result = app.model.a().ok_or_else(|| Error::Usage("there is no result to write yet".into()))?;
    if let Format::All = format {
        let path = free_path(&folder, "results", "");
        return output::write_all(&path, result).map(|_| path);
    }
    let Subject::Detector(name) = app.model.subject.clone() else {
        return Err(Error::Usage("no detector is shown that could be written".into()));
    };
    match format {
        Format::Csv => {
            let picture = app.model.picture().map_err(Error::Usage)?;
            let text = match picture.as_ref() {
                Picture::Map { field, .. } => fields_csv(field),
                Picture::Spots(spots) => spots_csv(spots),
            };
            let path = free_path(&folder, &file_name(app, &name), ".csv");
            write_new(path, &text)
        }
        _ => {
            let none = || Error::Usage(format!("the result has no detector '{name}'"));
            let detector = app.model.shown_light().or_else(|| result.detector(&name)).ok_or_else(none)?;
            write_detector(result, detector, &folder, &file_name(app, &name), format)
        }
    }
}

/// The name of a file of what is shown of a detector.
fn file_name(app: &App, detector: &str) -> String {
    let stem = app.model.shown_light().and_then(|_| app.model.light.stem());
    stem.map_or_else(|| detector.to_string(), |stem| format!("{detector}_{stem}"))
}

fn write_detector(
    result: &TraceResult,
    detector: &Detector,
    folder: &Path,
    name: &str,
    format: Format,
) -> Result<PathBuf> {
    match format {
        Format::Png => {
            let path = free_path(folder, name, ".png");
            png::write_detector(&path, detector, png::Style::default()).map(|()| path)
        }
        _ => {
            let path = free_path(folder, name, ".npz");
            npz_files::write_detector(&path, result, detector).map(|()| path)
        }
    }
}
