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

/// Yaw rate of one member's gyro (its TPDO5); of robots with a gyro only.
#[must_use]
pub const fn yaw_rate(node: u8) -> u16 {
    0x500 + node as u16
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

/// What only a robot sends, each kind with a function code of its own.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Sent {
    /// Emergency message.
    Emergency,
    /// Status.
    Status,
    /// Measured twist.
    Measured,
    /// Pose.
    Pose,
    /// Wheel rates.
    WheelRates,
    /// Yaw rate.
    YawRate,
    /// Answer to an SDO request.
    SdoResponse,
    /// Heartbeat or boot-up message.
    Heartbeat,
}

/// What a frame with this identifier is, and which robot it comes from; `None` if robots only
/// receive it.
#[must_use]
pub const fn sent(cob_id: u16) -> Option<(Sent, u8)> {
    const EMERGENCY: u16 = emergency(0);
    const STATUS: u16 = member_status(0);
    const MEASURED: u16 = measured_twist(0);
    const POSE: u16 = pose(0);
    const WHEEL_RATES: u16 = wheel_rates(0);
    const YAW_RATE: u16 = yaw_rate(0);
    const SDO_RESPONSE: u16 = sdo_response(0);
    const HEARTBEAT: u16 = heartbeat(0);
    let [low, _] = cob_id.to_le_bytes();
    let node = low & 0x7F;
    if !crate::is_robot(node) {
        return None;
    }
    let sent = match cob_id - node as u16 {
        EMERGENCY => Sent::Emergency,
        STATUS => Sent::Status,
        MEASURED => Sent::Measured,
        POSE => Sent::Pose,
        WHEEL_RATES => Sent::WheelRates,
        YAW_RATE => Sent::YawRate,
        SDO_RESPONSE => Sent::SdoResponse,
        HEARTBEAT => Sent::Heartbeat,
        _ => return None,
    };
    Some((sent, node))
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
        assert_eq!(yaw_rate(3), 0x503);
        assert_eq!(MASTER_HEARTBEAT, 0x701);
    }

    #[test]
    fn a_robot_has_eight_identifiers_of_its_own() {
        let own = (0..0x800).filter(|id| matches!(sent(*id), Some((_, 3))));
        let eight = [0x083, 0x183, 0x283, 0x383, 0x483, 0x503, 0x583, 0x703];
        assert!(own.eq(eight));
    }

    #[test]
    fn what_is_sent_names_robots_only() {
        assert_eq!(sent(0x181), None, "the master's own frame");
        assert_eq!(sent(0x182), Some((Sent::Status, 2)));
        assert_eq!(sent(0x191), Some((Sent::Status, 17)));
        assert_eq!(sent(0x192), None);
        assert_eq!(sent(0x282), Some((Sent::Measured, 2)));
        assert_eq!(sent(0x082), Some((Sent::Emergency, 2)));
        assert_eq!(sent(0x091), Some((Sent::Emergency, 17)));
        assert_eq!(sent(0x080), None);
        assert_eq!(sent(0x081), None, "the master's own");
        assert_eq!(sent(0x092), None);
        assert_eq!(sent(0x202), None, "sent to a robot");
        assert_eq!(sent(0xFFFF), None);
    }
}
