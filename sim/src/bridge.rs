//! A motor driver, as seen from its inputs: what the levels at them do to a motor.
//!
//! # Theory of operation
//!
//! [`output`] takes the levels of a wheel's outputs, whatever made them, and the driver that is
//! wired to them. So a robot that is configured for another kind of driver than it has misbehaves
//! as a real one would: its wheels turn the wrong way, at the wrong speed, or as soon as the driver
//! is on.
//!
//! # Interface
//!
//! An emulated robot reads the levels from its pins. A native one has none; [`levels`] makes those
//! that its firmware would, from the duty and the configured kind.
//!
//! # Limits
//!
//! Means over a PWM period: no ripple, no dead time. A driver that lets the motor coast while its
//! PWM is low has no mean voltage that follows from its inputs alone, and is not modelled.

use control::output_stage::OutputStage;
use group::Driver;

/// Levels of one wheel's outputs.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Levels {
    /// Driver enable.
    pub enabled: bool,
    /// Share of the time for which the PWM is high, 0..=1.
    pub pwm: f64,
    /// Share of the time for which the direction is high, or the second PWM, 0..=1; both PWMs begin
    /// their pulses together.
    pub direction: f64,
    /// The output beside it, which has the opposite level while the drivers are enabled.
    pub inverse: bool,
}

/// The levels for a duty (-1..=1) with a kind of driver.
#[must_use]
pub fn levels(stage: OutputStage, duty: f64, enabled: bool) -> Levels {
    if !enabled {
        return Levels::default();
    }
    let backward = duty < 0.0;
    let (ahead, back) = (duty.max(0.0), (-duty).max(0.0));
    let level = |high: bool| f64::from(u8::from(high));
    let (pwm, direction) = match stage {
        OutputStage::PwmDirection => (duty.abs(), level(!backward)),
        OutputStage::SlowDecay => (if backward { 1.0 + duty } else { duty }, level(backward)),
        OutputStage::FastDecay => (ahead, back),
        OutputStage::BrakeBetween => (1.0 - back, 1.0 - ahead),
        OutputStage::LockedAntiphase => (0.5 + 0.5 * duty, level(!backward)),
        OutputStage::C620 | OutputStage::C610 => (0.0, 1.0),
    };
    Levels {
        enabled,
        pwm,
        direction,
        // The pins of the opposites are others' where there are two PWMs.
        inverse: !stage.has_two_pwms() && direction == 0.0,
    }
}

/// Mean voltage at the motor over the supply's, positive rolls the base forward; `None` where the
/// driver leaves the motor open.
#[must_use]
pub fn output(driver: Driver, levels: &Levels) -> Option<f64> {
    let Levels {
        pwm,
        direction,
        inverse,
        ..
    } = *levels;
    if !levels.enabled {
        return None;
    }
    let toward = |forward: bool| if forward { pwm } else { -pwm };
    match driver {
        // Backward for what is left of its pulse when the direction has become low.
        Driver::PwmDirection => Some(2.0 * pwm.min(direction) - pwm),
        Driver::PwmIn1In2 => match (direction > 0.0, inverse) {
            // TB6612FNG, "H-SW control function": both high is a brake, both low is off.
            (true, true) => Some(0.0),
            (false, false) => None,
            (forward, _) => Some(toward(forward)),
        },
        Driver::HalfBridges => Some(pwm - direction),
        Driver::LockedAntiphase => Some(2.0 * pwm - 1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DUTIES: [f64; 7] = [-1.0, -0.6, -0.01, 0.0, 0.01, 0.6, 1.0];

    fn made_by(stage: OutputStage, driver: Driver) -> [f64; 7] {
        DUTIES.map(|duty| output(driver, &levels(stage, duty, true)).unwrap())
    }

    #[test]
    fn the_right_driver_gives_the_duty() {
        for (stage, driver) in [
            (OutputStage::PwmDirection, Driver::PwmDirection),
            (OutputStage::PwmDirection, Driver::PwmIn1In2),
            (OutputStage::SlowDecay, Driver::HalfBridges),
            (OutputStage::LockedAntiphase, Driver::LockedAntiphase),
            (OutputStage::FastDecay, Driver::HalfBridges),
            (OutputStage::BrakeBetween, Driver::HalfBridges),
        ] {
            for (got, want) in made_by(stage, driver).into_iter().zip(DUTIES) {
                assert!(
                    (got - want).abs() < 1e-12,
                    "{stage:?} {driver:?}: {got} {want}"
                );
            }
        }
    }

    /// By hand from the tables of the drivers' data sheets.
    #[test]
    fn the_wrong_driver_reverses_halves_or_is_always_on() {
        let at = |stage, driver, duty| output(driver, &levels(stage, duty, true));
        let (direction, slow) = (OutputStage::PwmDirection, OutputStage::SlowDecay);
        let antiphase = OutputStage::LockedAntiphase;
        // IN2 high and IN1 low: full reverse at no duty.
        assert_eq!(at(direction, Driver::HalfBridges, 0.0), Some(-1.0));
        assert_eq!(at(direction, Driver::LockedAntiphase, 0.0), Some(-1.0));
        assert_eq!(at(slow, Driver::LockedAntiphase, 0.0), Some(-1.0));
        // Forward is the low level of the direction.
        assert_eq!(at(slow, Driver::PwmDirection, 0.25), Some(-0.25));
        assert_eq!(at(slow, Driver::PwmDirection, -0.25), Some(0.75));
        assert_eq!(at(slow, Driver::PwmIn1In2, 0.25), Some(-0.25));
        // Half on at no duty, and half as steep.
        assert_eq!(at(antiphase, Driver::PwmDirection, 0.0), Some(0.5));
        assert_eq!(at(antiphase, Driver::PwmDirection, 0.5), Some(0.75));
        assert_eq!(at(antiphase, Driver::HalfBridges, 0.0), Some(-0.5));
        // A second PWM where the direction should be: reverse does nothing, or all of both is
        // forward at no duty.
        let (fast, brake) = (OutputStage::FastDecay, OutputStage::BrakeBetween);
        assert_eq!(at(fast, Driver::PwmDirection, 0.5), Some(-0.5));
        assert_eq!(at(fast, Driver::PwmDirection, -0.5), Some(0.0));
        assert_eq!(at(brake, Driver::PwmDirection, 0.0), Some(1.0));
        assert_eq!(at(fast, Driver::LockedAntiphase, 0.0), Some(-1.0));
    }

    #[test]
    fn without_the_enable_no_driver_drives() {
        for driver in [
            Driver::PwmDirection,
            Driver::PwmIn1In2,
            Driver::HalfBridges,
            Driver::LockedAntiphase,
        ] {
            let levels = Levels {
                pwm: 1.0,
                direction: 1.0,
                ..Levels::default()
            };
            assert_eq!(output(driver, &levels), None);
        }
    }
}
