//! bxCAN transmission (RM0390 rev 6, sections 30.7.1 and 30.9.2): three mailboxes, their order,
//! abort, and the outcome that the bus reports for a frame.

use super::errors::CanError;
use super::{BTR_LBKM, Can, CanFrame, Mode, mcr};

const TXRQ: u32 = 1;

/// State of a mailbox.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum State {
    #[default]
    Empty,
    /// Waits for the bus.
    Pending,
    /// On the wire.
    Transmitting,
}

/// One transmit mailbox.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Mailbox {
    ir: u32,
    dtr: u32,
    data: [u32; 2],
    state: State,
    /// Order and cycle of the request.
    order: u64,
    requested_at: u64,
    abort: bool,
    /// RQCP, TXOK, ALST, TERR in bits 0 to 3, as in TSR.
    result: u32,
}

impl Mailbox {
    pub(super) fn completed(&self) -> bool {
        self.result & 1 != 0
    }

    pub(super) fn on_the_wire(&self) -> bool {
        self.state == State::Transmitting
    }

    fn frame(&self) -> CanFrame {
        CanFrame::from_mailbox(self.ir, self.dtr, self.data[0], self.data[1])
    }

    pub(super) fn read(&self, offset: u32) -> u32 {
        match offset {
            0x0 => self.ir | u32::from(self.state != State::Empty),
            0x4 => self.dtr,
            0x8 => self.data[0],
            _ => self.data[1],
        }
    }

    fn finish(&mut self, result: u32) {
        self.state = State::Empty;
        self.abort = false;
        self.result = 1 | result;
    }
}

const TXOK: u32 = 1 << 1;
const ALST: u32 = 1 << 2;
const TERR: u32 = 1 << 3;

impl Can {
    pub(super) fn write_mailbox(&mut self, now: u64, index: usize, offset: u32, value: u32) {
        let mailbox = &mut self.mailboxes[index];
        if mailbox.state != State::Empty {
            return; // write-protected (30.9.3)
        }
        match offset {
            0x0 => {
                mailbox.ir = value & !TXRQ;
                if value & TXRQ != 0 {
                    mailbox.state = State::Pending;
                    mailbox.result = 0;
                    mailbox.order = self.requests;
                    mailbox.requested_at = now;
                    self.requests += 1;
                }
            }
            0x4 => mailbox.dtr = value & 0xFFFF_010F,
            0x8 => mailbox.data[0] = value,
            _ => mailbox.data[1] = value,
        }
    }

    pub(super) fn tsr(&self) -> u32 {
        let mut tsr = 0;
        for (index, mailbox) in self.mailboxes.iter().enumerate() {
            tsr |= mailbox.result << (8 * index);
            tsr |= u32::from(mailbox.abort) << (8 * index + 7);
            tsr |= u32::from(mailbox.state == State::Empty) << (26 + index);
        }
        let lowest = self.last_in_order();
        let busy = self
            .mailboxes
            .iter()
            .filter(|mailbox| mailbox.state != State::Empty)
            .count();
        // LOW tells which of several goes last; CODE the next free mailbox, or the one that goes
        // last.
        if busy > 1
            && let Some(index) = lowest
        {
            tsr |= 1 << (29 + index);
        }
        let free = self
            .mailboxes
            .iter()
            .position(|mailbox| mailbox.state == State::Empty);
        tsr | (free.or(lowest).unwrap_or(0) as u32) << 24
    }

    pub(super) fn write_tsr(&mut self, value: u32) {
        for (index, mailbox) in self.mailboxes.iter_mut().enumerate() {
            let bits = value >> (8 * index);
            if bits & 1 != 0 {
                mailbox.result = 0; // RQCP takes TXOK, ALST and TERR with it
            } else {
                mailbox.result &= !(bits & (TXOK | ALST | TERR));
            }
            if bits & 0x80 != 0 {
                match mailbox.state {
                    State::Empty => {}
                    State::Pending => mailbox.finish(0),
                    State::Transmitting => mailbox.abort = true,
                }
            }
        }
    }

    /// Key by which pending mailboxes leave, the smallest first: request order with TXFP, else
    /// identifier and then mailbox number.
    fn key(&self, index: usize) -> (u64, usize) {
        let mailbox = &self.mailboxes[index];
        if self.mcr & mcr::TXFP != 0 {
            (mailbox.order, index)
        } else {
            (u64::from(mailbox.frame().arbitration()), index)
        }
    }

