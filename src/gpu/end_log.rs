//! Adds up the log of where rays end (`shaders/lib/ends_logged.wgsl`), on devices whose memory is the host's.

use super::Gpu;
use super::end_sums::EndSums;
use crate::error::{Error, Result};
use crate::program::Cells;
use crate::program::RayRange;
use crate::program::end_log::{self, EndLog};

/// Two logs, so that the host adds up one while the device writes the other.
#[derive(Debug)]
pub struct EndLogs {
    shape: EndLog,
    sums: EndSums,
    logs: [wgpu::Buffer; 2],
    /// The one that the next dispatch writes.
    turn: usize,
    written: Option<Written>,
    /// Ids of rays that strayed from the nominal path, per emitter.
    strays: Vec<Vec<u64>>,
}

/// The log of a submitted dispatch.
#[derive(Debug)]
struct Written {
    log: usize,
    range: RayRange,
    submission: wgpu::SubmissionIndex,
}

impl EndLogs {
    /// The logs of dispatches of at most so many rays.
    ///
    /// # Errors
    /// [`Error::Device`] if the adapter cannot bind so much.
    pub fn new(gpu: &Gpu, shape: EndLog, cells: &Cells, rays: u32) -> Result<Self> {
        let bytes = u64::from(rays) * u64::from(shape.num_words()) * u64::from(shape.word_bytes());
        let log = || gpu.mappable_buffer("the log of ends", bytes);
        let sums = EndSums::new(cells, shape.form);
        Ok(EndLogs { logs: [log()?, log()?], shape, sums, turn: 0, written: None, strays: Vec::new() })
    }

    /// The buffer of either log, by binding.
    pub fn buffers(&self) -> [(u32, &wgpu::Buffer); 2] {
        [0, 1].map(|i| (end_log::LOG, &self.logs[i]))
    }

    /// The log that the next dispatch writes.
    pub fn turn(&self) -> usize {
        self.turn
    }

    /// Takes note of a dispatch, and adds up the one before it meanwhile.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn submitted(&mut self, gpu: &Gpu, range: RayRange, submission: wgpu::SubmissionIndex) -> Result<()> {
        self.logs[self.turn].map_async(wgpu::MapMode::Read, .., |_| {});
        let before = self.written.replace(Written { log: self.turn, range, submission });
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

    fn note_strays(&mut self, range: &RayRange) {
        let strays = self.sums.take_strays();
        if !strays.is_empty() {
            let num_emitters = self.strays.len().max(range.emitter + 1);
            self.strays.resize(num_emitters, Vec::new());
            self.strays[range.emitter].extend(strays.into_iter().map(|index| range.first + u64::from(index)));
        }
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
        let makes_sense = {
            let bytes = log.get_mapped_range(..);
            let bytes = bytes.map_err(|e| Error::Device(format!("reading the log of ends: {e}")))?;
            self.sums.add(&bytes, written.range.count as usize, &self.shape)
        };
        log.unmap();
        self.note_strays(&written.range);
        makes_sense.ok_or_else(|| Error::Internal("the log of ends names a cell that does not exist".into()))
    }
}
