//! What the deposit log adds up to: the integers of the device's atomics (`shaders/sums/sums.wgsl`), on the host.

use crate::cpu::log::bits::{bits, entries_of, quantize};
use crate::cpu::log::corners::CornerSums;
use crate::cpu::log::entries::{
    CELL_MASK, End, Entry, GUARD_FAILED, HIT_NEXT_COLUMN, HIT_NEXT_ROW, IN_CELL, IN_TAPS, NEXT_COLUMN,
    NEXT_ROW, PASSES, WITHOUT_POSITION,
};
use crate::cpu::log::format::{DepositLog, EntryFormat, Grid, LoggedTaps};
use crate::cpu::log::positions::{BLOCK, Block, PositionEntry, PositionTaps};
use crate::cpu::log::reals::Real;
use crate::engine::sums::INVALID_DEPOSITS;
use crate::program::Cells;
use std::ops::Range;

/// What the logged ends add up to.
#[derive(Debug, Default)]
pub struct DepositSums {
    /// Ends per counter.
    pub counts: Vec<u64>,
    quanta: Quanta,
    /// What has not come to its cells yet.
    corners: Vec<CornerSums>,
}

/// What the rays of a dispatch logged.
#[derive(Debug, Clone)]
pub struct LoggedRays<'a> {
    /// The log's words.
    pub bytes: &'a [u8],
    /// The rays to add, by their numbers in the dispatch.
    pub rays: Range<usize>,
    /// From an entry of a ray to its next.
    pub stride: usize,
    /// The weight that they are born with.
    pub weight: f64,
}

/// A ray that failed a guard of a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GuardFailure {
    /// Its number in the dispatch.
    pub ray: u32,
    /// The event of the path whose guard it failed.
    pub event: u32,
}

/// Quanta per cell, in two words: the low ones of a map fit the fastest cache, the high ones are seldom touched.
#[derive(Debug, Default)]
struct Quanta {
    low: Vec<u64>,
    high: Vec<u64>,
}

impl DepositSums {
    /// No ends.
    pub fn new(cells: &Cells, format: EntryFormat) -> Self {
        let num_sums = if format == EntryFormat::Counts { 0 } else { cells.num_sums as usize };
        let quanta = Quanta { low: vec![0; num_sums], high: vec![0; num_sums] };
        DepositSums { counts: vec![0; cells.num_counters as usize], quanta, corners: Vec::new() }
    }

    /// No ends in so many cells.
    #[cfg(test)]
    pub(crate) fn of_num(num: usize) -> Self {
        let quanta = Quanta { low: vec![0; num], high: vec![0; num] };
        DepositSums { counts: vec![0; num], quanta, corners: Vec::new() }
    }

    /// Brings what lies at corners to its cells.
    pub fn add_corners(&mut self) -> Option<()> {
        std::mem::take(&mut self.corners)
            .iter()
            .flat_map(CornerSums::by_cell)
            .try_for_each(|(cell, quanta)| self.quanta.add_low(cell, quanta))
    }

    /// Quanta per cell, after [`DepositSums::add_corners`]. Empty where quanta follow from the counts.
    pub fn quanta(&self) -> impl Iterator<Item = u128> {
        debug_assert!(self.corners.is_empty());
        let words = self.quanta.low.iter().zip(&self.quanta.high);
        words.map(|(&low, &high)| u128::from(low) | u128::from(high) << 64)
    }

