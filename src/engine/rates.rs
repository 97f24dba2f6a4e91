//! How fast the adapter does arithmetic. The rates are measured, because the adapter's name does not determine them.

use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::gpu::compute::bindings_of;
use crate::program::Precision;
use crate::program::layout::bindings;
use crate::program::rewrite::df64;
use std::time::Instant;

/// Multiply-adds per second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArithmeticRates {
    /// In f32.
    pub f32: f64,
    /// In df64, where the adapter's arithmetic passes the test.
    pub df64: Option<f64>,
    /// In f64, where the adapter has it.
    pub f64: Option<f64>,
}

const INVOCATIONS: u32 = 1 << 14;
const MULTIPLY_ADDS: u32 = 1 << 10;

/// Four independent chains, which a superscalar machine can overlap.
const SHADER: &str = "
@group(0) @binding(0) var<storage, read_write> values: array<real>;
@compute @workgroup_size(64)
fn measure(@builtin(global_invocation_id) id: vec3<u32>) {
    let seed = values[id.x];
    var v = vec4<real>(seed, seed + 0.25, seed + 0.5, seed + 0.75);
    for (var i = 0u; i < 256u; i++) {
        v = v * real(0.999) + vec4<real>(seed);
    }
    values[id.x] = v.x + v.y + v.z + v.w;
}
";

impl Gpu {
    /// Measures every precision.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn arithmetic_rates(&self) -> Result<ArithmeticRates> {
        let rate = |precision, there| if there { self.rate(precision).map(Some) } else { Ok(None) };
        let df64 = rate(Precision::Df64, self.check_df64().is_ok())?;
        let f64 = rate(Precision::F64, self.f64)?;
        Ok(ArithmeticRates { f32: self.rate(Precision::F32)?, df64, f64 })
    }

    fn rate(&self, precision: Precision) -> Result<f64> {
        let parse =
            |wgsl: &str| naga::front::wgsl::parse_str(wgsl).map_err(|e| Error::Internal(e.to_string()));
        let (module, wgsl) = match precision {
            Precision::F32 | Precision::F64 => {
                let wgsl = format!("alias real = {};{SHADER}", precision.name());
                (parse(&wgsl)?, wgsl)
            }
            Precision::Df64 => {
                let library = bindings::declared(df64::LIBRARY);
                df64::rewrite(&parse(&format!("alias real = f64;{library}{SHADER}"))?)?
            }
        };
        let layout = self.bind_group_layout("rates", &bindings_of(&module), 0);
        let pipeline = self.pipeline("measure", &self.shader("rates", &wgsl), &[&layout], &[]);
        let buffer = self.buffer("rates", u64::from(INVOCATIONS) * 8)?;
        let zero = self.constant_buffer("rates", &[0; 16]);
        let buffers =
            [(0, &buffer)].into_iter().chain((precision == Precision::Df64).then_some((df64::ZERO, &zero)));
        let group = self.bind_group("rates", &layout, buffers, &[]);
        let run = || -> Result<f64> {
            let start = Instant::now();
            self.dispatch(&pipeline, &group, INVOCATIONS / 64);
            self.wait()?;
            Ok(start.elapsed().as_secs_f64())
        };
        // The first dispatch compiles.
        run()?;
        let fastest = run()?.min(run()?).max(1e-9);
        Ok(f64::from(INVOCATIONS) * f64::from(MULTIPLY_ADDS) / fastest)
    }
}
