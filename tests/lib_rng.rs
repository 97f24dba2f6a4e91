//! Draws: the host and both shader variants give the bits that Optiland gives.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests, outside of #[test]"
)]

mod common;

use common::{Gpu, Storage, TIERS, real_bytes, reals_of};
use nsq_gpu::program::library::Real;
use nsq_gpu::program::rng::Sampler;
use nsq_gpu::program::{library, rng};

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

#[test]
fn shader_draws_are_optilands() {
    let rows = rows();
    let mut seeds: Vec<u64> = rows.iter().map(|row| row.seed).collect();
    seeds.sort_unstable();
    seeds.dedup();
    for (real, integers) in TIERS {
        let Some(gpu) = Gpu::open("shader_draws_are_optilands", real, integers) else { continue };
        let source = library::source(real, integers, Sampler::Pcg) + MAIN;
        for &seed in &seeds {
            let of_seed: Vec<&Row> = rows.iter().filter(|row| row.seed == seed).collect();
            let keys: Vec<[u32; 4]> = of_seed
                .iter()
                .map(|row| [row.ray_id as u32, (row.ray_id >> 32) as u32, row.slot, row.step])
                .collect();
            let storages = [
                Storage::read(1, &rng::step_table(Sampler::Pcg, seed, 10_001)),
                Storage::read(5, &keys),
                Storage::zeros(6, 4 * keys.len()),
            ];
            let written = gpu.run(&source, &storages, [keys.len().div_ceil(64) as u32, 1, 1]);
            let drawn: &[u32] = bytemuck::cast_slice(&written[0]);
            for (row, &drawn) in of_seed.iter().zip(drawn) {
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
        Real::F64 => [p, p.next_up(), p.next_down()],
    };
    let outside = [0.0, -0.0, -1.0, 1.0, 1.5, 1e30, 0.5, 1e-20];
    let probabilities = |bits: u32| next(f64::from(bits) / 2_f64.powi(32)).into_iter().chain(outside);
    let held = |p: f64| if real == Real::F32 { f64::from(p as f32) } else { p };
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
