//! How wide lavapipe computes.

use crate::ir::SceneIr;

/// Mesa's variable for the bits of lavapipe's vectors.
const WIDTH: &str = "LP_NATIVE_VECTOR_WIDTH";

/// Lets lavapipe compute in vectors of 512 bits where the processor is made for them; by itself it takes 256. A walk through
/// the tree of a mesh is the slower for it, all else the faster. Whoever has set the variable is obeyed.
///
/// # Safety
/// No other thread runs yet: one could read the environment meanwhile.
#[allow(unsafe_code)]
pub unsafe fn widen(ir: &SceneIr) {
    if ir.meshes.is_empty() && std::env::var_os(WIDTH).is_none() && computes_512_bits() {
        // SAFETY: nobody reads the environment meanwhile, as the caller promises.
        unsafe { std::env::set_var(WIDTH, "512") };
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
