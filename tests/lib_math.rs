//! Elementary functions: the largest error over their whole range, in units in the last place (ulp).

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests, outside of #[test]"
)]

mod common;

use common::{Gpu, Storage, real_bytes, reals_of};
use nsq_gpu::program::layout::rng::{Sampler, splitmix64};
use nsq_gpu::program::wgsl::library::{self, Integers, Real};
use std::f64::consts::TAU;

/// A function of the shader library.
struct Function {
    name: &'static str,
    /// Its call, on the numbers `a` and `b` or on `draw`, the bits of a draw.
    call: &'static str,
    /// Bounds on its error \[ulp\].
    bound_f32: f64,
    bound_df64: f64,
    bound_f64: f64,
    /// Its arguments in f32, from two random words, and its value in f64.
    arguments: fn(u64, u64) -> (f64, f64),
    value: fn(f64, f64) -> f64,
}

/// In the order of `tests/data/math.bin`.
const FUNCTIONS: [Function; 9] = [
    Function {
        name: "cos_turns",
        call: "sincos_turns(draw).x",
        bound_f32: 2.6,
        bound_df64: 2.6,
        bound_f64: 2.0,
        arguments: |word, size| (bits(word, size), 0.0),
        value: |bits, _| turns(bits).0,
    },
    Function {
        name: "sin_turns",
        call: "sincos_turns(draw).y",
        bound_f32: 2.6,
        bound_df64: 2.7,
        bound_f64: 2.0,
        arguments: |word, size| (bits(word, size), 0.0),
        value: |bits, _| turns(bits).1,
    },
    Function {
        name: "log_uniform",
        call: "log_uniform(draw)",
        bound_f32: 1.5,
        bound_df64: 1.3,
        bound_f64: 1.0,
        arguments: |word, size| (bits(word, size), 0.0),
        value: |bits, _| {
            if bits == 0.0 { 1e-300_f64.ln() } else { ((bits - 2_f64.powi(32)) / 2_f64.powi(32)).ln_1p() }
        },
    },
    Function {
        name: "exp_real",
        call: "exp_real(a)",
        bound_f32: 1.5,
        bound_df64: 1.2,
        bound_f64: 1.0,
        arguments: |word, size| (spread(word, size, -20, 88.0).max(f64::from(-87.33_f32)), 0.0),
        value: |x, _| x.exp(),
    },
    Function {
        name: "sin_real",
        call: "sin_real(a)",
        bound_f32: 2.5,
        bound_df64: 2.3,
        bound_f64: 2.0,
        arguments: |word, size| (spread(word, size, -30, 1e4), 0.0),
        value: |x, _| x.sin(),
    },
    Function {
        name: "cos_real",
        call: "cos_real(a)",
        bound_f32: 2.5,
        bound_df64: 2.6,
        bound_f64: 2.0,
        arguments: |word, size| (spread(word, size, -30, 1e4), 0.0),
        value: |x, _| x.cos(),
    },
    Function {
        name: "acos_real",
        call: "acos_real(a)",
        bound_f32: 1.5,
        bound_df64: 1.3,
        bound_f64: 1.0,
        arguments: |word, size| (spread(word, size, -30, 1.0), 0.0),
        value: |x, _| x.acos(),
    },
    Function {
        name: "atan2_real",
        call: "atan2_real(a, b)",
        bound_f32: 2.5,
        bound_df64: 2.5,
        bound_f64: 1.0,
        arguments: |word, size| {
            let (y, x) = (spread(word, size, -30, 1e3), spread(splitmix64(word), splitmix64(size), -30, 1e3));
            // A quarter of them as large or small as f32 allows: their ratio stays a normal number.
            let scale = if word & 24 == 0 { 2_f64.powi((word >> 32) as i32 % 110) } else { 1.0 };
            (f64::from((y * scale) as f32), f64::from((x * scale) as f32))
        },
        value: |y, x| (y + 0.0).atan2(x + 0.0),
    },
    Function {
        name: "log_real",
        call: "log_real(a)",
        bound_f32: 1.0,
        bound_df64: 0.8,
        bound_f64: 1.0,
        arguments: |word, size| (positive(word, size), 0.0),
        value: |x, _| x.ln(),
    },
];

