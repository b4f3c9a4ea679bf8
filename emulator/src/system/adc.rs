//! A converter as a voltmeter (RM0390 rev 6, section 13; RM0090 rev 19, section 13): one regular
//! channel, converted once or over and over, and injected channels after it.
//!
//! | register | section | modelled |
//! |---|---|---|
//! | SR | 13.13.1 | EOC, STRT; the flags of injected channels read as 0 |
//! | CR1 | 13.13.2 | RES at 12 bits; JAUTO with SCAN; everything else is refused |
//! | CR2 | 13.13.3 | ADON, CONT, SWSTART, ALIGN to the right; triggers and DMA are refused |
//! | SMPR1, SMPR2 | 13.13.4, 13.13.5 | sampling times |
//! | SQR1..3 | 13.13.9 to 13.13.11 | a sequence of one |
//! | JSQR | 13.13.12 | the injected sequence, converted after the regular channel each time |
//! | JDR1..4 | 13.13.13 | the last results of the injected channels |
//! | DR | 13.13.14 | the last result; reading clears EOC |
//! | CCR | 13.13.16 | ADCPRE, TSVREFE |
//!
//! A conversion takes the sampling time and 12 clocks (13.5), and converts the input at the end of
//! sampling. The result is the input over the reference, rounded down to 12 bits. The reference is
//! the supply of the chip, as on the NUCLEO board. Of the internal channels VREFINT is modelled,
//! which ADC1 alone has (13.10). The watchdog is not.

use std::cell::Cell;

use crate::family::Family;
use crate::system::gpio::Port;

mod f1;

/// Reference voltage of the board, V, until another is set. At this one ST measures VREFINT.
const VREF: f64 = 3.3;
/// The chip's internal reference, V: typical (DS10693, embedded reference voltage), and its
/// channel.
const VREFINT: f64 = 1.21;
const VREFINT_CHANNEL: usize = 17;
/// VREFIN_CAL (the same): what the converter makes of VREFINT at [`VREF`].
pub const VREFINT_CALIBRATION: u16 = (VREFINT / VREF * STEPS) as u16;
const STEPS: f64 = 4096.0;
/// Half clocks of a 12-bit conversion after sampling (13.5).
const CONVERSION: u64 = 24;
/// Sampling times by SMP, half ADC clocks (13.13.4).
const SAMPLING: [u64; 8] = [6, 30, 56, 112, 168, 224, 288, 960];
/// Dividers of PCLK2 by ADCPRE (13.13.16).
const DIVIDERS: [u64; 4] = [2, 4, 6, 8];
/// Fastest clock by the data sheet, Hz.
const MAX_HZ: u64 = 36_000_000;

mod cr1 {
    pub const SCAN: u32 = 1 << 8;
    pub const JAUTO: u32 = 1 << 10;
}

mod cr2 {
    pub const ADON: u32 = 1;
    pub const CONT: u32 = 1 << 1;
    pub const SWSTART: u32 = 1 << 30;
}

mod ccr {
    pub const ADCPRE: u32 = 3 << 16;
    pub const TSVREFE: u32 = 1 << 23;
}

mod sr {
    pub const EOC: u32 = 1 << 1;
    pub const STRT: u32 = 1 << 4;
}

/// What is connected to one input.
#[derive(Debug, Clone, Copy, Default)]
struct Input {
    volts: f64,
    before: f64,
    since_ps: u64,
}

/// One of the converters, with its copy of the common register.
#[derive(Debug, Clone)]
pub struct Adc {
    /// 1 to 3.
    number: usize,
    family: Family,
    cr1: u32,
    cr2: u32,
    smpr: [u32; 2],
    sqr: [u32; 3],
    jsqr: u32,
    ccr: u32,
    pclk2: u64,
    /// Local time at which a calibration ends, ps.
    calibrated: u64,
    /// Local time at which the first conversion began, ps.
    started: Option<u64>,
    /// Conversions whose result has been read, or whose EOC was cleared.
    seen: Cell<u64>,
    strt: bool,
    inputs: [Input; 16],
    /// Below [`VREF`] or above, V.
    reference_offset: f64,
    /// Volts that the internal reference has beyond its typical ones.
    internal_offset: f64,
}

