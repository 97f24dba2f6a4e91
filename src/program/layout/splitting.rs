//! Splitting as the shaders hold it (shaders/stages/split.wgsl): one invocation follows a launched ray and all its children.

use crate::model::Sampling;

/// Limits of a launched ray's family.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Splitting {
    /// Rays of fewer events than this are split.
    pub depth: u32,
    /// Rays of a family that are alive at a time, at most.
    pub budget: u32,
    /// Of 2^32 families so many may have one ray more.
    pub budget_fraction: u32,
}

impl Splitting {
    /// The limits of a scene. A family has a ray, and no more can be alive than one and one for each event.
    pub fn of(sampling: &Sampling) -> Self {
        let depth = sampling.split_depth;
        let budget = sampling.split_budget.clamp(1.0, f64::from(depth) + 1.0);
        Splitting {
            depth,
            budget: budget.trunc() as u32,
            budget_fraction: (budget.fract() * 4294967296.0) as u32,
        }
    }

    /// Most rays that are alive at a time.
    fn most_alive(&self) -> u32 {
        self.budget + u32::from(self.budget_fraction > 0)
    }

    /// Most rays that wait at a time.
    pub fn waiting_rays(&self) -> u32 {
        (self.most_alive() - 1).max(1)
    }

    /// Most rays of any family, including rays that have ended. A ray with so many waiting is not split. So a lineage
    /// was reflected at fewer than `most_alive` splits.
    pub fn most_rays(&self) -> u64 {
        let mut choices = 1;
        (0..u64::from(self.most_alive().min(self.depth + 1)))
            .map(|reflected| {
                let ways = choices;
                choices = choices * (u64::from(self.depth) - reflected) / (reflected + 1);
                ways
            })
            .sum()
    }

    /// Bits of `Ray.index` that hold the position in the dispatch; those above hold the number within the family.
    pub fn index_bits(&self) -> u32 {
        u32::BITS - self.depth
    }

    /// Position in the dispatch, and number within the family, of an index.
    pub fn parts(&self, index: u32) -> (u32, u32) {
        let bits = self.index_bits();
        (index & ((1 << bits) - 1), index >> bits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn splitting(split_depth: u32, split_budget: f64) -> Splitting {
        Splitting::of(&Sampling { split_depth, split_budget, ..Sampling::default() })
    }

    /// A depth-first walk of a family that is split at every event: its numbers, and the most that waited.
    fn walk(of: &Splitting, budget: u32, bounce: u32, number: u32, family: &mut BTreeSet<u32>) -> u32 {
        if budget < 2 || bounce == of.depth {
            assert!(family.insert(number), "{number} twice");
            return 0;
        }
        let reflected = walk(of, budget - 1, bounce + 1, number, family);
        let transmitted = walk(of, budget, bounce + 1, number | 1 << bounce, family);
        transmitted.max(1 + reflected)
    }

    #[test]
    fn numbers_are_unique_and_the_limits_are_reached_and_kept() {
        for depth in 1..12 {
            for budget in 1..14 {
                let splitting = splitting(depth, f64::from(budget));
                let mut family = BTreeSet::new();
                let waiting = walk(&splitting, splitting.budget, 0, 0, &mut family);
                assert_eq!(family.len() as u64, splitting.most_rays(), "{splitting:?}");
                assert_eq!(waiting.max(1), splitting.waiting_rays(), "{splitting:?}");
            }
        }
    }

    #[test]
    fn numbers_and_positions_share_an_index() {
        for depth in [1, 2, 7, Sampling::MAX_SPLIT_DEPTH] {
            let splitting = splitting(depth, 4.0);
            let number = (1 << depth) - 1;
            let index = 5 + (number << splitting.index_bits());
            assert_eq!(splitting.parts(index), (5, number), "{depth}");
        }
    }

    #[test]
    fn depth_bounds_the_budget_and_a_family_has_a_ray() {
        assert_eq!(splitting(3, 100.0), splitting(3, 4.0));
        assert_eq!(splitting(3, 0.5).most_rays(), 1);
        assert_eq!(splitting(3, 2.5), Splitting { depth: 3, budget: 2, budget_fraction: 1 << 31 });
        assert_eq!(splitting(Sampling::MAX_SPLIT_DEPTH, 1e6).most_rays(), 1 << Sampling::MAX_SPLIT_DEPTH);
    }
}
