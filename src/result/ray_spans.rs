//! Which rays a tally holds.

use std::ops::AddAssign;

use serde::{Deserialize, Serialize};

/// Rays `first..first + count` of one source.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct RaySpan {
    /// First ray id.
    pub first: u64,
    /// Number of rays.
    pub count: u64,
    /// The source they come from.
    pub source: u32,
}

/// The ids of the rays that were traced, as spans in ascending order. Neighbours are joined, so that the set does not
/// depend on how the rays were cut into passes.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RaySpans {
    spans: Vec<RaySpan>,
}

impl RaySpan {
    /// The id after the last one.
    pub fn end(&self) -> u64 {
        self.first.saturating_add(self.count)
    }
}

impl RaySpans {
    /// The spans, ascending.
    pub fn spans(&self) -> &[RaySpan] {
        &self.spans
    }

    /// Rays of one source.
    pub fn count_of(&self, source: usize) -> u64 {
        self.spans.iter().filter(|span| span.source as usize == source).map(|span| span.count).sum()
    }

    /// Launched rays of each of so many sources.
    pub fn counts(&self, num_sources: usize) -> Vec<u64> {
        let mut counts = vec![0; num_sources];
        for span in &self.spans {
            counts.iter_mut().skip(span.source as usize).take(1).for_each(|count| *count += span.count);
        }
        counts
    }

    /// Rays whose ids leave each remainder 0.. by `divisor`; ids of launched rays.
    pub fn counts_by_remainder(&self, divisor: u64) -> Vec<u64> {
        // Of the ids below `end`.
        let below = |end: u64, remainder: u64| end / divisor + u64::from(end % divisor > remainder);
        let of_span = |span: &RaySpan, remainder| below(span.end(), remainder) - below(span.first, remainder);
        (0..divisor).map(|remainder| self.spans.iter().map(|span| of_span(span, remainder)).sum()).collect()
    }

    /// A span of ids that both hold, if there is one.
    pub fn overlap(&self, other: &RaySpans) -> Option<(u64, u64)> {
        let (mut mine, mut others) = (self.spans.iter().peekable(), other.spans.iter().peekable());
        while let (Some(a), Some(b)) = (mine.peek(), others.peek()) {
            let (first, end) = (a.first.max(b.first), a.end().min(b.end()));
            if first < end {
                return Some((first, end));
            }
            if a.end() <= b.end() {
                mine.next()
            } else {
                others.next()
            };
        }
        None
    }
}

impl AddAssign<RaySpan> for RaySpans {
    fn add_assign(&mut self, span: RaySpan) {
        if span.count == 0 {
            return;
        }
        let place = self.spans.partition_point(|other| *other < span);
        self.spans.insert(place, span);
        for left in [place, place.wrapping_sub(1)] {
            let Some(&[a, b]) = self.spans.get(left..).and_then(|rest| rest.first_chunk::<2>()) else {
                continue;
            };
            if a.source == b.source && a.end() == b.first {
                self.spans[left].count += b.count;
                self.spans.remove(left + 1);
            }
        }
    }
}

impl AddAssign<&RaySpans> for RaySpans {
    fn add_assign(&mut self, other: &RaySpans) {
        other.spans.iter().for_each(|span| *self += *span);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn span(first: u64, end: u64, source: u32) -> RaySpan {
        RaySpan { first, count: end - first, source }
    }

    fn set(spans: &[RaySpan]) -> RaySpans {
        let mut set = RaySpans::default();
        spans.iter().for_each(|span| set += *span);
        set
    }

    #[test]
    fn neighbours_of_one_source_are_joined_in_any_order() {
        let pieces = [span(0, 10, 0), span(10, 20, 0), span(20, 30, 1), span(30, 35, 1), span(40, 50, 1)];
        let expected = [span(0, 20, 0), span(20, 35, 1), span(40, 50, 1)];
        for turn in 0..5 {
            let mut turned = pieces;
            turned.rotate_left(turn);
            assert_eq!(set(&turned).spans(), expected);
            turned.reverse();
            assert_eq!(set(&turned).spans(), expected);
        }
        assert_eq!(set(&pieces).count_of(1), 25);
        assert_eq!(set(&[span(5, 5, 0)]), RaySpans::default());
    }

    #[test]
    fn remainders_are_counted() {
        let rays = set(&[span(3, 9, 0), span(16, 17, 1), span(1 << 40, (1 << 40) + 8, 0)]);
        // 3 4 5 6 7 8, 16, and two of each remainder by 4.
        assert_eq!(rays.counts_by_remainder(4), [2 + 1 + 2, 1 + 2, 1 + 2, 2 + 2]);
        assert_eq!(RaySpans::default().counts_by_remainder(3), [0, 0, 0]);
    }

    #[test]
    fn overlaps_are_found_and_nothing_else() {
        let ours = set(&[span(0, 10, 0), span(20, 30, 1), span(1 << 40, (1 << 40) + 5, 1)]);
        assert_eq!(ours.overlap(&set(&[span(10, 20, 0), span(30, 1 << 40, 0)])), None);
        assert_eq!(ours.overlap(&set(&[span(12, 22, 0)])), Some((20, 22)));
        assert_eq!(set(&[span(12, 22, 0)]).overlap(&ours), Some((20, 22)));
        assert_eq!(
            ours.overlap(&set(&[span((1 << 40) + 4, 1 << 41, 0)])),
            Some(((1 << 40) + 4, (1 << 40) + 5))
        );
        assert_eq!(ours.overlap(&RaySpans::default()), None);
    }
}
