//! Tests df64 on this device: whether a pair of f32 can stand for a real, by comparing its arithmetic with IEEE 754.
//!
//! The functions of `shaders/math/df64.wgsl` rest on sums and products whose roundings are known exactly. A device or
//! compiler that rounds otherwise, fuses or reorders must not be used with them.

use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::gpu::compute::bindings_of;
use crate::program::layout::bindings;
use crate::program::rewrite::df64::{self, join, split};
use std::fmt::Write;

/// The number of pairs on which every operation is tested.
const NUM_PAIRS: u32 = 1 << 13;
const WORKGROUP: u32 = 64;

/// u^2, u = 2^-24.
const UNIT: f64 = 0.25 * f32::EPSILON as f64 * f32::EPSILON as f64;

/// An operation, its exact result, and its error bound in u^2.
struct Operation {
    /// The call in WGSL, with the reals `x` and `y`.
    call: &'static str,
    exact: fn([f64; 2]) -> f64,
    bound: f64,
}

/// The operations of two reals. The bounds of quotient and root allow for a division and a root with errors of 2.5 ulp,
/// as in WGSL and Vulkan.
const OPERATIONS: [Operation; 14] = [
    Operation { call: "df64_add(x, y)", exact: |[x, y]| x + y, bound: 3.0 },
    Operation { call: "df64_sub(x, y)", exact: |[x, y]| x - y, bound: 3.0 },
    Operation { call: "df64_add_f(x, y.x)", exact: |[x, y]| x + f64::from(y as f32), bound: 2.0 },
    Operation { call: "df64_mul(x, y)", exact: |[x, y]| x * y, bound: 5.0 },
    Operation { call: "df64_mul_f(x, y.x)", exact: |[x, y]| x * f64::from(y as f32), bound: 3.0 },
    Operation { call: "df64_square(x)", exact: |[x, _]| x * x, bound: 5.0 },
    Operation { call: "df64_div(x, y)", exact: |[x, y]| x / y, bound: 40.0 },
    Operation { call: "df64_sqrt(df64_abs(x))", exact: |[x, _]| x.abs().sqrt(), bound: 24.0 },
    Operation { call: "df64_determinant(x, -y, y, x)", exact: |[x, y]| x * x + y * y, bound: 8.0 },
    Operation {
        call: "df64_dot(mat3x2<f32>(x, y, x), mat3x2<f32>(x, y, x))",
        exact: |[x, y]| 2.0 * (x * x) + y * y,
        bound: 8.0,
    },
    Operation { call: "df64_floor(x)", exact: |[x, _]| x.floor(), bound: 0.0 },
    Operation { call: "df64_from_i32(df64_to_i32(x))", exact: |[x, _]| x.trunc(), bound: 0.0 },
    Operation { call: "df64_from_u32(df64_to_u32(x))", exact: |[x, _]| x.max(0.0).trunc(), bound: 0.0 },
    Operation {
        call: "vec2<f32>(select(0.0, 1.0, df64_less(x, -y)), 0.0)",
        exact: |[x, y]| f64::from(u8::from(x < -y)),
        bound: 0.0,
    },
];

/// The shader that computes exact sum, exact product and every operation, for each pair.
fn source() -> String {
    let mut text = bindings::declared(df64::LIBRARY);
    text.push_str(
        "@group(0) @binding(0) var<storage, read> pairs: array<vec4<f32>>;\n\
         @group(0) @binding(1) var<storage, read_write> results: array<vec2<f32>>;\n",
    );
    let rows = 2 + OPERATIONS.len();
    let _ = write!(
        text,
        "@compute @workgroup_size({WORKGROUP})\nfn test(@builtin(global_invocation_id) id: vec3<u32>) {{\n    \
         df64_zero = df64_zero_source;\n    let x = pairs[id.x].xy;\n    let y = pairs[id.x].zw;\n    let first = {rows}u * id.x;\n    \
         results[first] = df64_two_sum(x.x, y.x);\n    results[first + 1u] = df64_two_product(x.x, y.x);\n"
    );
    for (i, operation) in OPERATIONS.iter().enumerate() {
        let _ = writeln!(text, "    results[first + {}u] = {};", 2 + i, operation.call);
    }
    text.push_str("}\n");
    text
}

