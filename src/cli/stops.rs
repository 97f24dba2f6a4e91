//! How a command is stopped: by a signal, or by the end of whoever started it.

use crate::error::{Error, Result};
#[cfg(unix)]
use nix::sys::signal::{SigHandler, Signal};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
#[cfg(unix)]
use std::time::Duration;

/// From now on, ends this process when stdin closes, or when the process that started this one ends.
pub(crate) fn end_with_caller() {
    std::thread::spawn(end_with_stdin);
    #[cfg(unix)]
    {
        let parent = std::os::unix::process::parent_id();
        std::thread::spawn(move || end_with_parent(parent));
    }
}

/// Waits until nobody holds the other end of stdin, then ends the process. Results appear whole or not at all, so
/// nothing is left to tidy up.
fn end_with_stdin() {
    let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
    std::process::exit(i32::from(Error::Interrupted.exit_code()));
}

/// Waits until the process that started this one has ended, then ends this one. A fork of that process may also hold
/// the other end of stdin, and live on.
#[cfg(unix)]
pub(crate) fn end_with_parent(parent: u32) {
    while std::os::unix::process::parent_id() == parent {
        std::thread::sleep(Duration::from_millis(100));
    }
    std::process::exit(i32::from(Error::Interrupted.exit_code()));
}

/// A flag that Ctrl-C, SIGTERM and SIGHUP set. A second signal ends the process at once. What the caller has had ignored
/// stays ignored: `nohup` has it so with SIGHUP, and shells with SIGINT of what runs in the background.
pub(crate) fn stop_on_interrupt() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    #[cfg(unix)]
    let ignored = ignored_signals();
    ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::Relaxed) {
            std::process::exit(i32::from(Error::Interrupted.exit_code()));
        }
    })
    .map_err(|e| Error::Internal(format!("no handler for Ctrl-C: {e}")))?;
    #[cfg(unix)]
    for signal in ignored {
        ignore(signal);
    }
    Ok(stop)
}

/// The signals that the caller has had ignored.
#[cfg(unix)]
fn ignored_signals() -> Vec<Signal> {
    let signals = [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP];
    signals.into_iter().filter(|signal| matches!(ignore(*signal), SigHandler::SigIgn)).collect()
}

/// Ignores a signal from now on, and returns how it was handled before.
#[cfg(unix)]
pub(crate) fn ignore(signal: Signal) -> SigHandler {
    // SAFETY: no handler is called.
    #[allow(unsafe_code)]
    let before = unsafe { nix::sys::signal::signal(signal, SigHandler::SigIgn) };
    before.unwrap_or(SigHandler::SigDfl)
}
