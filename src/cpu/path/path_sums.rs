//! Adds up what rays on a path logged (`shaders/cpu/path/path_log.arrivals.wgsl`): places on detectors. The path gives
//! the weights, or rays log their own.

use crate::cpu::log::bits::{bits, entries_of, quantize};
use crate::cpu::log::deposit_sums::{DepositSums, GuardFailure, LoggedRays};
use crate::cpu::log::format::{EntryFormat, Grid};
use crate::cpu::log::positions::{BLOCK, Block, PositionEntry};
use crate::cpu::log::reals::Real;
use crate::cpu::path::path_log::{PathLog, Place, Weight};
use crate::program::layout::tables::LedgerCell;

/// A place, and what each ray leaves there.
struct Deposits<'a, T> {
    grid: &'a Grid,
    /// A weight for each time that rays arrive. Where rays log their own, the most that they weigh.
    weights: Vec<T>,
    /// Their quanta together fit 63 bits, however the sum of the weights was rounded.
    fit: bool,
}

impl DepositSums {
    /// Adds what the rays of a dispatch logged, and shows the rays that failed a guard, by their number. `None` if an
    /// entry makes no sense.
    pub fn add_path(
        &mut self,
        logged: &LoggedRays,
        format: EntryFormat,
        log: &PathLog,
        failures: &mut Vec<GuardFailure>,
    ) -> Option<()> {
        match (format, log.attenuating_legs.is_some()) {
            (EntryFormat::Counts, _) => None,
            (EntryFormat::Packed, false) => self.add_places::<[u32; 2]>(logged, log, failures),
            (EntryFormat::Packed, true) => self.add_places::<[u32; 4]>(logged, log, failures),
            (EntryFormat::Reals, false) => self.add_places::<[f64; 2]>(logged, log, failures),
            (EntryFormat::Reals, true) => self.add_places::<[f64; 4]>(logged, log, failures),
        }
    }

    fn add_places<E: PositionEntry>(
        &mut self,
        logged: &LoggedRays,
        log: &PathLog,
        failures: &mut Vec<GuardFailure>,
    ) -> Option<()> {
        let entries: &[E] = entries_of(logged.bytes)?;
        let kept_rays = match log.places.is_empty() {
            true => kept_without_places(entries, logged, log, failures)?,
            false => self.add_kept(entries, logged, log, failures)?,
        };
        if let Some(end) = log.end {
            match end.weight {
                Weight::Logged => self.add_losses(end.cell as usize, kept_rays.num, kept_rays.quanta)?,
                weight @ (Weight::Born | Weight::Known(_)) => {
                    let weight = E::Real::nearest(weight.most_of_born(logged.weight));
                    self.add_to_cell(end.cell as usize, weight.into(), kept_rays.num)?;
                }
            }
        }
        log.attenuating_legs.map_or(Some(()), |legs| {
            self.add_attenuated(&kept_rays, legs, E::Real::nearest(logged.weight).into())
        })
    }

    /// Adds what rays leave at the places of a path.
    fn add_kept<E: PositionEntry>(
        &mut self,
        entries: &[E],
        logged: &LoggedRays,
        log: &PathLog,
        failures: &mut Vec<GuardFailure>,
    ) -> Option<KeptRays> {
        let deposits_of: Vec<Deposits<E::Real>> =
            log.places.iter().map(|place| Deposits::of(place, logged.weight)).collect();
        let mut block = Block::new();
        let mut kept_rays = KeptRays::default();
        for first in logged.rays.clone().step_by(BLOCK) {
            let rays = first..(first + BLOCK).min(logged.rays.end);
            let mut kept = u64::MAX >> (BLOCK - rays.len());
            for (number, deposits) in deposits_of.iter().enumerate() {
                let start = number * logged.stride;
                let row = entries.get(start + rays.start..start + rays.end)?;
                block.lay_out(row, &deposits.weights, deposits.grid);
                if number == 0 {
                    kept &= !failures_among(row, block.others & kept, rays.start, failures);
                }
                self.add_row(&block, row, kept, deposits)?;
                if log.attenuating_legs.is_some() && number + 1 == deposits_of.len() {
                    kept_rays.quanta += left_by(&block, row, kept, deposits);
                }
            }
            kept_rays.num += u64::from(kept.count_ones());
        }
        Some(kept_rays)
    }

    /// What media took from rays that were born with a weight: all that these do not leave at their end.
    fn add_attenuated(&mut self, rays: &KeptRays, legs: u32, born: f64) -> Option<()> {
        let launched = quantize(born).unwrap_or(0).checked_mul(rays.num.into())?;
        self.add_losses(
            LedgerCell::Bulk as usize,
            u64::from(legs) * rays.num,
            launched.checked_sub(rays.quanta)?,
        )
    }

