//! Progress on stderr: a bar for people, lines of JSON for programs.

use crate::cli::console::say;
use crate::cli::trace_args::TraceArgs;
use crate::run;
use crate::run::stopping::Stopping;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::{Value, json};
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

/// The state of a trace while it runs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Status {
    /// Rays done, including those that the trace began with.
    pub rays: u64,
    /// Most rays of the whole trace.
    pub num_rays: u64,
    /// Rays done before the trace was resumed.
    pub begun: u64,
    /// Time since the trace began or was resumed.
    pub elapsed: Duration,
    /// The largest relative error, if known.
    pub relative_error: Option<f64>,
    /// The target for the relative error.
    pub target_error: Option<f64>,
    /// An estimate of the rays that the target takes.
    pub rays_to_target: Option<u64>,
    /// The time limit.
    pub time_limit: Option<Duration>,
}

impl Status {
    /// The state after a pass of a trace that began with `begun` rays.
    pub(crate) fn of(
        progress: &run::Progress<'_, '_>,
        stopping: &Stopping,
        args: &TraceArgs,
        begun: u64,
    ) -> Self {
        Status {
            rays: progress.done,
            num_rays: progress.num_rays,
            begun,
            elapsed: progress.elapsed,
            relative_error: stopping.relative_error(),
            target_error: args.target_error,
            rays_to_target: stopping.rays_to_target(),
            time_limit: args.time_limit,
        }
    }

    /// The state of a trace that goes on to its last ray.
    pub(crate) fn of_rays(rays: u64, num_rays: u64, elapsed: Duration) -> Self {
        Status {
            rays,
            num_rays,
            begun: 0,
            elapsed,
            relative_error: None,
            target_error: None,
            rays_to_target: None,
            time_limit: None,
        }
    }

    /// Rays per second.
    fn rate(&self) -> f64 {
        (self.rays - self.begun.min(self.rays)) as f64 / self.elapsed.as_secs_f64().max(1e-9)
    }

    /// Time to the end \[s\]: the last ray, the target or the time limit, whichever comes first.
    fn eta_sec(&self) -> f64 {
        let end = self.rays_to_target.map_or(self.num_rays, |rays| rays.min(self.num_rays));
        let left = end.saturating_sub(self.rays) as f64 / self.rate().max(1e-9);
        let limit =
            self.time_limit.map_or(f64::INFINITY, |limit| limit.saturating_sub(self.elapsed).as_secs_f64());
        left.min(limit)
    }

    /// The text of the bar.
    fn text(&self) -> String {
        let error = match (self.relative_error, self.target_error) {
            (Some(error), Some(target)) => format!(", error {} of {}", percent(error), percent(target)),
            (Some(error), None) => format!(", error {}", percent(error)),
            (None, _) => String::new(),
        };
        let rate = indicatif::HumanCount(self.rate().round() as u64);
        let left = indicatif::HumanDuration(Duration::try_from_secs_f64(self.eta_sec()).unwrap_or_default());
        format!("{rate} rays/s, {left:#} left{error}")
    }

    /// What programs read.
    pub(crate) fn json(&self) -> Value {
        json!({
            "rays": self.rays,
            "num_rays": self.num_rays,
            "rays_per_sec": self.rate(),
            "eta_sec": self.eta_sec(),
            "relative_error": self.relative_error,
        })
    }
}

/// A percentage with two or three digits.
fn percent(fraction: f64) -> String {
    let percent = 100.0 * fraction;
    let decimals = if percent >= 10.0 { 0 } else { (1.0 - percent.max(1e-3).log10().floor()) as usize };
    format!("{percent:.decimals$} %")
}

/// Shows the progress of a trace.
pub struct Progress {
    mode: Mode,
    bar: ProgressBar,
    last: Option<Instant>,
}

/// Time between two lines of JSON, or two updates of the bar.
const INTERVAL: Duration = Duration::from_millis(200);

impl Progress {
    /// Starts at ray 0.
    pub fn new(mode: Mode, num_rays: u64) -> Self {
        let bar = ProgressBar::with_draw_target(
            Some(num_rays),
            if mode == Mode::Auto { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() },
        );
        let template = "{bar:32} {percent:>3}%  {human_pos} of {human_len} rays, {msg}";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        Progress { mode, bar, last: None }
    }

    /// True if it is time to show the status. The caller computes an expensive status only then.
    pub fn is_due(&self) -> bool {
        let shown = self.mode == Mode::Json || !self.bar.is_hidden();
        shown && self.last.is_none_or(|last| last.elapsed() >= INTERVAL)
    }

    /// Shows the status if it is time, or if the last ray is done.
    pub fn update(&mut self, status: &Status) {
        if !self.is_due() && status.rays != status.num_rays {
            return;
        }
        self.last = Some(Instant::now());
        self.bar.set_message(status.text());
        self.bar.set_position(status.rays);
        if self.mode == Mode::Json {
            say(&status.json().to_string());
        }
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
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
        assert_eq!(status().text(), "770,416 rays/s, 11s left");
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
        assert_eq!(target.text(), "770,416 rays/s, 1s left, error 1.3 % of 1.0 %");
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
