//! Progress on stderr: a bar for people, lines of JSON for programs.

use super::say;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::time::{Duration, Instant};

/// How progress is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Mode {
    /// A bar on a terminal, nothing elsewhere.
    Auto,
    /// Nothing.
    Never,
    /// A line of JSON every so often: rays, num_rays, rays_per_sec, eta_sec.
    Json,
}

/// Shows how far a trace is.
pub struct Progress {
    mode: Mode,
    bar: ProgressBar,
    num_rays: u64,
    start: Instant,
    last: Option<Instant>,
}

/// Time between two lines of JSON.
const INTERVAL: Duration = Duration::from_millis(200);

impl Progress {
    /// Starts at ray 0.
    pub fn new(mode: Mode, num_rays: u64) -> Self {
        let bar = ProgressBar::with_draw_target(
            Some(num_rays),
            if mode == Mode::Auto { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() },
        );
        let template = "{bar:32} {percent:>3}%  {human_pos} of {human_len} rays, {per_sec}, {eta} left";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        Progress { mode, bar, num_rays, start: Instant::now(), last: None }
    }

    /// So many rays are done.
    pub fn update(&mut self, rays: u64) {
        self.bar.set_position(rays);
        let due = self.last.is_none_or(|last| last.elapsed() >= INTERVAL) || rays == self.num_rays;
        if self.mode == Mode::Json && due {
            self.last = Some(Instant::now());
            let rate = rays as f64 / self.start.elapsed().as_secs_f64().max(1e-9);
            let eta = (self.num_rays - rays.min(self.num_rays)) as f64 / rate;
            let line = serde_json::json!({
                "rays": rays, "num_rays": self.num_rays, "rays_per_sec": rate, "eta_sec": eta,
            });
            say(&line.to_string());
        }
    }

    /// Takes the bar away.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}
