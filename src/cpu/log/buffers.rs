//! The buffers of the deposit log (`shaders/cpu/log/ends.logged.wgsl`): which dispatch writes which, and when the host adds
//! them up. The memory of the device is the host's.

use crate::cpu::log::deposit_sums::{DepositSums, GuardFailure, LoggedRays};
use crate::cpu::log::format::DepositLog;
use crate::cpu::path::fallback::FallbackQueues;
use crate::cpu::path::path_log::PathLog;
use crate::cpu::path::side_trace::SideTrace;
use crate::error::{Error, Result};
use crate::gpu::{Gpu, processors};
use crate::program::{Cells, RayRange};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Two logs, so that the host adds up one while the device writes the other.
#[derive(Debug)]
pub struct LogBuffers {
    gpu: Gpu,
    shape: DepositLog,
    /// What rays on the hot path log. `None` if they log entries, as all other rays do.
    path: Option<PathLog>,
    /// The same of the side traces.
    side_traces: Vec<Option<PathLog>>,
    /// Sums, one for each thread that adds up.
    sums: Vec<DepositSums>,
    /// From an entry of a ray to its next.
    stride: u32,
    /// The logs, which take turns.
    buffers: [wgpu::Buffer; NUM_LOGS],
    /// The number of the log that the next dispatch gets.
    turn: usize,
    /// Logs that are written and not yet added up, in the order of their turns.
    written: VecDeque<Written>,
    /// When the first dispatch of all had ended, as far as was seen.
    first_end: Option<Instant>,
    /// When the last dispatch that was waited for had ended.
    last_end: Option<Instant>,
    /// Rays and time of each timed dispatch, since these times were last taken.
    times: Vec<(u32, Duration)>,
    fallback: FallbackQueues,
    /// Rays of ranges that were added up in this trace, and how many of these rays failed a guard.
    num_followed: u64,
    num_failed: u64,
}

/// Added to a stride, so that the entries of a ray lie no power of two apart. Such addresses crowd each other out of
/// the caches.
const OFF_POWERS_OF_TWO: u32 = 8;

const NUM_LOGS: usize = 2;

/// More threads would wait for memory.
const MOST_THREADS: usize = 8;
/// Most cells of all threads together. The sums of more would crowd each other out of the caches.
const MOST_CELLS: usize = 1 << 20;
/// A thread is not worth its start for fewer entries.
const LEAST_ENTRIES: usize = 1 << 12;

/// The log of a submitted dispatch.
#[derive(Debug)]
struct Written {
    turn: usize,
    range: RayRange,
    rays: Rays,
    submission: wgpu::SubmissionIndex,
    /// When it was submitted, if it is to be timed.
    start: Option<Instant>,
}

/// Which rays a dispatch traces.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Rays {
    /// The rays of its range, along the hot path if there is one.
    OfRange,
    /// Rays that failed a guard of the hot path, along a side trace.
    OfSide {
        /// Its number.
        side: usize,
        /// The ids of the rays.
        ids: Vec<u64>,
    },
    /// Rays that failed a guard of the hot path, by the plain stages.
    Fallback,
}

impl LogBuffers {
    /// The logs of dispatches of at most so many rays.
    ///
    /// # Errors
    /// [`Error::Device`] if the adapter cannot bind so much.
    pub fn new(
        gpu: &Gpu,
        shape: DepositLog,
        path: Option<PathLog>,
        cells: &Cells,
        rays: u32,
    ) -> Result<Self> {
        let stride = rays.next_multiple_of(8) + OFF_POWERS_OF_TWO;
        let bytes = u64::from(stride) * shape.ray_bytes(path.as_ref());
        let buffer = || gpu.mappable_buffer("the deposit log", bytes);
        Ok(LogBuffers {
            gpu: gpu.clone(),
            buffers: [buffer()?, buffer()?],
            sums: no_sums(num_threads(cells), cells, &shape),
            shape,
            path,
            side_traces: Vec::new(),
            stride,
            turn: 0,
            written: VecDeque::new(),
            first_end: None,
            last_end: None,
            times: Vec::new(),
            fallback: FallbackQueues::default(),
            num_followed: 0,
            num_failed: 0,
        })
    }

