//! `nsq-gpu adapters`: lists the adapters that can trace here.

use crate::error::{Error, Result};
use crate::gpu::rounding::Misrounded;
use crate::gpu::{self, AdapterChoice, AdapterInfo, Gpu};
use std::fmt::Write;

/// What other vectors of lavapipe's are good for. Lavapipe reads its variable once, before the first adapter.
const WIDTHS: &str = "LP_NATIVE_VECTOR_WIDTH=128 compiles sooner, for short traces in f64; 512 may suit long traces in f32 on AVX-512";

/// Arguments of `nsq-gpu adapters`.
#[derive(clap::Args)]
pub struct Args {
    /// Measure the rates of f32, df64 and f64 arithmetic, and how f32 and f64 are rounded.
    #[arg(long)]
    measure: bool,
}

/// Returns one paragraph per adapter. The adapter that `trace` chooses comes first.
pub fn run(args: &Args) -> Result<String> {
    let adapters = gpu::list_adapters();
    if adapters.is_empty() {
        // Opening a device fails with a message that says what to install.
        return Gpu::open(&AdapterChoice::default()).map(|_| String::new());
    }
    let text: String = adapters.iter().map(|info| describe(info, args.measure)).collect::<Result<_>>()?;
    let no_gpu = "no GPU was found: this is your processor, by a driver in software\n";
    Ok(if adapters.iter().all(|info| info.class.stands_in_for_gpu()) { text + no_gpu } else { text })
}

fn describe(info: &AdapterInfo, measure: bool) -> Result<String> {
    let mut text = format!("{} ({}, {}; {})\n", info.name, info.backend, info.kind, info.driver);
    let yes_no = |has| if has { "yes" } else { "no" };
    let _ = writeln!(text, "  64-bit floats: {}", yes_no(info.f64));
    let choice = AdapterChoice { name: Some(info.name.clone()), ..Default::default() };
    let gpu = Gpu::open(&choice)?;
    let pairs = match gpu.check_df64() {
        Ok(()) => "yes: its arithmetic passes the test".into(),
        Err(error) => format!("no: {error}"),
    };
    let _ = writeln!(text, "  pairs of 32-bit floats (df64): {pairs}");
    let _ = writeln!(text, "  64-bit integers and atomics: {}", yes_no(info.int64));
    let _ = writeln!(text, "  largest binding: {} MiB", info.max_binding_size >> 20);
    if info.class.has_vectors_of_a_set_width() && info.is_vulkan() {
        let _ = writeln!(text, "  vectors: {} bits; {WIDTHS}", 32 * gpu.vector_lanes());
    }
    if measure {
        let rates = gpu.arithmetic_rates()?;
        let _ = writeln!(text, "  f32: {:.1} G multiply-adds/s", rates.f32 / 1e9);
        for (name, rate) in [("df64", rates.df64), ("f64", rates.f64)] {
            if let Some(rate) = rate {
                let (billions, share) = (rate / 1e9, rate / rates.f32);
                let _ = writeln!(text, "  {name}: {billions:.1} G multiply-adds/s ({share:.2} of f32)");
            }
        }
        let (in_f32, in_f64) = gpu.misrounded()?;
        for (name, found) in [("f32", Some(in_f32)), ("f64", in_f64)] {
            let _ = found.map(|found| writeln!(text, "  rounding in {name}: {}", rounding(&found)));
        }
    }
    if text.is_empty() { Err(Error::Internal("an adapter without a name".into())) } else { Ok(text) }
}

fn rounding(found: &Misrounded) -> String {
    match found.none() {
        true => "to the nearest".into(),
        false => format!(
            "{:.1} % of quotients and {:.1} % of square roots are not the nearest numbers",
            100.0 * found.quotients,
            100.0 * found.roots
        ),
    }
}
