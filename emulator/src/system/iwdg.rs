//! Independent watchdog (RM0390 rev 6, section 21), on its own oscillator LSI: nominally 32 kHz, by
//! the data sheet 17 to 47 kHz, so its frequency is a setting of the board. Once started only a
//! reset stops it, also while the core sleeps or is locked up.
//!
//! A value written to PR or RLR takes up to five LSI cycles to arrive; here always five, counted
//! from the start of the watchdog if it is written before, since LSI does not run until then.
//! Meanwhile PVU or RVU is set, the register reads its old value and ignores writes (21.4.2 to
//! 21.4.4). The start loads the counter with 0xFFF; the value in RLR takes effect at the first
//! feeding after it has arrived (21.3).
//!
//! Not modelled: LSI switched on by RCC_CSR before the start, and its start-up time.

const RELOAD: u32 = 0xAAAA;
const ENABLE_ACCESS: u32 = 0x5555;
const START: u32 = 0xCCCC;
const RESET_RELOAD: u32 = 0xFFF;
const PS_PER_S: u128 = 1_000_000_000_000;

/// PR or RLR.
#[derive(Debug, Clone, Copy)]
struct Register {
    in_force: u32,
    /// A value on its way, and the local time in ps at which it arrives; none before the start.
    pending: Option<(u32, Option<u64>)>,
}

impl Register {
    const fn new(in_force: u32) -> Self {
        Self {
            in_force,
            pending: None,
        }
    }

    /// Takes over what has arrived by `now_ps`.
    fn sync(&mut self, now_ps: u64) {
        if let Some((value, Some(at))) = self.pending
            && now_ps >= at
        {
            *self = Self::new(value);
        }
    }

    /// What is read, and whether an update is under way.
    fn read(mut self, now_ps: u64) -> (u32, bool) {
        self.sync(now_ps);
        (self.in_force, self.pending.is_some())
    }

    /// A write, ignored while an update is under way.
    fn write(&mut self, value: u32, arrives_at: Option<u64>) {
        if self.pending.is_none() {
            self.pending = Some((value, arrives_at));
        }
    }

    /// The watchdog starts, and LSI with it.
    fn start(&mut self, arrives_at: u64) {
        if let Some((_, at @ None)) = &mut self.pending {
            *at = Some(arrives_at);
        }
    }
}

/// IWDG.
#[derive(Debug, Clone)]
pub struct Iwdg {
    lsi_hz: u64,
    prescaler: Register,
    reload: Register,
    access: bool,
    /// Counts left, and the local time in ps at which they were; `None` before the start.
    count: Option<(u32, u64)>,
    /// Local time in ps at which the counter ends.
    expires_at: Option<u64>,
}

impl Iwdg {
    /// The watchdog after reset.
    #[must_use]
    pub fn new(lsi_hz: u64) -> Self {
        Self {
            lsi_hz: lsi_hz.max(1),
            prescaler: Register::new(0),
            reload: Register::new(RESET_RELOAD),
            access: false,
            count: None,
            expires_at: None,
        }
    }

    /// Resets it: a system reset also stops it.
    pub fn reset(&mut self) {
        *self = Self::new(self.lsi_hz);
    }

    /// Reads a register at a local time in ps; `None` for an offset without one.
    #[must_use]
    pub fn read(&self, now_ps: u64, offset: u32) -> Option<u32> {
        Some(match offset {
            0x0 => 0,
            0x4 => self.prescaler.read(now_ps).0,
            0x8 => self.reload.read(now_ps).0,
            0xC => {
                let (_, pvu) = self.prescaler.read(now_ps);
                let (_, rvu) = self.reload.read(now_ps);
                u32::from(pvu) | u32::from(rvu) << 1
            }
            _ => return None,
        })
    }

    /// Writes a register at a local time in ps; `None` for an offset without one.
    pub fn write(&mut self, now_ps: u64, offset: u32, value: u32) -> Option<()> {
        self.sync(now_ps);
        let five_cycles = now_ps + 5_000_000_000_000 / self.lsi_hz;
        let arrives_at = self.count.map(|_| five_cycles);
        match offset {
            0x0 => {
                self.access = value == ENABLE_ACCESS;
                match value {
                    START if self.count.is_none() => {
                        self.count = Some((RESET_RELOAD, now_ps));
                        self.prescaler.start(five_cycles);
                        self.reload.start(five_cycles);
                    }
                    RELOAD if self.count.is_some() => {
                        self.count = Some((self.reload.in_force, now_ps));
                    }
                    _ => {}
                }
            }
            0x4 if self.access => self.prescaler.write(value & 7, arrives_at),
            0x8 if self.access => self.reload.write(value & 0xFFF, arrives_at),
            0x4 | 0x8 | 0xC => {}
            _ => return None,
        }
        self.expires_at = self.end_of_count();
        Some(())
    }

    /// Local time in ps at which it resets the chip unless it is reloaded.
    #[must_use]
    pub fn expires_at(&self) -> Option<u64> {
        self.expires_at
    }

    /// The counter has stood still for so long, ps.
    pub fn stood(&mut self, ps: u64) {
        self.count = self.count.map(|(count, at)| (count, at + ps));
        self.expires_at = self.expires_at.map(|at| at + ps);
    }

