//! The signed header of an image file.
//!
//! A file is a header, the image linked for slot A, and the image linked for slot B. What a robot
//! is sent, a *download*, is the same header and the one image that is linked for the slot it does
//! not run from: the header has the hash of either.
//!
//! # Layout
//!
//! All numbers are little-endian.
//!
//! | at | bytes | |
//! |---|---|---|
//! | 0 | 8 | magic |
//! | 8 | 2 | version of this layout |
//! | 10 | 2 | board |
//! | 12 | 2 | hardware revision of the board |
//! | 14 | 2 | version of what is said on the bus |
//! | 16 | 4 | version of the firmware, as object 0x2001:2 has it |
//! | 20 | 4 | security counter |
//! | 24 | 8 | zero |
//! | 32 | 72 | slot A: address (4), length (4), SHA-512 (64) |
//! | 104 | 72 | slot B: the same |
//! | 176 | 16 | zero |
//! | 192 | 64 | Ed25519 signature of the 192 bytes before |

use core::fmt;

use crate::{Crypto, Slot};

/// Bytes of a header with its signature.
pub const LENGTH: usize = HEADER_BYTES as usize;

const HEADER_BYTES: u32 = 256;

/// What the signature is of.
const SIGNED: usize = 192;

/// First bytes of every file. The last one is no text, so that a transfer as text damages it.
pub const MAGIC: [u8; 8] = *b"OMNIBUS\x1A";

/// Version of the layout.
pub const FORMAT: u16 = 1;

const LINKS: usize = 32;
const LINK: usize = 72;
const RESERVED: [core::ops::Range<usize>; 2] = [24..32, 176..SIGNED];

/// A board, as the header has it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Board(pub u16);

impl Board {
    /// NUCLEO-F446RE, the reference board.
    pub const NUCLEO_F446RE: Self = Self(1);
    /// RoboMaster Development Board C.
    pub const ROBOMASTER_C: Self = Self(2);
    /// NUCLEO-F446RE whose wheels are turned by smart drives: its image is another one, and would
    /// move nothing, or the wrong pins, on a robot with bridges.
    pub const NUCLEO_F446RE_C620: Self = Self(3);
    /// NUCLEO-F446RE with two PWMs a wheel, whose encoder and switches are at other pins.
    pub const NUCLEO_F446RE_TWO_PWMS: Self = Self(4);

    /// A kit's controller with an STM32F103RC, which takes no update over the bus.
    pub const KIT_F103RC: Self = Self(5);

    /// The firmware's features that make its image.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::NUCLEO_F446RE => "board-nucleo-f446re",
            Self::ROBOMASTER_C => "board-robomaster-c",
            Self::NUCLEO_F446RE_C620 => "board-nucleo-f446re, drives-c620",
            Self::NUCLEO_F446RE_TWO_PWMS => "board-nucleo-f446re, two-pwms",
            Self::KIT_F103RC => "board-kit-f103rc",
            Self(_) => "an unknown board",
        }
    }
}

/// The image that is linked for one slot.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Link {
    /// Bytes.
    pub length: u32,
    /// SHA-512 of them.
    pub hash: [u8; 64],
}

/// What a header says.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Header {
    /// Board that the images are for.
    pub board: Board,
    /// Revision of its hardware that they are for.
    pub hardware: u16,
    /// Version of what they say on the bus.
    pub wire_version: u16,
    /// Version of the firmware, as object 0x2001:2 has it.
    pub version: u32,
    /// Grows when an older image must not come back; see [`Header::admit`].
    pub security_counter: u32,
    /// The image for slot A.
    pub a: Link,
    /// The image for slot B.
    pub b: Link,
}

/// Bytes that are no header.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum HeaderError {
    /// Fewer bytes than a header has.
    Short,
    /// Other first bytes: not an image file.
    Magic,
    /// A layout that is not known here.
    Format(u16),
    /// Bytes that have to be zero are not.
    Reserved,
    /// The image for this slot is at another address.
    Address(Slot),
    /// The image for this slot has a length that no image has.
    Length(Slot),
}

impl fmt::Display for HeaderError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Short => write!(f, "shorter than the {LENGTH} bytes of a header"),
            Self::Magic => f.write_str("not an image file of Omnibus"),
            Self::Format(found) => {
                write!(
                    f,
                    "image file of layout {found}; this program knows layout {FORMAT}"
                )
            }
            Self::Reserved => f.write_str("reserved bytes of the header are not 0"),
            Self::Address(slot) => write!(f, "the image for slot {slot:?} is at a wrong address"),
            Self::Length(slot) => write!(
                f,
                "the length of the image for slot {slot:?} is not a multiple of 4 from {} to {} \
                 bytes",
                crate::slots::SHORTEST_IMAGE,
                slot.longest_image()
            ),
        }
    }
}

impl core::error::Error for HeaderError {}

/// What a robot is and runs, which an image has to fit.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Device {
    /// Its board.
    pub board: Board,
    /// Revision of its hardware.
    pub hardware: u16,
    /// Security counter of what it runs.
    pub security_counter: u32,
}

/// Why an image is not for a robot.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Refusal {
    /// It is for another board.
    Board(Board),
    /// It is for another revision of the hardware.
    Hardware(u16),
    /// Its security counter is below that of what the robot runs.
    Downgrade(u32),
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Board(board) => write!(f, "image for {} ({})", board.name(), board.0),
            Self::Hardware(revision) => write!(f, "image for hardware revision {revision}"),
            Self::Downgrade(counter) => write!(
                f,
                "security counter {counter} is below that of the running image"
            ),
        }
    }
}

