//! One classic CAN data frame with an 11-bit identifier.
//!
//! Remote and extended frames are not represented: the caller drops them when it reads the CAN
//! controller. Bytes past the length are kept at zero, so that comparing frames compares their
//! content.

use core::fmt;

/// A CAN data frame: 11-bit identifier and up to eight bytes.
// Aligned to a word, so that a copy is three loads and stores and no call of `memcpy`.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(align(4))]
pub struct Frame {
    id: u16,
    len: u8,
    bytes: [u8; 8],
}

/// The bit of an identifier's function code, its upper four bits: bit n for identifiers from 128 n
/// on.
#[must_use]
pub const fn function_code_bit(id: u16) -> u16 {
    1 << (id >> 7 & 0xF)
}

impl Frame {
    /// The largest identifier, 0x7FF.
    pub const MAX_ID: u16 = 0x7FF;

    /// Makes a frame; `None` if the identifier has more than 11 bits or the data more than eight
    /// bytes.
    ///
    /// ```
    /// # use canopen::Frame;
    /// let frame = Frame::new(0x601, &[0x40, 0x00, 0x10, 0, 0, 0, 0, 0]).ok_or("too long")?;
    /// assert_eq!(format!("{frame:?}"), "601#4000100000000000");
    /// assert_eq!(Frame::new(0x800, &[]), None);
    /// # Ok::<(), &str>(())
    /// ```
    #[must_use]
    pub fn new(id: u16, data: &[u8]) -> Option<Self> {
        if id > Self::MAX_ID {
            return None;
        }
        let mut bytes = [0; 8];
        bytes.get_mut(..data.len())?.copy_from_slice(data);
        let len = u8::try_from(data.len()).ok()?;
        Some(Self { id, len, bytes })
    }

    /// Makes a frame from an array whose length the compiler has checked. The identifier is cut to
    /// 11 bits.
    #[must_use]
    pub fn of<const N: usize>(id: u16, data: [u8; N]) -> Self {
        const { assert!(N <= 8, "a CAN frame carries at most eight bytes") };
        Self::cut(id, &data)
    }

    /// As [`Frame::of`], once for all lengths.
    #[inline(never)]
    fn cut(id: u16, data: &[u8]) -> Self {
        let mut bytes = [0; 8];
        for (to, from) in bytes.iter_mut().zip(data) {
            *to = *from;
        }
        Self {
            id: id & Self::MAX_ID,
            len: u8::try_from(data.len()).unwrap_or(8),
            bytes,
        }
    }

    /// Makes a frame of the first `len` of eight bytes, as a CAN controller has them in its
    /// registers. A length above eight counts as eight, as on the bus; the identifier is cut to 11
    /// bits.
    #[must_use]
    #[inline]
    pub fn prefix(id: u16, bytes: [u8; 8], len: u8) -> Self {
        let len = len.min(8);
        // A shift and no loop: a receive interrupt runs it for every frame.
        let mask = u64::MAX.checked_shr(64 - 8 * u32::from(len)).unwrap_or(0);
        Self {
            id: id & Self::MAX_ID,
            len,
            bytes: (u64::from_le_bytes(bytes) & mask).to_le_bytes(),
        }
    }

    /// The identifier, 0 to 0x7FF.
    #[must_use]
    pub const fn id(&self) -> u16 {
        self.id
    }

    /// The data bytes, zero to eight of them.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or(&[])
    }

    /// All eight bytes; those past [`data`](Self::data) are zero.
    #[must_use]
    pub const fn padded(&self) -> &[u8; 8] {
        &self.bytes
    }

    /// The number of data bytes, 0 to 8.
    #[must_use]
    pub const fn len(&self) -> u8 {
        self.len
    }

    /// Whether the frame carries no data at all.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }
}

/// `181#0011AABB`, as candump writes it.
impl fmt::Debug for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:03X}#", self.id)?;
        for byte in self.data() {
            write!(f, "{byte:02X}")?;
        }
        Ok(())
    }
}

/// As [`fmt::Debug`].
#[cfg(feature = "defmt")]
impl defmt::Format for Frame {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "{=u16:03X}#", self.id);
        for byte in self.data() {
            defmt::write!(f, "{=u8:02X}", *byte);
        }
    }
}

/// Remote frames and frames with 29-bit identifiers cannot be made: `None`.
#[cfg(feature = "embedded-can")]
impl embedded_can::Frame for Frame {
    fn new(id: impl Into<embedded_can::Id>, data: &[u8]) -> Option<Self> {
        match id.into() {
            embedded_can::Id::Standard(id) => Self::new(id.as_raw(), data),
            embedded_can::Id::Extended(_) => None,
        }
    }

    fn new_remote(_: impl Into<embedded_can::Id>, _: usize) -> Option<Self> {
        None
    }

    fn is_extended(&self) -> bool {
        false
    }

    fn is_remote_frame(&self) -> bool {
        false
    }

    fn id(&self) -> embedded_can::Id {
        // The identifier of a frame has 11 bits.
        let id = embedded_can::StandardId::new(self.id).unwrap_or(embedded_can::StandardId::MAX);
        id.into()
    }

    fn dlc(&self) -> usize {
        usize::from(self.len)
    }

    fn data(&self) -> &[u8] {
        self.data()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refuses_what_a_classic_frame_cannot_carry() {
        assert_eq!(Frame::new(0x800, &[]), None);
        assert_eq!(Frame::new(0x181, &[0; 9]), None);
        let frame = Frame::new(0x7FF, &[1, 2, 3]).unwrap();
        assert_eq!((frame.id(), frame.data()), (0x7FF, &[1, 2, 3][..]));
        assert_eq!(frame, Frame::of(0x7FF, [1, 2, 3]));
    }

    #[test]
    fn prefix_clears_what_it_leaves_out() {
        assert_eq!(Frame::prefix(0x181, [9; 8], 2), Frame::of(0x181, [9, 9]));
        assert_eq!(Frame::prefix(0x181, [9; 8], 0), Frame::of(0x181, []));
        for len in [8, 9, 15] {
            assert_eq!(Frame::prefix(0x981, [9; 8], len), Frame::of(0x181, [9; 8]));
        }
    }

    #[test]
    #[cfg(feature = "embedded-can")]
    fn is_a_frame_of_embedded_can() {
        use embedded_can::{ExtendedId, Frame as _, Id, StandardId};
        let id = StandardId::new(0x181).unwrap();
        let frame = <Frame as embedded_can::Frame>::new(id, &[1, 2]).unwrap();
        assert_eq!(frame, Frame::of(0x181, [1, 2]));
        assert_eq!(
            (embedded_can::Frame::id(&frame), frame.dlc()),
            (Id::Standard(id), 2)
        );
        assert_eq!(embedded_can::Frame::data(&frame), [1, 2]);
        let extended = ExtendedId::new(0x181).unwrap();
        assert_eq!(<Frame as embedded_can::Frame>::new(extended, &[]), None);
        assert_eq!(Frame::new_remote(id, 0), None);
    }

    #[test]
    fn prints_like_candump() {
        assert_eq!(
            std::format!("{:?}", Frame::of(0x81, [0x10, 0x82])),
            "081#1082"
        );
    }
}
