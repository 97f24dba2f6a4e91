//! Draws: the host and both shader variants give the bits that Optiland gives.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests, outside of #[test]"
)]

mod common;

use common::{Gpu, Storage, TIERS, real_bytes, reals_of};
use nsq_gpu::program::layout::rng::{self, Sampler};
use nsq_gpu::program::rewrite::df64;
use nsq_gpu::program::wgsl::library::{self, Integers, Real};

/// One row of `tests/data/rng.csv`: a key and the draw that Optiland makes of it.
struct Row {
    seed: u64,
    ray_id: u64,
    step: u32,
    slot: u32,
    draw: u32,
}

fn rows() -> Vec<Row> {
    let text = include_str!("data/rng.csv");
    let rows: Vec<Row> = text.lines().skip(1).map(row).collect();
    assert!(rows.len() >= 2000, "only {} rows", rows.len());
    rows
}

fn row(line: &str) -> Row {
    let words: Vec<u64> = line.split(',').map(|word| word.parse().unwrap()).collect();
    let small = |i: usize| u32::try_from(words[i]).unwrap();
    Row { seed: words[0], ray_id: words[1], step: small(2), slot: small(3), draw: small(4) }
}

#[test]
fn host_draws_are_optilands() {
    for row in rows() {
        let drawn = rng::draw(row.seed, row.ray_id, row.step, row.slot);
        assert_eq!(
            drawn, row.draw,
            "seed {} ray {} step {} slot {}",
            row.seed, row.ray_id, row.step, row.slot
        );
    }
}

const MAIN: &str = "
@group(0) @binding(5) var<storage, read> keys: array<vec4<u32>>;
@group(0) @binding(6) var<storage, read_write> drawn: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < arrayLength(&keys) {
        let key = keys[id.x];
        drawn[id.x] = draw(ray_key(key.x, key.y), key.z, key.w);
    }
}
";

/// The device's draws of keys (ray id's low and high word, slot, step), from a table of `num_steps` steps.
fn drawn(
    gpu: &Gpu,
    (real, integers, sampler): (Real, Integers, Sampler),
    seed: u64,
    num_steps: usize,
    keys: &[[u32; 4]],
) -> Vec<u32> {
    let storages = [
        Storage::read(1, &rng::step_table(sampler, seed, num_steps)),
        Storage::read(5, keys),
        Storage::zeros(6, 4 * keys.len()),
    ];
    let source = library::source(real, integers, sampler) + MAIN;
    let written = gpu.run(&source, &storages, [keys.len().div_ceil(64) as u32, 1, 1]);
    bytemuck::cast_slice(&written[0]).to_vec()
}

#[test]
fn shader_draws_are_optilands() {
    let rows = rows();
    let mut seeds: Vec<u64> = rows.iter().map(|row| row.seed).collect();
    seeds.sort_unstable();
    seeds.dedup();
    for (real, integers) in TIERS {
        let Some(gpu) = Gpu::open("shader_draws_are_optilands", real, integers) else { continue };
        for &seed in &seeds {
            let of_seed: Vec<&Row> = rows.iter().filter(|row| row.seed == seed).collect();
            let keys: Vec<[u32; 4]> = of_seed
                .iter()
                .map(|row| [row.ray_id as u32, (row.ray_id >> 32) as u32, row.slot, row.step])
                .collect();
            let drawn = drawn(&gpu, (real, integers, Sampler::Pcg), seed, 10_001, &keys);
            for (row, drawn) in of_seed.iter().zip(drawn) {
                assert_eq!(
                    drawn, row.draw,
                    "{real:?} {integers:?} seed {seed} ray {} step {}",
                    row.ray_id, row.step
                );
            }
        }
    }
}

/// Bits of draws, the edges among them.
fn bits() -> Vec<u32> {
    let edges =
        [0, 1, 2, 0x00FF_FFFF, 0x0100_0000, 0x0100_0001, 0x7FFF_FFFF, 0x8000_0000, 0xFFFF_FF7F, 0xFFFF_FFFF];
    let random = (0..2000_u32).map(|i| rng::splitmix64(u64::from(i)) as u32 >> (i % 32));
    edges.into_iter().chain(random).collect()
}

const JUDGE: &str = "
@group(0) @binding(5) var<storage, read> bits: array<u32>;
@group(0) @binding(6) var<storage, read> probabilities: array<real>;
@group(0) @binding(7) var<storage, read_write> uniforms: array<real>;
@group(0) @binding(8) var<storage, read_write> decisions: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i < arrayLength(&bits) {
        uniforms[i] = uniform_of(bits[i]);
        decisions[i] = u32(below(bits[i], probabilities[i]));
    }
}
";