    fn in_state(&self, state: State) -> impl Iterator<Item = usize> {
        (0..3).filter(move |&index| self.mailboxes[index].state == state)
    }

    fn last_in_order(&self) -> Option<usize> {
        (0..3)
            .filter(|&index| self.mailboxes[index].state != State::Empty)
            .max_by_key(|&index| self.key(index))
    }

    fn first_in_order(&self) -> Option<usize> {
        self.in_state(State::Transmitting).next().or_else(|| {
            self.in_state(State::Pending)
                .min_by_key(|&index| self.key(index))
        })
    }

    /// How many frames have been requested since reset.
    #[must_use]
    pub fn requests(&self) -> u64 {
        self.requests
    }

    /// The frame that was requested last, if it still waits, with the cycle of its request.
    #[must_use]
    pub fn latest_request(&self) -> Option<(CanFrame, u64)> {
        let waiting = self
            .mailboxes
            .iter()
            .filter(|mailbox| mailbox.state != State::Empty);
        let latest = waiting.max_by_key(|mailbox| mailbox.order)?;
        Some((latest.frame(), latest.requested_at))
    }

    /// The frame that wants the bus, with the cycle of its request: the one on the wire, else the
    /// next in order.
    #[must_use]
    pub fn pending(&self) -> Option<(CanFrame, u64)> {
        if !self.on_bus() || self.silent() {
            return None;
        }
        self.first_in_order().map(|index| {
            let mailbox = &self.mailboxes[index];
            (mailbox.frame(), mailbox.requested_at)
        })
    }

    /// The bus begins with the pending frame: from here on no other mailbox overtakes it.
    pub fn begin(&mut self, now: u64) -> Option<CanFrame> {
        self.pending()?;
        let index = self.first_in_order()?;
        Some(self.put_on_the_wire(now, index))
    }

    fn put_on_the_wire(&mut self, now: u64, index: usize) -> CanFrame {
        let stamp = self.time_stamp(now);
        let mailbox = &mut self.mailboxes[index];
        mailbox.state = State::Transmitting;
        if self.mcr & mcr::TTCM != 0 {
            mailbox.dtr = mailbox.dtr & 0xFFFF | stamp;
        }
        mailbox.frame()
    }

    /// The frame went out and was acknowledged.
    pub fn transmitted(&mut self) {
        if let Some(index) = self.pending().and(self.first_in_order()) {
            self.mailboxes[index].finish(TXOK);
            self.errors.transmitted();
        }
    }

    /// Another node's frame had priority. The frame stays, unless it is to be sent only once
    /// (NART).
    pub fn lost_arbitration(&mut self) {
        if let Some(index) = self.pending().and(self.first_in_order()) {
            self.unsuccessful(index, ALST);
        }
    }

    /// The transmission failed.
    pub fn transmit_error(&mut self, now: u64, error: CanError) {
        if let Some(index) = self.pending().and(self.first_in_order()) {
            self.unsuccessful(index, TERR);
            let cycles_per_bit = self.cycles_per_bit();
            let news = self.errors.transmit_error(error);
            if self.errors.bus_off() {
                for mailbox in &mut self.mailboxes {
                    if mailbox.state == State::Transmitting {
                        mailbox.state = State::Pending;
                    }
                }
                self.errors.went_off(now, cycles_per_bit);
            }
            self.raise_error(news);
        }
    }

    fn unsuccessful(&mut self, index: usize, why: u32) {
        let once = self.mcr & mcr::NART != 0;
        let mailbox = &mut self.mailboxes[index];
        if once || mailbox.abort {
            mailbox.finish(why);
        } else {
            mailbox.state = State::Pending;
            mailbox.result |= why;
        }
    }

    /// Loop-back (30.5.2): starts the next frame when none is under way.
    pub(super) fn start_loop_back(&mut self, now: u64) {
        if self.btr & BTR_LBKM == 0 || self.mode != Mode::Normal || self.loop_back.is_some() {
            return;
        }
        if let Some(index) = self.first_in_order() {
            let frame = self.put_on_the_wire(now, index);
            // With the intermission of 3 bits.
            let bits = u64::from(frame.bits() + 3);
            self.loop_back = Some((now, now + bits * self.cycles_per_bit()));
        }
    }

    pub(super) fn finish_loop_back(&mut self, began: u64) {
        let sent = self.in_state(State::Transmitting).next();
        if let Some(index) = sent {
            let frame = self.mailboxes[index].frame();
            self.mailboxes[index].finish(TXOK);
            self.accept(began, &frame);
        }
    }
}
