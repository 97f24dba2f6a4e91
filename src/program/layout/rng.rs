//! Keyed PCG32 draws, which equal Optiland's bit for bit: the table of jumps for the shader, and the draws of the host.
//!
//! A draw is a function of its key (seed, ray id, step = bounce + offset, slot) alone. With
//! `initstate = splitmix64(seed)`, `inc = 2 splitmix64(ray_id GAMMA ^ slot SLOT) + 1`, `A_k = MULT^k` and
//! `B_k = sum of MULT^i for i < k`, seeding gives `state_0 = (inc + initstate) MULT + inc`, and k steps later
//!
//! ```text
//! state_k = A_k state_0 + B_k inc = P_k + Q_k inc,   P_k = A_{k+1} initstate,   Q_k = A_{k+1} + B_{k+1}
//! ```
//!
//! since `A_k + B_k = B_{k+1}`. P and Q depend on the trace and the step alone, so the shader finds them in a table. A
//! draw then costs one hash and one product.
//!
//! Source of PCG32: O'Neill, PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms for Random
//! Number Generation (2014). Source of splitmix64: Steele, Lea and Flood, Fast Splittable Pseudorandom Number
//! Generators (2014).

const MULT: u64 = 6_364_136_223_846_793_005;
const GAMMA: u64 = 0x9E37_79B9_7F4A_7C15;
const SLOT: u64 = 0xC2B2_AE3D_27D4_EB4F;

/// Slot of the draws that choose which paths are recorded: `PATH_SAMPLE` in `rng_slots.wgsl`.
pub const PATH_SAMPLE: u32 = 11;

/// What the draws are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum Sampler {
    /// Keyed PCG32: Optiland's random numbers, bit for bit.
    #[default]
    Pcg,
    /// Owen-scrambled Sobol points, a ray a point: a map's error falls faster with the number of rays.
    Sobol,
}

impl Sampler {
    /// Its name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Sampler::Pcg => "pcg",
            Sampler::Sobol => "sobol",
        }
    }
}

/// Finaliser of `SplitMix64`.
pub fn splitmix64(key: u64) -> u64 {
    let a = key.wrapping_add(GAMMA);
    let b = (a ^ (a >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let c = (b ^ (b >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    c ^ (c >> 31)
}

/// The buffer `rng_table` of the shaders: a row for each of the steps 0..`num_steps`. A shader may draw at every
/// step = bounce + offset below `num_steps`, and at no other. The words are (P.lo, P.hi, Q.lo, Q.hi) for PCG, and
/// (hash of the seed, its high word, step, 0) for Sobol.
pub fn step_table(sampler: Sampler, seed: u64, num_steps: usize) -> Vec<[u32; 4]> {
    let words = |a: u64, b: u64| [a as u32, (a >> 32) as u32, b as u32, (b >> 32) as u32];
    match sampler {
        Sampler::Pcg => jumps(seed).take(num_steps).map(|(p, q)| words(p, q)).collect(),
        Sampler::Sobol => (0..num_steps as u64).map(|step| words(splitmix64(seed), step)).collect(),
    }
}

/// The pairs (P, Q) of the steps 0, 1, 2...
fn jumps(seed: u64) -> impl Iterator<Item = (u64, u64)> {
    let initstate = splitmix64(seed);
    let mut power = 1_u64;
    let mut sum = 0_u64;
    std::iter::repeat_with(move || {
        sum = sum.wrapping_add(power);
        power = power.wrapping_mul(MULT);
        (power.wrapping_mul(initstate), power.wrapping_add(sum))
    })
}

/// The 32 bits of a key, by advancing the generator step by step.
pub fn draw(seed: u64, ray_id: u64, step: u32, slot: u32) -> u32 {
    let selector = splitmix64(ray_id.wrapping_mul(GAMMA) ^ u64::from(slot).wrapping_mul(SLOT));
    let inc = (selector << 1) | 1;
    let advance = |state: u64| state.wrapping_mul(MULT).wrapping_add(inc);
    let seeded = advance(inc.wrapping_add(splitmix64(seed)));
    output((0..step).fold(seeded, |state, _| advance(state)))
}

/// XSH-RR: the output of a state.
fn output(state: u64) -> u32 {
    let xorshifted = (((state >> 18) ^ state) >> 27) as u32;
    xorshifted.rotate_right((state >> 59) as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    const RAYS: [u64; 6] = [0, 1, 2, 5, 100, 999_999];
    const BOUNCES: [u32; 6] = [0, 0, 3, 1, 0, 2];

    #[test]
    fn draws_match_optilands_frozen_vectors() {
        let frozen: [(u32, [u32; 6]); 3] = [
            (0, [0x489673E5, 0xF5314CF0, 0x95FFCD8C, 0x9D500941, 0xD7ED4E42, 0xA00A3EDD]),
            (5, [0xEBA83967, 0xC994A4B4, 0x722B9BE5, 0x339CDAD1, 0x85EF336D, 0x922DD0F3]),
            (8, [0xC9315134, 0x34776105, 0xDEB171CB, 0x79E94B7C, 0x5E71B7CA, 0xDB3C6EAF]),
        ];
        for (slot, expected) in frozen {
            let drawn: Vec<u32> =
                RAYS.iter().zip(BOUNCES).map(|(&ray, bounce)| draw(7, ray, bounce, slot)).collect();
            assert_eq!(drawn, expected, "slot {slot}");
        }
    }

    #[test]
    fn table_jumps_to_the_state_that_steps_reach() {
        let (seed, ray_id, slot) = (0xDEAD_BEEF_0123, 0x1_2345_6789_ABCD_u64, 5_u32);
        let inc = (splitmix64(ray_id.wrapping_mul(GAMMA) ^ u64::from(slot).wrapping_mul(SLOT)) << 1) | 1;
        for (step, (p, q)) in (0_u32..).zip(jumps(seed).take(300)) {
            let state = p.wrapping_add(q.wrapping_mul(inc));
            assert_eq!(output(state), draw(seed, ray_id, step, slot), "step {step}");
        }
    }
}
