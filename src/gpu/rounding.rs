//! How an adapter rounds quotients and square roots. Vulkan lets a quotient of f32 be 2.5 units of the last place off.
//! So strict arithmetic gives the same bits on two adapters only where both round to the nearest number.

use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::gpu::compute::bindings_of;
use bytemuck::Pod;

/// Results that are not the nearest number, as shares of those tried.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Misrounded {
    /// Quotients.
    pub quotients: f64,
    /// Square roots.
    pub roots: f64,
}

impl Misrounded {
    /// True if every result is the nearest number.
    pub fn none(&self) -> bool {
        self.quotients == 0.0 && self.roots == 0.0
    }
}

const NUM_PAIRS: u32 = 1 << 14;
const WORKGROUP: u32 = 64;

const SHADER: &str = "
@group(0) @binding(0) var<storage, read> pairs: array<vec2<real>>;
@group(0) @binding(1) var<storage, read_write> results: array<vec2<real>>;
@compute @workgroup_size(64)
fn divide(@builtin(global_invocation_id) id: vec3<u32>) {
    let pair = pairs[id.x];
    results[id.x] = vec2<real>(pair.x / pair.y, sqrt(pair.x));
}
";

/// A precision of the device, as the host computes in it.
trait Real: Pod + PartialEq {
    const NAME: &'static str;
    fn of(value: f64) -> Self;
    fn results(pair: [Self; 2]) -> [Self; 2];
}

macro_rules! real {
    ($type:ident) => {
        impl Real for $type {
            const NAME: &'static str = stringify!($type);
            fn of(value: f64) -> Self {
                value as $type
            }
            fn results([a, b]: [Self; 2]) -> [Self; 2] {
                [a / b, a.sqrt()]
            }
        }
    };
}
real!(f32);
real!(f64);

/// Pairs of positive numbers with random digits, from 2^-20 to 2^20.
fn pairs<T: Real>() -> Vec<[T; 2]> {
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let mut number = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let bits = (state ^ (state >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let exponent = (bits >> 56) as i32 % 41 - 20;
        T::of((1.0 + (bits << 8) as f64 / 2_f64.powi(64)) * 2_f64.powi(exponent))
    };
    (0..NUM_PAIRS).map(|_| [number(), number()]).collect()
}

impl Gpu {
    /// How the adapter rounds in f32, and in f64 where it has f64; as strict traces compute, where it takes these.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn misrounded(&self) -> Result<(Misrounded, Option<Misrounded>)> {
        let in_f64 = self.f64.then(|| self.misrounded_in::<f64>()).transpose()?;
        Ok((self.misrounded_in::<f32>()?, in_f64))
    }

    fn misrounded_in<T: Real>(&self) -> Result<Misrounded> {
        let wgsl = format!("alias real = {};{SHADER}", T::NAME);
        let module =
            naga::front::wgsl::parse_str(&wgsl).map_err(|error| Error::Internal(error.to_string()))?;
        let bindings = bindings_of(&module);
        let shader = match self.info.strict {
            true => self.strict_shader("divide", &module, &bindings)?,
            false => self.shader("divide", &wgsl),
        };
        let layout = self.bind_group_layout("rounding", &bindings, 0);
        let pipeline = self.pipeline("divide", &shader, &[&layout], &[]);
        let pairs = pairs::<T>();
        let numbers = self.constant_buffer("rounding", bytemuck::cast_slice(&pairs));
        let size = size_of_val(&pairs[..]) as u64;
        let results = self.buffer("rounding", size)?;
        let group = self.bind_group("rounding", &layout, [(0, &numbers), (1, &results)], &[]);
        self.dispatch(&pipeline, &group, NUM_PAIRS / WORKGROUP);
        let found: Vec<[T; 2]> = bytemuck::pod_collect_to_vec(&self.read(&results, size)?);
        let wrong = |which: usize| {
            let differs = |(pair, found): (&[T; 2], &[T; 2])| T::results(*pair)[which] != found[which];
            pairs.iter().zip(&found).filter(|both| differs(*both)).count() as f64 / f64::from(NUM_PAIRS)
        };
        Ok(Misrounded { quotients: wrong(0), roots: wrong(1) })
    }
}
