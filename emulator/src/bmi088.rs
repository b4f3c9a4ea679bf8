//! The gyro of a Bosch BMI088 on an SPI (data sheet BST-BMI088-DS001-13, rev 1.3, sections 4.4.1,
//! 5.5 and 6.1): registers, identifier, ranges, soft reset, latched rates, saturation.
//!
//! The world tells it the rate about its z axis ([`Bmi088::set_rate`]) as often as it measures,
//! noise and bias included: the sensor has a thousand samples a second whatever its bandwidth
//! register says. Axes x and y stand still.
//!
//! | not modelled | data sheet |
//! |---|---|
//! | accelerometer: its chip select is ignored | 5.3 |
//! | filter and output rate of GYRO_BANDWIDTH (stored), and with them the delay | 5.5.5 |
//! | FIFO, interrupts, self-test (read as 0, writes are lost) | 5.5.7 to 5.5.17 |
//! | wake-up time after suspend | 5.5.6 |

/// Read: the highest bit of the address byte.
const READ: u8 = 0x80;
/// Registers.
const CHIP_ID: u8 = 0x00;
const RATE_X_LSB: u8 = 0x02;
const RATE_Z_LSB: u8 = 0x06;
const RATE_Z_MSB: u8 = 0x07;
const RANGE: u8 = 0x0F;
const BANDWIDTH: u8 = 0x10;
const LPM1: u8 = 0x11;
const SOFT_RESET: u8 = 0x14;

/// What GYRO_CHIP_ID says (5.5.1).
pub const ID: u8 = 0x0F;
/// A write of this to GYRO_SOFTRESET resets (5.5.8).
const RESET: u8 = 0xB6;
/// After power-on or a soft reset it needs this long, ns (5.5.8).
const START_NS: u64 = 30_000_000;
/// The wire, not driven, with its pull-up.
const OPEN: u8 = 0xFF;

/// Counts in a degree a second in the range of 2000 degrees/s, which is 0 in GYRO_RANGE; each
/// smaller range has twice as many (5.5.4).
const COUNTS_2000: f64 = 16.384;

/// What can be wrong with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GyroDefect {
    /// It is not there, or its wires are broken.
    Absent,
    /// Another chip answers.
    Identifier(u8),
    /// It repeats its last sample.
    Stuck,
    /// A bit of every second sample is wrong.
    Jumps,
}

/// The gyro.
#[derive(Debug, Clone)]
pub struct Bmi088 {
    defect: Option<GyroDefect>,
    /// Degrees a second.
    rate: f64,
    range: u8,
    bandwidth: u8,
    low_power: u8,
    /// When it is ready, ns since power-on.
    ready_ns: u64,
    selected: bool,
    /// Address and direction of the access, once its first byte has come.
    access: Option<(u8, bool)>,
    /// The upper half of a rate whose lower half was read.
    latched: Option<u8>,
    samples: u32,
    /// The last sample, for one that is stuck.
    sample: i16,
}

impl Default for Bmi088 {
    fn default() -> Self {
        Self {
            defect: None,
            rate: 0.0,
            range: 0,
            bandwidth: 0x80,
            low_power: 0,
            ready_ns: START_NS,
            selected: false,
            access: None,
            latched: None,
            samples: 0,
            sample: 0,
        }
    }
}

impl Bmi088 {
    /// It measures this rate about its z axis, rad/s, counter-clockwise positive.
    pub fn set_rate(&mut self, rate: f64) {
        self.rate = rate.to_degrees();
        if self.defect != Some(GyroDefect::Stuck) {
            let counts = self.rate * COUNTS_2000 * f64::from(1_u32 << self.range);
            // 5.5.2: full scale is 32767.
            self.sample = counts.round().clamp(-32_767.0, 32_767.0) as i16;
        }
        self.samples = self.samples.wrapping_add(1);
    }

    /// What is wrong with it.
    #[must_use]
    pub fn defect(&self) -> Option<GyroDefect> {
        self.defect
    }

    /// Something is wrong with it, or no more.
    pub fn set_defect(&mut self, defect: Option<GyroDefect>) {
        self.defect = defect;
    }

    /// The level of its chip select; low selects.
    pub(crate) fn select(&mut self, low: bool) {
        if low && !self.selected {
            self.access = None;
        }
        self.selected = low;
    }

    /// Exchanges the bits of a frame, the highest first, at a time since power-on.
    pub(crate) fn exchange(&mut self, now_ns: u64, word: u16, bits: u32) -> u16 {
        let [high, low] = word.to_be_bytes();
        if bits == 8 {
            return self.byte(now_ns, low).into();
        }
        u16::from_be_bytes([self.byte(now_ns, high), self.byte(now_ns, low)])
    }