/// Offset of the common register from the first one of all three.
const CCR: u32 = 4;

/// The pin of an external channel (data sheets DS10693 rev 10, table 10, and DS8626 rev 9, table
/// 7).
fn pin_of(converter: usize, channel: u8) -> Option<(Port, u8)> {
    use Port::{A, B, C, F};
    Some(match (converter, channel) {
        (3, 4..=7) => (F, channel + 2),
        (3, 8) => (F, 10),
        (3, 9) => (F, 3),
        (3, 14..=15) => (F, channel - 10),
        (_, 0..=7) => (A, channel),
        (_, 8..=9) => (B, channel - 8),
        (_, 10..=15) => (C, channel - 10),
        _ => return None,
    })
}

impl Adc {
    /// A converter by its number, after reset.
    #[must_use]
    pub fn new(family: Family, number: usize) -> Self {
        Self {
            number,
            family,
            cr1: 0,
            cr2: 0,
            smpr: [0; 2],
            sqr: [0; 3],
            jsqr: 0,
            ccr: 0,
            pclk2: 0,
            calibrated: 0,
            started: None,
            seen: Cell::new(0),
            strt: false,
            inputs: [Input::default(); 16],
            reference_offset: 0.0,
            internal_offset: 0.0,
        }
    }

    /// Resets the registers; what is connected stays.
    pub fn reset(&mut self) {
        *self = Self {
            inputs: self.inputs,
            reference_offset: self.reference_offset,
            internal_offset: self.internal_offset,
            pclk2: self.pclk2,
            ..Self::new(self.family, self.number)
        };
    }

    /// Connects a voltage to a pin.
    pub fn set_pin(&mut self, now_ps: u64, port: Port, pin: u8, volts: f64) {
        let number = self.number;
        let channel = (0..16).find(|channel| pin_of(number, *channel) == Some((port, pin)));
        if let Some(input) = channel.and_then(|at| self.inputs.get_mut(usize::from(at))) {
            *input = Input {
                volts,
                before: input.volts,
                since_ps: now_ps,
            };
        }
    }

    /// Sets the reference, V. It counts for every conversion that is read from now on.
    pub fn set_reference(&mut self, volts: f64) {
        self.reference_offset = volts - VREF;
    }

    /// Makes the internal reference so many times as high as it should be.
    pub fn set_internal_reference(&mut self, times: f64) {
        self.internal_offset = VREFINT * (times - 1.0);
    }

    /// Takes over the clock that it divides.
    pub fn set_clock(&mut self, pclk2: u64) {
        self.pclk2 = pclk2;
    }

    /// What the clock is divided by here; the STM32F1 does that in RCC.
    fn divider(&self) -> u64 {
        match self.family {
            Family::F1 => 1,
            Family::F4 => DIVIDERS[(self.ccr >> 16 & 3) as usize],
        }
    }

    fn clock_ps(&self) -> u64 {
        1_000_000_000_000 * self.divider() / self.pclk2.max(1)
    }

    /// How many injected channels follow the regular one.
    fn injected(&self) -> usize {
        if self.cr1 & cr1::JAUTO == 0 {
            0
        } else {
            (self.jsqr >> 20 & 3) as usize + 1
        }
    }

    /// The channel with this place in a round of conversions: 0 is the regular one.
    fn channel(&self, place: usize) -> usize {
        if place == 0 {
            return (self.sqr[2] & 31) as usize;
        }
        // The sequence ends with JSQ4 (13.13.12).
        let field = 4 - self.injected() + place - 1;
        (self.jsqr >> (5 * field) & 31) as usize
    }

    /// Sampling time and length of a conversion, ps.
    fn times_ps(&self, place: usize) -> (u64, u64) {
        let channel = self.channel(place) as u32;
        let smp = match channel.checked_sub(10) {
            Some(place) => self.smpr[0] >> (3 * place),
            None => self.smpr[1] >> (3 * channel),
        } & 7;
        let (sampling, conversion) = match self.family {
            Family::F1 => (f1::SAMPLING[smp as usize], f1::CONVERSION),
            Family::F4 => (SAMPLING[smp as usize], CONVERSION),
        };
        (
            sampling * self.clock_ps() / 2,
            (sampling + conversion) * self.clock_ps() / 2,
        )
    }

