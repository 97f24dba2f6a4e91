//! The viewer driven as a user would: what is read from the window is what stands in the files.

#![cfg(feature = "viewer")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use approx::assert_relative_eq;
use assert_cmd::Command;
use assert_cmd::cargo::CommandCargoExt;
use eframe::egui::{Key, Pos2, Rect, Vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use ndarray::{Array1, Array2, Array3, s};
use ndarray_npy::NpzReader;
use nsq_gpu::TraceResult;
use nsq_gpu::model::PathFilter;
use nsq_gpu::result::StoppedBy;
use nsq_gpu::result::figures::region::{Region, RegionOutline};
use nsq_gpu::result::picture::scale::{ColorMap, ScaleKind};
use nsq_gpu::result::{DetectorData, Grouping, LightPath};
use nsq_gpu::viewer::light::{RaysOfPaths, ShownLight, TableStage};
use nsq_gpu::viewer::model::{Picture, RegionFigures, Subject};
use nsq_gpu::viewer::plot::View;
use nsq_gpu::viewer::settings::{Plane, Settings};
use nsq_gpu::viewer::tracing::{Device, State};
use nsq_gpu::viewer::two_results::ComparisonMode;
use nsq_gpu::viewer::{App, Model, screenshot};
use serde_json::{Value, json};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const RAYS: &str = "20000";

fn scene_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(format!("{name}.json"))
}

fn skip(test: &str, reason: &str) {
    // Straight to the stream: the test runner hides what a passing test prints.
    let _ = writeln!(std::io::stderr(), "SKIPPED: {test}: {reason}");
}

fn has_adapter(test: &str) -> bool {
    let found = !nsq_gpu::gpu::list_adapters().is_empty();
    if !found {
        skip(test, "no adapter");
    }
    found
}

/// Folders of results that `nsq-gpu trace` wrote, each traced once.
fn results(scene: &str, seed: u64) -> PathBuf {
    static FOLDER: OnceLock<TempDir> = OnceLock::new();
    static TRACED: std::sync::Mutex<Vec<PathBuf>> = std::sync::Mutex::new(Vec::new());
    let folder = FOLDER.get_or_init(|| tempfile::tempdir().unwrap());
    let path = folder.path().join(format!("{scene}_{seed}"));
    let mut traced = TRACED.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    if !traced.contains(&path) {
        let mut command = Command::cargo_bin("nsq-gpu").unwrap();
        command.arg("trace").arg(scene_path(scene)).args(["-n", RAYS, "--seed", &seed.to_string(), "-o"]);
        command.arg(&path).args(["--standard-error", "on"]).assert().success();
        traced.push(path.clone());
    }
    path
}

fn model(path: &Path) -> Model {
    Model::open(path, Settings::default(), Device::default(), Arc::new(|| {})).unwrap()
}

type Window = Harness<'static, App>;

fn window(model: Model) -> Window {
    let mut window = Harness::builder()
        .with_size(Vec2::new(1440.0, 900.0))
        .with_max_steps(30)
        .build_ui_state(|ui, app: &mut App| app.ui(ui), App::new(model));
    window.run();
    window
}

fn click(window: &mut Window, label: &str) {
    window.get_by_label(label).click();
    window.run();
}

/// Where a point of the plot lies on the screen.
fn place(window: &Window, point: (f64, f64)) -> Pos2 {
    window.state().frame().expect("a plot is shown").place(point)
}

fn hover(window: &mut Window, point: (f64, f64)) {
    let place = place(window, point);
    window.hover_at(place);
    window.run();
}

fn drag(window: &mut Window, from: (f64, f64), to: (f64, f64)) {
    let (from, to) = (place(window, from), place(window, to));
    window.hover_at(from);
    window.run();
    window.drag_at(from);
    window.run();
    window.hover_at(from + (to - from) * 0.5);
    window.run();
    window.hover_at(to);
    window.run();
    window.drop_at(to);
    window.run();
}

fn npz(dir: &Path, file: &str) -> NpzReader<File> {
    NpzReader::new(File::open(dir.join(file)).unwrap()).unwrap()
}

/// A map in a file, its brightest cell, and where the middle of that lies.
struct MapFile {
    cell: (usize, usize),
    middle: (f64, f64),
    values: Array2<f64>,
    hits: Array2<u64>,
}

fn map_file(dir: &Path, file: &str) -> MapFile {
    let mut npz = npz(dir, file);
    let values: Array2<f64> = npz.by_name("irradiance").unwrap();
    let hits: Array2<u64> = npz.by_name("hits").unwrap();
    let x: Array1<f64> = npz.by_name("x_coords").unwrap();
    let y: Array1<f64> = npz.by_name("y_coords").unwrap();
    let (cell, _) = values.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap();
    MapFile { cell, middle: (x[cell.1], y[cell.0]), values, hits }
}

#[test]
fn results_read_back_are_those_that_were_written() {
    if !has_adapter("results_read_back_are_those_that_were_written") {
        return;
    }
    for scene in ["cemented_achromat_auto", "telephoto_spectral", "cooke_triplet"] {
        let read = TraceResult::read(&results(scene, 0)).unwrap();
        let mut window = window(model(&scene_path(scene)));
        window.state_mut().model.run.num_rays = RAYS.parse().unwrap();
        window.state_mut().model.trace();
        finish(&mut window);
        let traced = window.state().model.a().unwrap();
        assert_eq!(read.ledger, traced.ledger, "{scene}");
        assert_eq!(read.surfaces, traced.surfaces, "{scene}");
        assert_eq!(read.diagnostics, traced.diagnostics, "{scene}");
        assert_eq!(read.detectors.len(), traced.detectors.len());
        for (read, traced) in read.detectors.iter().zip(&traced.detectors) {
            assert_eq!((&read.name, read.absorb), (&traced.name, traced.absorb));
            assert_eq!((read.total_flux, read.num_rays_hit), (traced.total_flux, traced.num_rays_hit));
            match (&read.data, &traced.data) {
                // The spectrum is a sum over the map; only its last bits depend on the order.
                (DetectorData::Spectral(read), DetectorData::Spectral(traced)) => {
                    assert_eq!(read.pixels, traced.pixels);
                    let close = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-12 * b;
                    assert!(read.spectrum.iter().zip(&traced.spectrum).all(close));
                }
                (read, traced) => assert_eq!(read, traced, "{scene}"),
            }
        }
    }
}

/// Shows frames until nothing more comes by itself.
fn finish(window: &mut Window) {
    let start = Instant::now();
    while !window.state().model.is_idle() {
        assert!(start.elapsed() < Duration::from_secs(300), "the trace does not end");
        std::thread::sleep(Duration::from_millis(10));
        window.run();
    }
    window.run();
}

#[test]
fn a_broken_folder_of_results_is_refused_with_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let problem = |folder: &Path| TraceResult::read(folder).unwrap_err().to_string();
    assert!(problem(folder.path()).contains("report.json"));
    std::fs::write(folder.path().join("report.json"), "{\"schema\": 1}").unwrap();
    assert!(problem(folder.path()).contains("missing field"));
    if !has_adapter("a_broken_folder_of_results_is_refused_with_its_file") {
        return;
    }
    for file in std::fs::read_dir(results("cooke_triplet", 0)).unwrap() {
        let file = file.unwrap();
        std::fs::copy(file.path(), folder.path().join(file.file_name())).unwrap();
    }
    std::fs::write(folder.path().join("stray.npz"), "no archive").unwrap();
    assert!(problem(folder.path()).contains("stray.npz"));
}

#[test]
fn the_cursor_reads_what_stands_in_the_file() {
    if !has_adapter("the_cursor_reads_what_stands_in_the_file") {
        return;
    }
    let dir = results("cooke_triplet", 0);
    let mut window = window(model(&dir));
    click(&mut window, "stray");
    assert_eq!(window.state().model.subject, Subject::Detector("stray".into()));
    click(&mut window, "image");
    let MapFile { cell, middle, values, hits } = map_file(&dir, "image.npz");
    hover(&mut window, middle);
    let cursor = window.state().cursor().unwrap().clone();
    assert_eq!(cursor.cell, Some(cell));
    let (value, cell_hits, _) = cursor.value.unwrap();
    assert_eq!((value, cell_hits), (values[cell], hits[cell]));
    // The panel shows it to four digits.
    let shown = format!("{} mW/mm²", trimmed(&format!("{:.*}", decimals(1e3 * value), 1e3 * value)));
    assert!(window.query_all_by_label(&shown).next().is_some(), "{shown} is not shown");
}

