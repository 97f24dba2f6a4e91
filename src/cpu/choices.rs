//! What the software wing does, and when. A trace chooses by what pays; tests choose otherwise. No choice changes a bit of a
//! result.

use crate::error::{Error, Result};
use crate::gpu::Gpu;

/// When something is done.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum When {
    /// Where it pays.
    #[default]
    ItPays,
    /// Wherever it is possible.
    Always,
    /// Nowhere.
    Never,
}

impl When {
    /// `Always` or `Never`.
    pub fn forced(is_done: bool) -> Self {
        if is_done { When::Always } else { When::Never }
    }

    /// Whether it is done, where it pays or does not.
    pub(crate) fn holds(self, pays: impl FnOnce() -> bool) -> bool {
        match self {
            When::ItPays => pays(),
            When::Always => true,
            When::Never => false,
        }
    }
}

/// The choices of a trace.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Choices {
    /// The host adds up where rays end, instead of atomics on the device.
    pub host_sums: When,
    /// The path that most rays take has a stage of its own, and rays that it rejects are traced again. It pays in long traces
    /// in which the host adds up.
    pub main_path: When,
    /// Rays that the main path rejects follow side paths: all of them, none, or those whose stages pay for as many rays as are
    /// to be traced or, where that is not known, have been.
    pub side_paths: When,
    /// Two devices on one adapter take turns where the host adds up, the second from the end of the first pass on. It pays in
    /// traces that take long.
    pub second_device: When,
    /// Invocations follow two rays of the main path at a time, where they can. It pays on processors, whose instructions would
    /// wait for each other.
    pub side_by_side: When,
    /// Most rays that an invocation follows one after the other, where it may follow several; where not given, several on a
    /// processor, as long as it has workgroups enough.
    pub rays_per_invocation: Option<u32>,
    /// Trees of at most so many bytes lie in images; where not given, on a processor, as large as its images.
    pub texel_bytes: Option<u64>,
}

impl Choices {
    /// Refuses what an adapter cannot do.
    pub(crate) fn check(&self, gpu: &Gpu) -> Result<()> {
        if self.host_sums == When::Always && !gpu.has_shared_memory() {
            let name = &gpu.info.name;
            return Err(Error::Usage(format!(
                "the adapter `{name}` shares no memory with the host, which cannot add up"
            )));
        }
        Ok(())
    }
}
