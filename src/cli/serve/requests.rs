//! The requests of a session, as their headers have them.

use crate::cli::trace::parse_record_paths;
use crate::cli::trace_args::{PhotometricArg, TraceArgs};
use crate::error::{Error, Result};
use crate::model::{SceneIr, Sequence};
use crate::result::NewCoating;
use crate::result::recoat::sequence_of;
use crate::run::RecordPaths;
use clap::Parser;
use ndarray::ArrayD;
use ndarray_npy::ReadNpyExt;
use serde::Deserialize;
use serde_json::{Map, Value};
use std::path::PathBuf;

/// A request, without its id.
#[derive(Debug)]
pub(crate) enum Request {
    /// Asks for the version of the protocol, and the adapter.
    Hello,
    /// Asks for numbers of a scene's text, by their names.
    Numbers { scene: String, names: Vec<String> },
    /// Asks what other coatings would do to the rows of a table of paths.
    Recoat(Box<RecoatRequest>),
    /// Asks for a trace.
    Trace(Box<TraceRequest>),
}

/// A trace that is asked for.
#[derive(Debug)]
pub(crate) struct TraceRequest {
    /// The text of the scene.
    pub(crate) scene: String,
    /// What messages call the scene.
    pub(crate) name: Option<String>,
    /// The folder from which files are looked for that the scene names.
    pub(crate) folder: PathBuf,
    /// Numbers of the scene to set, by their names.
    pub(crate) set: Vec<(String, f64)>,
    /// Options of the command.
    pub(crate) args: TraceArgs,
    /// Which paths are recorded.
    pub(crate) record_paths: RecordPaths,
    /// Whether results are photometric.
    pub(crate) photometric: PhotometricArg,
    /// Whether the scene's numbers are live; by default in short traces.
    pub(crate) live: Option<bool>,
    /// Names of numbers by which detectors' sums are differentiated.
    pub(crate) gradient: Vec<String>,
    /// Derivatives have standard errors.
    pub(crate) gradient_errors: bool,
    /// Derivatives are also found by differences of two traces, which see light that crosses edges.
    pub(crate) gradient_edges: bool,
    /// The gradient of a loss is checked by a short difference of two traces.
    pub(crate) check_edges: bool,
    /// What a loss gains by a watt in each cell of a detector, by the detector's name: the loss is differentiated, and not
    /// the sums. None: no loss.
    pub(crate) adjoints: Option<Vec<(String, ArrayD<f64>)>>,
    /// True: the progress is sent.
    pub(crate) progress: bool,
}

/// Rows of a table of paths, and other coatings of faces.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RecoatRequest {
    #[allow(dead_code, reason = "read before")]
    id: Value,
    #[allow(dead_code, reason = "read before")]
    request: String,
    /// The scene that was traced.
    scene: Value,
    /// The folder from which files are looked for that the scene names.
    #[serde(default)]
    pub(crate) folder: PathBuf,
    /// Rays were split at so many of their first events, if that was an option of the trace and is not in the scene.
    #[serde(default)]
    pub(crate) split_depth: u32,
    /// The rows.
    pub(crate) rows: Vec<PathRow>,
    /// The coatings, as `--recoat` has them.
    #[serde(default)]
    pub(crate) coatings: Vec<NewCoating>,
    /// Whether coatings are ranked.
    #[serde(default)]
    pub(crate) rank: bool,
}

/// A row of a table of paths.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PathRow {
    sequence: String,
    steps: Vec<[String; 2]>,
    detector: Option<String>,
    pub(crate) flux: f64,
    pub(crate) standard_error: Option<f64>,
}

impl RecoatRequest {
    /// The text of the scene.
    pub(crate) fn scene(&self) -> String {
        text_of(self.scene.clone())
    }
}

