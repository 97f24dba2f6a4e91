//! `nsq-gpu completions`: completion scripts for shells.

use crate::error::Result;
use clap::CommandFactory;

/// Arguments of `nsq-gpu completions`.
#[derive(clap::Args)]
pub struct Args {
    /// The shell to complete in.
    shell: clap_complete::Shell,
}

/// The generator names a subcommand in two ways where the program's name has a dash, so that bash never found its options.
fn with_one_name_per_subcommand(script: &str) -> String {
    script.replace("nsq__subcmd__gpu", "nsq__gpu")
}

/// The script.
pub fn run<C: CommandFactory>(args: &Args) -> Result<String> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut C::command(), "nsq-gpu", &mut script);
    let script = String::from_utf8_lossy(&script).into_owned();
    Ok(if args.shell == clap_complete::Shell::Bash { with_one_name_per_subcommand(&script) } else { script })
}
