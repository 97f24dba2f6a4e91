//! Traces a lens from a file: reads the scene, launches a million rays, prints the report, writes the results.
//!
//! `cargo run --example trace_a_lens`, or with a scene of your own: `cargo run --example trace_a_lens -- lens.json`

#![allow(clippy::print_stdout, reason = "an example shows what it found")]

use nsq_gpu::result::output;
use nsq_gpu::{Result, Run};
use std::path::Path;

fn main() -> Result<()> {
    let path = std::env::args().nth(1).unwrap_or("docs/example.json".into());
    // Reading proves a scene valid: an error names the place in the file, and what would be right.
    let result = Run::open(path)?.rays(1e6)?.go()?.result;
    println!("{}", result.report());
    for file in output::write_all(Path::new("example-out"), &result)? {
        println!("{}", file.display());
    }
    Ok(())
}
