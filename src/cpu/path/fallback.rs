//! Queues of rays that failed a guard of the hot path, by the event of that guard, until a batch is worth a dispatch.

use crate::cpu::log::deposit_sums::GuardFailure;
use crate::cpu::path::hot_path::MAX_EVENTS;
use crate::cpu::path::pays;
use crate::cpu::path::side_trace::SideTrace;
use crate::program::RayRange;

/// A stage for so many rays saves what it takes to compile: 0.06 s for a lens, 0.5 s for a double Gauss, on lavapipe.
/// Of 2^17 to 2^21 this number was the best for a lens, a triplet and a double Gauss together. Traces had 5e6 to 1e8
/// rays. Where nobody knows how many rays will come, a stage waits until as many have come. So a stage at most doubles
/// what is lost without it.
const STAGE_PAYS: f64 = (1 << 19) as f64;

/// Fewer rays of a side trace are sooner traced with others: a dispatch of their own takes longer than is saved.
const LEAST_ALONE: usize = 1 << 12;

/// All rays that wait, and how the side traces go.
#[derive(Debug, Default)]
pub struct FallbackQueues {
    sides: Vec<Side>,
    /// So many rays are to be traced, where that is known.
    num_expected: Option<u64>,
    /// Rays that were to keep to the hot path, in all traces.
    num_followed: u64,
    /// Of each source.
    waiting: Vec<Waiting>,
}

/// A side trace, and what has become of its rays.
#[derive(Debug)]
struct Side {
    fails_at: usize,
    /// Of all rays, by the profile.
    share: f64,
    is_always_followed: bool,
    /// Rays of this trace that were to keep to the side trace, and how many of these rays failed a guard.
    followed_and_failed: [u64; 2],
}

/// Ids of rays.
#[derive(Debug)]
struct Waiting {
    /// Per event of the hot path whose guard the rays failed. The last element is for guards at the end of the path.
    /// Such rays go alike, which matters because wide machines wait for the longest of the rays that they trace side by
    /// side.
    by_event: [Vec<u64>; MAX_EVENTS as usize + 1],
    /// Per side trace.
    by_side: Vec<Vec<u64>>,
}

impl Side {
    /// Whether rays that fail the guard of its event should follow it, of so many that are traced.
    fn pays(&self, num_rays: u64) -> bool {
        let pays = || self.share * num_rays as f64 >= STAGE_PAYS && pays::pays(self.followed_and_failed);
        self.is_always_followed || pays()
    }
}

impl FallbackQueues {
    /// Empty queues. `num_expected`: how many rays are to be traced, if that is known. `are_always_followed`: side
    /// traces are followed whether or not they pay.
    pub fn new(side_traces: &[SideTrace], num_expected: Option<u64>, are_always_followed: bool) -> Self {
        let sides = side_traces.iter().map(|side| Side {
            fails_at: side.fails_at,
            share: side.share,
            is_always_followed: are_always_followed,
            followed_and_failed: [0, 0],
        });
        FallbackQueues { sides: sides.collect(), num_expected, num_followed: 0, waiting: Vec::new() }
    }

    /// Begins a trace: forgets the rays that wait.
    pub fn discard(&mut self) {
        self.waiting.clear();
        self.sides.iter_mut().for_each(|side| side.followed_and_failed = [0, 0]);
    }

    /// Takes note of rays of a range that failed a guard of the hot path.
    pub fn add(&mut self, failures: &[GuardFailure], range: &RayRange) {
        self.num_followed += u64::from(range.count);
        let sides: [Option<usize>; MAX_EVENTS as usize + 1] =
            std::array::from_fn(|event| self.side_at(event, 0));
        let waiting = self.of(range.source);
        for &GuardFailure { ray, event } in failures {
            let event = event.min(MAX_EVENTS) as usize;
            waiting.list(sides[event], event).push(range.first + u64::from(ray));
        }
    }

    /// Takes note of the rays that failed a guard of a side trace, by their numbers among these ids. Such rays follow
    /// the next side trace from the same event.
    pub fn add_of_side(
        &mut self,
        side: usize,
        failures: &[GuardFailure],
        ids: &[u64],
        source: usize,
    ) -> Option<()> {
        let Side { fails_at, followed_and_failed: [num_followed, num_failed], .. } =
            self.sides.get_mut(side)?;
        *num_followed += ids.len() as u64;
        *num_failed += failures.len() as u64;
        let event = *fails_at;
        let next = self.side_at(event, side + 1);
        let list = self.of(source).list(next, event);
        failures.iter().try_for_each(|ray| {
            list.push(*ids.get(ray.ray as usize)?);
            Some(())
        })
    }

    /// The first side trace, from number `first` on, for rays that failed the guard of this event.
    fn side_at(&self, event: usize, first: usize) -> Option<usize> {
        let num_rays = self.num_expected.unwrap_or(0).max(self.num_followed);
        let is_there = |side: &Side| side.fails_at == event && side.pays(num_rays);
        let number = self.sides.get(first..)?.iter().position(is_there)?;
        Some(first + number)
    }

