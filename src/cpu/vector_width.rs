//! How wide lavapipe computes.

use crate::cpu::path::pays;
use crate::model::SceneIr;
use std::process::Command;
use std::sync::OnceLock;

/// Mesa's variable for the bits of lavapipe's vectors.
const WIDTH: &str = "LP_NATIVE_VECTOR_WIDTH";

/// So few rays are traced in less time than shaders take to compile, for 512 bits 1.3 to 1.5 times as long as for 256.
const MOST_COMPILED_RAYS: u64 = 100_000;

/// How wide lavapipe computes. No bit of a result depends on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Width {
    /// 128 bits: four rays, whose f64 fill a register of 256. The least to compile.
    Narrow,
    /// The driver's own choice, 256 bits on x86-64: eight rays.
    Usual,
    /// 512 bits: sixteen rays.
    Wide,
}

/// Set once a width is chosen here.
static CHOSEN: OnceLock<Width> = OnceLock::new();

/// What a processor makes of vectors of 512 bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(
    not(target_arch = "x86_64"),
    allow(dead_code, reason = "only x86-64 has such vectors; tests go through all kinds anywhere")
)]
enum Processor {
    /// It has none, or slows down when it computes in them.
    Slow,
    /// It computes in them, but to read a part of one that was just stored takes it four times as long, on average, as of
    /// one of 256 bits; and so lavapipe takes the lanes of every load, store and atomic one by one.
    Whole,
    /// Fast, whole and in parts.
    Fast,
}

impl Width {
    /// What suits a command that compiles the shaders of a scene, in f64 or not, and traces so many rays with them. Where
    /// they are few, it mostly compiles.
    pub fn of_command(ir: &SceneIr, num_rays: u64, in_f64: bool) -> Width {
        Width::of_command_on(Processor::of_this_processor(), ir, num_rays, in_f64)
    }

    fn of_command_on(processor: Processor, ir: &SceneIr, num_rays: u64, in_f64: bool) -> Width {
        if num_rays <= processor.most_narrow_rays(in_f64) {
            Width::Narrow
        } else if num_rays <= MOST_COMPILED_RAYS {
            Width::Usual
        } else {
            Width::of_trace_on(processor, ir, num_rays)
        }
    }

    /// What traces so many rays of a scene fastest on this processor, once its shaders are compiled. Wide vectors are not
    /// for scenes that have meshes: every lane waits until the last one has found its triangle. Where parts are slow, they
    /// are for those whose rays may have a path in a stage of its own, on which memory is met only at the end.
    pub fn of_trace(ir: &SceneIr, num_rays: u64) -> Width {
        Width::of_trace_on(Processor::of_this_processor(), ir, num_rays)
    }

    fn of_trace_on(processor: Processor, ir: &SceneIr, num_rays: u64) -> Width {
        let is_wide = ir.meshes.is_empty()
            && match processor {
                Processor::Slow => false,
                Processor::Whole => {
                    pays::is_long_enough(num_rays) && ir.detectors.iter().all(|detector| detector.absorb)
                }
                Processor::Fast => true,
            };
        if is_wide { Width::Wide } else { Width::Usual }
    }

    fn bits(self) -> Option<&'static str> {
        match self {
            Width::Narrow => Some("128"),
            Width::Usual => None,
            Width::Wide => Some("512"),
        }
    }
}

/// Lets lavapipe compute in vectors so wide. Whoever has set the variable is obeyed.
///
/// # Safety
/// No other thread runs yet: it could read the environment meanwhile. No adapter has been asked for: Mesa reads the
/// variable once.
#[allow(unsafe_code)]
pub unsafe fn choose(width: Width) {
    let Some(bits) = width.bits().filter(|_| std::env::var_os(WIDTH).is_none()) else { return };
    if CHOSEN.set(width).is_ok() {
        // SAFETY: nobody reads the environment meanwhile, as the caller promises.
        unsafe { std::env::set_var(WIDTH, bits) };
    }
}

