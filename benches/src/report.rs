//! The files of a benchmark: `bench.json` with everything, `bench.csv` with a line per engine.

use crate::machine;
use crate::runner::{CaseResult, Measurement, PeerMeasurement};
use crate::statistics::Summary;
use nsq_gpu::gpu::AdapterInfo;
use nsq_gpu::internals::{PROGRAM, VERSION, pretty_json, processors, replace_file};
use nsq_gpu::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Version of the document. The version grows when a field changes its meaning or is removed, not when a field is
/// added.
pub const SCHEMA: u32 = 1;

/// The document. Times are in s, rates per s.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BenchReport {
    /// Version of the document: [`SCHEMA`].
    pub schema: u32,
    /// Name of the program.
    pub program: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// `debug` or `release`: how the host's part was compiled. The device's part is compiled by the driver.
    pub build: &'static str,
    /// When the benchmark began, in UTC.
    pub date: String,
    /// The command that repeats the measurement, without the adapter, the Python of the peers, and the folder.
    pub command: String,
    /// A note for the reader, such as who else used the machine.
    pub note: Option<String>,
    /// The machine.
    pub machine: Machine,
    /// The adapter.
    pub adapter: Adapter,
    /// Versions of the peers, by peer.
    pub peers: BTreeMap<String, BTreeMap<String, String>>,
    /// Measured runs of each case.
    pub num_runs: usize,
    /// The measurements.
    pub cases: Vec<CaseResult>,
    /// The viewer's frames, where they were measured.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub viewer: Vec<ViewerResult>,
}

/// The measurements of the window in one state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ViewerResult {
    /// `viewer_small`, `viewer_large`: a result is shown. `viewer_tracing`, `viewer_shared`: a trace runs, on a device
    /// of its own or on the device that draws.
    pub name: String,
    /// Cells of the map along each side.
    pub cells: u32,
    /// Width and height of the window \[pixels\].
    pub window: [u32; 2],
    /// Measured frames; each shows another part of the map.
    pub num_frames: usize,
    /// Load average before the first frame; null if the system does not report it.
    pub load_average: Option<f64>,
    /// Times of the program's part of a frame: from the user's input to the commands for the device \[s\].
    pub host_sec: Summary,
    /// Times of whole frames: from the user's input to the last pixel \[s\]. A processor as the device draws the whole
    /// window, and takes about as long for any contents.
    pub frame_sec: Summary,
    /// Rays per second of the trace beside it; null without a trace.
    pub rays_per_sec: Option<f64>,
}

/// The machine.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Machine {
    /// Operating system and architecture.
    pub system: String,
    /// Processor; null if the system does not report it.
    pub processor: Option<String>,
    /// Cores that the program may use.
    pub num_cores: usize,
    /// Load average before the first case; null if the system does not report it.
    pub load_average_start: Option<f64>,
    /// Load average after the last case; null if the system does not report it.
    pub load_average_end: Option<f64>,
}

/// The adapter.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Adapter {
    /// The adapter's name.
    pub name: String,
    /// The adapter's driver and version.
    pub driver: String,
    /// Vulkan, Metal or DX12.
    pub backend: String,
    /// Discrete GPU, integrated GPU, CPU.
    pub kind: String,
}

impl BenchReport {
    /// A report without cases.
    pub fn new(info: &AdapterInfo, num_runs: usize, note: Option<String>) -> Self {
        BenchReport {
            schema: SCHEMA,
            program: PROGRAM,
            version: VERSION,
            build: if cfg!(debug_assertions) { "debug" } else { "release" },
            date: machine::utc_now(),
            command: String::new(),
            note,
            machine: Machine {
                system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
                processor: machine::processor(),
                num_cores: processors::count(),
                load_average_start: machine::load_average(),
                load_average_end: None,
            },
            adapter: Adapter {
                name: info.name.clone(),
                driver: info.driver.clone(),
                backend: info.backend.clone(),
                kind: info.kind.clone(),
            },
            peers: BTreeMap::new(),
            num_runs,
            cases: Vec::new(),
            viewer: Vec::new(),
        }
    }

    /// The document.
    pub fn to_json(&self) -> String {
        pretty_json(self).unwrap_or_else(|error| error.to_string())
    }

    /// A line per case, engine and precision, with a header.
    pub fn to_csv(&self) -> String {
        let mut text = CSV_COLUMNS.join(",") + "\n";
        for case in &self.cases {
            case.measurements.iter().for_each(|ours| text.push_str(&csv_line(case, ours)));
            case.peers.iter().for_each(|peer| text.push_str(&csv_peer_line(case, peer)));
        }
        text
    }

    /// Writes the files into `dir`, which is created if it does not exist, and returns their paths.
    ///
    /// # Errors
    /// [`Error::File`] with the file or folder that could not be written.
    pub fn write_all(&self, dir: &Path) -> Result<Vec<PathBuf>> {
        std::fs::create_dir_all(dir).map_err(|error| Error::file(dir, error))?;
        for (name, text) in [("bench.json", self.to_json()), ("bench.csv", self.to_csv())] {
            replace_file(&dir.join(name), text.as_bytes())?;
        }
        Ok(vec![dir.join("bench.json"), dir.join("bench.csv")])
    }

