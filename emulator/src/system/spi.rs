//! SPI1 as a master on four wires (RM0090 rev 19, section 28; the same registers in RM0390, section
//! 26): frames of 8 or 16 bits, clock divider, transmit buffer and shift register, overrun.
//!
//! A frame is exchanged with the device when it begins; its bits are in the receive buffer when it
//! ends. Which pin selects a device is the program's own business (`SSM` and `SSI`), as it is on
//! boards with several devices.
//!
//! | not modelled (a write that asks for it ends the run) | RM0090 |
//! |---|---|
//! | slave, one or three wires, least bit first, hardware NSS | 28.3.1 to 28.3.4 |
//! | interrupts, DMA | 28.3.9, 28.3.11 |
//! | CRC, TI mode, I2S | 28.3.6, 28.3.8, 28.4 |
//! | SPI2 and SPI3, and SPI1 of an STM32F103 | |

/// Registers (28.5).
mod reg {
    pub const CR1: u32 = 0x00;
    pub const CR2: u32 = 0x04;
    pub const SR: u32 = 0x08;
    pub const DR: u32 = 0x0C;
    pub const CRCPR: u32 = 0x10;
}

/// Bits of CR1.
mod cr1 {
    pub const MSTR: u32 = 1 << 2;
    pub const SPE: u32 = 1 << 6;
    pub const SSI: u32 = 1 << 8;
    pub const SSM: u32 = 1 << 9;
    pub const DFF: u32 = 1 << 11;
    /// CPHA and CPOL, BR and what is above.
    pub const MODELLED: u32 = 0b11 | MSTR | 0b111 << 3 | SPE | SSI | SSM | DFF;
}

/// Bits of SR.
mod sr {
    pub const RXNE: u32 = 1;
    pub const TXE: u32 = 1 << 1;
    pub const OVR: u32 = 1 << 6;
    pub const BSY: u32 = 1 << 7;
}

/// What is at the other end: takes the bits of a frame and their number, and returns its own.
pub(crate) type Exchange<'a> = &'a mut dyn FnMut(u16, u32) -> u16;

/// One SPI.
#[derive(Debug, Clone, Default)]
pub(crate) struct Spi {
    cr1: u32,
    received: Option<u16>,
    last: u16,
    overrun: bool,
    /// Written to DR, not yet in the shift register.
    waiting: Option<u16>,
    /// What the device has answered, and when the frame ends.
    shifting: Option<(u16, u64)>,
    /// Core cycles in a clock of its bus.
    ratio: u64,
}

impl Spi {
    /// After a reset; the clock stays.
    pub(crate) fn reset(&mut self) {
        *self = Self {
            ratio: self.ratio,
            ..Self::default()
        };
    }

    /// Sets how many core cycles a clock of its bus takes.
    pub(crate) fn set_ratio(&mut self, ratio: u64) {
        self.ratio = ratio;
    }

    fn bits(&self) -> u32 {
        if self.cr1 & cr1::DFF == 0 { 8 } else { 16 }
    }

    /// Core cycles of a frame: 2 to 256 clocks a bit.
    fn cycles(&self) -> u64 {
        let divider = 2 << (self.cr1 >> 3 & 0b111);
        u64::from(self.bits()) * divider * self.ratio.max(1)
    }

    /// Ends the frame that is over, and begins the one that waits.
    fn sync(&mut self, now: u64, exchange: Exchange) {
        while let Some((answer, end)) = self.shifting.filter(|(_, end)| *end <= now) {
            if self.received.is_some() {
                self.overrun = true;
            } else {
                self.received = Some(answer);
            }
            self.shifting = None;
            if let Some(word) = self.waiting.take() {
                self.begin(end, word, exchange);
            }
        }
    }

    fn begin(&mut self, now: u64, word: u16, exchange: Exchange) {
        let bits = self.bits();
        let mask = if bits == 8 { 0xFF } else { 0xFFFF };
        let answer = exchange(word & mask, bits) & mask;
        self.shifting = Some((answer, now + self.cycles()));
    }

    /// Reads a register; `None` for an offset without one.
    pub(crate) fn read(&mut self, now: u64, offset: u32, exchange: Exchange) -> Option<u32> {
        self.sync(now, exchange);
        Some(match offset {
            reg::CR1 => self.cr1,
            reg::CR2 => 0,
            reg::SR => {
                let flag = |on: bool, bit: u32| if on { bit } else { 0 };
                flag(self.received.is_some(), sr::RXNE)
                    | flag(self.waiting.is_none(), sr::TXE)
                    | flag(self.overrun, sr::OVR)
                    | flag(self.shifting.is_some(), sr::BSY)
            }
            reg::DR => {
                self.last = self.received.take().unwrap_or(self.last);
                // 28.3.10: reading DR and then SR clears it. Here DR alone does.
                self.overrun = false;
                self.last.into()
            }
            reg::CRCPR => 7,
            _ => return None,
        })
    }