    /// When the last complete conversion at this place began, ps, and how many are complete.
    fn last(&self, now_ps: u64, place: usize) -> Option<(u64, u64)> {
        let length = |places| (0..places).map(|n| self.times_ps(n).1).sum::<u64>();
        let first = self.started? + length(place);
        let since = now_ps.checked_sub(first + self.times_ps(place).1)?;
        let round = length(self.injected() + 1);
        let again = if self.cr2 & cr2::CONT == 0 {
            0
        } else {
            since / round
        };
        Some((first + again * round, again + 1))
    }

    /// Regular conversions that are complete.
    fn complete(&self, now_ps: u64) -> u64 {
        self.last(now_ps, 0).map_or(0, |(_, complete)| complete)
    }

    /// The result of the last conversion at this place.
    fn result(&self, now_ps: u64, place: usize, analog: bool) -> u32 {
        let Some((began, _)) = self.last(now_ps, place) else {
            return 0;
        };
        let sampled = began + self.times_ps(place).0;
        let channel = self.channel(place);
        let input = self.inputs.get(channel);
        let input = input.copied().unwrap_or_default();
        let volts = if channel == VREFINT_CHANNEL && self.number == 1 {
            // Unconnected without TSVREFE.
            f64::from(u8::from(self.internal_is_on())) * (self.internal() + self.internal_offset)
        } else if !analog {
            0.0
        } else if sampled < input.since_ps {
            input.before
        } else {
            input.volts
        };
        let reference = VREF + self.reference_offset;
        (volts / reference * STEPS).clamp(0.0, STEPS - 1.0) as u32
    }

    /// Whether the internal channels are connected, and VREFINT in V.
    fn internal_is_on(&self) -> bool {
        match self.family {
            Family::F1 => self.cr2 & f1::TSVREFE != 0,
            Family::F4 => self.ccr & ccr::TSVREFE != 0,
        }
    }

    fn internal(&self) -> f64 {
        match self.family {
            Family::F1 => f1::VREFINT,
            Family::F4 => VREFINT,
        }
    }

    /// The place whose result this register holds.
    fn place(&self, offset: u32) -> Option<usize> {
        let place = match offset {
            0x3C..0x4C => (offset - 0x3C) as usize / 4 + 1,
            _ => 0,
        };
        (place <= self.injected()).then_some(place)
    }

    /// The pin whose voltage the register at `offset` shows.
    #[must_use]
    pub fn pin(&self, offset: u32) -> Option<(Port, u8)> {
        pin_of(self.number, self.channel(self.place(offset)?) as u8)
    }

    /// Reads a register that the converters share; `None` for what is not modelled.
    #[must_use]
    pub fn read_common(&self, offset: u32) -> Option<u32> {
        (offset == CCR).then_some(self.ccr)
    }