    /// Adds one place, which is laid out, of those rays of a block that kept to the path.
    fn add_row<E: PositionEntry>(
        &mut self,
        block: &Block<E::Real>,
        row: &[E],
        kept: u64,
        deposits: &Deposits<E::Real>,
    ) -> Option<()> {
        let others = deposits.others(block);
        self.add_laid_out(block, kept & !others, deposits.weights.len() as u64, deposits.grid)?;
        bits(kept & others).try_for_each(|i| {
            let mut weights = deposits.weights.iter();
            weights.try_for_each(|&weight| {
                self.add_position(row[i].position(), row[i].weight(weight), deposits.grid)
            })
        })
    }
}

/// Counts the rays that kept to a path without places.
fn kept_without_places<E: PositionEntry>(
    entries: &[E],
    logged: &LoggedRays,
    log: &PathLog,
    failures: &mut Vec<GuardFailure>,
) -> Option<KeptRays> {
    let born = E::Real::nearest(logged.weight);
    let mut kept_rays = KeptRays::default();
    for (ray, entry) in logged.rays.clone().zip(entries.get(logged.rays.clone())?) {
        if entry.position()[0].is_off_detectors() {
            failures.push(failure_of(entry, ray));
        } else {
            kept_rays.num += 1;
            if log.attenuating_legs.is_some() {
                kept_rays.quanta += quantize(entry.weight(born).into()).unwrap_or(0);
            }
        }
    }
    Some(kept_rays)
}

/// Rays of a dispatch that kept to the path.
#[derive(Debug, Default)]
struct KeptRays {
    num: u64,
    /// What they leave at its end, where they log it.
    quanta: u128,
}

/// Quanta that some rays of a block, a bit each, leave at a place, where they log their weights.
fn left_by<E: PositionEntry>(
    block: &Block<E::Real>,
    row: &[E],
    rays: u64,
    deposits: &Deposits<E::Real>,
) -> u128 {
    let others = deposits.others(block);
    let quanta = |i: usize| quantize(row[i].weight(deposits.weights[0]).into()).unwrap_or(0);
    block.total(rays & !others) + bits(rays & others).map(quanta).sum::<u128>()
}

/// Which rays of a block failed a guard, by their first places. Both masks have a bit for each ray.
fn failures_among<E: PositionEntry>(
    places: &[E],
    rays: u64,
    first: usize,
    failures: &mut Vec<GuardFailure>,
) -> u64 {
    let off = bits(rays).filter(|&i| places[i].position()[0].is_off_detectors());
    off.fold(0, |bits, i| {
        failures.push(failure_of(&places[i], first + i));
        bits | 1 << i
    })
}

fn failure_of<E: PositionEntry>(place: &E, ray: usize) -> GuardFailure {
    let event: f64 = place.position()[1].into();
    GuardFailure { ray: ray as u32, event: event as u32 }
}

impl<'a, T: Real> Deposits<'a, T> {
    fn of(place: &'a Place, born: f64) -> Self {
        let weights: Vec<T> =
            place.arrivals.iter().map(|arrival| T::nearest(arrival.weight.most_of_born(born))).collect();
        let total: f64 = weights.iter().map(|&weight| weight.into()).sum();
        Deposits { grid: &place.grid, weights, fit: total < T::LIMIT / 2.0 }
    }

