//! Adds up the log of where rays end (`shaders/lib/ends_logged.wgsl`), on devices whose memory is the host's.

use super::Gpu;
use super::end_sums::{EndSums, LoggedRays};
use crate::error::{Error, Result};
use crate::program::Cells;
use crate::program::RayRange;
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
    /// Ids of rays that strayed from the nominal path, per emitter.
    strays: Vec<Vec<u64>>,
}

/// So that the entries of a ray lie no power of two apart: such addresses crowd each other out of the caches.
const OFF_POWERS_OF_TWO: u32 = 8;

/// The log of a submitted dispatch.
#[derive(Debug)]
struct Written {
    log: usize,
    range: RayRange,
    /// Its rays follow the nominal path, as far as they do.
    may_stray: bool,
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
        Ok(EndLogs {
            logs: [log()?, log()?],
            shape,
            sums,
            stride,
            turn: 0,
            written: None,
            strays: Vec::new(),
        })
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

    /// Takes note of a dispatch, whose rays may have strayed from the nominal path, and adds up the one before it meanwhile.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn submitted(
        &mut self,
        gpu: &Gpu,
        range: RayRange,
        may_stray: bool,
        submission: wgpu::SubmissionIndex,
    ) -> Result<()> {
        self.logs[self.turn].map_async(wgpu::MapMode::Read, .., |_| {});
        let before = self.written.replace(Written { log: self.turn, range, may_stray, submission });
        self.turn = 1 - self.turn;
        before.map_or(Ok(()), |written| self.add_up(gpu, written))
    }

    /// Forgets what is not added up, and the strays.
    pub fn discard(&mut self) {
        if let Some(written) = self.written.take() {
            self.logs[written.log].unmap();
        }
        self.strays.clear();
    }

    /// Adds up what is still to be.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn finish(&mut self, gpu: &Gpu) -> Result<()> {
        self.written.take().map_or(Ok(()), |written| self.add_up(gpu, written))
    }

    /// How many strays of an emitter wait.
    pub fn num_strays(&self, emitter: usize) -> usize {
        self.strays.get(emitter).map_or(0, Vec::len)
    }

    /// Strays of an emitter, at most so many of those that wait.
    pub fn take_strays(&mut self, emitter: usize, most: u32) -> Vec<u64> {
        let Some(strays) = self.strays.get_mut(emitter) else { return Vec::new() };
        strays.split_off(strays.len().saturating_sub(most as usize))
    }

    /// The sums since the last time.
    pub fn take(&mut self, cells: &Cells) -> EndSums {
        std::mem::replace(&mut self.sums, EndSums::new(cells, self.shape.form))
    }

    fn add_up(&mut self, gpu: &Gpu, written: Written) -> Result<()> {
        gpu.wait_for(written.submission)?;
        let log = &self.logs[written.log];
        let mut strays = Vec::new();
        let makes_sense = {
            let bytes = log.get_mapped_range(..);
            let bytes = bytes.map_err(|e| Error::Device(format!("reading the log of ends: {e}")))?;
            let (num, stride) = (written.range.count as usize, self.stride as usize);
            let rays = LoggedRays { bytes: &bytes, num, stride };
            self.sums.add(rays, &self.shape, written.may_stray.then_some(&mut strays))
        };
        log.unmap();
        self.note_strays(&strays, &written.range);
        makes_sense.ok_or_else(|| Error::Internal("the log of ends names a cell that does not exist".into()))
    }

    /// Notes the rays of a range that strayed, by their ids.
    fn note_strays(&mut self, strays: &[u32], range: &RayRange) {
        self.strays.resize(self.strays.len().max(range.emitter + 1), Vec::new());
        self.strays[range.emitter].extend(strays.iter().map(|&ray| range.first + u64::from(ray)));
    }
}
