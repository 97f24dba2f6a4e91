//! The window of `nsq-gpu view`: a trace while it converges, or results from a folder.
//!
//! ```text
//! tracing   a thread that traces, and the latest of its results
//! following light by its path, in the background: a table, maps of its rows, and their rays
//! light     the table of the detector that is shown, and what is ticked and shown of it
//! model     results, comparison, choices -> Picture (field, scale | spots); needs no window
//! line_profile, two_results, spots    what is shown, as pure functions (field, region: result/figures)
//! polar     the polar diagrams of a far field and of lamps
//! silhouettes     the scene from the side, as curves in a plane
//! plot, screen_pixels    axes with a view; pixels of the screen (scales and colours: result/picture)
//! app, views      panels around the plot
//! screenshot      the same frame without a display
//! ```

pub mod app;
pub mod export;
pub mod following;
pub mod light;
pub mod line_profile;
pub mod model;
pub mod plot;
mod polar;
pub mod screen_pixels;
pub mod screenshot;
pub mod settings;
pub mod silhouettes;
pub mod spots;
pub mod state;
pub mod stray;
pub mod tracing;
pub mod two_results;
mod views;

pub use crate::viewer::app::App;
pub use crate::viewer::model::Model;

use crate::error::{Error, Result};
use eframe::egui;
use eframe::egui_wgpu::RendererOptions;
use std::sync::{Arc, OnceLock};

/// Wakes a window, once there is one: a trace begins before its window is open.
#[derive(Clone, Default)]
pub struct Waker(Arc<OnceLock<egui::Context>>);

impl Waker {
    /// The function that the tracing threads call.
    pub fn notify(&self) -> tracing::Notify {
        let context = self.0.clone();
        Arc::new(move || {
            if let Some(context) = context.get() {
                context.request_repaint();
            }
        })
    }
}

/// How the window is drawn: without dithering, on which neither colours of a map nor times of frames may depend.
pub const RENDERER: RendererOptions = RendererOptions {
    msaa_samples: 1,
    depth_stencil_format: None,
    dithering: false,
    predictable_texture_filtering: false,
};

/// Opens the window of `app`, and returns when it is closed. `size` is in points.
///
/// # Errors
/// [`Error::Usage`] where there is no display.
pub fn open(title: &str, size: (f32, f32), waker: &Waker, app: App) -> Result<()> {
    let viewport = egui::ViewportBuilder::default()
        .with_title(title)
        .with_app_id("nsq-gpu")
        .with_inner_size([size.0, size.1])
        .with_min_inner_size([860.0, 560.0]);
    let options = eframe::NativeOptions { viewport, dithering: RENDERER.dithering, ..Default::default() };
    let waker = waker.clone();
    let create = move |context: &eframe::CreationContext<'_>| -> Created {
        // A waker wakes one window: it could not distinguish a second one.
        let _ = waker.0.set(context.egui_ctx.clone());
        Ok(Box::new(app))
    };
    eframe::run_native(title, options, Box::new(create)).map_err(|error| {
        Error::Usage(format!(
            "no window could be opened: is there a display? `--screenshot FILE` draws the same without one ({error})"
        ))
    })
}

type Created = std::result::Result<Box<dyn eframe::App>, Box<dyn std::error::Error + Send + Sync>>;
