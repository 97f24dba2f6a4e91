//! Progress on stderr: a bar for people, lines of JSON for programs.

use crate::cli::console::say;
use crate::run::{Next, Status};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::{Value, json};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How progress is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Mode {
    /// A bar on a terminal, nothing elsewhere.
    Auto,
    /// Nothing.
    Never,
    /// A line of JSON every so often: rays, num_rays, rays_per_sec, eta_sec, relative_error.
    Json,
}

/// The text of the bar.
fn text(status: &Status) -> String {
    let error = match (status.relative_error, status.target_error) {
        (Some(error), Some(target)) => format!(", error {} of {}", percent(error), percent(target)),
        (Some(error), None) => format!(", error {}", percent(error)),
        (None, _) => String::new(),
    };
    let rate = indicatif::HumanCount(status.rate().round() as u64);
    let left = indicatif::HumanDuration(Duration::try_from_secs_f64(status.eta_sec()).unwrap_or_default());
    format!("{rate} rays/s, {left:#} left{error}")
}

/// What programs read.
pub(crate) fn json(status: &Status) -> Value {
    json!({
        "rays": status.rays,
        "num_rays": status.num_rays,
        "rays_per_sec": status.rate(),
        "eta_sec": status.eta_sec(),
        "relative_error": status.relative_error,
    })
}

/// A percentage with two or three digits.
fn percent(fraction: f64) -> String {
    let percent = 100.0 * fraction;
    let decimals = if percent >= 10.0 { 0 } else { (1.0 - percent.max(1e-3).log10().floor()) as usize };
    format!("{percent:.decimals$} %")
}

/// Shows the progress of a trace.
struct ProgressMeter {
    mode: Mode,
    bar: ProgressBar,
    last: Option<Instant>,
}

/// Time between two lines of JSON, or two updates of the bar.
const INTERVAL: Duration = Duration::from_millis(200);

impl ProgressMeter {
    /// Starts at ray 0.
    fn new(mode: Mode) -> Self {
        let bar = ProgressBar::with_draw_target(
            Some(0),
            if mode == Mode::Auto { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() },
        );
        let template = "{bar:32} {percent:>3}%  {human_pos} of {human_len} rays, {msg}";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        ProgressMeter { mode, bar, last: None }
    }

    fn is_due(&self) -> bool {
        let shown = self.mode == Mode::Json || !self.bar.is_hidden();
        shown && self.last.is_none_or(|last| last.elapsed() >= INTERVAL)
    }

    /// Shows the status if it is time, or if the last ray is done.
    fn update(&mut self, status: &Status) {
        if !self.is_due() && status.rays != status.num_rays {
            return;
        }
        self.last = Some(Instant::now());
        if self.bar.length() != Some(status.num_rays) {
            self.bar.set_length(status.num_rays);
        }
        self.bar.set_message(text(status));
        self.bar.set_position(status.rays);
        if self.mode == Mode::Json {
            say(&json(status).to_string());
        }
    }
}

impl Drop for ProgressMeter {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Shows how far a trace has come, until the flag is raised or the trace ends: what runs ask after each pass.
pub(crate) fn shown(mode: Mode, stop: &AtomicBool) -> impl FnMut(&Status) -> Next {
    let mut meter = ProgressMeter::new(mode);
    move |status| {
        meter.update(status);
        Next::stop_if(stop.load(Ordering::Relaxed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status() -> Status {
        Status {
            rays: 1_500_000,
            num_rays: 10_000_000,
            begun: 500_000,
            elapsed: Duration::from_millis(1298),
            relative_error: None,
            target_error: None,
            rays_to_target: None,
            time_limit: None,
        }
    }

    #[test]
    fn people_read_whole_rays_per_second() {
        assert_eq!(text(&status()), "770,416 rays/s, 11s left");
    }

    #[test]
    fn the_end_is_what_comes_first() {
        assert!((status().eta_sec() - 8.5 * 1.298).abs() < 1e-9);
        let limited = Status { time_limit: Some(Duration::from_secs(2)), ..status() };
        assert!((limited.eta_sec() - 0.702).abs() < 1e-9);
        let target = Status {
            relative_error: Some(0.0134),
            target_error: Some(0.01),
            rays_to_target: Some(2_500_000),
            ..status()
        };
        assert!((target.eta_sec() - 1.298).abs() < 1e-9);
        assert_eq!(text(&target), "770,416 rays/s, 1s left, error 1.3 % of 1.0 %");
        let met = Status { rays_to_target: Some(1), ..target };
        assert_eq!(met.eta_sec(), 0.0);
    }

    #[test]
    fn errors_have_two_digits() {
        assert_eq!(percent(0.5), "50 %");
        assert_eq!(percent(0.0123), "1.2 %");
        assert_eq!(percent(0.00123), "0.12 %");
    }
}
