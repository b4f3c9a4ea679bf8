//! COB-IDs: which identifier carries what.
//!
//! The predefined connection set of CiA 301 (4.2, table 45 there) is kept, so that a foreign tool
//! recognises every frame. The one thing to know beyond it: the master's first transmit PDO
//! ([`GROUP_TWIST`], 0x181) is the first receive PDO of *every* robot, which makes it a broadcast.

use crate::MASTER;

/// Group twist, from the master to all robots.
pub const GROUP_TWIST: u16 = 0x180 + MASTER as u16;

/// Network management commands.
pub const NMT: u16 = 0x000;

/// SYNC, with a counter.
pub const SYNC: u16 = 0x080;

/// Heartbeat of the master.
pub const MASTER_HEARTBEAT: u16 = heartbeat(MASTER);

/// Emergency message of a node.
#[must_use]
pub const fn emergency(node: u8) -> u16 {
    0x080 + node as u16
}

/// Status of one member (its TPDO1), heard by every other member.
#[must_use]
pub const fn member_status(node: u8) -> u16 {
    0x180 + node as u16
}

/// Twist for one robot alone (its RPDO2), used while commissioning.
#[must_use]
pub const fn commissioning_twist(node: u8) -> u16 {
    0x200 + node as u16
}

/// Measured twist of one member (its TPDO2).
#[must_use]
pub const fn measured_twist(node: u8) -> u16 {
    0x280 + node as u16
}

/// Pose as one member estimates it (its TPDO3).
#[must_use]
pub const fn pose(node: u8) -> u16 {
    0x380 + node as u16
}

/// Measured wheel rates of one member (its TPDO4).
#[must_use]
pub const fn wheel_rates(node: u8) -> u16 {
    0x480 + node as u16
}

/// SDO answers of a node.
#[must_use]
pub const fn sdo_response(node: u8) -> u16 {
    0x580 + node as u16
}

/// SDO requests to a node.
#[must_use]
pub const fn sdo_request(node: u8) -> u16 {
    0x600 + node as u16
}

/// Heartbeat and boot-up of a node.
#[must_use]
pub const fn heartbeat(node: u8) -> u16 {
    0x700 + node as u16
}

/// Whether only the robot `node` sends frames with this identifier.
#[must_use]
pub const fn is_sent_by(cob_id: u16, node: u8) -> bool {
    const FUNCTIONS: u16 = function_bit(emergency(0))
        | function_bit(member_status(0))
        | function_bit(measured_twist(0))
        | function_bit(pose(0))
        | function_bit(wheel_rates(0))
        | function_bit(sdo_response(0))
        | function_bit(heartbeat(0));
    cob_id & 0x7F == node as u16 && FUNCTIONS & function_bit(cob_id) != 0
}

/// The function code of an identifier as one bit of sixteen.
const fn function_bit(cob_id: u16) -> u16 {
    1 << (cob_id >> 7 & 0xF)
}

/// The robot whose emergency message a frame with this identifier carries, if it is one.
#[must_use]
pub const fn emergency_sender(cob_id: u16) -> Option<u8> {
    match cob_id.checked_add(0x100) {
        Some(status) => status_sender(status),
        None => None,
    }
}

/// The robot whose status a frame with this identifier carries, if it is one.
#[must_use]
pub const fn status_sender(cob_id: u16) -> Option<u8> {
    let [high, low] = cob_id.to_be_bytes();
    if high == 0x01 && low >= 0x80 && crate::is_robot(low - 0x80) {
        Some(low - 0x80)
    } else {
        None
    }
}

/// The robot whose measured twist a frame with this identifier carries, if it is one.
#[must_use]
pub const fn measured_sender(cob_id: u16) -> Option<u8> {
    match cob_id.checked_sub(0x100) {
        Some(status) => status_sender(status),
        None => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identifiers_are_those_of_the_design() {
        assert_eq!(GROUP_TWIST, 0x181);
        assert_eq!(member_status(2), 0x182);
        assert_eq!(commissioning_twist(17), 0x211);
        assert_eq!(measured_twist(3), 0x283);
        assert_eq!(pose(3), 0x383);
        assert_eq!(wheel_rates(3), 0x483);
        assert_eq!(MASTER_HEARTBEAT, 0x701);
    }

    #[test]
    fn a_robot_has_seven_identifiers_of_its_own() {
        let own = (0..0x800).filter(|id| is_sent_by(*id, 3));
        let seven = [0x083, 0x183, 0x283, 0x383, 0x483, 0x583, 0x703];
        assert!(own.eq(seven));
    }

    #[test]
    fn status_sender_names_robots_only() {
        assert_eq!(status_sender(0x181), None, "the master's own frame");
        assert_eq!(status_sender(0x182), Some(2));
        assert_eq!(status_sender(0x191), Some(17));
        assert_eq!(status_sender(0x192), None);
        assert_eq!(status_sender(0x282), None);
        assert_eq!(status_sender(0x082), None);
        assert_eq!(measured_sender(0x282), Some(2));
        assert_eq!(measured_sender(0x182), None);
        assert_eq!(measured_sender(0x082), None);
        assert_eq!(emergency_sender(0x082), Some(2));
        assert_eq!(emergency_sender(0x091), Some(17));
        assert_eq!(emergency_sender(0x080), None);
        assert_eq!(emergency_sender(0x081), None, "the master's own");
        assert_eq!(emergency_sender(0x092), None);
        assert_eq!(emergency_sender(0xFFFF), None);
    }
}
