//! Scenes where tracers fail, with exact answers. Each is traced in every tier, and compared with what the tier's
//! numbers allow.
//!
//! The cases, their answers to 60 digits, and what Optiland reads are in `benches/stability/cases.json`, which `python
//! -m tools.make_stability` writes. A few roundings of the scene's own numbers make an interval of the exact answer,
//! and a tier is right in this interval. A reading that chance decides must lie within five standard deviations.

use nsq_gpu::gpu::Gpu;
use nsq_gpu::model::SceneIr;
use nsq_gpu::program::Precision;
use nsq_gpu::result::{DetectorData, RunInfo, TraceResult};
use nsq_gpu::run::{TraceOptions, Tracer};
use nsq_gpu::scene::Scene;
use nsq_gpu::{Error, Result};
use serde::Deserialize;
use serde_json::Value;
use std::fmt::Write;

const CASES: &str = include_str!("../stability/cases.json");

/// A scene, and what is read from its result.
#[derive(Debug, Clone, Deserialize)]
pub struct StabilityCase {
    /// Unique name.
    pub name: String,
    /// The difficulty of the scene.
    pub group: String,
    /// Rays to launch.
    pub num_rays: u64,
    /// Largest number of events of a ray.
    pub max_depth: u32,
    /// If the scene must be refused: a part of the message.
    pub refused: Option<String>,
    /// Optiland's message, if Optiland refuses the scene.
    pub reference_refused: Option<String>,
    /// True if Optiland would take too long.
    pub reference_not_run: bool,
    /// The readings.
    pub readings: Vec<Reading>,
    scene: Value,
}

/// A number of the result, and what it must be.
#[derive(Debug, Clone, Deserialize)]
pub struct Reading {
    /// The name of the reading.
    pub name: String,
    /// The exact answer, or the expectation if draws decide.
    pub expected: f64,
    f32: [f64; 2],
    df64: [f64; 2],
    f64: [f64; 2],
    nothing: Vec<String>,
    /// The reading of Optiland's NumPy backend, if there is one.
    #[serde(default)]
    pub reference: Option<f64>,
    detector: Option<String>,
    column: Option<String>,
    take: Option<String>,
    pixel: Option<[usize; 2]>,
    field: Option<String>,
}

/// The outcome of a case in a tier.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    /// The readings in the case's order; `None` where nothing arrived.
    Read(Vec<Option<f64>>),
    /// The scene was refused.
    Refused(Error),
}

/// A case with its outcome in each tier.
#[derive(Debug, Clone)]
pub struct Row {
    /// The case.
    pub case: StabilityCase,
    /// Outcomes.
    pub outcomes: Vec<(Precision, Outcome)>,
}

/// Every case.
///
/// # Errors
/// [`Error::Internal`] if the committed file is malformed.
pub fn cases() -> Result<Vec<StabilityCase>> {
    #[derive(Deserialize)]
    struct File {
        cases: Vec<StabilityCase>,
    }
    let file: File =
        serde_json::from_str(CASES).map_err(|e| Error::Internal(format!("stability cases: {e}")))?;
    Ok(file.cases)
}

impl Reading {
    /// The interval in which the tier's reading must lie.
    pub fn interval(&self, precision: Precision) -> [f64; 2] {
        match precision {
            Precision::F32 => self.f32,
            Precision::Df64 => self.df64,
            Precision::F64 => self.f64,
        }
    }

    /// True if the value is within the tier's interval.
    pub fn holds(&self, precision: Precision, value: Option<f64>) -> bool {
        let [low, high] = self.interval(precision);
        match value {
            Some(value) => (low..=high).contains(&value),
            None => self.nothing.iter().any(|tier| tier == precision.name()),
        }
    }

