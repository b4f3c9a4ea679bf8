//! Limits of the motion and thresholds of its supervision: 0x2030 on.

use super::record::{Record, real, records, word};
use crate::address::Address;
use crate::object::Object;

records! { LIMITS_RECORDS:
    0x2030 "Limits" {
        WHEEL_RATE_MAX = 1: required("Maximum wheel rate", "rad/s", real(0.1, 65.0, 10.0)),
            "What this robot's wheels can follow; sets its permitted group scale.";
        ACCELERATION = 2: required("Group acceleration", "m/s^2", real(0.01, 20.0, 1.0)),
            "Largest acceleration of the group frame's origin. The same in every member.";
        ACCELERATION_YAW = 3: required(
            "Group angular acceleration", "rad/s^2", real(0.01, 50.0, 1.0)
        ),
            "The same about z.";
        JERK = 4: required("Group jerk", "m/s^3", real(0.1, 2000.0, 20.0)),
            "Largest change of acceleration per second. The same in every member.";
        JERK_YAW = 5: required("Group angular jerk", "rad/s^3", real(0.1, 5000.0, 20.0)),
            "The same about z.";
        DECELERATION = 6: required("Ramp deceleration", "m/s^2", real(0.05, 20.0, 1.0)),
            "Of every ramp to standstill, along the direction of motion. The same in every member.";
        DECELERATION_YAW = 7: required(
            "Ramp angular deceleration", "rad/s^2", real(0.05, 50.0, 1.0)
        ),
            "The same about z; the slower of the two decides.";
        SPEED_MAX = 8: parameter("Maximum group speed", "m/s", real(0.0, 20.0, 0.0)),
            "Largest speed of the group frame's origin: a faster setpoint is scaled down. 0: what \
             the wheels can follow. The same in every member.";
        YAW_RATE_MAX = 9: parameter("Maximum group yaw rate", "rad/s", real(0.0, 20.0, 0.0)),
            "The same about z.";
    }
    0x2031 "Thresholds" {
        SLIP_LIMIT = 1: parameter("Slip limit", "rad/s", real(0.0, 60.0, 1.0)),
            "Slip residual above which the slip limit is reported; 0 for never.";
        SLIP_FAULT = 2: parameter("Slip fault", "rad/s", real(0.0, 60.0, 2.5)),
            "Slip residual above which the robot comes to rest; 0 for never. It must last for one \
             and a half times 0x2031:6, and 300 ms at least. No drive of the tests without a fault \
             has 0.1 for that long; one wheel that stands still while the others roll at 0.6 m/s \
             (152 mm) has 2.0, and is named by the wheel watch.";
        STRAIN_LIMIT = 3: parameter("Strain limit", "m/s", real(0.0, 5.0, 0.05)),
            "Difference between this robot's and another member's measured group twist, at this \
             robot's place, above which the strain limit is reported; 0 for never.";
        STRAIN_FAULT = 4: parameter("Strain fault", "m/s", real(0.0, 5.0, 0.3)),
            "The same, above which the robot comes to rest; 0 for never. It must last as long as \
             slip above 0x2031:2. No drive of the tests without a fault has 0.01 for that long; a \
             member with one dead encoder at 0.6 m/s has 0.21, and is named by its wheel watch.";
        BLOCKED_RATE = 5: parameter("Blocked wheel", "rad/s", real(0.0, 60.0, 2.0)),
            "Deviation from the commanded wheel rate that means a blocked or dead wheel; 0 for no \
             check.";
        WHEEL_FAULT_TIME = 6: parameter("Wheel fault time", "ms", word(10, 2000, 200)),
            "How long that must last.";
    }
}
