//! The angle of a wheel's ground roller, as an integer that wraps when the next roller touches
//! down.
//!
//! One pitch, from roller to roller, is 2^32 steps. Zero is the middle of a roller, and the integer
//! wraps from its largest to its smallest value at the roller transition: folding an angle into ±
//! half a pitch needs no instruction, for any distance.

use crate::arithmetic::Real;
use crate::error::GeometryError;

/// Bits behind the point of a `f64`'s mantissa, and what its exponent is too large by.
const MANTISSA: u32 = 52;
const BIAS: i32 = 1023;

/// How far a wheel has rolled on past the middle of its ground roller: 2^-32 of a pitch, within ±
/// half a pitch.
///
/// ```
/// use mecanum_kinematics::{RollerAngle, Rollers};
///
/// let eight = Rollers::<f64>::new(8)?;
/// // Four tenths of a pitch further than three tenths is three tenths before the middle of the
/// // next roller.
/// let start = RollerAngle::new(0.3 * eight.pitch(), &eight);
/// let later = start.advanced(RollerAngle::new(0.4 * eight.pitch(), &eight));
/// assert!((later.sweep(&eight) + 0.3 * eight.pitch()).abs() < 1e-9);
/// # Ok::<(), mecanum_kinematics::GeometryError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RollerAngle(i32);

impl RollerAngle {
    /// From a wheel angle since a roller's middle, rad; whole pitches are taken out. Not finite
    /// counts as zero.
    #[must_use]
    pub fn new<S: Real>(angle: S, rollers: &crate::Rollers<S>) -> Self {
        Self((angle / rollers.pitch()).to_fraction())
    }

    /// From the integer.
    #[must_use]
    pub const fn from_bits(bits: i32) -> Self {
        Self(bits)
    }

    /// The integer, 2^-32 of a pitch.
    #[must_use]
    pub const fn to_bits(self) -> i32 {
        self.0
    }

    /// The angle, rad, within ± half a pitch.
    #[must_use]
    pub fn sweep<S: Real>(self, rollers: &crate::Rollers<S>) -> S {
        S::from_fraction(self.0) * rollers.pitch()
    }

    /// The sum of both, folded.
    #[must_use]
    #[inline]
    pub const fn advanced(self, by: Self) -> Self {
        Self(self.0.wrapping_add(by.0))
    }
}

/// Follows a wheel's roller angle by its encoder counts, without ever losing a step.
///
/// It keeps 2^-64 of a pitch. A count is that many steps, rounded once; the rounding adds up to a
/// millionth of a pitch after 10^13 counts.
///
/// ```
/// use mecanum_kinematics::{RollerAngle, RollerTrack};
///
/// // Eight rollers and 40000 counts a turn: 5000 counts a pitch.
/// let mut track = RollerTrack::new(8, 40_000.0)?;
/// track.set(RollerAngle::from_bits(0));
/// for _ in 0..5_000 {
///     track.advance(-1);
/// }
/// assert!(track.angle().to_bits().abs() <= 1); // a whole pitch back: the next roller's middle
/// # Ok::<(), mecanum_kinematics::GeometryError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RollerTrack {
    angle: u64,
    /// Steps of 2^-64 pitches in a count.
    per_count: i64,
}

impl RollerTrack {
    /// For a wheel with this many rollers and encoder counts (quadrature, at the wheel) a turn;
    /// counts that go down when the wheel rolls forward are given as negative.
    ///
    /// # Errors
    ///
    /// [`GeometryError::NotPositive`] for fewer than three rollers; for counts of less than four a
    /// pitch, which could not resolve the angle of a roller; and for so many that one is less than
    /// half a step of 2^-64 pitches. [`GeometryError::NotFinite`] for counts that are no finite
    /// number.
    pub fn new(rollers: u16, counts_per_turn: f64) -> Result<Self, GeometryError> {
        if rollers < 3 {
            return Err(GeometryError::NotPositive("rollers - 2"));
        }
        // Magnitudes in the order of their bits, which takes no double precision.
        let least = f64::from(4 * u32::from(rollers)).to_bits();
        if !counts_per_turn.is_finite() {
            return Err(GeometryError::NotFinite("counts_per_turn"));
        }
        if counts_per_turn.abs().to_bits() < least {
            return Err(GeometryError::NotPositive("counts a roller - 3"));
        }
        let steps = steps_per_count(rollers, counts_per_turn);
        if steps == 0 {
            return Err(GeometryError::NotPositive("pitches a count"));
        }
        let per_count = if counts_per_turn.is_sign_negative() {
            -steps
        } else {
            steps
        };
        Ok(Self {
            angle: 0,
            per_count,
        })
    }

    /// The wheel went on by this many counts.
    #[inline]
    pub const fn advance(&mut self, counts: i32) {
        self.angle = self
            .angle
            .wrapping_add((counts as i64).wrapping_mul(self.per_count).cast_unsigned());
    }

    /// Says what the angle is now.
    pub const fn set(&mut self, angle: RollerAngle) {
        self.angle = (angle.0.cast_unsigned() as u64) << 32;
    }

    /// The angle now.
    #[must_use]
    #[inline]
    pub const fn angle(&self) -> RollerAngle {
        RollerAngle((self.angle >> 32) as u32 as i32)
    }
}

/// `rollers / counts` in steps of 2^-64, to the nearest; at most a quarter. By long division,
/// because that is exact and a Cortex-M4F has double precision in software only.
const fn steps_per_count(rollers: u16, counts: f64) -> i64 {
    let bits = counts.to_bits();
    let exponent = (bits >> MANTISSA & 0x7FF) as i32 - BIAS - MANTISSA as i32;
    let divisor = bits & ((1 << MANTISSA) - 1) | 1 << MANTISSA;
    let (mut steps, mut rest) = (0_u64, rollers as u64);
    // One bit more than wanted, to round by.
    let mut place = 65 - exponent;
    while place > 0 {
        rest <<= 1;
        steps <<= 1;
        if rest >= divisor {
            rest -= divisor;
            steps |= 1;
        }
        place -= 1;
    }
    ((steps + 1) >> 1) as i64
}
