//! Draws: the host and both shader variants give the bits that Optiland gives.

mod common;

use common::{Gpu, Storage, TIERS};
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
        let source = library::source(real, integers) + MAIN;
        for &seed in &seeds {
            let of_seed: Vec<&Row> = rows.iter().filter(|row| row.seed == seed).collect();
            let keys: Vec<[u32; 4]> = of_seed
                .iter()
                .map(|row| [row.ray_id as u32, (row.ray_id >> 32) as u32, row.slot, row.step])
                .collect();
            let storages = [
                Storage::read(1, &rng::step_table(seed, 10_001)),
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
