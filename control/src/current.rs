//! The motors' current, where a sensor measures it, and the fault when it exceeds the torque bound.
//!
//! The bound of [`crate::wheel`] relies on the motor's model: it does not detect a shorted winding,
//! a wrong resistance or a bridge that does not follow its duty. A measurement needs no model. A
//! sensor at the end of its range no longer measures, and is treated as too much current.

use crate::time::Micros;

use crate::supply::FULL_SCALE;
use crate::threshold::Lasting;

/// How long there must be too much of it, us: no acceleration takes that long to be limited.
const OVER_US: u64 = 20_000;
/// The same while nothing drives: two readings might be from before the sensors were looked at.
const AT_REST_US: u64 = 5_000;

/// A sensor that may show less than nothing is at the lower end of its range below this, V: three
/// steps of 4096.
const LOW_END: f32 = 0.0025;

/// The parameters of a robot's current sensors.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct CurrentConfiguration {
    /// Current per voltage at an input, A/V.
    pub scale: f32,
    /// Voltage at an input without current, V.
    pub offset: f32,
    /// How many of the inputs are added up, from the first.
    pub inputs: u8,
    /// More than this is a fault, A.
    pub bound: f32,
}

/// Follows the current of one robot.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub(crate) struct Current {
    over: Lasting,
    /// It has lasted.
    too_much: bool,
}

impl Current {
    pub(crate) const fn new() -> Self {
        Self {
            over: Lasting::new(),
            too_much: false,
        }
    }

    /// Whether it has been too much for too long.
    pub(crate) const fn is_too_much(&self) -> bool {
        self.too_much
    }

    /// Takes in the voltages at the inputs, V, while the robot drives or not; returns the current,
    /// A.
    #[cold]
    #[inline(never)]
    pub(crate) fn update(
        &mut self,
        volts: [f32; 3],
        sensor: &CurrentConfiguration,
        now: Micros,
        drives: bool,
    ) -> f32 {
        let (mut sum, mut at_end) = (0.0, false);
        for volts in volts.into_iter().take(sensor.inputs.into()) {
            sum += volts - sensor.offset;
            at_end |= volts > FULL_SCALE || volts < LOW_END && sensor.offset > LOW_END;
        }
        let current = sum * sensor.scale;
        let over = at_end || current.abs() > sensor.bound;
        let lasting_us = if drives { OVER_US } else { AT_REST_US };
        self.too_much = self.over.update(over, now, lasting_us);
        current
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three sensors of 100 mV/A around the middle of the range, and motors of 4 A.
    const SENSOR: CurrentConfiguration = CurrentConfiguration {
        scale: 10.0,
        offset: 1.65,
        inputs: 3,
        bound: 20.0,
    };

    /// When it is too much, ms, if `volts` are at the inputs at each ms.
    fn run(sensor: &CurrentConfiguration, volts: fn(u64) -> [f32; 3]) -> Option<u64> {
        let mut current = Current::new();
        (0..200).find(|ms| {
            current.update(volts(*ms), sensor, Micros(ms * 1_000), true);
            current.is_too_much()
        })
    }

    #[test]
    fn the_inputs_are_added_with_their_signs() {
        let sum = |volts| Current::new().update(volts, &SENSOR, Micros(0), true);
        assert!((sum([1.65, 2.65, 2.15]) - 15.0).abs() < 1e-4);
        assert!((sum([1.15, 1.15, 2.65])).abs() < 1e-4);
        let one = CurrentConfiguration {
            inputs: 1,
            ..SENSOR
        };
        let first = Current::new().update([1.15, 3.3, 0.0], &one, Micros(0), true);
        assert!((first + 5.0).abs() < 1e-4, "the others are not looked at");
    }

    #[test]
    fn too_much_must_last_either_way() {
        assert_eq!(run(&SENSOR, |_| [2.35, 2.35, 2.36]), Some(20));
        assert_eq!(run(&SENSOR, |_| [0.95, 0.95, 0.94]), Some(20));
        assert_eq!(run(&SENSOR, |_| [2.31, 2.31, 2.31]), None, "19.8 A");
        let once = |ms| if ms % 20 == 19 { [1.65; 3] } else { [2.5; 3] };
        assert_eq!(run(&SENSOR, once), None);
    }

    #[test]
    fn an_input_at_an_end_of_its_range_counts_whatever_the_sum_is() {
        assert_eq!(run(&SENSOR, |_| [3.299, 1.65, 0.1]), Some(20));
        assert_eq!(run(&SENSOR, |_| [0.0, 1.65, 3.2]), Some(20));
        let shunt = CurrentConfiguration {
            offset: 0.0,
            ..SENSOR
        };
        assert_eq!(run(&shunt, |_| [0.0; 3]), None, "no current in a shunt");
    }
}
