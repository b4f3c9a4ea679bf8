//! How a duty becomes levels at the two inputs of a bridge: a PWM and a direction.
//!
//! # Theory of operation
//!
//! Every kind of bridge needs, for a duty `u` from -1 to 1, a share of the period for which the PWM
//! is high and a level of the direction output:
//!
//! | kind | forward and still, `u >= 0` | backward, `u < 0` | no voltage |
//! |---|---|---|---|
//! | PWM and direction | PWM `u`, direction high | PWM `-u`, direction low | PWM low |
//! | IN/IN, slow decay | PWM `u`, direction low | PWM `1 + u`, direction high | both inputs equal |
//! | locked antiphase | PWM `(1 + u) / 2` | the same | PWM high for half the period |
//!
//! With two PWMs a wheel the second takes the direction's place:
//!
//! | kind | forward and still, `u >= 0` | backward, `u < 0` | no voltage |
//! |---|---|---|---|
//! | IN/IN, fast decay | IN1 `u`, IN2 low | IN1 low, IN2 `-u` | both low |
//! | IN/IN, brake between | IN1 high, IN2 `1 - u` | IN1 `1 + u`, IN2 high | both high |
//!
//! A duty is converted to whole steps of 2^-24, the resolution of a float near 1 and of the
//! fixed-point duty, so both continue with the same integers.
//!
//! All kinds are one formula: the clocks of the duty are added to a base or subtracted from it.
//! [`Pattern`] holds base and sign for either direction. They are computed when the robot is
//! configured, so a control tick takes the same instructions for every kind. Of two PWMs, the one
//! that the duty does not change is at its value for a duty of zero.
//!
//! # Interface
//!
//! In each tick the board calls [`Pattern::high`] and [`Pattern::back`] for each wheel, and
//! [`Pattern::direction`] for each port; with two PWMs a wheel, [`Pattern::pair`] alone. A duty
//! that is not a number gives no voltage in any kind.
//!
//! # Limits
//!
//! The voltage is duty times supply only where the bridge shorts the motor while it does not drive
//! it. IN/IN bridges that coast when both inputs are low need a second PWM, and the kind that has
//! both high in between ([`OutputStage::BrakeBetween`]).

use crate::quantity::Drive;
use crate::smart_drive::frames::Model;

/// Fractional bits of a duty in steps.
const STEP_BITS: u32 = 24;
/// A duty of 1 in steps.
const WHOLE: u32 = 1 << STEP_BITS;

/// A duty in steps; none for what is not a number.
#[cfg(feature = "fixed-point")]
#[inline(always)]
#[must_use]
pub const fn steps(duty: Drive) -> i32 {
    const { assert!(Drive::FRACTION == STEP_BITS) };
    duty.to_bits()
}

/// A duty in steps; none for what is not a number.
#[cfg(not(feature = "fixed-point"))]
#[inline(always)]
#[must_use]
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "the ends for what lies beyond, zero for a NaN"
)]
pub fn steps(duty: Drive) -> i32 {
    (duty.to_f32() * const { WHOLE as f32 }) as i32
}

/// How a wheel is driven, with the numbers of object 0x2027:6.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[repr(u8)]
pub enum OutputStage {
    /// Sign-magnitude: PWM and direction, and the direction's inverse beside it where the board has
    /// it, for bridges with PWM, IN1 and IN2.
    #[default]
    PwmDirection = 0,
    /// PWM on IN1, direction on IN2; both inputs equal short the motor.
    SlowDecay = 1,
    /// Two PWMs: on one input by direction, and the other low.
    FastDecay = 2,
    /// High drives forward, low drives backward.
    LockedAntiphase = 3,
    /// No bridge of the board's: C620 drives on a CAN bus of their own ([`crate::smart_drive`]).
    C620 = 4,
    /// The same with C610 drives.
    C610 = 5,
    /// Two PWMs: one input high by direction, the other low while the motor is driven; both high
    /// short it.
    BrakeBetween = 6,
}

impl OutputStage {
    /// The kind with this number, which must be one of the object's.
    #[must_use]
    pub const fn from_number(number: u32) -> Self {
        match number {
            1 => Self::SlowDecay,
            2 => Self::FastDecay,
            3 => Self::LockedAntiphase,
            4 => Self::C620,
            5 => Self::C610,
            6 => Self::BrakeBetween,
            _ => Self::PwmDirection,
        }
    }