    /// The rays of a block that are not laid out, a bit each.
    fn others(&self, block: &Block<T>) -> u64 {
        if self.fit { block.others } else { u64::MAX }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::path::path_log::{Arrival, LedgerEnd};
    use crate::engine::sums::QUANTA_PER_UNIT;
    use bytemuck::cast_slice;

    const UNIT: u128 = QUANTA_PER_UNIT;
    /// Three columns and two rows behind the counter of invalid deposits and two cells of the ledger.
    const GRID: Grid = Grid { first: 3, column: 1, row: 3, size: [3, 2] };
    const OFF: f64 = -1.25;

    fn place(weights: &[Weight]) -> Place {
        let arrivals = weights.iter().map(|&weight| Arrival { event: 0, weight }).collect();
        Place { grid: GRID, detector: 0, arrivals, edge_room: None }
    }

    /// What rays of a birth weight of 2 add up to, whose places lie row by row, one beyond the other of 70.
    fn added(
        log: &PathLog,
        rows: &[&[[f64; 2]]],
        format: EntryFormat,
    ) -> Option<(DepositSums, Vec<GuardFailure>)> {
        const STRIDE: usize = 70;
        let mut reals = vec![f64::NAN; 2 * STRIDE * rows.len()];
        for (number, row) in rows.iter().enumerate() {
            let first = 2 * STRIDE * number;
            reals[first..first + 2 * row.len()].copy_from_slice(row.as_flattened());
        }
        let floats: Vec<f32> = reals.iter().map(|&real| real as f32).collect();
        let bytes = if format == EntryFormat::Reals { cast_slice(&reals) } else { cast_slice(&floats) };
        let logged = LoggedRays { bytes, rays: 0..rows[0].len(), stride: STRIDE, weight: 2.0 };
        let (mut sums, mut failures) = (DepositSums::of_num(9), Vec::new());
        sums.add_path(&logged, format, log, &mut failures)?;
        sums.add_corners().map(|()| (sums, failures))
    }

    #[test]
    fn each_arrival_leaves_its_weight_and_failed_rays_nothing() {
        let places = vec![place(&[Weight::Known(1.0), Weight::Known(0.5)]), place(&[Weight::Born])];
        let end = Some(LedgerEnd { cell: 1, weight: Weight::Known(0.25) });
        let log = PathLog { places, end, attenuating_legs: None, tells_all: true };
        let fails_sixth = |i: usize| if i % 6 == 5 { [OFF, (i % 4) as f64] } else { [0.5, 0.0] };
        let first: Vec<[f64; 2]> = (0..66).map(fails_sixth).collect();
        let second = [[2.0, 1.0]; 66];
        for format in [EntryFormat::Packed, EntryFormat::Reals] {
            let (sums, failures) = added(&log, &[&first, &second], format).unwrap();
            let ray = |i: u32| GuardFailure { ray: i, event: i % 4 };
            assert!(failures.iter().copied().eq((5..66).step_by(6).map(ray)), "{format:?}");
            let tap = UNIT * 3 / 4 * 55;
            let expected = [0, UNIT / 4 * 55, 0, tap, tap, 0, 0, 0, 2 * UNIT * 55];
            assert_eq!(sums.quanta().collect::<Vec<_>>(), expected, "{format:?}");
            assert_eq!(sums.counts, [0, 55, 0, 110, 0, 0, 0, 0, 55], "{format:?}");
        }
    }

    #[test]
    fn weights_that_no_word_holds_together_add_up_one_by_one() {
        let weights = [Weight::Known(1500.0), Weight::Known(700.0), Weight::Known(1e6)];
        let log =
            PathLog { places: vec![place(&weights)], end: None, attenuating_legs: None, tells_all: true };
        let (sums, _) = added(&log, &[&[[1.5, 1.0]]], EntryFormat::Reals).unwrap();
        let half = 1_002_200 * UNIT / 2;
        assert_eq!(sums.quanta().collect::<Vec<_>>(), [0, 0, 0, 0, 0, 0, 0, half, half]);
        assert_eq!(sums.counts, [0, 0, 0, 0, 0, 0, 0, 3, 0]);
    }

    #[test]
    fn a_weight_that_no_sum_can_hold_is_counted() {
        let end = Some(LedgerEnd { cell: 2, weight: Weight::Known(1e30) });
        let log = PathLog {
            places: vec![place(&[Weight::Known(-1.0)])],
            end,
            attenuating_legs: None,
            tells_all: true,
        };
        let (sums, _) = added(&log, &[&[[0.0, 0.0]; 3]], EntryFormat::Reals).unwrap();
        assert!(sums.quanta().all(|quanta| quanta == 0));
        assert_eq!(sums.counts, [6, 0, 3, 3, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn what_rays_weigh_no_more_at_their_end_is_what_media_took() {
        let places = vec![place(&[Weight::Logged]); 2];
        let log = PathLog { places, end: None, attenuating_legs: Some(3), tells_all: true };
        // Of births of 2, in a block that is full and one that is not; every third ray failed.
        let first: Vec<[f64; 4]> =
            (0..66).map(|i| if i % 3 == 0 { [OFF, 1.0, 9.0, 0.0] } else { [0.5, 0.0, 1.75, 0.0] }).collect();
        let second: Vec<[f64; 4]> = (0..66).map(|i| [2.0, 1.0, [0.5, 1.5][i % 2], 0.0]).collect();
        let both = [first, second].concat();
        for format in [EntryFormat::Packed, EntryFormat::Reals] {
            let floats: Vec<f32> = both.as_flattened().iter().map(|&real| real as f32).collect();
            let bytes = if format == EntryFormat::Reals { cast_slice(&both) } else { cast_slice(&floats) };
            let added = |weight: f64| {
                let logged = LoggedRays { bytes, rays: 0..66, stride: 66, weight };
                let (mut sums, mut failures) = (DepositSums::of_num(9), Vec::new());
                sums.add_path(&logged, format, &log, &mut failures)?;
                sums.add_corners().map(|()| (sums, failures))
            };
            let (sums, failures) = added(2.0).unwrap();
            assert_eq!(failures.len(), 22, "{format:?}");
            assert_eq!(sums.counts, [0, 0, 0, 44 * 3 + 44, 0, 0, 0, 0, 44], "{format:?}");
            let quanta: Vec<u128> = sums.quanta().collect();
            let tap = UNIT * 7 / 8 * 44;
            assert_eq!(quanta[3..5], [tap + 44 * UNIT, tap], "{format:?}");
            assert_eq!(quanta[8], 44 * UNIT, "{format:?}");
            // Births so heavy that no ray is laid out.
            let heavy: Vec<u128> = added(1e6).unwrap().0.quanta().collect();
            assert_eq!(heavy[3], tap + 44 * (1_000_000 - 1) * UNIT, "{format:?}");
            assert_eq!((heavy[4], heavy[8]), (tap, 44 * UNIT), "{format:?}");
            assert!(added(0.125).is_none(), "{format:?}: more than they were born with");
        }
    }

    /// A path that arrives on no detector, of rays that escape, with known weights or their own.
    #[test]
    fn rays_without_places_leave_their_weight_at_their_end() {
        for format in [EntryFormat::Packed, EntryFormat::Reals] {
            for logs_weights in [false, true] {
                let weight = if logs_weights { Weight::Logged } else { Weight::Known(0.5) };
                let end = Some(LedgerEnd { cell: 1, weight });
                let attenuating_legs = logs_weights.then_some(2);
                let log = PathLog { places: Vec::new(), end, attenuating_legs, tells_all: true };
                let width = if logs_weights { 4 } else { 2 };
                let row = |i: usize| [[0.0, OFF][usize::from(i % 5 == 2)], 3.0, 0.5 + (i % 2) as f64, 0.0];
                let reals: Vec<f64> = (0..70).flat_map(|i| row(i).into_iter().take(width)).collect();
                let floats: Vec<f32> = reals.iter().map(|&real| real as f32).collect();
                let bytes =
                    if format == EntryFormat::Reals { cast_slice(&reals) } else { cast_slice(&floats) };
                let logged = LoggedRays { bytes, rays: 1..70, stride: 70, weight: 2.0 };
                let (mut sums, mut failures) = (DepositSums::of_num(9), Vec::new());
                sums.add_path(&logged, format, &log, &mut failures).unwrap();
                let ray = |ray: u32| GuardFailure { ray, event: 3 };
                assert!(failures.iter().copied().eq((2..70).step_by(5).map(ray)), "{format:?}");
                // Of the rays 1 to 69, 14 fail; 28 of the others have an odd number, and 27 an even one.
                let (left, lost) = if logs_weights { (28 * 3 + 27, 28 + 27 * 3) } else { (55, 0) };
                let quanta: Vec<u128> = sums.quanta().collect();
                assert_eq!(quanta[1], UNIT / 2 * left, "{format:?}");
                assert_eq!(quanta[3], UNIT / 2 * lost, "{format:?}");
                let legs = u64::from(logs_weights) * 2 * 55;
                assert_eq!(sums.counts, [0, 55, 0, legs, 0, 0, 0, 0, 0], "{format:?}");
                let beyond = LoggedRays { rays: 0..71, ..logged };
                assert!(sums.add_path(&beyond, format, &log, &mut failures).is_none(), "the log ends before");
            }
        }
    }

    #[test]
    fn what_is_no_place_is_refused() {
        let log = PathLog {
            places: vec![place(&[Weight::Born])],
            end: None,
            attenuating_legs: None,
            tells_all: true,
        };
        assert!(added(&log, &[&[[0.0, f64::NAN]]], EntryFormat::Reals).is_none());
        assert!(added(&log, &[&[[0.0, 0.0]]], EntryFormat::Counts).is_none());
        let beyond = PathLog {
            places: vec![place(&[Weight::Born]); 2],
            end: None,
            attenuating_legs: None,
            tells_all: true,
        };
        assert!(
            added(&beyond, &[&[[0.0, 0.0]]], EntryFormat::Reals).is_none(),
            "the log ends before the path"
        );
    }
}