    /// Lets all rays of a range wait, as if none had followed the path.
    pub fn list(&mut self, range: &RayRange) {
        self.of(range.source).by_event[0].extend(range.first..range.first + u64::from(range.count));
    }

    /// Called when the last rays have come. Rays that are too few for their side trace fall back on the plain stages.
    pub fn give_up_few(&mut self) {
        for (side, Side { fails_at, is_always_followed, .. }) in self.sides.iter().enumerate() {
            let least = if *is_always_followed { 1 } else { LEAST_ALONE };
            for Waiting { by_event, by_side } in &mut self.waiting {
                if by_side[side].len() < least {
                    by_event[*fails_at].append(&mut by_side[side]);
                }
            }
        }
    }

    /// How many rays of a source wait for trace_new.
    pub fn num(&self, source: usize) -> usize {
        self.waiting.get(source).into_iter().flat_map(|waiting| &waiting.by_event).map(Vec::len).sum()
    }

    /// At most so many of them.
    pub fn take(&mut self, source: usize, most: usize) -> Vec<u64> {
        let mut taken = Vec::new();
        for waiting in self.waiting.get_mut(source).into_iter().flat_map(|waiting| &mut waiting.by_event) {
            let room = most - taken.len();
            taken.extend(waiting.drain(waiting.len().saturating_sub(room)..));
        }
        taken
    }

    /// The side trace that most rays of a source wait for, if so many wait for any, and at most so many of these.
    pub fn take_of_side(&mut self, source: usize, at_least: usize, most: usize) -> Option<(usize, Vec<u64>)> {
        let by_side = &mut self.waiting.get_mut(source)?.by_side;
        let num: usize = by_side.iter().map(Vec::len).sum();
        let most_waiting = by_side.iter_mut().enumerate().max_by_key(|(_, ids)| ids.len());
        let (number, ids) = most_waiting.filter(|_| num >= at_least.max(1))?;
        Some((number, ids.drain(ids.len().saturating_sub(most)..).collect()))
    }

    /// For each side trace, how many rays of this trace were to keep to it, and how many of these failed a guard.
    pub fn num_along_sides(&self) -> impl Iterator<Item = [u64; 2]> {
        self.sides.iter().map(|side| side.followed_and_failed)
    }

    fn of(&mut self, source: usize) -> &mut Waiting {
        let num_sides = self.sides.len();
        let none = || Waiting {
            by_event: std::array::from_fn(|_| Vec::new()),
            by_side: vec![Vec::new(); num_sides],
        };
        self.waiting.resize_with(self.waiting.len().max(source + 1), none);
        &mut self.waiting[source]
    }
}

