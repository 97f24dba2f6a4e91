//! `nsq-gpu serve`: one process that keeps its device and its compiled shaders. Messages on stdin ask for traces, and
//! answers go to stdout. docs/reference/serve.md describes the messages.

mod frames;
mod requests;
mod traces;

use crate::cli::device_args::DeviceArgs;
use crate::cli::progress;
use crate::cli::serve::frames::Incoming;
use crate::cli::serve::requests::{PathRow, RecoatRequest, Request, TraceRequest};
use crate::error::{Error, Result};
use crate::model::Sequence;
use crate::result::coating_rank::{self, Ghost, Ghosts};
use crate::result::{Recoating, Report, TraceResult, npz_files, report};
use crate::run::gradients::LossWithEdges;
use crate::run::{LossDerivatives, Next, Session, Status, missed_target};
use crate::scene::Scene;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::time::{Duration, Instant};

/// Version of the messages. It grows when a message changes its meaning or goes away, not when one is added.
pub const PROTOCOL: u32 = 1;

/// Shortest time between two messages of progress.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(100);

/// Arguments of `nsq-gpu serve`.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    device: DeviceArgs,
}

/// How a request that is not answered goes on: set by the thread that listens.
#[derive(Default)]
struct Flag(AtomicU8);

impl Flag {
    const STOPPED: u8 = 1;
    const CANCELLED: u8 = 2;

    /// Never takes a cancel back.
    fn raise(&self, to: u8) {
        self.0.fetch_max(to, Ordering::Relaxed);
    }

    fn next(&self) -> Next {
        match self.0.load(Ordering::Relaxed) {
            0 => Next::GoOn,
            Flag::STOPPED => Next::Stop,
            _ => Next::Cancel,
        }
    }
}

/// The traces that are asked for and not answered.
type Flags = Arc<Mutex<HashMap<String, Arc<Flag>>>>;

/// A message for the thread that traces.
enum Job {
    Request {
        id: Value,
        header: Value,
        arrays: Vec<u8>,
        flag: Arc<Flag>,
    },
    Broken(String),
    /// The stream of requests has ended; with an error if it cannot be read on.
    End(Option<String>),
}

/// Answers requests until stdin closes or the parent ends.
pub fn run(args: &Args) -> Result<String> {
    #[cfg(unix)]
    {
        let parent = std::os::unix::process::parent_id();
        std::thread::spawn(move || crate::cli::stops::end_with_parent(parent));
    }
    let mut session = Session::new(args.device.choice());
    let flags = Flags::default();
    let (sender, jobs) = mpsc::channel();
    let known = flags.clone();
    std::thread::spawn(move || listen(&sender, &known));
    // Opened before the first request comes. An error is that request's answer.
    let _ = session.open();
    let mut output = Output(std::io::BufWriter::new(std::io::stdout()));
    for job in jobs {
        let problem = match job {
            Job::Request { id, header, arrays, flag } => {
                let answered = answer(&mut session, &mut output, &id, (header, &arrays), &flag);
                flags.lock().unwrap_or_else(PoisonError::into_inner).remove(&id.to_string());
                answered
            }
            Job::Broken(problem) => output.fail(&Value::Null, &Error::Usage(problem)),
            Job::End(None) => break,
            Job::End(Some(problem)) => {
                output.fail(&Value::Null, &Error::Usage(problem.clone()))?;
                return Err(Error::Usage(problem));
            }
        };
        problem?;
    }
    Ok(String::new())
}

/// Reads stdin to its end. Stops and cancels take effect at once, also for requests that wait.
fn listen(jobs: &mpsc::Sender<Job>, flags: &Flags) {
    let mut input = std::io::BufReader::new(std::io::stdin());
    loop {
        let job = match frames::read(&mut input) {
            Ok(None) => Job::End(None),
            Err(error) => Job::End(Some(error.to_string())),
            Ok(Some(Incoming::Broken(problem))) => Job::Broken(problem),
            Ok(Some(Incoming::Header(header, arrays))) => {
                let id = header.get("id").cloned().unwrap_or(Value::Null);
                let mut flags = flags.lock().unwrap_or_else(PoisonError::into_inner);
                let raised = match header.get("request").and_then(Value::as_str) {
                    Some("stop") => Some(Flag::STOPPED),
                    Some("cancel") => Some(Flag::CANCELLED),
                    _ => None,
                };
                if let Some(raised) = raised {
                    flags.get(&id.to_string()).into_iter().for_each(|flag| flag.raise(raised));
                    continue;
                }
                let flag = Arc::new(Flag::default());
                flags.insert(id.to_string(), flag.clone());
                Job::Request { id, header, arrays, flag }
            }
        };
        let is_end = matches!(job, Job::End(_));
        if jobs.send(job).is_err() || is_end {
            return;
        }
    }
}

