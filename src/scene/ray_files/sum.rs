//! Sums of fluxes that do not lose small ones.

/// A sum that keeps what each addition rounds away (Neumaier 1974).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sum {
    sum: f64,
    rounded: f64,
}

impl Sum {
    pub(super) fn add(&mut self, term: f64) {
        let sum = self.sum + term;
        let (large, small) = if self.sum.abs() >= term.abs() { (self.sum, term) } else { (term, self.sum) };
        self.rounded += (large - sum) + small;
        self.sum = sum;
    }

    pub(super) fn value(&self) -> f64 {
        self.sum + self.rounded
    }
}
