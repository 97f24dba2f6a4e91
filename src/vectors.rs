//! How wide lavapipe computes.

use crate::ir::SceneIr;
use std::process::Command;
use std::sync::OnceLock;

/// Mesa's variable for the bits of lavapipe's vectors.
const WIDTH: &str = "LP_NATIVE_VECTOR_WIDTH";

/// Set once the width is chosen here: whether it is.
static IS_WIDE: OnceLock<bool> = OnceLock::new();

/// True if a scene is the faster for wide vectors. All are but those with meshes: every lane waits until the last one has
/// found its triangle.
pub fn suit(ir: &SceneIr) -> bool {
    ir.meshes.is_empty()
}

/// Lets lavapipe compute in vectors of 512 bits, where the processor is made for them; by itself it takes 256. No bit of a
/// result depends on it. Whoever has set the variable is obeyed.
///
/// # Safety
/// No other thread runs yet: it could read the environment meanwhile. No adapter has been asked for: Mesa reads the
/// variable once.
#[allow(unsafe_code)]
pub unsafe fn widen() {
    let is_wide = std::env::var_os(WIDTH).is_none() && computes_512_bits();
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

/// Processors with this extension (from Ice Lake and Zen 4 on) do not slow down when they compute in 512 bits, as older
/// ones do.
fn computes_512_bits() -> bool {
    #[cfg(target_arch = "x86_64")]
    {
        std::arch::is_x86_feature_detected!("avx512vbmi")
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        false
    }
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
