//! Adds the device's counters and sums to their places in a tally, one number at a time. A large map with few lit cells
//! then takes time and memory for these cells alone.

use crate::program::Cells;
use crate::program::layout::tables::{LEDGER_CELLS, LedgerCell, MomentCells, ReachedMarks};
use crate::result::{FluxSum, Moments, Tally};

/// From this sum on, some cell of squares may have overflowed (shaders/sums/moments.on.wgsl).
const LARGE_SQUARES_LIMIT: u128 = 1 << 64;

/// What counts determine, beside themselves.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Counted {
    /// The quanta of each event, where all rays keep the weight with which they are born.
    pub quanta: Option<u128>,
    /// The square of the flux of each hit, where second moments follow from hits.
    pub square: Option<u128>,
}

/// Adds counters and sums to a tally. A number may come several times, in parts that add up.
pub(crate) struct Readback<'a> {
    layout: Layout<'a>,
    counted: Counted,
    tally: &'a mut Tally,
    /// Numbers that belong to no detector's cell ([`Owner::Other`]).
    counters: Vec<u64>,
    sums: Vec<u128>,
    /// Copies of the detectors' cells hold tangents.
    has_tangents: bool,
}

/// To what a counter or a sum belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Owner {
    /// A cell of a detector, in one of the copies.
    Cell { detector: usize, cell: usize, copy: usize },
    /// Anything else, numbered as if the detectors had no cells.
    Other(usize),
}

/// How the cells of detectors lie: in copies of all cells, one after the other.
#[derive(Debug, Clone, Copy)]
struct Layout<'a> {
    cells: &'a Cells,
    first: usize,
    /// The distance from a cell to its next copy.
    stride: usize,
    /// The number of copies that hold quanta. Where there are squares, the sums have one more copy.
    copies: usize,
}

impl<'a> Layout<'a> {
    fn of(cells: &'a Cells) -> Self {
        let first = cells.detectors.first().copied().unwrap_or(cells.num_cells);
        let (stride, copies) = cells.replicates.map_or((cells.num_cells - first, 1), |r| (r.stride, r.num));
        Layout { cells, first: first as usize, stride: stride as usize, copies: copies as usize }
    }

    fn copies_of_sums(&self) -> usize {
        self.copies + usize::from(self.cells.moments.is_some())
    }

    fn place(&self, index: usize, copies: usize) -> Owner {
        let Some(behind) = index.checked_sub(self.first) else { return Owner::Other(index) };
        if behind >= copies * self.stride {
            return Owner::Other(index - copies * self.stride);
        }
        let (copy, within) = (behind / self.stride, behind % self.stride);
        let starts_before = |&start: &u32| start as usize <= self.first + within;
        let detector = self.cells.detectors.partition_point(starts_before) - 1;
        Owner::Cell { detector, cell: self.first + within - self.cells.detectors[detector] as usize, copy }
    }

    /// The number of a counter that belongs to no detector's cell.
    fn other_counter(&self, index: u32) -> usize {
        index as usize - self.copies * self.stride
    }

    fn other_sum(&self, index: u32) -> usize {
        index as usize - self.copies_of_sums() * self.stride
    }
}

impl<'a> Readback<'a> {
    /// A readback for a tally in the scene's shape. The tally may lack moments.
    pub fn new(cells: &'a Cells, counted: Counted, num_sources: usize, tally: &'a mut Tally) -> Self {
        let layout = Layout::of(cells);
        for detector in &mut tally.detectors {
            let num_cells = detector.quanta.len();
            if counted.square.is_some() || cells.moments.is_some() {
                grow(&mut detector.squares, num_cells);
                let by_source = cells.moments.is_some_and(|moments| moments.totals.is_some());
                grow(&mut detector.totals, if by_source { num_sources } else { 1 });
            }
            if cells.replicates.is_some_and(|copies| !copies.are_tangents) {
                grow(&mut detector.replicates, layout.copies * num_cells.max(1));
            }
        }
        let has_tangents = cells.replicates.is_some_and(|copies| copies.are_tangents);
        if has_tangents {
            for detector in &mut tally.detectors {
                let num = layout.copies / 2 * detector.quanta.len().max(1);
                grow(&mut detector.tangents, num);
            }
        }
        let counters = vec![0; layout.other_counter(cells.num_counters)];
        let sums = vec![0; layout.other_sum(cells.num_sums)];
        Readback { layout, counted, tally, counters, sums, has_tangents }
    }

