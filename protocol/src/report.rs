//! What a robot says by itself, read from its frames.

use crate::{
    MeasuredTwist, MemberStatus, PoseReport, WheelRateReport, YawRateReport, cob, is_robot,
};

/// The content of one frame of a robot: process data or an emergency message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RobotReport {
    /// Its status, TPDO1.
    Status(MemberStatus),
    /// Its measured twist, TPDO2.
    Measured(MeasuredTwist),
    /// Its pose, TPDO3.
    Pose(PoseReport),
    /// Its measured wheel rates, TPDO4.
    WheelRates(WheelRateReport),
    /// The yaw rate of its gyro, TPDO5.
    YawRate(YawRateReport),
    /// The error code of its emergency message.
    Emergency(u16),
}

impl RobotReport {
    /// Reads a frame: who sent it, and what it says. `None` for a frame that is no robot's, and for
    /// one that does not decode.
    #[must_use]
    pub fn decode(cob_id: u16, data: &[u8]) -> Option<(u8, Self)> {
        let node = u8::try_from(cob_id & 0x7F)
            .ok()
            .filter(|node| is_robot(*node))?;
        let report = if cob_id == cob::member_status(node) {
            Self::Status(MemberStatus::try_from(data).ok()?)
        } else if cob_id == cob::measured_twist(node) {
            Self::Measured(MeasuredTwist::try_from(data).ok()?)
        } else if cob_id == cob::pose(node) {
            Self::Pose(PoseReport::try_from(data).ok()?)
        } else if cob_id == cob::wheel_rates(node) {
            Self::WheelRates(WheelRateReport::try_from(data).ok()?)
        } else if cob_id == cob::yaw_rate(node) {
            Self::YawRate(YawRateReport::try_from(data).ok()?)
        } else if let (true, [low, high, ..]) = (cob_id == cob::emergency(node), data) {
            Self::Emergency(u16::from_le_bytes([*low, *high]))
        } else {
            return None;
        };
        Some((node, report))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kinematics::Twist;

    #[test]
    fn a_report_is_of_the_robot_whose_identifier_it_has() {
        let measured = MeasuredTwist {
            twist: Twist::new(0.5, 0.0, 0.0),
            sequence: 7,
            group: 1,
        };
        let bytes = measured.encode();
        let decoded = RobotReport::decode(0x283, &bytes);
        assert_eq!(decoded, Some((3, RobotReport::Measured(measured))));
        // The master's node, a node beyond the last robot, another service, a length too short.
        assert_eq!(RobotReport::decode(0x281, &bytes), None);
        assert_eq!(RobotReport::decode(0x292, &bytes), None);
        assert_eq!(RobotReport::decode(0x603, &bytes), None);
        assert_eq!(RobotReport::decode(0x283, &bytes[..7]), None);
    }

    #[test]
    fn an_emergency_message_is_its_code() {
        let frame = [0x0B, 0xFF, 0x81, 0, 0, 0, 0, 0];
        let decoded = RobotReport::decode(0x091, &frame);
        assert_eq!(decoded, Some((17, RobotReport::Emergency(0xFF0B))));
        // SYNC has the same function code.
        assert_eq!(RobotReport::decode(0x080, &[1]), None);
    }
}