/// Draws beside probabilities: those next to the draw itself, and those outside (0, 1).
fn cases(real: Real) -> Vec<(u32, f64)> {
    let next = |p: f64| match real {
        Real::F32 => {
            [f64::from(p as f32), f64::from((p as f32).next_up()), f64::from((p as f32).next_down())]
        }
        Real::Df64 => {
            let [high, low] = df64::split(p);
            [low, low.next_up(), low.next_down()].map(|low| df64::join([high, low]))
        }
        Real::F64 => [p, p.next_up(), p.next_down()],
    };
    let outside = [0.0, -0.0, -1.0, 1.0, 1.5, 1e30, 0.5, 1e-20];
    let probabilities = |bits: u32| next(f64::from(bits) / 2_f64.powi(32)).into_iter().chain(outside);
    let held = |p: f64| match real {
        Real::F32 => f64::from(p as f32),
        Real::Df64 => df64::rounded(p),
        Real::F64 => p,
    };
    bits().into_iter().flat_map(|bits| probabilities(bits).map(move |p| (bits, held(p)))).collect()
}

#[test]
fn draws_become_numbers_below_one_and_decide_exactly() {
    for (real, integers) in TIERS {
        let test = "draws_become_numbers_below_one_and_decide_exactly";
        let Some(gpu) = Gpu::open(test, real, integers) else { continue };
        let (bits, probabilities): (Vec<u32>, Vec<f64>) = cases(real).into_iter().unzip();
        let storages = [
            Storage::read(5, &bits),
            Storage::reals(6, real, &probabilities),
            Storage::zeros(7, real_bytes(real) * bits.len()),
            Storage::zeros(8, 4 * bits.len()),
        ];
        let source = library::source(real, integers, Sampler::Pcg) + JUDGE;
        let written = gpu.run(&source, &storages, [bits.len().div_ceil(64) as u32, 1, 1]);
        let uniforms = reals_of(real, &written[0]);
        let decisions: &[u32] = bytemuck::cast_slice(&written[1]);
        for (i, (&bits, &p)) in bits.iter().zip(&probabilities).enumerate() {
            let exact = f64::from(bits) / 2_f64.powi(32);
            assert_eq!(decisions[i] == 1, exact < p, "{real:?} {bits:#x} below {p:e}");
            let cut = if real == Real::F32 { exact * f64::from(f32::EPSILON) } else { 0.0 };
            let uniform = uniforms[i];
            assert!(
                uniform < 1.0 && (exact - cut..=exact).contains(&uniform),
                "{real:?} {bits:#x}: {uniform:e}"
            );
        }
    }
}

const POINTS: &str = "
@group(0) @binding(5) var<storage, read_write> coordinates: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    for (var dimension = 0u; dimension < 5u; dimension++) {
        coordinates[5u * id.x + dimension] = sobol(id.x * 0x9E3779B1u, dimension);
    }
}
";

/// Degree, coefficients and initial numbers of the second to the fifth dimension: new-joe-kuo-6.
const JOE_KUO: [(usize, u32, &[u32]); 4] =
    [(1, 0, &[1]), (2, 1, &[1, 3]), (3, 1, &[1, 3, 1]), (3, 2, &[1, 1, 1])];

/// Direction numbers as integers, by the recurrence of Joe and Kuo, Remark on Algorithm 659 (ACM TOMS 29, 2003), eq. 2:
/// m_k = 2 a_1 m_(k-1) ^ ... ^ 2^s m_(k-s) ^ m_(k-s).
fn direction_numbers((degree, coefficients, initial): (usize, u32, &[u32])) -> Vec<u32> {
    let mut m: Vec<u64> = initial.iter().map(|&number| u64::from(number)).collect();
    for k in degree..32 {
        let mut next = m[k - degree] ^ (m[k - degree] << degree);
        for i in 1..degree {
            if coefficients >> (degree - 1 - i) & 1 == 1 {
                next ^= m[k - i] << i;
            }
        }
        m.push(next);
    }
    (0..32).map(|k| (m[k] << (31 - k)) as u32).collect()
}

#[test]
fn sobol_points_are_those_of_joe_and_kuo() {
    const NUM_POINTS: u32 = 4096;
    let mut columns = vec![(0..32).map(|k| 1 << (31 - k)).collect::<Vec<u32>>()];
    columns.extend(JOE_KUO.into_iter().map(direction_numbers));
    // The first points as SciPy 1.16 gives them, put into the order of the index: 5 and 13.
    let coordinate = |column: &[u32], index: u32| {
        (0..32).filter(|k| index >> k & 1 == 1).fold(0, |sum, k: usize| sum ^ column[k])
    };
    let point = |index: u32| columns.iter().map(|column| coordinate(column, index)).collect::<Vec<u32>>();
    assert_eq!(point(5), [2684354560, 536870912, 3758096384, 2684354560, 2684354560]);
    assert_eq!(point(13), [2952790016, 3489660928, 1879048192, 4026531840, 268435456]);
    for (real, integers) in TIERS {
        let Some(gpu) = Gpu::open("sobol_points_are_those_of_joe_and_kuo", real, integers) else { continue };
        let source = library::source(real, integers, Sampler::Sobol) + POINTS;
        let storages = [Storage::zeros(5, 20 * NUM_POINTS as usize)];
        let written = gpu.run(&source, &storages, [NUM_POINTS / 64, 1, 1]);
        let coordinates: &[u32] = bytemuck::cast_slice(&written[0]);
        for (i, drawn) in (0..NUM_POINTS).zip(coordinates.chunks_exact(5)) {
            assert_eq!(drawn, point(i.wrapping_mul(0x9E37_79B1)), "{real:?} {integers:?} point {i}");
        }
    }
}