/// A word in [0, 1].
fn unit(word: u64) -> f64 {
    word as f64 / 2_f64.powi(64)
}

/// The bits of a draw: small ones, ones near 2^32, and any.
fn bits(word: u64, size: u64) -> f64 {
    let small = ((word >> 32) as u32) >> (size / 4 % 32);
    f64::from(match size % 4 {
        0 => small,
        1 => !small,
        2 => (((size >> 32) as u32) << 29).wrapping_add(small >> 8),
        _ => (word >> 32) as u32,
    })
}

/// A number up to `largest`, of either sign: half of them spread evenly, half with their logarithms spread evenly from
/// 2^`smallest` on.
fn spread(word: u64, size: u64, smallest: i32, largest: f64) -> f64 {
    let logarithmic = largest * 2_f64.powf(f64::from(smallest) * unit(size));
    let size = if word & 2 == 0 { logarithmic } else { largest * unit(size) };
    f64::from((if word & 1 == 0 { size } else { -size }) as f32)
}

/// A positive normal f32: any, or near 1.
fn positive(word: u64, size: u64) -> f64 {
    if word & 4 == 0 {
        return f64::from((1.0 + spread(word, size, -24, 0.9)) as f32);
    }
    f64::from(f32::from_bits(0x0080_0000 + (size % (0x7F80_0000 - 0x0080_0000)) as u32))
}

/// (cos, sin) of 2 pi bits / 2^32, reduced to an eighth of a turn so that nothing is lost near the zeros.
fn turns(bits: f64) -> (f64, f64) {
    let quarters = (bits / 2_f64.powi(30)).round();
    let (sin, cos) = ((bits / 2_f64.powi(32) - quarters / 4.0) * TAU).sin_cos();
    match quarters as u32 % 4 {
        0 => (cos, sin),
        1 => (-sin, cos),
        2 => (-cos, -sin),
        _ => (sin, -cos),
    }
}

/// Size of a unit in the last place of a number, in the precision of the tier.
fn ulp(value: f64, real: Real) -> f64 {
    let power_of_two = f64::from_bits(value.to_bits() & f64::INFINITY.to_bits());
    match real {
        Real::F32 => power_of_two.max(f64::from(f32::MIN_POSITIVE)) * f64::from(f32::EPSILON),
        // Twice u^2, u = 2^-24, as long as the low part does not underflow.
        Real::Df64 => power_of_two.max(2_f64.powi(-79)) * 2_f64.powi(-47),
        Real::F64 => power_of_two.max(f64::MIN_POSITIVE) * f64::EPSILON,
    }
}

/// Evaluates a function of the library on the adapter.
fn evaluate(gpu: &Gpu, real: Real, call: &str, arguments: &[(f64, f64)]) -> Vec<f64> {
    let entry = format!(
        "@group(0) @binding(5) var<storage, read> numbers: array<real>;
        @group(0) @binding(6) var<storage, read> draws: array<u32>;
        @group(0) @binding(7) var<storage, read_write> values: array<real>;
        @compute @workgroup_size(64)
        fn main(@builtin(global_invocation_id) id: vec3<u32>) {{
            let i = id.x;
            if i >= arrayLength(&draws) {{ return; }}
            let a = numbers[2u * i];
            let b = numbers[2u * i + 1u];
            let draw = draws[i];
            values[i] = {call};
        }}"
    );
    let numbers: Vec<f64> = arguments.iter().flat_map(|&(a, b)| [a, b]).collect();
    let draws: Vec<u32> = arguments.iter().map(|&(a, _)| a as u32).collect();
    let storages = [
        Storage::reals(5, real, &numbers),
        Storage::read(6, &draws),
        Storage::zeros(7, real_bytes(real) * draws.len()),
    ];
    let groups = [u32::try_from(draws.len().div_ceil(64)).unwrap(), 1, 1];
    let source = library::source(real, Integers::Portable, Sampler::Pcg) + &entry;
    reals_of(real, &gpu.run(&source, &storages, groups)[0])
}