    /// Lets rays that fail a guard of the hot path follow side traces: always, or where a side trace pays.
    /// `num_expected` is the number of rays to be traced, where that is known.
    pub fn follow_sides(&mut self, side_traces: &[SideTrace], num_expected: Option<u64>, always: bool) {
        self.side_traces = side_traces.iter().map(|side| side.log.clone()).collect();
        self.fallback = FallbackQueues::new(side_traces, num_expected, always);
    }

    /// The logs.
    pub fn buffers(&self) -> [&wgpu::Buffer; NUM_LOGS] {
        self.buffers.each_ref()
    }

    /// The number of the log that the next dispatch writes.
    pub fn turn(&self) -> usize {
        self.turn
    }

    /// From an entry of a ray to its next.
    pub fn stride(&self) -> u32 {
        self.stride
    }

    /// Takes note of a dispatch, which may be timed. Goes on to the next log, and adds up what is written there.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn submitted(
        &mut self,
        range: RayRange,
        rays: Rays,
        submission: wgpu::SubmissionIndex,
        is_timed: bool,
    ) -> Result<()> {
        self.buffers[self.turn].map_async(wgpu::MapMode::Read, .., |_| {});
        let start = is_timed.then(Instant::now);
        self.written.push_back(Written { turn: self.turn, range, rays, submission, start });
        self.turn = (self.turn + 1) % NUM_LOGS;
        while self.written.iter().any(|written| written.turn == self.turn) {
            self.add_up_next()?;
        }
        Ok(())
    }

    /// When the first dispatch of all had ended.
    pub fn first_end(&self) -> Option<Instant> {
        self.first_end
    }

    /// Rays of each timed dispatch that has ended since the last call, and the most that it took.
    pub fn take_times(&mut self) -> Vec<(u32, Duration)> {
        std::mem::take(&mut self.times)
    }

    /// Begins a trace: forgets what is not added up, and the rays that wait for their fallback.
    pub fn discard(&mut self) {
        for written in std::mem::take(&mut self.written) {
            self.buffers[written.turn].unmap();
        }
        self.times.clear();
        self.fallback.discard();
        (self.num_followed, self.num_failed) = (0, 0);
    }

    /// Adds up all logs that still wait.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn finish(&mut self) -> Result<()> {
        while !self.written.is_empty() {
            self.add_up_next()?;
        }
        Ok(())
    }

    /// The rays that failed a guard of the hot path, and wait for their fallback.
    pub fn fallback(&mut self) -> &mut FallbackQueues {
        &mut self.fallback
    }

    /// How many rays of this trace were to keep to the hot path, and how many of these failed a guard.
    pub fn num_followed_and_failed(&self) -> [u64; 2] {
        [self.num_followed, self.num_failed]
    }

    /// The same of each side trace.
    pub fn num_along_sides(&self) -> impl Iterator<Item = [u64; 2]> {
        self.fallback.num_along_sides()
    }

    /// The sums since the last time.
    ///
    /// # Errors
    /// [`Error::Internal`] if the sums of the threads do not fit together.
    pub fn take(&mut self, cells: &Cells) -> Result<DepositSums> {
        let empty = no_sums(self.sums.len(), cells, &self.shape);
        let mut parts = std::mem::replace(&mut self.sums, empty);
        let misfit = || Error::Internal("the threads that add up the deposit log have unlike sums".into());
        parts.iter_mut().try_for_each(DepositSums::add_corners).ok_or_else(misfit)?;
        let mut parts = parts.into_iter();
        let mut sums = parts.next().unwrap_or_default();
        parts.try_for_each(|part| sums.merge(&part)).ok_or_else(misfit)?;
        Ok(sums)
    }

    /// Adds up the first log that is written.
    fn add_up_next(&mut self) -> Result<()> {
        let Some(written) = self.written.pop_front() else { return Ok(()) };
        let log = &self.buffers[written.turn];
        self.gpu.wait_for(written.submission.clone())?;
        let end = Instant::now();
        // The dispatch began when it was submitted, or when the one before had ended.
        let start = written.start.map(|start| self.last_end.map_or(start, |last| last.max(start)));
        self.times.extend(start.map(|start| (written.range.count, end.saturating_duration_since(start))));
        self.last_end = Some(end);
        self.first_end.get_or_insert(end);
        let failures = {
            let bytes = log.get_mapped_range(..);
            let bytes = bytes.map_err(|e| Error::Device(format!("reading the deposit log: {e}")))?;
            let RayRange { count, source, .. } = written.range;
            let logged = LoggedRays {
                bytes: &bytes,
                rays: 0..count as usize,
                stride: self.stride as usize,
                weight: self.shape.weights.get(source).copied().unwrap_or_default(),
            };
            let path = match written.rays {
                Rays::OfRange => self.path.as_ref(),
                Rays::OfSide { side, .. } => self.side_traces.get(side).and_then(Option::as_ref),
                Rays::Fallback => None,
            };
            add_side_by_side(&mut self.sums, &logged, &self.shape, path)
        };
        log.unmap();
        self.note_failures(&failures?, &written)
    }

    /// Notes the rays of a dispatch that failed a guard.
    fn note_failures(&mut self, failures: &[GuardFailure], written: &Written) -> Result<()> {
        let range = &written.range;
        match &written.rays {
            Rays::OfRange => {
                self.num_followed += u64::from(range.count);
                self.num_failed += failures.len() as u64;
                self.fallback.add(failures, range);
                Ok(())
            }
            Rays::OfSide { side, ids } => {
                let unknown =
                    || Error::Internal("a ray that nobody traced was failed a guard of a side trace".into());
                self.fallback.add_of_side(*side, failures, ids, range.source).ok_or_else(unknown)
            }
            Rays::Fallback => Ok(()),
        }
    }
}