    /// The kind of smart drive, where it is one.
    #[must_use]
    pub const fn smart_drive(self) -> Option<Model> {
        match self {
            Self::C620 => Some(Model::C620),
            Self::C610 => Some(Model::C610),
            Self::PwmDirection
            | Self::SlowDecay
            | Self::FastDecay
            | Self::LockedAntiphase
            | Self::BrakeBetween => None,
        }
    }

    /// Whether it needs two PWMs a wheel. Then all outputs low is no voltage at any time.
    #[must_use]
    pub const fn has_two_pwms(self) -> bool {
        matches!(self, Self::FastDecay | Self::BrakeBetween)
    }

    /// Its bit in a mask of kinds.
    #[must_use]
    pub const fn bit(self) -> u8 {
        1 << self as u8
    }
}

/// One direction: clocks from which to count, and all bits set where to count down.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Half {
    base: u32,
    flip: u32,
}

/// The levels of one kind at one PWM frequency.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Pattern {
    /// Clocks of a duty of 1.
    span: u16,
    /// Forward and still, backward.
    halves: [Half; 2],
    /// By how many bits a word for the direction outputs is turned: 16 swaps the halves of a set
    /// and reset register, and so the levels.
    turn: u32,
}

impl Pattern {
    /// For a PWM with a period of so many timer clocks.
    #[must_use]
    pub fn new(stage: OutputStage, period: u16) -> Self {
        let clocks = u32::from(period);
        let up = |base| Half { base, flip: 0 };
        // The complement of a number is one less than its negative.
        let down = |base: u32| Half {
            base: base.wrapping_add(1),
            flip: u32::MAX,
        };
        let (span, halves, turn) = match stage {
            OutputStage::PwmDirection | OutputStage::FastDecay => (period, [up(0), up(0)], 0),
            OutputStage::SlowDecay => (period, [up(0), down(clocks)], 16),
            OutputStage::LockedAntiphase => (period / 2, [up(clocks / 2), down(clocks / 2)], 0),
            OutputStage::BrakeBetween => (period, [down(clocks), down(clocks)], 0),
            // The PWM stays low.
            OutputStage::C620 | OutputStage::C610 => (0, [up(0), up(0)], 0),
        };
        Self { span, halves, turn }
    }

