//! The CAN controllers bxCAN, CAN1 and CAN2 (RM0390 rev 6, section 30).
//!
//! This file: modes, registers, interrupts. [`transmit`]: the three mailboxes. [`receive`]: filters
//! and FIFOs. [`errors`]: error counters and bus-off. The bus itself is outside this crate: it asks
//! for the frame to be sent and reports its outcome.
//!
//! Joining the bus takes 11 recessive bits (30.4); the bus is assumed to be idle then. Loop-back
//! mode sends to itself after the time the frame takes on the wire. With TTCM a counter of bit
//! times stamps every frame, sent or received, at the sample point of its start bit (30.7.2). It
//! begins at 0 when TTCM is set or the bit timing written, which the manual leaves open; without
//! TTCM stamps are 0.
//!
//! The filters are CAN1's; CAN2 receives by the banks from CAN2SB on ([`Can::receive_second`]), and
//! only while CAN1 has its clock. The match index of CAN2 counts from its own first bank.
//!
//! Not modelled: loop-back of CAN2, sending the time stamp (TGT), test mode bits beyond loop-back
//! and silent.

pub mod errors;
mod frame;
pub mod port;
pub mod receive;
#[cfg(test)]
mod tests;
pub mod transmit;

pub use errors::{CanError, ErrorCounters};
pub use frame::{CanFrame, CanId};
pub use port::CanPort;

use crate::clock::earliest;
use receive::Fifo;
use transmit::Mailbox;

/// Bits of MCR (30.9.2).
mod mcr {
    pub const INRQ: u32 = 1;
    pub const SLEEP: u32 = 1 << 1;
    pub const TXFP: u32 = 1 << 2;
    pub const RFLM: u32 = 1 << 3;
    pub const NART: u32 = 1 << 4;
    pub const AWUM: u32 = 1 << 5;
    pub const ABOM: u32 = 1 << 6;
    pub const TTCM: u32 = 1 << 7;
    pub const RESET: u32 = 1 << 15;
}

/// Bits of MSR.
mod msr {
    pub const ERRI: u32 = 1 << 2;
    pub const WKUI: u32 = 1 << 3;
    pub const SLAKI: u32 = 1 << 4;
}

/// Bits of IER.
mod ier {
    pub const TMEIE: u32 = 1;
    pub const FMPIE0: u32 = 1 << 1;
    pub const EWGIE: u32 = 1 << 8;
    pub const EPVIE: u32 = 1 << 9;
    pub const BOFIE: u32 = 1 << 10;
    pub const LECIE: u32 = 1 << 11;
    pub const ERRIE: u32 = 1 << 15;
    pub const WKUIE: u32 = 1 << 16;
    pub const SLKIE: u32 = 1 << 17;
}

const BTR_LBKM: u32 = 1 << 30;

/// What the controller is doing (30.4).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Initialisation: the bit timing can be written, the bus is ignored.
    Initialisation,
    /// Sleep, the state after reset.
    Sleep,
    /// On the bus.
    Normal,
}

/// The levels of the four interrupt lines.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[allow(missing_docs)]
pub struct Lines {
    pub tx: bool,
    pub rx: [bool; 2],
    pub sce: bool,
}

/// bxCAN.
#[derive(Debug, Clone)]
pub struct Can {
    mcr: u32,
    msr_flags: u32,
    ier: u32,
    btr: u32,
    mode: Mode,
    /// When 11 recessive bits will have been seen and the mode becomes normal.
    joins_at: Option<u64>,
    /// Core clock cycles per APB1 clock.
    ratio: u64,
    /// When the counter of time stamps stood at 0, while it runs.
    counts_since: Option<u64>,
    mailboxes: [Mailbox; 3],
    requests: u64,
    /// When the frame that is being sent to itself in loop-back mode began, and when it is
    /// complete.
    loop_back: Option<(u64, u64)>,
    fifos: [Fifo; 2],
    filters: receive::Filters,
    errors: errors::Errors,
}

impl Default for Can {
    fn default() -> Self {
        Self {
            mcr: 0x0001_0002,
            msr_flags: 0,
            ier: 0,
            btr: 0x0123_0000,
            mode: Mode::Sleep,
            joins_at: None,
            ratio: 1,
            counts_since: None,
            mailboxes: [Mailbox::default(); 3],
            requests: 0,
            loop_back: None,
            fifos: [Fifo::default(); 2],
            filters: receive::Filters::default(),
            errors: errors::Errors::default(),
        }
    }
}