impl core::error::Error for Refusal {}

impl Header {
    /// Reads the first [`LENGTH`] bytes of a file or a download. It does not check the signature,
    /// see [`Header::is_signed`].
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn parse(bytes: &[u8]) -> Result<Self, HeaderError> {
        let bytes = bytes.first_chunk::<LENGTH>().ok_or(HeaderError::Short)?;
        if !bytes.starts_with(&MAGIC) {
            return Err(HeaderError::Magic);
        }
        let format = half(bytes, 8);
        if format != FORMAT {
            return Err(HeaderError::Format(format));
        }
        let mut reserved = RESERVED.into_iter().filter_map(|range| bytes.get(range));
        if reserved.any(|part| part.iter().any(|byte| *byte != 0)) {
            return Err(HeaderError::Reserved);
        }
        Ok(Self {
            board: Board(half(bytes, 10)),
            hardware: half(bytes, 12),
            wire_version: half(bytes, 14),
            version: word(bytes, 16),
            security_counter: word(bytes, 20),
            a: link(bytes, Slot::A)?,
            b: link(bytes, Slot::B)?,
        })
    }

    /// The bytes of a header without its signature, which is of these bytes.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; SIGNED] {
        let mut bytes = [0; SIGNED];
        put(&mut bytes, 0, &MAGIC);
        put(&mut bytes, 8, &FORMAT.to_le_bytes());
        put(&mut bytes, 10, &self.board.0.to_le_bytes());
        put(&mut bytes, 12, &self.hardware.to_le_bytes());
        put(&mut bytes, 14, &self.wire_version.to_le_bytes());
        put(&mut bytes, 16, &self.version.to_le_bytes());
        put(&mut bytes, 20, &self.security_counter.to_le_bytes());
        for slot in Slot::ALL {
            let (at, link) = (link_at(slot), self.link(slot));
            put(&mut bytes, at, &slot.address().to_le_bytes());
            put(&mut bytes, at + 4, &link.length.to_le_bytes());
            put(&mut bytes, at + 8, &link.hash);
        }
        bytes
    }

    /// Whether the signature at the end of the first [`LENGTH`] bytes is right. At 180 MHz this
    /// takes some 40 ms.
    #[must_use]
    pub fn is_signed(bytes: &[u8], crypto: &impl Crypto) -> bool {
        let parts = bytes.split_first_chunk::<SIGNED>();
        parts.is_some_and(|(message, rest)| {
            let signature = rest.first_chunk::<{ LENGTH - SIGNED }>();
            signature.is_some_and(|signature| crypto.is_signed(message, signature))
        })
    }

    /// The image for a slot.
    #[must_use]
    pub const fn link(&self, slot: Slot) -> &Link {
        match slot {
            Slot::A => &self.a,
            Slot::B => &self.b,
        }
    }

    /// Bytes of a download for a slot, the header included.
    #[must_use]
    pub const fn download_length(&self, slot: Slot) -> u32 {
        HEADER_BYTES + self.link(slot).length
    }

    /// Where in a file the image for a slot is.
    #[must_use]
    pub const fn offset(&self, slot: Slot) -> usize {
        match slot {
            Slot::A => LENGTH,
            Slot::B => LENGTH + self.a.length as usize,
        }
    }

    /// Whether a robot may take one of the images. An equal or lower version may be taken as long
    /// as its security counter is not below that of what runs.
    ///
    /// # Errors
    /// Why not.
    pub fn admit(&self, device: &Device) -> Result<(), Refusal> {
        if self.board != device.board {
            return Err(Refusal::Board(self.board));
        }
        if self.hardware != device.hardware {
            return Err(Refusal::Hardware(self.hardware));
        }
        if self.security_counter < device.security_counter {
            return Err(Refusal::Downgrade(self.security_counter));
        }
        Ok(())
    }
}

const fn link_at(slot: Slot) -> usize {
    match slot {
        Slot::A => LINKS,
        Slot::B => LINKS + LINK,
    }
}

fn link(bytes: &[u8; LENGTH], slot: Slot) -> Result<Link, HeaderError> {
    let at = link_at(slot);
    if word(bytes, at) != slot.address() {
        return Err(HeaderError::Address(slot));
    }
    let length = word(bytes, at + 4);
    if !slot.holds(length) {
        return Err(HeaderError::Length(slot));
    }
    let hash = array(bytes, at + 8);
    Ok(Link { length, hash })
}

/// Bytes from an offset on, which is a constant within the header.
fn array<const N: usize>(bytes: &[u8; LENGTH], at: usize) -> [u8; N] {
    let part = bytes.get(at..).and_then(|rest| rest.first_chunk());
    part.copied().unwrap_or([0; N])
}

fn half(bytes: &[u8; LENGTH], at: usize) -> u16 {
    u16::from_le_bytes(array(bytes, at))
}

fn word(bytes: &[u8; LENGTH], at: usize) -> u32 {
    u32::from_le_bytes(array(bytes, at))
}

fn put(bytes: &mut [u8; SIGNED], at: usize, part: &[u8]) {
    let place = bytes.iter_mut().skip(at);
    place.zip(part).for_each(|(to, from)| *to = *from);
}