/// True if the width was chosen here.
pub fn are_chosen() -> bool {
    CHOSEN.get().is_some()
}

/// Leaves the choice to a command that is this program.
pub fn leave_to(command: &mut Command) {
    if are_chosen() {
        command.env_remove(WIDTH);
    }
}

impl Processor {
    /// Processors with AVX-512 VBMI (from Ice Lake and Zen 4 on) do not slow down when they compute in 512 bits, as older
    /// ones do. AMD's read parts as fast as ever (measured on Zen 5), Intel's do not (on Sapphire Rapids).
    #[cfg(target_arch = "x86_64")]
    fn of_this_processor() -> Processor {
        match (std::arch::is_x86_feature_detected!("avx512vbmi"), vendor().as_slice()) {
            (false, _) => Processor::Slow,
            (true, b"AuthenticAMD") => Processor::Fast,
            (true, _) => Processor::Whole,
        }
    }

    #[cfg(not(target_arch = "x86_64"))]
    fn of_this_processor() -> Processor {
        Processor::Slow
    }

    /// So many rays are traced no slower in narrow vectors than compiling for the driver's takes longer. Of f64, registers
    /// of 256 bits hold four, and in vectors of four rays fewer wait for another: on Zen 3 they trace as fast.
    fn most_narrow_rays(self, in_f64: bool) -> u64 {
        match (in_f64, self) {
            (false, _) => 20_000,
            (true, Processor::Slow) => 1_000_000,
            (true, Processor::Whole | Processor::Fast) => MOST_COMPILED_RAYS,
        }
    }
}

/// The processor's maker, in twelve letters.
#[cfg(target_arch = "x86_64")]
fn vendor() -> Vec<u8> {
    let leaf = std::arch::x86_64::__cpuid(0);
    [leaf.ebx, leaf.edx, leaf.ecx].into_iter().flat_map(u32::to_le_bytes).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_are_wide_where_they_pay() {
        let ir = |text: &str| crate::Scene::from_json(text).unwrap().lower().unwrap();
        let lens = ir(include_str!("../../scenes/bench_lens.json"));
        let cavity = ir(include_str!("../../scenes/bench_cavity.json"));
        let mesh = ir(include_str!("../../scenes/mesh_prism.json"));
        for (processor, of_lens, of_cavity) in [
            (Processor::Slow, [false, false], [false, false]),
            (Processor::Whole, [false, true], [false, false]),
            (Processor::Fast, [true, true], [true, true]),
        ] {
            let suits =
                |ir| [1_000, 10_000_000].map(|num| Width::of_trace_on(processor, ir, num) == Width::Wide);
            let found = [suits(&lens), suits(&cavity), suits(&mesh)];
            assert_eq!(found, [of_lens, of_cavity, [false, false]], "{processor:?}");
        }
    }

    #[test]
    fn what_is_mostly_compiled_is_narrow_and_wide_nowhere() {
        use Width::{Narrow, Usual, Wide};
        let lens =
            crate::Scene::from_json(include_str!("../../scenes/bench_lens.json")).unwrap().lower().unwrap();
        let counts = [10_000, 100_000, 1_000_000, 1_000_001, 10_000_000];
        for (processor, in_f64, expected) in [
            (Processor::Slow, false, [Narrow, Usual, Usual, Usual, Usual]),
            (Processor::Slow, true, [Narrow, Narrow, Narrow, Usual, Usual]),
            (Processor::Whole, false, [Narrow, Usual, Usual, Usual, Wide]),
            (Processor::Whole, true, [Narrow, Narrow, Usual, Usual, Wide]),
            (Processor::Fast, false, [Narrow, Usual, Wide, Wide, Wide]),
            (Processor::Fast, true, [Narrow, Narrow, Wide, Wide, Wide]),
        ] {
            let widths = counts.map(|num| Width::of_command_on(processor, &lens, num, in_f64));
            assert_eq!(widths, expected, "{processor:?}, in f64: {in_f64}");
        }
    }
}
