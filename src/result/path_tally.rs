//! Light by its path: exact sums for each sequence of events.
//!
//! A table holds at most so many sequences. If a trace has more sequences, a pilot decides beforehand which ones have
//! a row. All other light is summed up by its end. So the sums of parts of a trace add up to the sums of the whole,
//! however the trace is cut.

use crate::model::sequence::{End, Sequence};
use crate::result::QUANTA_PER_WEIGHT;
use crate::result::few_rays::Brought;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::AddAssign;

/// The sums of light that took one path.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PathSum {
    /// Number of deposits. A launched ray makes at most one along a sequence.
    pub count: u64,
    /// Sum of the weights \[quanta\].
    pub quanta: u128,
    /// Sum of the squares of the weights, in units of 2^-52, each rounded up.
    pub squares: u128,
}

/// The sums of all light by its path.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PathTally {
    /// Most rows.
    pub most_rows: u32,
    /// The rows, by sequence.
    pub rows: BTreeMap<Sequence, PathSum>,
    /// True if there were more sequences than rows. Then the sequences that the pilot chose have a row, and no others.
    pub is_closed: bool,
    /// The sequences that the pilot chose, ascending; `None` while no pilot was needed.
    pub chosen: Option<Vec<Sequence>>,
    /// Light without a row, by its end.
    pub other: BTreeMap<End, PathSum>,
    /// True if some square was too large to be summed: no standard error is known.
    pub squares_overflowed: bool,
}

impl AddAssign for PathSum {
    fn add_assign(&mut self, other: Self) {
        self.count += other.count;
        self.quanta += other.quanta;
        self.squares += other.squares;
    }
}

impl PathSum {
    /// What the rays brought, with squares where they could be summed.
    pub(crate) fn brought(&self, has_squares: bool) -> Brought {
        let squares = Some(self.squares).filter(|squares| has_squares && *squares > 0);
        Brought { count: self.count, quanta: self.quanta, squares }
    }

    /// The variance of the sum of quanta, where so many rays of the source were launched \[quanta^2\].
    pub fn variance(&self, launched: u64) -> f64 {
        let (quanta, squares) = (self.quanta as f64, self.squares as f64 * QUANTA_PER_WEIGHT);
        (squares - quanta * (quanta / launched.max(1) as f64)).max(0.0)
    }
}

impl PathTally {
    /// An empty table.
    pub fn new(most_rows: u32) -> Self {
        PathTally { most_rows, ..PathTally::default() }
    }

    /// True if there are more rows than the table may have. Then [`PathTally::close`] is due.
    pub fn is_too_large(&self) -> bool {
        !self.is_closed && self.rows.len() > self.most_rows as usize
    }

    /// True if parts of a trace like this one may have more sequences together than the table has rows. The chosen
    /// sequences should then be known. A trace that is a part of a larger one has more parts beside it.
    pub fn may_grow_too_large(&self, is_part: bool) -> bool {
        self.rows.len() > self.most_rows as usize / if is_part { 256 } else { 16 }
    }

    /// Keeps the rows of the chosen sequences alone.
    pub fn close(&mut self, chosen: Vec<Sequence>) {
        self.is_closed = true;
        let rows = std::mem::take(&mut self.rows);
        for (sequence, sum) in rows {
            match chosen.binary_search(&sequence) {
                Ok(_) => {
                    self.rows.insert(sequence, sum);
                }
                Err(_) => *self.other.entry(sequence.end).or_default() += sum,
            }
        }
        self.chosen = Some(chosen);
    }

    /// The sums of all light, by its end.
    pub fn totals(&self) -> BTreeMap<End, PathSum> {
        let mut totals = self.other.clone();
        for (sequence, sum) in &self.rows {
            *totals.entry(sequence.end).or_default() += *sum;
        }
        totals
    }

    /// The sums of all light that came to an end.
    pub fn total(&self, end: End) -> PathSum {
        self.totals().remove(&end).unwrap_or_default()
    }
}

/// Adds the sums of other rays of the same trace. Where the result [`PathTally::is_too_large`], it has to be closed.
impl AddAssign<&PathTally> for PathTally {
    fn add_assign(&mut self, other: &PathTally) {
        self.most_rows = self.most_rows.max(other.most_rows);
        for (sequence, sum) in &other.rows {
            *self.rows.entry(sequence.clone()).or_default() += *sum;
        }
        for (end, sum) in &other.other {
            *self.other.entry(*end).or_default() += *sum;
        }
        self.squares_overflowed |= other.squares_overflowed;
        if self.chosen.is_none() {
            self.chosen.clone_from(&other.chosen);
        }
        let is_due = self.is_closed || other.is_closed || self.is_too_large();
        if let Some(chosen) = self.chosen.take_if(|_| is_due) {
            self.close(chosen);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sequence::{Step, StepKind};

    fn sequence(surface: u32) -> Sequence {
        let steps = vec![Step { kind: StepKind::Transmitted, surface }];
        Sequence { source: 0, steps, end: End::Detector(surface % 2) }
    }

    /// The sums of rays that took these paths, in a table of three rows.
    fn tally(surfaces: &[u32]) -> PathTally {
        let mut tally = PathTally { chosen: Some([0, 1, 2].map(sequence).to_vec()), ..PathTally::new(3) };
        for &surface in surfaces {
            *tally.rows.entry(sequence(surface)).or_default() +=
                PathSum { count: 1, quanta: 1 << surface, squares: 1 };
        }
        if tally.is_too_large() {
            tally.close([0, 1, 2].map(sequence).to_vec());
        }
        tally
    }

    #[test]
    fn parts_add_up_to_the_whole_whichever_of_them_is_too_large() {
        let rays = [0, 5, 2, 2, 4, 0, 1, 5, 3];
        let whole = tally(&rays);
        assert!(whole.is_closed && whole.rows.len() == 3);
        assert_eq!(whole.total(End::Detector(1)).quanta, 32 + 2 + 32 + 8);
        for cut in 1..rays.len() {
            for other_cut in cut..rays.len() {
                let mut sum = PathTally::new(3);
                for part in [&rays[..cut], &rays[cut..other_cut], &rays[other_cut..]] {
                    sum += &tally(part);
                }
                assert_eq!(sum, whole, "cut at {cut} and {other_cut}");
            }
        }
    }
}