    /// Timer clocks for which the PWM is high at a duty in [`steps`]; the whole period is always
    /// high.
    #[inline(always)]
    #[must_use]
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the value is between 0 and the period, which fits"
    )]
    pub fn high(&self, duty: i32) -> u32 {
        let share = duty.unsigned_abs().min(WHOLE);
        let steps = u64::from(share) * u64::from(self.span) + u64::from(WHOLE / 2);
        let clocks = (steps >> STEP_BITS) as u32;
        let [ahead, back] = &self.halves;
        let half = if Self::back(duty) == 0 { ahead } else { back };
        (clocks ^ half.flip).wrapping_add(half.base)
    }

    /// Timer clocks for which the first and the second PWM of a wheel are high, in a kind with two.
    #[inline(always)]
    #[must_use]
    pub fn pair(&self, duty: i32) -> [u32; 2] {
        let [ahead, _] = &self.halves;
        let (still, driven) = (ahead.flip.wrapping_add(ahead.base), self.high(duty));
        // Which input is driven low is the opposite of which is driven high.
        let is_first = (Self::back(duty) == 0) == (ahead.flip == 0);
        if is_first {
            [driven, still]
        } else {
            [still, driven]
        }
    }

    /// By how many bits a word that sets a direction output is shifted, so that it resets it where
    /// a duty is backward: 16, and 0 for forward and none.
    #[inline(always)]
    #[must_use]
    pub const fn back(duty: i32) -> u32 {
        if duty < 0 { 16 } else { 0 }
    }

    /// The word for a port's set and reset register, from the one that sets a direction output
    /// where [`Pattern::back`] is 0.
    #[inline(always)]
    #[must_use]
    pub const fn direction(&self, forward_high: u32) -> u32 {
        forward_high.rotate_right(self.turn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: u16 = 9000;
    /// A whole clock is rounded.
    const CLOCK: f32 = 0.5 / 9000.0 + 1e-6;

    /// Share of the period and level of the direction output.
    fn levels(stage: OutputStage, duty: f32) -> (f32, bool) {
        let pattern = Pattern::new(stage, PERIOD);
        let duty = steps(Drive::new(duty));
        let word = 1 << Pattern::back(duty);
        let high = pattern.direction(word) == 1;
        (pattern.high(duty) as f32 / f32::from(PERIOD), high)
    }

    /// What the bridge for which a kind is meant makes of them, over the supply.
    fn voltage(stage: OutputStage, duty: f32) -> f32 {
        let (pwm, high) = levels(stage, duty);
        match stage {
            OutputStage::FastDecay => unreachable!("it has two PWMs"),
            OutputStage::PwmDirection => {
                if high {
                    pwm
                } else {
                    -pwm
                }
            }
            // Two half bridges: each output follows its input.
            OutputStage::SlowDecay => pwm - if high { 1.0 } else { 0.0 },
            OutputStage::LockedAntiphase => 2.0 * pwm - 1.0,
            OutputStage::C620 | OutputStage::C610 => 0.0,
            OutputStage::BrakeBetween => unreachable!("it has two PWMs"),
        }
    }

    const KINDS: [OutputStage; 3] = [
        OutputStage::PwmDirection,
        OutputStage::SlowDecay,
        OutputStage::LockedAntiphase,
    ];

    #[test]
    fn the_voltage_is_the_duty_times_the_supply() {
        for stage in KINDS {
            for step in -120_i8..=120 {
                let duty = f32::from(step) / 100.0;
                let got = voltage(stage, duty);
                let want = duty.clamp(-1.0, 1.0);
                // Antiphase counts two for one.
                assert!((got - want).abs() <= 2.0 * CLOCK, "{stage:?} {duty}: {got}");
            }
        }
    }

    #[test]
    fn the_clocks_of_a_duty_are_the_nearest() {
        for period in [2, 450, 4_500, 9_000, u16::MAX] {
            let pattern = Pattern::new(OutputStage::PwmDirection, period);
            let whole = f64::from(period);
            for step in -12_000_i16..=12_000 {
                let duty = Drive::new(f32::from(step) / 9_973.0);
                let wanted = f64::from(duty.to_f32()).abs().min(1.0) * whole;
                let off = (f64::from(pattern.high(steps(duty))) - wanted).abs();
                assert!(off <= 0.5 + whole / f64::from(WHOLE), "{duty:?} {period}");
            }
            for duty in [Drive::MIN, Drive::MAX] {
                assert_eq!(pattern.high(steps(duty)), u32::from(period));
            }
        }
    }

    #[test]
    fn no_duty_and_what_is_no_number_give_no_voltage() {
        for stage in KINDS {
            for duty in [0.0, -0.0, f32::NAN, -f32::NAN] {
                assert_eq!(voltage(stage, duty), 0.0, "{stage:?} {duty}");
            }
        }
    }

    /// Two half bridges, each of which follows its input: the difference of the two is the voltage.
    /// One of them never changes: low with fast decay, which is a level that a cut has, too; high
    /// with the other, so that both are never low at once.
    #[test]
    fn two_pwms_differ_by_the_duty_and_one_of_them_stands() {
        let clocks = u32::from(PERIOD);
        for (stage, still) in [
            (OutputStage::FastDecay, 0),
            (OutputStage::BrakeBetween, clocks),
        ] {
            let pattern = Pattern::new(stage, PERIOD);
            for step in -120_i8..=120 {
                let duty = f32::from(step) / 100.0;
                let [first, second] = pattern.pair(steps(Drive::new(duty)));
                let got = (first as f32 - second as f32) / f32::from(PERIOD);
                let want = duty.clamp(-1.0, 1.0);
                assert!((got - want).abs() <= CLOCK, "{stage:?} {duty}: {got}");
                assert!(first.max(second) <= clocks, "{stage:?} {duty}");
                let stands = if (duty < 0.0) == (still == 0) {
                    first
                } else {
                    second
                };
                assert_eq!(stands, still, "{stage:?} {duty}");
            }
            for duty in [0.0, -0.0, f32::NAN, -f32::NAN] {
                let pair = pattern.pair(steps(Drive::new(duty)));
                assert_eq!(pair, [still; 2], "{stage:?} {duty}");
            }
        }
    }

    #[test]
    fn numbers_are_those_of_the_object() {
        for (number, stage) in (0..).zip([
            OutputStage::PwmDirection,
            OutputStage::SlowDecay,
            OutputStage::FastDecay,
            OutputStage::LockedAntiphase,
            OutputStage::C620,
            OutputStage::C610,
            OutputStage::BrakeBetween,
        ]) {
            assert_eq!(OutputStage::from_number(number), stage);
            assert_eq!(stage.bit(), 1 << number);
        }
    }
}
