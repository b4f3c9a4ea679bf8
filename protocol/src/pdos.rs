//! Which PDOs a robot has, and which record each of them carries from the first sub-index to the
//! last.

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
        name: "GroupTwist",
    },
    Pdo {
        receive: true,
        number: 2,
        cob_base: crate::cob::commissioning_twist(0),
        broadcast: false,
        index: 0x2101,
        name: "CommissioningTwist",
    },
    Pdo {
        receive: false,
        number: 1,
        cob_base: crate::cob::member_status(0),
        broadcast: false,
        index: 0x2110,
        name: "MemberStatus",
    },
    Pdo {
        receive: false,
        number: 2,
        cob_base: crate::cob::measured_twist(0),
        broadcast: false,
        index: 0x2111,
        name: "MeasuredTwist",
    },
    Pdo {
        receive: false,
        number: 3,
        cob_base: crate::cob::pose(0),
        broadcast: false,
        index: 0x2112,
        name: "Pose",
    },
    Pdo {
        receive: false,
        number: 4,
        cob_base: crate::cob::wheel_rates(0),
        broadcast: false,
        index: 0x2113,
        name: "WheelRates",
    },
];

impl Pdo {
    /// The objects it carries, in order.
    pub fn objects(&self) -> impl Iterator<Item = &'static Object> + use<> {
        let index = self.index;
        OBJECTS
            .iter()
            .filter(move |object| object.address.index == index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pdo_is_eight_bytes_of_mappable_objects() {
        for pdo in PDOS {
            assert!(pdo.objects().all(|object| object.mappable));
            let bytes: u8 = pdo.objects().map(|object| object.kind.bytes()).sum();
            assert_eq!(bytes, 8, "{}", pdo.name);
        }
    }
}
