//! How the cost of a trace grows with its surfaces, its depth and its rays. A depth that no ray reaches should cost
//! nothing, and the time should grow with what the rays meet.
//!
//! The scene is a cloud of small mirrors in random places. More mirrors are smaller ones, so that a ray meets one or two
//! of them however many there are.

use crate::cases::mirror_cloud;
use crate::statistics::Summary;
use nsq_gpu::gpu::Gpu;
use nsq_gpu::internals::replace_file;
use nsq_gpu::model::Precision;
use nsq_gpu::run::{TraceOptions, Tracer};
use nsq_gpu::scene::Scene;
use nsq_gpu::{Error, Result};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The mirrors of a cloud, and those that depth and rays are varied with.
const MIRRORS: [u32; 4] = [100, 1000, 10_000, 100_000];
const MIRRORS_OF_OTHERS: u32 = 1000;
/// The depth that every ray stays below, and one far beyond.
const SHALLOW: u32 = 64;
const DEEP: u32 = 100_000;
const DEPTHS: [u32; 5] = [SHALLOW, 256, 1024, 10_000, DEEP];
const RAYS: u64 = 1_000_000;
/// The files that `-o` writes.
pub const FILES: &[&str] = &["growth.txt"];

/// One point: how long a trace takes at each depth.
#[derive(Debug, Clone)]
struct Point {
    num_mirrors: u32,
    num_rays: u64,
    /// (depth, seconds), the shallow one first.
    times: Vec<(u32, Summary)>,
}

/// The measurements.
#[derive(Debug, Clone)]
pub struct Growth {
    adapter: String,
    precision: Precision,
    mirrors: Vec<Point>,
    depths: Point,
    rays: Vec<Point>,
}

/// Measures, with at most `max_rays` rays. The depths of a point take turns.
///
/// # Errors
/// [`Error::Device`] if the device fails.
pub fn measure(
    gpu: &Gpu,
    precision: Precision,
    max_rays: u64,
    num_runs: usize,
    say: impl Fn(&str),
) -> Result<Growth> {
    let point = |num_mirrors, num_rays: u64, depths: &[u32]| -> Result<Point> {
        let point = measure_point(gpu, precision, num_mirrors, num_rays.min(max_rays), depths, num_runs)?;
        say(point.line().trim_end());
        Ok(point)
    };
    let both = [SHALLOW, DEEP];
    let mirrors = MIRRORS.iter().map(|num| point(*num, RAYS, &both)).collect::<Result<_>>()?;
    let depths = point(MIRRORS_OF_OTHERS, RAYS, &DEPTHS)?;
    let powers = (4..=7).map(|power| 10_u64.pow(power)).filter(|num| *num <= max_rays.max(10_000));
    let rays = powers.map(|num| point(MIRRORS_OF_OTHERS, num, &both)).collect::<Result<_>>()?;
    Ok(Growth { adapter: gpu.info.name.clone(), precision, mirrors, depths, rays })
}

fn measure_point(
    gpu: &Gpu,
    precision: Precision,
    num_mirrors: u32,
    num_rays: u64,
    depths: &[u32],
    num_runs: usize,
) -> Result<Point> {
    let ir = Scene::from_json(&mirror_cloud(num_mirrors))?.lower()?;
    let options = |max_depth| {
        TraceOptions { num_rays, max_depth, precision, ..TraceOptions::default() }.tuned(&gpu.info)
    };
    let tracer = |depth: &u32| Tracer::new(gpu, &ir, &options(*depth));
    let mut tracers = depths.iter().map(tracer).collect::<Result<Vec<_>>>()?;
    let mut times = vec![Vec::new(); depths.len()];
    // The first run compiles.
    for run in 0..=num_runs {
        for (tracer, times) in tracers.iter_mut().zip(&mut times) {
            let start = Instant::now();
            tracer.trace(|_| true)?;
            times.extend((run > 0).then(|| start.elapsed().as_secs_f64()));
        }
    }
    let times = depths.iter().zip(&times).filter_map(|(depth, times)| Some((*depth, Summary::of(times)?)));
    Ok(Point { num_mirrors, num_rays, times: times.collect() })
}

impl Point {
    fn seconds(&self, depth: u32) -> f64 {
        let found = self.times.iter().find(|(of, _)| *of == depth);
        found.map_or(f64::NAN, |(_, seconds)| seconds.median)
    }

    fn line(&self) -> String {
        let shallow = self.seconds(SHALLOW);
        let mut text = String::new();
        for (depth, seconds) in &self.times {
            let Point { num_mirrors, num_rays, .. } = self;
            let Summary { median, min, max } = seconds;
            let _ = writeln!(
                text,
                "{num_mirrors:>8}{num_rays:>10}{depth:>8}{median:>11.4}{min:>11.4}{max:>11.4}{:>8.2}",
                median / shallow
            );
        }
        text
    }
}

impl Growth {
    /// The table: seconds of each point, and how they compare with the shallow trace's.
    pub fn table(&self) -> String {
        let mut text = format!("{}, {}\n\n", self.adapter, self.precision.name());
        let _ = writeln!(
            text,
            "{:>8}{:>10}{:>8}{:>11}{:>11}{:>11}{:>8}",
            "mirrors", "rays", "depth", "median [s]", "min [s]", "max [s]", "ratio"
        );
        for point in self.mirrors.iter().chain([&self.depths]).chain(&self.rays) {
            text += &point.line();
        }
        text
    }

    /// Writes the table into a folder, and returns its path.
    ///
    /// # Errors
    /// [`Error::File`] if a file cannot be written.
    pub fn write(&self, dir: &Path) -> Result<PathBuf> {
        std::fs::create_dir_all(dir).map_err(|error| Error::file(dir, error))?;
        let path = dir.join(FILES[0]);
        replace_file(&path, self.table().as_bytes())?;
        Ok(path)
    }
}
