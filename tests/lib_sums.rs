//! Exact sums: quanta, carries, contention, splats, and what no sum can hold.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests, outside of #[test]"
)]

mod common;

use common::{Gpu, Storage, TIERS};
use nsq_gpu::engine::sums;
use nsq_gpu::program::layout::rng::{Sampler, splitmix64};
use nsq_gpu::program::layout::words::Words;
use nsq_gpu::program::rewrite::df64;
use nsq_gpu::program::wgsl::library::{self, Integers, Real};

/// Workgroup size of every shader here.
const GROUP: usize = 64;

/// The library, and an entry point that runs `body` for each index `i` of the array `num`.
fn shader(real: Real, integers: Integers, declarations: &str, body: &str) -> String {
    let entry = format!(
        "{declarations}
        @compute @workgroup_size({GROUP})
        fn main(@builtin(global_invocation_id) id: vec3<u32>) {{
            let i = id.x;
            if i >= arrayLength(&inputs) {{ return; }}
            {body}
        }}"
    );
    library::source(real, integers, Sampler::Pcg) + &entry
}

fn groups(num: usize) -> [u32; 3] {
    [u32::try_from(num.div_ceil(GROUP)).unwrap(), 1, 1]
}

/// The buffers of cells that start at these values.
fn cells(integers: Integers, start: &[u128]) -> Vec<Storage> {
    let low = |cell: &u128| *cell as u64;
    let top = |cell: &u128| (cell >> 64) as u32;
    match integers {
        Integers::Native => vec![
            Storage::written(2, &start.iter().map(low).collect::<Vec<u64>>()),
            Storage::written(3, &start.iter().map(top).collect::<Vec<u32>>()),
        ],
        Integers::Portable => vec![Storage::written(2, &words_of(start).concat())],
    }
}

/// What the buffers of [`cells`] hold in the end.
fn read(integers: Integers, written: &[Vec<u8>]) -> Vec<u128> {
    let buffers: &[(Words, &[u8])] = match integers {
        Integers::Native => &[(Words::Low, &written[0]), (Words::Top, &written[1])],
        Integers::Portable => &[(Words::All, &written[0])],
    };
    let bytes_of_cell = if integers == Integers::Native { 8 } else { 12 };
    let mut cells = vec![0; written[0].len() / bytes_of_cell];
    for (words, bytes) in buffers {
        words.values(0, bytes).for_each(|(cell, value)| cells[cell] += value);
    }
    cells
}

/// Quanta as words (lo, hi, top).
fn words_of(quanta: &[u128]) -> Vec<[u32; 3]> {
    quanta.iter().map(|q| [*q as u32, (q >> 32) as u32, (q >> 64) as u32]).collect()
}

/// Quanta from the vec4 that a shader wrote.
fn quanta_of(bytes: &[u8]) -> Vec<u128> {
    bytes
        .chunks_exact(16)
        .map(|words| Words::All.values(0, &words[..12]).map(|(_, value)| value).sum())
        .collect()
}

/// A weight as the tier holds it.
fn held(real: Real, weight: f64) -> f64 {
    match real {
        Real::F32 => f64::from(weight as f32),
        Real::Df64 => df64::rounded(weight),
        Real::F64 => weight,
    }
}

/// floor(weight * 2^52), or nothing where no sum can hold it.
fn quantized(weight: f64) -> Option<u128> {
    let holds = (0.0..2_f64.powi(43)).contains(&weight);
    // Exact: a power of two, and a conversion that cuts off the fraction.
    holds.then_some((weight * 2_f64.powi(52)) as u128)
}

/// Weights of every size, the edges of every word among them.
fn weights() -> Vec<f64> {
    let mut weights = vec![0.0, -0.0, 1.0, f64::from(f32::MIN_POSITIVE), 1e-40, 5e-324];
    for exponent in -60..43 {
        let edge = 2_f64.powi(exponent);
        weights.extend([edge, edge.next_up(), edge.next_down(), f64::from((edge as f32).next_up())]);
        weights.extend((0..20).map(|i| edge * (1.0 + splitmix64(i) as f64 / 2_f64.powi(64))));
    }
    weights
}

/// Weights that no sum can hold.
const INVALID: [f64; 8] =
    [f64::NAN, -f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1.0, -1e-30, 8_796_093_022_208.0, 1e300];

