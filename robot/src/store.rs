//! The image of everything that a robot saves: parameters, node-ID, communication objects.
//!
//! # Interface
//!
//! The bus side provides the image when a master asks to save or to restore (objects 0x1010 and
//! 0x1011), and reads one at start. The platform stores it as a whole, and is responsible for where
//! it lies and how it survives a power loss. The platform also owns the memory of the image: a
//! robot that stores nothing needs none, and one that does can build its bus side on a small stack.
//!
//! # Layout
//!
//! | bytes | |
//! |---|---|
//! | 4 | CRC-32 (IEEE 802.3) of all that follows |
//! | 1 | format, 2 |
//! | 2 | length of the application's part |
//! | 1 | node-ID given by LSS; 0 for none, then the switches on the board give it |
//! | | the application's part: index, sub-index and value of every parameter that has been written; of the compensation set its length in one byte and then the set |
//! | | the communication part, as `canopen` wants it |
//!
//! All numbers are little-endian. An image is checked as a whole before any of it takes effect: a
//! wrong CRC, an unknown object, or a value out of its limits refuses all of it, and the robot
//! names the object. Restoring the defaults saves an image without parameters, so both take the
//! same path.
//!
//! # Limits
//!
//! Saving happens only at rest, and a robot that has been asked to save does not start before the
//! save is done, because the processor stops while flash is written or erased.

use canopen::{AbortCode, NodeId};
use protocol::compensation::{CompensationSet, LENGTH_MAX};
use protocol::{Address, ENTRIES, Kind, crc32, entry, is_robot};

use crate::parameters::Parameters;

/// Bytes kept for the communication part; a longer one cannot be saved.
const COMMUNICATION: usize = 192;
pub(crate) const HEADER: usize = 8;
pub(crate) const CRC: usize = 4;
pub(crate) const FORMAT: u8 = 2;

/// Length of the longest image.
pub const IMAGE_MAX: usize = HEADER + parameters_length() + COMMUNICATION;

/// Every persistent parameter with its address.
#[expect(clippy::indexing_slicing, reason = "evaluated by the compiler only")]
const fn parameters_length() -> usize {
    let mut length = 0;
    let mut at = 0;
    while at < ENTRIES.len() {
        if ENTRIES[at].slot().is_some() {
            length += 3 + match ENTRIES[at].kind {
                Kind::Domain => 1 + LENGTH_MAX,
                kind => kind.bytes() as usize,
            };
        }
        at += 1;
    }
    length
}

/// What the platform has stored.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Stored<'a> {
    /// Nothing has ever been stored.
    Nothing,
    /// This image.
    Image(&'a [u8]),
    /// Something that cannot be read.
    Unreadable,
}

/// An image: what the memory holds, or is to hold while `asked` is set.
pub(crate) struct Store {
    bytes: &'static mut [u8],
    length: usize,
    /// A save waits for the platform.
    pub asked: bool,
    /// What is wrong with the image that was loaded: the object, 0 where it is the image itself.
    pub corrupt: Option<Address>,
}

const NO_OBJECT: Address = Address::new(0, 0);

/// A copy has memory of its own, which is never given back, as a robot's never is.
#[cfg(feature = "copies")]
impl Clone for Store {
    fn clone(&self) -> Self {
        let memory: alloc::boxed::Box<[u8]> = (&*self.bytes).into();
        Self {
            bytes: alloc::boxed::Box::leak(memory),
            ..*self
        }
    }
}

impl Store {
    pub const fn new() -> Self {
        Self {
            bytes: &mut [],
            length: 0,
            asked: false,
            corrupt: None,
        }
    }

    /// The image; empty when nothing is stored.
    pub fn image(&self) -> &[u8] {
        self.bytes.get(..self.length).unwrap_or(&[])
    }

    /// Gives it the memory for an image.
    pub fn give(&mut self, memory: &'static mut [u8; IMAGE_MAX]) {
        self.bytes = memory;
    }

