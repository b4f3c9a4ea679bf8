//! Sine and cosine with single-precision accuracy at a low cost.
//!
//! `libm`'s `f32` trigonometry computes in double precision, which a Cortex-M4F does in software: 1
//! 250 to 2 200 instructions. The approximations of `micromath` are cheap but off by 1.1e-3, as
//! much as the compensation coefficients that this crate applies. [`sin_cos`] is in between:
//! quadrant reduction in three exact steps, two short polynomials, single precision only.
//!
//! Error: at most 1e-7 absolute for |angle| <= [`SIN_COS_RANGE`], asserted by a test over the whole
//! range. Outside it, and for a NaN, the result is NaN: a heading that large has no significant
//! digits.

/// Largest angle [`sin_cos`] takes, rad.
pub const SIN_COS_RANGE: f32 = 8192.0;

/// Sine and cosine of an angle in rad, to 1e-7 absolute within ±[`SIN_COS_RANGE`]; NaN outside.
#[must_use]
// On a robot once: its callers there prepare something, the tick calls `sin_cos_within`.
#[cfg_attr(target_os = "none", inline(never))]
#[cfg_attr(not(target_os = "none"), inline)]
pub fn sin_cos(angle: f32) -> (f32, f32) {
    if angle.is_nan() || angle.abs() > SIN_COS_RANGE {
        (f32::NAN, f32::NAN)
    } else {
        sin_cos_within(angle)
    }
}

/// The same without looking: nonsense outside the range.
#[inline]
pub(crate) fn sin_cos_within(angle: f32) -> (f32, f32) {
    // pi/2 in three parts. The first two have 8 and 11 significant bits, so that a quadrant number
    // of up to 13 bits times either is exact in 24.
    const HALF_PI_1: f32 = 1.570_312_5;
    const HALF_PI_2: f32 = 4.837_513e-4;
    const HALF_PI_3: f32 = 7.549_79e-8;
    // Adding 1.5 * 2^23 rounds to the nearest integer and leaves it in the low mantissa bits.
    const ROUNDER: f32 = 12_582_912.0;

    let shifted = angle * core::f32::consts::FRAC_2_PI + ROUNDER;
    let quadrant = shifted.to_bits();
    let quadrants = shifted - ROUNDER;
    let rest = ((angle - quadrants * HALF_PI_1) - quadrants * HALF_PI_2) - quadrants * HALF_PI_3;

    // Chebyshev fits over |rest| <= 0.7855, errors 1e-8 (sine) and 1e-9 (cosine).
    let square = rest * rest;
    let sine = rest
        + rest * square * (-0.166_666_64 + square * (0.008_332_748 + square * -0.000_195_878_25));
    let cosine = 1.0
        - (0.5 * square
            - square
                * square
                * (0.041_666_664 + square * (-0.001_388_830_2 + square * 2.454_787_7e-5)));

    let (sine, cosine) = if quadrant & 1 == 0 {
        (sine, cosine)
    } else {
        (cosine, sine)
    };
    // Quadrants 2 and 3 turn the sine around, 1 and 2 the cosine.
    let sine_sign = (quadrant & 2) << 30;
    let cosine_sign = (quadrant.wrapping_add(1) & 2) << 30;
    (
        f32::from_bits(sine.to_bits() ^ sine_sign),
        f32::from_bits(cosine.to_bits() ^ cosine_sign),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The stated bound of [`sin_cos`].
    const BOUND: f64 = 1e-7;

    #[test]
    fn sin_cos_keeps_its_bound_over_the_whole_range() {
        let mut worst = 0.0_f64;
        let last = SIN_COS_RANGE.to_bits();
        // Every 41st float from 0 to the end of the range, both signs: 60 million angles.
        for bits in (0..=last).step_by(41) {
            let angle = f32::from_bits(bits);
            let (sine, cosine) = sin_cos(angle);
            let (want_sine, want_cosine) = f64::from(angle).sin_cos();
            worst = worst
                .max((f64::from(sine) - want_sine).abs())
                .max((f64::from(cosine) - want_cosine).abs());
            let (mirrored, same) = sin_cos(-angle);
            assert!(
                mirrored == -sine && same == cosine,
                "odd and even at {angle}"
            );
        }
        assert!(worst <= BOUND, "worst error {worst:e}");
    }

    #[test]
    fn sin_cos_refuses_what_has_no_digits_left() {
        for angle in [8193.0, f32::INFINITY, f32::NEG_INFINITY, f32::NAN] {
            assert!(sin_cos(angle).0.is_nan() && sin_cos(angle).1.is_nan());
        }
    }
}
