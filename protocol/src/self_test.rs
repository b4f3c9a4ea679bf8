//! The objects of the self-test image: pins, measurements and failures of a bare board, for
//! `cargo xtask accept`. They are no objects of a robot; its dictionary and the EDS lack them.
//!
//! # Objects
//!
//! A pin is one byte: the port (0 is A) in the upper half, its number in the lower, see [`pin`].
//! Values are unsigned unless stated otherwise. A measurement runs when its first sub-index is
//! written, and is over when the answer comes.
//!
//! | object | type | | |
//! |---|---|---|---|
//! | [`PIN`]:1 | U16 | wo | makes a pin (lower byte) an input with this pull: 0 none, 1 up, 2 down |
//! | [`PIN`]:2 | U16 | wo | makes a pin (lower byte) an output of this level |
//! | [`LEVELS`]:1 to 4 | U16 | ro | levels of ports A to D |
//! | [`OUTPUTS`]:1 to 4 | I16 | wo | duty of a wheel, a thousandth |
//! | [`OUTPUTS`]:5, :6 | U8 | wo | driver enable, brake release |
//! | [`WAVE`]:1 | U8 | wo | measures the square wave at a pin for up to 3 ms |
//! | [`WAVE`]:2, :3 | U32 | ro | duration of all periods and of their high parts, clocks of the core |
//! | [`WAVE`]:4 | U8 | ro | number of periods; with 0 the pin did not change, and :3 is its level |
//! | [`STOP`]:1 | U8 | wo | raises a pin, watches others for 2 ms, lowers it again |
//! | [`STOP`]:2 to 7 | U8 | wo | the others, [`NO_PIN`] for none |
//! | [`STOP`]:8 to 13 | U32 | ro | when each was low, clocks of the core; [`NEVER`] |
//! | [`ENCODER`]:1 | I16 | wo | makes so many quadrature edges at two pins, negative for backwards |
//! | [`ENCODER`]:2, :3 | U8 | wo | these pins, A and B |
//! | [`ENCODER`]:4 | U8 | wo | time between two edges, us |
//! | [`ENCODER`]:5 | U8 | wo | 1: each edge lies in a pulse at the other pin, as short as can be |
//! | [`ENCODER`]:6 to 9 | U16 | ro | counters of the encoders |
//! | [`METERS`]:1 to 4 | U16 | ro | supply input, current inputs, mV at the pin |
//! | [`CLOCK`]:1 | U32 | ro | time since the start, us |
//! | [`CLOCK`]:2 | U32 | ro | clocks of the core in a second |
//! | [`CLOCK`]:3 | U8 | ro | over-drive: ready 1, switched 2, the voltage's scale reached 4 |
//! | [`CHIP`]:1 | U32 | ro | DBGMCU_IDCODE: the chip's device number, its revision from bit 16 on |
//! | [`FLASH`]:1 | U8 | wo | erases the parameters' two sectors, programs so many words, erases them again |
//! | [`FLASH`]:2, :3 | U32 | ro | the longest erase of a sector, word to program, clocks of the core |
//! | [`FLASH`]:4 | U16 | ro | words that read back wrong, and operations that failed |
//! | [`BITS`]:1 | U8 | wo | looks at the input of CAN: [`OWN`] at the answer to this, [`OTHERS`] at the first frame after it |
//! | [`BITS`]:2, :3 | U32 | ro | clocks of the core from the first edge to the last, largest distance of an edge from a whole number of bits after the first |
//! | [`BITS`]:4, :5 | U8 | ro | bits between first and last edge, number of edges |
//! | [`FAIL`]:1 | U8 | wo | after the answer: [`HALT`], [`PANIC`] or [`RESET`] |
//! | [`FAIL`]:2 | U8 | ro | cause of the last reset, as object 0x2001:3 |

/// Device name of the self-test image, object 0x1008.
pub const NAME: &str = "Omnibus self-test";

/// Role and level of single pins.
pub const PIN: u16 = 0x5E01;
/// Levels of the ports.
pub const LEVELS: u16 = 0x5E02;
/// The outputs of the power stage.
pub const OUTPUTS: u16 = 0x5E03;
/// A square wave at a pin.
pub const WAVE: u16 = 0x5E04;
/// Time from the edge of a pin to the cut of others.
pub const STOP: u16 = 0x5E05;
/// Encoder signals.
pub const ENCODER: u16 = 0x5E06;
/// Inputs of the converter.
pub const METERS: u16 = 0x5E07;
/// Clocks.
pub const CLOCK: u16 = 0x5E08;
/// The chip's device number and revision.
pub const CHIP: u16 = 0x5E0C;
/// Raw times of the flash.
pub const FLASH: u16 = 0x5E0A;
/// Bit times on the bus.
pub const BITS: u16 = 0x5E0B;
/// Failures of the program.
pub const FAIL: u16 = 0x5E09;

/// Over-drive is ready, switched on, and the voltage as it should be.
pub const OVER_DRIVE: u8 = 7;

/// The frame that the board sends.
pub const OWN: u8 = 1;
/// A frame of another node.
pub const OTHERS: u8 = 2;

/// Stops the core with interrupts masked.
pub const HALT: u8 = 1;
/// Panics.
pub const PANIC: u8 = 2;
/// Resets the chip.
pub const RESET: u8 = 3;

/// How many pins [`STOP`] watches.
pub const WATCHED: usize = 6;
/// No pin.
pub const NO_PIN: u8 = 0xFF;
/// Not within the time of a measurement.
pub const NEVER: u32 = u32::MAX;

/// The byte of a pin: `pin(b'B', 12)` is PB12.
#[must_use]
pub const fn pin(port: u8, number: u8) -> u8 {
    port.wrapping_sub(b'A') << 4 | number & 15
}