    /// Adds what the rays of a dispatch logged, and shows those that failed a guard of the hot path, by their number. None
    /// if an entry makes no sense.
    pub fn add(
        &mut self,
        logged: &LoggedRays,
        log: &DepositLog,
        failures: &mut Vec<GuardFailure>,
    ) -> Option<()> {
        match (log.format, log.taps) {
            (EntryFormat::Counts, _) => self.add_rays::<[u32; 1]>(logged, log, failures),
            (EntryFormat::Packed, LoggedTaps::None) => self.add_rays::<[u64; 1]>(logged, log, failures),
            (EntryFormat::Packed, LoggedTaps::Fractions) => self.add_rays::<[u64; 2]>(logged, log, failures),
            (EntryFormat::Reals, LoggedTaps::None) => self.add_rays::<[f64; 2]>(logged, log, failures),
            (EntryFormat::Reals, LoggedTaps::Fractions) => self.add_rays::<[f64; 4]>(logged, log, failures),
            // The low half of a 64-bit word comes first.
            (EntryFormat::Packed, LoggedTaps::Positions { grid, has_weights: false }) => {
                self.add_positions::<[u32; 2]>(logged, &grid, failures)
            }
            (EntryFormat::Packed, LoggedTaps::Positions { grid, has_weights: true }) => {
                self.add_positions::<[u32; 4]>(logged, &grid, failures)
            }
            (EntryFormat::Reals, LoggedTaps::Positions { grid, has_weights: false }) => {
                self.add_positions::<[f64; 2]>(logged, &grid, failures)
            }
            (EntryFormat::Reals, LoggedTaps::Positions { grid, has_weights: true }) => {
                self.add_positions::<[f64; 3]>(logged, &grid, failures)
            }
        }
    }

    /// Adds the sums of another thread, which has settled.
    pub fn merge(&mut self, other: &DepositSums) -> Option<()> {
        debug_assert!(other.corners.is_empty());
        for (count, more) in self.counts.iter_mut().zip(&other.counts) {
            *count += more;
        }
        (0..)
            .zip(other.quanta())
            .filter(|(_, quanta)| *quanta > 0)
            .try_for_each(|(cell, quanta)| self.quanta.add(cell, quanta))
    }

    fn add_rays<E: Entry>(
        &mut self,
        logged: &LoggedRays,
        log: &DepositLog,
        failures: &mut Vec<GuardFailure>,
    ) -> Option<()> {
        let LoggedRays { bytes, ref rays, stride, .. } = *logged;
        let entries: &[E] = entries_of(bytes)?;
        if log.max_passes == 0 {
            let mut ends = rays.clone().zip(entries.get(rays.clone())?);
            return ends
                .try_for_each(|(ray, entry)| self.add_entry::<E>(entry.read(), ray, &log.grids, failures));
        }
        rays.clone().step_by(BLOCK).try_for_each(|start| {
            let block = start..(start + BLOCK).min(rays.end);
            self.add_block(entries, block, stride, &log.grids, failures)
        })
    }

    /// Adds the entries of some rays, row by row, as they lie in memory.
    fn add_block<E: Entry>(
        &mut self,
        entries: &[E],
        rays: Range<usize>,
        stride: usize,
        grids: &[Grid],
        failures: &mut Vec<GuardFailure>,
    ) -> Option<()> {
        let mut rows = entries.get(rays.start..)?.chunks(stride);
        let mut unended = u64::MAX >> (BLOCK - rays.len());
        while unended != 0 {
            let row = rows.next()?;
            for ray in bits(std::mem::take(&mut unended)) {
                let end = row.get(ray)?.read();
                unended |= u64::from(end.what & PASSES != 0) << ray;
                self.add_entry::<E>(end, rays.start + ray, grids, failures)?;
            }
        }
        Some(())
    }

    #[inline(always)]
    fn add_entry<E: Entry>(
        &mut self,
        end: End<E::Real>,
        ray: usize,
        grids: &[Grid],
        failures: &mut Vec<GuardFailure>,
    ) -> Option<()> {
        if end.what & IN_TAPS != 0 {
            return self.add_taps_of(end, grid_of(grids, end.what)?);
        }
        self.add_end(end, ray, failures, E::IS_COUNTED)
    }

    /// An end in one cell, or none. `is_counted`: sums follow from counts.
    #[inline(always)]
    fn add_end<T: Real>(
        &mut self,
        end: End<T>,
        ray: usize,
        failures: &mut Vec<GuardFailure>,
        is_counted: bool,
    ) -> Option<()> {
        if end.what & GUARD_FAILED != 0 {
            failures.push(GuardFailure { ray: ray as u32, event: end.what & CELL_MASK });
        }
        self.add_count(end.what)?;
        if is_counted || end.what & IN_CELL == 0 {
            return Some(());
        }
        let quanta = self.quanta_of(end.weight.into())?;
        self.quanta.add((end.what & CELL_MASK) as usize, quanta)
    }

