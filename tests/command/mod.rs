//! Runs the command in the root of the repository, for tests.
#![allow(dead_code, clippy::unwrap_used, reason = "each test binary compiles these, and uses some")]

use std::io::Write;
use std::process::{Command, Output};

/// True if there is an adapter; else says by name that a test is skipped, straight to the stream: the test runner hides what
/// a passing test prints.
pub fn has_adapter(test: &str) -> bool {
    let found = !nsq_gpu::gpu::list_adapters().is_empty();
    if !found {
        let _ = writeln!(std::io::stderr(), "SKIPPED: {test}: no adapter");
    }
    found
}

/// The command with these arguments.
pub fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_nsq-gpu"));
    command.args(arguments).current_dir(env!("CARGO_MANIFEST_DIR"));
    command
}

/// What the command says to these arguments.
pub fn run(arguments: &[&str]) -> Output {
    command(arguments).output().unwrap()
}

/// The text on stderr.
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}
