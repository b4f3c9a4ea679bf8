//! The reasons for which a run ends early.

use std::fmt;

/// What happened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum StopKind {
    /// The firmware accessed something that is not modelled.
    Unmodelled {
        /// Peripheral and register or use, as in the reference manual.
        what: String,
        /// Address of the access.
        address: u32,
        /// Value, if it was a write.
        written: Option<u32>,
    },
    /// The firmware accessed a peripheral whose clock is off or that is held in reset. The chip
    /// would ignore a write and read 0.
    Unclocked {
        /// Peripheral and register.
        what: String,
        /// Address of the access.
        address: u32,
        /// Value, if it was a write.
        written: Option<u32>,
    },
    /// The clock tree is set outside the chip's specification.
    Clock(String),
    /// A fault inside a fault handler: the core is locked up, and no watchdog is running to reset
    /// it.
    LockedUp,
    /// The power failed where
    /// [`Board::cut_power_at_flash_operation`](crate::Board::cut_power_at_flash_operation) said.
    PowerCut,
    /// The processor took a HardFault and [`BoardConfig::stop_on_hard_fault`](crate::BoardConfig)
    /// is set.
    HardFault,
}

/// Why and where a run ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stop {
    /// What happened.
    pub kind: StopKind,
    /// Address of the instruction.
    pub pc: u32,
    /// Function, file and line of the instruction, from the image's debug information.
    pub location: Option<String>,
    /// World time in ns.
    pub t_ns: u64,
}

impl fmt::Display for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let access = |f: &mut fmt::Formatter<'_>,
                      what: &str,
                      address: u32,
                      written: Option<u32>| match written {
            Some(value) => write!(f, "write of {value:#010x} to {what} ({address:#010x})"),
            None => write!(f, "read of {what} ({address:#010x})"),
        };
        match &self.kind {
            StopKind::Unmodelled {
                what,
                address,
                written,
            } => {
                write!(f, "not modelled: ")?;
                access(f, what, *address, *written)?;
            }
            StopKind::Unclocked {
                what,
                address,
                written,
            } => {
                write!(f, "clock off or held in reset: ")?;
                access(f, what, *address, *written)?;
            }
            StopKind::Clock(what) => write!(f, "clock outside the specification: {what}")?,
            StopKind::LockedUp => write!(f, "the processor locked up")?,
            StopKind::PowerCut => write!(f, "power cut")?,
            StopKind::HardFault => write!(f, "HardFault")?,
        }
        write!(f, " at {:#010x}", self.pc)?;
        if let Some(location) = &self.location {
            write!(f, " in {location}")?;
        }
        write!(f, ", {:.6} s", self.t_ns as f64 * 1e-9)
    }
}

impl std::error::Error for Stop {}