impl Waiting {
    /// The rays that wait for a side trace or, without one, the rays that failed the guard of an event.
    fn list(&mut self, side: Option<usize>, event: usize) -> &mut Vec<u64> {
        match side {
            Some(side) => &mut self.by_side[side],
            None => &mut self.by_event[event],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::path::hot_path::HotPath;

    const RANGE: RayRange =
        RayRange { first: 0, count: STAGE_PAYS as u32, source: 0, log_stride: 0, reached: 0 };

    /// A side trace of one ray in so many.
    fn side_trace(fails_at: usize, of_rays: u64) -> SideTrace {
        let path = HotPath { events: Vec::new(), missed: None };
        SideTrace { fails_at, path, log: None, share: 1.0 / of_rays as f64, media_absorb_weakly: true }
    }

    fn failed_rays(rays: std::ops::Range<u32>, event: u32) -> Vec<GuardFailure> {
        rays.map(|ray| GuardFailure { ray, event }).collect()
    }

    #[test]
    fn rays_follow_a_side_trace_when_its_stage_pays() {
        let mut failures = FallbackQueues::new(&[side_trace(3, 2), side_trace(1, 1)], None, false);
        let almost = RayRange { count: STAGE_PAYS as u32 - 1, ..RANGE };
        failures.add(&[failed_rays(0..3, 1), failed_rays(0..7, 3)].concat(), &almost);
        assert_eq!((failures.num(0), failures.take_of_side(0, 1, 9)), (10, None));
        // In all traces together.
        failures.discard();
        assert_eq!(failures.num(0), 0);
        let one = RayRange { count: 1, ..RANGE };
        failures.add(&[failed_rays(4..9, 1), failed_rays(0..5, 0), failed_rays(9..11, 3)].concat(), &one);
        assert_eq!(failures.num(0), 7);
        assert_eq!(failures.take_of_side(0, 6, 9), None, "too few wait");
        assert_eq!(failures.take_of_side(0, 5, 3), Some((1, vec![6, 7, 8])));
        failures.add(&failed_rays(0..3, 3), &RANGE);
        // For either of them.
        assert_eq!(failures.take_of_side(0, 5, 9), Some((0, vec![0, 1, 2])));
        assert_eq!(failures.take_of_side(0, 1, 3), Some((1, vec![4, 5])));
        assert_eq!(failures.take_of_side(0, 0, 3), None);
    }

    #[test]
    fn rays_follow_a_side_trace_at_once_where_enough_are_to_come() {
        for (num_expected, are_enough) in [(2 * STAGE_PAYS as u64, true), (2 * STAGE_PAYS as u64 - 1, false)]
        {
            let mut failures = FallbackQueues::new(&[side_trace(1, 2)], Some(num_expected), false);
            failures.add(&failed_rays(0..3, 1), &RayRange { count: 3, ..RANGE });
            assert_eq!(failures.take_of_side(0, 1, 9).is_some(), are_enough, "{num_expected}");
            assert_eq!(failures.num(0), if are_enough { 0 } else { 3 });
        }
    }

    #[test]
    fn rays_that_are_failed_again_follow_the_next_side_trace() {
        let mut failures =
            FallbackQueues::new(&[side_trace(1, 1), side_trace(2, 1), side_trace(1, 1)], None, true);
        failures.add(&failed_rays(10..20, 1), &RANGE);
        let (side, ids) = failures.take_of_side(0, 1, 9).unwrap();
        assert_eq!((side, ids[0]), (0, 11));
        failures.add_of_side(0, &failed_rays(1..4, 2), &ids, 0).unwrap();
        let (side, ids) = failures.take_of_side(0, 1, 9).unwrap();
        assert_eq!((side, &ids[..]), (2, &[12, 13, 14][..]));
        failures.add_of_side(2, &failed_rays(1..2, 0), &ids, 0).unwrap();
        assert_eq!(failures.take(0, 9), [13]);
        assert_eq!(failures.num_along_sides().collect::<Vec<_>>(), [[9, 3], [0, 0], [3, 1]]);
    }

    #[test]
    fn few_rays_follow_no_side_trace_when_no_more_will_come() {
        for is_always_followed in [false, true] {
            let mut failures =
                FallbackQueues::new(&[side_trace(2, 1), side_trace(1, 1)], None, is_always_followed);
            let enough = LEAST_ALONE as u32;
            failures.add(&[failed_rays(0..enough, 1), failed_rays(0..enough - 1, 2)].concat(), &RANGE);
            failures.give_up_few();
            let num_given_up = if is_always_followed { 0 } else { LEAST_ALONE - 1 };
            assert_eq!(failures.num(0), num_given_up);
            let taken = failures.take_of_side(0, 1, 2 * LEAST_ALONE);
            assert_eq!(taken.map(|(side, ids)| (side, ids.len())), Some((1, LEAST_ALONE)));
            let taken = failures.take_of_side(0, 1, 2 * LEAST_ALONE);
            assert_eq!(taken.is_some(), is_always_followed);
        }
    }

    #[test]
    fn a_side_trace_that_fails_most_rays_is_left() {
        const NUM: u32 = STAGE_PAYS as u32;
        for is_always_followed in [false, true] {
            let mut failures = FallbackQueues::new(&[side_trace(1, 1)], None, is_always_followed);
            let ids: Vec<u64> = (0..u64::from(NUM)).map(|ray| 2 * ray).collect();
            failures.add(&failed_rays(0..NUM, 1), &RANGE);
            let taken = failures.take_of_side(0, 1, NUM as usize);
            assert_eq!(taken.map(|(side, ids)| (side, ids.len())), Some((0, NUM as usize)));
            failures.add_of_side(0, &failed_rays(5..NUM, 2), &ids, 0).unwrap();
            let num_failed = NUM as usize - 5;
            assert_eq!(failures.num_along_sides().next(), Some([NUM.into(), num_failed as u64]));
            assert_eq!(failures.num(0), num_failed);
            assert_eq!(failures.take(0, 2), ids[ids.len() - 2..], "by the ids of those that followed it");
            failures.add(&failed_rays(0..9, 1), &RANGE);
            assert_eq!(failures.take_of_side(0, 1, 9).is_some(), is_always_followed);
            assert!(
                failures.add_of_side(0, &failed_rays(3..4, 2), &ids[..3], 0).is_none(),
                "beyond the dispatch"
            );
        }
    }

    #[test]
    fn failed_rays_are_taken_in_the_order_of_their_events() {
        let range = RayRange { first: 100, count: 7, source: 1, log_stride: 0, reached: 0 };
        let of_events = [(0, 2), (1, 0), (2, 2), (3, u32::MAX), (4, 0), (5, 2)];
        let mut failures = FallbackQueues::default();
        failures.add(&of_events.map(|(ray, event)| GuardFailure { ray, event }), &range);
        assert_eq!(failures.take(1, 4), [101, 104, 102, 105]);
        assert_eq!(failures.take(1, 4), [100, 103]);
        assert!(failures.take(1, 4).is_empty() && failures.take(0, 4).is_empty());
    }
}
