//! What the CPU backend does, and when. A trace decides by what pays; tests and the bench override that. No choice changes a bit of a
//! result.

use crate::error::{Error, Result};
use crate::gpu::Gpu;

/// When something is done that changes no result.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Override {
    /// Done where it pays.
    #[default]
    Automatic,
    /// Wherever it is possible.
    Always,
    /// Nowhere.
    Never,
}

impl Override {
    /// `Always` or `Never`.
    pub fn forced(is_done: bool) -> Self {
        if is_done { Override::Always } else { Override::Never }
    }

    /// Whether it is done, where it pays or does not.
    pub(crate) fn holds(self, pays: impl FnOnce() -> bool) -> bool {
        match self {
            Override::Automatic => pays(),
            Override::Always => true,
            Override::Never => false,
        }
    }
}

/// What a trace is forced to do or not to do.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct CpuOverrides {
    /// The host adds up where rays end, instead of atomics on the device.
    pub deferred_splats: Override,
    /// The path that most rays take has a stage of its own, and rays that fail its guards are traced again. The stage
    /// pays in long traces in which the host adds up.
    pub hot_path: Override,
    /// Rays that fail a guard of the hot path follow side traces: all of these, none, or those whose stages pay.
    /// Whether a stage pays follows from the rays to be traced or, where that number is not known, from the rays traced
    /// so far.
    pub side_traces: Override,
    /// Invocations follow two rays of the hot path at a time, where they can. Pairs pay on processors, whose
    /// instructions would wait for each other.
    pub side_by_side: Override,
    /// Most rays that an invocation follows one after the other, where it may follow several. By default several on a
    /// processor, as long as there are workgroups enough.
    pub rays_per_invocation: Option<u32>,
    /// Trees of at most so many bytes lie in images. By default, on a processor, all trees that its images can hold.
    pub texel_bytes: Option<u64>,
}

impl CpuOverrides {
    /// Refuses what an adapter cannot do.
    pub(crate) fn check(&self, gpu: &Gpu) -> Result<()> {
        if self.deferred_splats == Override::Always && !gpu.has_shared_memory() {
            let name = &gpu.info.name;
            return Err(Error::Usage(format!(
                "the adapter `{name}` shares no memory with the host, which cannot add up"
            )));
        }
        Ok(())
    }
}