impl Can {
    /// A controller with so many filter banks, after reset.
    #[must_use]
    pub fn with_banks(count: usize) -> Self {
        Self {
            filters: receive::Filters::with_banks(count),
            ..Self::default()
        }
    }

    /// Resets the controller.
    pub fn reset(&mut self) {
        *self = Self {
            ratio: self.ratio,
            errors: self.errors.reset(),
            filters: self.filters.after_reset(),
            ..Self::default()
        };
    }

    /// Sets the number of core clock cycles per APB1 clock.
    pub fn set_ratio(&mut self, ratio: u64) {
        self.ratio = ratio;
    }

    /// APB1 clocks per bit: prescaler times time quanta (30.7.7).
    #[must_use]
    pub fn clocks_per_bit(&self) -> u64 {
        let quanta = 1 + u64::from(self.btr >> 16 & 0xF) + 1 + u64::from(self.btr >> 20 & 7) + 1;
        self.brp() * quanta
    }

    /// Share of a bit before the sample point.
    #[must_use]
    pub fn sample_point(&self) -> f32 {
        let (seg1, seg2) = ((self.btr >> 16 & 0xF) + 1, (self.btr >> 20 & 7) + 1);
        (1 + seg1) as f32 / (1 + seg1 + seg2) as f32
    }

    pub(crate) fn cycles_per_bit(&self) -> u64 {
        self.clocks_per_bit() * self.ratio
    }

    /// The time stamp of a frame that began at a cycle, in the upper half of a mailbox's third
    /// word.
    fn time_stamp(&self, began: u64) -> u32 {
        let Some(since) = self.counts_since else {
            return 0;
        };
        let bit = self.cycles_per_bit();
        let behind_sample_point = (u64::from(self.btr >> 20 & 7) + 1) * self.brp() * self.ratio;
        let sampled = began + bit - behind_sample_point;
        ((sampled.saturating_sub(since) / bit) as u32 & 0xFFFF) << 16
    }

    fn brp(&self) -> u64 {
        u64::from(self.btr & 0x3FF) + 1
    }

    /// What the controller is doing, as of the last [`Can::sync`].
    #[must_use]
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Whether it takes part in the bus: normal mode, not bus-off, not in loop-back.
    #[must_use]
    pub fn on_bus(&self) -> bool {
        self.mode == Mode::Normal && !self.errors.bus_off() && self.btr & BTR_LBKM == 0
    }

    /// Whether it only listens: silent mode sends neither frames nor acknowledge bits.
    #[must_use]
    pub fn silent(&self) -> bool {
        self.btr >> 31 != 0
    }

    /// Brings the controller to cycle `now`.
    pub fn sync(&mut self, now: u64) {
        if self.joins_at.is_some_and(|at| now >= at) {
            self.joins_at = None;
            self.mode = Mode::Normal;
        }
        if self.errors.recover(now, self.mcr & mcr::ABOM != 0) {
            self.errors.reset_counters();
        }
        while let Some((began, _)) = self.loop_back.take_if(|(_, at)| now >= *at) {
            self.finish_loop_back(began);
        }
        self.start_loop_back(now);
    }

    /// Cycle at which something will happen by itself.
    #[must_use]
    pub fn next_event(&self) -> Option<u64> {
        let loop_back = self.loop_back.map(|(_, at)| at);
        earliest([self.joins_at, self.errors.recovers_at(), loop_back])
    }

    /// Interrupt lines (30.8), as of the last [`Can::sync`].
    #[must_use]
    pub fn lines(&self) -> Lines {
        if self.ier == 0 {
            return Lines::default();
        }
        let fifo = |index: usize| {
            let enabled = self.ier >> (3 * index);
            self.fifos[index].interrupt(
                enabled & ier::FMPIE0 != 0,
                enabled & 4 != 0,
                enabled & 8 != 0,
            )
        };
        let on = |flag: u32, enable: u32| self.msr_flags & flag != 0 && self.ier & enable != 0;
        Lines {
            tx: self.ier & ier::TMEIE != 0
                && self.mailboxes.iter().any(|mailbox| mailbox.completed()),
            rx: [fifo(0), fifo(1)],
            sce: on(msr::ERRI, ier::ERRIE)
                || on(msr::WKUI, ier::WKUIE)
                || on(msr::SLAKI, ier::SLKIE),
        }
    }