    /// Takes over what has arrived.
    fn sync(&mut self, now_ps: u64) {
        if let Some((_, Some(at))) = self.prescaler.pending
            && now_ps >= at
        {
            self.count = self.counted_to(at);
        }
        self.prescaler.sync(now_ps);
        self.reload.sync(now_ps);
    }

    /// What is left of the count at `at_ps`, with the prescaler in force, and when the last whole
    /// count ended.
    fn counted_to(&self, at_ps: u64) -> Option<(u32, u64)> {
        let (left, since) = self.count?;
        let hz = u128::from(self.lsi_hz);
        let count = PS_PER_S * divider(self.prescaler.in_force);
        let done = u128::from(at_ps.saturating_sub(since)) * hz / count;
        let until = since + (done * count / hz) as u64;
        Some((left.saturating_sub(done as u32), until))
    }

    /// When the counter ends, a prescaler on its way included.
    fn end_of_count(&self) -> Option<u64> {
        let end = |(left, since): (u32, u64), prescaler| {
            let ps = divider(prescaler) * u128::from(left + 1) * PS_PER_S / u128::from(self.lsi_hz);
            since + ps as u64
        };
        let plain = end(self.count?, self.prescaler.in_force);
        Some(match self.prescaler.pending {
            Some((prescaler, Some(at))) if at < plain => end(self.counted_to(at)?, prescaler),
            _ => plain,
        })
    }
}

/// LSI cycles in a count (21.4.2).
fn divider(prescaler: u32) -> u128 {
    4 << prescaler.min(6)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Started with a divider of 4 and a reload of 400 cycles, fed at the returned time, when both
    /// have arrived.
    fn started(lsi_hz: u64) -> (Iwdg, u64) {
        let mut iwdg = Iwdg::new(lsi_hz);
        for (offset, value) in [(0, ENABLE_ACCESS), (4, 0), (8, 399), (0, START)] {
            iwdg.write(0, offset, value).unwrap();
        }
        let at = 5_000_000_000_000 / lsi_hz;
        assert_eq!(iwdg.read(at - 1, 0xC), Some(3));
        assert_eq!(iwdg.read(at, 0xC), Some(0));
        iwdg.write(at, 0, RELOAD).unwrap();
        (iwdg, at)
    }

    #[test]
    fn timeout_follows_the_lsi() {
        // 4 x 400 / 32 kHz = 50 ms; 34 ms and 94 ms at the ends of the data sheet's range.
        for (lsi_hz, ps) in [
            (32_000, 50_000_000_000),
            (47_000, 34_042_553_191),
            (17_000, 94_117_647_058),
        ] {
            let (iwdg, fed) = started(lsi_hz);
            assert_eq!(iwdg.expires_at(), Some(fed + ps));
        }
    }

    #[test]
    fn the_first_count_is_the_longest() {
        let mut iwdg = Iwdg::new(32_000);
        for (offset, value) in [(0, ENABLE_ACCESS), (4, 0), (8, 399), (0, START)] {
            iwdg.write(0, offset, value).unwrap();
        }
        // 4 x 4096 / 32 kHz, also when it is fed before the reload value has arrived.
        assert_eq!(iwdg.expires_at(), Some(512_000_000_000));
        iwdg.write(100_000_000, 0, RELOAD).unwrap();
        assert_eq!(iwdg.expires_at(), Some(512_100_000_000));
    }

    #[test]
    fn a_value_on_its_way_reads_as_the_old_one_and_takes_no_other() {
        let (mut iwdg, at) = started(32_000);
        iwdg.write(at, 0, ENABLE_ACCESS).unwrap();
        iwdg.write(at, 8, 99).unwrap();
        iwdg.write(at, 4, 3).unwrap();
        let later = at + 156_000_000;
        assert_eq!(iwdg.read(later, 8), Some(399));
        assert_eq!(iwdg.read(later, 4), Some(0));
        iwdg.write(later, 8, 1).unwrap();
        iwdg.write(later, 4, 1).unwrap();
        let arrived = at + 156_250_000;
        assert_eq!(iwdg.read(arrived, 8), Some(99));
        assert_eq!(iwdg.read(arrived, 4), Some(3));
        // Of the five cycles four are one count gone; the other 398 and the last one take 32 cycles
        // each.
        let counted = at + 125_000_000;
        let rest = 399 * 32 * 1_000_000_000_000 / 32_000;
        assert_eq!(iwdg.expires_at(), Some(counted + rest));
    }

    #[test]
    fn reload_starts_anew_and_nothing_stops_it() {
        let (mut iwdg, _) = started(32_000);
        iwdg.write(10_000_000_000, 0, RELOAD).unwrap();
        assert_eq!(iwdg.expires_at(), Some(60_000_000_000));
        iwdg.write(20_000_000_000, 0, 0).unwrap();
        assert_eq!(iwdg.expires_at(), Some(60_000_000_000));
    }

    #[test]
    fn settings_are_protected() {
        let mut iwdg = Iwdg::new(32_000);
        iwdg.write(0, 8, 1).unwrap();
        assert_eq!(iwdg.read(0, 8), Some(0xFFF));
        assert_eq!(iwdg.expires_at(), None);
    }
}