/// Answers one request. Only a failure of stdout is an error.
fn answer(
    session: &mut Session,
    output: &mut Output,
    id: &Value,
    (header, arrays): (Value, &[u8]),
    flag: &Flag,
) -> Result<()> {
    let request = match Request::of(header, arrays) {
        Ok(request) => request,
        Err(error) => return output.fail(id, &error),
    };
    match request {
        Request::Hello => {
            let [num_shaders, shader_bytes] = session.shaders();
            match session.open() {
                Ok(gpu) => {
                    let (adapter, driver) = (gpu.info.name.clone(), gpu.info.driver.clone());
                    output.send(&json!({
                        "id": id,
                        "reply": "hello",
                        "protocol": PROTOCOL,
                        "program": env!("CARGO_PKG_NAME"),
                        "version": env!("CARGO_PKG_VERSION"),
                        "adapter": adapter,
                        "driver": driver,
                        "num_shaders": num_shaders,
                        "shader_bytes": shader_bytes,
                    }))
                }
                Err(error) => output.fail(id, &error),
            }
        }
        Request::Numbers { scene, names } => match Scene::numbers(&scene, &names) {
            Ok(values) => {
                output.send(&json!({"id": id, "reply": "numbers", "names": names, "values": values}))
            }
            Err(error) => output.fail(id, &error),
        },
        Request::Recoat(request) => match recoat(&request) {
            Ok(Value::Object(found)) => {
                let mut reply = json!({"id": id, "reply": "recoat"});
                found.into_iter().for_each(|(key, value)| reply[key] = value);
                output.send(&reply)
            }
            Ok(_) => output.fail(id, &Error::Internal("the answer is no object".into())),
            Err(error) => output.fail(id, &error),
        },
        Request::Trace(request) => trace(session, output, id, &request, flag),
    }
}

/// What other coatings do to rows: the factors of their light, the changed faces, warnings, and the rank of the coatings.
fn recoat(request: &RecoatRequest) -> Result<Value> {
    let mut ir = Scene::with_numbers(&request.scene(), &request.folder, &[])?.lower()?;
    ir.sampling.split_depth = ir.sampling.split_depth.max(request.split_depth);
    let paths: Vec<Sequence> = request.rows.iter().map(|row| row.sequence(&ir)).collect::<Result<_>>()?;
    let recoating = Recoating::new(&ir, &request.coatings)?;
    recoating.check(&ir, paths.iter())?;
    let fluxes = request.rows.iter().map(|row| row.flux);
    let mut warnings = recoating.warnings(&ir, paths.iter().zip(fluxes));
    let mut found = json!({
        "factors": paths.iter().map(|path| recoating.factor(path)).collect::<Vec<_>>(),
        "recoated": recoating.recoated(),
    });
    if request.rank {
        let ghost = |(sequence, row): (_, &PathRow)| Ghost {
            sequence,
            flux: row.flux,
            standard_error: row.standard_error,
        };
        let ghosts = Ghosts::among(&ir, paths.iter().zip(&request.rows).map(ghost));
        found["coatings"] = json!(coating_rank::rank(&ir, &recoating, &ghosts));
        warnings.extend(coating_rank::warnings(&ir, &ghosts));
    }
    found["warnings"] = warnings.into();
    Ok(found)
}

fn trace(
    session: &mut Session,
    output: &mut Output,
    id: &Value,
    request: &TraceRequest,
    flag: &Flag,
) -> Result<()> {
    let mut told = Instant::now();
    let mut unsent = Ok(());
    if flag.next() != Next::GoOn {
        return output.fail(id, &Error::Interrupted);
    }
    let traced = catch_unwind(AssertUnwindSafe(|| {
        let next = |status: &Status| {
            let is_last = status.rays >= status.num_rays;
            // A stop is acknowledged: writing what was traced may take long.
            let is_due = request.progress && (is_last || told.elapsed() >= PROGRESS_INTERVAL);
            if is_due || flag.next() == Next::Stop {
                told = Instant::now();
                unsent = output.send(&progress_of(id, status));
            }
            if unsent.is_ok() { flag.next() } else { Next::Cancel }
        };
        match &request.adjoints {
            None => request.trace(session, next).map(|result| Answer::Traced(Box::new(result))),
            Some(adjoints) => request.loss_gradient(session, adjoints, next).map(Answer::Loss),
        }
    }));
    unsent?;
    match traced {
        Ok(Ok(Answer::Traced(result))) => output.send_result(id, &result),
        Ok(Ok(Answer::Loss(found))) => output.send(&loss_gradient(id, &request.gradient, &found)),
        Ok(Err(error)) => {
            if matches!(error, Error::Device(_)) {
                session.close();
            }
            output.fail(id, &error)
        }
        Err(_) => {
            session.close();
            output.fail(id, &Error::Internal("the trace ended by a panic".into()))
        }
    }
}

