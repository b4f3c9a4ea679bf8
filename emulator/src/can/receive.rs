//! bxCAN reception (RM0390 rev 6, sections 30.7.3 and 30.7.4): 28 filter banks that both
//! controllers share, and two FIFOs of three in each.

use std::ops::Range;

use super::{BTR_LBKM, Can, CanFrame, CanId, Mode, ier, mcr, msr};

const FMP: u32 = 3;
const FULL: u32 = 1 << 3;
const FOVR: u32 = 1 << 4;
const RFOM: u32 = 1 << 5;
const FINIT: u32 = 1;

/// One receive FIFO: the mailboxes as their four register words, the oldest first.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Fifo {
    mailboxes: [[u32; 4]; 3],
    count: usize,
    full: bool,
    overrun: bool,
}

impl Fifo {
    pub(super) fn rfr(&self) -> u32 {
        self.count as u32 & FMP | u32::from(self.full) << 3 | u32::from(self.overrun) << 4
    }

    pub(super) fn write_rfr(&mut self, value: u32) {
        if value & FULL != 0 {
            self.full = false;
        }
        if value & FOVR != 0 {
            self.overrun = false;
        }
        if value & RFOM != 0 && self.count > 0 {
            self.mailboxes.rotate_left(1);
            self.count -= 1;
            self.full = false;
        }
    }

    pub(super) fn read(&self, offset: u32) -> u32 {
        self.mailboxes[0][(offset / 4) as usize]
    }

    pub(super) fn interrupt(&self, pending: bool, full: bool, overrun: bool) -> bool {
        (pending && self.count > 0) || (full && self.full) || (overrun && self.overrun)
    }

    fn push(&mut self, mailbox: [u32; 4], locked: bool) {
        match self.count {
            3 => {
                // 30.7.3: an overrun replaces the newest frame, or with RFLM is dropped.
                self.overrun = true;
                if !locked {
                    self.mailboxes[2] = mailbox;
                }
            }
            count => {
                self.mailboxes[count] = mailbox;
                self.count += 1;
                self.full = self.count == 3;
            }
        }
    }
}

/// Whose a filter bank is.
#[derive(Debug, Clone, Copy)]
enum Owner {
    Can1,
    Can2,
}

/// The filter banks.
#[derive(Debug, Clone)]
pub(super) struct Filters {
    fmr: u32,
    list_mode: u32,
    wide: u32,
    to_fifo_1: u32,
    active: u32,
    banks: [[u32; 2]; 28],
    /// How many of them there are.
    count: usize,
}

impl Default for Filters {
    fn default() -> Self {
        Self {
            fmr: 0x2A1C_0E01,
            list_mode: 0,
            wide: 0,
            to_fifo_1: 0,
            active: 0,
            banks: [[0; 2]; 28],
            count: 28,
        }
    }
}

impl Filters {
    /// With so many banks.
    pub(super) fn with_banks(count: usize) -> Self {
        Self {
            count,
            ..Self::default()
        }
    }

    /// The same after a reset.
    pub(super) fn after_reset(&self) -> Self {
        Self::with_banks(self.count)
    }

    /// The bits of the banks.
    fn all(&self) -> u32 {
        (1 << self.count) - 1
    }

    /// The bank whose register is at an offset.
    fn bank_at(&self, offset: u32) -> Option<usize> {
        let bank = (offset.checked_sub(0x240)? / 8) as usize;
        (bank < self.count).then_some(bank)
    }

