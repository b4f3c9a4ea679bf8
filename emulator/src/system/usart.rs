//! A USART (RM0390 rev 6, section 25) as an asynchronous port with eight data bits, no parity and
//! one stop bit: data register, baud rate, status flags, idle line, DMA requests.
//!
//! The line into the chip is a queue of bytes with the time at which each begins and how long its
//! sender's bits last. The receiver samples it in the middle of its own bits, so a sender with
//! another baud rate gives what it gives on a robot: other bytes, and framing errors where the stop
//! bit is not one. The noise flag is never set, because a line here has sharp edges.
//!
//! Not modelled: other word lengths, parity, LIN, IrDA, smartcards, flow control, breaks sent by
//! the chip, multiprocessor mode.

use std::collections::VecDeque;

use crate::clock::earliest;

/// Registers (section 25.6).
mod reg {
    pub const SR: u32 = 0x00;
    pub const DR: u32 = 0x04;
    pub const BRR: u32 = 0x08;
    pub const CR1: u32 = 0x0C;
    pub const CR2: u32 = 0x10;
    pub const CR3: u32 = 0x14;
    pub const GTPR: u32 = 0x18;
}

/// Bits of SR.
mod sr {
    pub const FE: u32 = 1 << 1;
    pub const ORE: u32 = 1 << 3;
    pub const IDLE: u32 = 1 << 4;
    pub const RXNE: u32 = 1 << 5;
    pub const TC: u32 = 1 << 6;
    pub const TXE: u32 = 1 << 7;
    /// What reading SR and then DR clears.
    pub const BY_READING: u32 = FE | ORE | IDLE;
}

/// Bits of CR1.
mod cr1 {
    pub const RE: u32 = 1 << 2;
    pub const TE: u32 = 1 << 3;
    pub const IDLEIE: u32 = 1 << 4;
    pub const RXNEIE: u32 = 1 << 5;
    pub const TCIE: u32 = 1 << 6;
    pub const TXEIE: u32 = 1 << 7;
    pub const UE: u32 = 1 << 13;
    pub const OVER8: u32 = 1 << 15;
    pub const MODELLED: u32 = RE | TE | IDLEIE | RXNEIE | TCIE | TXEIE | UE | OVER8;
}

/// Bits of CR3.
mod cr3 {
    pub const EIE: u32 = 1;
    pub const DMAR: u32 = 1 << 6;
    pub const DMAT: u32 = 1 << 7;
    /// ONEBIT changes nothing on a line without noise.
    pub const MODELLED: u32 = EIE | DMAR | DMAT | 1 << 11;
}

/// Bits of a byte on the line: start, data, stop.
const BITS: f64 = 10.0;

/// A byte on its way into the chip.
#[derive(Debug, Clone, Copy)]
struct OnLine {
    /// When its start bit begins, in core cycles.
    start: f64,
    /// How long each of its bits lasts, in core cycles.
    bit: f64,
    byte: u8,
    /// Whether its stop bit is one.
    stop: bool,
}

impl OnLine {
    fn end(&self) -> f64 {
        self.start + BITS * self.bit
    }

    /// The level at a time in it.
    fn level(&self, at: f64) -> bool {
        match ((at - self.start) / self.bit) as u32 {
            0 => false,
            bit @ 1..=8 => self.byte >> (bit - 1) & 1 != 0,
            _ => self.stop,
        }
    }
}

/// The line while it is not driven.
#[derive(Debug, Clone, Copy)]
struct Undriven {
    /// Since when, in core cycles.
    from: f64,
    /// Until when; `None` while it still is.
    until: Option<f64>,
    /// What it is then: low by an end without power, high by a pull-up.
    level: bool,
}