/// Threads that add up. Lavapipe deals a dispatch out to all processors in equal parts, and waits for each part. A
/// single thread would keep one processor from its part, and the others would wait.
fn num_threads(cells: &Cells) -> usize {
    processors::count().min(MOST_THREADS).min(MOST_CELLS / cells.num_cells.max(1) as usize).max(1)
}

/// Empty sums, one for each thread.
fn no_sums(num_threads: usize, cells: &Cells, shape: &DepositLog) -> Vec<DepositSums> {
    (0..num_threads).map(|_| DepositSums::new(cells, shape.format)).collect()
}

/// Adds up what rays logged, a part of them in each thread, and returns the rays that failed a guard.
fn add_side_by_side(
    sums: &mut [DepositSums],
    logged: &LoggedRays,
    shape: &DepositLog,
    path: Option<&PathLog>,
) -> Result<Vec<GuardFailure>> {
    let rays = &logged.rays;
    let entries_per_ray = path.map_or(shape.max_passes as usize + 1, PathLog::num_rows);
    let num_entries = rays.len() * entries_per_ray;
    let num_parts = sums.len().min(num_entries / LEAST_ENTRIES).max(1);
    let part_rays = rays.len().div_ceil(num_parts).max(1);
    let part = |first| LoggedRays { rays: first..(first + part_rays).min(rays.end), ..*logged };
    let parts = rays.clone().step_by(part_rays).map(part);
    let add = |(sums, part): (&mut DepositSums, LoggedRays)| {
        let mut failures = Vec::new();
        let added = match path {
            Some(path) => sums.add_path(&part, shape.format, path, &mut failures),
            None => sums.add(&part, shape, &mut failures),
        };
        added.map(|()| failures).ok_or_else(no_such_cell)
    };
    std::thread::scope(|scope| {
        let mut parts = sums.iter_mut().zip(parts);
        let own = parts.next();
        let thread = |part| std::thread::Builder::new().spawn_scoped(scope, move || add(part));
        let no_thread = |error| Error::Device(format!("no thread to add up where rays end: {error}"));
        let others = parts.map(thread).collect::<std::io::Result<Vec<_>>>().map_err(no_thread)?;
        let mut failures = own.map_or_else(|| Ok(Vec::new()), add)?;
        for other in others {
            let failed = |_| Error::Internal("a thread that adds up the deposit log failed".into());
            failures.append(&mut other.join().map_err(failed)??);
        }
        Ok(failures)
    })
}