    fn read(&self, result: &TraceResult) -> Result<Option<f64>> {
        if self.field.as_deref() == Some("total_flux_lost") {
            return Ok(Some(result.total_flux_lost));
        }
        let name = self.detector.as_deref().unwrap_or_default();
        let detector = result.detectors.iter().find(|detector| detector.name == name);
        let detector = detector.ok_or_else(|| Error::Internal(format!("no detector `{name}`")))?;
        match (self.take.as_deref(), &detector.data, self.pixel) {
            (Some("total"), ..) => return Ok(Some(detector.total_flux)),
            (Some("lit"), DetectorData::Irradiance(map), _) => {
                return Ok(Some(map.irradiance.iter().filter(|value| **value != 0.0).count() as f64));
            }
            (Some("pixel"), DetectorData::Irradiance(map), Some([x, y])) => {
                let (num_y, num_x) = map.irradiance.dim();
                let area = map.width / num_x as f64 * (map.height / num_y as f64);
                return Ok(map.irradiance.get((y, x)).map(|value| value * area));
            }
            _ => {}
        }
        let DetectorData::RayDatabase(database) = &detector.data else {
            return Err(Error::Internal(format!("`{name}` is no ray database")));
        };
        let rows = database.columns()?;
        let weight = result.num_rays_total as f64 / result.total_flux_in;
        let (column, unit) = match self.column.as_deref() {
            Some("x") => (&rows.position[0], 1.0),
            Some("L") => (&rows.direction[0], 1.0),
            Some("N") => (&rows.direction[2], 1.0),
            Some("weight") => (&rows.flux, weight),
            other => return Err(Error::Internal(format!("no column {other:?}"))),
        };
        let value = if self.take.as_deref() == Some("last") { column.last().copied() } else { column.mean() };
        // In Optiland's form, an empty database holds one row of zeros.
        Ok(value.filter(|_| detector.num_rays_hit > 0).map(|value| value * unit))
    }
}

impl StabilityCase {
    /// Traces the case in one precision.
    ///
    /// # Errors
    /// The errors of the trace, except those that refuse the scene.
    pub fn measure(&self, gpu: &Gpu, precision: Precision) -> Result<Outcome> {
        let traced = self.scene().and_then(|ir| {
            let options = self.options(precision);
            let tally = Tracer::new(gpu, &ir, &options)?.trace(|_| true)?;
            let run = RunInfo { num_rays: self.num_rays, max_depth: self.max_depth, ..Default::default() };
            TraceResult::new(&ir, &run, &tally)
        });
        match traced {
            Ok(result) => self.read(&result),
            Err(error @ (Error::Usage(_) | Error::Scene { .. } | Error::Device(_))) => {
                Ok(Outcome::Refused(error))
            }
            Err(error) => Err(error),
        }
    }

    /// The scene.
    ///
    /// # Errors
    /// [`Error::Scene`] if the scene is refused.
    pub fn scene(&self) -> Result<SceneIr> {
        Scene::from_json(&self.scene.to_string())?.lower()
    }

    /// The options of the trace.
    pub fn options(&self, precision: Precision) -> TraceOptions {
        TraceOptions {
            num_rays: self.num_rays,
            max_depth: self.max_depth,
            min_flux_fraction: 0.0,
            precision,
            ..Default::default()
        }
    }

    /// The readings of a result.
    ///
    /// # Errors
    /// [`Error::Internal`] if the result's ledger does not close.
    pub fn read(&self, result: &TraceResult) -> Result<Outcome> {
        if !result.ledger.closes() {
            return Err(Error::Internal(format!("{}: the ledger does not close", self.name)));
        }
        let readings = self.readings.iter().map(|reading| reading.read(result));
        Ok(Outcome::Read(readings.collect::<Result<_>>()?))
    }