    /// Adds to a counter.
    pub fn count(&mut self, counter: usize, count: u64) {
        match self.layout.place(counter, self.layout.copies) {
            Owner::Cell { detector, copy: 1.., .. } if self.has_tangents => {
                self.tally.detectors[detector].lost_tangents += count;
            }
            Owner::Cell { detector, cell, .. } => {
                let detector = &mut self.tally.detectors[detector];
                *detector.hits.get_mut(cell).unwrap_or(&mut detector.recorded.count) += count;
                if let Some(square) = self.counted.square {
                    let squares = u128::from(count) * square;
                    detector.squares.get_mut(cell).into_iter().for_each(|sum| *sum += squares);
                    detector.totals[0].squares += squares;
                }
            }
            Owner::Other(number) => self.counters[number] += count,
        }
        if let Some(quanta) = self.counted.quanta.filter(|_| counter < self.layout.cells.num_cells as usize) {
            self.sum(counter, u128::from(count) * quanta);
        }
    }

    /// Adds to a sum.
    pub fn sum(&mut self, index: usize, value: u128) {
        let holds_total = self.cells_hold_totals();
        match self.layout.place(index, self.layout.copies_of_sums()) {
            Owner::Cell { detector, cell, copy } if copy == self.layout.copies => {
                let detector = &mut self.tally.detectors[detector];
                detector.squares.get_mut(cell).into_iter().for_each(|sum| *sum += value);
                if holds_total {
                    detector.totals[0].squares += value;
                }
            }
            Owner::Cell { detector, cell, copy: copy @ 1.. } if self.has_tangents => {
                let detector = &mut self.tally.detectors[detector];
                let num_cells = detector.quanta.len().max(1);
                let sign = if copy % 2 == 1 { 1 } else { -1 };
                detector.tangents[(copy - 1) / 2 * num_cells + cell] += sign * value as i128;
            }
            Owner::Cell { detector, cell, copy } => {
                let detector = &mut self.tally.detectors[detector];
                let num_cells = detector.quanta.len().max(1);
                *detector.quanta.get_mut(cell).unwrap_or(&mut detector.recorded.quanta) += value;
                if holds_total {
                    detector.totals[0].quanta += value;
                }
                if !detector.replicates.is_empty() {
                    detector.replicates[copy * num_cells + cell] += value;
                }
            }
            Owner::Other(number) => self.sums[number] += value,
        }
    }

    /// True if a detector's moments are the sums over its cells.
    fn cells_hold_totals(&self) -> bool {
        match self.layout.cells.moments {
            Some(MomentCells { totals, .. }) => totals.is_none(),
            None => self.counted.square.is_some(),
        }
    }