    /// Adds rays whose entries are positions on a grid.
    fn add_positions<E: PositionEntry>(
        &mut self,
        logged: &LoggedRays,
        grid: &Grid,
        failures: &mut Vec<GuardFailure>,
    ) -> Option<()> {
        let entries: &[E] = entries_of(logged.bytes)?;
        let born = E::Real::nearest(logged.weight);
        let mut block = Block::new();
        let mut first = logged.rays.start;
        for entries in entries.get(logged.rays.clone())?.chunks(BLOCK) {
            block.lay_out(entries, &[born], grid);
            let all = u64::MAX >> (BLOCK - entries.len());
            self.add_laid_out(&block, all & !block.others, 1, grid)?;
            bits(all & block.others)
                .try_for_each(|i| self.add_other(&entries[i], born, first + i, grid, failures))?;
            first += entries.len();
        }
        Some(())
    }

    /// What some rays of a block, a bit each, leave in so many arrivals.
    pub(crate) fn add_laid_out<T>(
        &mut self,
        block: &Block<T>,
        rays: u64,
        arrivals: u64,
        grid: &Grid,
    ) -> Option<()> {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi1") {
            // SAFETY: the processor has what the function is compiled for.
            #[allow(unsafe_code)]
            return unsafe { self.add_laid_out_in_avx2(block, rays, arrivals, grid) };
        }
        self.add_laid_out_inline(block, rays, arrivals, grid)
    }

    /// The same in vectors of 256 bits, which hold the taps of a ray.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi1")]
    fn add_laid_out_in_avx2<T>(
        &mut self,
        block: &Block<T>,
        rays: u64,
        arrivals: u64,
        grid: &Grid,
    ) -> Option<()> {
        self.add_laid_out_inline(block, rays, arrivals, grid)
    }

    #[inline(always)]
    fn add_laid_out_inline<T>(
        &mut self,
        block: &Block<T>,
        rays: u64,
        arrivals: u64,
        grid: &Grid,
    ) -> Option<()> {
        let at = self.corners.iter().position(|corners| corners.are_of(grid)).unwrap_or_else(|| {
            self.corners.push(CornerSums::new(*grid));
            self.corners.len() - 1
        });
        let corners = &mut self.corners[at];
        for ray in bits(rays) {
            let (corner, quanta) = (block.corners[ray], block.quanta[ray]);
            *self.counts.get_mut(block.hits[ray] as usize)? += arrivals;
            if corners.add(corner, quanta)? {
                corners.carries(corner, quanta).try_for_each(|cell| self.quanta.carry(cell))?;
            }
        }
        Some(())
    }

    /// Adds an entry that is no position, or a position with any weight.
    fn add_other<E: PositionEntry>(
        &mut self,
        entry: &E,
        born: E::Real,
        ray: usize,
        grid: &Grid,
        failures: &mut Vec<GuardFailure>,
    ) -> Option<()> {
        let position = entry.position();
        if position[0].is_off_detectors() {
            return self.add_end(entry.end(born), ray, failures, false);
        }
        self.add_position(position, entry.weight(born), grid)
    }

    /// A position with any weight.
    pub(crate) fn add_position<T: Real>(&mut self, position: [T; 2], weight: T, grid: &Grid) -> Option<()> {
        let taps = PositionTaps::of(position, grid);
        let cells = taps.cells.map(|cell| cell as usize);
        let add = || self.add_taps(cells, taps.hit as usize, weight, taps.fractions);
        taps.is_number.then(add)?
    }

    /// The same weight so many times in one cell.
    pub(crate) fn add_to_cell(&mut self, cell: usize, weight: f64, num: u64) -> Option<()> {
        *self.counts.get_mut(cell)? += num;
        match quantize(weight) {
            Some(quanta) => self.quanta.add(cell, quanta.checked_mul(num.into())?),
            None => {
                *self.counts.get_mut(INVALID_DEPOSITS)? += num;
                Some(())
            }
        }
    }

    /// So many events, that took so much together.
    pub(crate) fn add_losses(&mut self, cell: usize, events: u64, quanta: u128) -> Option<()> {
        *self.counts.get_mut(cell)? += events;
        self.quanta.add(cell, quanta)
    }

    #[inline(always)]
    fn add_count(&mut self, end: u32) -> Option<()> {
        if end & WITHOUT_POSITION != 0 {
            *self.counts.get_mut(INVALID_DEPOSITS)? += 1;
        }
        if end & IN_CELL != 0 {
            *self.counts.get_mut((end & CELL_MASK) as usize)? += 1;
        }
        Some(())
    }

    /// The taps of an end whose bits say which taps these are.
    #[inline(always)]
    fn add_taps_of<T: Real>(&mut self, end: End<T>, grid: &Grid) -> Option<()> {
        let first = (end.what & CELL_MASK) as usize;
        let column = if end.what & NEXT_COLUMN != 0 { grid.column } else { 0 };
        let row = if end.what & NEXT_ROW != 0 { grid.row } else { 0 };
        let cells = [first, first + column, first + row, first + column + row];
        let hit_column = if end.what & HIT_NEXT_COLUMN != 0 { column } else { 0 };
        let hit_row = if end.what & HIT_NEXT_ROW != 0 { row } else { 0 };
        self.add_taps(cells, first + hit_column + hit_row, end.weight, end.fractions)
    }

    /// Shares a weight among taps: the last one takes what the others left (`deposit_taps` in splat.wgsl).
    #[inline(always)]
    fn add_taps<T: Real>(
        &mut self,
        cells: [usize; 4],
        hit: usize,
        weight: T,
        fractions: [T; 2],
    ) -> Option<()> {
        *self.counts.get_mut(hit)? += 1;
        let parts = T::parts(fractions);
        let (quanta, is_small) = T::quanta::<false>(weight, parts);
        if is_small && fractions.iter().all(|fraction| fraction.is_at_most_one()) {
            let mut taps = cells.iter().zip(quanta);
            return taps.try_for_each(|(&cell, quanta)| self.quanta.add_low(cell, quanta));
        }
        let shares = T::first_shares(weight, parts);
        self.add_shares(cells, weight.into(), shares.map(Into::into))
    }

    /// Taps of any weight.
    #[cold]
    fn add_shares(&mut self, cells: [usize; 4], weight: f64, shares: [f64; 3]) -> Option<()> {
        let mut rest = self.quanta_of(weight)?;
        for (&cell, share) in cells.iter().zip(shares) {
            let taken = quantize(share).unwrap_or(0).min(rest);
            rest -= taken;
            self.quanta.add(cell, taken)?;
        }
        self.quanta.add(cells[3], rest)
    }

    /// Quanta of a weight. A weight that no sum can hold is counted as invalid, and has 0 quanta.
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
        *self.high.get_mut(cell)? += (quanta >> 64) as u64;
        self.add_low(cell, quanta as u64)
    }

    #[inline]
    fn add_low(&mut self, cell: usize, quanta: u64) -> Option<()> {
        let low = self.low.get_mut(cell)?;
        let (sum, carries) = low.overflowing_add(quanta);
        *low = sum;
        if carries { self.carry(cell) } else { Some(()) }
    }

    fn carry(&mut self, cell: usize) -> Option<()> {
        *self.high.get_mut(cell)? += 1;
        Some(())
    }
}