/// The largest error of the values \[ulp\]; every value must be a number.
fn largest_error(real: Real, name: &str, rows: &[(f64, f64, f64)], values: &[f64]) -> f64 {
    assert_eq!(rows.len(), values.len());
    let mut largest = 0.0_f64;
    for (&(a, b, expected), value) in rows.iter().zip(values) {
        let error = (value - expected).abs() / ulp(expected, real);
        assert!(error.is_finite(), "{name}({a:e}, {b:e}) = {value:e}, expected {expected:e}");
        largest = error.max(largest);
    }
    largest
}

fn check(gpu: &Gpu, real: Real, function: &Function, rows: &[(f64, f64, f64)], bound: f64) {
    let arguments: Vec<(f64, f64)> = rows.iter().map(|&(a, b, _)| (a, b)).collect();
    let values = evaluate(gpu, real, function.call, &arguments);
    let largest = largest_error(real, function.name, rows, &values);
    println!("{real:?} {}: {largest:.3} ulp", function.name);
    assert!(largest <= bound, "{real:?} {}: {largest:.3} ulp, bound {bound}", function.name);
}

#[test]
fn f32_functions_stay_within_their_bounds() {
    const ROWS: u64 = 1 << 20;
    let Some(gpu) = Gpu::open("f32_functions_stay_within_their_bounds", Real::F32, Integers::Portable) else {
        return;
    };
    for function in &FUNCTIONS {
        let arguments = (0..ROWS).map(|i| (function.arguments)(splitmix64(2 * i), splitmix64(2 * i + 1)));
        let rows: Vec<_> = arguments.map(|(a, b)| (a, b, (function.value)(a, b))).collect();
        check(&gpu, Real::F32, function, &rows, function.bound_f32);
    }
}

#[test]
fn df64_functions_stay_within_their_bounds() {
    const ROWS: u64 = 1 << 18;
    let Some(gpu) = Gpu::open("df64_functions_stay_within_their_bounds", Real::Df64, Integers::Portable)
    else {
        return;
    };
    for function in &FUNCTIONS {
        let arguments = (0..ROWS).map(|i| (function.arguments)(splitmix64(2 * i), splitmix64(2 * i + 1)));
        // Beyond, low parts of intermediate results underflow.
        let fits = |x: f64| x == 0.0 || (2_f64.powi(-60)..2_f64.powi(60)).contains(&x.abs());
        let arguments = arguments.filter(|&(a, b)| fits(a) && fits(b));
        let rows: Vec<_> = arguments.map(|(a, b)| (a, b, (function.value)(a, b))).collect();
        check(&gpu, Real::Df64, function, &rows, function.bound_df64);
    }
}

/// Every 509th f32 from `lowest` to `highest` in size, of the signs in use.
fn walk(lowest: f64, highest: f64, signs: &'static [f64]) -> impl Iterator<Item = f64> {
    let (low, high) = ((lowest as f32).to_bits(), (highest as f32).to_bits());
    let sizes = (low..=high).step_by(509).map(|bits| f64::from(f32::from_bits(bits)));
    sizes.flat_map(|size| signs.iter().map(move |sign| sign * size))
}

