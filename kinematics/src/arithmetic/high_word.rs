//! Products of which only the upper word is kept, to the nearest.
//!
//! A number with `a` fractional bits times one with `b` has `a + b - 32` of them. With the numbers
//! scaled so that this is what is wanted, a Cortex-M4 needs one instruction for the product, its
//! rounding and the sum (SMMULR, SMMLAR, SMMLSR), and nothing has to be shifted. Each function is
//! off by half a step at most, as long as its result fits; where it does not, it wraps.

/// Half of what is cut.
const HALF: i64 = 1 << 31;

/// `a b / 2^32`.
#[inline]
pub const fn product(a: i32, b: i32) -> i32 {
    plus_product(0, a, b)
}

/// `c + a b / 2^32`.
#[inline]
pub const fn plus_product(c: i32, a: i32, b: i32) -> i32 {
    upper(wide(c).wrapping_add(a as i64 * b as i64))
}

/// `c - a b / 2^32`.
#[inline]
pub const fn minus_product(c: i32, a: i32, b: i32) -> i32 {
    upper(wide(c).wrapping_sub(a as i64 * b as i64))
}

/// Three coefficients times three numbers, over 2^32.
#[inline]
pub const fn dot(row: &[i32; 3], vector: &[i32; 3]) -> i32 {
    let ([a, b, c], [x, y, z]) = (*row, *vector);
    plus_product(plus_product(product(a, x), b, y), c, z)
}

/// As the upper word, with a half in the lower.
#[inline]
const fn wide(c: i32) -> i64 {
    (c as i64) << 32 | HALF
}

#[inline]
const fn upper(wide: i64) -> i32 {
    (wide >> 32) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn to_the_nearest_with_halves_up() {
        assert_eq!(product(3, 1 << 30), 1);
        assert_eq!(product(3 << 16, 1 << 15), 2);
        assert_eq!(product(-3 << 16, 1 << 15), -1);
        assert_eq!(product(i32::MIN, i32::MIN), 1 << 30);
        assert_eq!(plus_product(7, -5 << 16, 1 << 15), 5);
        assert_eq!(minus_product(7, -5 << 16, 1 << 15), 10);
        assert_eq!(minus_product(i32::MAX, -1 << 30, 4), i32::MIN);
        assert_eq!(dot(&[1 << 30, -1 << 30, 1 << 29], &[4, 8, 16]), 1);
    }
}
