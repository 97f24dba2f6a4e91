//! Standard errors between rounds of rays, for light so faint that the squares of single weights are lost in rounding.

use crate::result::Tally;
use crate::run::TraceOptions;
use std::collections::BTreeMap;

/// Rounds of a trace, and their rays.
const ROUNDS: u64 = 64;
const FEWEST_RAYS: u64 = 1 << 12;
const MOST_RAYS: u64 = 1 << 17;

/// Light by its part, after each round \[quanta\]. A round is a pass of one dispatch.
#[derive(Debug)]
pub(super) struct Rounds<K> {
    /// Rays so far.
    pub num_rays: u64,
    launched: Vec<f64>,
    light: Vec<BTreeMap<K, f64>>,
}

impl<K> Default for Rounds<K> {
    fn default() -> Self {
        Rounds { num_rays: 0, launched: Vec::new(), light: Vec::new() }
    }
}

/// The options of a trace in rounds, whose passes must have no time limit.
pub(super) fn in_rounds(options: TraceOptions) -> TraceOptions {
    let of_round = (options.num_rays / ROUNDS).clamp(FEWEST_RAYS, MOST_RAYS);
    TraceOptions { batch_size: Some(of_round as u32), ..options }
}

impl<K: Ord> Rounds<K> {
    /// Adds a round, after which the sums are these, and the light in them.
    pub fn add(&mut self, tally: &Tally, light: BTreeMap<K, f64>) {
        // Where paths turned out to be too many for the table, the trace began anew.
        if tally.launched.count <= self.num_rays {
            *self = Rounds::default();
        }
        self.num_rays = tally.launched.count;
        self.launched.push(tally.launched.quanta as f64);
        self.light.push(light);
    }

    /// The number of rounds.
    pub fn len(&self) -> usize {
        self.light.len()
    }

    /// What there is light of.
    pub fn keys(&self) -> impl Iterator<Item = &K> {
        self.light.last().into_iter().flat_map(BTreeMap::keys)
    }

    /// The share of the launched light, and its standard error between rounds (Cochran, Sampling Techniques, 1977, section 6.3: a
    /// ratio of means).
    pub fn share(&self, key: &K) -> [f64; 2] {
        let after = |round: usize| self.light[round].get(key).copied().unwrap_or(0.0);
        let (Some(last), Some(&all)) = (self.light.len().checked_sub(1), self.launched.last()) else {
            return [0.0; 2];
        };
        let share = after(last) / all;
        let (mut before, mut squares) = ([0.0, 0.0], 0.0);
        for round in 0..=last {
            let here = [after(round), self.launched[round]];
            squares += (here[0] - before[0] - share * (here[1] - before[1])).powi(2);
            before = here;
        }
        let count = self.light.len() as f64;
        let variance = squares * count / (count - 1.0).max(1.0);
        [share, variance.sqrt() / all]
    }
}