/// One USART.
#[derive(Debug, Clone)]
pub(crate) struct Usart {
    sr: u32,
    received: u8,
    brr: u32,
    cr1: u32,
    cr2: u32,
    cr3: u32,
    /// Flags that the last read of SR has shown.
    shown: u32,
    /// Core cycles in a clock of its bus.
    ratio: u64,
    /// Bytes on the way in.
    line: VecDeque<OnLine>,
    /// When the line becomes free for the next byte.
    free_at: f64,
    /// When the start bit of the byte that is being received began.
    start: Option<f64>,
    /// When that byte is sampled for the last time.
    sampled_at: Option<u64>,
    /// The last time that the line was not driven.
    undriven: Option<Undriven>,
    /// Whether a byte has come since the line was found idle.
    idle_is_news: bool,
    /// When the line has been idle for a byte.
    idle_at: Option<u64>,
    /// Written to DR, not yet in the shift register.
    waiting: Option<u8>,
    /// In the shift register, and when its stop bit ends.
    shifting: Option<(u8, u64)>,
    /// Bytes that have left, with the cycle at which each ended.
    sent: Vec<(u64, u8)>,
}

impl Usart {
    /// After a system reset.
    pub(crate) fn new() -> Self {
        Self {
            sr: sr::TXE | sr::TC,
            received: 0,
            brr: 0,
            cr1: 0,
            cr2: 0,
            cr3: 0,
            shown: 0,
            ratio: 1,
            line: VecDeque::new(),
            free_at: 0.0,
            start: None,
            sampled_at: None,
            undriven: None,
            idle_is_news: false,
            idle_at: None,
            waiting: None,
            shifting: None,
            sent: Vec::new(),
        }
    }

    /// System reset, or reset by RCC. What is on the line stays there.
    pub(crate) fn reset(&mut self) {
        *self = Self {
            ratio: self.ratio,
            line: std::mem::take(&mut self.line),
            free_at: self.free_at,
            undriven: self.undriven,
            sent: std::mem::take(&mut self.sent),
            ..Self::new()
        };
    }

    /// Takes over how many core cycles a clock of its bus has.
    pub(crate) fn set_ratio(&mut self, ratio: u64) {
        self.ratio = ratio;
    }

    /// Core cycles of a bit (25.4.4); `None` without a baud rate.
    fn bit(&self) -> Option<u64> {
        let (mantissa, fraction) = (self.brr >> 4, self.brr & 0xF);
        let clocks = if self.cr1 & cr1::OVER8 != 0 {
            8 * mantissa + (fraction & 7)
        } else {
            16 * mantissa + fraction
        };
        (mantissa > 0).then(|| u64::from(clocks) * self.ratio)
    }

    /// Core cycles of a bit, while it is switched on; `None` otherwise.
    pub(crate) fn cycles_per_bit(&self) -> Option<u64> {
        self.bit().filter(|_| self.cr1 & cr1::UE != 0)
    }

    /// Reads a register.
    pub(crate) fn read(&mut self, offset: u32) -> Option<u32> {
        Some(match offset {
            reg::SR => {
                self.shown = self.sr;
                self.sr
            }
            reg::DR => {
                self.sr &= !(self.shown & sr::BY_READING) & !sr::RXNE;
                self.shown = 0;
                self.received.into()
            }
            reg::BRR => self.brr,
            reg::CR1 => self.cr1,
            reg::CR2 => self.cr2,
            reg::CR3 => self.cr3,
            reg::GTPR => 0,
            _ => return None,
        })
    }