fn decimals(value: f64) -> usize {
    (3 - value.log10().floor() as i32).max(0) as usize
}

fn trimmed(number: &str) -> &str {
    if number.contains('.') { number.trim_end_matches('0').trim_end_matches('.') } else { number }
}

#[test]
fn a_far_field_reads_alike_as_a_disc_and_over_its_angles() {
    if !has_adapter("a_far_field_reads_alike_as_a_disc_and_over_its_angles") {
        return;
    }
    let dir = results("searchlight", 0);
    let mut npz = npz(&dir, "beam.npz");
    let intensity: Array2<f64> = npz.by_name("intensity").unwrap();
    let theta: Array1<f64> = npz.by_name("theta").unwrap();
    let phi: Array1<f64> = npz.by_name("phi").unwrap();
    let cell = (intensity.nrows() / 2, intensity.ncols() / 3);
    // Neighbours share their mean: so many groups of a ring have at least the solid angle of the largest cell each.
    let largest = theta.iter().map(|theta| theta.to_radians().sin()).fold(0.0, f64::max);
    let columns = intensity.ncols();
    let num_groups = (columns as f64 * theta[cell.0].to_radians().sin() / largest * (1.0 + 1e-9)) as usize;
    assert!(num_groups > 1 && num_groups < columns);
    let first = |group: usize| group * columns / num_groups;
    let group = (0..num_groups).find(|group| first(group + 1) > cell.1).unwrap();
    let expected = intensity.slice(s![cell.0, first(group)..first(group + 1)]).mean().unwrap();
    let (theta, phi) = (theta[cell.0], phi[cell.1]);
    let mut window = window(model(&dir));
    let (sin, cos) = phi.to_radians().sin_cos();
    for (name, point) in [("Polar", (theta * cos, theta * sin)), ("Cartesian", (phi, theta))] {
        click(&mut window, name);
        hover(&mut window, point);
        let (value, ..) = window.state().cursor().unwrap().value.unwrap();
        assert_relative_eq!(value, expected, max_relative = 1e-12);
        assert!(value > 0.0, "{name}");
    }
}

#[test]
fn a_wavelength_and_the_spectrum_of_a_pixel_are_those_of_the_file() {
    if !has_adapter("a_wavelength_and_the_spectrum_of_a_pixel_are_those_of_the_file") {
        return;
    }
    let dir = results("telephoto_spectral", 0);
    let irradiance: Array3<f64> = npz(&dir, "image.npz").by_name("irradiance").unwrap();
    let mut window = window(model(&dir));
    let (ny, nx, bins) = irradiance.dim();
    for bin in [None, Some(0), Some(bins - 1)] {
        window.state_mut().model.bin = bin;
        window.run();
        let Picture::Map { field, .. } = window.state_mut().model.picture().unwrap().as_ref().clone() else {
            panic!("a spectral detector is a map")
        };
        let cell = (ny / 2, nx / 2);
        hover(&mut window, field.centre(cell));
        let (value, ..) = window.state().cursor().unwrap().value.unwrap();
        let expected: f64 = match bin {
            Some(bin) => irradiance[(cell.0, cell.1, bin)],
            None => (0..bins).map(|bin| irradiance[(cell.0, cell.1, bin)]).sum(),
        };
        assert!((value - expected).abs() <= 1e-15 * expected, "{bin:?}");
    }
    click(&mut window, "All wavelengths");
    assert_eq!(window.state().model.bin, None);
    // Lumens weigh every bin with the curve at its middle.
    click(&mut window, "lm");
    let wavelengths: Array1<f64> = npz(&dir, "image.npz").by_name("wavelengths").unwrap();
    let picture = window.state_mut().model.picture().unwrap();
    let Picture::Map { field, .. } = picture.as_ref() else { panic!("a spectral detector is a map") };
    let lux: f64 = (0..bins)
        .map(|bin| {
            irradiance[(ny / 2, nx / 2, bin)] * nsq_gpu::model::photometry::efficacy(wavelengths[bin]) * 1e6
        })
        .sum();
    assert!((field.values[(ny / 2, nx / 2)] / lux - 1.0).abs() < 1e-12);
}

#[test]
fn the_scale_follows_the_buttons() {
    if !has_adapter("the_scale_follows_the_buttons") {
        return;
    }
    let dir = results("cooke_triplet", 0);
    let MapFile { values, .. } = map_file(&dir, "image.npz");
    let largest = values.iter().copied().fold(0.0, f64::max);
    let smallest = values.iter().copied().filter(|value| *value > 0.0).fold(f64::INFINITY, f64::min);
    let mut window = window(model(&dir));
    let scale = |window: &mut Window| match window.state_mut().model.picture().unwrap().as_ref() {
        Picture::Map { scale, .. } => *scale,
        Picture::Spots(_) => panic!("an irradiance detector is a map"),
    };
    assert_eq!((scale(&mut window).low, scale(&mut window).high), (0.0, largest));
    click(&mut window, "Log");
    let log = scale(&mut window);
    assert_eq!((log.kind, log.high), (ScaleKind::Log, largest));
    assert_eq!(log.low, smallest.max(largest * 1e-6));
    click(&mut window, "Percentile");
    let percentile = scale(&mut window);
    let lit = values.iter().filter(|value| **value > 0.0).count();
    let within = values.iter().filter(|value| **value > 0.0 && **value <= percentile.high).count();
    assert_eq!(within, (0.99 * lit as f64).ceil() as usize);
}

#[test]
fn a_dragged_region_sums_the_cells_of_the_file() {
    if !has_adapter("a_dragged_region_sums_the_cells_of_the_file") {
        return;
    }
    let dir = results("cooke_triplet", 0);
    let MapFile { values, hits, .. } = map_file(&dir, "image.npz");
    let mut window = window(model(&dir));
    click(&mut window, "Rectangle");
    drag(&mut window, (-3.0, -2.0), (3.0, 2.5));
    let region = window.state_mut().model.marks().region.unwrap();
    assert_eq!(region.outline, RegionOutline::Rectangle);
    let pixel = {
        let frame = window.state().frame().unwrap();
        (frame.view.x.1 - frame.view.x.0) / f64::from(frame.rect.width())
    };
    assert!((region.half.0 - 3.0).abs() < 2.0 * pixel && (region.half.1 - 2.25).abs() < 2.0 * pixel);
    let (figures, _) = window.state_mut().region_figures().unwrap();
    let RegionFigures::Map(Some(figures)) = figures else { panic!("there are cells in the region") };
    let (rows, columns) = values.dim();
    // The detector is 36 mm wide and high.
    let at = |index: usize, count: usize| (index as f64 + 0.5) / count as f64 * 36.0 - 18.0;
    let inside = |row: usize, column: usize| {
        (at(column, columns) - region.centre.0).abs() <= region.half.0
            && (at(row, rows) - region.centre.1).abs() <= region.half.1
    };
    let mut expected = (0.0, 0);
    for ((row, column), value) in values.indexed_iter().filter(|((row, column), _)| inside(*row, *column)) {
        expected.0 += value * (36.0 / columns as f64) * (36.0 / rows as f64);
        expected.1 += hits[(row, column)];
    }
    assert!((figures.flux / expected.0 - 1.0).abs() < 1e-12);
    assert_eq!(figures.hits, expected.1);
    // Dragged from within, it moves and keeps its size. Away from the line that lies over its middle.
    drag(&mut window, (1.0, 1.5), (2.0, 4.5));
    let moved = window.state_mut().model.marks().region.unwrap();
    assert!((moved.centre.0 - region.centre.0 - 1.0).abs() < 2.0 * pixel, "{moved:?} {region:?}");
    assert!((moved.centre.1 - region.centre.1 - 3.0).abs() < 2.0 * pixel);
    assert!((moved.half.0 - region.half.0).abs() < 1e-9);
    click(&mut window, "Clear");
    assert_eq!(window.state_mut().model.marks().region, None);
}

