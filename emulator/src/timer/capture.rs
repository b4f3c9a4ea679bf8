//! Input capture (RM0390 rev 6, sections 18.3.5 and 18.4.5, the same for TIM9 and TIM12 in 19): an
//! edge at the pin of channel 1 or 2 puts the counter into the channel's register.
//!
//! What it cannot do: it divides no edges (ICxPSC), captures no other channel's pin, and nothing
//! while the timer counts an encoder. Behind a filter an edge is captured with the counter as it
//! was when the timer was last updated.

use super::{Timer, flag};

/// Overcapture flag of channel 1.
const OVERCAPTURE: u32 = 1 << 9;

impl Timer {
    /// Whether a channel is an input on its own pin and not one of an encoder.
    pub(super) fn captures(&self, channel: usize) -> bool {
        let mode = self.ccmr[channel / 2] >> (8 * (channel % 2)) & 3;
        mode == 1 && self.smcr & 7 == 0
    }

    /// The level behind the filter of an input has changed.
    pub(super) fn capture(&mut self, channel: usize) {
        let bits = self.ccer >> (4 * channel);
        if !self.captures(channel) || bits & 1 == 0 || channel >= self.kind.channels {
            return;
        }
        let level = self.encoder.filtered[channel];
        // CCxP and CCxNP (18.4.9): neither is a rising edge, both are any edge.
        let wanted = match (bits & 2 != 0, bits & 8 != 0) {
            (false, false) => level,
            (true, false) => !level,
            (true, true) => true,
            (false, true) => false,
        };
        if wanted {
            let overrun = self.sr & flag::compare(channel) != 0;
            self.sr |= (u32::from(overrun) * (OVERCAPTURE << channel)) | flag::compare(channel);
            let count = self.count();
            self.ccr[channel].set_now(count);
        }
    }

    /// A captured value is read, which clears its flag (18.4.5).
    pub(super) fn take_capture(&mut self, channel: usize) {
        if self.captures(channel) {
            self.sr &= !flag::compare(channel);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Kind, reg};
    use super::*;

    /// TIM12 at a tenth of the core's clock, both channels inputs with these bits of CCER.
    fn timer(ccer: u32) -> Timer {
        let mut timer = Timer::new(Kind::TWO_CHANNELS);
        for (offset, value) in [
            (reg::CCMR1, 0x0101),
            (reg::CCER, ccer),
            (reg::PSC, 9),
            (reg::EGR, 1),
            (reg::SR, 0),
            (reg::CR1, 1),
        ] {
            timer.write(0, offset, value).unwrap();
        }
        timer
    }

    fn captured(timer: &mut Timer, now: u64) -> [u32; 2] {
        [0, 4].map(|more| timer.read(now, reg::CCR1 + more).unwrap())
    }

    #[test]
    fn an_edge_is_captured_with_the_counter_of_its_time() {
        // Any edge at channel 1, rising ones at channel 2.
        let mut t = timer(0x1B);
        t.set_input(1_005, 0, true);
        t.set_input(2_009, 1, true);
        assert_eq!(captured(&mut t, 9_000), [100, 200]);
        t.set_input(10_000, 0, false);
        t.set_input(10_500, 1, false);
        assert_eq!(captured(&mut t, 11_000), [1_000, 200]);
    }

    #[test]
    fn a_channel_that_is_off_captures_nothing() {
        let mut t = timer(0xB0);
        t.set_input(1_000, 0, true);
        t.set_input(1_000, 1, true);
        assert_eq!(captured(&mut t, 2_000), [0, 100]);
    }

    #[test]
    fn the_flag_goes_when_the_value_is_read_and_a_second_edge_is_marked() {
        let mut t = timer(0xBB);
        t.set_input(1_000, 0, true);
        assert_eq!(t.read(1_001, reg::SR).unwrap() & 0x202, 2);
        t.set_input(2_000, 0, false);
        assert_eq!(t.read(2_001, reg::SR).unwrap() & 0x202, 0x202);
        captured(&mut t, 2_002);
        assert_eq!(t.read(2_003, reg::SR).unwrap() & 2, 0);
    }
}
