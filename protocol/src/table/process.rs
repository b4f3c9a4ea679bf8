//! Process data: what PDOs carry, each record as one PDO. 0x2100 on.

use super::record::{Record, records};
use crate::address::Address;
use crate::object::{Kind, Object};

const GROUP_TWIST: &str =
    "Group twist as received by RPDO1, in the group frame; -32768 is invalid.";
const ALONE_TWIST: &str =
    "Commissioning twist as received by RPDO2, in the robot's frame; -32768 is invalid.";
const MEASURED_TWIST: &str =
    "Velocity of the group as this robot's wheels measure it, in the group frame.";
const RATE: &str = "Measured wheel rate; positive rolls the base forward.";

records! { SETPOINT_RECORDS:
    0x2100 "Group twist" {
        SETPOINT_VX = 1: received("vx", "0.1 mm/s", Kind::I16), GROUP_TWIST;
        SETPOINT_VY = 2: received("vy", "0.1 mm/s", Kind::I16), GROUP_TWIST;
        SETPOINT_OMEGA = 3: received("omega", "0.1 mrad/s", Kind::I16), GROUP_TWIST;
        SETPOINT_SEQUENCE = 4: received("sequence", "", Kind::U8), GROUP_TWIST;
        SETPOINT_GROUP = 5: received("group", "", Kind::U8), GROUP_TWIST;
    }
}

records! { ALONE_RECORDS:
    0x2101 "Commissioning twist" {
        ALONE_VX = 1: received("vx", "0.1 mm/s", Kind::I16), ALONE_TWIST;
        ALONE_VY = 2: received("vy", "0.1 mm/s", Kind::I16), ALONE_TWIST;
        ALONE_OMEGA = 3: received("omega", "0.1 mrad/s", Kind::I16), ALONE_TWIST;
        ALONE_SEQUENCE = 4: received("sequence", "", Kind::U8), ALONE_TWIST;
        ALONE_GROUP = 5: received("group", "", Kind::U8), ALONE_TWIST;
    }
}

records! { STATUS_RECORDS:
    0x2110 "Status" {
        STATE = 1: process("State", "", Kind::U8),
            "0 unconfigured, 1 ready, 2 armed, 3 moving, 4 alone, 5 ramping, 6 faulted.";
        STATUS_SEQUENCE = 2: process("Echoed sequence", "", Kind::U8),
            "Of the setpoint latched at the last SYNC.";
        STATUS_SCALE = 3: process("Permitted group scale", "1/65535", Kind::U16),
            "Scale at which this robot's own wheels can follow; 0 stops the group.";
        STATUS_SLIP = 4: process("Slip residual", "20 mrad/s", Kind::U8),
            "Magnitude of the wheel rates that no rigid motion explains; 254 is this or more, 255 \
             not measured. With its sign and in full: 0x2120:2.";
        STATUS_CODE = 5: process("Limit or fault", "", Kind::U16),
            "0 nothing, below 0x1000 a limit, else a fault; the number is that of the emergency \
             message.";
        STATUS_PLAN = 6: process("Plan checksum", "", Kind::U8),
            "Over what this robot is about to do: the setpoint as it understood it, its group \
             parameters, its communication objects. Members that differ stop the group.";
    }
}

records! { MEASURED_RECORDS:
    0x2111 "Measured twist" {
        MEASURED_VX = 1: process("vx", "0.1 mm/s", Kind::I16), MEASURED_TWIST;
        MEASURED_VY = 2: process("vy", "0.1 mm/s", Kind::I16), MEASURED_TWIST;
        MEASURED_OMEGA = 3: process("omega", "0.1 mrad/s", Kind::I16), MEASURED_TWIST;
        MEASURED_SEQUENCE = 4: process("sequence", "", Kind::U8), MEASURED_TWIST;
        MEASURED_GROUP = 5: process("group", "", Kind::U8), MEASURED_TWIST;
    }
}

records! { POSE_RECORDS:
    0x2112 "Pose" {
        POSE_X = 1: process("x", "0.1 mm", Kind::I24),
            "Position of the group frame since the robot was configured.";
        POSE_Y = 2: process("y", "0.1 mm", Kind::I24),
            "The same to the left.";
        POSE_HEADING = 3: process("Heading", "0.1 mrad", Kind::I16),
            "Heading of the group frame, within +-pi.";
    }
}

records! { RATES_RECORDS:
    0x2113 "Wheel rates" {
        RATE_FRONT_LEFT = 1: process("Front left", "2 mrad/s", Kind::I16), RATE;
        RATE_FRONT_RIGHT = 2: process("Front right", "2 mrad/s", Kind::I16), RATE;
        RATE_REAR_LEFT = 3: process("Rear left", "2 mrad/s", Kind::I16), RATE;
        RATE_REAR_RIGHT = 4: process("Rear right", "2 mrad/s", Kind::I16), RATE;
    }
}
