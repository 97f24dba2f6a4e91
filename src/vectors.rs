//! How wide lavapipe computes.

use crate::ir::SceneIr;
use crate::nominal;
use std::process::Command;
use std::sync::OnceLock;

/// Mesa's variable for the bits of lavapipe's vectors.
const WIDTH: &str = "LP_NATIVE_VECTOR_WIDTH";

/// Set once the width is chosen here: whether it is.
static IS_WIDE: OnceLock<bool> = OnceLock::new();

/// What a processor makes of vectors of 512 bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(
    not(target_arch = "x86_64"),
    allow(dead_code, reason = "only x86-64 has such vectors; tests go through all kinds anywhere")
)]
enum Wide {
    /// It has none, or slows down when it computes in them.
    Slow,
    /// It computes in them, but to read a part of one that was just stored takes it four times as long, on average, as of
    /// one of 256 bits; and so lavapipe takes the lanes of every load, store and atomic one by one.
    Whole,
    /// Fast, whole and in parts.
    Fast,
}

/// True if so many rays of a scene are the faster for wide vectors on this processor. No scene is that has meshes: every
/// lane waits until the last one has found its triangle. Where parts are slow, those are whose rays may have a path in a
/// stage of its own, on which memory is met only at the end.
pub fn suit(ir: &SceneIr, num_rays: u64) -> bool {
    suit_on(Wide::of_this_processor(), ir, num_rays)
}

fn suit_on(processor: Wide, ir: &SceneIr, num_rays: u64) -> bool {
    ir.meshes.is_empty()
        && match processor {
            Wide::Slow => false,
            Wide::Whole => nominal::is_long_enough(num_rays) && ir.sensors.iter().all(|sensor| sensor.absorb),
            Wide::Fast => true,
        }
}

/// True if this processor reads parts of vectors of 512 bits slowly that it has just stored.
pub fn have_slow_parts() -> bool {
    Wide::of_this_processor() == Wide::Whole
}

/// Lets lavapipe compute in vectors of 512 bits; by itself it takes 256. No bit of a result depends on it. Whoever has set
/// the variable is obeyed.
///
/// # Safety
/// No other thread runs yet: it could read the environment meanwhile. No adapter has been asked for: Mesa reads the
/// variable once.
#[allow(unsafe_code)]
pub unsafe fn widen() {
    let is_wide = std::env::var_os(WIDTH).is_none();
    if *IS_WIDE.get_or_init(|| is_wide) {
        // SAFETY: nobody reads the environment meanwhile, as the caller promises.
        unsafe { std::env::set_var(WIDTH, "512") };
    }
}

/// True if [`widen`] has chosen the width.
pub fn are_wide() -> bool {
    IS_WIDE.get() == Some(&true)
}

/// Leaves the choice to a command that is this program.
pub fn leave_to(command: &mut Command) {
    if are_wide() {
        command.env_remove(WIDTH);
    }
}

impl Wide {
    /// Processors with AVX-512 VBMI (from Ice Lake and Zen 4 on) do not slow down when they compute in 512 bits, as older
    /// ones do. AMD's read parts as fast as ever (measured on Zen 5), Intel's do not (on Sapphire Rapids).
    #[cfg(target_arch = "x86_64")]
    fn of_this_processor() -> Wide {
        match (std::arch::is_x86_feature_detected!("avx512vbmi"), vendor().as_slice()) {
            (false, _) => Wide::Slow,
            (true, b"AuthenticAMD") => Wide::Fast,
            (true, _) => Wide::Whole,
        }
    }

    #[cfg(not(target_arch = "x86_64"))]
    fn of_this_processor() -> Wide {
        Wide::Slow
    }
}

/// The processor's maker, in twelve letters.
#[cfg(target_arch = "x86_64")]
fn vendor() -> Vec<u8> {
    let leaf = std::arch::x86_64::__cpuid(0);
    [leaf.ebx, leaf.edx, leaf.ecx].into_iter().flat_map(u32::to_le_bytes).collect()
}

/// The name of an adapter without the width of lavapipe's vectors, which is no part of what it is.
pub fn without_width(name: &str) -> String {
    let is_width = |part: &str| part.strip_suffix(" bits").is_some_and(|bits| bits.parse::<u32>().is_ok());
    let last = name.strip_suffix(')').and_then(|open| open.rsplit_once(", "));
    match last {
        Some((rest, width)) if is_width(width) => format!("{rest})"),
        _ => name.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_are_wide_where_they_pay() {
        let ir = |text: &str| crate::Scene::from_json(text).unwrap().lower().unwrap();
        let lens = ir(include_str!("../scenes/bench_lens.json"));
        let cavity = ir(include_str!("../scenes/bench_cavity.json"));
        let mesh = ir(include_str!("../scenes/mesh_prism.json"));
        for (processor, of_lens, of_cavity) in [
            (Wide::Slow, [false, false], [false, false]),
            (Wide::Whole, [false, true], [false, false]),
            (Wide::Fast, [true, true], [true, true]),
        ] {
            let suits = |ir| [1_000, 10_000_000].map(|num_rays| suit_on(processor, ir, num_rays));
            let found = [suits(&lens), suits(&cavity), suits(&mesh)];
            assert_eq!(found, [of_lens, of_cavity, [false, false]], "{processor:?}");
        }
    }

    #[test]
    fn only_a_width_is_taken_out_of_a_name() {
        for (name, expected) in [
            ("llvmpipe (LLVM 15.0.6, 256 bits)", "llvmpipe (LLVM 15.0.6)"),
            ("llvmpipe (LLVM 19.1.7, 512 bits)", "llvmpipe (LLVM 19.1.7)"),
            ("Some GPU (A, B)", "Some GPU (A, B)"),
            ("Some GPU (RADV NAVI31)", "Some GPU (RADV NAVI31)"),
            ("256 bits", "256 bits"),
            ("", ""),
        ] {
            assert_eq!(without_width(name), expected);
        }
    }
}
