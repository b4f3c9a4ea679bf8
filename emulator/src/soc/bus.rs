//! The level at the input of CAN1 while a frame is on its bus, for a program that looks at the pin.
//!
//! The caller, which is the bus, says when a frame begins
//! ([`CanPort::begin`](crate::CanPort::begin) of the board's own,
//! [`CanPort::arrives`](crate::CanPort::arrives) of another node's). The bits with their stuff bits
//! and checksum are worked out only when the pin is read. The acknowledge slot is dominant, as with
//! another node on the bus. A repeated frame looks as the first one did; error frames are not
//! shown.

use super::Soc;
use crate::can::CanFrame;
use crate::system::gpio::Port;

/// Equal bits in a row after which a stuff bit follows.
const STUFF_AFTER: u32 = 5;
/// The polynomial of the checksum (Bosch CAN 2.0, 3.1.1).
const CRC: u16 = 0x4599;
/// A bit of a node that keeps 1 Mbit/s, s.
const BIT_S: f64 = 1e-6;

/// A frame on the bus.
#[derive(Debug, Clone)]
pub(super) struct OnTheBus {
    frame: CanFrame,
    /// Cycle of its first bit, and cycles in a bit.
    began: u64,
    bit: f64,
    /// Its levels, once the pin was read.
    levels: Option<Vec<bool>>,
}

impl Soc {
    /// CAN1 begins to send a frame.
    pub(crate) fn sends(&mut self, frame: CanFrame) {
        let bit = self.can.cycles_per_bit() as f64 * self.defects.bit_time();
        self.begins(frame, bit);
    }

    /// Another node begins to send a frame; its bits are this times as long as they should be.
    pub(crate) fn arrives(&mut self, frame: CanFrame, bit_time: f64) {
        let hz = self.clock.hz() as f64 * self.clock.rate();
        self.begins(frame, BIT_S * hz * bit_time);
    }

    fn begins(&mut self, frame: CanFrame, bit: f64) {
        self.on_the_bus = Some(OnTheBus {
            frame,
            began: self.now,
            bit,
            levels: None,
        });
    }

    /// The levels of a port with that of the bus at the input of CAN1; recessive is high.
    pub(super) fn with_the_bus(&mut self, port: Port, levels: u32) -> u32 {
        let pins = self.chip.pins.can1_receive.iter();
        let here = pins
            .filter(|route| route.port == port && self.receives(route))
            .fold(0, |mask, route| mask | 1 << route.pin);
        if here == 0 {
            return levels;
        }
        let now = self.now;
        let dominant = self.on_the_bus.as_mut().is_some_and(|on| {
            let bits = on.levels.get_or_insert_with(|| bits(&on.frame));
            let at = (now.saturating_sub(on.began) as f64 / on.bit) as usize;
            bits.get(at) == Some(&false)
        });
        if dominant {
            levels & !here
        } else {
            levels | here
        }
    }
}

/// The bits of a frame with an 11-bit identifier from its start to its acknowledge slot, as levels;
/// none for other frames.
fn bits(frame: &CanFrame) -> Vec<bool> {
    let Some(id) = frame.standard_id() else {
        return Vec::new();
    };
    let mut plain = vec![false];
    let mut push = |value: u32, count: u32| {
        plain.extend((0..count).rev().map(|bit| value >> bit & 1 != 0));
    };
    push(id.into(), 11);
    // RTR, IDE and the reserved bit.
    push(u32::from(frame.is_remote()) << 2, 3);
    push(frame.dlc().into(), 4);
    for byte in frame.data() {
        push((*byte).into(), 8);
    }
    let crc = checksum(&plain);
    plain.extend((0..15).rev().map(|bit| crc >> bit & 1 != 0));
    let mut stuffed = Vec::new();
    let mut equal = 0;
    for bit in plain {
        equal = if stuffed.last() == Some(&bit) {
            equal + 1
        } else {
            1
        };
        stuffed.push(bit);
        if equal == STUFF_AFTER {
            stuffed.push(!bit);
            equal = 1;
        }
    }
    // Delimiter, acknowledge, and recessive from there on.
    stuffed.extend([true, false]);
    stuffed
}

/// The checksum of bits.
fn checksum(bits: &[bool]) -> u16 {
    bits.iter().fold(0, |crc: u16, bit| {
        let next = *bit != (crc >> 14 & 1 != 0);
        (crc << 1 & 0x7FFF) ^ if next { CRC } else { 0 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// CRC-15/CAN of the digits 1 to 9, the customary check of a checksum.
    #[test]
    fn the_checksum_is_that_of_can() {
        let bit = |byte: u8| (0..8).rev().map(move |bit| byte >> bit & 1 != 0);
        let bits: Vec<bool> = b"123456789".iter().copied().flat_map(bit).collect();
        assert_eq!(checksum(&bits), 0x059E);
    }

    #[test]
    fn after_five_equal_bits_comes_another() {
        // Start, eleven bits of identifier, three of control, length: eighteen zeros but for one.
        let frame = CanFrame::new(0, &[]).unwrap();
        let text: String = bits(&frame)
            .iter()
            .map(|bit| if *bit { '1' } else { '0' })
            .collect();
        // The checksum of zeros is zero: 34 of them, with six stuff bits, delimiter, acknowledge.
        assert_eq!(text, format!("{}000010", "000001".repeat(6)));
    }
}