#[test]
fn a_profile_is_drawn_and_dragged() {
    if !has_adapter("a_profile_is_drawn_and_dragged") {
        return;
    }
    let mut window = window(model(&results("cooke_triplet", 0)));
    // The line that is there at first can be dragged with any tool, and the view stays.
    let view = window.state().frame().unwrap().view;
    drag(&mut window, (-10.0, 0.0), (-10.0, 6.0));
    let line = window.state_mut().model.marks().line.unwrap();
    assert!((line[0].1 - 6.0).abs() < 0.2 && (line[1].1 - line[0].1).abs() < 1e-9, "{line:?}");
    assert_eq!(window.state().frame().unwrap().view, view);
    window.key_press(Key::L);
    window.run();
    drag(&mut window, (-8.0, -8.0), (8.0, -4.0));
    let line = window.state_mut().model.marks().line.unwrap();
    assert!((line[0].0 + 8.0).abs() < 0.2 && (line[1].0 - 8.0).abs() < 0.2, "{line:?}");
    // One end alone.
    drag(&mut window, line[1], (8.0, 8.0));
    let bent = window.state_mut().model.marks().line.unwrap();
    assert_eq!(bent[0], line[0]);
    assert!((bent[1].1 - 8.0).abs() < 0.2);
}

#[test]
fn two_results_are_compared_cell_by_cell() {
    if !has_adapter("two_results_are_compared_cell_by_cell") {
        return;
    }
    let (a, b) = (results("cooke_triplet", 0), results("cooke_triplet", 1));
    let MapFile { values: of_a, hits: hits_a, .. } = map_file(&a, "image.npz");
    let MapFile { values: of_b, hits: hits_b, .. } = map_file(&b, "image.npz");
    // Where a ray came to both, both errors are known.
    let hits_of_both = |cell: &(usize, usize)| hits_a[*cell].min(hits_b[*cell]);
    let (cell, _) = hits_a.indexed_iter().max_by_key(|(cell, _)| hits_of_both(cell)).unwrap();
    assert!(hits_of_both(&cell) > 0);
    let coordinate = |name: &str, index: usize| {
        let array: Array1<f64> = npz(&a, "image.npz").by_name(name).unwrap();
        array[index]
    };
    let middle = (coordinate("x_coords", cell.1), coordinate("y_coords", cell.0));
    let mut window = window(model(&a));
    window.get_by_label("Folder of B").focus();
    window.run();
    window.get_by_label("Folder of B").type_text(&b.display().to_string());
    window.run();
    click(&mut window, "Open");
    assert!(window.state().model.b().is_some(), "{:?}", window.state().model.messages);
    let read = |window: &mut Window| {
        hover(window, middle);
        window.state().cursor().unwrap().value.unwrap().0
    };
    assert_eq!(read(&mut window), of_a[cell]);
    let common = |window: &mut Window| match window.state_mut().model.picture().unwrap().as_ref() {
        Picture::Map { scale, .. } => *scale,
        Picture::Spots(_) => panic!("an irradiance detector is a map"),
    };
    let scale_of_a = common(&mut window);
    click(&mut window, "B");
    assert_eq!(read(&mut window), of_b[cell]);
    assert_eq!(common(&mut window), scale_of_a);
    click(&mut window, "A − B");
    assert_eq!(read(&mut window), of_a[cell] - of_b[cell]);
    click(&mut window, "(A − B) / σ");
    assert_eq!(window.state().model.settings.comparison, ComparisonMode::Significance);
    let sigma = |dir: &Path| {
        let errors: Array2<f64> = npz(dir, "image.npz").by_name("standard_error").unwrap();
        errors[cell]
    };
    let both = sigma(&a).hypot(sigma(&b));
    assert!(both > 0.0);
    let expected = (of_a[cell] - of_b[cell]) / both;
    assert!((read(&mut window) - expected).abs() < 1e-12 * expected.abs().max(1.0));
    click(&mut window, "End comparison");
    assert_eq!(read(&mut window), of_a[cell]);
}

#[test]
fn rays_of_a_database_are_read_one_by_one() {
    if !has_adapter("rays_of_a_database_are_read_one_by_one") {
        return;
    }
    let dir = results("cemented_achromat_auto", 0);
    let mut npz = npz(&dir, "before.npz");
    let flux: Array1<f64> = npz.by_name("flux").unwrap();
    let ids: Array1<u64> = npz.by_name("ray_id").unwrap();
    let mut window = window(model(&dir));
    let (figures, _) = window.state_mut().region_figures().unwrap();
    let RegionFigures::Spots(figures) = figures else { panic!("a ray database is shown as spots") };
    assert_eq!(figures.num_rays, flux.len() as u64);
    assert!((figures.flux / flux.sum() - 1.0).abs() < 1e-12);
    for name in ["Directions", "Spot diagram"] {
        click(&mut window, name);
        let picture = window.state_mut().model.picture().unwrap();
        let Picture::Spots(spots) = picture.as_ref() else { panic!("a ray database is shown as spots") };
        hover(&mut window, spots.spots[7].at);
        let spot = window.state().cursor().unwrap().spot.unwrap();
        let row = ids.iter().zip(&flux).position(|(id, flux)| (*id, *flux) == (spot.ray_id, spot.flux));
        assert!(row.is_some(), "{spot:?} is no ray of the file");
    }
}

#[test]
fn a_trace_is_paused_resumed_stopped_and_restarted() {
    if !has_adapter("a_trace_is_paused_resumed_stopped_and_restarted") {
        return;
    }
    let mut window = window(model(&scene_path("cooke_triplet")));
    window.state_mut().model.run.num_rays = 1 << 40;
    click(&mut window, "Trace");
    let wait = |window: &mut Window, done: &dyn Fn(&Model) -> bool| {
        let start = Instant::now();
        while !done(&window.state().model) {
            assert!(start.elapsed() < Duration::from_secs(300), "{:?}", window.state().model.messages);
            std::thread::sleep(Duration::from_millis(5));
            window.run();
        }
    };
    let state = |model: &Model| model.job().unwrap().state();
    // Results come while it traces, and each of them is whole.
    wait(&mut window, &|model| model.revision() >= 2);
    let live = window.state().model.a().unwrap().clone();
    assert!(live.run.partial && live.ledger.closes() && live.num_rays_total > 0);
    click(&mut window, "Pause");
    wait(&mut window, &|model| state(model) == State::Paused);
    window.run();
    let paused = window.state().model.a().unwrap().num_rays_total;
    assert_eq!(paused, window.state().model.job().unwrap().progress().0, "what is shown is what is traced");
    // Meanwhile the window does what it is told.
    click(&mut window, "Log");
    assert_eq!(window.state().model.settings.scale, ScaleKind::Log);
    assert_eq!(state(&window.state().model), State::Paused);
    click(&mut window, "Resume");
    wait(&mut window, &|model| model.a().unwrap().num_rays_total > paused);
    click(&mut window, "Stop");
    wait(&mut window, &|model| state(model) == State::Finished && !model.a().unwrap().run.adapter.is_empty());
    window.run();
    assert!(window.state().model.a().unwrap().run.partial);
    // Another trace, to its end: the bits of the command.
    window.state_mut().model.run.num_rays = RAYS.parse().unwrap();
    window.state_mut().model.run.seed = 1;
    click(&mut window, "Restart");
    finish(&mut window);
    let shown = window.state().model.a().unwrap();
    let written = TraceResult::read(&results("cooke_triplet", 1)).unwrap();
    assert_eq!(shown.detectors, written.detectors);
    assert_eq!(shown.ledger, written.ledger);
}

