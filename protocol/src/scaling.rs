//! From SI to the integers on the wire and back, once, at this edge.
//!
//! Every scaled field is a signed integer times a least significant bit. Encoding rounds to
//! nearest (halves away from zero) and saturates at the largest magnitude that is *not* the
//! invalid pattern; the most negative integer is reserved for "invalid" and is what a NaN becomes.
//! The error of a value in range is therefore at most half an LSB, which a test asserts. (Beyond
//! 420 m an `f32` itself has coarser steps than a pose; the error is one LSB there.)

/// Steps per m/s in a twist field: one LSB is 0.1 mm/s, the range is +-3.2767 m/s.
pub const VELOCITY_STEPS: f32 = 10_000.0;

/// Steps per rad/s in a twist field: one LSB is 0.1 mrad/s, the range is +-3.2767 rad/s.
pub const YAW_RATE_STEPS: f32 = 10_000.0;

/// The largest magnitude of a component of a twist in a frame, m/s or rad/s: 3.2767. A group cannot
/// be commanded more.
pub const TWIST_MAX: f64 = i16::MAX as f64 / 1e4;

/// Steps per rad/s of a wheel rate: one LSB is 2 mrad/s, the range +-65.534 rad/s.
pub const WHEEL_RATE_STEPS: f32 = 500.0;

/// Steps per rad/s of the magnitude of a slip residual: one LSB is 20 mrad/s, the range 0 to 5.08
/// rad/s.
pub const SLIP_STEPS: f32 = 50.0;

/// Steps per metre of a pose field: one LSB is 0.1 mm, the range is +-838.8607 m.
pub const POSITION_STEPS: f32 = 10_000.0;

/// Steps per radian of a heading: one LSB is 0.1 mrad. A heading in (-pi, pi] always fits.
pub const HEADING_STEPS: f32 = 10_000.0;

/// The bit pattern of an invalid magnitude of 8 bits.
pub const INVALID_U8: u8 = u8::MAX;

/// The bit pattern of an invalid 16-bit field.
pub const INVALID_I16: i16 = i16::MIN;

/// The bit pattern of an invalid 24-bit field.
pub const INVALID_I24: i32 = -0x80_0000;

const MAX_I24: i32 = 0x7F_FFFF;

/// Nearest integer to `value` after saturating it at `±limit`, halves away from zero; `None` for
/// NaN. The limit is at most [`MAX_I24`].
///
/// From the bits of the float: each of some ten operations with it is a call on a core without a
/// floating-point unit, and the others take as many instructions either way.
#[expect(clippy::cast_possible_wrap, reason = "at most 2^24")]
fn nearest(value: f32, limit: i32) -> Option<i32> {
    /// Exponent of a float whose digits are whole numbers: at least 2^23.
    const WHOLE: u32 = 127 + 23;
    let bits = value.to_bits();
    let magnitude = bits & 0x7FFF_FFFF;
    let (exponent, digits) = (magnitude >> 23, (magnitude & 0x007F_FFFF) | 0x0080_0000);
    let steps = if exponent >= WHOLE {
        if magnitude > f32::INFINITY.to_bits() {
            return None;
        }
        limit
    } else {
        // Less than a half has no digit left after a shift by 25.
        let shift = (WHOLE - exponent).min(25);
        let steps = (digits + (1 << (shift - 1))) >> shift;
        (steps as i32).min(limit)
    };
    let sign = bits.cast_signed() >> 31;
    Some((steps ^ sign) - sign)
}

/// The magnitude of `value` in steps, rounded to nearest and saturated to 254; NaN becomes
/// [`INVALID_U8`].
#[must_use]
pub fn encode_magnitude(value: f32, steps: f32) -> u8 {
    nearest(value.abs() * steps, i32::from(INVALID_U8) - 1)
        .and_then(|steps| u8::try_from(steps).ok())
        .unwrap_or(INVALID_U8)
}

/// `raw` steps as a number, or `None` when the field is marked invalid.
#[must_use]
pub fn decode_magnitude(raw: u8, steps: f32) -> Option<f32> {
    (raw != INVALID_U8).then(|| f32::from(raw) / steps)
}

/// `value` in steps, rounded to nearest and saturated to +-32767; NaN becomes [`INVALID_I16`].
#[must_use]
pub fn encode_i16(value: f32, steps: f32) -> i16 {
    nearest(value * steps, i32::from(i16::MAX))
        .and_then(|steps| i16::try_from(steps).ok())
        .unwrap_or(INVALID_I16)
}

/// `raw` steps as a number, or `None` when the field is marked invalid.
#[must_use]
pub fn decode_i16(raw: i16, steps: f32) -> Option<f32> {
    (raw != INVALID_I16).then(|| f32::from(raw) / steps)
}

