//! The SPI protocol of the gyro in a Bosch BMI088, word by word (data sheet BST-BMI088-DS001-13,
//! sections 5.5 and 6.1).
//!
//! # Theory of operation
//!
//! A transfer is one word of 16 bits, and a control tick starts at most one, so no tick waits for
//! the SPI: a word sent at the end of a tick has its answer at the beginning of the next. One word
//! writes or reads a register (address, then value). The rate about z takes two words, which begin
//! with the upper half of y, so that both halves of z come in the second word and belong to one
//! sample. This reads 500 of the sensor's 1000 samples a second, which it filters to 116 Hz.
//!
//! # Interface
//!
//! The driver passes the answer to the last word to [`Reader::receive`], which returns a sample if
//! there is one, and then sends the word that [`Reader::next`] returns. Chip select is low from the
//! first word of an access until the answer to its last has come ([`Reader::goes_on`], before the
//! answer).
//!
//! # Limits
//!
//! The registers are not read again once samples come; [`super::Gyro`] judges whether the samples
//! are plausible.

use super::Reading;

/// Read: the highest bit of the address.
const READ: u16 = 0x8000;
/// GYRO_CHIP_ID (5.5.1), and what it says.
const CHIP_ID: u16 = 0x00;
const ID: u8 = 0x0F;
/// GYRO_RANGE (5.5.4): 2000 degrees/s.
const RANGE: u16 = 0x0F;
const RANGE_2000: u8 = 0x00;
/// GYRO_BANDWIDTH (5.5.5): 1000 samples a second, 116 Hz; its highest bit reads as 1.
const BANDWIDTH: u16 = 0x10;
const BANDWIDTH_116: u8 = 0x02;
/// RATE_Y_MSB, and behind it RATE_Z_LSB and RATE_Z_MSB (5.5.2).
const RATE: u16 = 0x05;

/// Ticks before the first word: the sensor starts within 30 ms (table 4).
const START: u8 = 40;
/// How often it is spoken to before it counts as missing.
const TRIES: u8 = 3;

/// What comes next.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// So many ticks more.
    Wait(u8),
    Identify,
    SetRange,
    SetBandwidth,
    CheckRange,
    CheckBandwidth,
    /// The first and the second word of a rate.
    Ask,
    Answer,
    Missing,
}

/// The conversation.
#[derive(Clone, Copy)]
pub struct Reader {
    phase: Phase,
    tries: u8,
}

impl Default for Reader {
    fn default() -> Self {
        Self::new()
    }
}

impl Reader {
    /// A sensor that has just been switched on.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            phase: Phase::Wait(START),
            tries: TRIES,
        }
    }

    /// Takes the answer to the last word; `None` where there is none.
    pub fn receive(&mut self, answer: Option<u16>) -> Reading {
        let [_, value] = answer.unwrap_or(!0).to_be_bytes();
        let (expected, next) = match self.phase {
            Phase::Wait(0) => (value, Phase::Identify),
            Phase::Wait(ticks) => (value, Phase::Wait(ticks - 1)),
            Phase::Identify => (ID, Phase::SetRange),
            Phase::SetRange => (value, Phase::SetBandwidth),
            Phase::SetBandwidth => (value, Phase::CheckRange),
            Phase::CheckRange => (RANGE_2000, Phase::CheckBandwidth),
            Phase::CheckBandwidth => (BANDWIDTH_116 | 0x80, Phase::Ask),
            Phase::Ask => (value, Phase::Answer),
            Phase::Answer => {
                self.phase = Phase::Ask;
                return match answer {
                    Some(word) => Reading::Rate(word.swap_bytes().cast_signed()),
                    None => Reading::Waiting,
                };
            }
            Phase::Missing => return Reading::Missing,
        };
        self.phase = if value == expected {
            next
        } else {
            self.tries -= 1;
            match self.tries {
                0 => Phase::Missing,
                _ => Phase::Wait(START),
            }
        };
        Reading::Waiting
    }

    /// Whether the access goes on behind the last word, so that chip select stays low.
    #[must_use]
    pub const fn goes_on(&self) -> bool {
        matches!(self.phase, Phase::Ask)
    }

    /// The word to send, with chip select low.
    #[must_use]
    pub const fn next(&self) -> Option<u16> {
        Some(match self.phase {
            Phase::Wait(_) | Phase::Missing => return None,
            Phase::Identify => READ | CHIP_ID << 8,
            Phase::SetRange => RANGE << 8 | RANGE_2000 as u16,
            Phase::SetBandwidth => BANDWIDTH << 8 | BANDWIDTH_116 as u16,
            Phase::CheckRange => READ | RANGE << 8,
            Phase::CheckBandwidth => READ | BANDWIDTH << 8,
            Phase::Ask => READ | RATE << 8,
            Phase::Answer => 0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// Ticks with a sensor that gives these answers to words; what was sent and what was read.
    fn talk(ticks: usize, answer: impl Fn(u16) -> u16) -> (Vec<u16>, Vec<Reading>) {
        let mut reader = Reader::new();
        let (mut words, mut readings) = (Vec::new(), Vec::new());
        let mut last = None;
        for _ in 0..ticks {
            readings.push(reader.receive(last));
            let word = reader.next();
            words.extend(word);
            last = word.map(&answer);
        }
        (words, readings)
    }

    /// Identifier, range and bandwidth as the data sheet has them, then a rate of 0x1234 every
    /// second tick.
    #[test]
    fn it_is_asked_who_it_is_set_up_and_read() {
        let (words, readings) = talk(51, |word| match word {
            0x8000 => 0xFF0F,
            0x8F00 => 0xFF00,
            0x9000 => 0xFF82,
            0 => 0x3412,
            _ => 0xFFFF,
        });
        let beginning = [0x8000, 0x0F00, 0x1002, 0x8F00, 0x9000, 0x8500, 0, 0x8500, 0];
        assert_eq!(words[..9], beginning);
        let rates = readings.iter().filter(|r| **r == Reading::Rate(0x1234));
        assert_eq!(rates.count(), 2);
        assert!(!readings.contains(&Reading::Missing));
    }

    /// An open wire, another chip (0x1E is the accelerometer's number), a register that does not
    /// keep what is written, and no answer at all.
    #[test]
    fn a_sensor_that_is_not_there_is_missing_after_three_tries() {
        let other = |word| if word == 0x8000 { 0xFF1E } else { 0xFFFF };
        let forgets = |word| match word {
            0x8000 => 0xFF0F,
            0x9000 => 0xFF80,
            _ => 0,
        };
        for answer in [|_| 0xFFFF, |_| 0, other, forgets] {
            let (_, readings) = talk(200, answer);
            let first = readings.iter().position(|r| *r == Reading::Missing);
            assert!(first.is_some_and(|tick| tick > 120), "{first:?}");
            assert_eq!(readings.last(), Some(&Reading::Missing));
        }
    }
}
