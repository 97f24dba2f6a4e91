//! Splitting as the shaders hold it (shaders/split.wgsl): one invocation follows a launched ray and all its children.

use crate::ir::Sampling;

/// Limits of a launched ray's family.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Splitting {
    /// Rays of fewer events than this are split.
    pub depth: u32,
    /// Rays of a family, at most.
    pub budget: u32,
    /// Of 2^32 families so many may have one ray more.
    pub budget_fraction: u32,
}

impl Splitting {
    /// The limits of a scene.
    pub fn of(sampling: &Sampling) -> Self {
        let budget = sampling.family_budget();
        Splitting {
            depth: sampling.split_depth,
            budget: (budget >> 32) as u32,
            budget_fraction: budget as u32,
        }
    }

    /// Most rays of any family.
    pub fn most_rays(&self) -> u32 {
        self.budget + u32::from(self.budget_fraction > 0)
    }

    /// Most rays that wait at a time: followed depth first, with budgets halved at each split, log2 of the budget.
    pub fn waiting_rays(&self) -> u32 {
        self.most_rays().ilog2().max(1)
    }

    /// Bits of `Ray.index` that hold the position in the dispatch; those above hold the number within the family.
    pub fn index_bits(&self) -> u32 {
        u32::BITS - (self.most_rays() - 1).max(1).ilog2() - 1
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

    fn splitting(split_depth: u32, split_budget: f64) -> Splitting {
        Splitting::of(&Sampling { split_depth, split_budget, ..Sampling::default() })
    }

    /// What a depth-first walk of the tree of halved budgets leaves waiting, and the numbers that it gives out.
    fn walk(budget: u32, number: u32, waiting: u32, numbers: &mut Vec<u32>) -> u32 {
        if budget < 2 {
            numbers.push(number);
            return waiting;
        }
        let kept = budget / 2;
        walk(kept, number, waiting + 1, numbers).max(walk(budget - kept, number + kept, waiting, numbers))
    }

    #[test]
    fn every_number_is_given_once_and_the_waiting_rays_have_room() {
        for budget in 1..200 {
            let splitting = splitting(30, f64::from(budget));
            let mut numbers = Vec::new();
            let waiting = walk(splitting.budget, 0, 0, &mut numbers);
            numbers.sort_unstable();
            assert!(numbers.into_iter().eq(0..budget));
            assert!(waiting <= splitting.waiting_rays(), "{budget}: {waiting}");
        }
    }

    #[test]
    fn numbers_and_positions_share_an_index() {
        for budget in [1.0, 2.0, 2.5, 3.0, 4.0, 4.25, 524_287.5, 524_288.0] {
            let splitting = splitting(30, budget);
            let (number, position) = (splitting.most_rays() - 1, 5);
            let index = position + (number << splitting.index_bits());
            assert_eq!(splitting.parts(index), (position, number), "{budget}");
            assert!((number as f64) < budget);
        }
    }

    #[test]
    fn depth_bounds_the_budget_and_a_family_has_a_ray() {
        assert_eq!(splitting(3, 100.0), splitting(3, 8.0));
        assert_eq!(splitting(3, 0.5).most_rays(), 1);
        assert_eq!(splitting(3, 2.5), Splitting { depth: 3, budget: 2, budget_fraction: 1 << 31 });
    }
}