    /// Reads a register; `None` for an offset without one.
    pub fn read(&mut self, now: u64, offset: u32) -> Option<u32> {
        self.sync(now);
        Some(match offset {
            0x000 => self.mcr,
            0x004 => self.msr(),
            0x008 => self.tsr(),
            0x00C => self.fifos[0].rfr(),
            0x010 => self.fifos[1].rfr(),
            0x014 => self.ier,
            0x018 => self.errors.esr(),
            0x01C => self.btr,
            0x180..=0x1AC => self.mailboxes[((offset - 0x180) / 16) as usize].read(offset & 0xC),
            0x1B0..=0x1CC => self.fifos[((offset - 0x1B0) / 16) as usize].read(offset & 0xC),
            0x200..=0x31C => self.filters.read(offset)?,
            _ => return None,
        })
    }

    /// Writes a register; `None` for an offset without one.
    pub fn write(&mut self, now: u64, offset: u32, value: u32) -> Option<()> {
        self.sync(now);
        match offset {
            0x000 => self.write_mcr(now, value),
            0x004 => self.msr_flags &= !(value & (msr::ERRI | msr::WKUI | msr::SLAKI)),
            0x008 => self.write_tsr(value),
            0x00C => self.fifos[0].write_rfr(value),
            0x010 => self.fifos[1].write_rfr(value),
            0x014 => self.ier = value & 0x0003_8F7F,
            0x018 => self.errors.write_lec(value),
            0x01C => {
                // 30.9.2: only in initialisation mode.
                if self.mode == Mode::Initialisation {
                    self.btr = value & 0xC37F_03FF;
                    self.counts_since = self.counts_since.map(|_| now);
                }
            }
            0x180..=0x1AC => {
                self.write_mailbox(now, ((offset - 0x180) / 16) as usize, offset & 0xC, value)
            }
            0x1B0..=0x1CC => {}
            0x200..=0x31C => self.filters.write(offset, value)?,
            _ => return None,
        }
        self.start_loop_back(now);
        Some(())
    }

    fn msr(&self) -> u32 {
        let transmitting = self.mailboxes.iter().any(|mailbox| mailbox.on_the_wire());
        u32::from(self.mode == Mode::Initialisation)
            | u32::from(self.mode == Mode::Sleep) << 1
            | self.msr_flags
            | u32::from(transmitting) << 8
            | 3 << 10 // RX and the last sample: recessive
    }

    fn write_mcr(&mut self, now: u64, value: u32) {
        if value & mcr::RESET != 0 {
            self.reset();
            return;
        }
        self.mcr = value & 0x0001_00FF;
        let counts = value & mcr::TTCM != 0;
        self.counts_since = counts.then(|| self.counts_since.unwrap_or(now));
        if value & mcr::INRQ != 0 {
            if value & mcr::SLEEP == 0 || self.mode != Mode::Sleep {
                self.mode = Mode::Initialisation;
                self.joins_at = None;
                if self.errors.bus_off() {
                    self.errors.start_recovery();
                }
            }
        } else if value & mcr::SLEEP != 0 {
            if self.mode != Mode::Sleep && self.ier & ier::SLKIE != 0 {
                self.msr_flags |= msr::SLAKI;
            }
            self.mode = Mode::Sleep;
            self.joins_at = None;
        } else if self.mode != Mode::Normal && self.joins_at.is_none() {
            self.joins_at = Some(now + 11 * self.cycles_per_bit());
            if self.errors.waits_for_software() {
                self.errors.recover_from(now, self.cycles_per_bit());
            }
        }
    }

    /// Name of the register at an offset.
    #[must_use]
    pub fn register_name(offset: u32) -> &'static str {
        match offset {
            0x000 => "MCR",
            0x004 => "MSR",
            0x008 => "TSR",
            0x00C => "RF0R",
            0x010 => "RF1R",
            0x014 => "IER",
            0x018 => "ESR",
            0x01C => "BTR",
            0x180..=0x1AF => "transmit mailbox",
            0x1B0..=0x1CF => "receive FIFO mailbox",
            0x200..=0x31F => "filter",
            _ => "?",
        }
    }
}