    pub(super) fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x200 => self.fmr,
            0x204 => self.list_mode,
            0x20C => self.wide,
            0x214 => self.to_fifo_1,
            0x21C => self.active,
            _ => self.banks[self.bank_at(offset)?][(offset / 4 % 2) as usize],
        })
    }

    pub(super) fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        let init = self.fmr & FINIT != 0;
        match offset {
            // CAN2SB is reserved where there is no CAN2, with the reset value 14.
            0x200 => {
                let writable = if self.count < 28 { 1 } else { 0x3F01 };
                self.fmr = (value & writable) | (self.fmr & !writable);
            }
            // 30.9.4: mode, scale and assignment change only in filter initialisation mode.
            0x204 if init => self.list_mode = value & self.all(),
            0x20C if init => self.wide = value & self.all(),
            0x214 if init => self.to_fifo_1 = value & self.all(),
            0x204 | 0x20C | 0x214 => {}
            0x21C => self.active = value & self.all(),
            _ => {
                let bank = self.bank_at(offset)?;
                if init || self.active >> bank & 1 == 0 {
                    self.banks[bank][(offset / 4 % 2) as usize] = value;
                }
            }
        }
        Some(())
    }

    /// The filters of a bank as (identifier, mask) pairs in their 32-bit layout, narrow ones
    /// widened.
    fn of_bank(&self, bank: usize) -> Vec<(u32, u32)> {
        let [one, two] = self.banks[bank];
        let (list, wide) = (self.list_mode >> bank & 1 != 0, self.wide >> bank & 1 != 0);
        let halves = [one & 0xFFFF, one >> 16, two & 0xFFFF, two >> 16];
        match (list, wide) {
            (false, true) => vec![(one, two)],
            (true, true) => vec![(one, !0), (two, !0)],
            (false, false) => vec![(halves[0], halves[1]), (halves[2], halves[3])],
            (true, false) => halves.iter().map(|half| (*half, 0xFFFF)).collect(),
        }
    }

    /// The banks of a controller: those below CAN2SB are CAN1's, the others CAN2's (30.9.4).
    fn banks_of(&self, owner: Owner) -> Range<usize> {
        let second = ((self.fmr >> 8 & 0x3F) as usize).min(28);
        match owner {
            Owner::Can1 => 0..second,
            Owner::Can2 => second..28,
        }
    }

    /// FIFO and filter match index of a frame that one of these banks accepts, or `None` when no
    /// filter accepts it. Among several the rules of 30.7.4 choose: 32 bits before 16, list before
    /// mask, then the lower number.
    fn accept(&self, frame: &CanFrame, banks: Range<usize>) -> Option<(usize, u32)> {
        if self.fmr & FINIT != 0 {
            return None;
        }
        let word = frame.mailbox_ir();
        // 16 bits: STID[10:0] RTR IDE EXID[17:15] (figure 368).
        let (base, extension, ide) = match frame.id() {
            CanId::Standard(id) => (u32::from(id), 0, 0),
            CanId::Extended(id) => (id >> 18, id >> 15 & 7, 1),
        };
        let half = base << 5 | u32::from(frame.is_remote()) << 4 | ide << 3 | extension;
        let mut numbers = [0; 2];
        let mut best: Option<((bool, bool), usize, u32)> = None;
        for bank in banks {
            let fifo = (self.to_fifo_1 >> bank & 1) as usize;
            let (list, wide) = (self.list_mode >> bank & 1 != 0, self.wide >> bank & 1 != 0);
            for (id, mask) in self.of_bank(bank) {
                let number = numbers[fifo];
                numbers[fifo] += 1;
                let value = if wide { word & !1 } else { half };
                let id = if wide { id & !1 } else { id };
                let matches = self.active >> bank & 1 != 0
                    && (value ^ id) & mask & if wide { !1 } else { !0 } == 0;
                let rank = (!wide, !list);
                if matches && best.is_none_or(|(other, ..)| rank < other) {
                    best = Some((rank, fifo, number));
                }
            }
        }
        best.map(|(_, fifo, number)| (fifo, number))
    }
}

impl Can {
    /// A frame was received without error. In silent mode and when bus-off it is not acknowledged,
    /// but that is for the bus to know. It was so many bits long.
    pub fn receive(&mut self, now: u64, frame: &CanFrame, bits: u32) {
        if let Some(began) = self.begin_reception(now, bits) {
            self.accept(began, frame);
        }
    }

    /// The same for CAN2, whose filters are among those of CAN1.
    pub fn receive_second(&mut self, first: &Self, now: u64, frame: &CanFrame, bits: u32) {
        if let Some(began) = self.begin_reception(now, bits) {
            let banks = first.filters.banks_of(Owner::Can2);
            self.store(began, frame, first.filters.accept(frame, banks));
        }
    }

    /// The cycle at which a frame that has just ended began, if the controller receives it.
    fn begin_reception(&mut self, now: u64, bits: u32) -> Option<u64> {
        self.sync(now);
        if self.mode == Mode::Sleep {
            // 30.4.3: the frame that wakes the controller is lost.
            if self.ier & ier::WKUIE != 0 {
                self.msr_flags |= msr::WKUI;
            }
            if self.mcr & mcr::AWUM != 0 {
                self.mcr &= !mcr::SLEEP;
                self.joins_at = Some(now + 11 * self.cycles_per_bit());
            }
            return None;
        }
        if !self.on_bus() {
            return None;
        }
        self.errors.received();
        Some(now.saturating_sub(u64::from(bits) * self.cycles_per_bit()))
    }

    pub(super) fn accept(&mut self, began: u64, frame: &CanFrame) {
        debug_assert!(self.mode == Mode::Normal || self.btr & BTR_LBKM != 0);
        let banks = self.filters.banks_of(Owner::Can1);
        let accepted = self.filters.accept(frame, banks);
        self.store(began, frame, accepted);
    }

    /// Stores a frame in the FIFO that its filter names.
    fn store(&mut self, began: u64, frame: &CanFrame, accepted: Option<(usize, u32)>) {
        if let Some((fifo, number)) = accepted {
            let [low, high] = frame.mailbox_data();
            let mailbox = [
                frame.mailbox_ir(),
                u32::from(frame.dlc()) | number << 8 | self.time_stamp(began),
                low,
                high,
            ];
            self.fifos[fifo].push(mailbox, self.mcr & mcr::RFLM != 0);
        }
    }
}
