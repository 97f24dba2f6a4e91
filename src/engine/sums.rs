//! The exact sums of a trace on the device (`shaders/sums/sums*.wgsl`): buffers, and how they are read back.
//!
//! Cells that are zero are left out, so that memory for them is never touched: few cells of a large map are lit.

use crate::error::Result;
use crate::gpu::Gpu;
use crate::program::layout::sums::SumBuffer;

/// One unit of weight \[quanta\].
pub const QUANTA_PER_UNIT: u128 = 1 << 52;

/// Index of the counter of deposits that no sum can hold: `INVALID_DEPOSITS` in `sums.wgsl`.
pub const INVALID_DEPOSITS: usize = 0;

/// A buffer of sums on the device, in its parts.
#[derive(Debug)]
pub struct DeviceSums {
    shape: SumBuffer,
    parts: Vec<wgpu::Buffer>,
}

impl DeviceSums {
    /// The buffer, all zeros.
    ///
    /// # Errors
    /// [`crate::Error::Device`] if the adapter cannot bind a part.
    pub fn new(gpu: &Gpu, shape: &SumBuffer) -> Result<Self> {
        let parts = shape.part_bytes().map(|bytes| gpu.buffer(shape.name, bytes)).collect::<Result<_>>()?;
        Ok(DeviceSums { shape: shape.clone(), parts })
    }

    /// The parts by binding.
    pub fn bindings(&self) -> impl Iterator<Item = (u32, &wgpu::Buffer)> {
        self.shape.bindings.iter().copied().zip(&self.parts)
    }

    /// Sets all to zero.
    pub fn clear(&self, encoder: &mut wgpu::CommandEncoder) {
        self.parts.iter().for_each(|part| encoder.clear_buffer(part, 0, None));
    }

    /// Passes what the buffer adds to its cells to `add`, as (cell, value). Zeros are left out.
    ///
    /// # Errors
    /// [`crate::Error::Device`] if the device fails.
    pub fn read(&self, gpu: &Gpu, mut add: impl FnMut(usize, u128)) -> Result<()> {
        let element_bytes = self.shape.words.element_bytes();
        for (part, bytes) in (0..).zip(self.shape.part_bytes()) {
            gpu.read_blocks(&self.parts[part], 0, bytes, |offset, bytes| {
                let first = ((part as u64) << self.shape.part_bits) + offset / element_bytes;
                self.shape.words.values(first, bytes).for_each(|(cell, value)| add(cell, value));
            })?;
        }
        Ok(())
    }

    /// Reads one element of 32 bits.
    ///
    /// # Errors
    /// [`crate::Error::Device`] if the device fails.
    pub fn read_word(&self, gpu: &Gpu, index: u32) -> Result<u32> {
        let (part, within) = (index >> self.shape.part_bits, index & ((1 << self.shape.part_bits) - 1));
        let bytes = gpu.read_at(&self.parts[part as usize], u64::from(within) * 4, 4)?;
        Ok(bytemuck::pod_read_unaligned(&bytes))
    }
}
