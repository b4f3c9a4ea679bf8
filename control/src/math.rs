//! Square roots for the control tick.
//!
//! `core` has none, `libm`'s is a loop over bits (about 120 instructions) on a target it has no
//! special case for, and `micromath`'s is wrong by 6 %. Three Newton steps from the well-known
//! first guess take about 20 instructions and are good to 3e-7 of the value, which a test asserts
//! over the whole range of normal numbers the limiter can meet.

/// One over the square root of a positive normal number, to 3e-7 of the value.
#[inline]
#[must_use]
pub fn inverse_sqrt(value: f32) -> f32 {
    let half = 0.5 * value;
    let mut guess = f32::from_bits(0x5F37_5A86_u32.wrapping_sub(value.to_bits() >> 1));
    for _ in 0..3 {
        guess *= 1.5 - half * guess * guess;
    }
    guess
}

/// The square root of a number that is not negative, to 3e-7 of the value.
#[inline]
#[must_use]
pub fn sqrt(value: f32) -> f32 {
    if value > f32::MIN_POSITIVE {
        value * inverse_sqrt(value)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn square_roots_keep_their_bound() {
        let mut worst = 0.0_f64;
        for bits in (f32::to_bits(1e-20)..f32::to_bits(1e20)).step_by(1009) {
            let value = f32::from_bits(bits);
            let exact = f64::from(value).sqrt();
            worst = worst
                .max((f64::from(sqrt(value)) / exact - 1.0).abs())
                .max((f64::from(inverse_sqrt(value)) * exact - 1.0).abs());
        }
        assert!(worst < 3e-7, "worst {worst:e}");
        assert_eq!(sqrt(0.0), 0.0);
    }
}
