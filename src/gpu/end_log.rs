//! Adds up the log of where rays end (`shaders/lib/ends_logged.wgsl`), on devices whose memory is the host's.

use super::Gpu;
use super::sums::{INVALID_DEPOSITS, QUANTA_PER_UNIT};
use crate::error::{Error, Result};
use crate::program::Cells;
use crate::program::RayRange;
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
    /// Rays that strayed from the nominal path, per emitter.
    strays: Vec<Vec<u64>>,
}

/// What the logged ends add up to.
#[derive(Debug, Default)]
pub struct EndSums {
    /// Ends per counter.
    pub counts: Vec<u64>,
    quanta: Quanta,
}

/// Quanta per cell, in two words: the low ones of a map fit the fastest cache, the high ones are seldom touched.
#[derive(Debug, Default)]
struct Quanta {
    low: Vec<u64>,
    high: Vec<u32>,
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
    range: RayRange,
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
        Ok(EndLogs {
            logs: [log()?, log()?],
            shape,
            sums,
            stride: rays,
            turn: 0,
            written: None,
            strays: Vec::new(),
        })
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

    /// Takes note of a dispatch, and adds up the one before it meanwhile.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn submitted(&mut self, gpu: &Gpu, range: RayRange, submission: wgpu::SubmissionIndex) -> Result<()> {
        for buffer in [&self.logs[self.turn].cells, &self.logs[self.turn].weights] {
            buffer.map_async(wgpu::MapMode::Read, .., |_| {});
        }
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

    /// Rays of an emitter that have strayed and wait to be traced: the oldest ones, so many; fewer where no more wait.
    pub fn take_strays(&mut self, emitter: usize, most: u32) -> Vec<u64> {
        let Some(strays) = self.strays.get_mut(emitter) else { return Vec::new() };
        let rest = strays.split_off(strays.len().min(most as usize));
        std::mem::replace(strays, rest)
    }

