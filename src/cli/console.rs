//! What commands share: reading a scene, messages on stderr, printing the result.

#[cfg(feature = "cpu")]
use crate::cpu::vector_width::Width;
use crate::error::{Error, Result};
use crate::format::{for_terminal, path_text};
use crate::model::SceneIr;
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

/// Writes a message to stderr, fit for a terminal; it is no part of the result. Without stderr, it cannot be told.
pub fn say(text: &str) {
    let _ = writeln!(std::io::stderr(), "{}", for_terminal(text));
}

/// Lets lavapipe compute in vectors as wide as suits this trace. Must be called before other threads and adapters.
/// [`crate::cli::main`] demands that no other threads run, and each command calls this before it asks for an adapter.
#[cfg_attr(not(feature = "cpu"), allow(unused_variables, reason = "the driver's own width is taken"))]
pub(crate) fn choose_vectors(ir: &SceneIr, num_rays: u64, in_f64: bool) {
    #[cfg(feature = "cpu")]
    choose_width(Width::of_command(ir, num_rays, in_f64));
}

/// As [`choose_vectors`], with this width.
#[cfg(feature = "cpu")]
pub fn choose_width(width: Width) {
    // SAFETY: no other thread runs yet, and no adapter was asked for.
    #[allow(unsafe_code)]
    unsafe {
        crate::cpu::vector_width::choose(width);
    }
}
