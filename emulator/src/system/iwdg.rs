//! Independent watchdog (RM0390 rev 6, section 21), on its own oscillator LSI: nominally 32 kHz, by the data
//! sheet 17 to 47 kHz, so its frequency is a setting of the board. Once started only a reset stops it, also
//! while the core sleeps or is locked up.

const RELOAD: u32 = 0xAAAA;
const ENABLE_ACCESS: u32 = 0x5555;
const START: u32 = 0xCCCC;

/// IWDG.
#[derive(Debug, Clone)]
pub struct Iwdg {
    lsi_hz: u64,
    prescaler: u32,
    reload: u32,
    access: bool,
    /// Local time in ps at which the counter was last loaded; `None` before the start.
    loaded_at: Option<u64>,
    /// Until when PVU and RVU are set: a new value takes up to 5 LSI cycles to arrive (21.4.4).
    updating: [u64; 2],
}

impl Iwdg {
    /// The watchdog after reset.
    #[must_use]
    pub fn new(lsi_hz: u64) -> Self {
        Self {
            lsi_hz: lsi_hz.max(1),
            prescaler: 0,
            reload: 0xFFF,
            access: false,
            loaded_at: None,
            updating: [0; 2],
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
            0x4 => self.prescaler,
            0x8 => self.reload,
            0xC => u32::from(now_ps < self.updating[0]) | u32::from(now_ps < self.updating[1]) << 1,
            _ => return None,
        })
    }

    /// Writes a register at a local time in ps; `None` for an offset without one.
    pub fn write(&mut self, now_ps: u64, offset: u32, value: u32) -> Option<()> {
        let five_cycles = 5_000_000_000_000 / self.lsi_hz;
        match offset {
            0x0 => {
                self.access = value == ENABLE_ACCESS;
                match value {
                    START => self.loaded_at = Some(now_ps),
                    RELOAD if self.loaded_at.is_some() => self.loaded_at = Some(now_ps),
                    _ => {}
                }
            }
            0x4 if self.access => {
                self.prescaler = value & 7;
                self.updating[0] = now_ps + five_cycles;
            }
            0x8 if self.access => {
                self.reload = value & 0xFFF;
                self.updating[1] = now_ps + five_cycles;
            }
            0x4 | 0x8 | 0xC => {}
            _ => return None,
        }
        Some(())
    }

    /// Local time in ps at which it resets the chip unless it is reloaded.
    #[must_use]
    pub fn expires_at(&self) -> Option<u64> {
        let divider = 4_u64 << self.prescaler.min(6);
        let ps = u128::from(divider) * u128::from(self.reload + 1) * 1_000_000_000_000
            / u128::from(self.lsi_hz);
        self.loaded_at.map(|at| at + ps as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn started(lsi_hz: u64) -> Iwdg {
        let mut iwdg = Iwdg::new(lsi_hz);
        for (offset, value) in [(0, ENABLE_ACCESS), (4, 0), (8, 399), (0, START)] {
            iwdg.write(0, offset, value).unwrap();
        }
        iwdg
    }

    #[test]
    fn timeout_follows_the_lsi() {
        // 4 x 400 / 32 kHz = 50 ms; 34 ms and 94 ms at the ends of the data sheet's range.
        assert_eq!(started(32_000).expires_at(), Some(50_000_000_000));
        assert_eq!(started(47_000).expires_at(), Some(34_042_553_191));
        assert_eq!(started(17_000).expires_at(), Some(94_117_647_058));
    }

    #[test]
    fn reload_starts_anew_and_nothing_stops_it() {
        let mut iwdg = started(32_000);
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