/// Pairs of 48-bit numbers: of similar and of very different size, near cancellations, ties, powers of two, long runs
/// of ones.
fn pairs() -> Vec<[f64; 2]> {
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let mut word = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state ^ (state >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 8
    };
    let mut number = move |spread: i32| {
        let bits = match word() % 6 {
            0 => 1 << 47,
            1 => (1 << 48) - 1 - (word() & 1),
            2 => (1 << 47) | (1 << (word() % 47)),
            3 => ((word() >> 32) << 24) | (1 << 23) | (1 << 47),
            _ => (word() >> 8) | (1 << 47),
        };
        let exponent = (word() % (2 * spread as u64 + 1)) as i32 - spread;
        let sign = if word() & 1 == 0 { 1.0 } else { -1.0 };
        df64::rounded(sign * (bits as f64) * 2_f64.powi(exponent - 47))
    };
    (0..NUM_PAIRS)
        .map(|i| {
            let x = number(20);
            match i % 4 {
                0 => [x, number(20)],
                1 => [x, number(1)],
                2 => [x, df64::rounded(-x * (1.0 + number(0).abs() * 2_f64.powi(-(i as i32 / 4 % 48))))],
                _ => [x, x * 2_f64.powi(i as i32 / 4 % 60 - 30)],
            }
        })
        .collect()
}

impl Gpu {
    /// Fails if double-word arithmetic fails on this device. The test runs once.
    ///
    /// # Errors
    /// [`Error::Usage`] with the operation that fails; [`Error::Device`] if the device does.
    pub fn check_df64(&self) -> Result<()> {
        self.df64.get_or_init(|| self.test_df64(df64::LIBRARY)).clone()
    }

    /// Tests the double-word arithmetic of a modified library, to prove that the test notices a wrong one.
    #[doc(hidden)]
    pub fn test_df64(&self, library: &str) -> Result<()> {
        let pairs = pairs();
        let results = self.df64_results(library, &pairs)?;
        let rows = results.chunks_exact(2 + OPERATIONS.len());
        match pairs.iter().zip(rows).find_map(|(pair, results)| fault(*pair, results)) {
            None => Ok(()),
            Some(fault) => Err(Error::Usage(format!(
                "the adapter `{}` cannot trace in df64, because {fault}; use --precision f32",
                self.info.name
            ))),
        }
    }

    fn df64_results(&self, library: &str, pairs: &[[f64; 2]]) -> Result<Vec<[f32; 2]>> {
        let wgsl = source().replace(df64::LIBRARY, library);
        let module = naga::front::wgsl::parse_str(&wgsl)
            .map_err(|error| Error::Internal(format!("df64: {}", error.emit_to_string(&wgsl))))?;
        let layout = self.bind_group_layout("df64", &bindings_of(&module), 0);
        let pipeline = self.pipeline("test", &self.shader("df64", &wgsl), &[&layout], &[]);
        let words: Vec<[f32; 2]> = pairs.iter().flatten().map(|&number| split(number)).collect();
        let size = u64::from(NUM_PAIRS) * 8 * (2 + OPERATIONS.len() as u64);
        let results = self.buffer("df64", size)?;
        let numbers = self.constant_buffer("df64", bytemuck::cast_slice(&words));
        let zero = self.constant_buffer("df64", &[0; 16]);
        let group =
            self.bind_group("df64", &layout, [(0, &numbers), (1, &results), (df64::ZERO, &zero)], &[]);
        self.dispatch(&pipeline, &group, NUM_PAIRS / WORKGROUP);
        Ok(bytemuck::pod_collect_to_vec(&self.read(&results, size)?))
    }
}

/// The first fault in the results on a pair, if any.
fn fault([x, y]: [f64; 2], results: &[[f32; 2]]) -> Option<String> {
    let (a, b) = (x as f32, y as f32);
    let exact = [("sum", two_sum(a, b)), ("product", two_product(a, b))];
    let exact = exact.iter().zip(results).find(|((_, expected), result)| expected != *result);
    if let Some(((name, expected), result)) = exact {
        return Some(format!("the {name} of {a:e} and {b:e} is {result:?} there, not {expected:?}"));
    }
    OPERATIONS.iter().zip(&results[2..]).find_map(|(operation, result)| {
        let expected = (operation.exact)([x, y]);
        let units = (join(*result) - expected).abs() / (UNIT * expected.abs());
        // A result that should be 0 has no size to compare with. A NaN is within no bound.
        let right = if expected == 0.0 { join(*result) == 0.0 } else { units <= operation.bound };
        (!right).then(|| format!("{} of {x:e} and {y:e} is off by {units:.1} u^2 there", operation.call))
    })
}

/// a + b rounded, and the rounding error, both exact (Knuth).
fn two_sum(a: f32, b: f32) -> [f32; 2] {
    let sum = a + b;
    let b_part = sum - a;
    [sum, (a - (sum - b_part)) + (b - b_part)]
}

/// a b rounded, and the rounding error, both exact: the product of two f32 fits an f64.
fn two_product(a: f32, b: f32) -> [f32; 2] {
    let product = a * b;
    [product, (f64::from(a) * f64::from(b) - f64::from(product)) as f32]
}
