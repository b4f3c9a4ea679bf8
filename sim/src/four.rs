//! The four wheels of a robot side by side.
//!
//! What is computed for one wheel is computed for its neighbours, too, so a robot's wheels are the
//! lanes of a vector: the compiler makes vector instructions of these loops where the processor has
//! them, and the results are the same where it has none.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// One number for each wheel of a robot: front left, front right, rear left, rear right.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(32))]
pub(crate) struct Four(pub [f64; 4]);

/// In which lanes two numbers have had different signs.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(32))]
pub(crate) struct Signs([u64; 4]);

impl Signs {
    pub const EQUAL: Self = Self([0; 4]);

    /// And in which these two have.
    #[inline(always)]
    pub fn or(self, a: Four, b: Four) -> Self {
        let lane = |n: usize| self.0[n] | (a.0[n].to_bits() ^ b.0[n].to_bits());
        Self([lane(0), lane(1), lane(2), lane(3)])
    }

    #[inline(always)]
    pub fn all_equal(self) -> bool {
        let [a, b, c, d] = self.0;
        (a | b | c | d) >> 63 == 0
    }
}

/// Taylor's terms of the sine from `x^3`, and of the cosine from `x^2`: within a sixth of a turn to
/// either side, what follows is less than 3e-17.
const SINE: [f64; 8] = reciprocals_of_factorials(3);
const COSINE: [f64; 9] = reciprocals_of_factorials(2);

/// `-1 / first!`, `1 / (first + 2)!`, and so on with alternating signs.
const fn reciprocals_of_factorials<const N: usize>(first: usize) -> [f64; N] {
    let mut terms = [0.0; N];
    let mut factorial = 1.0;
    let mut number = 1;
    while number < first {
        number += 1;
        factorial *= number as f64;
    }
    let mut n = 0;
    while n < N {
        terms[n] = (if n % 2 == 0 { -1.0 } else { 1.0 }) / factorial;
        factorial *= ((number + 1) * (number + 2)) as f64;
        number += 2;
        n += 1;
    }
    terms
}

impl Four {
    pub const ZERO: Self = Self::all(0.0);
    pub const ONE: Self = Self::all(1.0);

    pub const fn all(value: f64) -> Self {
        Self([value; 4])
    }

    #[inline(always)]
    pub fn from_fn(of: impl FnMut(usize) -> f64) -> Self {
        Self(std::array::from_fn(of))
    }

    #[inline(always)]
    pub fn map(self, f: impl Fn(f64) -> f64) -> Self {
        let [a, b, c, d] = self.0;
        Self([f(a), f(b), f(c), f(d)])
    }

    #[inline(always)]
    pub fn zip(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        let ([a, b, c, d], [e, g, h, i]) = (self.0, other.0);
        Self([f(a, e), f(b, g), f(c, h), f(d, i)])
    }

    /// The lanes of `yes` where this is positive, those of `no` elsewhere.
    #[inline(always)]
    pub fn where_positive(self, yes: Self, no: Self) -> Self {
        let lane = |n: usize| {
            let mask = u64::from(self.0[n] > 0.0).wrapping_neg();
            f64::from_bits((yes.0[n].to_bits() & mask) | (no.0[n].to_bits() & !mask))
        };
        Self([lane(0), lane(1), lane(2), lane(3)])
    }

    /// The lanes of `then` where this equals the other, elsewhere 0.
    #[inline(always)]
    pub fn where_equal(self, other: Self, then: Self) -> Self {
        let lane = |n: usize| {
            let mask = u64::from(self.0[n] == other.0[n]).wrapping_neg();
            f64::from_bits(then.0[n].to_bits() & mask)
        };
        Self([lane(0), lane(1), lane(2), lane(3)])
    }

    #[inline(always)]
    pub fn min(self, most: Self) -> Self {
        self.zip(most, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    pub fn max(self, least: Self) -> Self {
        self.zip(least, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    pub fn abs(self) -> Self {
        self.map(f64::abs)
    }

    #[inline(always)]
    pub fn floor(self) -> Self {
        self.map(f64::floor)
    }

    #[inline(always)]
    pub fn sqrt(self) -> Self {
        self.map(f64::sqrt)
    }

    #[inline(always)]
    pub fn any_positive(self) -> bool {
        let [a, b, c, d] = self.0;
        (a > 0.0) | (b > 0.0) | (c > 0.0) | (d > 0.0)
    }

    /// Whether all lanes are the other's.
    #[inline(always)]
    pub fn is(self, other: Self) -> bool {
        let ([a, b, c, d], [e, g, h, i]) = (self.0, other.0);
        (a == e) & (b == g) & (c == h) & (d == i)
    }

    #[inline(always)]
    pub fn sum(self) -> f64 {
        let [a, b, c, d] = self.0;
        (a + b) + (c + d)
    }

    /// The [`sum`](Self::sum)s of two at once.
    #[inline(always)]
    pub fn two_sums(a: Self, b: Self) -> [f64; 2] {
        let ([a0, a1, a2, a3], [b0, b1, b2, b3]) = (a.0, b.0);
        let pairs = [a0 + a1, b0 + b1, a2 + a3, b2 + b3];
        [pairs[0] + pairs[2], pairs[1] + pairs[3]]
    }

    /// Sine and cosine of angles within a sixth of a turn to either side: half a wheel's pitch with
    /// three rollers, the fewest that a wheel has.
    #[inline(always)]
    pub fn sin_cos(self) -> (Self, Self) {
        let square = self * self;
        (
            self + self * series(&SINE, square),
            Self::ONE + series(&COSINE, square),
        )
    }
}

/// The sum of `terms[n] square^(n + 1)`, in pairs, which do not wait for each other.
#[inline(always)]
fn series<const N: usize>(terms: &[f64; N], square: Four) -> Four {
    let fourth = square * square;
    let mut sum = Four::ZERO;
    for pair in terms.chunks(2).rev() {
        sum = sum * fourth
            + match *pair {
                [a, b] => Four::all(a) + square * b,
                [a] => Four::all(a),
                _ => Four::ZERO,
            };
    }
    sum * square
}

impl Add for Four {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
}

impl Sub for Four {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
}

impl Mul for Four {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
}

impl Mul<f64> for Four {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: f64) -> Self {
        self * Self::all(other)
    }
}

impl Div for Four {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
}

impl Neg for Four {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.map(|a| -a)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_and_cosine_are_those_of_the_library() {
        for n in -1000..=1000 {
            let angle = f64::from(n) * 1e-3 * std::f64::consts::FRAC_PI_3;
            let (sin, cos) = Four::all(angle).sin_cos();
            assert!((sin.0[0] - angle.sin()).abs() < 4e-16, "{angle}");
            assert!((cos.0[3] - angle.cos()).abs() < 4e-16, "{angle}");
        }
    }
}