    /// Keeps what the platform holds, if it is good.
    pub fn keep(&mut self, stored: Stored<'_>) {
        self.length = 0;
        self.corrupt = match stored {
            Stored::Nothing => None,
            Stored::Unreadable => Some(NO_OBJECT),
            Stored::Image(image) => match (check(image), self.bytes.get_mut(..image.len())) {
                (Ok(_), Some(to)) => {
                    to.copy_from_slice(image);
                    self.length = image.len();
                    None
                }
                (Ok(_), None) => Some(NO_OBJECT),
                (Err(address), _) => Some(address),
            },
        };
    }

    /// Puts an image there that the platform is to store.
    pub fn put(&mut self, image: &[u8]) -> Result<(), AbortCode> {
        let memory = self.bytes.get_mut(..image.len());
        memory.ok_or(AbortCode::CannotStore)?.copy_from_slice(image);
        self.length = image.len();
        self.asked = true;
        Ok(())
    }

    /// The image that waits for the platform.
    #[inline]
    pub fn image_to_store(&self) -> Option<&[u8]> {
        self.asked.then(|| self.image())
    }

    /// The platform has stored it; or it has not, and this is what it has.
    pub fn finish(&mut self, outcome: Result<(), Stored<'_>>) -> Result<(), AbortCode> {
        self.asked = false;
        match outcome {
            Ok(()) => {
                self.corrupt = None;
                Ok(())
            }
            Err(stored) => {
                self.keep(stored);
                Err(AbortCode::Hardware)
            }
        }
    }

    /// The parameters of the image; the defaults when nothing is stored.
    pub fn parameters(&self) -> Parameters {
        check(self.image()).unwrap_or_default()
    }

    /// The node-ID of the image; 0 for none.
    pub fn node(&self) -> u8 {
        self.image().get(HEADER - 1).copied().unwrap_or(0)
    }

    /// The application's and the communication part of the image.
    pub fn parts(&self) -> (&[u8], &[u8]) {
        split(self.image()).unwrap_or((&[], &[]))
    }
}

/// The application's and the communication part of an image.
fn split(image: &[u8]) -> Option<(&[u8], &[u8])> {
    let (&[_, _, _, _, format, low, high, _], rest) = image.split_first_chunk::<HEADER>()?;
    if format != FORMAT {
        return None;
    }
    rest.split_at_checked(usize::from(u16::from_le_bytes([low, high])))
}

/// The parameters of an image, or the object that is wrong with it.
fn check(image: &[u8]) -> Result<Parameters, Address> {
    let (crc, content) = image.split_first_chunk::<CRC>().ok_or(NO_OBJECT)?;
    if u32::from_le_bytes(*crc) != crc32(content.iter().copied()) {
        return Err(NO_OBJECT);
    }
    let (mut rest, _) = split(image).ok_or(NO_OBJECT)?;
    let mut parameters = Parameters::new();
    while let Some((&[low, high, sub], behind)) = rest.split_first_chunk() {
        let address = Address::new(u16::from_le_bytes([low, high]), sub);
        let entry = entry(address).ok_or(address)?;
        let slot = entry.slot().ok_or(address)?;
        let (length, behind) = match entry.kind {
            Kind::Domain => {
                let (length, behind) = behind.split_first().ok_or(address)?;
                (*length, behind)
            }
            kind => (kind.bytes(), behind),
        };
        let (value, behind) = behind
            .split_at_checked(usize::from(length))
            .ok_or(address)?;
        if entry.kind == Kind::Domain {
            CompensationSet::decode(value).map_err(|_| address)?;
            parameters.set_block(slot, value);
        } else {
            parameters.set(slot, entry.accept(value).map_err(|_| address)?);
        }
        rest = behind;
    }
    if rest.is_empty() {
        Ok(parameters)
    } else {
        Err(NO_OBJECT)
    }
}

/// The node-ID that LSS has stored in an image, if the image is whole. It comes before the
/// switches.
#[must_use]
pub fn stored_node(image: &[u8]) -> Option<NodeId> {
    let (crc, content) = image.split_first_chunk::<CRC>()?;
    let is_whole = u32::from_le_bytes(*crc) == crc32(content.iter().copied());
    split(image).filter(|_| is_whole)?;
    let node = image.get(HEADER - 1).copied()?;
    NodeId::new(node).filter(|_| is_robot(node))
}
