//! Measures the viewer's frames per second while the user drags a large map. The map is at rest, or is being traced.

use crate::machine;
use crate::report::ViewerResult;
use crate::statistics::Summary;
use ndarray::Array2;
use nsq_gpu::gpu::{AdapterChoice, Gpu};
use nsq_gpu::internals::egui::{Event, Modifiers, PointerButton, Pos2, vec2};
use nsq_gpu::internals::{App, Device, Model, OffscreenTexture, RENDERER, Settings};
use nsq_gpu::result::{DetectorData, TraceResult};
use nsq_gpu::{Error, Result};
use serde_json::Value;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The window's state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// A small result is shown.
    Small,
    /// A large result is shown.
    Still,
    /// A map is traced, on a device of its own.
    Tracing,
    /// A map is traced on the device that draws.
    Shared,
}

/// Cells along each side of the map that is shown, as many as the largest detectors have.
const SHOWN: u32 = 4096;
/// Cells along each side of the map that is traced. With its squares, this map fits the bindings of all adapters.
const TRACED: u32 = 2048;
const SMALL: u32 = 64;
const NUM_RAYS: u64 = 1_000_000;
/// Frames that are not measured: in the first frames, panels find their sizes and pictures are made.
const WARM_UP: usize = 4;

/// Draws `num_frames` frames in each state, on the adapter whose name contains `adapter`.
///
/// # Errors
/// [`Error::NoAdapter`] or [`Error::Device`] if drawing is impossible.
pub fn measure(adapter: Option<&str>, num_frames: usize) -> Result<Vec<ViewerResult>> {
    [State::Small, State::Still, State::Tracing, State::Shared]
        .into_iter()
        .map(|state| measure_state(state, adapter, num_frames))
        .collect()
}

fn measure_state(state: State, adapter: Option<&str>, num_frames: usize) -> Result<ViewerResult> {
    let choice = AdapterChoice { name: adapter.map(str::to_string), ..AdapterChoice::default() };
    let gpu = Arc::new(Gpu::open(&choice)?);
    let device = match state {
        State::Small | State::Still | State::Tracing => Device::on(adapter.map(str::to_string)),
        State::Shared => Device::sharing(gpu.clone()),
    };
    let folder = tempfile::tempdir().map_err(|error| Error::file(std::env::temp_dir(), error))?;
    let path = folder.path().join("scene.json");
    std::fs::write(&path, scene(state.traced_cells())?).map_err(|error| Error::file(&path, error))?;
    let mut model = Model::open(&path, Settings::default(), device, Arc::new(|| {}))?;
    model.run.num_rays = if state.traces() { u64::MAX >> 2 } else { NUM_RAYS };
    model.trace();
    let mut app = App::new(model);
    let window = Settings::default().window;
    let mut canvas = OffscreenTexture::new(gpu.clone(), window, 1.0, RENDERER);
    wait_until(&mut canvas, &mut app, |app| {
        app.frame().is_some() && (state.traces() || app.model.is_idle())
    })?;
    if state == State::Still
        && let Some(result) = app.model.a()
    {
        let result = enlarged(result);
        app.model.show(result);
        wait_until(&mut canvas, &mut app, |app| app.model.is_idle() && app.frame().is_some())?;
    }
    let load_average = machine::load_average();
    let rays = |app: &App| app.model.job().map_or(0, |job| job.progress().0);
    let (rays_before, start) = (rays(&app), Instant::now());
    let (mut host_sec, mut frames_sec) = (Vec::new(), Vec::new());
    for number in 0..WARM_UP + num_frames {
        let start = Instant::now();
        let events = drag(&app, number);
        let primitives = canvas.frame(&mut app, events);
        let drawn = canvas.render(&primitives);
        host_sec.push(start.elapsed().as_secs_f64());
        gpu.wait_for(drawn)?;
        frames_sec.push(start.elapsed().as_secs_f64());
    }
    let traced = (rays(&app) - rays_before) as f64 / start.elapsed().as_secs_f64();
    let measured = |mut seconds: Vec<f64>| {
        seconds.drain(..WARM_UP);
        Summary::of(&seconds).ok_or_else(|| Error::Usage("at least one frame must be drawn".into()))
    };
    Ok(ViewerResult {
        name: state.name().into(),
        cells: state.shown_cells(),
        window: [window.0 as u32, window.1 as u32],
        num_frames,
        load_average,
        host_sec: measured(host_sec)?,
        frame_sec: measured(frames_sec)?,
        rays_per_sec: state.traces().then_some(traced),
    })
}

impl State {
    fn name(self) -> &'static str {
        match self {
            State::Small => "viewer_small",
            State::Still => "viewer_large",
            State::Tracing => "viewer_tracing",
            State::Shared => "viewer_shared",
        }
    }

    fn traces(self) -> bool {
        matches!(self, State::Tracing | State::Shared)
    }

    fn traced_cells(self) -> u32 {
        if self.traces() { TRACED } else { SMALL }
    }

    fn shown_cells(self) -> u32 {
        if self == State::Still { SHOWN } else { self.traced_cells() }
    }
}

fn wait_until(canvas: &mut OffscreenTexture, app: &mut App, is_ready: impl Fn(&App) -> bool) -> Result<()> {
    for _ in 0..2 {
        // A ready window may ask for more in its first frame.
        while !is_ready(app) {
            if let Some(problem) = app.model.messages.last() {
                return Err(Error::Device(problem.clone()));
            }
            canvas.frame(app, Vec::new());
            std::thread::sleep(Duration::from_millis(10));
        }
        canvas.frame(app, Vec::new());
    }
    Ok(())
}

/// The result with as many cells as are to be shown; no two neighbours are alike.
fn enlarged(result: &TraceResult) -> TraceResult {
    let mut result = result.clone();
    for detector in &mut result.detectors {
        if let DetectorData::Irradiance(map) = &mut detector.data {
            let (rows, columns) = map.irradiance.dim();
            let side = SHOWN as usize;
            let within = |(row, column): (usize, usize)| (row * rows / side, column * columns / side);
            let tint = |(row, column): (usize, usize)| 0.5 + ((7 * row + 13 * column) % 64) as f64 / 64.0;
            map.irradiance = Array2::from_shape_fn((side, side), |at| map.irradiance[within(at)] * tint(at));
            map.hits = Array2::from_shape_fn((side, side), |at| map.hits[within(at)]);
            map.standard_error = Some(map.irradiance.mapv(|value| 0.1 * value));
        }
    }
    result
}

/// The events of a drag: the button goes down in the middle of the plot, and the pointer turns around it. Every frame
/// shows another view.
fn drag(app: &App, number: usize) -> Vec<Event> {
    let middle = app.frame().map_or(Pos2::ZERO, |frame| frame.rect.center()) + vec2(40.0, 60.0);
    let angle = 0.3 * number as f32;
    let at = middle + 25.0 * vec2(angle.cos(), angle.sin());
    let moved = Event::PointerMoved(at);
    let button = PointerButton::Primary;
    match number {
        0 => vec![moved],
        1 => vec![Event::PointerButton { pos: at, button, pressed: true, modifiers: Modifiers::NONE }],
        _ => vec![moved],
    }
}

/// A lens scene with one detector.
fn scene(num_pixels: u32) -> Result<String> {
    let mut scene: Value = serde_json::from_str(include_str!("../../scenes/bench_lens.json"))
        .map_err(|error| Error::Internal(error.to_string()))?;
    let detector = &mut scene["detectors"][0];
    (detector["num_pixels_x"], detector["num_pixels_y"]) = (num_pixels.into(), num_pixels.into());
    Ok(scene.to_string())
}
