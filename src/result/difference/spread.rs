//! Standard errors of sums from blocks of rays that are independent of each other.
//!
//! Each block r gives sums D_r over n_r rays, of D over n. Rays of one source are independent draws of one distribution, so D_r / n_r has
//! the variance s^2 / n_r. The weighted squares S = sum n_r (D_r / n_r - D / n)^2 of R blocks have the expectation
//! (R - 1) s^2. So n S / (R - 1) estimates the variance of D without bias, whatever the sizes of the blocks, with R - 1
//! degrees of freedom. S is summed up as in West, Updating mean and variance estimates, CACM 22 (1979).

/// Means and squares of several numbers over blocks of rays.
#[derive(Debug, Clone, Default)]
pub struct Spread {
    num_rays: u64,
    num_blocks: u32,
    /// D / n so far, number by number.
    means: Vec<f64>,
    /// S so far.
    squares: Vec<f64>,
    /// Blocks whose sum is not 0.
    lit: Vec<u32>,
}

impl Spread {
    /// Adds a block: what its rays sum up to. A block without a ray says nothing.
    pub fn add(&mut self, num_rays: u64, sums: &[f64]) {
        if num_rays == 0 {
            return;
        }
        self.means.resize(sums.len(), 0.0);
        self.squares.resize(sums.len(), 0.0);
        self.lit.resize(sums.len(), 0);
        self.lit.iter_mut().zip(sums).for_each(|(lit, sum)| *lit += u32::from(*sum != 0.0));
        let (before, of_block) = (self.num_rays as f64, num_rays as f64);
        let all = before + of_block;
        for ((mean, square), sum) in self.means.iter_mut().zip(&mut self.squares).zip(sums) {
            let apart = sum / of_block - *mean;
            *mean += apart * (of_block / all);
            *square += apart * apart * (before * of_block / all);
        }
        self.num_rays += num_rays;
        self.num_blocks += 1;
    }

    /// Blocks with rays.
    pub fn num_blocks(&self) -> u32 {
        self.num_blocks
    }

    /// The number of rays that the sum of this number rests on, if there are fewer rays than blocks. So few rays seldom
    /// share a block. `None` from as many rays on as there are blocks.
    pub(crate) fn rests_on(&self, number: usize) -> Option<u64> {
        self.lit.get(number).filter(|lit| **lit < self.num_blocks).map(|lit| u64::from(*lit))
    }

    /// The standard error of each sum over all rays; none from fewer than two blocks.
    pub fn errors(&self) -> Option<Vec<f64>> {
        let freedom = f64::from(self.num_blocks.checked_sub(1).filter(|freedom| *freedom > 0)?);
        let factor = self.num_rays as f64 / freedom;
        Some(self.squares.iter().map(|square| (square * factor).sqrt()).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn error(blocks: &[(u64, f64)]) -> f64 {
        let mut spread = Spread::default();
        blocks.iter().for_each(|(num_rays, sum)| spread.add(*num_rays, &[*sum]));
        spread.errors().unwrap()[0]
    }

    #[test]
    fn blocks_of_one_ray_are_the_sample_variance() {
        // Deviations -1, 0, 1 from the mean 2: a variance of 1 a ray, of 3 the sum.
        assert_relative_eq!(error(&[(1, 1.0), (1, 2.0), (1, 3.0)]), 3_f64.sqrt());
    }

    #[test]
    fn blocks_that_all_say_the_same_leave_no_doubt() {
        assert_eq!(error(&[(3, 1.5), (1, 0.5), (4, 2.0)]), 0.0);
        assert!(Spread::default().errors().is_none());
        let mut one = Spread::default();
        one.add(5, &[1.0]);
        one.add(0, &[0.0]);
        assert!(one.errors().is_none(), "a single block says nothing");
    }

    #[test]
    fn a_large_block_counts_for_more() {
        // Rates 1 and 3 over 1 and 3 rays: mean 2.5, S = 1 * 2.25 + 3 * 0.25 = 3, and n S / (R - 1) = 12.
        assert_relative_eq!(error(&[(1, 1.0), (3, 9.0)]), 12_f64.sqrt());
    }
}