    /// Tells the converter what is written to a register that they share.
    ///
    /// # Errors
    /// In words.
    pub fn write_common(&mut self, offset: u32, value: u32) -> Result<(), &'static str> {
        match offset {
            CCR if value & !(ccr::ADCPRE | ccr::TSVREFE) != 0 => Err("multi mode, battery channel"),
            CCR => {
                self.ccr = value;
                Ok(())
            }
            _ => Err(""),
        }
    }

    /// Reads a register; `analog` states whether the channel's pin is in analog mode. `None` for
    /// what is not modelled.
    #[must_use]
    pub fn read(&self, now_ps: u64, offset: u32, analog: bool) -> Option<u32> {
        Some(match offset {
            0x00 => {
                let done = self.complete(now_ps) > self.seen.get();
                (u32::from(done) * sr::EOC) | (u32::from(self.strt) * sr::STRT)
            }
            0x04 => self.cr1,
            0x08 if self.family == Family::F1 => self.read_cr2_f1(now_ps),
            0x08 => self.cr2,
            0x0C => self.smpr[0],
            0x10 => self.smpr[1],
            0x2C => self.sqr[0],
            0x30 => self.sqr[1],
            0x34 => self.sqr[2],
            0x38 => self.jsqr,
            0x3C..0x4C if offset.is_multiple_of(4) => {
                let place = self.place(offset);
                place.map_or(0, |place| self.result(now_ps, place, analog))
            }
            0x4C => {
                self.seen.set(self.complete(now_ps));
                self.result(now_ps, 0, analog)
            }
            _ => return None,
        })
    }

    fn start(&mut self, now_ps: u64) {
        self.started = Some(now_ps);
        self.seen.set(0);
        self.strt = true;
    }

    /// Writes a register; an error says what is not modelled.
    ///
    /// # Errors
    /// In words.
    pub fn write(&mut self, now_ps: u64, offset: u32, value: u32) -> Result<(), &'static str> {
        match offset {
            // Flags are cleared by writing 0.
            0x00 => {
                if value & sr::EOC == 0 {
                    self.seen.set(self.complete(now_ps));
                }
                self.strt &= value & sr::STRT != 0;
            }
            0x04 if value != 0 && value != cr1::SCAN | cr1::JAUTO => {
                return Err("anything but 12 bits without interrupts");
            }
            0x04 => self.cr1 = value,
            0x08 if self.family == Family::F1 => self.write_cr2_f1(now_ps, value)?,
            0x08 => {
                if value & !(cr2::ADON | cr2::CONT | cr2::SWSTART) != 0 {
                    return Err("triggers, DMA, alignment to the left");
                }
                self.cr2 = value & !cr2::SWSTART;
                if value & cr2::ADON == 0 {
                    self.started = None;
                } else if value & cr2::SWSTART != 0 {
                    if self.pclk2 / self.divider() > MAX_HZ {
                        return Err("a clock above 36 MHz (DS10693)");
                    }
                    self.start(now_ps);
                }
            }
            0x0C => self.smpr[0] = value,
            0x10 => self.smpr[1] = value,
            0x2C if value >> 20 & 15 != 0 => return Err("a sequence of more than one"),
            0x2C => self.sqr[0] = value,
            0x30 => self.sqr[1] = value,
            0x34 => self.sqr[2] = value,
            0x38 => self.jsqr = value,
            _ => return Err(""),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 22.5 MHz: 90 MHz by 4. 480 + 12 clocks are 21.87 us.
    fn running() -> Adc {
        let mut adc = Adc::new(Family::F4, 1);
        adc.set_clock(90_000_000);
        adc.set_pin(0, Port::A, 4, 1.65);
        adc.write_common(CCR, 1 << 16).unwrap();
        for (offset, value) in [(0x10, 7 << 12), (0x34, 4)] {
            adc.write(0, offset, value).unwrap();
        }
        let on = cr2::ADON | cr2::CONT;
        adc.write(0, 0x08, on).unwrap();
        adc.write(0, 0x08, on | cr2::SWSTART).unwrap();
        adc
    }

    #[test]
    fn half_of_the_reference_is_half_of_the_scale_after_492_clocks() {
        let adc = running();
        assert_eq!(adc.read(21_800_000, 0x4C, true), Some(0));
        assert_eq!(adc.read(21_900_000, 0x4C, true), Some(2048));
        assert_eq!(adc.read(21_900_000, 0x4C, false), Some(0), "a digital pin");
    }

    #[test]
    fn end_of_conversion_is_cleared_by_reading() {
        let adc = running();
        assert_eq!(adc.read(21_900_000, 0x00, true), Some(sr::EOC | sr::STRT));
        assert_eq!(adc.read(21_900_000, 0x4C, true), Some(2048));
        assert_eq!(adc.read(21_900_000, 0x00, true), Some(sr::STRT));
        assert_eq!(adc.read(43_800_000, 0x00, true), Some(sr::EOC | sr::STRT));
    }

    #[test]
    fn a_change_shows_with_the_next_sampling() {
        let mut adc = running();
        // The first sampling ends after 480 clocks, 21.3 us.
        adc.set_pin(21_500_000, Port::A, 4, 3.3);
        assert_eq!(adc.read(21_900_000, 0x4C, true), Some(2048));
        assert_eq!(adc.read(43_800_000, 0x4C, true), Some(4095));
    }

    /// Channels 7, 14 and 15 after channel 4, 480 clocks each: a round is 87.5 us.
    #[test]
    fn injected_channels_follow_the_regular_one_in_the_order_of_their_sequence() {
        let mut adc = running();
        let jsqr = 2 << 20 | 15 << 15 | 14 << 10 | 7 << 5;
        for (offset, value) in [
            (0x0C, 7 << 12 | 7 << 15),
            (0x10, 7 << 12 | 7 << 21),
            (0x38, jsqr),
            (0x04, cr1::SCAN | cr1::JAUTO),
        ] {
            adc.write(0, offset, value).unwrap();
        }
        for (port, pin, volts) in [(Port::A, 7, 0.825), (Port::C, 4, 2.475), (Port::C, 5, 3.3)] {
            adc.set_pin(0, port, pin, volts);
        }
        let at = |ps, offset| adc.read(ps, offset, true).unwrap();
        assert_eq!([0x3C, 0x40, 0x44].map(|n| at(43_700_000, n)), [0; 3]);
        let last = 87_500_000;
        assert_eq!([0x3C, 0x40, 0x44].map(|n| at(last, n)), [1024, 3072, 4095]);
        assert_eq!((at(last, 0x48), at(last, 0x4C)), (0, 2048));
        let pins = [0x3C, 0x40, 0x44, 0x48, 0x4C].map(|n| adc.pin(n));
        let [a7, c4, c5, a4] = [(Port::A, 7), (Port::C, 4), (Port::C, 5), (Port::A, 4)].map(Some);
        assert_eq!(pins, [a7, c4, c5, None, a4]);
        // Read at 87.5 us, the regular channel has its second result 21.9 us later.
        assert_eq!(at(109_000_000, 0x00), sr::STRT);
        assert_eq!(at(109_500_000, 0x00), sr::EOC | sr::STRT);
    }

    /// VREFINT stays what it is: at a lower reference it is more of it.
    #[test]
    fn the_internal_reference_shows_what_the_reference_is() {
        let mut adc = Adc::new(Family::F4, 1);
        adc.set_clock(90_000_000);
        adc.write_common(CCR, 1 << 16 | ccr::TSVREFE).unwrap();
        for (offset, value) in [
            (0x0C, 7 << 21),
            (0x34, VREFINT_CHANNEL as u32),
            (0x08, cr2::ADON | cr2::CONT),
            (0x08, cr2::ADON | cr2::CONT | cr2::SWSTART),
        ] {
            adc.write(0, offset, value).unwrap();
        }
        let at = |adc: &Adc| adc.read(21_900_000, 0x4C, false).unwrap();
        assert_eq!(at(&adc), u32::from(VREFINT_CALIBRATION));
        adc.set_reference(3.0);
        // 1.21 / 3.0 x 4096.
        assert_eq!(at(&adc), 1652);
        adc.write_common(CCR, 1 << 16).unwrap();
        assert_eq!(at(&adc), 0, "not connected");
    }

    #[test]
    fn what_is_not_modelled_is_refused() {
        let mut adc = running();
        assert!(adc.write(0, 0x2C, 1 << 20).is_err());
        assert!(adc.write(0, 0x08, 1 << 8).is_err());
        assert!(adc.write(0, 0x04, 1 << 10).is_err(), "JAUTO without SCAN");
        assert!(adc.write_common(CCR, 1 << 22).is_err(), "battery channel");
        assert_eq!(adc.read(0, 0x14, true), None);
    }

    /// DS8626 table 7: ADC3 has pins of port F, and no channel 17 (RM0090 13.10).
    #[test]
    fn adc3_has_pins_of_port_f_and_no_internal_reference() {
        let mut adc = Adc::new(Family::F4, 3);
        adc.set_clock(84_000_000);
        adc.set_pin(0, Port::F, 10, 1.65);
        adc.write_common(CCR, 1 << 16 | ccr::TSVREFE).unwrap();
        for (channel, pin, result) in [(8, Some((Port::F, 10)), 2048), (17, None, 0)] {
            adc.write(0, 0x34, channel).unwrap();
            for start in [0, cr2::SWSTART] {
                adc.write(0, 0x08, cr2::ADON | cr2::CONT | start).unwrap();
            }
            assert_eq!(adc.pin(0x4C), pin);
            assert_eq!(adc.read(25_000_000, 0x4C, true), Some(result));
        }
    }
}