/// The target and the time limit of the options end a trace as those of the command do, and stand in the copied command.
#[test]
fn a_trace_ends_at_its_target_or_its_time() {
    if !has_adapter("a_trace_ends_at_its_target_or_its_time") {
        return;
    }
    let mut window = window(model(&scene_path("bench_cavity")));
    window.state_mut().model.run.num_rays = 1 << 40;
    click(&mut window, "Target error");
    assert_eq!(window.state().model.run.target_error, Some(0.01));
    window.state_mut().model.run.target_error = Some(0.1);
    click(&mut window, "Trace");
    finish(&mut window);
    let shown = window.state().model.a().unwrap();
    assert_eq!((shown.run.stopped_by, shown.run.partial), (Some(StoppedBy::TargetError), true));
    assert!(shown.relative_error.unwrap() <= 0.1);
    assert!(window.query_by_label_contains("target met").is_some());
    let command = window.state().model.command();
    assert!(command.contains("--target-error 10%") && !command.contains("--time-limit"), "{command}");
    let folder = tempfile::tempdir().unwrap();
    let arguments = command.split(' ').skip(1).map(|word| match word {
        "results" => folder.path().join("results").display().to_string(),
        word => word.to_string(),
    });
    Command::cargo_bin("nsq-gpu").unwrap().args(arguments).assert().success();
    let written = TraceResult::read(&folder.path().join("results")).unwrap();
    assert_eq!(window.state().model.a().unwrap().detectors, written.detectors);

    click(&mut window, "Target error");
    click(&mut window, "Time limit");
    assert_eq!(window.state().model.run.target_error, None);
    assert_eq!(window.state().model.run.time_limit, Some(Duration::from_secs(30)));
    window.state_mut().model.run.time_limit = Some(Duration::from_millis(300));
    click(&mut window, "Restart");
    finish(&mut window);
    assert_eq!(window.state().model.a().unwrap().run.stopped_by, Some(StoppedBy::TimeLimit));
    assert!(window.state().model.command().contains("--time-limit 0.3s"));
}

#[test]
fn keys_reach_the_plot() {
    if !has_adapter("keys_reach_the_plot") {
        return;
    }
    let mut window = window(model(&results("cooke_triplet", 0)));
    window.get_by_label("Plot: irradiance").focus();
    window.run();
    let width = |window: &Window| {
        let view = window.state().frame().unwrap().view;
        view.x.1 - view.x.0
    };
    let home = window.state().frame().unwrap().view;
    window.key_press(Key::Plus);
    window.run();
    assert!((width(&window) * 1.25 / (home.x.1 - home.x.0) - 1.0).abs() < 1e-6);
    window.key_press(Key::ArrowRight);
    window.run();
    assert!(window.state().frame().unwrap().view.x.0 > home.x.0);
    window.key_press(Key::Num0);
    window.run();
    assert_eq!(window.state().frame().unwrap().view, home);
    window.key_press(Key::PageDown);
    window.run();
    assert_eq!(window.state().model.subject, Subject::Detector("stray".into()));
}

#[test]
fn the_side_view_shows_the_scene_and_its_rays() {
    if !has_adapter("the_side_view_shows_the_scene_and_its_rays") {
        return;
    }
    let mut window = window(model(&results("cooke_triplet", 0)));
    click(&mut window, "Side view with rays");
    finish(&mut window);
    let paths = window.state_mut().model.paths().expect("rays are recorded");
    let mut rays: Vec<i64> = paths.ray_id.to_vec();
    rays.dedup();
    assert_eq!(rays.len(), 300);
    assert!(window.query_by_label("Plot: scene").is_some());
    for plane in ["z–x", "x–y", "flux"] {
        click(&mut window, plane);
    }
}

/// The view that is asked for is on the screen: the tighter range to its ends, the other one in its middle.
#[test]
fn the_side_view_shows_the_part_that_is_asked_for() {
    if !has_adapter("the_side_view_shows_the_part_that_is_asked_for") {
        return;
    }
    let mut window = window(model(&results("searchlight", 0)));
    let view = |window: &Window| window.state().frame().unwrap().view;
    let ((low, high), (bottom, top)) = ((-31.0, -24.0), (-61.0, 61.0));
    window.state_mut().show_side_view(Plane::ZY, View::new((low, high), (bottom, top)));
    window.run();
    assert_eq!(window.state().model.subject, Subject::Scene);
    let View { x, y } = view(&window);
    assert!((y.0 - bottom).abs() < 1e-9 && (y.1 - top).abs() < 1e-9, "{y:?}");
    assert!((x.0 + x.1 - low - high).abs() < 1e-9 && x.0 < low && x.1 > high, "{x:?}");
    let frame = window.state().frame().unwrap();
    let (across, up) = (frame.place((1.0, 0.0)).x - frame.place((0.0, 0.0)).x, frame.place((0.0, 0.0)).y);
    assert!(
        (across / (up - frame.place((0.0, 1.0)).y) - 1.0).abs() < 1e-3,
        "a millimetre is as long along both axes"
    );
    // Other planes are as they were, and the key for the whole is that of the user's own zoom.
    click(&mut window, "x–y");
    assert!(view(&window).y.1 > 90.0);
    click(&mut window, "z–y");
    assert_eq!(view(&window), frame.view);
    window.get_by_label("Plot: scene").focus();
    window.run();
    window.key_press(Key::Num0);
    window.run();
    assert!(view(&window).y.1 > 90.0);
}

#[test]
fn what_is_shown_is_exported() {
    if !has_adapter("what_is_shown_is_exported") {
        return;
    }
    let dir = results("cooke_triplet", 0);
    let folder = tempfile::tempdir().unwrap();
    let mut window = window(model(&dir));
    window.state_mut().set_export_folder(folder.path());
    for button in [
        "Figure of the detector (PNG)",
        "Values that are shown (CSV)",
        "Arrays of the detector (npz)",
        "All results (folder)",
    ] {
        click(&mut window, "Export");
        click(&mut window, button);
    }
    let same = |a: &Path, b: &Path| assert_eq!(std::fs::read(a).unwrap(), std::fs::read(b).unwrap());
    same(&folder.path().join("image.png"), &dir.join("image.png"));
    same(&folder.path().join("results").join("image.npz"), &dir.join("image.npz"));
    let values: Array2<f64> = npz(folder.path(), "image.npz").by_name("irradiance").unwrap();
    let csv = std::fs::read_to_string(folder.path().join("image.csv")).unwrap();
    assert_eq!(csv.lines().count(), values.len() + 1);
    let shown: f64 =
        csv.lines().skip(1).map(|line| line.split(',').nth(2).unwrap().parse::<f64>().unwrap()).sum();
    assert!((shown / values.sum() - 1.0).abs() < 1e-12);
    assert!(window.state().model.command().contains("--seed 0"));
}

/// A window of a scene whose light was followed.
fn followed(scene: &str) -> Window {
    let mut window = window(model(&scene_path(scene)));
    window.state_mut().model.run.num_rays = RAYS.parse().unwrap();
    window.state_mut().model.trace();
    click(&mut window, "Paths");
    assert_eq!(window.state().model.light.stage(), TableStage::None);
    click(&mut window, "Follow light");
    finish(&mut window);
    assert_eq!(window.state().model.light.stage(), TableStage::Listed);
    window
}

/// The values that the plot shows.
fn values(window: &mut Window) -> Array2<f64> {
    let picture = window.state_mut().model.picture().unwrap();
    let Picture::Map { field, .. } = picture.as_ref() else { panic!("the detector is a map") };
    field.values.clone()
}

/// The values of a trace of the same rays that keeps only what an expression says.
fn values_where(scene: &str, detector: &str, filter: &str) -> Array2<f64> {
    let mut model = model(&scene_path(scene));
    let parsed = PathFilter::parse(filter, &model.scene().unwrap().ir).unwrap();
    model.run.filter = Some(Arc::new(parsed));
    model.run.num_rays = RAYS.parse().unwrap();
    model.subject = Subject::Detector(detector.into());
    model.trace();
    assert!(
        model.command().contains(" --where ") && model.command().contains(" --guide "),
        "{}",
        model.command()
    );
    let mut window = window(model);
    finish(&mut window);
    assert!(window.query_by_label(&format!("where {filter}")).is_some());
    values(&mut window)
}

fn path_rows(window: &Window) -> Vec<LightPath> {
    window.state().model.light.rows().to_vec()
}

