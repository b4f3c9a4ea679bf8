//! Boards with a defect, and the check that has to notice it.

use emulator::{BoardConfig, Defect, PinLevel, Port};

use super::Faults;

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
    /// Length of the other node's bits, over what it should be.
    BitTimeOfOthers(f64),
    /// The program writes to this word.
    StrayWrite(u32),
    /// What is stored is lost with the power.
    Forgets,
    /// The second board hears frames this much later, ns.
    SecondLate(u64),
}

impl Mutation {
    /// Changes what a board is made from.
    pub fn apply(&self, config: &mut BoardConfig, faults: &mut Faults) {
        match self.change {
            Change::Defect(defect) => config.defects.push(defect),
            Change::Crystal(ppm) => config.crystal_ppm = ppm,
            Change::Watchdog(hz) => config.lsi_hz = hz,
            Change::Damaged(every) => faults.damaged_every = Some(every),
            Change::BitTimeOfOthers(times) => faults.bit_time_of_others = times,
            Change::StrayWrite(address) => faults.stray_write = Some(address),
            Change::Forgets => faults.forgets = true,
            Change::SecondLate(ns) => faults.second_late_ns = ns,
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
        "other-chip",
        "the chip is another one: device 0x413, an STM32F407",
        "chip",
        Defect::Device(0x413),
    ),
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
    defect(
        "words-slow",
        "programming a word takes seven times as long",
        "flash.word",
        Defect::ProgramSlow(7),
    ),
    defect(
        "saves-slow",
        "programming a word takes three times as long",
        "flash.program",
        Defect::ProgramSlow(3),
    ),
    defect(
        "erase-slow",
        "flash takes three times as long",
        "flash.sector",
        Defect::FlashSlow(3),
    ),
    defect(
        "over-drive-lost",
        "over-drive goes off by itself",
        "clock.over_drive",
        Defect::OverDrive,
    ),
    defect(
        "bits-long",
        "the board's bits on the bus are 1 % too long",
        "can.bit_time.own",
        Defect::BitTime(1.01),
    ),
    Mutation {
        name: "bits-of-others-short",
        what: "the other node's bits on the bus are 1 % too short",
        caught_by: "can.bit_time.others",
        change: Change::BitTimeOfOthers(0.99),
    },
    defect(
        "error-counter-stuck",
        "the transmit error counter does not count",
        "can.bus_off",
        Defect::ErrorCounter,
    ),
    defect(
        "caches-dead",
        "the flash is read without caches",
        "load.at_rest",
        Defect::Caches,
    ),
    defect(
        "divisions-slow",
        "a division in floating point takes fifty times as long",
        "load.driving",
        Defect::Division(50),
    ),
    Mutation {
        name: "stack-deep",
        what: "something writes 24 KiB down the stack",
        caught_by: "stack.high_water",
        change: Change::StrayWrite(0x2000_2000),
    },
    Mutation {
        name: "starts-forgotten",
        what: "what is stored is lost with the power",
        caught_by: "start.counted",
        change: Change::Forgets,
    },
    Mutation {
        name: "second-late",
        what: "a second board hears frames 50 us later than the first",
        caught_by: "skew.pwm",
        change: Change::SecondLate(50_000),
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