    /// Writes a register.
    pub(crate) fn write(&mut self, now: u64, offset: u32, value: u32) -> Result<(), &'static str> {
        match offset {
            // 25.6.1: RXNE and TC are cleared by writing zero; the others here are not.
            reg::SR => self.sr &= value | !(sr::RXNE | sr::TC),
            reg::DR => self.put(now, value as u8),
            reg::BRR => self.brr = value & 0xFFFF,
            reg::CR1 if value & !cr1::MODELLED == 0 => {
                let was_on = self.receives();
                self.cr1 = value;
                if !was_on && self.receives() {
                    self.begin(now as f64);
                }
            }
            reg::CR2 if value == 0 => {}
            reg::CR3 if value & !cr3::MODELLED == 0 => self.cr3 = value,
            reg::CR1 | reg::CR2 | reg::CR3 => return Err("this mode of the port"),
            reg::GTPR => {}
            _ => return Err(""),
        }
        Ok(())
    }

    fn receives(&self) -> bool {
        self.cr1 & (cr1::UE | cr1::RE) == cr1::UE | cr1::RE && self.bit().is_some()
    }

    /// Puts a byte into the data register.
    pub(crate) fn put(&mut self, now: u64, byte: u8) {
        if self.cr1 & (cr1::UE | cr1::TE) != cr1::UE | cr1::TE {
            return;
        }
        self.sr &= !sr::TC;
        self.waiting = Some(byte);
        self.shift(now);
    }

    /// Moves the byte that waits into an empty shift register.
    fn shift(&mut self, now: u64) {
        if self.shifting.is_none()
            && let Some(bit) = self.bit()
            && let Some(byte) = self.waiting.take()
        {
            self.shifting = Some((byte, now + BITS as u64 * bit));
        }
        if self.waiting.is_none() {
            self.sr |= sr::TXE;
        } else {
            self.sr &= !sr::TXE;
        }
    }

    /// Whether it asks the DMA for a byte to send.
    pub(crate) fn wants_byte(&self) -> bool {
        let on = self.cr1 & (cr1::UE | cr1::TE) == cr1::UE | cr1::TE;
        on && self.cr3 & cr3::DMAT != 0 && self.sr & sr::TXE != 0
    }

    /// The byte that it asks the DMA to take.
    pub(crate) fn offers_byte(&self) -> bool {
        self.cr3 & cr3::DMAR != 0 && self.sr & sr::RXNE != 0
    }

    /// Hands the received byte to the DMA, which reads DR but not SR.
    pub(crate) fn read_byte(&mut self) -> u8 {
        self.sr &= !sr::RXNE;
        self.received
    }

    /// Puts a byte on the line into the chip, behind those that are there. Its bits last this many
    /// core cycles; without a stop bit it is what a line looks like that is pulled low.
    pub(crate) fn arrive(&mut self, now: u64, byte: u8, bit: f64, stop: bool) {
        if self.undriven.is_some_and(|span| span.until.is_none()) {
            return;
        }
        let start = self.free_at.max(now as f64);
        let on_line = OnLine {
            start,
            bit,
            byte,
            stop,
        };
        self.free_at = on_line.end();
        self.line.push_back(on_line);
        if self.sampled_at.is_none() {
            self.begin(now as f64);
        }
    }

    /// The other end lets go of the line, in the middle of a byte or not: it stays at this level,
    /// and what was still to come is lost.
    pub(crate) fn release(&mut self, now: u64, level: bool) {
        let from = now as f64;
        self.line.retain(|byte| byte.start < from);
        self.free_at = from;
        self.undriven = Some(Undriven {
            from,
            until: None,
            level,
        });
        if self.sampled_at.is_none() {
            self.begin(from);
            self.expect_idle(now);
        }
    }

    /// The other end drives the line again, which is idle.
    pub(crate) fn drive(&mut self, now: u64) {
        let Some(span) = self.undriven.as_mut().filter(|span| span.until.is_none()) else {
            return;
        };
        span.until = Some(now as f64);
        self.line.clear();
        self.free_at = now as f64;
        if self.sampled_at.is_none() {
            self.expect_idle(now);
        }
    }

    /// 25.4.3: idle is a whole frame of ones, once after every byte.
    fn expect_idle(&mut self, now: u64) {
        let expects = self.idle_is_news && self.sampled_at.is_none() && self.level(now as f64);
        let bit = self.bit().filter(|_| expects);
        self.idle_at = bit.map(|bit| now + BITS as u64 * bit);
    }

    /// Waits for the next start bit from a time on: a falling edge, wherever in a byte it is.
    fn begin(&mut self, from: f64) {
        while self.line.front().is_some_and(|byte| byte.end() <= from) {
            self.line.pop_front();
        }
        self.start = self.next_fall(from);
        self.sampled_at = match (self.start, self.bit()) {
            (Some(start), Some(bit)) if self.receives() => {
                Some((start + 9.5 * bit as f64).ceil() as u64)
            }
            _ => None,
        };
    }

    /// The level of the line at a time.
    fn level(&self, at: f64) -> bool {
        let undriven = self
            .undriven
            .filter(|span| span.from <= at && span.until.is_none_or(|until| at < until));
        if let Some(span) = undriven {
            return span.level;
        }
        let mut on_it = self
            .line
            .iter()
            .filter(|byte| byte.start <= at && at < byte.end());
        on_it.next().is_none_or(|byte| byte.level(at))
    }

    fn next_fall(&self, from: f64) -> Option<f64> {
        let edges = self.line.iter().flat_map(|byte| {
            (0..10).map(|n| (byte.start + f64::from(n) * byte.bit, byte.bit / 100.0))
        });
        // No byte begins while the line is not driven.
        let released = self.undriven.map(|span| (span.from, 1.0));
        edges
            .chain(released)
            .filter(|(edge, _)| *edge >= from)
            .find(|(edge, little)| self.level(edge - little) && !self.level(edge + little))
            .map(|(edge, _)| edge)
    }

    /// A byte has been sampled, the last time at `at`.
    fn sample(&mut self, at: u64) {
        self.sampled_at = None;
        let (Some(start), Some(bit)) = (self.start, self.bit()) else {
            return;
        };
        let level = |number: u32| self.level(start + (f64::from(number) + 0.5) * bit as f64);
        let byte = (0..8).fold(0, |byte, n| byte | u8::from(level(n + 1)) << n);
        let stop = level(9);
        if self.sr & sr::RXNE != 0 {
            // 25.4.3: the new byte is lost.
            self.sr |= sr::ORE;
        } else {
            self.received = byte;
            self.sr |= sr::RXNE;
        }
        if !stop {
            self.sr |= sr::FE;
        }
        self.begin(at as f64);
        self.idle_is_news = true;
        self.expect_idle(at);
    }

    /// Lets everything that is due by `now` happen, one thing at a time: the DMA serves it between.
    /// Returns whether anything has.
    pub(crate) fn sync(&mut self, now: u64) -> bool {
        let due = |at: Option<u64>| at.is_some_and(|at| at <= now);
        if due(self.shifting.map(|(_, end)| end)) {
            let Some((byte, end)) = self.shifting.take() else {
                return false;
            };
            self.sent.push((end, byte));
            self.shift(end);
            if self.shifting.is_none() {
                self.sr |= sr::TC;
            }
            return true;
        }
        if let Some(at) = self.sampled_at.filter(|at| *at <= now) {
            self.sample(at);
            return true;
        }
        if due(self.idle_at) {
            self.idle_at = None;
            if self.sampled_at.is_none() {
                self.idle_is_news = false;
                self.sr |= sr::IDLE;
            }
            return true;
        }
        false
    }

    /// When something will next happen by itself.
    pub(crate) fn next_event(&self) -> Option<u64> {
        let shifted = self.shifting.map(|(_, end)| end);
        earliest([shifted, self.sampled_at, self.idle_at])
    }

    /// Whether it asks for an interrupt (25.5).
    pub(crate) fn line(&self) -> bool {
        let enabled = |bit: u32, flags: u32| self.cr1 & bit != 0 && self.sr & flags != 0;
        let errors = self.cr3 & (cr3::EIE | cr3::DMAR) == cr3::EIE | cr3::DMAR
            && self.sr & (sr::FE | sr::ORE) != 0;
        errors
            || enabled(cr1::TXEIE, sr::TXE)
            || enabled(cr1::TCIE, sr::TC)
            || enabled(cr1::RXNEIE, sr::RXNE | sr::ORE)
            || enabled(cr1::IDLEIE, sr::IDLE)
    }

    /// Bytes that have left since the last call, with the cycle at which each ended.
    pub(crate) fn take_sent(&mut self) -> Vec<(u64, u8)> {
        std::mem::take(&mut self.sent)
    }

    /// Bytes that are still on the line into the chip.
    pub(crate) fn on_line(&self) -> usize {
        self.line.len()
    }

    /// Its register at an offset.
    pub(crate) fn register_name(offset: u32) -> &'static str {
        match offset {
            reg::SR => "SR",
            reg::DR => "DR",
            reg::BRR => "BRR",
            reg::CR1 => "CR1",
            reg::CR2 => "CR2",
            reg::CR3 => "CR3",
            reg::GTPR => "GTPR",
            _ => "",
        }
    }
}

#[cfg(test)]
mod tests;