    /// The table for people.
    pub fn table(&self) -> String {
        let Adapter { name, driver, .. } = &self.adapter;
        let mut text = format!("{} {} on {name}, {driver}\n", self.program, self.version);
        let load = self.machine.load_average_start.map_or("unknown".into(), |load| format!("{load:.2}"));
        let _ = writeln!(text, "{}, {} cores, load average {load}\n", self.date, self.machine.num_cores);
        if !self.cases.is_empty() {
            text += &self.table_of_cases();
        }
        if !self.viewer.is_empty() {
            text += &self.table_of_frames();
        }
        text
    }

    fn table_of_frames(&self) -> String {
        let mut text = format!(
            "{:<16}{:>8}{:>14}{:>12}{:>12}{:>12}{:>12}\n",
            "viewer", "cells", "program [ms]", "frames/s", "drawn [ms]", "frames/s", "M rays/s"
        );
        for state in &self.viewer {
            let ViewerResult { name, cells, host_sec, frame_sec, .. } = state;
            let rays = state.rays_per_sec.map_or("-".into(), |rate| format!("{:.3}", 1e-6 * rate));
            let part = |seconds: &Summary| (1e3 * seconds.median, 1.0 / seconds.median);
            let ((host, host_rate), (frame, frame_rate)) = (part(host_sec), part(frame_sec));
            let _ = write!(text, "{name:<16}{:>8}", format!("{cells}^2"));
            let _ = writeln!(text, "{host:>14.1}{host_rate:>12.1}{frame:>12.1}{frame_rate:>12.1}{rays:>12}");
        }
        text
    }

    fn table_of_cases(&self) -> String {
        let mut text = format!("{:<20}{:>5}{:>12}", "case", "", "rays");
        let _ = write!(
            text,
            "{:>11}{:>12}{:>10}{:>10}{:>12}{:>13}",
            "time [s]", "M rays/s", "min", "max", "M casts/s", "first rays"
        );
        self.peers.keys().for_each(|peer| text += &format!("{:>14}", format!("x {peer}")));
        text.push('\n');
        for case in &self.cases {
            for ours in &case.measurements {
                text += &self.table_line(case, ours);
            }
        }
        text
    }

    fn table_line(&self, case: &CaseResult, ours: &Measurement) -> String {
        let rays = ours.rays_per_sec.times(1e-6);
        let first = ours.first_rays_sec.map_or("-".into(), |seconds| format!("{:.0} ms", 1e3 * seconds));
        let seconds = case.num_rays as f64 / ours.rays_per_sec.median;
        let mut line = format!("{:<20}{:>5}{:>12}", case.name, ours.precision, case.num_rays);
        let _ = write!(line, "{seconds:>11.4}");
        let _ = write!(line, "{:>12.3}{:>10.3}{:>10.3}", rays.median, rays.min, rays.max);
        let _ = write!(line, "{:>12.3}{first:>13}", 1e-6 * ours.casts_per_sec.median);
        for peer in self.peers.keys() {
            let ratio = ours.ratios.get(peer).map_or("-".into(), |ratio| format!("{ratio:.3}"));
            let _ = write!(line, "{ratio:>14}");
        }
        line + "\n"
    }
}

/// The columns of the CSV; a peer has no casts and no ratios.
pub const CSV_COLUMNS: [&str; 19] = [
    "case",
    "axis",
    "kind",
    "engine",
    "precision",
    "num_rays",
    "max_depth",
    "num_primitives",
    "num_runs",
    "median_rays_per_sec",
    "min_rays_per_sec",
    "max_rays_per_sec",
    "median_casts_per_sec",
    "ready_sec",
    "first_rays_sec",
    "load_average",
    "ratio_to_optiland",
    "ratio_to_drjit",
    "ratio_to_mitsuba",
];

fn csv_line(case: &CaseResult, ours: &Measurement) -> String {
    let engine = [PROGRAM, &ours.precision];
    let ratio = |peer: &str| cell(ours.ratios.get(peer).copied());
    let last = [
        cell(Some(ours.casts_per_sec.median)),
        cell(ours.ready_sec),
        cell(ours.first_rays_sec),
        cell(case.load_average),
        ratio("optiland"),
        ratio("drjit"),
        ratio("mitsuba"),
    ];
    let first = csv_start(case, engine, case.num_rays, &ours.runs_sec, ours.rays_per_sec);
    format!("{first},{}\n", last.join(","))
}

fn csv_peer_line(case: &CaseResult, peer: &PeerMeasurement) -> String {
    let engine = [peer.name.as_str(), &peer.precision];
    let first = csv_start(case, engine, peer.num_rays, &peer.runs_sec, peer.rays_per_sec);
    format!("{first},,,,{},,,\n", cell(case.load_average))
}

fn csv_start(
    case: &CaseResult,
    [engine, precision]: [&str; 2],
    num_rays: u64,
    runs: &[f64],
    rate: Summary,
) -> String {
    let CaseResult { name, axis, kind, max_depth, num_primitives, .. } = case;
    let Summary { median, min, max } = rate;
    let num_runs = runs.len();
    format!(
        "{name},{axis},{kind},{engine},{precision},{num_rays},{max_depth},{num_primitives},{num_runs},{median},{min},{max}"
    )
}

fn cell(value: Option<f64>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}