    /// Adds the numbers that belong to no detector's cell.
    pub fn finish(self, marks: ReachedMarks) {
        let Readback { layout, tally, counters, sums, .. } = self;
        let flux_sum = |cell: usize| FluxSum { count: counters[cell], quanta: sums[cell] };
        for (cell, _) in LEDGER_CELLS {
            let found = flux_sum(cell as usize);
            match cell {
                LedgerCell::Invalid => tally.invalid_deposits += found.count,
                LedgerCell::Underflows => tally.medium_stack_underflows += found.count,
                LedgerCell::RouletteGain => tally.roulette_gain += found,
                LedgerCell::Bulk => tally.bulk += found,
                LedgerCell::ImportanceLoss => tally.importance_loss += found,
                LedgerCell::ImportanceGain => tally.importance_gain += found,
                LedgerCell::Escaped => tally.escaped += found,
                LedgerCell::DepthKilled => tally.depth_killed += found,
                LedgerCell::RouletteKilled => tally.roulette_loss += found,
                LedgerCell::Coating => tally.coating += found,
                LedgerCell::Bsdf => tally.bsdf_loss += found,
                LedgerCell::BsdfGain => tally.bsdf_gain += found,
            }
        }
        let reached = layout.other_counter(layout.cells.reached);
        for (i, surface) in tally.surfaces.iter_mut().enumerate() {
            let absorbed = flux_sum(layout.cells.surfaces as usize + i);
            surface.reached |= match marks {
                ReachedMarks::None => absorbed.count != 0,
                ReachedMarks::Bits => counters[reached] >> i & 1 != 0,
                ReachedMarks::Counters => counters[reached + i] != 0,
            };
            surface.absorbed += absorbed;
        }
        if let Some(first) = layout.cells.wrong_sides {
            let counts = &counters[layout.other_counter(first)..];
            let (entered, ended) = counts.split_at(tally.surfaces.len());
            let (on_surfaces, on_detectors) = ended.split_at(tally.surfaces.len());
            for (surface, (entered, ended)) in tally.surfaces.iter_mut().zip(entered.iter().zip(on_surfaces))
            {
                surface.entered_twice += entered;
                surface.ended_inside += ended;
            }
            tally
                .detectors
                .iter_mut()
                .zip(on_detectors)
                .for_each(|(detector, ended)| detector.ended_inside += ended);
        }
        let saturated = layout.cells.saturated.map(|counter| layout.other_counter(counter));
        tally.split_budget_saturated |= saturated.is_some_and(|counter| counters[counter] != 0);
        if let Some(filtered) = layout.cells.filtered {
            tally.filtered_out += flux_sum(filtered as usize);
        }
        let Some(moments) = layout.cells.moments else { return };
        tally.moments_overflowed |= sums[layout.other_sum(moments.large_squares)] >= LARGE_SQUARES_LIMIT;
        let Some(totals) = moments.totals else { return };
        let pairs = sums[layout.other_sum(totals)..].chunks_exact(2);
        let by_source = tally.detectors.iter_mut().flat_map(|detector| &mut detector.totals);
        by_source.zip(pairs).for_each(|(sum, pair)| *sum += Moments { quanta: pair[0], squares: pair[1] });
    }
}