#[test]
fn weights_become_the_quanta_below_them() {
    let weights: Vec<f64> = weights().into_iter().chain(INVALID).collect();
    for (real, integers) in TIERS {
        let Some(gpu) = Gpu::open("weights_become_the_quanta_below_them", real, integers) else { continue };
        let source = shader(
            real,
            integers,
            "@group(0) @binding(5) var<storage, read> inputs: array<real>;
             @group(0) @binding(6) var<storage, read_write> outputs: array<vec4<u32>>;",
            "outputs[i] = vec4<u32>(quantize(inputs[i]), 0u);",
        );
        let storages = [Storage::reals(5, real, &weights), Storage::zeros(6, 16 * weights.len())];
        let written = gpu.run(&source, &storages, groups(weights.len()));
        for (&weight, quanta) in weights.iter().zip(quanta_of(&written[0])) {
            let expected = quantized(held(real, weight)).unwrap_or(0);
            assert_eq!(quanta, expected, "{real:?} {integers:?} weight {weight:e}");
        }
    }
}

#[test]
fn what_no_sum_can_hold_is_counted_and_adds_nothing() {
    let weights: Vec<f64> = weights().into_iter().chain(INVALID).collect();
    for (real, integers) in TIERS {
        let Some(gpu) = Gpu::open("what_no_sum_can_hold_is_counted_and_adds_nothing", real, integers) else {
            continue;
        };
        // Each weight as it was loaded; NaN and infinity computed as well, which a compiler may treat otherwise
        // (it makes x - x, of an infinite x, a plain 0: nothing can tell).
        let source = shader(
            real,
            integers,
            "@group(0) @binding(5) var<storage, read> inputs: array<real>;",
            "deposit_weight(i, inputs[i]);
             let zero = inputs[0];
             let computed = arrayLength(&inputs);
             if i == 1u { deposit_weight(computed, zero / zero); }
             if i == 2u { deposit_weight(computed, inputs[i] / zero); }
             if i == 3u { deposit_weight(computed, sqrt(-inputs[2])); }
             if i == 4u { deposit_weight(computed, inputs[2] / zero - inputs[6] / zero); }",
        );
        let mut storages = vec![Storage::reals(5, real, &weights)];
        storages.extend(cells(integers, &vec![0; weights.len() + 1]));
        storages.push(Storage::zeros(4, 8));
        let written = gpu.run(&source, &storages, groups(weights.len()));
        let expected: Vec<Option<u128>> =
            weights.iter().map(|&weight| quantized(held(real, weight))).collect();
        let computed = std::iter::once(None);
        for (i, (total, expected)) in
            read(integers, &written).into_iter().zip(expected.iter().copied().chain(computed)).enumerate()
        {
            assert_eq!(total, expected.unwrap_or(0), "{real:?} {integers:?} weight {:?}", weights.get(i));
        }
        let invalid = expected.iter().filter(|quanta| quanta.is_none()).count() + 4;
        let counters: &[u32] = bytemuck::cast_slice(written.last().unwrap());
        assert_eq!(counters[sums::INVALID_DEPOSITS] as usize, invalid, "{real:?} {integers:?}");
    }
}

/// Quanta at the edges of every word, and random ones.
fn edges() -> Vec<u128> {
    let words = [0_u128, 1, 0x7FFF_FFFF, 0x8000_0000, 0xFFFF_FFFE, 0xFFFF_FFFF];
    let mut edges: Vec<u128> = Vec::new();
    for lo in words {
        edges
            .extend(words.iter().flat_map(|hi| [0_u128, 1, 0xFFFF].map(|top| lo | (hi << 32) | (top << 64))));
    }
    edges.extend((0..200).map(|i| (u128::from(splitmix64(i)) << 16) >> (splitmix64(i + 200) % 80)));
    edges
}

#[test]
fn carries_pass_through_every_word() {
    let deposits = edges();
    for (real, integers) in TIERS {
        let Some(gpu) = Gpu::open("carries_pass_through_every_word", real, integers) else { continue };
        // Cell i starts at edge i and takes every deposit of one in seven, in whatever order.
        let source = shader(
            real,
            integers,
            "@group(0) @binding(5) var<storage, read> inputs: array<vec4<u32>>;",
            "for (var k = i % 7u; k < arrayLength(&inputs); k += 7u) { deposit(i, inputs[k].xyz); }",
        );
        let inputs: Vec<[u32; 4]> = words_of(&deposits).iter().map(|w| [w[0], w[1], w[2], 0]).collect();
        let mut storages = vec![Storage::read(5, &inputs)];
        storages.extend(cells(integers, &deposits));
        let written = gpu.run(&source, &storages, groups(deposits.len()));
        for (i, total) in read(integers, &written).into_iter().enumerate() {
            let expected = deposits[i] + deposits.iter().skip(i % 7).step_by(7).sum::<u128>();
            assert_eq!(total, expected, "{real:?} {integers:?} cell {i}");
        }
    }
}

