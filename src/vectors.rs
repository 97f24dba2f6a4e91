//! How wide lavapipe computes.

use crate::folders::Folder;
use crate::ir::SceneIr;
use crate::nominal;
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::Command;
use std::sync::OnceLock;

/// Mesa's variable for the bits of lavapipe's vectors.
const WIDTH: &str = "LP_NATIVE_VECTOR_WIDTH";
/// Mesa's variables for the folder of its cache of compiled shaders: today's, and that of before Mesa 22.3.
const CACHES: [&str; 2] = ["MESA_SHADER_CACHE_DIR", "MESA_GLSL_CACHE_DIR"];

/// So few rays are traced in less time than wide vectors take longer to compile for.
const FEW_RAYS: u64 = 100_000;

/// How wide lavapipe computes. No bit of a result depends on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Width {
    /// 128 bits: four rays. Each has half of a vector of f64 in a register as they are since AVX, and the least is compiled.
    Narrow,
    /// The driver's own choice, 256 bits on x86-64: eight rays.
    Usual,
    /// 512 bits: sixteen rays.
    Wide,
}

/// Set once a width is chosen here: what was set in the environment.
static CHOSEN: OnceLock<Vec<&str>> = OnceLock::new();

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

impl Width {
    /// What suits a command that compiles the shaders of a scene, in f64 or not, and traces so many rays with them. Where
    /// they are few, it mostly compiles.
    pub fn of_command(ir: &SceneIr, num_rays: u64, in_f64: bool) -> Width {
        Width::of_command_on(Wide::of_this_processor(), ir, num_rays, in_f64)
    }

    fn of_command_on(processor: Wide, ir: &SceneIr, num_rays: u64, in_f64: bool) -> Width {
        match (num_rays <= FEW_RAYS, in_f64) {
            (true, true) => Width::Narrow,
            (true, false) => Width::Usual,
            (false, _) => Width::of_trace_on(processor, ir, num_rays),
        }
    }

    /// What traces so many rays of a scene fastest on this processor, once its shaders are compiled. Wide vectors are not
    /// for scenes that have meshes: every lane waits until the last one has found its triangle. Where parts are slow, they
    /// are for those whose rays may have a path in a stage of its own, on which memory is met only at the end.
    pub fn of_trace(ir: &SceneIr, num_rays: u64) -> Width {
        Width::of_trace_on(Wide::of_this_processor(), ir, num_rays)
    }

    fn of_trace_on(processor: Wide, ir: &SceneIr, num_rays: u64) -> Width {
        let is_wide = ir.meshes.is_empty()
            && match processor {
                Wide::Slow => false,
                Wide::Whole => {
                    nominal::is_long_enough(num_rays) && ir.sensors.iter().all(|sensor| sensor.absorb)
                }
                Wide::Fast => true,
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

/// True if this processor reads parts of vectors of 512 bits slowly that it has just stored.
pub fn have_slow_parts() -> bool {
    Wide::of_this_processor() == Wide::Whole
}

/// Lets lavapipe compute in vectors so wide. Whoever has set the variable is obeyed. The driver's cache of compiled shaders
/// does not know of their width, and would give this width's to the others: so each has a folder of its own, unless the
/// user has named one.
///
/// # Safety
/// No other thread runs yet: it could read the environment meanwhile. No adapter has been asked for: Mesa reads the
/// variables once.
#[allow(unsafe_code)]
pub unsafe fn choose(width: Width) {
    let is_set = |name: &str| std::env::var_os(name).is_some();
    let Some(bits) = width.bits().filter(|_| !is_set(WIDTH)) else { return };
    let mut variables = vec![(WIDTH, OsString::from(bits))];
    if !CACHES.into_iter().any(is_set) {
        variables.extend(cache_folder(bits).map(|folder| (CACHES[0], folder.into_os_string())));
    }
    if CHOSEN.set(variables.iter().map(|(name, _)| *name).collect()).is_ok() {
        for (name, value) in variables {
            // SAFETY: nobody reads the environment meanwhile, as the caller promises.
            unsafe { std::env::set_var(name, value) };
        }
    }
}

/// The folder for shaders of a width. Without one, where it cannot be made, the driver keeps to its own.
fn cache_folder(bits: &str) -> Option<PathBuf> {
    let folder = Folder::Cache.path()?.join(format!("shaders-{bits}-bits"));
    std::fs::create_dir_all(&folder).ok()?;
    Some(folder)
}

/// True if the width was chosen here.
pub fn are_chosen() -> bool {
    CHOSEN.get().is_some()
}

/// Leaves the choice to a command that is this program.
pub fn leave_to(command: &mut Command) {
    for name in CHOSEN.get().into_iter().flatten() {
        command.env_remove(name);
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
            let suits =
                |ir| [1_000, 10_000_000].map(|num| Width::of_trace_on(processor, ir, num) == Width::Wide);
            let found = [suits(&lens), suits(&cavity), suits(&mesh)];
            assert_eq!(found, [of_lens, of_cavity, [false, false]], "{processor:?}");
        }
    }

    #[test]
    fn what_is_mostly_compiled_is_narrow_in_f64_and_wide_nowhere() {
        let lens =
            crate::Scene::from_json(include_str!("../scenes/bench_lens.json")).unwrap().lower().unwrap();
        for processor in [Wide::Slow, Wide::Whole, Wide::Fast] {
            let of = |num_rays, in_f64| Width::of_command_on(processor, &lens, num_rays, in_f64);
            assert_eq!([false, true].map(|in_f64| of(FEW_RAYS, in_f64)), [Width::Usual, Width::Narrow]);
            for num_rays in [FEW_RAYS + 1, 10_000_000] {
                let of_trace = Width::of_trace_on(processor, &lens, num_rays);
                assert_eq!([false, true].map(|in_f64| of(num_rays, in_f64)), [of_trace; 2], "{processor:?}");
            }
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