/// A click shows one path's map. A trace with the row's expression has the same light there, by rays that all follow the path.
/// Ticked maps add up to the bit.
#[test]
fn paths_are_shown_alone_and_add_up() {
    if !has_adapter("paths_are_shown_alone_and_add_up") {
        return;
    }
    let mut window = followed("cooke_triplet");
    let rows = path_rows(&window);
    assert!(rows.len() > 5, "{} rows", rows.len());
    assert_eq!((rows[0].reflections, rows[1].reflections), (0, 2), "a ghost is one row: {rows:?}");
    let whole = values(&mut window);
    for row in [&rows[1], &rows[0]] {
        click(&mut window, &row.sequence);
        assert_eq!(window.state().model.light.shown(), ShownLight::Row(row.rank as usize - 1));
        assert!(window.query_by_label_contains(&format!("Path {}: ", row.rank)).is_some());
        let alone = values(&mut window);
        let guided = values_where("cooke_triplet", "image", row.filter.as_ref().unwrap());
        let error = row.standard_error.unwrap() / row.flux;
        assert!(
            (guided.sum() / alone.sum() - 1.0).abs() < 5.0 * error + 1e-3,
            "{}",
            guided.sum() / alone.sum()
        );
        let detector = window.state().model.detector().unwrap();
        assert!((detector.total_flux / row.flux - 1.0).abs() < 1e-12);
        assert_eq!(detector.num_rays_hit, row.num_rays);
    }
    // A second click shows all light again.
    click(&mut window, &rows[0].sequence);
    assert_eq!(values(&mut window), whole);
    click(&mut window, "Tick path 2");
    let second = values(&mut window);
    click(&mut window, "Tick path 3");
    assert_eq!(window.state().model.light.shown(), ShownLight::Ticked);
    let both = values(&mut window);
    assert!(both.sum() > second.sum());
    click(&mut window, "Tick path 2");
    let third = values(&mut window);
    let rounding = 1e-15 * both.sum();
    assert!((&second + &third - &both).iter().all(|difference| difference.abs() <= rounding));
    click(&mut window, "All");
    assert_eq!(values(&mut window), whole, "all rows are the detector's map");
    click(&mut window, "All but the direct light");
    let ghosts = values(&mut window);
    let guided = values_where("cooke_triplet", "image", "reflections > 0 or scatterings > 0");
    let flux: f64 = rows[1..].iter().map(|row| row.flux).sum();
    let error = rows[1..].iter().map(|row| row.standard_error.unwrap().powi(2)).sum::<f64>().sqrt() / flux;
    assert!(
        (guided.sum() / ghosts.sum() - 1.0).abs() < 5.0 * error + 1e-3,
        "{}",
        guided.sum() / ghosts.sum()
    );
    assert!(ghosts.sum() > 0.0 && ghosts.sum() < 0.1 * whole.sum());
    click(&mut window, "None");
    assert_eq!((window.state().model.light.shown(), values(&mut window)), (ShownLight::Whole, whole));
}

/// A sequence that is cut off in its row stands whole beside the pointer.
#[test]
fn a_sequence_that_is_cut_off_shows_whole_on_hover() {
    if !has_adapter("a_sequence_that_is_cut_off_shows_whole_on_hover") {
        return;
    }
    let mut window = followed("stacked_plates_ghosts");
    click(&mut window, "sequence");
    finish(&mut window);
    let rows = path_rows(&window);
    let row = rows.iter().take(20).max_by_key(|row| row.sequence.len()).unwrap();
    let place = window.get_by_label(&row.sequence).rect().center();
    window.hover_at(place);
    // A pointer that rests shows a hint after half a second.
    for _ in 0..60 {
        window.step();
    }
    let whole = format!("{}\n", row.sequence);
    let hint = window.query_by_label_contains(&whole);
    let hint = hint.unwrap_or_else(|| panic!("no hint has {}", row.sequence));
    let screen = Rect::from_min_size(Pos2::ZERO, Vec2::new(1440.0, 900.0));
    assert!(screen.contains_rect(hint.rect()), "{:?} is cut off", hint.rect());
}

/// Where not every row has a map, the rest is what the detector has besides.
#[test]
fn what_has_no_map_of_its_own_is_the_rest() {
    if !has_adapter("what_has_no_map_of_its_own_is_the_rest") {
        return;
    }
    let mut window = followed("stacked_plates_ghosts");
    click(&mut window, "sequence");
    finish(&mut window);
    assert_eq!(window.state().model.light.group(), Grouping::Sequence);
    let listing = window.state().model.light.listing().unwrap().clone();
    let rest = listing.rest().expect("there are more than 50 sequences");
    assert!(!listing.has_map(50) && listing.table.paths.len() == 50 + rest.num_rows);
    let whole = values(&mut window);
    click(&mut window, "All");
    assert!(window.state().model.light.rest_is_ticked());
    assert_eq!(values(&mut window), whole);
    window.state_mut().model.light.tick_none();
    window.state_mut().model.light.tick_rest(true);
    window.run();
    let detector = window.state().model.detector().unwrap();
    assert!((detector.total_flux / rest.flux - 1.0).abs() < 1e-9);
    // A row without a map cannot be ticked, and a row that is not there does nothing.
    let light = &mut window.state_mut().model.light;
    light.tick_none();
    light.tick(50, true);
    light.tick(usize::MAX, true);
    light.click(usize::MAX);
    assert_eq!(light.shown(), ShownLight::Whole);
}

/// The side view has the rays of the row, each up to its arrival; those of ticked rows are those of all of them.
#[test]
fn the_side_view_shows_the_rays_of_a_path() {
    if !has_adapter("the_side_view_shows_the_rays_of_a_path") {
        return;
    }
    for scene in ["cooke_triplet", "split_ghosts"] {
        let mut window = followed(scene);
        let rows = path_rows(&window);
        let is_rare = |row: &&LightPath| row.reflections > 1 && (5..90).contains(&row.num_rays);
        let row = rows.iter().find(is_rare).expect("there is a rare ghost");
        let detector = row.detector.clone().unwrap();
        click(&mut window, &row.sequence);
        click(&mut window, "Side view with rays");
        finish(&mut window);
        let Some(RaysOfPaths::Found(rays)) = window.state_mut().model.light_rays() else {
            panic!("{scene}: the rays are not found")
        };
        assert_eq!(rays.num_arrivals as u64, row.num_rays, "{scene}: every ray of the row is found");
        let columns = &rays.columns;
        let arrivals = columns.component_name.iter().filter(|name| **name == detector).count();
        assert_eq!(arrivals, rays.num_arrivals, "{scene}: nothing but the row's light arrives");
        for [_, face] in &row.steps {
            assert!(columns.component_name.contains(face), "{scene}: {face}");
        }
        assert!(!columns.event_type.contains(&"death"), "{scene}: no ray goes on after its arrival");
        let first = row.rank as usize - 1;
        let light = &mut window.state_mut().model.light;
        light.tick(first, true);
        light.tick(0, true);
        window.run();
        finish(&mut window);
        let Some(RaysOfPaths::Found(both)) = window.state_mut().model.light_rays() else {
            panic!("{scene}: the rays are not found")
        };
        assert_eq!(both.num_arrivals, 100, "{scene}");
        // An expression has room for four paths, so that six are looked for in two parts of at most 50 rays.
        let light = &mut window.state_mut().model.light;
        light.tick_none();
        let last = rows.len() - 6;
        (last..rows.len()).for_each(|row| light.tick(row, true));
        let ticked: Vec<u64> =
            (last..rows.len()).filter(|row| light.is_ticked(*row)).map(|row| rows[row].num_rays).collect();
        window.run();
        finish(&mut window);
        match window.state_mut().model.light_rays() {
            Some(RaysOfPaths::Found(rays)) => {
                let expected: u64 = ticked.chunks(4).map(|part| part.iter().sum::<u64>().min(50)).sum();
                assert_eq!(rays.num_arrivals as u64, expected, "{scene}");
            }
            None => assert_eq!(ticked.len(), 0, "{scene}: rows without maps cannot be ticked"),
            Some(RaysOfPaths::Missing(problem)) => panic!("{scene}: {problem}"),
            Some(RaysOfPaths::Searching) => panic!("{scene}: the search does not end"),
        }
        window.state_mut().model.light.click(first);
        window.run();
        finish(&mut window);
        click(&mut window, "All light");
        assert!(window.state_mut().model.light_rays().is_none());
    }
}

