//! Numbers for references: plain ones, and numbers with their derivatives by eight inputs. The rules here are the
//! textbook's, written apart from the rewriters.

use std::cell::Cell;

/// How many inputs a function has.
pub const NUM_INPUTS: usize = 8;

/// What references compute with.
pub trait Number: Copy {
    fn of(value: f64) -> Self;
    fn value(self) -> f64;
    /// A function of one number, from its value and its slope there.
    fn by(self, value: f64, slope: f64) -> Self;
    fn plus(self, other: Self) -> Self;
    fn times(self, other: Self) -> Self;

    fn negative(self) -> Self {
        self.by(-self.value(), -1.0)
    }
    fn minus(self, other: Self) -> Self {
        self.plus(other.negative())
    }
    fn over(self, other: Self) -> Self {
        let x = other.value();
        self.times(other.by(1.0 / x, -1.0 / (x * x)))
    }
    /// The magnitude. Its slope at 0 is that of positive numbers.
    fn magnitude(self) -> Self {
        if self.value() < 0.0 { self.negative() } else { self }
    }
    /// The first of two equal numbers.
    fn smaller(self, other: Self) -> Self {
        if other.value() < self.value() { other } else { self }
    }
    /// The first of two equal numbers.
    fn larger(self, other: Self) -> Self {
        if other.value() > self.value() { other } else { self }
    }
    /// The square root. Its slope at 0 is 0 by convention: a ray that grazes has no derivative.
    fn root(self) -> Self {
        let root = self.value().sqrt();
        self.by(root, if root > 0.0 { 0.5 / root } else { 0.0 })
    }
    fn exponential(self) -> Self {
        self.by(self.value().exp(), self.value().exp())
    }
    fn logarithm(self) -> Self {
        self.by(self.value().ln(), 1.0 / self.value())
    }
    fn sine(self) -> Self {
        self.by(self.value().sin(), self.value().cos())
    }
    fn cosine(self) -> Self {
        self.by(self.value().cos(), -self.value().sin())
    }
    /// The same value, without derivatives.
    fn constant(self) -> Self {
        Self::of(self.value())
    }
}

impl Number for f64 {
    fn of(value: f64) -> Self {
        value
    }
    fn value(self) -> f64 {
        self
    }
    fn by(self, value: f64, _: f64) -> Self {
        value
    }
    fn plus(self, other: Self) -> Self {
        self + other
    }
    fn times(self, other: Self) -> Self {
        self * other
    }
}

thread_local! {
    /// The largest value or derivative of any intermediate result: what rounding errors are measured by.
    static LARGEST: Cell<f64> = const { Cell::new(0.0) };
}

/// Evaluates, and gives the largest intermediate value or derivative too.
pub fn with_largest<T>(evaluate: impl FnOnce() -> T) -> (T, f64) {
    LARGEST.set(1.0);
    let found = evaluate();
    (found, LARGEST.get())
}

/// A number, and its derivatives by the inputs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dual {
    pub value: f64,
    pub slopes: [f64; NUM_INPUTS],
}

impl Dual {
    /// The inputs themselves.
    pub fn inputs(values: &[f64; NUM_INPUTS]) -> [Dual; NUM_INPUTS] {
        std::array::from_fn(|i| Dual {
            value: values[i],
            slopes: std::array::from_fn(|j| if i == j { 1.0 } else { 0.0 }),
        })
    }

    fn noted(self) -> Self {
        let largest = self.slopes.iter().fold(self.value.abs(), |largest, slope| largest.max(slope.abs()));
        LARGEST.set(LARGEST.get().max(largest));
        self
    }
}

impl Number for Dual {
    fn of(value: f64) -> Self {
        Dual { value, slopes: [0.0; NUM_INPUTS] }
    }
    fn value(self) -> f64 {
        self.value
    }
    fn by(self, value: f64, slope: f64) -> Self {
        // An infinite slope of what does not vary is no slope.
        Dual { value, slopes: self.slopes.map(|s| if s == 0.0 { 0.0 } else { slope * s }) }.noted()
    }
    fn plus(self, other: Self) -> Self {
        let slopes = std::array::from_fn(|i| self.slopes[i] + other.slopes[i]);
        Dual { value: self.value + other.value, slopes }.noted()
    }
    fn times(self, other: Self) -> Self {
        let slopes = std::array::from_fn(|i| self.slopes[i] * other.value + self.value * other.slopes[i]);
        Dual { value: self.value * other.value, slopes }.noted()
    }
}

/// Three numbers.
pub type Three<N> = [N; 3];

pub fn each<N: Number>(a: Three<N>, b: Three<N>, of: impl Fn(N, N) -> N) -> Three<N> {
    std::array::from_fn(|i| of(a[i], b[i]))
}

pub fn dot<N: Number>(a: Three<N>, b: Three<N>) -> N {
    let [x, y, z] = each(a, b, N::times);
    x.plus(y).plus(z)
}

pub fn cross<N: Number>(a: Three<N>, b: Three<N>) -> Three<N> {
    let part = |i: usize, j: usize| a[i].times(b[j]).minus(a[j].times(b[i]));
    [part(1, 2), part(2, 0), part(0, 1)]
}
