//! `nsq-gpu completions`: completion scripts for shells.

use crate::error::Result;
use clap::CommandFactory;

/// Arguments of `nsq-gpu completions`.
#[derive(clap::Args)]
pub struct Args {
    /// The shell to complete in.
    shell: clap_complete::Shell,
}

/// The script.
pub fn run<C: CommandFactory>(args: &Args) -> Result<String> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut C::command(), "nsq-gpu", &mut script);
    Ok(String::from_utf8_lossy(&script).into_owned())
}
