//! Environment variables that keep Mesa's drivers from writing to stderr; they must be set before the drivers start.

use std::path::Path;

/// Where Wayland's library looks for a compositor. The library complains if the variable is missing or no absolute
/// path.
const RUNTIME_FOLDER: &str = "XDG_RUNTIME_DIR";
/// A folder that does not exist. A program without a compositor needs no more.
const NOWHERE: &str = "/nonexistent";
/// If this variable is true, drivers do not announce at every start that they have not been certified.
const IGNORE_CONFORMANCE: &str = "MESA_VK_IGNORE_CONFORMANCE_WARNING";

/// Sets the variables that keep Mesa silent, where nobody has set them. Mesa's layer that sorts devices asks Wayland's
/// library for a compositor, even where no window is wanted.
///
/// # Safety
/// No other thread may run yet, because it could read the environment meanwhile. No adapter may have been asked for.
#[allow(unsafe_code)]
pub unsafe fn quieten() {
    if !cfg!(unix) {
        return;
    }
    let is_absolute = std::env::var_os(RUNTIME_FOLDER).is_some_and(|folder| Path::new(&folder).is_absolute());
    let conformance = std::env::var_os(IGNORE_CONFORMANCE).is_none().then_some((IGNORE_CONFORMANCE, "true"));
    let runtime_folder = (!is_absolute).then_some((RUNTIME_FOLDER, NOWHERE));
    for (name, value) in conformance.into_iter().chain(runtime_folder) {
        // SAFETY: nobody reads the environment meanwhile, as the caller promises.
        unsafe { std::env::set_var(name, value) };
    }
}