impl PathRow {
    /// The row's sequence in its scene.
    ///
    /// # Errors
    /// [`Error::Usage`] if it has none.
    pub(crate) fn sequence(&self, ir: &SceneIr) -> Result<Sequence> {
        sequence_of(ir, &self.sequence, &self.steps, self.detector.as_deref())
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TraceHeader {
    #[allow(dead_code, reason = "read before")]
    id: Value,
    #[allow(dead_code, reason = "read before")]
    request: String,
    scene: Value,
    name: Option<String>,
    folder: Option<PathBuf>,
    #[serde(default)]
    options: Map<String, Value>,
    #[serde(default)]
    set: Map<String, Value>,
    live: Option<bool>,
    #[serde(default)]
    gradient: Vec<String>,
    #[serde(default = "yes")]
    gradient_errors: bool,
    #[serde(default)]
    gradient_edges: bool,
    #[serde(default)]
    check_edges: bool,
    adjoints: Option<Vec<AdjointHeader>>,
    #[serde(default)]
    progress: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NumbersHeader {
    #[allow(dead_code, reason = "read before")]
    id: Value,
    #[allow(dead_code, reason = "read before")]
    request: String,
    scene: Value,
    names: Vec<String>,
}

/// An array of adjoints that comes after the header.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AdjointHeader {
    detector: String,
    bytes: usize,
}

fn yes() -> bool {
    true
}

#[derive(Parser)]
#[command(no_binary_name = true, disable_help_flag = true)]
struct Options {
    #[command(flatten)]
    trace: TraceArgs,
    #[arg(long, value_parser = parse_record_paths)]
    record_paths: Option<RecordPaths>,
    #[command(flatten)]
    photometric: PhotometricArg,
}

impl Request {
    /// Reads a header.
    ///
    /// # Errors
    /// [`Error::Usage`] if it asks for nothing that there is.
    pub(crate) fn of(header: Value, arrays: &[u8]) -> Result<Self> {
        match header.get("request").and_then(Value::as_str) {
            Some("hello") => Ok(Request::Hello),
            Some("numbers") => {
                let NumbersHeader { scene, names, .. } = read(header)?;
                Ok(Request::Numbers { scene: text_of(scene), names })
            }
            Some("recoat") => read(header).map(|request| Request::Recoat(Box::new(request))),
            Some("trace") => {
                TraceRequest::of(header, arrays).map(|request| Request::Trace(Box::new(request)))
            }
            Some(other) => Err(Error::Usage(format!(
                "there is no request `{other}`; there are hello, numbers, recoat, trace, stop and cancel"
            ))),
            None => Err(Error::Usage(
                "the header has no text `request`: hello, numbers, recoat, trace, stop or cancel".into(),
            )),
        }
    }
}

impl TraceRequest {
    fn of(header: Value, arrays: &[u8]) -> Result<Self> {
        let header: TraceHeader = read(header)?;
        let Options { trace, record_paths, photometric } = options(&header.options)?;
        Ok(TraceRequest {
            scene: text_of(header.scene),
            name: header.name,
            folder: header.folder.unwrap_or_default(),
            set: numbers(&header.set)?,
            args: trace,
            record_paths: record_paths.unwrap_or(RecordPaths::None),
            photometric,
            live: header.live,
            gradient: header.gradient,
            gradient_errors: header.gradient_errors,
            gradient_edges: header.gradient_edges,
            check_edges: header.check_edges,
            adjoints: header.adjoints.map(|told| adjoints(told, arrays)).transpose()?,
            progress: header.progress,
        })
    }
}

fn read<T: serde::de::DeserializeOwned>(header: Value) -> Result<T> {
    serde_json::from_value(header).map_err(|error| Error::Usage(format!("the request: {error}")))
}

/// A scene's text, be it given as a text or as an object.
fn text_of(scene: Value) -> String {
    match scene {
        Value::String(text) => text,
        object => object.to_string(),
    }
}

/// The arrays of adjoints, each in the format `.npy`.
fn adjoints(told: Vec<AdjointHeader>, mut arrays: &[u8]) -> Result<Vec<(String, ArrayD<f64>)>> {
    let mut found = Vec::new();
    for AdjointHeader { detector, bytes } in told {
        let problem = |problem: &dyn std::fmt::Display| {
            Error::Usage(format!(
                "adjoints of `{detector}`: {problem}; give an array of float64 in the format .npy"
            ))
        };
        let (own, rest) =
            arrays.split_at_checked(bytes).ok_or_else(|| problem(&"the arrays of the message end before"))?;
        arrays = rest;
        let array = ArrayD::<f64>::read_npy(own).map_err(|error| problem(&error))?;
        found.push((detector, array));
    }
    Ok(found)
}

/// Numbers to set: `{"L1.r1": 51.0}`.
fn numbers(given: &Map<String, Value>) -> Result<Vec<(String, f64)>> {
    let number = |(name, value): (&String, &Value)| match value.as_f64() {
        Some(number) => Ok((name.clone(), number)),
        None => Err(Error::Usage(format!("set.{name} is {value}; give a number"))),
    };
    given.iter().map(number).collect()
}

/// Options as the command parses them: `{"num_rays": 10000}` is `--num-rays=10000`.
fn options(given: &Map<String, Value>) -> Result<Options> {
    let mut arguments = Vec::new();
    for (name, value) in given {
        let value = match value {
            Value::Null => continue,
            Value::String(text) => text.clone(),
            Value::Number(number) => number.to_string(),
            Value::Bool(_) | Value::Array(_) | Value::Object(_) => {
                return Err(Error::Usage(format!("options.{name} is {value}; give a text or a number")));
            }
        };
        arguments.push(format!("--{}={value}", name.replace('_', "-")));
    }
    Options::try_parse_from(arguments).map_err(|error| {
        let text = error.to_string();
        let first = text.split("\n\n").next().unwrap_or(&text);
        Error::Usage(format!("options: {}", first.trim_start_matches("error: ").trim()))
    })
}
