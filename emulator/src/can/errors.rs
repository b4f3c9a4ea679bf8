//! bxCAN error management (RM0390 rev 6, section 30.7.6; the counting rules are ISO 11898-1's):
//! counters, the states error active, error passive and bus-off, and the way back.

use super::{Can, ier, msr};

/// What was wrong with a frame; the values are those of ESR.LEC.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum CanError {
    /// More than five equal bits.
    Stuff = 1,
    /// A fixed-form bit had the wrong level.
    Form = 2,
    /// No node acknowledged.
    Acknowledge = 3,
    /// Sent recessive, saw dominant.
    BitRecessive = 4,
    /// Sent dominant, saw recessive.
    BitDominant = 5,
    /// Checksum.
    Crc = 6,
}

/// The error counters of a CAN controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ErrorCounters {
    /// Transmit error counter.
    pub transmit: u32,
    /// Receive error counter.
    pub receive: u32,
}

/// A bus-off node comes back after 128 times 11 recessive bits.
const RECOVERY_BITS: u64 = 128 * 11;

/// Counters and states.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Errors {
    tec: u32,
    rec: u32,
    lec: u32,
    off: bool,
    recovers_at: Option<u64>,
    /// Bus-off, and software has asked for initialisation mode: recovery starts when it leaves it.
    software: bool,
    /// A defect: the transmit error counter does not count.
    stuck: bool,
    cycles_per_bit: u64,
}

/// What an error changed: bits as in IER, to be turned into ERRI.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct News(u32);

impl Errors {
    pub(super) fn bus_off(&self) -> bool {
        self.off
    }

    fn passive(&self) -> bool {
        self.tec > 127 || self.rec > 127
    }

    fn warning(&self) -> bool {
        self.tec >= 96 || self.rec >= 96
    }

    pub(super) fn esr(&self) -> u32 {
        u32::from(self.warning())
            | u32::from(self.passive()) << 1
            | u32::from(self.off) << 2
            | self.lec << 4
            | self.tec.min(255) << 16
            | self.rec.min(255) << 24
    }

    pub(super) fn write_lec(&mut self, value: u32) {
        self.lec = value >> 4 & 7;
    }

    pub(super) fn transmitted(&mut self) {
        self.tec = self.tec.saturating_sub(1);
        self.lec = 0;
    }

    pub(super) fn received(&mut self) {
        // 30.7.6: a good frame takes one off, or sets 120 when the node was error passive.
        self.rec = if self.rec > 127 {
            120
        } else {
            self.rec.saturating_sub(1)
        };
        self.lec = 0;
    }

    fn counted(&mut self, error: CanError, count: impl FnOnce(&mut Self)) -> News {
        let before = (self.warning(), self.passive(), self.off);
        count(self);
        self.lec = error as u32;
        self.off |= self.tec > 255;
        let mut news = ier::LECIE;
        for (was, is, bit) in [
            (before.0, self.warning(), ier::EWGIE),
            (before.1, self.passive(), ier::EPVIE),
            (before.2, self.off, ier::BOFIE),
        ] {
            if is && !was {
                news |= bit;
            }
        }
        News(news)
    }

    pub(super) fn transmit_error(&mut self, error: CanError) -> News {
        self.counted(error, |errors| {
            // An error-passive node alone on the bus stays on it: a missing acknowledge counts no
            // further.
            if !(error == CanError::Acknowledge && errors.passive()) {
                errors.tec += if errors.stuck { 0 } else { 8 };
            }
        })
    }

    fn receive_error(&mut self, error: CanError) -> News {
        self.counted(error, |errors| errors.rec = (errors.rec + 1).min(255))
    }

    pub(super) fn went_off(&mut self, now: u64, cycles_per_bit: u64) {
        self.cycles_per_bit = cycles_per_bit;
        if self.recovers_at.is_none() {
            self.recovers_at = Some(now + RECOVERY_BITS * cycles_per_bit);
        }
    }

    pub(super) fn recovers_at(&self) -> Option<u64> {
        self.recovers_at
    }

    /// Whether recovery is complete at `now`. Without ABOM it waits for software (30.7.6).
    pub(super) fn recover(&mut self, now: u64, automatic: bool) -> bool {
        let due = self.off && self.recovers_at.is_some_and(|at| now >= at);
        if due && !automatic && !self.software {
            self.recovers_at = None;
            return false;
        }
        due
    }

    pub(super) fn start_recovery(&mut self) {
        self.software = true;
        self.recovers_at = None;
    }

    pub(super) fn waits_for_software(&self) -> bool {
        self.off && self.software
    }

    pub(super) fn recover_from(&mut self, now: u64, cycles_per_bit: u64) {
        self.recovers_at = Some(now + RECOVERY_BITS * cycles_per_bit);
    }

    pub(super) fn reset_counters(&mut self) {
        *self = Self {
            lec: self.lec,
            stuck: self.stuck,
            ..Self::default()
        };
    }

    /// After a reset; a defect stays.
    pub(super) fn reset(self) -> Self {
        Self {
            stuck: self.stuck,
            ..Self::default()
        }
    }
}

impl Can {
    /// Makes the transmit error counter stay at 0.
    pub(crate) fn stop_error_counter(&mut self) {
        self.errors.stuck = true;
    }

    /// A frame of another node was received with an error.
    pub fn receive_error(&mut self, error: CanError) {
        if self.on_bus() {
            let news = self.errors.receive_error(error);
            self.raise_error(news);
        }
    }

    pub(super) fn raise_error(&mut self, news: News) {
        if news.0 & self.ier != 0 {
            self.msr_flags |= msr::ERRI;
        }
    }

    /// Whether the node is bus-off.
    #[must_use]
    pub fn bus_off(&self) -> bool {
        self.errors.bus_off()
    }

    /// Whether the node is error passive: it may signal errors with recessive flags only.
    #[must_use]
    pub fn error_passive(&self) -> bool {
        self.errors.passive()
    }

    /// The error counters.
    #[must_use]
    pub fn error_counters(&self) -> ErrorCounters {
        ErrorCounters {
            transmit: self.errors.tec,
            receive: self.errors.rec,
        }
    }
}