#[test]
fn the_table_and_the_map_of_a_path_are_exported() {
    if !has_adapter("the_table_and_the_map_of_a_path_are_exported") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut window = followed("cooke_triplet");
    window.state_mut().set_export_folder(folder.path());
    let rows = path_rows(&window);
    click(&mut window, "Export table");
    click(&mut window, &rows[1].sequence);
    for button in
        ["Figure of the detector (PNG)", "Values that are shown (CSV)", "Arrays of the detector (npz)"]
    {
        click(&mut window, "Export");
        click(&mut window, button);
    }
    let text = std::fs::read_to_string(folder.path().join("image_table_of_paths.csv")).unwrap();
    assert_eq!(text, window.state().model.light.listing().unwrap().table.to_csv());
    assert_eq!(text.lines().count(), rows.len() + 1);
    let shown = values(&mut window);
    let written: Array2<f64> = npz(folder.path(), "image_path_2.npz").by_name("irradiance").unwrap();
    assert_eq!(written, shown);
    let csv = std::fs::read_to_string(folder.path().join("image_path_2.csv")).unwrap();
    assert_eq!(csv.lines().count(), shown.len() + 1);
    assert!(folder.path().join("image_path_2.png").exists());
    // Another trace makes the table old.
    window.state_mut().model.trace();
    assert_eq!(window.state().model.light.stage(), TableStage::None);
    click(&mut window, "Export");
    click(&mut window, "Table of paths (CSV)");
    assert!(window.state().model.messages.last().unwrap().contains("no table of paths"));
    finish(&mut window);
}

/// Rows are read, and chosen, while their maps are traced.
#[test]
fn the_table_shows_before_its_maps() {
    if !has_adapter("the_table_shows_before_its_maps") {
        return;
    }
    let mut window = followed("cooke_triplet");
    // So many rays that the second trace takes longer than a few frames.
    window.state_mut().model.run.num_rays = 1 << 40;
    click(&mut window, "Follow again");
    let deadline = Instant::now() + Duration::from_secs(300);
    let wait_for = |window: &mut Window, is_there: &dyn Fn(&TableStage) -> bool| {
        while !is_there(&window.state().model.light.stage()) {
            assert!(Instant::now() < deadline, "{:?}", window.state().model.light.stage());
            std::thread::sleep(Duration::from_millis(2));
            window.run();
        }
    };
    wait_for(&mut window, &|stage| matches!(stage, TableStage::Following(rays) if *rays > 1 << 19));
    click(&mut window, "End here");
    wait_for(&mut window, &|stage| *stage == TableStage::Mapping);
    let early = path_rows(&window);
    assert!(early.len() > 5 && !window.state().model.light.listing().unwrap().has_maps());
    assert!(window.query_by_label_contains("maps follow").is_some());
    click(&mut window, &early[1].sequence);
    assert_eq!(window.state().model.light.shown(), ShownLight::Row(1));
    assert_eq!(window.state().model.light.stage(), TableStage::Mapping, "the choice came before the maps");
    finish(&mut window);
    // What was chosen stays, and has its map now.
    assert_eq!(window.state().model.light.shown(), ShownLight::Row(1));
    assert!((window.state().model.detector().unwrap().total_flux / early[1].flux - 1.0).abs() < 1e-12);
    let sums = |row: &LightPath| (row.rank, row.sequence.clone(), row.flux, row.num_rays);
    let rows = path_rows(&window);
    assert!(early.iter().map(sums).eq(rows.iter().map(sums)), "maps change no row");
    assert!(early[1].centroid.is_none() && rows[1].centroid.is_some());
}

#[test]
fn a_table_is_ended_early_and_follows_the_detector() {
    if !has_adapter("a_table_is_ended_early_and_follows_the_detector") {
        return;
    }
    let mut window = followed("cooke_triplet");
    click(&mut window, "stray");
    finish(&mut window);
    let of_stray = |row: &LightPath| row.detector.as_deref() == Some("stray");
    assert!(path_rows(&window).iter().all(of_stray) && !path_rows(&window).is_empty());
    // The rays of a far field are found as well.
    let rare = path_rows(&window).iter().position(|row| row.num_rays < 60).unwrap();
    window.state_mut().model.light.click(rare);
    let deadline = Instant::now() + Duration::from_secs(300);
    let found = loop {
        match window.state_mut().model.light_rays() {
            Some(RaysOfPaths::Found(rays)) => break rays,
            Some(RaysOfPaths::Searching) => assert!(Instant::now() < deadline),
            Some(RaysOfPaths::Missing(problem)) => panic!("{problem}"),
            None => panic!("no path is shown"),
        }
        std::thread::sleep(Duration::from_millis(10));
        window.run();
    };
    assert_eq!(found.num_arrivals as u64, path_rows(&window)[rare].num_rays);
    window.state_mut().model.run.num_rays = 1 << 40;
    click(&mut window, "Follow again");
    while !matches!(window.state().model.light.stage(), TableStage::Following(1..)) {
        assert!(Instant::now() < deadline, "{:?}", window.state().model.light.stage());
        std::thread::sleep(Duration::from_millis(5));
        window.run();
    }
    click(&mut window, "End here");
    finish(&mut window);
    let listing = window.state().model.light.listing().unwrap().clone();
    assert!(listing.followed.tally.launched.count < 1 << 40 && !listing.table.paths.is_empty());
}

#[test]
fn a_picture_needs_no_display_and_is_the_same_each_time() {
    if !has_adapter("a_picture_needs_no_display_and_is_the_same_each_time") {
        return;
    }
    let dir = results("cooke_triplet", 0);
    let draw = || screenshot::draw(&mut App::new(model(&dir)), (1000.0, 640.0), 1.0, || false).unwrap();
    let picture = draw();
    assert_eq!(picture.size, [1000, 640]);
    assert_eq!(picture.rgba.len(), 4 * 1000 * 640);
    let mut colors: Vec<&[u8]> = picture.rgba.chunks_exact(4).collect();
    colors.sort_unstable();
    colors.dedup();
    assert!(colors.len() > 100, "only {} colours: the map is not drawn", colors.len());
    assert!(picture.rgba.chunks_exact(4).all(|pixel| pixel[3] == 255));
    assert_eq!(picture.rgba, draw().rgba);
}

/// A red beam and a blue beam on a screen: red and blue in the picture that a trace writes, and in the window.
#[test]
fn light_is_shown_in_its_colours() {
    if !has_adapter("light_is_shown_in_its_colours") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let beam = |name: &str, x: f64, wavelength: f64| {
        serde_json::json!({"type": "collimated", "name": name, "cs": {"x": x}, "aperture_radius": 3.0, "total_flux": 1.0,
            "spectrum": {"wavelengths": [wavelength], "weights": [1.0]}})
    };
    let scene = serde_json::json!({"nsq_schema_version": 1, "components": [],
        "sources": [beam("red", -5.0, 0.61), beam("blue", 5.0, 0.47)],
        "detectors": [{"type": "irradiance", "name": "screen", "cs": {"z": 10.0}, "width": 20.0, "height": 10.0,
            "num_pixels_x": 40, "num_pixels_y": 20, "color": "xyz"},
            {"type": "far_field", "name": "sky", "cs": {"z": 20.0}, "color": "xyz"}]});
    let (file, out) = (folder.path().join("beams.json"), folder.path().join("out"));
    std::fs::write(&file, scene.to_string().replace("\"screen\",", "\"screen\",\"absorb\":false,")).unwrap();
    let nsq_gpu = |arguments: &[&str]| {
        Command::cargo_bin("nsq-gpu").unwrap().args(arguments).current_dir(folder.path()).assert().success();
    };
    // A second time, over files that are its own.
    nsq_gpu(&["trace", "beams.json", "-n", "20000", "-o", "out"]);
    nsq_gpu(&["trace", "beams.json", "-n", "20000", "-o", "out"]);
    nsq_gpu(&["verify", "out"]);
    let report: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap();
    assert_eq!(report["detectors"]["screen"]["color_picture"], "screen.color.png");
    // Shares of pixels that are red, and that are blue: 610 nm lies beyond the red of sRGB, and 470 nm beyond its blue.
    let shares = |pixels: &[u8], channels: usize| {
        let num = pixels.len() / channels;
        let share = |is_it: fn(&[u8]) -> bool| {
            pixels.chunks_exact(channels).filter(|pixel| is_it(pixel)).count() as f64 / num as f64
        };
        [share(|p| p[0] > 180 && p[1] < 60 && p[2] < 60), share(|p| p[0] < 60 && p[1] < 130 && p[2] > 180)]
    };
    let [red, blue] = shares(&read_png(&out.join("screen.color.png")), 3);
    assert!(red > 0.08 && blue > 0.08, "{red} {blue}");
    // Both go into one direction.
    let sky = read_png(&out.join("sky.color.png"));
    assert!(sky.chunks_exact(3).any(|pixel| pixel[0] > 180 && pixel[1] < 60 && pixel[2] > 180));
    let mut model = model(&out);
    model.subject = Subject::Detector("screen".into());
    model.settings.color_map = ColorMap::TrueColor;
    let shown = screenshot::draw(&mut App::new(model), (1000.0, 640.0), 1.0, || false).unwrap();
    let [red, blue] = shares(&shown.rgba, 4);
    assert!(red > 0.008 && blue > 0.008, "{red} {blue}");
}