#[test]
fn f32_functions_stay_within_their_bounds_all_over_their_range() {
    let test = "f32_functions_stay_within_their_bounds_all_over_their_range";
    let Some(gpu) = Gpu::open(test, Real::F32, Integers::Portable) else { return };
    const BOTH: &[f64] = &[1.0, -1.0];
    let smallest = f64::from(f32::MIN_POSITIVE);
    for function in &FUNCTIONS {
        let arguments: Box<dyn Iterator<Item = f64>> = match function.name {
            "cos_turns" | "sin_turns" | "log_uniform" => {
                Box::new((0..1_u64 << 32).step_by(1021).map(|b| b as f64))
            }
            "exp_real" => Box::new(walk(1e-9, 87.33, BOTH)),
            "sin_real" | "cos_real" => Box::new(walk(1e-9, 1e4, BOTH)),
            "acos_real" => Box::new(walk(1e-9, 1.0, BOTH)),
            "log_real" => Box::new(walk(smallest, f64::from(f32::MAX), &[1.0])),
            // Of two arguments.
            _ => continue,
        };
        let rows: Vec<_> = arguments.map(|a| (a, 0.0, (function.value)(a, 0.0))).collect();
        assert!(rows.len() > 900_000, "{}: {} arguments", function.name, rows.len());
        rows.chunks(1 << 21).for_each(|rows| check(&gpu, Real::F32, function, rows, function.bound_f32));
    }
}

#[test]
fn f64_functions_stay_within_their_bounds() {
    let Some(gpu) = Gpu::open("f64_functions_stay_within_their_bounds", Real::F64, Integers::Portable) else {
        return;
    };
    let words = include_bytes!("data/math.bin").chunks_exact(8);
    let numbers: Vec<f64> = words.map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap())).collect();
    let rows: Vec<(f64, f64, f64)> = numbers.chunks_exact(3).map(|row| (row[0], row[1], row[2])).collect();
    let per_function = rows.len() / FUNCTIONS.len();
    assert!(per_function >= 2000, "only {per_function} rows");
    for (function, rows) in FUNCTIONS.iter().zip(rows.chunks_exact(per_function)) {
        check(&gpu, Real::F64, function, rows, function.bound_f64);
    }
}

#[test]
fn functions_keep_their_word_at_the_ends_of_their_range() {
    for (real, lowest, highest) in
        [(Real::F32, f64::from(-87.33_f32), 88.0), (Real::Df64, -87.33, 88.0), (Real::F64, -708.39, 709.0)]
    {
        let test = "functions_keep_their_word_at_the_ends_of_their_range";
        let Some(gpu) = Gpu::open(test, real, Integers::Portable) else { continue };
        let values = |call: &str, arguments: &[f64]| {
            let arguments: Vec<_> = arguments.iter().map(|&a| (a, 0.0)).collect();
            evaluate(&gpu, real, call, &arguments)
        };
        let exp = values("exp_real(a)", &[lowest - 0.01, -1e30, 0.0, lowest, highest, highest + 1.0, 1e30]);
        assert_eq!(exp[..3], [0.0, 0.0, 1.0], "{real:?}");
        assert!(exp[3] > 0.0 && exp[4].is_finite(), "{real:?} {exp:?}");
        assert_eq!(exp[5..], [exp[4], exp[4]], "{real:?}");
        let near: Vec<f64> = (-680..=680).map(|i| f64::from(i) / 2000.0).collect();
        assert_eq!(values("exp_near_zero(a)", &near), values("exp_real(a)", &near), "{real:?}");
        let acos = values("acos_real(a)", &[1.0, 1.001, 1e30, -1.0, -1.001, -1e30]);
        assert_eq!(acos[..3], [0.0; 3], "{real:?}");
        assert!(acos[3..].iter().all(|pi| (pi - TAU / 2.0).abs() < ulp(3.0, real)), "{real:?} {acos:?}");
        let atan2 = values("atan2_real(a, -1.0)", &[0.0, -0.0]);
        assert!(atan2.iter().all(|pi| (pi - TAU / 2.0).abs() < ulp(3.0, real)), "{real:?} {atan2:?}");
    }
}
