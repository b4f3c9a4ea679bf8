//! The DMA controllers (RM0390 rev 6, section 9): DMA1 as far as a byte at a time goes between a
//! peripheral's data register and memory.
//!
//! A stream moves one byte whenever its peripheral asks, at once: the real one takes some ten
//! cycles, a byte of the fastest serial line two thousand. Modelled are single buffers, once or
//! circular, in direct mode, with half-transfer and transfer-complete flags and their interrupts.
//! Anything else (FIFO, double buffers, wider items, memory to memory, the peripheral as flow
//! controller) is refused when the stream is enabled.

use crate::memory_map::RAM_BASE;
use crate::ram::Ram;

/// Registers (section 9.5).
mod reg {
    pub const LISR: u32 = 0x00;
    pub const HISR: u32 = 0x04;
    pub const LIFCR: u32 = 0x08;
    pub const HIFCR: u32 = 0x0C;
    pub const STREAMS: u32 = 0x10;
    pub const STREAM: u32 = 0x18;
    pub const CR: u32 = 0x00;
    pub const NDTR: u32 = 0x04;
    pub const PAR: u32 = 0x08;
    pub const M0AR: u32 = 0x0C;
    pub const M1AR: u32 = 0x10;
    pub const FCR: u32 = 0x14;
}

/// Bits of a stream's CR.
mod cr {
    pub const EN: u32 = 1;
    pub const TEIE: u32 = 1 << 2;
    pub const HTIE: u32 = 1 << 3;
    pub const TCIE: u32 = 1 << 4;
    pub const DIR: u32 = 3 << 6;
    pub const TO_PERIPHERAL: u32 = 1 << 6;
    pub const CIRC: u32 = 1 << 8;
    pub const MINC: u32 = 1 << 10;
    /// DMEIE has no effect here and PL none on a stream alone.
    pub const HARMLESS: u32 = 1 << 1 | 3 << 16;
    pub const CHSEL_SHIFT: u32 = 25;
    pub const CHSEL: u32 = 7 << CHSEL_SHIFT;
    pub const MODELLED: u32 = EN | TEIE | HTIE | TCIE | DIR | CIRC | MINC | HARMLESS | CHSEL;
}

/// Flags of a stream, as in the lowest six bits of LISR.
mod flag {
    pub const TE: u32 = 1 << 3;
    pub const HT: u32 = 1 << 4;
    pub const TC: u32 = 1 << 5;
}

/// Where the flags of the four streams of a register begin.
const FLAG_SHIFTS: [u32; 4] = [0, 6, 16, 22];

#[derive(Debug, Clone, Copy, Default)]
struct Stream {
    cr: u32,
    /// Items left.
    ndtr: u32,
    par: u32,
    m0ar: u32,
    m1ar: u32,
    flags: u32,
    /// Items of a whole transfer, as written before it was enabled.
    whole: u32,
}

/// One controller with its eight streams.
#[derive(Debug, Clone, Default)]
pub(crate) struct Dma {
    streams: [Stream; 8],
}

impl Dma {
    /// System reset, or reset by RCC.
    pub(crate) fn reset(&mut self) {
        *self = Self::default();
    }

    fn split(offset: u32) -> Option<(usize, u32)> {
        let offset = offset.checked_sub(reg::STREAMS)?;
        let stream = (offset / reg::STREAM) as usize;
        (stream < 8).then_some((stream, offset % reg::STREAM))
    }

