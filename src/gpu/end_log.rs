//! Adds up the log of where rays end (`shaders/lib/ends_logged.wgsl`), on devices whose memory is the host's.

use super::Gpu;
use super::sums::{INVALID_DEPOSITS, QUANTA_PER_UNIT};
use crate::error::{Error, Result};
use crate::program::Cells;
use crate::program::end_log::{self, EndLog, Grid, Real};

/// Two logs, so that the host adds up one while the device writes the other.
#[derive(Debug)]
pub struct EndLogs {
    shape: EndLog,
    sums: EndSums,
    stride: u32,
    logs: [Log; 2],
    /// The one that the next dispatch writes.
    turn: usize,
    written: Option<Written>,
}

/// What the logged ends add up to.
#[derive(Debug, Default)]
pub struct EndSums {
    /// Ends per counter.
    pub counts: Vec<u64>,
    /// Quanta per cell; nothing where they follow from the counts.
    pub quanta: Vec<u128>,
}

#[derive(Debug)]
struct Log {
    cells: wgpu::Buffer,
    weights: wgpu::Buffer,
}

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
        let real_bytes = match shape.real {
            Real::F32 => 4,
            Real::F64 => 8,
        };
        let weight_bytes = u64::from(rays) * u64::from(shape.num_rows) * real_bytes;
        let log = || -> Result<Log> {
            Ok(Log {
                cells: gpu.mappable_buffer("the log of ends", u64::from(rays) * 4)?,
                weights: gpu.mappable_buffer("the log of weights", weight_bytes)?,
            })
        };
        let sums = EndSums::new(cells, shape.counts_alone);
        Ok(EndLogs { logs: [log()?, log()?], shape, sums, stride: rays, turn: 0, written: None })
    }

    /// The buffers of either log, by binding.
    pub fn buffers(&self) -> [Vec<(u32, &wgpu::Buffer)>; 2] {
        [0, 1].map(|i| vec![(end_log::CELLS, &self.logs[i].cells), (end_log::WEIGHTS, &self.logs[i].weights)])
    }

    /// The log that the next dispatch writes.
    pub fn turn(&self) -> usize {
        self.turn
    }

    /// Words of a row.
    pub fn stride(&self) -> u32 {
        self.stride
    }

    /// Takes note of a dispatch of so many rays, and adds up the one before it meanwhile.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn submitted(&mut self, gpu: &Gpu, rays: u32, submission: wgpu::SubmissionIndex) -> Result<()> {
        for buffer in [&self.logs[self.turn].cells, &self.logs[self.turn].weights] {
            buffer.map_async(wgpu::MapMode::Read, .., |_| {});
        }
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
        std::mem::replace(&mut self.sums, EndSums::new(cells, self.shape.counts_alone))
    }

    fn add_up(&mut self, gpu: &Gpu, written: Written) -> Result<()> {
        gpu.wait_for(written.submission)?;
        let log = &self.logs[written.log];
        let failed = |e: wgpu::MapRangeError| Error::Device(format!("reading the log of ends: {e}"));
        let makes_sense = {
            let cells = log.cells.get_mapped_range(..).map_err(failed)?;
            let weights = log.weights.get_mapped_range(..).map_err(failed)?;
            let ends = &bytemuck::cast_slice(&cells)[..written.rays as usize];
            let stride = self.stride as usize;
            match self.shape.real {
                Real::F32 => {
                    let weights: &[f32] = bytemuck::cast_slice(&weights);
                    let real = |row: usize, ray: usize| f64::from(weights[row * stride + ray]);
                    self.sums.add(ends, &self.shape, real)
                }
                Real::F64 => {
                    let weights: &[f64] = bytemuck::cast_slice(&weights);
                    let real = |row: usize, ray: usize| weights[row * stride + ray];
                    self.sums.add(ends, &self.shape, real)
                }
            }
        };
        log.cells.unmap();
        log.weights.unmap();
        makes_sense.ok_or_else(|| Error::Internal("the log of ends names a cell that does not exist".into()))
    }
}