/// The message of the gradient of a loss by some parameters.
fn loss_gradient(id: &Value, parameters: &[String], found: &LossDerivatives) -> Value {
    let LossDerivatives { gradient, with_edges, not_confirmed } = found;
    let of_edges =
        |edges: &LossWithEdges| json!({"value": edges.value, "standard_error": edges.standard_error});
    let not_confirmed = not_confirmed.iter().map(|(number, edges)| {
        let mut entry = of_edges(edges);
        entry["parameter"] = parameters[*number].clone().into();
        entry["interior"] = gradient.values[*number].into();
        entry
    });
    json!({
        "id": id,
        "reply": "loss_gradient",
        "parameters": parameters,
        "values": gradient.values,
        "num_lost": gradient.num_lost,
        "num_forward": gradient.num_forward,
        "why_forward": gradient.why_forward,
        "with_edges": with_edges.iter().map(of_edges).collect::<Vec<_>>(),
        "not_confirmed": not_confirmed.collect::<Vec<_>>(),
    })
}

fn progress_of(id: &Value, status: &Status) -> Value {
    let mut message = json!({"id": id, "reply": "progress"});
    let fields = progress::json(status).as_object().cloned().unwrap_or_default();
    fields.into_iter().for_each(|(key, value)| message[key] = value);
    message
}

/// What a request is answered with.
enum Answer {
    Traced(Box<TraceResult>),
    Loss(LossDerivatives),
}

/// Where answers go.
struct Output(std::io::BufWriter<std::io::Stdout>);

impl Output {
    fn send(&mut self, header: &Value) -> Result<()> {
        frames::write(&mut self.0, header, std::iter::empty()).map_err(|error| Error::file("stdout", error))
    }

    fn fail(&mut self, id: &Value, error: &Error) -> Result<()> {
        let exit_code = error.exit_code();
        self.send(&json!({"id": id, "reply": "error", "exit_code": exit_code, "message": error.to_string()}))
    }

    fn send_result(&mut self, id: &Value, result: &TraceResult) -> Result<()> {
        let arrays = arrays(result)?;
        let told = arrays.iter().map(|DetectorArray { detector, name, bytes }| {
            json!({"detector": detector, "name": name, "bytes": bytes.len()})
        });
        let header = json!({
            "id": id,
            "reply": "result",
            "report": Report::new(result, &report::Files::default()),
            "missed_target": missed_target(result),
            "arrays": told.collect::<Vec<_>>(),
        });
        let arrays = arrays.iter().map(|array| &array.bytes[..]);
        frames::write(&mut self.0, &header, arrays).map_err(|error| Error::file("stdout", error))
    }
}

/// An array of a result.
struct DetectorArray<'a> {
    /// The detector that it is of; of recorded paths none.
    detector: Option<&'a str>,
    name: String,
    /// The array in the format `.npy`.
    bytes: Vec<u8>,
}

fn arrays(result: &TraceResult) -> Result<Vec<DetectorArray<'_>>> {
    let mut arrays = Vec::new();
    for detector in &result.detectors {
        let own = npz_files::detector_arrays(result, detector)?;
        let of_detector = |(name, bytes)| DetectorArray { detector: Some(&detector.name), name, bytes };
        arrays.extend(own.into_iter().map(of_detector));
    }
    if !result.gradients.is_empty() {
        let own = npz_files::gradient_arrays(result)?;
        arrays.extend(own.into_iter().map(|(name, bytes)| DetectorArray { detector: None, name, bytes }));
    }
    if let Some(paths) = &result.ray_paths {
        let own = npz_files::ray_path_arrays(result, paths)?;
        arrays.extend(own.into_iter().map(|(name, bytes)| DetectorArray { detector: None, name, bytes }));
    }
    Ok(arrays)
}