/// The main views against pictures that people have looked at; NSQ_GPU_UPDATE_SNAPSHOTS=1 takes new ones. Text may be
/// smoothed otherwise and a ray near a decision go elsewhere, so that few pixels may differ.
#[test]
fn the_main_views_look_as_they_were_reviewed() {
    if !has_adapter("the_main_views_look_as_they_were_reviewed") {
        return;
    }
    type Prepare = fn(&mut Model);
    let views: [(&str, &str, Prepare); 9] = [
        ("irradiance", "cooke_triplet", |model| {
            model.marks().region = Some(Region::between(RegionOutline::Ellipse, (-10.0, 4.0), (-4.0, 12.0)));
        }),
        ("irradiance_log", "cooke_triplet", |model| model.settings.scale = ScaleKind::Log),
        ("spectral", "telephoto_spectral", |model| {
            (model.bin, model.marks().pin) = (Some(0), Some((-1.0, -1.0)));
        }),
        ("far_field", "searchlight", |model| model.settings.scale = ScaleKind::Log),
        ("spots", "cemented_achromat_auto", |model| model.subject = Subject::Detector("before".into())),
        ("side_view", "cooke_triplet", |model| model.subject = Subject::Scene),
        ("stray", "scattering_telescope", |model| {
            model.subject = Subject::Scene;
            model.ask_for_stray("focus");
        }),
        ("paths", "cooke_triplet", |model| {
            model.light.is_open = true;
            model.follow_light();
            model.light.ask_for(2);
        }),
        ("difference", "cooke_triplet", |model| {
            let a = model.a().unwrap().clone();
            model.show(TraceResult::read(&results("cooke_triplet", 1)).unwrap());
            model.hold_as_b();
            model.show(a);
            model.settings.comparison = ComparisonMode::Difference;
        }),
    ];
    let mut shown = Vec::new();
    for (name, scene, prepare) in views {
        let mut model = model(&results(scene, 0));
        model.title = scene.into();
        prepare(&mut model);
        let picture = screenshot::draw(&mut App::new(model), (1100.0, 720.0), 0.5, || false).unwrap();
        check_as_reviewed(name, &picture);
        shown.push(picture.rgba);
    }
    // Another scale is told from the one that was reviewed.
    assert!(differing(&shown[0], &shown[1]) > 0.05);
}

/// A lamp that is even about its axis, and one that is not: their diagrams stand beside the scene.
#[test]
fn lamps_have_their_polar_diagrams() {
    if !has_adapter("lamps_have_their_polar_diagrams") {
        return;
    }
    let lamp = |name: &str, x: f64, azimuths: Value, intensity: Value| {
        json!({"type": "tabulated", "name": name, "cs": {"x": x}, "polar_angles_deg": [0, 15, 30, 45, 60, 75, 90],
            "azimuth_angles_deg": azimuths, "intensity": intensity, "intensity_units": "cd",
            "spectrum": {"wavelengths": [0.555], "weights": [1]}})
    };
    let batwing = json!([[200, 240, 300, 350, 300, 120, 0], [200, 190, 150, 100, 60, 20, 0]]);
    let scene = json!({"nsq_schema_version": 1, "components": [], "sources": [
            lamp("downlight", -400.0, json!([0]), json!([900, 860, 620, 250, 60, 10, 0])),
            lamp("aisle", 400.0, json!([0, 90]), batwing),
        ], "detectors": [{"type": "irradiance", "name": "floor", "cs": {"z": 2000}, "width": 4000, "height": 2000,
            "num_pixels_x": 40, "num_pixels_y": 20}]});
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hall.json");
    std::fs::write(&path, scene.to_string()).unwrap();
    let mut model = model(&path);
    (model.title, model.subject, model.run.num_rays) = ("hall".into(), Subject::Scene, 20_000);
    let picture = screenshot::draw(&mut App::new(model), (1100.0, 720.0), 0.75, || false).unwrap();
    check_as_reviewed("lamps", &picture);
}

/// Fails if a picture is not the reviewed one of that name, or takes it as reviewed where the user says so.
fn check_as_reviewed(name: &str, picture: &screenshot::Picture) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/snapshots/viewer_{name}.png"));
    if std::env::var_os("NSQ_GPU_UPDATE_SNAPSHOTS").is_some() {
        std::fs::write(&path, picture.to_png().unwrap()).unwrap();
    }
    let reviewed = read_png(&path);
    assert_eq!(picture.rgba.len(), reviewed.len(), "{name} has another size");
    let share = differing(&picture.rgba, &reviewed);
    if share >= 0.01 {
        let found = std::env::temp_dir().join(format!("viewer_{name}.png"));
        std::fs::write(&found, picture.to_png().unwrap()).unwrap();
        panic!(
            "{:.1} % of the pixels differ from {}: see {}",
            100.0 * share,
            path.display(),
            found.display()
        );
    }
}

fn read_png(path: &Path) -> Vec<u8> {
    let file = File::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size()];
    let length = reader.next_frame(&mut bytes).unwrap().buffer_size();
    bytes.truncate(length);
    bytes
}

/// The share of pixels of which some channel is further off than smoothing explains.
fn differing(a: &[u8], b: &[u8]) -> f64 {
    const CHANNEL: u8 = 40;
    let pairs = a.chunks_exact(4).zip(b.chunks_exact(4));
    let differ = pairs.filter(|(a, b)| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > CHANNEL));
    differ.count() as f64 / (a.len() / 4) as f64
}

/// Size, pixels and texts of a picture.
type Image = ((u32, u32), Vec<u8>, Vec<(String, String)>);

fn read_png_info(path: &Path) -> Image {
    let mut reader = png::Decoder::new(File::open(path).unwrap()).read_info().unwrap();
    let mut rgba = vec![0; reader.output_buffer_size()];
    reader.next_frame(&mut rgba).unwrap();
    let info = reader.info();
    let texts = info.uncompressed_latin1_text.iter();
    let texts = texts.map(|text| (text.keyword.clone(), text.text.clone())).collect();
    ((info.width, info.height), rgba, texts)
}

/// As an editor would write it that keeps the texts.
fn write_png_with(path: &Path, ((width, height), rgba, texts): &Image) {
    let mut encoder = png::Encoder::new(File::create(path).unwrap(), *width, *height);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    for (keyword, text) in texts {
        encoder.add_text_chunk(keyword.clone(), text.clone()).unwrap();
    }
    encoder.write_header().unwrap().write_image_data(rgba).unwrap();
}