    /// Reads a register.
    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        let flags = |from: usize| {
            let streams = &self.streams[from..from + 4];
            let pairs = streams.iter().zip(FLAG_SHIFTS);
            pairs.fold(0, |word, (stream, shift)| word | stream.flags << shift)
        };
        Some(match offset {
            reg::LISR => flags(0),
            reg::HISR => flags(4),
            reg::LIFCR | reg::HIFCR => 0,
            _ => {
                let (stream, register) = Self::split(offset)?;
                let stream = &self.streams[stream];
                match register {
                    reg::CR => stream.cr,
                    reg::NDTR => stream.ndtr,
                    reg::PAR => stream.par,
                    reg::M0AR => stream.m0ar,
                    reg::M1AR => stream.m1ar,
                    // 9.5.10: the reset value; the FIFO is empty.
                    reg::FCR => 0x21,
                    _ => return None,
                }
            }
        })
    }

    /// Writes a register.
    pub(crate) fn write(&mut self, offset: u32, value: u32) -> Result<(), &'static str> {
        let half = match offset {
            reg::LISR | reg::HISR => return Ok(()),
            reg::LIFCR => Some(0),
            reg::HIFCR => Some(4),
            _ => None,
        };
        if let Some(from) = half {
            for (stream, shift) in self.streams[from..].iter_mut().zip(FLAG_SHIFTS) {
                stream.flags &= !(value >> shift & 0x3D);
            }
            return Ok(());
        }
        let (number, register) = Self::split(offset).ok_or("")?;
        let stream = &mut self.streams[number];
        let enabled = stream.cr & cr::EN != 0;
        match register {
            reg::CR => {
                // 9.3.17: a stream that is switched off in the middle has its TC flag set.
                if enabled && value & cr::EN == 0 {
                    stream.flags |= flag::TC;
                }
                if !enabled && value & cr::EN != 0 {
                    if value & !cr::MODELLED != 0 || value & cr::DIR == cr::DIR {
                        return Err("this kind of transfer");
                    }
                    // 9.3.17: flags of an earlier transfer have to be cleared first.
                    if stream.flags & (flag::TC | flag::TE) != 0 {
                        return Err("enabled with flags of an earlier transfer set");
                    }
                    stream.whole = stream.ndtr;
                    if stream.ndtr == 0 {
                        return Ok(());
                    }
                }
                stream.cr = value;
            }
            // 9.5.6 to 9.5.9: these can be written only while the stream is disabled.
            reg::NDTR if !enabled => stream.ndtr = value & 0xFFFF,
            reg::PAR if !enabled => stream.par = value,
            reg::M0AR if !enabled => stream.m0ar = value,
            reg::M1AR => stream.m1ar = value,
            reg::NDTR | reg::PAR | reg::M0AR => return Err("written while the stream is enabled"),
            reg::FCR if value & 0x84 == 0 => {}
            _ => return Err("FIFO"),
        }
        Ok(())
    }

    /// The enabled stream, if it serves this channel and data register in this direction.
    fn serving(
        &mut self,
        stream: usize,
        channel: u32,
        data_register: u32,
        to_peripheral: bool,
    ) -> Option<&mut Stream> {
        let stream = &mut self.streams[stream];
        let direction = stream.cr & cr::DIR == if to_peripheral { cr::TO_PERIPHERAL } else { 0 };
        let serves = stream.cr & cr::EN != 0
            && (stream.cr & cr::CHSEL) >> cr::CHSEL_SHIFT == channel
            && stream.par == data_register
            && direction;
        serves.then_some(stream)
    }

    /// Whether a byte from this data register would be taken.
    pub(crate) fn takes(&mut self, stream: usize, channel: u32, data_register: u32) -> bool {
        self.serving(stream, channel, data_register, false)
            .is_some()
    }

    /// The peripheral asks for its byte to be put into memory.
    pub(crate) fn put(
        &mut self,
        ram: &Ram,
        stream: usize,
        channel: u32,
        data_register: u32,
        byte: u8,
    ) {
        if let Some(stream) = self.serving(stream, channel, data_register, false) {
            let done = stream.place().and_then(|at| ram.write_at(at, &[byte]).ok());
            stream.moved(done);
        }
    }

    /// The peripheral asks for a byte from memory.
    pub(crate) fn get(
        &mut self,
        ram: &Ram,
        stream: usize,
        channel: u32,
        data_register: u32,
    ) -> Option<u8> {
        let stream = self.serving(stream, channel, data_register, true)?;
        let mut byte = [0];
        let done = stream
            .place()
            .and_then(|at| ram.read_at(at, &mut byte).ok());
        stream.moved(done);
        done.map(|()| byte[0])
    }

    /// Whether a stream asks for an interrupt.
    pub(crate) fn line(&self, stream: usize) -> bool {
        let Stream { cr, flags, .. } = self.streams[stream];
        // The enable bits lie one below their flags.
        flags >> 1 & cr & (cr::TEIE | cr::HTIE | cr::TCIE) != 0
    }

    /// Its register at an offset.
    pub(crate) fn register_name(offset: u32) -> &'static str {
        match (offset, Self::split(offset)) {
            (reg::LISR | reg::HISR, _) => "ISR",
            (reg::LIFCR | reg::HIFCR, _) => "IFCR",
            (_, Some((_, reg::CR))) => "SxCR",
            (_, Some((_, reg::NDTR))) => "SxNDTR",
            (_, Some((_, reg::PAR))) => "SxPAR",
            (_, Some((_, reg::M0AR))) => "SxM0AR",
            (_, Some((_, reg::M1AR))) => "SxM1AR",
            (_, Some((_, reg::FCR))) => "SxFCR",
            _ => "",
        }
    }
}

impl Stream {
    /// Where in the RAM the next item is.
    fn place(&self) -> Option<u64> {
        let done = if self.cr & cr::MINC != 0 {
            self.whole - self.ndtr
        } else {
            0
        };
        u64::from(self.m0ar)
            .checked_sub(u64::from(RAM_BASE))
            .map(|offset| offset + u64::from(done))
    }

