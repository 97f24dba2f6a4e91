//! The command line: one file per subcommand. Only this room prints.
//!
//! stdout carries the result alone; progress, warnings and errors go to stderr.

mod adapters;
mod check;
mod compare;
mod completions;
pub(crate) mod console;
mod device_args;
mod diff;
mod export;
mod figures;
mod lamp;
pub mod materials;
mod merge;
pub(crate) mod output_file;
mod paths;
mod pictures;
mod progress;
mod pst;
mod quantity;
mod rays_out;
mod schema;
mod serve;
mod shader;
mod stops;
mod surfaces;
mod sweep;
mod trace;
mod trace_args;
mod verify;
#[cfg(feature = "viewer")]
mod view;

use crate::cli::console::{print, say};
use crate::error::Result;
use crate::format::for_terminal;
use clap::builder::StyledStr;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Parser, Subcommand};
use std::process::ExitCode;
use std::time::Instant;

#[derive(Parser)]
#[command(
    name = "nsq-gpu",
    version,
    about = "Monte Carlo non-sequential ray tracing of Optiland's NSQ scenes, on any GPU",
    after_help = "Exit codes: 0 done, 1 internal error, 2 usage, 3 invalid or unsupported scene, or no result, 4 no adapter, \
                  5 device lost or out of memory, 6 tolerance not met, 130 interrupted (partial results are kept)."
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Trace a scene and report what its detectors saw.
    Trace(Box<trace::Args>),
    /// Add up results of one scene that were traced apart, on one machine or several.
    Merge(merge::Args),
    /// Compare two results: whether they differ by more than chance.
    Compare(compare::Args),
    /// Say how even, how wide and how strong the light of a result is: uniformity, FWHM, beam angle, flux in a region.
    Figures(figures::Args),
    /// Write the far field of a result as a lamp file: IES LM-63 or EULUMDAT.
    Export(export::Args),
    /// Say what of a result is proven: its files by their hashes and sums, its numbers by rays that are traced again.
    Verify(verify::Args),
    /// Look at a scene while it is traced, or at results.
    #[cfg(feature = "viewer")]
    View(Box<view::Args>),
    /// List the paths that light took, the strongest first: which surfaces make a ghost, and which scatter.
    Paths(Box<paths::Args>),
    /// Say what a change does: two scenes by the same draws, A - B with its own standard errors.
    Diff(Box<diff::Args>),
    /// Check a scene file without tracing it.
    Check(check::Args),
    /// List the adapters that can trace.
    Adapters(adapters::Args),
    /// Show a material of the catalog: its entry, its source, n and k over the wavelength.
    Materials(materials::Args),
    /// Show a lamp file (.ies, .ldt): its light, its beam and its field.
    Lamp(lamp::Args),
    /// Print the WGSL that a scene is traced by, with the file that each part of it comes from.
    Shader(shader::Args),
    /// Trace a scene again and again, with some of its numbers changed: a sweep, or a Monte Carlo of tolerances.
    Sweep(Box<sweep::Args>),
    /// Say how much of the light of a far point comes to a detector, by the angle off the axis: point source transmittance.
    Pst(Box<pst::Args>),
    /// List surfaces by the stray light that they send to a detector: which of them a source lights, and which the detector sees.
    Surfaces(Box<surfaces::Args>),
    /// Keep a device and compiled shaders, and trace what is asked by messages on stdin and stdout.
    Serve(serve::Args),
    /// Print the JSON Schema of scene files.
    Schema,
    /// Print a completion script for a shell.
    Completions(completions::Args),
}

/// Runs the command, and returns the exit code of its error. Must be called before other threads run, because it may
/// set environment variables ([`crate::mesa`]).
pub fn main() -> ExitCode {
    let start = Instant::now();
    main_of("nsq-gpu", |cli: Cli| match cli.command {
        Command::Trace(args) => trace::run(&args, start),
        Command::Merge(args) => merge::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Figures(args) => figures::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Verify(args) => verify::run(&args),
        #[cfg(feature = "viewer")]
        Command::View(args) => view::run(&args),
        Command::Paths(args) => paths::run(&args, start),
        Command::Diff(args) => diff::run(&args),
        Command::Check(args) => check::run(&args),
        Command::Adapters(args) => adapters::run(&args),
        Command::Materials(args) => materials::run(&args),
        Command::Lamp(args) => lamp::run(&args),
        Command::Shader(args) => shader::run(&args),
        Command::Sweep(args) => sweep::run(&args),
        Command::Pst(args) => pst::run(&args),
        Command::Surfaces(args) => surfaces::run(&args),
        Command::Serve(args) => serve::run(&args),
        Command::Schema => schema::run(),
        Command::Completions(args) => completions::run::<Cli>(&args),
    })
}

/// Runs a program of these arguments, prints its text, and returns the exit code of its error. Must be called before
/// other threads run.
pub fn main_of<C: Parser>(name: &str, run: impl FnOnce(C) -> Result<String>) -> ExitCode {
    quiet_drivers();
    ignore_file_size_signal();
    let arguments = C::try_parse().unwrap_or_else(|error| refuse(&without_misleading_tip(error)));
    match run(arguments).and_then(|text| print(&text)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            say(&format!("{name}: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

/// Ends with the parser's words, which repeat arguments: where one would garble a terminal, without colours and escaped.
fn refuse(error: &clap::Error) -> ! {
    let text = error.render().to_string();
    if !error.use_stderr() || text == for_terminal(&text) {
        error.exit();
    }
    say(text.trim_end());
    std::process::exit(error.exit_code())
}

/// Keeps Mesa's drivers from writing to stderr. Must be called before other threads and adapters.
fn quiet_drivers() {
    // SAFETY: no other thread runs yet, and no adapter was asked for.
    #[allow(unsafe_code)]
    unsafe {
        crate::mesa::quieten();
    }
}

/// Turns a file that outgrows a limit (`ulimit -f`) into an error that is reported, like a full disk. The signal would
/// otherwise kill the process.
fn ignore_file_size_signal() {
    #[cfg(unix)]
    stops::ignore(nix::sys::signal::Signal::SIGXFSZ);
}

/// Removes clap's tip to write `-- --option`. An unknown option was misspelt, and hardly meant as a value.
fn without_misleading_tip(mut error: clap::Error) -> clap::Error {
    let invalid = error.get(ContextKind::InvalidArg).map(ToString::to_string);
    if error.kind() == ErrorKind::UnknownArgument && invalid.is_some_and(|name| name.starts_with("--")) {
        error.remove(ContextKind::Suggested);
    }
    if error.kind() == ErrorKind::InvalidSubcommand
        && error.get(ContextKind::InvalidSubcommand).is_some_and(|name| name.to_string() == "bench")
    {
        let tip = StyledStr::from("`nsq-bench`, a program of its own, measures: cargo build -p nsq-bench");
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip]));
    }
    error
}
