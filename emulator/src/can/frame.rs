//! A CAN 2.0 frame and its order on the bus.

/// Identifier.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum CanId {
    /// 11 bits.
    Standard(u16),
    /// 29 bits.
    Extended(u32),
}

/// A data or remote frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct CanFrame {
    id: CanId,
    remote: bool,
    dlc: u8,
    data: [u8; 8],
}

impl CanFrame {
    /// A data frame with an 11-bit identifier; `None` when the identifier or the length is out of
    /// range.
    #[must_use]
    pub fn new(id: u16, data: &[u8]) -> Option<Self> {
        Self::with_id(CanId::Standard(id), data)
    }

    /// A data frame; `None` when the identifier or the length is out of range.
    #[must_use]
    pub fn with_id(id: CanId, data: &[u8]) -> Option<Self> {
        let valid = match id {
            CanId::Standard(id) => id < 1 << 11,
            CanId::Extended(id) => id < 1 << 29,
        };
        if !valid || data.len() > 8 {
            return None;
        }
        let mut bytes = [0; 8];
        bytes[..data.len()].copy_from_slice(data);
        Some(Self {
            id,
            remote: false,
            dlc: data.len() as u8,
            data: bytes,
        })
    }

    /// A remote frame asking for `dlc` bytes; `None` when the identifier or the length is out of
    /// range.
    #[must_use]
    pub fn remote(id: CanId, dlc: u8) -> Option<Self> {
        let frame = Self::with_id(id, &[])?;
        (dlc <= 8).then_some(Self {
            remote: true,
            dlc,
            ..frame
        })
    }

    /// Identifier.
    #[must_use]
    pub fn id(&self) -> CanId {
        self.id
    }

    /// The 11-bit identifier, if it is one.
    #[must_use]
    pub fn standard_id(&self) -> Option<u16> {
        match self.id {
            CanId::Standard(id) => Some(id),
            CanId::Extended(_) => None,
        }
    }

    /// Whether it is a remote frame.
    #[must_use]
    pub fn is_remote(&self) -> bool {
        self.remote
    }

    /// Data length code, 0..=8.
    #[must_use]
    pub fn dlc(&self) -> u8 {
        self.dlc
    }

    /// Payload; empty for a remote frame.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        if self.remote {
            &[]
        } else {
            &self.data[..usize::from(self.dlc)]
        }
    }

    /// Bits from its start to the end of its last field, stuff bits left out.
    #[must_use]
    pub fn bits(&self) -> u32 {
        let without_data = match self.id {
            CanId::Standard(_) => 44,
            CanId::Extended(_) => 64,
        };
        without_data + 8 * self.data().len() as u32
    }

    /// The arbitration field as it goes over the wire, first bit highest: the smaller number wins
    /// the bus.
    #[must_use]
    pub fn arbitration(&self) -> u32 {
        match self.id {
            // Identifier, RTR, IDE dominant.
            CanId::Standard(id) => u32::from(id) << 21 | u32::from(self.remote) << 20,
            // Base identifier, SRR and IDE recessive, extension, RTR.
            CanId::Extended(id) => {
                (id >> 18) << 21 | 3 << 19 | (id & 0x3_FFFF) << 1 | u32::from(self.remote)
            }
        }
    }

    /// From the identifier and length words of a mailbox (30.9.3).
    pub(super) fn from_mailbox(ir: u32, dtr: u32, low: u32, high: u32) -> Self {
        let id = if ir & 4 != 0 {
            CanId::Extended(ir >> 3)
        } else {
            CanId::Standard((ir >> 21) as u16)
        };
        let mut data = [0; 8];
        data[..4].copy_from_slice(&low.to_le_bytes());
        data[4..].copy_from_slice(&high.to_le_bytes());
        let dlc = (dtr & 0xF).min(8) as u8;
        data[usize::from(dlc)..].fill(0);
        Self {
            id,
            remote: ir & 2 != 0,
            dlc,
            data,
        }
    }

    /// The identifier word of a mailbox, without TXRQ.
    pub(super) fn mailbox_ir(&self) -> u32 {
        let id = match self.id {
            CanId::Standard(id) => u32::from(id) << 21,
            CanId::Extended(id) => id << 3 | 4,
        };
        id | u32::from(self.remote) << 1
    }

    /// The two data words of a mailbox.
    pub(super) fn mailbox_data(&self) -> [u32; 2] {
        let [a, b, c, d, e, f, g, h] = self.data;
        [
            u32::from_le_bytes([a, b, c, d]),
            u32::from_le_bytes([e, f, g, h]),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arbitration_order() {
        let standard = CanFrame::new(0x123, &[]).unwrap();
        let remote = CanFrame::remote(CanId::Standard(0x123), 0).unwrap();
        let extended = CanFrame::with_id(CanId::Extended(0x123 << 18), &[]).unwrap();
        let higher = CanFrame::new(0x122, &[]).unwrap();
        assert!(higher.arbitration() < standard.arbitration());
        assert!(
            standard.arbitration() < remote.arbitration(),
            "data before remote"
        );
        assert!(
            remote.arbitration() < extended.arbitration(),
            "standard before extended"
        );
    }

    #[test]
    fn limits() {
        assert!(CanFrame::new(0x800, &[]).is_none());
        assert!(CanFrame::new(0, &[0; 9]).is_none());
        assert!(CanFrame::with_id(CanId::Extended(1 << 29), &[]).is_none());
    }
}