    /// An item has been moved, or the bus has refused it.
    fn moved(&mut self, done: Option<()>) {
        if done.is_none() {
            // 9.3.18: a bus error ends the transfer.
            self.flags |= flag::TE;
            self.cr &= !cr::EN;
            return;
        }
        self.ndtr -= 1;
        if self.ndtr == self.whole / 2 {
            self.flags |= flag::HT;
        }
        if self.ndtr == 0 {
            self.flags |= flag::TC;
            if self.cr & cr::CIRC != 0 {
                self.ndtr = self.whole;
            } else {
                self.cr &= !cr::EN;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DATA: u32 = 0x4000_4404;
    const STREAM_5: u32 = reg::STREAMS + 5 * reg::STREAM;

    fn receiving(length: u32, control: u32) -> (Dma, Ram) {
        let mut dma = Dma::default();
        for (register, value) in [
            (reg::PAR, DATA),
            (reg::M0AR, RAM_BASE + 0x100),
            (reg::NDTR, length),
            (reg::CR, 4 << cr::CHSEL_SHIFT | cr::MINC | control | cr::EN),
        ] {
            dma.write(STREAM_5 + register, value).unwrap();
        }
        (dma, Ram::new(&crate::chip::F446))
    }

    /// HISR: the flags of stream 5 begin at bit 6.
    fn flags(dma: &Dma) -> u32 {
        dma.read(reg::HISR).unwrap() >> 6 & 0x3D
    }

    #[test]
    fn a_circular_buffer_is_filled_over_and_over() {
        let (mut dma, ram) = receiving(4, cr::CIRC | cr::HTIE);
        for byte in b"abcde" {
            dma.put(&ram, 5, 4, DATA, *byte);
        }
        let mut buffer = [0; 5];
        ram.read_at(0x100, &mut buffer).unwrap();
        assert_eq!(&buffer, b"ebcd\0");
        assert_eq!(dma.read(STREAM_5 + reg::NDTR), Some(3));
        assert_eq!(flags(&dma), flag::HT | flag::TC);
        assert!(dma.line(5));
        dma.write(reg::HIFCR, 0x10 << 6).unwrap();
        assert!(!dma.line(5), "TCIE is off");
    }

    #[test]
    fn a_transfer_ends_and_is_begun_again_with_clean_flags() {
        let (mut dma, ram) = receiving(2, cr::TCIE);
        for byte in b"abc" {
            dma.put(&ram, 5, 4, DATA, *byte);
        }
        let mut buffer = [0; 3];
        ram.read_at(0x100, &mut buffer).unwrap();
        assert_eq!(&buffer, b"ab\0", "it was over after two");
        assert_eq!(dma.read(STREAM_5 + reg::CR).unwrap() & cr::EN, 0);
        let enable = 4 << cr::CHSEL_SHIFT | cr::EN;
        assert!(dma.write(STREAM_5 + reg::CR, enable).is_err());
        dma.write(reg::HIFCR, 0x3D << 6).unwrap();
        dma.write(STREAM_5 + reg::NDTR, 1).unwrap();
        assert_eq!(dma.write(STREAM_5 + reg::CR, enable), Ok(()));
    }

    #[test]
    fn only_its_own_channel_and_register_are_served() {
        let (mut dma, ram) = receiving(4, 0);
        dma.put(&ram, 5, 3, DATA, b'x');
        dma.put(&ram, 5, 4, DATA + 0x400, b'x');
        assert_eq!(dma.get(&ram, 5, 4, DATA), None, "the other direction");
        assert_eq!(dma.read(STREAM_5 + reg::NDTR), Some(4));
    }

    #[test]
    fn memory_that_is_not_there_is_an_error() {
        let (mut dma, ram) = receiving(4, cr::TEIE);
        dma.streams[5].m0ar = 0x1000_0000;
        dma.put(&ram, 5, 4, DATA, b'x');
        assert_eq!(flags(&dma), flag::TE);
        assert!(dma.line(5));
    }

    #[test]
    fn what_is_not_modelled_is_refused_when_it_is_enabled() {
        let mut dma = Dma::default();
        dma.write(STREAM_5 + reg::NDTR, 1).unwrap();
        for unmodelled in [1 << 18, 1 << 11, 1 << 5, cr::DIR] {
            let result = dma.write(STREAM_5 + reg::CR, unmodelled | cr::EN);
            assert!(result.is_err(), "{unmodelled:#x}");
        }
        assert!(dma.write(STREAM_5 + reg::FCR, 1 << 2).is_err());
    }
}
