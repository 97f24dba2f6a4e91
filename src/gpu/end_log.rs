//! Adds up the log of where rays end (`shaders/lib/ends_logged.wgsl`), on devices whose memory is the host's.

use super::Gpu;
use super::end_sums::{EndSums, LoggedRays};
use crate::error::{Error, Result};
use crate::program::Cells;
use crate::program::end_log::{self, EndLog};

/// Two logs, so that the host adds up one while the device writes the other.
#[derive(Debug)]
pub struct EndLogs {
    shape: EndLog,
    sums: EndSums,
    /// From an entry of a ray to its next.
    stride: u32,
    logs: [wgpu::Buffer; 2],
    /// The one that the next dispatch writes.
    turn: usize,
    written: Option<Written>,
}

/// So that the entries of a ray lie no power of two apart: such addresses crowd each other out of the caches.
const OFF_POWERS_OF_TWO: u32 = 8;

/// The log of a submitted dispatch.
#[derive(Debug)]
struct Written {
    log: usize,
    rays: u32,
    submission: wgpu::SubmissionIndex,
}

impl EndLogs {
    /// The logs of dispatches of at most so many rays.
    ///
    /// # Errors
    /// [`Error::Device`] if the adapter cannot bind so much.
    pub fn new(gpu: &Gpu, shape: EndLog, cells: &Cells, rays: u32) -> Result<Self> {
        let stride = rays.next_multiple_of(8) + OFF_POWERS_OF_TWO;
        let bytes = u64::from(stride) * shape.ray_bytes();
        let log = || gpu.mappable_buffer("the log of ends", bytes);
        let sums = EndSums::new(cells, shape.form);
        Ok(EndLogs { logs: [log()?, log()?], shape, sums, stride, turn: 0, written: None })
    }

    /// The buffer of either log, by binding.
    pub fn buffers(&self) -> [(u32, &wgpu::Buffer); 2] {
        [0, 1].map(|i| (end_log::LOG, &self.logs[i]))
    }

    /// The log that the next dispatch writes.
    pub fn turn(&self) -> usize {
        self.turn
    }

    /// From an entry of a ray to its next.
    pub fn stride(&self) -> u32 {
        self.stride
    }

    /// Takes note of a dispatch of so many rays, and adds up the one before it meanwhile.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn submitted(&mut self, gpu: &Gpu, rays: u32, submission: wgpu::SubmissionIndex) -> Result<()> {
        self.logs[self.turn].map_async(wgpu::MapMode::Read, .., |_| {});
        let before = self.written.replace(Written { log: self.turn, rays, submission });
        self.turn = 1 - self.turn;
        before.map_or(Ok(()), |written| self.add_up(gpu, written))
    }

    /// Adds up what is still to be.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn finish(&mut self, gpu: &Gpu) -> Result<()> {
        self.written.take().map_or(Ok(()), |written| self.add_up(gpu, written))
    }

    /// The sums since the last time.
    pub fn take(&mut self, cells: &Cells) -> EndSums {
        std::mem::replace(&mut self.sums, EndSums::new(cells, self.shape.form))
    }

    fn add_up(&mut self, gpu: &Gpu, written: Written) -> Result<()> {
        gpu.wait_for(written.submission)?;
        let log = &self.logs[written.log];
        let makes_sense = {
            let bytes = log.get_mapped_range(..);
            let bytes = bytes.map_err(|e| Error::Device(format!("reading the log of ends: {e}")))?;
            let (num, stride) = (written.rays as usize, self.stride as usize);
            self.sums.add(LoggedRays { bytes: &bytes, num, stride }, &self.shape)
        };
        log.unmap();
        makes_sense.ok_or_else(|| Error::Internal("the log of ends names a cell that does not exist".into()))
    }
}
