//! Watches a result converge, and stops the trace when every detector is known to a percent.
//!
//! A trace is a sum over rays, so that the sums so far are a whole result at any moment, with standard errors.
//!
//! `cargo run --example progressive`

#![allow(clippy::print_stdout, reason = "an example shows what it found")]

use nsq_gpu::run::Next;
use nsq_gpu::{Result, Run};

fn main() -> Result<()> {
    let mut next = 0;
    // The closure runs after each pass of some 40 ms, and says how the trace goes on.
    let outcome = Run::open("docs/example.json")?.rays(1e8)?.target_error(0.01)?.go_with(|pass| {
        let rays = pass.status.rays;
        if rays >= next {
            next = 2 * rays;
            let error = pass.result()?.relative_error.unwrap_or(f64::NAN);
            println!("{rays:>9} rays: relative error {:.2} %", 100.0 * error);
        }
        Ok(Next::GoOn)
    })?;
    println!("{}", outcome.result.report());
    Ok(())
}