/// `value` in steps, rounded to nearest and saturated to +-8388607; NaN becomes [`INVALID_I24`].
#[must_use]
pub fn encode_i24(value: f32, steps: f32) -> i32 {
    nearest(value * steps, MAX_I24).unwrap_or(INVALID_I24)
}

/// `raw` steps as a number, or `None` when the field is marked invalid.
#[must_use]
pub fn decode_i24(raw: i32, steps: f32) -> Option<f32> {
    // Every 24-bit integer is exact in an f32.
    (raw != INVALID_I24).then(|| raw as f32 / steps)
}

/// The three little-endian bytes of a 24-bit integer.
#[must_use]
pub const fn i24_to_bytes(value: i32) -> [u8; 3] {
    let [a, b, c, _] = value.to_le_bytes();
    [a, b, c]
}

/// The sign-extended integer in three little-endian bytes.
#[must_use]
pub const fn i24_from_bytes([a, b, c]: [u8; 3]) -> i32 {
    i32::from_le_bytes([0, a, b, c]) >> 8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_to_nearest_and_not_towards_zero() {
        assert_eq!(encode_i16(0.000_149, VELOCITY_STEPS), 1);
        assert_eq!(encode_i16(0.000_151, VELOCITY_STEPS), 2);
        assert_eq!(encode_i16(-0.000_149, VELOCITY_STEPS), -1);
        assert_eq!(encode_i16(-0.000_151, VELOCITY_STEPS), -2);
        assert_eq!(nearest(2.5, 9), Some(3));
        assert_eq!(nearest(-2.5, 9), Some(-3));
        // Adding a half and truncating would make a one of this.
        assert_eq!(nearest(0.499_999_97, 9), Some(0));
    }

    #[test]
    fn saturates_short_of_the_invalid_pattern() {
        assert_eq!(encode_i16(4.0, VELOCITY_STEPS), 32767);
        assert_eq!(encode_i16(-4.0, VELOCITY_STEPS), -32767);
        assert_eq!(encode_i16(f32::INFINITY, VELOCITY_STEPS), 32767);
        assert_eq!(encode_i16(f32::NEG_INFINITY, VELOCITY_STEPS), -32767);
        assert_eq!(encode_i24(-1e9, POSITION_STEPS), -8_388_607);
        assert_eq!(encode_i24(1e9, POSITION_STEPS), 8_388_607);
    }

    #[test]
    fn rounds_every_number_it_may_meet_as_the_standard_library_does() {
        // `f32::round`, which `core` lacks: halves away from zero.
        for bits in (0..=f32::to_bits(MAX_I24 as f32)).step_by(97) {
            let value = f32::from_bits(bits);
            assert_eq!(nearest(value, MAX_I24), Some(value.round() as i32));
            assert_eq!(nearest(-value, MAX_I24), Some(-(value.round() as i32)));
        }
    }

    #[test]
    fn not_a_number_is_invalid_and_comes_back_as_none() {
        assert_eq!(encode_i16(f32::NAN, VELOCITY_STEPS), i16::MIN);
        assert_eq!(decode_i16(i16::MIN, VELOCITY_STEPS), None);
        assert_eq!(encode_i24(f32::NAN, POSITION_STEPS), INVALID_I24);
        assert_eq!(decode_i24(INVALID_I24, POSITION_STEPS), None);
    }

    #[test]
    fn error_is_at_most_half_a_step() {
        // Half a step, plus the rounding of the f32 itself near 3.2.
        let bound = 0.5e-4 + 3e-7;
        for i in -32_000_i16..32_000 {
            let value = f32::from(i) * 1.0237e-4 * 0.97;
            let back = decode_i16(encode_i16(value, VELOCITY_STEPS), VELOCITY_STEPS).unwrap();
            assert!((back - value).abs() <= bound, "{value} came back as {back}");
        }
    }

    #[test]
    fn every_integer_survives_the_way_there_and_back() {
        for raw in -32767..=32767_i16 {
            let value = decode_i16(raw, VELOCITY_STEPS).unwrap();
            assert_eq!(encode_i16(value, VELOCITY_STEPS), raw);
        }
        for raw in (-8_388_607..=8_388_607_i32).step_by(97) {
            assert_eq!(i24_from_bytes(i24_to_bytes(raw)), raw);
            let value = decode_i24(raw, POSITION_STEPS).unwrap();
            let back = encode_i24(value, POSITION_STEPS);
            // Up to 2^22 steps an f32 resolves half a step.
            let bound = i32::from(raw.abs() >= 1 << 22);
            assert!((back - raw).abs() <= bound, "{raw} came back as {back}");
        }
    }
}
