//! What commands share: reading a scene, messages on stderr, printing the result.

use crate::error::{Error, Result};
use crate::format::{for_terminal, path_text};
use crate::scene::Scene;
use std::io::Write;
use std::path::Path;

/// Reads a scene. An error about its contents begins with the file's name, because a script may trace many files.
pub(crate) fn read_scene(path: &Path) -> Result<Scene> {
    Scene::from_path(path).map_err(|error| error.in_scene(&path_text(path)))
}

/// Prints the result, which may hold names and paths of any kind, fit for a terminal. A closed pipe (`nsq-gpu ... | head`)
/// is no error.
pub fn print(text: &str) -> Result<()> {
    let mut stdout = std::io::stdout().lock();
    let written = stdout.write_all(for_terminal(text).as_bytes()).and_then(|()| stdout.flush());
    match written {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(Error::file("stdout", error)),
        _ => Ok(()),
    }
}

/// The text for stdout; printed already where the command fails all the same.
pub(crate) fn ended(printed: String, failure: Option<Error>) -> Result<String> {
    let Some(failure) = failure else { return Ok(printed) };
    print(&printed)?;
    Err(failure)
}

/// Writes a message to stderr, fit for a terminal; it is no part of the result. A failure to write is ignored, because
/// there is no other place for the message.
pub fn say(text: &str) {
    let _ = writeln!(std::io::stderr(), "{}", for_terminal(text));
}
