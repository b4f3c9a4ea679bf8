//! Defects of a chip or its board, to find out whether a test notices them.

use crate::system::gpio::{PinLevel, Port};

/// Something that does not work as its manual says. Crystal and watchdog oscillator are settings of
/// the [`BoardConfig`](crate::BoardConfig) anyway.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Defect {
    /// DBGMCU_IDCODE has another device number.
    Device(u32),
    /// The break input of this timer is connected to nothing.
    BreakInput(usize),
    /// This timer counts at a fraction of its clock.
    TimerDivided {
        /// Number of the timer.
        timer: usize,
        /// The divider.
        by: u64,
    },
    /// An output that drives its pin drives it to this level always.
    OutputStuck((Port, u8), PinLevel),
    /// An output drives the opposite of what it should.
    OutputInverted((Port, u8)),
    /// Two outputs have exchanged their pins.
    OutputsSwapped((Port, u8), (Port, u8)),
    /// Channel 1 or 2 of a timer receives no edges from its pin.
    TimerInput(usize, usize),
    /// The digital filters of the timers' inputs let every edge through.
    InputFilters,
    /// Programming and erasing flash takes this times as long.
    FlashSlow(u64),
    /// Programming a word of flash takes this times as long; erasing does not.
    ProgramSlow(u64),
    /// The caches and the prefetch buffer of the flash have no effect.
    Caches,
    /// The floating-point unit takes this times as long for a division or a square root.
    Division(u64),
    /// Over-drive comes on, and goes off by itself 100 ms later.
    OverDrive,
    /// A bit that the CAN controller sends lasts this times as long as its registers say.
    BitTime(f64),
    /// The transmit error counter of CAN1 stays at 0.
    ErrorCounter,
    /// The chip's own voltage reference is this times as high.
    Reference(f64),
}

/// The defects of one board.
#[derive(Debug, Clone, Default)]
pub(crate) struct Defects(Vec<Defect>);

impl Defects {
    pub(crate) fn new(all: &[Defect]) -> Self {
        Self(all.to_vec())
    }

    pub(crate) fn has(&self, defect: Defect) -> bool {
        self.0.contains(&defect)
    }

    /// The largest factor that `of` finds, or 1.
    fn factor(&self, of: impl Fn(&Defect) -> Option<u64>) -> u64 {
        self.0.iter().filter_map(of).max().unwrap_or(1)
    }

    /// The chip's device number and revision.
    pub(crate) fn id_code(&self, real: u32) -> u32 {
        let found = self.0.iter().find_map(|defect| match *defect {
            Defect::Device(number) => Some(real & !0xFFF | number),
            _ => None,
        });
        found.unwrap_or(real)
    }

    /// Divider of a timer's clock.
    pub(crate) fn divider(&self, number: usize) -> u64 {
        self.factor(|defect| match *defect {
            Defect::TimerDivided { timer, by } if timer == number => Some(by),
            _ => None,
        })
    }

    /// How many times as long flash takes.
    pub(crate) fn flash_factor(&self) -> u64 {
        self.factor(|defect| match *defect {
            Defect::FlashSlow(times) => Some(times),
            _ => None,
        })
    }

    /// How many times as long programming takes.
    pub(crate) fn program_factor(&self) -> u64 {
        self.factor(|defect| match *defect {
            Defect::ProgramSlow(times) => Some(times),
            _ => None,
        })
    }

    /// How many times as long a division takes.
    pub(crate) fn division_factor(&self) -> u64 {
        self.factor(|defect| match *defect {
            Defect::Division(times) => Some(times),
            _ => None,
        })
    }

    /// How many times as long a bit that is sent lasts.
    pub(crate) fn bit_time(&self) -> f64 {
        let found = self.0.iter().find_map(|defect| match *defect {
            Defect::BitTime(times) => Some(times),
            _ => None,
        });
        found.unwrap_or(1.0)
    }

    /// How many times as high the voltage reference is.
    pub(crate) fn reference(&self) -> f64 {
        let found = self.0.iter().find_map(|defect| match *defect {
            Defect::Reference(times) => Some(times),
            _ => None,
        });
        found.unwrap_or(1.0)
    }

    /// Whose output comes out at this pin.
    pub(crate) fn source(&self, at: (Port, u8)) -> (Port, u8) {
        let found = self.0.iter().find_map(|defect| match *defect {
            Defect::OutputsSwapped(one, other) if one == at => Some(other),
            Defect::OutputsSwapped(one, other) if other == at => Some(one),
            _ => None,
        });
        found.unwrap_or(at)
    }

    /// What becomes of a level at a pin that is driven.
    pub(crate) fn driven(&self, at: (Port, u8), level: PinLevel) -> PinLevel {
        if level == PinLevel::Floating {
            return level;
        }
        self.0.iter().fold(level, |level, defect| match *defect {
            Defect::OutputStuck(pin, stuck) if pin == at => stuck,
            Defect::OutputInverted(pin) if pin == at => match level {
                PinLevel::Low => PinLevel::High,
                _ => PinLevel::Low,
            },
            _ => level,
        })
    }
}
