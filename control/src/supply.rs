//! The supply voltage: the voltage at full duty, and the faults for too low and too high a supply.
//!
//! The board provides the voltage at its measuring input, behind a divider. The duty is computed
//! from the mean over several ticks, because one sample contains the ripple of four bridges. A
//! fault depends on the single samples, which must stay beyond the threshold for a time: one sample
//! on the other side restarts that time.
//!
//! Too high a voltage is dangerous at once: braking motors raise the voltage of a bench supply, or
//! of a full battery that has disconnected itself. A ramp would continue to brake, so the fault
//! cuts and the holding brake takes the energy. An input at the end of its range has the same
//! reaction: either the divider's ground is open or the voltage exceeds the range.

use protocol::Fault;

use crate::quantity::{Divider, InputVoltage, Ratio, Voltage};
use crate::threshold::Lasting;
use crate::time::Micros;

/// Weight of a new sample in the mean: it follows with a time constant of four ticks.
const FRESH: Ratio = Ratio::new(0.25);

/// Voltage at the input above which the converter is at its end, V: three steps of 4096 below its
/// reference of 3.3 V.
pub const FULL_SCALE: f32 = 3.2975;

/// Time for which a low supply must last, us.
const LOW_US: u64 = 100_000;

/// Time for which a high supply must last, us.
const HIGH_US: u64 = 10_000;

/// The parameters of a robot's supply.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct SupplyConfiguration {
    /// Where it is not measured, V.
    pub nominal: Voltage,
    /// Below this the robot comes to rest, V; 0 where the supply is not measured.
    pub minimum: Voltage,
    /// Above this the drivers go off, V; 0 for no check.
    pub maximum: Voltage,
    /// Less than this above the minimum is reported, V.
    pub margin: Voltage,
    /// Supply voltage per voltage at the input.
    pub divider: Divider,
    /// Largest duty.
    pub duty_max: Ratio,
}

/// Filters and checks the supply of one robot.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub(crate) struct Supply {
    /// Of the last ticks, V; `None` where it is not measured.
    mean: Option<Voltage>,
    /// Of this tick, V.
    sample: Voltage,
    /// The input is at the end of its range.
    at_end: bool,
    low: Lasting,
    high: Lasting,
}

impl Supply {
    pub(crate) const fn new() -> Self {
        Self {
            mean: None,
            sample: Voltage::ZERO,
            at_end: false,
            low: Lasting::new(),
            high: Lasting::new(),
        }
    }

    /// Processes the voltage at the input, V; returns the voltage at full duty, V.
    #[inline]
    pub(crate) fn update(
        &mut self,
        input: Option<InputVoltage>,
        supply: &SupplyConfiguration,
    ) -> Voltage {
        let measured = match input {
            Some(input) if supply.minimum > Voltage::ZERO => input,
            // Without a minimum no divider is connected, so the input does not show the supply.
            Some(_) | None => {
                self.mean = None;
                return supply.nominal;
            }
        };
        self.at_end = measured > const { InputVoltage::new(FULL_SCALE) };
        self.sample = measured.times(supply.divider);
        let mean = self.mean.unwrap_or(self.sample);
        let mean = mean + (self.sample - mean).times(FRESH);
        self.mean = Some(mean);
        if mean > supply.minimum {
            mean
        } else {
            supply.minimum
        }
    }

    /// The mean, V, where it is measured.
    pub(crate) const fn voltage(&self) -> Option<Voltage> {
        self.mean
    }

    /// Whether it is only a little above the minimum.
    #[inline]
    pub(crate) fn is_short(&self, supply: &SupplyConfiguration) -> bool {
        self.mean
            .is_some_and(|mean| mean < supply.minimum + supply.margin)
    }

    /// Whether it has been too high for too long.
    #[inline]
    pub(crate) fn too_high(&mut self, supply: &SupplyConfiguration, now: Micros) -> Option<Fault> {
        let above = supply.maximum > Voltage::ZERO && self.sample > supply.maximum;
        let high = self.mean.is_some() && (above || self.at_end);
        let lasts = self.high.update(high, now, HIGH_US);
        lasts.then_some(Fault::SupplyHigh)
    }

    /// Whether it has been too low for too long.
    #[inline]
    pub(crate) fn too_low(&mut self, supply: &SupplyConfiguration, now: Micros) -> Option<Fault> {
        let low = self.mean.is_some() && self.sample < supply.minimum;
        let lasts = self.low.update(low, now, LOW_US);
        lasts.then_some(Fault::SupplyLow)
    }

    /// Restarts the times.
    pub(crate) fn acknowledge(&mut self) {
        self.low.reset();
        self.high.reset();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SUPPLY: SupplyConfiguration = SupplyConfiguration {
        nominal: Voltage::new(24.0),
        minimum: Voltage::new(18.0),
        maximum: Voltage::new(30.0),
        margin: Voltage::new(1.0),
        divider: Divider::new(11.0),
        duty_max: Ratio::new(1.0),
    };

    /// Runs `volts(ms)` for so long; the first fault with its time.
    fn run(millis: u64, volts: impl Fn(u64) -> f32) -> Option<(u64, Fault)> {
        let mut supply = Supply::new();
        (0..millis).find_map(|ms| {
            supply.update(Some(InputVoltage::new(volts(ms) / 11.0)), &SUPPLY);
            let now = Micros(ms * 1_000);
            let fault = supply.too_high(&SUPPLY, now);
            let fault = fault.or(supply.too_low(&SUPPLY, now));
            fault.map(|fault| (ms, fault))
        })
    }

    #[test]
    fn faults_come_after_their_time_and_not_for_a_spike() {
        assert_eq!(run(500, |_| 31.0), Some((10, Fault::SupplyHigh)));
        assert_eq!(run(500, |_| 17.0), Some((100, Fault::SupplyLow)));
        // Nine milliseconds in ten above.
        assert_eq!(run(500, |ms| if ms % 10 < 9 { 31.0 } else { 29.0 }), None);
        assert_eq!(run(500, |_| 18.01), None);
    }

    #[test]
    fn the_end_of_the_range_is_too_high_without_a_maximum() {
        let open = SupplyConfiguration {
            maximum: Voltage::ZERO,
            ..SUPPLY
        };
        let mut supply = Supply::new();
        let found = (0..100_u64).find(|ms| {
            supply.update(Some(InputVoltage::new(3.3)), &open);
            supply.too_high(&open, Micros(ms * 1_000)).is_some()
        });
        assert_eq!(found, Some(10));
    }

    #[test]
    fn the_duty_is_worth_the_mean_and_at_least_the_minimum() {
        let mut supply = Supply::new();
        assert_eq!(supply.update(None, &SUPPLY).to_f32(), 24.0);
        let mut worth = 0.0;
        for ms in 0..200 {
            // Ripple of 2 V in every tick.
            let volts = if ms % 2 == 0 { 25.0 } else { 23.0 };
            worth = supply
                .update(Some(InputVoltage::new(volts / 11.0)), &SUPPLY)
                .to_f32();
        }
        // A step of 2 V leaves 2 V * 0.25 / 1.75 from tick to tick, half of it to either side.
        assert!(
            (worth - 24.0).abs() < 0.5 * 2.0 * 0.25 / 1.75 + 1e-3,
            "{worth}"
        );
        assert!(!supply.is_short(&SUPPLY));
        for _ in 0..200 {
            worth = supply
                .update(Some(InputVoltage::new(5.0 / 11.0)), &SUPPLY)
                .to_f32();
        }
        assert_eq!(worth, 18.0);
        assert!(supply.is_short(&SUPPLY));
    }
}
