//! `nsq-gpu serve` over a long time: requests at random among all scenes, some broken, some cancelled. Answers equal the
//! command's, nothing hangs, and memory stays what it is. python/tests/test_session.py has what a session does in short.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

#[path = "zoo/files.rs"]
mod files;

use std::collections::HashMap;
use std::io::{Read, Write};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use files::{json_files, repository};
use serde_json::{Value, json};

fn program() -> Command {
    Command::new(assert_cmd::cargo::cargo_bin("nsq-gpu"))
}

/// A session.
struct Session {
    child: Child,
    next_id: u64,
}

impl Session {
    fn start() -> Self {
        let mut command = program();
        command.arg("serve").stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::inherit());
        Session { child: command.spawn().unwrap(), next_id: 0 }
    }

    fn send(&mut self, header: &Value) {
        let text = header.to_string();
        let stdin = self.child.stdin.as_mut().unwrap();
        let frame = [&(text.len() as u32).to_le_bytes()[..], &0_u64.to_le_bytes(), text.as_bytes()].concat();
        stdin.write_all(&frame).unwrap();
        stdin.flush().unwrap();
    }

    /// The header of the next answer.
    fn answer(&mut self) -> Value {
        let stdout = self.child.stdout.as_mut().unwrap();
        let mut frame = [0; 12];
        stdout.read_exact(&mut frame).unwrap();
        let header = u32::from_le_bytes(frame[..4].try_into().unwrap());
        let arrays = u64::from_le_bytes(frame[4..].try_into().unwrap());
        let mut bytes = vec![0; header as usize];
        stdout.read_exact(&mut bytes).unwrap();
        let mut rest = Vec::new();
        stdout.take(arrays).read_to_end(&mut rest).unwrap();
        serde_json::from_slice(&bytes).unwrap()
    }

    /// The id of a request that is sent, with its other fields.
    fn ask(&mut self, mut request: Value) -> Value {
        self.next_id += 1;
        request["id"] = self.next_id.into();
        self.send(&request);
        request["id"].clone()
    }

    /// Memory that is resident \[bytes\]; 0 where the system does not tell.
    fn memory(&self) -> u64 {
        let statm = std::fs::read_to_string(format!("/proc/{}/statm", self.child.id())).unwrap_or_default();
        statm.split(' ').nth(1).and_then(|pages| pages.parse::<u64>().ok()).unwrap_or(0) * 4096
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// What an answer tells of a trace: where every quantum went.
fn fingerprint(report: &Value) -> String {
    format!("{} {}", report["ledger"], report["surfaces"])
}

fn options(num_rays: u64, precision: &str) -> Value {
    json!({"num_rays": num_rays, "precision": precision})
}

/// The command's own answer.
fn expected(name: &str, num_rays: u64, precision: &str) -> String {
    let path = repository(&format!("scenes/{name}.json"));
    let mut command = program();
    command.arg("trace").arg(path).args(["--json", "--strict", "--progress", "never"]);
    command.args(["-n", &num_rays.to_string(), "--precision", precision]);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    fingerprint(&serde_json::from_slice(&output.stdout).unwrap())
}

fn soak(time: Duration) {
    let scenes = json_files("scenes");
    let texts: Vec<String> = scenes
        .iter()
        .map(|name| std::fs::read_to_string(repository(&format!("scenes/{name}.json"))).unwrap())
        .collect();
    let folder = repository("scenes").display().to_string();
    let mut known: HashMap<(usize, u64, &str), String> = HashMap::new();
    let mut session = Session::start();
    let mut state = 12345_u64;
    let mut draw = |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    let (start, mut counts, mut memory_then) = (Instant::now(), [0_u64; 3], 0);
    while start.elapsed() < time {
        let scene = draw(scenes.len());
        match draw(10) {
            0 => {
                let cut = draw(texts[scene].len() / 2);
                let text: String = texts[scene].chars().take(cut).collect();
                let id =
                    session.ask(json!({"request": "trace", "scene": text, "options": options(10, "f64")}));
                let answer = session.answer();
                assert_eq!((&answer["id"], &answer["reply"]), (&id, &json!("error")), "{answer}");
                assert_eq!(answer["exit_code"], 3, "{answer}");
                counts[0] += 1;
            }
            1 => {
                let request = json!({
                    "request": "trace", "scene": texts[scene], "folder": folder,
                    "options": options(1_000_000_000_000, "f64"), "live": true,
                });
                let id = session.ask(request);
                std::thread::sleep(Duration::from_millis(draw(100) as u64));
                session.send(&json!({"id": id, "request": "cancel"}));
                let answer = session.answer();
                assert_eq!((&answer["id"], &answer["exit_code"]), (&id, &json!(130)), "{answer}");
                counts[1] += 1;
            }
            _ => {
                let num_rays = [10, 500, 3000][draw(3)];
                let precision = ["f32", "f64"][draw(2)];
                let wanted = known
                    .entry((scene, num_rays, precision))
                    .or_insert_with(|| expected(&scenes[scene], num_rays, precision));
                let request = json!({
                    "request": "trace", "scene": texts[scene], "folder": folder,
                    "options": options(num_rays, precision),
                });
                let id = session.ask(request);
                let answer = session.answer();
                assert_eq!(
                    (&answer["id"], &answer["reply"]),
                    (&id, &json!("result")),
                    "{}: {answer}",
                    scenes[scene]
                );
                assert_eq!(
                    &fingerprint(&answer["report"]),
                    wanted,
                    "{} {num_rays} {precision}",
                    scenes[scene]
                );
                counts[2] += 1;
            }
        }
        if memory_then == 0 && start.elapsed() > time / 2 {
            memory_then = session.memory();
        }
    }
    let grown = session.memory().saturating_sub(memory_then) >> 20;
    let _ = writeln!(
        std::io::stderr(),
        "{} broken, {} cancelled, {} traced; memory grew by {grown} MiB",
        counts[0],
        counts[1],
        counts[2]
    );
    assert!(grown < 200, "memory grew by {grown} MiB in the second half");
}

#[test]
fn answers_equal_the_commands_for_some_seconds() {
    soak(Duration::from_secs(15));
}

#[test]
#[ignore = "long"]
fn answers_equal_the_commands_for_an_hour() {
    let seconds = std::env::var("NSQ_GPU_SOAK_SECONDS").ok().and_then(|seconds| seconds.parse().ok());
    soak(Duration::from_secs(seconds.unwrap_or(3600)));
}

/// Each request has numbers of its own, and all share one shader.
#[test]
#[ignore = "long"]
fn memory_stays_flat_over_a_hundred_thousand_requests() {
    let text = std::fs::read_to_string(repository("docs/example.json")).unwrap();
    let mut session = Session::start();
    let mut memory_then = 0;
    for i in 0..100_000_u32 {
        let radius = 50.0 + 1e-4 * f64::from(i);
        session.ask(json!({
            "request": "trace", "scene": text, "folder": repository("docs").display().to_string(),
            "options": options(100, "f64"), "set": {"L1.r1": radius},
        }));
        let answer = session.answer();
        assert_eq!(answer["reply"], "result", "{answer}");
        if i == 1000 {
            memory_then = session.memory();
        }
    }
    let grown = session.memory().saturating_sub(memory_then) >> 20;
    assert!(grown < 20, "memory grew by {grown} MiB over 99,000 requests");
}
