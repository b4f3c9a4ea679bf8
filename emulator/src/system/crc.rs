//! CRC unit (RM0390 rev 6, section 4): CRC-32 by words, a word in four cycles, which is no longer
//! than the loop that brings the next one.

/// The CRC unit.
#[derive(Debug, Clone)]
pub struct Crc {
    data: u32,
    independent: u32,
}

impl Default for Crc {
    fn default() -> Self {
        Self {
            data: u32::MAX,
            independent: 0,
        }
    }
}

impl Crc {
    /// As after a reset.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Reads a register; `None` for an offset without one.
    #[must_use]
    pub fn read(&self, offset: u32) -> Option<u32> {
        match offset {
            0 => Some(self.data),
            4 => Some(self.independent),
            8 => Some(0),
            _ => None,
        }
    }

    /// Writes a register; `None` for an offset without one.
    pub fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        match offset {
            0 => self.data = step(self.data, value),
            // Eight bits to keep something in.
            4 => self.independent = value & 0xFF,
            8 if value & 1 != 0 => self.data = u32::MAX,
            8 => {}
            _ => return None,
        }
        Some(())
    }

    /// Name of the register at an offset.
    #[must_use]
    pub fn register_name(offset: u32) -> &'static str {
        match offset {
            0 => "DR",
            4 => "IDR",
            8 => "CR",
            _ => "?",
        }
    }
}

/// A word more, from its highest bit on (4.3: the polynomial 0x04C1_1DB7).
fn step(crc: u32, word: u32) -> u32 {
    (0..32).fold(crc ^ word, |crc, _| {
        let shifted = crc << 1;
        if crc >> 31 == 1 {
            shifted ^ 0x04C1_1DB7
        } else {
            shifted
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A zero word from all ones leaves the remainder 0xC704_DD7B, and any value followed by itself
    /// the remainder 0.
    #[test]
    fn remainders_that_the_polynomial_gives() {
        let mut crc = Crc::default();
        crc.write(0, 0).unwrap();
        assert_eq!(crc.read(0), Some(0xC704_DD7B));
        crc.write(8, 1).unwrap();
        assert_eq!(crc.read(0), Some(u32::MAX));
        for word in [0x3132_3334, 0x3536_3738] {
            crc.write(0, word).unwrap();
        }
        let before = crc.read(0).unwrap();
        crc.write(0, before).unwrap();
        assert_eq!(crc.read(0), Some(0), "a value that follows what it is of");
    }

    #[test]
    fn other_registers() {
        let mut crc = Crc::default();
        crc.write(4, 0x1A5).unwrap();
        crc.write(8, 0).unwrap();
        assert_eq!((crc.read(4), crc.read(8)), (Some(0xA5), Some(0)));
        assert_eq!((crc.read(12), crc.write(12, 0)), (None, None));
    }
}