#[test]
fn a_million_deposits_into_one_cell_are_exact() {
    const NUM: usize = 1 << 20;
    // Just below 2^64, so that the carries into every word are many; few distinct weights keep the sum easy to state.
    let start = (1_u128 << 64) - 12345;
    let weights: Vec<f64> = (0..NUM).map(|i| [1.0, 0.3, 1e-9, 2047.7, 8191.25][i % 5]).collect();
    for (real, integers) in TIERS {
        let Some(gpu) = Gpu::open("a_million_deposits_into_one_cell_are_exact", real, integers) else {
            continue;
        };
        let source = shader(
            real,
            integers,
            "@group(0) @binding(5) var<storage, read> inputs: array<real>;",
            "deposit_weight(0u, inputs[i]);",
        );
        let mut storages = vec![Storage::reals(5, real, &weights)];
        storages.extend(cells(integers, &[start]));
        storages.push(Storage::zeros(4, 4));
        let written = gpu.run(&source, &storages, groups(NUM));
        let expected =
            start + weights.iter().map(|&weight| quantized(held(real, weight)).unwrap()).sum::<u128>();
        assert_eq!(read(integers, &written), [expected], "{real:?} {integers:?}");
    }
}

#[test]
fn quanta_compare_and_subtract_like_integers() {
    let edges = edges();
    let pairs: Vec<(u128, u128)> =
        edges.iter().flat_map(|&a| edges.iter().step_by(5).map(move |&b| (a.max(b), a.min(b)))).collect();
    let (real, integers) = (Real::F32, Integers::Portable);
    let Some(gpu) = Gpu::open("quanta_compare_and_subtract_like_integers", real, integers) else { return };
    let source = shader(
        real,
        integers,
        "struct Pair { large: vec3<u32>, small: vec3<u32> }
         @group(0) @binding(5) var<storage, read> inputs: array<Pair>;
         @group(0) @binding(6) var<storage, read_write> outputs: array<vec4<u32>>;
         fn bit(condition: bool, place: u32) -> u32 { return select(0u, 1u << place, condition); }",
        "let a = inputs[i].large;
         let b = inputs[i].small;
         let flags = bit(q_less(a, b), 0u) | bit(q_less(b, a), 1u) | bit(q_is_zero(a), 2u) | bit(q_is_zero(b), 3u)
             | bit(all(q_min(a, b) == b), 4u) | bit(all(q_min(b, a) == b), 5u);
         outputs[i] = vec4<u32>(q_sub(a, b), flags);",
    );
    let inputs: Vec<[u32; 8]> = pairs
        .iter()
        .map(|&(large, small)| {
            let (a, b) = (words_of(&[large])[0], words_of(&[small])[0]);
            [a[0], a[1], a[2], 0, b[0], b[1], b[2], 0]
        })
        .collect();
    let storages = [Storage::read(5, &inputs), Storage::zeros(6, 16 * pairs.len())];
    let written = gpu.run(&source, &storages, groups(pairs.len()));
    let flags: &[u32] = bytemuck::cast_slice(&written[0]);
    for (i, (&(a, b), difference)) in pairs.iter().zip(quanta_of(&written[0])).enumerate() {
        assert_eq!(difference, a - b, "{a:x} - {b:x}");
        let expected =
            u32::from(b < a) << 1 | u32::from(a == 0) << 2 | u32::from(b == 0) << 3 | 1 << 4 | 1 << 5;
        assert_eq!(flags[4 * i + 3], expected, "{a:x} and {b:x}");
    }
}

#[test]
fn taps_of_a_splat_add_up_to_the_weight() {
    let weights: Vec<f64> = weights();
    for (real, integers) in TIERS {
        let Some(gpu) = Gpu::open("taps_of_a_splat_add_up_to_the_weight", real, integers) else { continue };
        // Shares that add up to a little more than 1 in one cell of two: what is left must then limit them.
        let source = shader(
            real,
            integers,
            "@group(0) @binding(5) var<storage, read> inputs: array<real>;",
            "let w = inputs[i];
             var rest = quantize_counted(w);
             let share = choose(0.3, 0.35, (i & 1u) == 1u);
             for (var tap = 0u; tap < 3u; tap++) { deposit_tap(4u * i + tap, w * share, &rest); }
             deposit(4u * i + 3u, rest);",
        );
        let mut storages = vec![Storage::reals(5, real, &weights)];
        storages.extend(cells(integers, &vec![0; 4 * weights.len()]));
        storages.push(Storage::zeros(4, 4));
        let written = gpu.run(&source, &storages, groups(weights.len()));
        for (i, (taps, &weight)) in read(integers, &written).chunks(4).zip(&weights).enumerate() {
            let expected = quantized(held(real, weight)).unwrap();
            assert_eq!(taps.iter().sum::<u128>(), expected, "{real:?} {integers:?} weight {weight:e}");
            let last_share = if i % 2 == 1 { 0.0 } else { 0.1 };
            let difference = taps[3] as f64 - last_share * expected as f64;
            assert!(difference.abs() <= 1e-6 * expected as f64 + 3.0, "{real:?} {integers:?} {taps:?}");
        }
    }
}