/// Slots and steps whose draws are one set, and of which any two dimensions are even over 2^a x 2^b cells: what a source
/// draws first, two reflections in a row, the angles of a lobe.
const PAIRS: [[(u32, u32); 2]; 4] = [[(0, 0), (1, 0)], [(5, 4), (5, 5)], [(9, 0), (9, 1)], [(7, 3), (8, 3)]];

#[test]
fn sobol_pairs_are_even_over_every_net() {
    const LOG: u32 = 10;
    let (real, integers) = (Real::F32, Integers::Portable);
    let Some(gpu) = Gpu::open("sobol_pairs_are_even_over_every_net", real, integers) else { return };
    // A block of rays anywhere.
    for (seed, first) in [(0, 0_u64), (1, 1 << 20), (7, (1 << 32) - 1024), (7, 3 << 32)] {
        let keys: Vec<[u32; 4]> = PAIRS
            .iter()
            .flatten()
            .flat_map(|&(slot, step)| (first..first + (1 << LOG)).map(move |ray| (ray, slot, step)))
            .map(|(ray, slot, step)| [ray as u32, (ray >> 32) as u32, slot, step])
            .collect();
        let drawn = drawn(&gpu, (real, integers, Sampler::Sobol), seed, 16, &keys);
        for (pair, drawn) in PAIRS.iter().zip(drawn.chunks_exact(2 << LOG)) {
            let (xs, ys) = drawn.split_at(1 << LOG);
            for a in 0..=LOG {
                let cell =
                    |(&x, &y): (&u32, &u32)| (u64::from(x) >> (32 - a), u64::from(y) >> (32 - (LOG - a)));
                let cells: std::collections::HashSet<(u64, u64)> = xs.iter().zip(ys).map(cell).collect();
                assert_eq!(cells.len(), 1 << LOG, "seed {seed}, rays from {first}, {pair:?}, 2^{a} columns");
            }
        }
    }
}

#[test]
fn sobol_sets_are_shuffled_against_each_other() {
    // Over seeds, decisions of two sets, and of one dimension for two seeds, are as independent as random ones: the mean
    // of (x - 1/2)(y - 1/2) over 64 rays has the standard deviation 1 / (12 sqrt(64)).
    const NUM_RAYS: u32 = 64;
    const NUM_SEEDS: u64 = 400;
    let (real, integers) = (Real::F32, Integers::Portable);
    let Some(gpu) = Gpu::open("sobol_sets_are_shuffled_against_each_other", real, integers) else { return };
    let slots = [(0_u32, 0_u32), (4, 0), (5, 0), (5, 2), (6, 0), (9, 0), (7, 1), (0, 1)];
    let mut sums = [[0.0; 8]; 8];
    for seed in 0..NUM_SEEDS {
        let keys: Vec<[u32; 4]> = slots
            .iter()
            .flat_map(|&(slot, step)| (0..NUM_RAYS).map(move |ray| [ray, 0, slot, step]))
            .collect();
        let drawn = drawn(&gpu, (real, integers, Sampler::Sobol), seed, 16, &keys);
        let centred: Vec<f64> = drawn.iter().map(|&bits| f64::from(bits) / 2_f64.powi(32) - 0.5).collect();
        let columns: Vec<&[f64]> = centred.chunks_exact(NUM_RAYS as usize).collect();
        for (i, x) in columns.iter().enumerate() {
            for (j, y) in columns.iter().enumerate().skip(i + 1) {
                let mean = x.iter().zip(*y).map(|(x, y)| x * y).sum::<f64>() / f64::from(NUM_RAYS);
                sums[i][j] += mean;
                // The sum of squares stands below the diagonal.
                sums[j][i] += mean * mean;
            }
        }
    }
    let expected = 1.0 / (144.0 * f64::from(NUM_RAYS));
    for i in 0..8 {
        // The first two are of one set.
        for j in (i + 1).max(2)..8 {
            let (mean, variance) = (sums[i][j] / NUM_SEEDS as f64, sums[j][i] / NUM_SEEDS as f64);
            let z = mean / (expected / NUM_SEEDS as f64).sqrt();
            assert!(z.abs() < 4.5, "{:?} and {:?}: correlated, z = {z}", slots[i], slots[j]);
            // Its standard deviation is sqrt(2 / 400), if it is no more even than random.
            let ratio = variance / expected;
            assert!((0.5..1.3).contains(&ratio), "{:?} and {:?}: variance x {ratio}", slots[i], slots[j]);
        }
    }
}