    /// The faults of an outcome, by reading; empty if there are none.
    pub fn faults(&self, precision: Precision, outcome: &Outcome) -> Vec<String> {
        let fault = |what: String| format!("{}, {}: {what}", self.name, precision.name());
        match (outcome, &self.refused) {
            (Outcome::Refused(error), Some(part)) if error.to_string().contains(part.as_str()) => Vec::new(),
            (Outcome::Refused(error), _) => vec![fault(format!("refused: {error}"))],
            (Outcome::Read(_), Some(part)) => vec![fault(format!("not refused with `{part}`"))],
            (Outcome::Read(values), None) => {
                let wrong =
                    self.readings.iter().zip(values).filter(|(r, value)| !r.holds(precision, **value));
                wrong
                    .map(|(reading, value)| {
                        let [low, high] = reading.interval(precision);
                        fault(format!("{} is {}, not in {low:e}..={high:e}", reading.name, shown(*value)))
                    })
                    .collect()
            }
        }
    }
}

/// All faults in the rows.
pub fn faults(rows: &[Row]) -> Vec<String> {
    rows.iter()
        .flat_map(|row| row.outcomes.iter().flat_map(|(precision, o)| row.case.faults(*precision, o)))
        .collect()
}

fn shown(value: Option<f64>) -> String {
    value.map_or("nothing".into(), |value| format!("{value:.12e}"))
}

/// The table: a line a reading, with the errors of each tier and of the reference. A `!` marks an error beyond what the
/// numbers allow.
pub fn table(rows: &[Row]) -> String {
    let width = rows.iter().map(|row| row.case.name.chars().count()).max().unwrap_or(0);
    let mut text = format!("{:<width$}  {:<12}{:>20}", "case", "reading", "expected");
    for (precision, _) in rows.iter().take(1).flat_map(|row| &row.outcomes) {
        let _ = write!(text, "{:>14}", format!("{} error", precision.name()));
    }
    let _ = writeln!(text, "{:>14}", "Optiland's");
    let mut group = "";
    for row in rows {
        if row.case.group != group {
            group = &row.case.group;
            let _ = writeln!(text, "\n{group}");
        }
        for line in row.lines() {
            let [reading, expected, cells @ ..] = line.as_slice() else { continue };
            let _ = write!(text, "{:<width$}  {reading:<12}{expected:>20}", row.case.name);
            for cell in cells {
                let _ = write!(text, "{cell:>14}");
            }
            text.push('\n');
        }
    }
    text
}

impl Row {
    /// For each reading: its name, the expected value, the errors of the tiers and of the reference.
    fn lines(&self) -> Vec<Vec<String>> {
        if self.case.refused.is_some() {
            let ours = |(precision, outcome): &(Precision, Outcome)| {
                if self.case.faults(*precision, outcome).is_empty() { "refused" } else { "traced!" }
                    .to_string()
            };
            let theirs = if self.case.reference_refused.is_some() { "refused" } else { "traced" };
            let cells = self.outcomes.iter().map(ours).chain([theirs.into()]);
            return vec![[String::new(), "refused".into()].into_iter().chain(cells).collect()];
        }
        self.case.readings.iter().enumerate().map(|(i, reading)| self.line(i, reading)).collect()
    }

    fn line(&self, i: usize, reading: &Reading) -> Vec<String> {
        let ours = self.outcomes.iter().map(|(precision, outcome)| match outcome {
            Outcome::Refused(_) => "refused".into(),
            Outcome::Read(values) => error_cell(reading, *precision, values[i]),
        });
        let theirs = match (&self.case.reference_refused, reading.reference) {
            (Some(_), _) => "refused".into(),
            (None, None) if self.case.reference_not_run => "not run".into(),
            (None, value) => error_cell(reading, Precision::F64, value),
        };
        let head = [reading.name.clone(), format!("{:.12e}", reading.expected)];
        head.into_iter().chain(ours).chain([theirs]).collect()
    }
}

fn error_cell(reading: &Reading, precision: Precision, value: Option<f64>) -> String {
    let mark = if reading.holds(precision, value) { " " } else { "!" };
    match value {
        None => format!("nothing{mark}"),
        Some(value) => format!("{:.1e}{mark}", value - reading.expected),
    }
}
