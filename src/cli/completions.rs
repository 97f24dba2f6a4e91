//! `nsq-gpu completions`: prints completion scripts for shells.

use crate::error::Result;
use clap::CommandFactory;

/// Arguments of `nsq-gpu completions`.
#[derive(clap::Args)]
pub struct Args {
    /// The shell to complete in.
    shell: clap_complete::Shell,
}

/// Gives each subcommand one name. Where the program's name has a dash, the generator uses two names, and bash finds no
/// options.
fn with_one_name_per_subcommand(script: &str) -> String {
    script.replace("nsq__subcmd__gpu", "nsq__gpu")
}

/// Returns the script.
pub fn run<C: CommandFactory>(args: &Args) -> Result<String> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut C::command(), "nsq-gpu", &mut script);
    let script = String::from_utf8_lossy(&script).into_owned();
    Ok(if args.shell == clap_complete::Shell::Bash { with_one_name_per_subcommand(&script) } else { script })
}
