//! Which PDOs a robot has, and which record each of them carries: every object of it that a PDO may
//! carry, by rising sub-index.

use crate::object::Object;
use crate::table::OBJECTS;

/// One PDO of a robot. All are synchronous, type 1.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Pdo {
    /// Received by the robot, not sent.
    pub receive: bool,
    /// 1 is 0x1400 or 0x1800.
    pub number: u8,
    /// Identifier, or what the node number is added to.
    pub cob_base: u16,
    /// The identifier is the same for all robots.
    pub broadcast: bool,
    /// Index of the record it carries.
    pub index: u16,
    /// Robots without a gyro do not send it: its identifier is switched off.
    pub of_gyro: bool,
    /// Its name.
    pub name: &'static str,
}

/// All PDOs of a robot, received ones first.
pub const PDOS: &[Pdo] = &[
    Pdo {
        receive: true,
        number: 1,
        cob_base: crate::cob::GROUP_TWIST,
        broadcast: true,
        index: 0x2100,
        of_gyro: false,
        name: "GroupTwist",
    },
    Pdo {
        receive: true,
        number: 2,
        cob_base: crate::cob::commissioning_twist(0),
        broadcast: false,
        index: 0x2101,
        of_gyro: false,
        name: "CommissioningTwist",
    },
    Pdo {
        receive: false,
        number: 1,
        cob_base: crate::cob::member_status(0),
        broadcast: false,
        index: 0x2110,
        of_gyro: false,
        name: "MemberStatus",
    },
    Pdo {
        receive: false,
        number: 2,
        cob_base: crate::cob::measured_twist(0),
        broadcast: false,
        index: 0x2111,
        of_gyro: false,
        name: "MeasuredTwist",
    },
    Pdo {
        receive: false,
        number: 3,
        cob_base: crate::cob::pose(0),
        broadcast: false,
        index: 0x2112,
        of_gyro: false,
        name: "Pose",
    },
    Pdo {
        receive: false,
        number: 4,
        cob_base: crate::cob::wheel_rates(0),
        broadcast: false,
        index: 0x2113,
        of_gyro: false,
        name: "WheelRates",
    },
    Pdo {
        receive: false,
        number: 5,
        cob_base: crate::cob::yaw_rate(0),
        broadcast: false,
        index: 0x2132,
        of_gyro: true,
        name: "YawRate",
    },
];

impl Pdo {
    /// The objects it carries, in order.
    pub fn objects(&self) -> impl Iterator<Item = &'static Object> + use<> {
        let index = self.index;
        OBJECTS
            .iter()
            .filter(move |object| object.address.index == index && object.mappable)
    }

    /// How many bytes it has.
    #[must_use]
    pub fn bytes(&self) -> u8 {
        self.objects().map(|object| object.kind.bytes()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pdo_is_eight_bytes_but_that_of_the_gyro() {
        for pdo in PDOS {
            let bytes = if pdo.of_gyro { 5 } else { 8 };
            assert_eq!(pdo.bytes(), bytes, "{}", pdo.name);
        }
    }
}
