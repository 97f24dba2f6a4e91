//! The window of `nsq-gpu view`: a trace while it converges, or results from a folder.
//!
//! ```text
//! tracing   a thread that folds passes, and a shelf with its latest result
//! model     results, comparison, choices -> Picture (field, scale | spots); no window in it
//! field, scale, region, profile, compare, photometry, spots    what is shown, as pure functions
//! plot, raster    axes with a view; pixels
//! app, views      panels around the plot
//! screenshot      the same frame without a display
//! ```

pub mod app;
pub mod compare;
pub mod export;
pub mod field;
pub mod model;
pub mod photometry;
pub mod plot;
pub mod profile;
pub mod raster;
pub mod region;
pub mod scale;
pub mod screenshot;
pub mod settings;
pub mod spots;
pub mod tracing;
mod views;

pub use app::App;
pub use model::Model;

use crate::error::{Error, Result};
use eframe::egui;
use std::sync::Arc;

/// Opens the window and stays until it is closed. `model` makes the model once there is a window to wake.
///
/// # Errors
/// What `model` says, and [`Error::Usage`] where there is no display.
pub fn open(
    title: &str,
    size: (f32, f32),
    model: impl FnOnce(tracing::Notify) -> Result<App> + 'static,
) -> Result<()> {
    let viewport = egui::ViewportBuilder::default()
        .with_title(title)
        .with_app_id("nsq-gpu")
        .with_inner_size([size.0, size.1])
        .with_min_inner_size([860.0, 560.0]);
    let options = eframe::NativeOptions { viewport, ..Default::default() };
    let failure = Arc::new(std::sync::Mutex::new(None));
    let kept = failure.clone();
    let opened = eframe::run_native(
        title,
        options,
        Box::new(move |context| {
            let ctx = context.egui_ctx.clone();
            match model(Arc::new(move || ctx.request_repaint())) {
                Ok(app) => Ok(Box::new(app)),
                Err(error) => {
                    let text = error.to_string();
                    *kept.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(error);
                    Err(text.into())
                }
            }
        }),
    );
    let failure = failure.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take();
    if let Some(error) = failure {
        return Err(error);
    }
    opened.map_err(|error| {
        Error::Usage(format!(
            "no window could be opened ({error}); `--screenshot FILE` draws the same without a display"
        ))
    })
}
