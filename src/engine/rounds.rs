//! How many rounds follow the rays that live on. Rounds end with the last ray, so a depth limit costs only as much as
//! rays use of it.
//!
//! The first stage follows new rays through their first events, and queues the survivors. Each round follows those
//! through as many events again. Few rounds are submitted at once with the first stage. Where more are allowed, the
//! host asks the device how many rays are left. The host submits rounds in groups for as long as rays are left.

use std::ops::Range;
use std::time::Duration;

/// Up to so many rounds are submitted with the first stage, whether or not a ray needs them: to ask takes longer.
const MOST_UNASKED: usize = 4;
/// Rounds of the first group, and most rounds of one.
const FIRST_GROUP: usize = 4;
pub(crate) const MOST_IN_GROUP: usize = 64;

/// The rounds that are submitted with the first stage, of a trace that may have so many in all. The first stage is round
/// 0.
pub(crate) fn unasked(num_rounds: usize) -> Range<usize> {
    if num_rounds > 1 + MOST_UNASKED { 1..1 } else { 1..num_rounds }
}

/// The rounds of a range that are not submitted yet.
#[derive(Debug)]
pub(crate) struct RoundsLeft {
    left: Range<usize>,
    group: usize,
}

impl RoundsLeft {
    /// The rounds that are left after the first stage; `None` if all were submitted with that stage.
    pub(crate) fn of(num_rounds: usize) -> Option<Self> {
        let left = unasked(num_rounds).end..num_rounds;
        (!left.is_empty()).then_some(RoundsLeft { left, group: FIRST_GROUP })
    }

    /// The rounds of the next group, at most `most`; `None` if no ray is left.
    pub(crate) fn next(&mut self, num_queued: u32, most: u64) -> Option<Range<usize>> {
        if num_queued == 0 || self.left.is_empty() {
            return None;
        }
        let most = usize::try_from(most).unwrap_or(usize::MAX).clamp(1, self.left.len());
        let group = self.left.start..self.left.start + self.group.min(most);
        self.left.start = group.end;
        Some(group)
    }

    /// Learns from a group that took `time`, where a group should not take longer than `target`.
    pub(crate) fn note(&mut self, time: Duration, target: Duration) {
        let group = if time > target { self.group / 2 } else { 2 * self.group };
        self.group = group.clamp(1, MOST_IN_GROUP);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TARGET: Duration = Duration::from_millis(40);

    /// The groups of a range in which rays are left until round `last`, where each group takes so long.
    fn groups(num_rounds: usize, last: usize, millis: u64) -> Vec<Range<usize>> {
        let mut left = RoundsLeft::of(num_rounds).unwrap();
        let mut groups: Vec<Range<usize>> = Vec::new();
        while let Some(group) = left.next(u32::from(groups.last().is_none_or(|g| g.end <= last)), u64::MAX) {
            groups.push(group);
            left.note(Duration::from_millis(millis), TARGET);
        }
        groups
    }

    #[test]
    fn few_rounds_are_not_asked_about() {
        assert!((1..=5).all(|num| RoundsLeft::of(num).is_none() && unasked(num) == (1..num)));
        assert!(RoundsLeft::of(6).is_some() && unasked(6).is_empty());
    }

    #[test]
    fn rounds_end_with_the_last_ray() {
        assert_eq!(RoundsLeft::of(1000).unwrap().next(0, 1), None);
        assert_eq!(groups(1000, 0, 1).last(), Some(&(1..5)));
        assert_eq!(groups(1000, 9, 1), [1..5, 5..13]);
    }

    #[test]
    fn groups_follow_one_another_up_to_the_last_round() {
        for (num_rounds, millis) in [(6, 1), (1000, 1), (1000, 40), (77, 41), (300, 1000)] {
            let groups = groups(num_rounds, usize::MAX, millis);
            assert_eq!((groups[0].start, groups.last().unwrap().end), (1, num_rounds));
            assert!(groups.windows(2).all(|pair| pair[0].end == pair[1].start));
            assert!(groups.iter().all(|group| group.len() <= MOST_IN_GROUP));
            let last = groups[groups.len().saturating_sub(2)].len();
            assert!(millis <= 40 || last <= 2, "groups shrink where they take long: {last}");
        }
    }

    #[test]
    fn a_group_is_no_larger_than_counters_allow() {
        assert_eq!(RoundsLeft::of(1000).unwrap().next(1, 2), Some(1..3));
        assert_eq!(RoundsLeft::of(1000).unwrap().next(1, 0), Some(1..2));
    }
}