fn no_such_cell() -> Error {
    Error::Internal("the deposit log names a cell that does not exist".into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::log::format::{EntryFormat, LoggedTaps};
    use crate::model::SceneIr;

    fn log(format: EntryFormat, max_passes: u32) -> DepositLog {
        DepositLog { format, taps: LoggedTaps::None, max_passes, grids: Vec::new(), weights: Vec::new() }
    }

    fn scene() -> SceneIr {
        let text = include_str!("../../../scenes/cooke_triplet.json");
        crate::Scene::from_json(text).unwrap().lower().unwrap()
    }

    /// What so many threads make of a log, whose rays end in one cell after the other, pass first, or failed a guard.
    fn added(num_threads: usize, num: usize) -> (DepositSums, Vec<GuardFailure>) {
        let [in_cell, passes, guard_failed]: [u64; 3] = [1 << 26, 1 << 29, 1 << 30];
        let cells = Cells::of(&scene());
        let shape = log(EntryFormat::Packed, 1);
        let stride = num + 3;
        let weight = |ray: usize| u64::from((1.0 + ray as f32).to_bits()) << 32;
        let cell = |ray: usize| ray as u64 % u64::from(cells.num_cells);
        let first = |ray| match ray % 7 {
            0 => guard_failed | (ray as u64 % 5),
            1 => in_cell | passes | cell(ray) | weight(ray),
            _ => in_cell | cell(ray) | weight(ray),
        };
        let mut entries: Vec<u64> = (0..stride).map(first).collect();
        entries.extend((0..stride).map(|ray| in_cell | cell(ray + 1) | weight(ray)));
        let mut sums: Vec<DepositSums> =
            (0..num_threads).map(|_| DepositSums::new(&cells, shape.format)).collect();
        let logged = LoggedRays { bytes: bytemuck::cast_slice(&entries), rays: 0..num, stride, weight: 0.0 };
        let failures = add_side_by_side(&mut sums, &logged, &shape, None).unwrap();
        let mut all = DepositSums::new(&cells, shape.format);
        sums.iter().for_each(|part| all.merge(part).unwrap());
        (all, failures)
    }

    #[test]
    fn any_number_of_threads_adds_up_the_same() {
        for num in [1, LEAST_ENTRIES, 3 * LEAST_ENTRIES + 1, 4 * LEAST_ENTRIES + 63] {
            let (alone, failures) = added(1, num);
            let ray = |ray: u32| GuardFailure { ray, event: ray % 5 };
            assert!(failures.iter().copied().eq((0..num as u32).step_by(7).map(ray)));
            assert_eq!(alone.counts.iter().sum::<u64>(), (num - failures.len() + (num + 5) / 7) as u64);
            for num_threads in [2, 3, 8] {
                let (sums, failed_of_threads) = added(num_threads, num);
                assert!(
                    sums.counts == alone.counts && sums.quanta().eq(alone.quanta()),
                    "{num_threads}, {num}"
                );
                assert_eq!(failed_of_threads, failures);
            }
        }
    }

    #[test]
    fn a_cell_that_does_not_exist_is_refused_in_any_thread() {
        let cells = Cells::of(&scene());
        let shape = log(EntryFormat::Counts, 0);
        for part in 0..3 {
            let mut entries = vec![0_u32; 3 * LEAST_ENTRIES];
            entries[part * LEAST_ENTRIES + 5] = 1 << 26 | cells.num_counters;
            let mut sums: Vec<DepositSums> = (0..3).map(|_| DepositSums::new(&cells, shape.format)).collect();
            let bytes = bytemuck::cast_slice(&entries);
            let logged = LoggedRays { bytes, rays: 0..entries.len(), stride: 1, weight: 0.0 };
            assert!(
                matches!(add_side_by_side(&mut sums, &logged, &shape, None), Err(Error::Internal(_))),
                "{part}"
            );
        }
    }
}