/// The detector that has the end's cell.
#[inline]
fn grid_of(grids: &[Grid], end: u32) -> Option<&Grid> {
    let cell = (end & CELL_MASK) as usize;
    match grids {
        [grid] => Some(grid),
        _ => grids.get(grids.partition_point(|grid| grid.first <= cell).checked_sub(1)?),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::log::reals::{HIT_NEXT, OFF_DETECTORS};
    use crate::engine::sums::QUANTA_PER_UNIT;
    use bytemuck::cast_slice;

    const UNIT: u128 = QUANTA_PER_UNIT;

    /// Three columns and two rows behind the counter of invalid deposits.
    const GRID: Grid = Grid { first: 1, column: 1, row: 3, size: [3, 2] };

    fn logged(bytes: &[u8], num: usize) -> LoggedRays<'_> {
        LoggedRays { bytes, rays: 0..num, stride: num, weight: 0.0 }
    }

    fn log(format: EntryFormat, max_passes: u32) -> DepositLog {
        let taps = if format == EntryFormat::Counts { LoggedTaps::None } else { LoggedTaps::Fractions };
        DepositLog { format, taps, max_passes, grids: vec![GRID], weights: vec![] }
    }

    /// A map of three columns and two rows behind the counter of invalid deposits.
    fn sums() -> DepositSums {
        DepositSums::of_num(7)
    }

    fn quanta(sums: &DepositSums) -> Vec<u128> {
        sums.quanta().collect()
    }

    #[test]
    fn taps_share_the_weight_in_every_form() {
        let what = IN_TAPS | NEXT_COLUMN | NEXT_ROW | HIT_NEXT_ROW | 2;
        let (weight, x, y) = (1.0_f32, 0.25_f32, 0.5_f32);
        let [weight_bits, x_bits, y_bits] = [weight, x, y].map(f32::to_bits);
        let joined = |low: u32, high: u32| u64::from(low) | u64::from(high) << 32;
        let packed = [joined(what, weight_bits), joined(x_bits, y_bits)];
        let reals = [f64::from(what), f64::from(weight), f64::from(x), f64::from(y)];
        for (format, bytes) in
            [(EntryFormat::Packed, cast_slice::<u64, u8>(&packed)), (EntryFormat::Reals, cast_slice(&reals))]
        {
            let mut sums = sums();
            assert_eq!(sums.add(&logged(bytes, 1), &log(format, 0), &mut Vec::new()), Some(()), "{format:?}");
            let shares = [0, 0, UNIT * 3 / 8, UNIT / 8, 0, UNIT * 3 / 8, UNIT / 8];
            assert_eq!(quanta(&sums), shares, "{format:?}");
            assert_eq!(sums.counts, [0, 0, 0, 0, 0, 1, 0], "{format:?}");
        }
    }

    /// A log of positions on the map.
    fn position_log(format: EntryFormat, has_weights: bool) -> DepositLog {
        DepositLog { taps: LoggedTaps::Positions { grid: GRID, has_weights }, ..log(format, 0) }
    }

    /// What a log of positions adds up to, of rays that were born with a weight of 2 and lost nothing.
    fn sums_of_positions(
        format: EntryFormat,
        has_weights: bool,
        positions: &[[f64; 2]],
    ) -> Option<DepositSums> {
        let reals = |place: &[f64; 2]| [place[0], place[1], 2.0];
        let words = |place: &[f64; 2]| reals(place).map(|real| (real as f32).to_bits());
        let num = if has_weights { 3 } else { 2 };
        let bytes: Vec<u8> = match format {
            EntryFormat::Reals => {
                positions.iter().flat_map(|p| cast_slice::<f64, u8>(&reals(p)[..num]).to_vec()).collect()
            }
            EntryFormat::Packed if has_weights => positions
                .iter()
                .flat_map(|p| words(p).into_iter().chain([0]).flat_map(u32::to_le_bytes).collect::<Vec<_>>())
                .collect(),
            EntryFormat::Counts | EntryFormat::Packed => {
                positions.iter().flat_map(|p| cast_slice::<u32, u8>(&words(p)[..num]).to_vec()).collect()
            }
        };
        let mut aligned = vec![0_f64; bytes.len().div_ceil(8)];
        bytemuck::cast_slice_mut::<f64, u8>(&mut aligned)[..bytes.len()].copy_from_slice(&bytes);
        let mut sums = sums();
        let bytes = &cast_slice(&aligned)[..bytes.len()];
        let logged = LoggedRays { weight: 2.0, ..logged(bytes, positions.len()) };
        sums.add(&logged, &position_log(format, has_weights), &mut Vec::new())?;
        sums.add_corners().map(|()| sums)
    }

    #[test]
    fn positions_share_the_weight_in_every_form() {
        // Four places. First, between two columns and two rows, where the pixel that was hit lies behind. Then the
        // middle of a pixel, before the first pixel, and behind the last.
        let places = [[0.75 * HIT_NEXT, 0.5], [2.0, 1.0], [-0.25, -0.5], [2.25, 1.25]];
        // One more than two blocks.
        let many: Vec<[f64; 2]> = places.iter().copied().cycle().take(129).collect();
        for (format, has_weights) in
            [EntryFormat::Packed, EntryFormat::Reals].map(|f| [(f, false), (f, true)]).concat()
        {
            let sums = sums_of_positions(format, has_weights, &many).unwrap();
            let [between, others] = [33, 32];
            let first = UNIT / 4 * between + 2 * UNIT * others;
            let last = 4 * UNIT * others;
            let second = UNIT * 3 / 4 * between;
            let expected = [0, first, second, 0, UNIT / 4 * between, second, last];
            assert_eq!(quanta(&sums), expected, "{format:?}, {has_weights}");
            assert_eq!(sums.counts, [0, 32, 33, 0, 0, 0, 64], "{format:?}, {has_weights}");
        }
    }

    /// As rounding may put them far from the scene's centre.
    #[test]
    fn positions_beyond_the_map_fall_into_its_edge_pixels() {
        for (format, has_weights) in
            [(EntryFormat::Packed, false), (EntryFormat::Packed, true), (EntryFormat::Reals, false)]
        {
            for (place, expected) in [
                ([-1.0, 0.5], [UNIT, 0, 0, UNIT, 0, 0]),
                ([OFF_DETECTORS, 0.5], [UNIT, 0, 0, UNIT, 0, 0]),
                ([3.75, 0.5], [0, 0, UNIT, 0, 0, UNIT]),
                ([1e30, -7.5], [0, 0, 2 * UNIT, 0, 0, 0]),
                ([-1e30, 1e12], [0, 0, 0, 2 * UNIT, 0, 0]),
            ] {
                // The hit is the next pixel, which is the same.
                let sums = sums_of_positions(format, has_weights, &[place.map(|at| at * HIT_NEXT)]).unwrap();
                assert_eq!(quanta(&sums)[1..], expected, "{format:?}, {place:?}");
                assert_eq!(sums.counts.iter().sum::<u64>(), 1);
            }
            assert!(sums_of_positions(format, has_weights, &[[0.0, f64::NAN]]).is_none(), "{format:?}");
        }
    }

    #[test]
    fn sums_at_corners_carry_each_by_itself() {
        // Of 2^62 quanta, three quarters lie in the first tap, whose sum loses two carries. The sum of the second tap
        // loses none.
        let (large, num) = (1024.0, 15);
        let left = vec![[0.25, 0.0, large]; num];
        // Two corners that share a pixel: only together do their sums lose a carry.
        let shared = [vec![[1.0, 0.0, large]; 3], vec![[1.0, -0.25, large]; 3]].concat();
        let all = |num: u128| num * 1024 * UNIT;
        for (entries, expected) in [(left, [all(15) / 4 * 3, all(15) / 4, 0]), (shared, [0, all(6), 0])] {
            let mut sums = sums();
            let logged = logged(cast_slice(&entries), entries.len());
            assert_eq!(sums.add(&logged, &position_log(EntryFormat::Reals, true), &mut Vec::new()), Some(()));
            sums.add_corners().unwrap();
            assert_eq!(quanta(&sums)[1..4], expected);
        }
    }

    #[test]
    fn what_is_no_position_ends_as_it_says() {
        let off = OFF_DETECTORS;
        let bits = |what: u32| f64::from(f32::from_bits(what));
        for (format, end) in
            [(EntryFormat::Packed, bits(IN_CELL | 3)), (EntryFormat::Reals, f64::from(IN_CELL | 3))]
        {
            let sums = sums_of_positions(format, false, &[[off, end], [off, end]]).unwrap();
            assert_eq!(quanta(&sums), [0, 0, 0, 4 * UNIT, 0, 0, 0], "{format:?}");
            assert_eq!(sums.counts, [0, 0, 0, 2, 0, 0, 0], "{format:?}");
        }
    }

    #[test]
    fn positions_of_large_weights_are_shared_like_those_of_the_device() {
        let large = 2.0_f64.powi(20);
        let mut sums = sums();
        let entries = [[0.5, 0.0, large], [0.5, 0.0, f64::NAN]];
        let logged = logged(cast_slice(&entries), 2);
        assert_eq!(sums.add(&logged, &position_log(EntryFormat::Reals, true), &mut Vec::new()), Some(()));
        sums.add_corners().unwrap();
        assert_eq!(quanta(&sums)[1..3], [UNIT << 19, UNIT << 19]);
        assert_eq!(sums.counts, [1, 2, 0, 0, 0, 0, 0], "a deposit that no sum can hold");
    }

    #[test]
    fn failed_rays_are_reported_and_add_nothing_in_every_form() {
        let whats = [GUARD_FAILED, IN_CELL | 2, GUARD_FAILED | 7];
        let counts = whats;
        let packed = whats.map(|what| [u64::from(what), 0]);
        let reals = whats.map(|what| [f64::from(what), 0.0, 0.0, 0.0]);
        for (format, bytes) in [
            (EntryFormat::Counts, cast_slice::<u32, u8>(&counts)),
            (EntryFormat::Packed, cast_slice(&packed)),
            (EntryFormat::Reals, cast_slice(&reals)),
        ] {
            let (mut sums, mut failures) = (sums(), Vec::new());
            assert_eq!(sums.add(&logged(bytes, 3), &log(format, 0), &mut failures), Some(()), "{format:?}");
            assert_eq!(
                failures,
                [GuardFailure { ray: 0, event: 0 }, GuardFailure { ray: 2, event: 7 }],
                "{format:?}"
            );
            assert_eq!(sums.counts, [0, 0, 1, 0, 0, 0, 0], "{format:?}");
        }
    }

    #[test]
    fn taps_of_large_weights_and_of_no_number_are_those_of_the_device() {
        let what = f64::from(IN_TAPS | NEXT_COLUMN | 1);
        let large = 2.0_f64.powi(20);
        let entries = [[what, large, 0.5, 0.0], [what, f64::NAN, 0.5, 0.0], [what, -1.0, 0.5, 0.0]];
        let mut sums = sums();
        assert_eq!(
            sums.add(&logged(cast_slice(&entries), 3), &log(EntryFormat::Reals, 0), &mut Vec::new()),
            Some(())
        );
        assert_eq!(quanta(&sums)[1..3], [UNIT << 19, UNIT << 19]);
        assert_eq!(sums.counts, [2, 3, 0, 0, 0, 0, 0], "two deposits that no sum can hold");
    }

    /// Of 100 rays, ray r passes r % 4 times.
    #[test]
    fn a_ray_ends_with_the_first_entry_that_does_not_pass() {
        let (num, stride) = (100, 104);
        let mut entries = vec![IN_CELL | PASSES | 3; 5 * stride];
        for ray in 0..num {
            let passes = ray % 4;
            (0..passes).for_each(|row| entries[row * stride + ray] = IN_CELL | PASSES | 1);
            entries[passes * stride + ray] = IN_CELL | 2;
        }
        let mut whole = sums();
        let logged = LoggedRays { bytes: cast_slice(&entries), rays: 0..num, stride, weight: 0.0 };
        assert_eq!(whole.add(&logged, &log(EntryFormat::Counts, 4), &mut Vec::new()), Some(()));
        assert_eq!(whole.counts, [0, 150, 100, 0, 0, 0, 0]);
        let cut = LoggedRays { bytes: cast_slice(&entries[..2 * stride]), ..logged.clone() };
        assert_eq!(
            sums().add(&cut, &log(EntryFormat::Counts, 4), &mut Vec::new()),
            None,
            "the log ends before the ray does"
        );
    }

    #[test]
    fn a_cell_that_does_not_exist_is_refused() {
        let entries = [IN_CELL | 7];
        assert_eq!(
            sums().add(&logged(cast_slice(&entries), 1), &log(EntryFormat::Counts, 0), &mut Vec::new()),
            None
        );
    }
}