/// Lengthens a table with zeros.
fn grow<T: Clone + Default>(table: &mut Vec<T>, length: usize) {
    if table.is_empty() {
        // The system gives zeroed memory, which is then not written to.
        *table = vec![T::default(); length];
    }
    table.resize(length.max(table.len()), T::default());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::result::DetectorTally;

    /// A ledger of twelve bins, one surface, a map of three cells and a ray database.
    fn cells() -> Cells {
        Cells {
            surfaces: 12,
            detectors: vec![13, 16],
            num_cells: 17,
            reached: 17,
            filtered: None,
            saturated: Some(20),
            wrong_sides: None,
            num_counters: 21,
            moments: None,
            replicates: None,
            num_sums: 17,
        }
    }

    fn tally() -> Tally {
        let map = DetectorTally { quanta: vec![0; 3], hits: vec![0; 3], ..DetectorTally::default() };
        Tally {
            detectors: vec![map, DetectorTally::default()],
            surfaces: vec![Default::default()],
            ..Tally::default()
        }
    }

    const NOTHING: Counted = Counted { quanta: None, square: None };

    #[test]
    fn every_number_finds_its_place() {
        let (cells, mut tally) = (cells(), tally());
        let mut readback = Readback::new(&cells, NOTHING, 1, &mut tally);
        (0..21).for_each(|i| readback.count(i, 100 + i as u64));
        (0..17).for_each(|i| readback.sum(i, 1000 + i as u128));
        readback.finish(ReachedMarks::Counters);
        assert_eq!((tally.invalid_deposits, tally.medium_stack_underflows), (100, 101));
        assert_eq!(tally.bsdf_gain, FluxSum { count: 111, quanta: 1011 });
        assert_eq!(tally.surfaces[0].absorbed, FluxSum { count: 112, quanta: 1012 });
        assert!(tally.surfaces[0].reached && tally.split_budget_saturated);
        assert_eq!(tally.detectors[0].hits, [113, 114, 115]);
        assert_eq!(tally.detectors[0].quanta, [1013, 1014, 1015]);
        assert_eq!(tally.detectors[1].recorded, FluxSum { count: 116, quanta: 1016 });
    }

    #[test]
    fn absorbing_surfaces_count_as_reached_where_rays_end() {
        let cells = Cells {
            detectors: vec![14, 17],
            num_cells: 18,
            reached: 18,
            saturated: None,
            num_counters: 22,
            num_sums: 18,
            ..cells()
        };
        let mut tally = tally();
        tally.surfaces.push(Default::default());
        let mut readback = Readback::new(&cells, NOTHING, 1, &mut tally);
        readback.count(13, 3);
        readback.finish(ReachedMarks::None);
        let reached: Vec<bool> = tally.surfaces.iter().map(|surface| surface.reached).collect();
        assert_eq!(reached, [false, true]);
    }

    #[test]
    fn squares_and_totals_lie_behind_the_cells() {
        let moments = Some(MomentCells { squares_offset: 4, totals: Some(21), large_squares: 25 });
        let (cells, mut tally) = (Cells { moments, num_sums: 26, ..cells() }, tally());
        let mut readback = Readback::new(&cells, NOTHING, 1, &mut tally);
        (13..26).for_each(|i| readback.sum(i, i as u128));
        readback.finish(ReachedMarks::Counters);
        assert_eq!(
            (&tally.detectors[0].quanta[..], &tally.detectors[0].squares[..]),
            (&[13, 14, 15][..], &[17, 18, 19][..])
        );
        assert_eq!(tally.detectors[0].totals, [Moments { quanta: 21, squares: 22 }]);
        assert_eq!(tally.detectors[1].totals, [Moments { quanta: 23, squares: 24 }]);
        assert!(!tally.moments_overflowed);
    }

    #[test]
    fn moments_follow_from_hits() {
        let (cells, mut tally) = (cells(), tally());
        let counted = Counted { quanta: Some(10), square: Some(7) };
        let mut readback = Readback::new(&cells, counted, 1, &mut tally);
        [(6, 5), (14, 2), (16, 3), (17, 1)].into_iter().for_each(|(i, count)| readback.count(i, count));
        readback.finish(ReachedMarks::Bits);
        assert_eq!(tally.escaped, FluxSum { count: 5, quanta: 50 });
        assert_eq!(
            (&tally.detectors[0].quanta[..], &tally.detectors[0].squares[..]),
            (&[0, 20, 0][..], &[0, 14, 0][..])
        );
        assert_eq!(tally.detectors[0].totals, [Moments { quanta: 20, squares: 14 }]);
        assert_eq!(tally.detectors[1].totals, [Moments { quanta: 30, squares: 21 }]);
    }

    #[test]
    fn each_scramble_has_its_copy() {
        let replicates =
            Some(crate::program::layout::tables::ReplicateCells { stride: 4, num: 2, are_tangents: false });
        let (cells, mut tally) = (
            Cells {
                replicates,
                num_cells: 21,
                reached: 21,
                saturated: None,
                num_counters: 24,
                num_sums: 21,
                ..cells()
            },
            tally(),
        );
        let mut readback = Readback::new(&cells, NOTHING, 1, &mut tally);
        (13..21).for_each(|i| readback.sum(i, i as u128));
        (13..22).for_each(|i| readback.count(i, i as u64));
        readback.finish(ReachedMarks::Counters);
        assert_eq!(tally.detectors[0].replicates, [13, 14, 15, 17, 18, 19]);
        assert_eq!(tally.detectors[0].quanta, [30, 32, 34]);
        assert_eq!(tally.detectors[1].replicates, [16, 20]);
        assert_eq!(tally.detectors[1].recorded, FluxSum { count: 36, quanta: 36 });
        assert!(tally.surfaces[0].reached);
    }

    #[test]
    fn tangents_have_a_sign_and_leave_the_sums_alone() {
        let replicates =
            Some(crate::program::layout::tables::ReplicateCells { stride: 4, num: 3, are_tangents: true });
        let (cells, mut tally) = (
            Cells {
                replicates,
                num_cells: 25,
                reached: 25,
                saturated: None,
                num_counters: 28,
                num_sums: 25,
                ..cells()
            },
            tally(),
        );
        for _ in 0..2 {
            let mut readback = Readback::new(&cells, NOTHING, 1, &mut tally);
            [(13, 5), (18, 4), (22, 7), (20, 7)]
                .into_iter()
                .for_each(|(cell, value)| readback.sum(cell, value));
            readback.count(19, 2);
            readback.finish(ReachedMarks::Counters);
        }
        let map = &tally.detectors[0];
        assert_eq!((&map.quanta[..], &map.tangents[..]), (&[10, 0, 0][..], &[0, -6, 0][..]));
        assert_eq!((tally.detectors[1].recorded.quanta, &tally.detectors[1].tangents[..]), (0, &[14][..]));
        assert_eq!(tally.detectors[0].lost_tangents, 4);
    }
}