/// The parts of an end (`END_*` in ends_logged.wgsl).
const CELL_MASK: u32 = (1 << end_log::CELL_BITS) - 1;
const NEXT_COLUMN: u32 = 1 << 22;
const NEXT_ROW: u32 = 1 << 23;
const HIT_TAP_SHIFT: u32 = 24;
const IN_CELL: u32 = 1 << 26;
const IN_TAPS: u32 = 1 << 27;
const WITHOUT_PLACE: u32 = 1 << 28;

impl EndSums {
    fn new(cells: &Cells, counts_alone: bool) -> Self {
        let num_sums = if counts_alone { 0 } else { cells.num_sums as usize };
        EndSums { counts: vec![0; cells.num_counters as usize], quanta: vec![0; num_sums] }
    }

    /// Adds the ends of a dispatch, with their weights: `real` gives the value of a row for a ray. None if an end makes
    /// no sense.
    fn add(&mut self, ends: &[u32], log: &EndLog, real: impl Fn(usize, usize) -> f64) -> Option<()> {
        for (ray, &end) in ends.iter().enumerate() {
            if end & WITHOUT_PLACE != 0 {
                *self.counts.get_mut(INVALID_DEPOSITS)? += 1;
            }
            if end & (IN_CELL | IN_TAPS) == 0 {
                continue;
            }
            if log.counts_alone {
                *self.counts.get_mut((end & CELL_MASK) as usize)? += 1;
                continue;
            }
            let quanta = self.quanta_of(real(0, ray))?;
            if end & IN_TAPS == 0 {
                let cell = (end & CELL_MASK) as usize;
                *self.counts.get_mut(cell)? += 1;
                *self.quanta.get_mut(cell)? += quanta;
            } else {
                self.add_taps(end, grid_of(&log.grids, end)?, quanta, |tap| real(tap + 1, ray))?;
            }
        }
        Some(())
    }

    /// The taps of an end: the last one takes what the others left (`book_taps` in splat.wgsl).
    fn add_taps(&mut self, end: u32, grid: &Grid, quanta: u128, share: impl Fn(usize) -> f64) -> Option<()> {
        let first = (end & CELL_MASK) as usize;
        let column = if end & NEXT_COLUMN != 0 { grid.column } else { 0 };
        let row = if end & NEXT_ROW != 0 { grid.row } else { 0 };
        let cells = [first, first + column, first + row, first + column + row];
        let hit = cells[(end >> HIT_TAP_SHIFT & 3) as usize];
        *self.counts.get_mut(hit)? += 1;
        let mut rest = quanta;
        for (tap, &cell) in cells[..3].iter().enumerate() {
            let taken = quantize(share(tap)).unwrap_or(0).min(rest);
            rest -= taken;
            *self.quanta.get_mut(cell)? += taken;
        }
        *self.quanta.get_mut(cells[3])? += rest;
        Some(())
    }

    /// Quanta of a weight; what no sum can hold is counted, and is none.
    fn quanta_of(&mut self, weight: f64) -> Option<u128> {
        let quanta = quantize(weight);
        if quanta.is_none() {
            *self.counts.get_mut(INVALID_DEPOSITS)? += 1;
        }
        Some(quanta.unwrap_or(0))
    }
}

/// The detector that has the end's cell.
fn grid_of(grids: &[Grid], end: u32) -> Option<&Grid> {
    let cell = (end & CELL_MASK) as usize;
    match grids {
        [grid] => Some(grid),
        _ => grids.get(grids.partition_point(|grid| grid.first <= cell).checked_sub(1)?),
    }
}

/// `quantize` in sums.wgsl: floor(w 2^52), or none for what no sum can hold.
#[inline]
fn quantize(weight: f64) -> Option<u128> {
    const LIMIT: f64 = (1_u64 << 43) as f64;
    /// Below it, quanta fit 64 bits, to which a processor converts by an instruction.
    const SMALL: f64 = 2048.0;
    let quanta = weight * QUANTA_PER_UNIT as f64;
    if (0.0..SMALL).contains(&weight) {
        return Some(u128::from(quanta as u64));
    }
    (0.0..LIMIT).contains(&weight).then_some(quanta as u128)
}
