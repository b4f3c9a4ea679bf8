//! The emergency message: an error in eight bytes.

use crate::{Frame, NodeId};

/// The pre-defined identifier less the node-ID.
pub(crate) const EMERGENCY: u16 = 0x080;

/// What kind of error it is: the bits of the error register, object 0x1001.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum ErrorClass {
    /// Any error; this bit is set together with each of the others.
    Generic = 1 << 0,
    /// Current.
    Current = 1 << 1,
    /// Voltage.
    Voltage = 1 << 2,
    /// Temperature.
    Temperature = 1 << 3,
    /// Communication.
    Communication = 1 << 4,
    /// As the device profile defines.
    Profile = 1 << 5,
    /// As the manufacturer defines.
    Manufacturer = 1 << 7,
}

/// The content of an emergency message (CiA 301, 7.2.7).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Emergency {
    /// The error code; 0 when an error has gone.
    pub code: u16,
    /// The error register, object 0x1001, at that time.
    pub register: u8,
    /// Up to the manufacturer. When an error has gone, this crate puts its code and the first
    /// byte that came with it here.
    pub info: [u8; 5],
}

impl Emergency {
    /// CAN overrun: frames could not be sent.
    pub const CAN_OVERRUN: u16 = 0x8110;
    /// The CAN controller is error passive.
    pub const CAN_PASSIVE: u16 = 0x8120;
    /// A heartbeat did not come in time.
    pub const HEARTBEAT_LOST: u16 = 0x8130;
    /// Recovered from bus-off.
    pub const BUS_OFF_RECOVERED: u16 = 0x8140;
    /// A PDO was not processed because it was too short.
    pub const PDO_LENGTH: u16 = 0x8210;
    /// A SYNC had not the length that object 0x1019 implies.
    pub const SYNC_LENGTH: u16 = 0x8240;
    /// An RPDO did not come in time.
    pub const RPDO_TIMEOUT: u16 = 0x8250;
    /// SYNC did not come in time.
    pub const SYNC_LOST: u16 = 0x8700;

    /// The eight bytes on the wire.
    #[must_use]
    pub const fn encode(&self) -> [u8; 8] {
        let [low, high] = self.code.to_le_bytes();
        let [a, b, c, d, e] = self.info;
        [low, high, self.register, a, b, c, d, e]
    }

    /// Reads an emergency message on its pre-defined identifier; `None` if the frame is not one.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<(NodeId, Self)> {
        let &[low, high, register, a, b, c, d, e] = frame.data() else {
            return None;
        };
        let node = match frame.id() & 0x780 {
            EMERGENCY => NodeId::of_cob_id(frame.id())?,
            _ => return None,
        };
        let code = u16::from_le_bytes([low, high]);
        let info = [a, b, c, d, e];
        Some((
            node,
            Self {
                code,
                register,
                info,
            },
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_read_back() {
        let emergency = Emergency {
            code: 0x8130,
            register: 0x11,
            info: [1, 2, 3, 4, 5],
        };
        let frame = Frame::of(0x85, [0x30, 0x81, 0x11, 1, 2, 3, 4, 5]);
        assert_eq!(emergency.encode(), *frame.padded());
        assert_eq!(
            Emergency::parse(&frame),
            Some((NodeId::new(5).unwrap(), emergency))
        );
        assert_eq!(Emergency::parse(&Frame::of(0x80, [0; 8])), None);
        assert_eq!(Emergency::parse(&Frame::of(0x85, [0; 7])), None);
    }
}