    /// Writes a register.
    ///
    /// # Errors
    /// What is asked for is not modelled.
    pub(crate) fn write(
        &mut self,
        now: u64,
        offset: u32,
        value: u32,
        exchange: Exchange,
    ) -> Result<(), &'static str> {
        self.sync(now, exchange);
        match offset {
            reg::CR1 => {
                if value & 0xFFFF & !cr1::MODELLED != 0 {
                    return Err("a mode that is not modelled");
                }
                let master = cr1::MSTR | cr1::SSM | cr1::SSI;
                if value & cr1::SPE != 0 && value & master != master {
                    return Err("only a master without NSS is modelled");
                }
                self.cr1 = value & cr1::MODELLED;
            }
            reg::CR2 if value == 0 => {}
            reg::CR2 => return Err("interrupts and DMA are not modelled"),
            // CRCERR and others that nothing sets.
            reg::SR => {}
            reg::DR if self.cr1 & cr1::SPE == 0 => return Err("written while SPE is clear"),
            reg::DR => {
                let word = value as u16;
                if self.shifting.is_none() {
                    self.begin(now, word, exchange);
                } else {
                    self.waiting = Some(word);
                }
            }
            _ => return Err(""),
        }
        Ok(())
    }

    /// Name of the register at an offset.
    #[must_use]
    pub(crate) fn register_name(offset: u32) -> &'static str {
        match offset {
            reg::CR1 => "CR1",
            reg::CR2 => "CR2",
            reg::SR => "SR",
            reg::DR => "DR",
            reg::CRCPR => "CRCPR",
            _ => "?",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MASTER_16: u32 = cr1::MSTR | cr1::SPE | cr1::SSI | cr1::SSM | cr1::DFF;

    /// Sixteen bits at a divider of 16 on a bus with half the core's clock: 512 cycles. The buffer
    /// takes a second word at once, and what is not read in time is lost.
    #[test]
    fn a_frame_takes_its_time_and_the_next_follows_it() {
        let mut spi = Spi::default();
        spi.set_ratio(2);
        let mut seen = Vec::new();
        let mut echo = |word: u16, bits: u32| {
            seen.push((word, bits));
            !word
        };
        spi.write(0, reg::CR1, MASTER_16 | 3 << 3, &mut echo)
            .unwrap();
        assert_eq!(spi.read(0, reg::SR, &mut echo), Some(sr::TXE));
        spi.write(0, reg::DR, 0x8612, &mut echo).unwrap();
        assert_eq!(spi.read(0, reg::SR, &mut echo), Some(sr::TXE | sr::BSY));
        spi.write(1, reg::DR, 0x0034, &mut echo).unwrap();
        assert_eq!(spi.read(511, reg::SR, &mut echo), Some(sr::BSY));
        let second = sr::TXE | sr::BSY | sr::RXNE;
        assert_eq!(spi.read(512, reg::SR, &mut echo), Some(second));
        assert_eq!(spi.read(513, reg::DR, &mut echo), Some(0x79ED));
        assert_eq!(spi.read(1024, reg::SR, &mut echo), Some(sr::TXE | sr::RXNE));
        spi.write(1024, reg::DR, 0, &mut echo).unwrap();
        let lost = sr::TXE | sr::RXNE | sr::OVR;
        assert_eq!(spi.read(1536, reg::SR, &mut echo), Some(lost));
        assert_eq!(spi.read(1536, reg::DR, &mut echo), Some(0xFFCB));
        assert_eq!(spi.read(1536, reg::SR, &mut echo), Some(sr::TXE));
        assert_eq!(seen, [(0x8612, 16), (0x0034, 16), (0, 16)]);
    }

    #[test]
    fn what_is_not_modelled_is_refused() {
        let mut none = |_: u16, _: u32| 0;
        let mut spi = Spi::default();
        assert!(spi.write(0, reg::DR, 1, &mut none).is_err());
        assert!(spi.write(0, reg::CR1, cr1::SPE, &mut none).is_err());
        assert!(
            spi.write(0, reg::CR1, 1 << 7, &mut none).is_err(),
            "least bit first"
        );
        assert!(spi.write(0, reg::CR2, 1 << 6, &mut none).is_err());
        assert!(spi.read(0, 0x14, &mut none).is_none());
        // 16 bits of 8: the lower byte alone is exchanged.
        let mut bits = |word: u16, bits: u32| {
            assert_eq!((word, bits), (0x12, 8));
            0xABCD
        };
        spi.write(0, reg::CR1, MASTER_16 & !cr1::DFF, &mut bits)
            .unwrap();
        spi.write(0, reg::DR, 0x3412, &mut bits).unwrap();
        assert_eq!(spi.read(16, reg::DR, &mut bits), Some(0xCD));
    }
}