    fn byte(&mut self, now_ns: u64, byte: u8) -> u8 {
        if !self.selected || self.defect == Some(GyroDefect::Absent) {
            return OPEN;
        }
        let Some((address, reads)) = self.access else {
            self.access = Some((byte & !READ, byte & READ != 0));
            return OPEN;
        };
        // A burst goes on to the next register.
        self.access = Some(((address + 1) & !READ, reads));
        if now_ns < self.ready_ns {
            return 0;
        }
        if reads {
            return self.read(address);
        }
        self.write(now_ns, address, byte);
        OPEN
    }

    fn read(&mut self, address: u8) -> u8 {
        match address {
            CHIP_ID => match self.defect {
                Some(GyroDefect::Identifier(other)) => other,
                _ => ID,
            },
            RATE_Z_LSB => {
                let [low, high] = self.rate_z().to_le_bytes();
                self.latched = Some(high);
                low
            }
            RATE_Z_MSB => match self.latched.take() {
                Some(high) => high,
                None => self.rate_z().to_le_bytes()[1],
            },
            RATE_X_LSB..RATE_Z_LSB => 0,
            RANGE => self.range,
            BANDWIDTH => self.bandwidth,
            LPM1 => self.low_power,
            _ => 0,
        }
    }

    /// The rate about z as its registers have it, counts.
    #[must_use]
    pub fn rate_z(&self) -> i16 {
        let jumps = self.defect == Some(GyroDefect::Jumps) && self.samples & 2 != 0;
        self.sample ^ if jumps { 1 << 14 } else { 0 }
    }

    fn write(&mut self, now_ns: u64, address: u8, value: u8) {
        match address {
            RANGE if value <= 4 => self.range = value,
            BANDWIDTH => self.bandwidth = value & 0b111 | 0x80,
            LPM1 => self.low_power = value,
            SOFT_RESET if value == RESET => {
                *self = Self {
                    defect: self.defect,
                    selected: self.selected,
                    ready_ns: now_ns + START_NS,
                    ..Self::default()
                };
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const READY: u64 = START_NS;

    fn access(gyro: &mut Bmi088, words: &[u16]) -> Vec<u16> {
        gyro.select(true);
        let words = words.iter().map(|word| gyro.exchange(READY, *word, 16));
        let answers = words.collect();
        gyro.select(false);
        answers
    }

    /// 90 degrees/s are 1474.56 counts of 16.384, and 5898.24 in the range of 500 degrees/s; what
    /// is beyond the range is its end.
    #[test]
    fn rates_are_those_of_the_data_sheet() {
        let mut gyro = Bmi088::default();
        for (range, degrees, counts) in [
            (0, 90.0, 1475_i16),
            (0, -90.0, -1475),
            (2, 90.0, 5898),
            (2, 600.0, 32_767),
            (0, -2500.0, -32_767),
        ] {
            access(&mut gyro, &[u16::from(RANGE) << 8 | range]);
            gyro.set_rate(f64::to_radians(degrees));
            // Y_MSB, then z from its lower half on.
            let answers = access(&mut gyro, &[0x8500, 0]);
            assert_eq!(answers[0], 0xFF00, "the address, and an axis that stands");
            assert_eq!(answers[1].swap_bytes().cast_signed(), counts);
        }
    }

    /// 5.5.2: reading the lower half locks the upper one until it is read.
    #[test]
    fn both_halves_are_of_one_sample() {
        let mut gyro = Bmi088::default();
        gyro.set_rate(f64::to_radians(200.0 / COUNTS_2000));
        gyro.select(true);
        assert_eq!(gyro.exchange(READY, 0x86, 8), 0xFF);
        assert_eq!(gyro.exchange(READY, 0, 8), 200);
        gyro.set_rate(f64::to_radians(300.0 / COUNTS_2000));
        assert_eq!(gyro.exchange(READY, 0, 8), 0);
        gyro.select(false);
        assert_eq!(access(&mut gyro, &[0x8500, 0])[1], 0x2C01);
    }

    #[test]
    fn identifier_registers_and_reset() {
        let mut gyro = Bmi088::default();
        gyro.select(true);
        assert_eq!(gyro.exchange(READY - 1, 0x8000, 16), 0xFF00, "not ready");
        gyro.select(false);
        assert_eq!(access(&mut gyro, &[0x8000]), [0xFF0F]);
        assert_eq!(access(&mut gyro, &[0x9000]), [0xFF80]);
        access(&mut gyro, &[0x1002]);
        assert_eq!(access(&mut gyro, &[0x9000]), [0xFF82]);
        access(&mut gyro, &[0x14B6]);
        assert_eq!(access(&mut gyro, &[0x8000]), [0xFF00], "resetting");
        gyro.select(true);
        assert_eq!(gyro.exchange(2 * READY, 0x9000, 16), 0xFF80);
        // Without chip select nothing drives the wire.
        gyro.select(false);
        assert_eq!(gyro.exchange(2 * READY, 0x8000, 16), 0xFFFF);
        gyro.set_defect(Some(GyroDefect::Absent));
        gyro.select(true);
        assert_eq!(gyro.exchange(2 * READY, 0x8000, 16), 0xFFFF);
    }
}