    /// How many rays of an emitter wait.
    pub fn num_strays(&self, emitter: usize) -> usize {
        self.strays.get(emitter).map_or(0, Vec::len)
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
            let ends: &[u32] = &bytemuck::cast_slice(&cells)[..written.range.count as usize];
            collect_strays(ends, &written.range, &mut self.strays);
            let stride = self.stride as usize;
            match self.shape.real {
                Real::F32 => {
                    self.sums.add(ends, &self.shape, bytemuck::cast_slice::<_, f32>(&weights), stride)
                }
                Real::F64 => {
                    self.sums.add(ends, &self.shape, bytemuck::cast_slice::<_, f64>(&weights), stride)
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
const HIT_NEXT_COLUMN: u32 = 1 << 24;
const HIT_NEXT_ROW: u32 = 1 << 25;
const IN_CELL: u32 = 1 << 26;
const IN_TAPS: u32 = 1 << 27;
const WITHOUT_PLACE: u32 = 1 << 28;
const STRAYED: u32 = 1 << 29;

/// Takes note of the rays of a range that strayed.
fn collect_strays(ends: &[u32], range: &RayRange, strays: &mut Vec<Vec<u64>>) {
    if strays.len() <= range.emitter {
        strays.resize(range.emitter + 1, Vec::new());
    }
    let ids = (range.first..).zip(ends).filter(|(_, end)| *end & STRAYED != 0).map(|(id, _)| id);
    strays[range.emitter].extend(ids);
}

impl EndSums {
    fn new(cells: &Cells, counts_alone: bool) -> Self {
        let num_sums = if counts_alone { 0 } else { cells.num_sums as usize };
        let quanta = Quanta { low: vec![0; num_sums], high: vec![0; num_sums] };
        EndSums { counts: vec![0; cells.num_counters as usize], quanta }
    }

    /// Quanta per cell; none where they follow from the counts.
    pub fn quanta(&self) -> impl Iterator<Item = u128> {
        let words = self.quanta.low.iter().zip(&self.quanta.high);
        words.map(|(&low, &high)| u128::from(low) | u128::from(high) << 64)
    }

    /// Adds the ends of a dispatch; `rows` are those of their weights and shares, each `stride` long. None if an end
    /// makes no sense.
    fn add<T: Copy + Into<f64>>(
        &mut self,
        ends: &[u32],
        log: &EndLog,
        rows: &[T],
        stride: usize,
    ) -> Option<()> {
        let row = |number: usize| rows.get(number * stride..).and_then(|row| row.get(..ends.len()));
        let real = |value: &T| -> f64 { (*value).into() };
        match log.num_rows {
            0 => ends.iter().try_for_each(|&end| self.add_count(end)),
            1 => ends.iter().zip(row(0)?).try_for_each(|(&end, weight)| self.add_end(end, real(weight))),
            _ => {
                let taps = row(1)?.iter().zip(row(2)?).zip(row(3)?);
                let mut rays = ends.iter().zip(row(0)?).zip(taps);
                rays.try_for_each(|((&end, weight), ((a, b), c))| match end & IN_TAPS {
                    0 => self.add_end(end, real(weight)),
                    _ => {
                        let grid = grid_of(&log.grids, end)?;
                        self.add_taps(end, grid, real(weight), [real(a), real(b), real(c)])
                    }
                })
            }
        }
    }

    fn add_count(&mut self, end: u32) -> Option<()> {
        if end & WITHOUT_PLACE != 0 {
            *self.counts.get_mut(INVALID_DEPOSITS)? += 1;
        }
        if end & IN_CELL != 0 {
            *self.counts.get_mut((end & CELL_MASK) as usize)? += 1;
        }
        Some(())
    }

    fn add_end(&mut self, end: u32, weight: f64) -> Option<()> {
        self.add_count(end)?;
        if end & IN_CELL == 0 {
            return Some(());
        }
        let quanta = self.quanta_of(weight)?;
        self.quanta.add((end & CELL_MASK) as usize, quanta)
    }

    /// The taps of an end: the last one takes what the others left (`book_taps` in splat.wgsl).
    fn add_taps(&mut self, end: u32, grid: &Grid, weight: f64, shares: [f64; 3]) -> Option<()> {
        let first = (end & CELL_MASK) as usize;
        let column = if end & NEXT_COLUMN != 0 { grid.column } else { 0 };
        let row = if end & NEXT_ROW != 0 { grid.row } else { 0 };
        let cells = [first, first + column, first + row, first + column + row];
        let hit_column = if end & HIT_NEXT_COLUMN != 0 { column } else { 0 };
        let hit_row = if end & HIT_NEXT_ROW != 0 { row } else { 0 };
        *self.counts.get_mut(first + hit_column + hit_row)? += 1;
        if are_small([weight, shares[0], shares[1], shares[2]]) {
            let mut rest = small_quanta(weight);
            for (&cell, share) in cells.iter().zip(shares) {
                let taken = small_quanta(share).min(rest);
                rest -= taken;
                self.quanta.add_low(cell, taken)?;
            }
            return self.quanta.add_low(cells[3], rest);
        }
        let mut rest = self.quanta_of(weight)?;
        for (&cell, share) in cells.iter().zip(shares) {
            let taken = quantize(share).unwrap_or(0).min(rest);
            rest -= taken;
            self.quanta.add(cell, taken)?;
        }
        self.quanta.add(cells[3], rest)
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

impl Quanta {
    fn add(&mut self, cell: usize, quanta: u128) -> Option<()> {
        *self.high.get_mut(cell)? += (quanta >> 64) as u32;
        self.add_low(cell, quanta as u64)
    }

    #[inline]
    fn add_low(&mut self, cell: usize, quanta: u64) -> Option<()> {
        let low = self.low.get_mut(cell)?;
        let (sum, carries) = low.overflowing_add(quanta);
        *low = sum;
        if carries {
            *self.high.get_mut(cell)? += 1;
        }
        Some(())
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
fn quantize(weight: f64) -> Option<u128> {
    const LIMIT: f64 = (1_u64 << 43) as f64;
    (0.0..LIMIT).contains(&weight).then_some((weight * QUANTA_PER_UNIT as f64) as u128)
}

/// Whether the quanta of weights fit 63 bits: by the bits of positive numbers, which are in their order.
#[inline]
fn are_small(weights: [f64; 4]) -> bool {
    const LIMIT: f64 = 2048.0;
    weights.iter().all(|weight| weight.to_bits() < LIMIT.to_bits())
}

/// [`quantize`] of a small weight.
#[inline]
fn small_quanta(weight: f64) -> u64 {
    (weight * QUANTA_PER_UNIT as f64) as i64 as u64
}
