//! Boards with a defect, and the check that has to notice it.

use emulator::{BoardConfig, Defect, PinLevel, Port};

/// A board with one defect.
#[derive(Debug, Clone, Copy)]
pub struct Mutation {
    /// Name, for `--mutate`.
    pub name: &'static str,
    /// What is wrong.
    pub what: &'static str,
    /// The check that has to fail.
    pub caught_by: &'static str,
    change: Change,
}

#[derive(Debug, Clone, Copy)]
enum Change {
    Defect(Defect),
    Crystal(f64),
    /// Frequency of the watchdog's oscillator, Hz.
    Watchdog(u64),
    /// Every so many frames of the board is damaged.
    Damaged(u32),
}

impl Mutation {
    /// Changes what a board is made from.
    pub fn apply(&self, config: &mut BoardConfig, damaged_every: &mut Option<u32>) {
        match self.change {
            Change::Defect(defect) => config.defects.push(defect),
            Change::Crystal(ppm) => config.crystal_ppm = ppm,
            Change::Watchdog(hz) => config.lsi_hz = hz,
            Change::Damaged(every) => *damaged_every = Some(every),
        }
    }

    /// The mutation of this name.
    #[must_use]
    pub fn find(name: &str) -> Option<&'static Self> {
        MUTATIONS.iter().find(|mutation| mutation.name == name)
    }
}

const fn defect(
    name: &'static str,
    what: &'static str,
    caught_by: &'static str,
    defect: Defect,
) -> Mutation {
    Mutation {
        name,
        what,
        caught_by,
        change: Change::Defect(defect),
    }
}

use Port::{A, B, C, D};

/// All mutations.
pub const MUTATIONS: &[Mutation] = &[
    defect(
        "break-input-dead",
        "the break input of TIM1 does nothing",
        "stop.pwm",
        Defect::BreakInput(1),
    ),
    defect(
        "gate-break-dead",
        "the break input of TIM8 does nothing",
        "stop.driver_enable_and_brake",
        Defect::BreakInput(8),
    ),
    Mutation {
        name: "watchdog-slow",
        what: "the watchdog is ten times slower",
        caught_by: "watchdog.halt",
        change: Change::Watchdog(3_200),
    },
    defect(
        "pwm-half",
        "TIM1 has half its clock",
        "pwm.front_left.frequency",
        Defect::TimerDivided { timer: 1, by: 2 },
    ),
    defect(
        "pwm-swapped",
        "PWM of the front wheels have exchanged their pins",
        "pwm.front_right.pin",
        Defect::OutputsSwapped((A, 8), (A, 9)),
    ),
    defect(
        "pwm-inverted",
        "PWM of a wheel is inverted",
        "pwm.rear_left.duty",
        Defect::OutputInverted((A, 10)),
    ),
    defect(
        "pwm-dead",
        "PWM of a wheel stays low",
        "pwm.rear_right.frequency",
        Defect::OutputStuck((A, 11), PinLevel::Low),
    ),
    defect(
        "encoder-dead",
        "channel B of an encoder has no edges",
        "encoder.front_right.forwards",
        Defect::TimerInput(3, 2),
    ),
    defect(
        "encoder-a-dead",
        "channel A of an encoder has no edges",
        "encoder.rear_left.backwards",
        Defect::TimerInput(4, 1),
    ),
    defect(
        "filters-dead",
        "the encoder inputs have no filter",
        "encoder.front_left.noise",
        Defect::InputFilters,
    ),
    defect(
        "brake-inverted",
        "brake release is inverted",
        "brake_release",
        Defect::OutputInverted((B, 1)),
    ),
    defect(
        "enable-stuck-high",
        "driver enable stays high",
        "driver_enable",
        Defect::OutputStuck((B, 0), PinLevel::High),
    ),
    defect(
        "enable-stuck-low",
        "driver enable stays low",
        "driver_enable",
        Defect::OutputStuck((B, 0), PinLevel::Low),
    ),
    defect(
        "direction-stuck",
        "a direction stays high",
        "direction.rear_left",
        Defect::OutputStuck((C, 2), PinLevel::High),
    ),
    defect(
        "inverse-stuck",
        "an inverse direction stays low",
        "inverse.rear_right",
        Defect::OutputStuck((D, 2), PinLevel::Low),
    ),
    defect(
        "reference-off",
        "the chip's voltage reference is 6 % high",
        "supply.high",
        Defect::Reference(1.06),
    ),
    defect(
        "flash-slow",
        "flash takes twice as long",
        "flash.erase",
        Defect::FlashSlow(2),
    ),
    Mutation {
        name: "crystal-off",
        what: "the crystal is 500 ppm fast",
        caught_by: "clock.crystal",
        change: Change::Crystal(500.0),
    },
    Mutation {
        name: "transmit-errors",
        what: "every twentieth frame of the board is damaged",
        caught_by: "can.errors",
        change: Change::Damaged(20),
    },
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_differ() {
        for (place, mutation) in MUTATIONS.iter().enumerate() {
            let same = Mutation::find(mutation.name).map(|found| found.what);
            assert_eq!(same, Some(mutation.what), "{place}");
        }
        assert!(MUTATIONS.len() >= 15);
    }
}