#[test]
fn the_command_draws_a_picture() {
    if !has_adapter("the_command_draws_a_picture") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("view.png");
    let view = |arguments: &[&str]| {
        let mut command = Command::cargo_bin("nsq-gpu").unwrap();
        command.args(["view", "--screenshot"]).arg(&file).args(arguments);
        command.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").assert()
    };
    let scene = scene_path("cooke_triplet").display().to_string();
    view(&[&scene, "-n", "5000", "--detector", "stray", "--scale", "log", "--size", "900x600"])
        .success()
        .stdout("");
    let decoder = png::Decoder::new(File::open(&file).unwrap());
    let reader = decoder.read_info().unwrap();
    assert_eq!((reader.info().width, reader.info().height), (900, 600));
    view(&[&scene, "-n", "5000", "--where", "reflections == 2", "--path", "1", "--side-view"]).success();
    let picture = |arguments: &[&str]| {
        view(&[&[scene.as_str(), "-n", "5000"], arguments].concat()).success();
        read_png_info(&file).1
    };
    let whole = picture(&["--side-view"]);
    let zoomed = picture(&["--zoom", "z=-5:15,y=-9:9"]);
    assert!(differing(&whole, &zoomed) > 0.02);
    // The time that the trace took stands in the window, too.
    let again = picture(&["--zoom", "y=-9:9,z=-5:15", "--side-view"]);
    assert!(differing(&zoomed, &again) < 0.001, "{}", differing(&zoomed, &again));
    assert!(differing(&whole, &picture(&["--fit", "L3", "--fit", "L1.front"])) > 0.02);
    for (arguments, problems) in [
        (&["--detector", "nobody"][..], &["'nobody'", "image, stray"][..]),
        (&["--where", "reflexions == 2"], &["--where", "column 1", "did you mean `reflections`"]),
        (&["-n", "5000", "--path", "9999"], &["rank 9999", "ranks 1 to "]),
        (&["--path", "0"], &["--path"]),
        (&["--fit", "L33"], &["--fit \"L33\"", "did you mean `L3`?"]),
        (&["--fit", "stray"], &["--fit \"stray\"", "no place"]),
        (&["--fit", "L3", "--zoom", "z=0:1,y=0:1"], &["--zoom"]),
        (&["--zoom", "z=-5:15,y=9:-9"], &["--zoom", "`y=9:-9` is reversed; write y=-9:9"]),
        (&["--zoom", "z=4:4,y=-9:9"], &["--zoom", "`z=4:4` is empty"]),
        (&["--zoom", "-5:15,-9:9"], &["--zoom", "`-5:15` names no axis; write z=-5:30,y=-12:12"]),
        (&["--zoom", "z=-5:15"], &["two ranges"]),
        (&["--zoom", "z=-5:15,z=0:1"], &["`z` and `z` are not the axes"]),
        (&["--zoom", "z=a:15,y=0:1"], &["`a` in `z=a:15` is not a number"]),
        (&["--zoom", "z=0:nan,y=0:1"], &["`nan`"]),
        (&["--zoom", "z=0,y=0:1"], &["`z=0` has no `:`"]),
        (&["--zoom", "z=0:1e-9,y=0:1e-9"], &["--zoom", "a million times smaller", "mm"]),
    ] {
        let output = view(&[&[scene.as_str()], arguments].concat()).code(2).get_output().stderr.clone();
        let said = String::from_utf8(output).unwrap();
        assert!(problems.iter().all(|problem| said.contains(problem)), "{said}");
    }
    // Pixels that somebody has changed are no longer the program's.
    let mut image = read_png_info(&file);
    image.1[0] ^= 1;
    write_png_with(&file, &image);
    let before = std::fs::read(&file).unwrap();
    view(&[&scene, "-n", "5000"]).code(2);
    assert_eq!(std::fs::read(&file).unwrap(), before);
    view(&[&scene, "-n", "5000", "--overwrite"]).success();
    std::fs::remove_file(&file).unwrap();
    let traced = results("cooke_triplet", 0).display().to_string();
    let output = view(&[&traced, "--where", "reflections == 2"]).code(2).get_output().stderr.clone();
    assert!(String::from_utf8(output).unwrap().contains("--where is for traces"));
    let output = view(&["--help"]).success().get_output().stdout.clone();
    let help = String::from_utf8(output).unwrap();
    assert!(help.contains("nsq-gpu view lamp.json --fit lens"), "{help}");
}

#[test]
fn a_real_window_opens_traces_and_closes() {
    const TEST: &str = "a_real_window_opens_traces_and_closes";
    if !has_adapter(TEST) {
        return;
    }
    let nothing = |program: &str| std::process::Command::new(program).arg("--help").output().is_err();
    if nothing("xvfb-run") {
        return skip(TEST, "no xvfb-run (Debian: apt-get install xvfb)");
    }
    let home = tempfile::tempdir().unwrap();
    let choices = home.path().join("nsq-gpu").join("viewer.json");
    std::fs::create_dir(choices.parent().unwrap()).unwrap();
    std::fs::write(&choices, "{\"dark\": false, \"percentile\": 97.5}").unwrap();
    let program = std::process::Command::cargo_bin("nsq-gpu").unwrap();
    let mut command = Command::new("xvfb-run");
    command.args(["-a", "-s", "-screen 0 1280x800x24"]).arg(program.get_program());
    command.arg("view").arg(scene_path("cooke_triplet")).args(["-n", "20000", "--frames", "5"]);
    command.env_remove("WAYLAND_DISPLAY").env("XDG_CONFIG_HOME", home.path());
    command.timeout(Duration::from_secs(300)).assert().success().stdout("");
    // What was chosen the last time is kept, and so is the rest.
    let kept = std::fs::read_to_string(&choices).unwrap();
    assert!(kept.contains("\"dark\": false") && kept.contains("\"percentile\": 97.5"), "{kept}");
    assert!(kept.contains("\"color_map\""), "{kept}");
}

#[test]
fn what_cannot_be_shown_is_refused_before_a_window_opens() {
    let view = |arguments: &[&str]| {
        let mut command = Command::cargo_bin("nsq-gpu").unwrap();
        command.arg("view").args(arguments).env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY");
        command.env_remove("WAYLAND_SOCKET").timeout(Duration::from_secs(300));
        let output = command.output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let folder = tempfile::tempdir().unwrap();
    let broken = folder.path().join("broken.json");
    std::fs::write(&broken, "{\"nsq_schema_version\": 7}").unwrap();
    let (code, said) = view(&[broken.to_str().unwrap()]);
    assert_eq!(code, Some(3), "{said}");
    let (code, said) = view(&[folder.path().to_str().unwrap()]);
    assert!(code == Some(2) && said.contains("report.json"), "{code:?} {said}");
    if has_adapter("what_cannot_be_shown_is_refused_before_a_window_opens") && cfg!(target_os = "linux") {
        let (code, said) = view(&[scene_path("cooke_triplet").to_str().unwrap(), "-n", "1000"]);
        assert!(code == Some(2) && said.contains("--screenshot"), "{code:?} {said}");
    }
}

#[test]
fn without_the_feature_there_is_no_trace_of_a_window() {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml");
    let mut command = Command::new(env!("CARGO"));
    command.args([
        "tree",
        "-p",
        "nsq-gpu",
        "--offline",
        "--locked",
        "--no-default-features",
        "-e",
        "normal",
        "--prefix",
        "none",
    ]);
    let output = command.arg("--manifest-path").arg(manifest).assert().success().get_output().stdout.clone();
    let tree = String::from_utf8(output).unwrap();
    for name in ["egui", "eframe", "winit", "epaint", "x11rb", "wayland-client"] {
        assert!(!tree.lines().any(|line| line.starts_with(&format!("{name} "))), "{name} is there");
    }
}

#[test]
fn the_number_of_rays_is_typed_as_people_write_it() {
    if !has_adapter("the_number_of_rays_is_typed_as_people_write_it") {
        return;
    }
    let mut window = window(model(&results("cooke_triplet", 0)));
    for (text, rays) in [("2e6", 2_000_000), ("5M", 5_000_000), ("many", 5_000_000)] {
        window.get_by_label("Rays").focus();
        window.run();
        window.key_combination_modifiers(eframe::egui::Modifiers::COMMAND, &[Key::A]);
        window.run();
        window.get_by_label("Rays").type_text(text);
        window.run();
        assert_eq!(window.state().model.run.num_rays, rays, "{text}");
    }
    // What is no count goes away with the focus.
    window.get_by_label("Plot: irradiance").focus();
    window.run();
    assert_eq!(window.get_by_label("Rays").value().as_deref(), Some("5000000"));
}
