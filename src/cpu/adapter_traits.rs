//! What suits an adapter that is a processor: where sums are added up, and in what memory tables lie. On a GPU nothing is
//! set: the plain loop does everything.

use crate::gpu::compute::TEXEL_BYTES;
use crate::gpu::{Gpu, processors};
use crate::program::TEXELS_PER_LINE;

/// What suits an adapter.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct AdapterTraits {
    /// How many processors the adapter is. `None` for a GPU.
    pub processors: Option<u32>,
    /// The host should add up where rays end: on a processor, an atomic costs each emulated lane ten times a store.
    pub deferred_splats: bool,
    /// Tables of at most so many bytes are better read from a uniform buffer than from a storage buffer. Processors read
    /// uniforms, by words, without a check of every lane; GPUs read storage faster where invocations diverge.
    pub uniform_bytes: u32,
    /// Tables of at most so many bytes are better read from an image than from a buffer, where invocations read
    /// different rows. Lavapipe reads a texel as a whole, and the words of a buffer lane by lane. Other processors'
    /// drivers were not tried.
    pub texel_bytes: u64,
}

impl AdapterTraits {
    /// What suits an open device.
    pub fn of(gpu: &Gpu) -> Self {
        if !gpu.info.class.emulates_lanes() {
            return AdapterTraits::default();
        }
        let limits = gpu.device.limits();
        AdapterTraits {
            processors: Some(processors::count() as u32),
            deferred_splats: gpu.has_shared_memory(),
            uniform_bytes: limits.max_uniform_buffer_binding_size.min(u64::from(u32::MAX)) as u32,
            texel_bytes: if gpu.info.is_vulkan() { texel_bytes(gpu, &limits) } else { 0 },
        }
    }
}

/// What the largest image of texels holds.
fn texel_bytes(gpu: &Gpu, limits: &wgpu::Limits) -> u64 {
    let is_possible = limits.max_storage_textures_per_shader_stage >= 1
        && limits.max_texture_dimension_2d >= TEXELS_PER_LINE;
    let lines = if is_possible { limits.max_texture_dimension_2d } else { 0 };
    let image = u64::from(TEXEL_BYTES) * u64::from(TEXELS_PER_LINE) * u64::from(lines);
    image.min(gpu.largest_binding())
}
