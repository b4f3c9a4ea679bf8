//! What the robot is, and whether it is configured: 0x2000 on.

use super::record::{Record, records};
use crate::address::Address;
use crate::object::{Kind, Object, Value};

records! { IDENTITY_RECORDS:
    0x2000 "Wire version" {
        WIRE_VERSION = 0: constant("Wire version", Value::U16(crate::WIRE_VERSION)),
            "Changes with the meaning of any byte on the bus. A master refuses a robot that has \
             another.";
    }
    0x2001 "Device" {
        SERIAL_NUMBER = 1: state("Serial number", "", Kind::U32),
            "Also 0x1018:4.";
        FIRMWARE_VERSION = 2: state("Firmware version", "", Kind::U32),
            "Major, minor, patch in the upper three bytes; the lowest is 0.";
        RESET_CAUSE = 3: state("Reset cause", "", Kind::U8),
            "0 power, 1 reset pin, 2 software, 3 independent watchdog, 4 window watchdog, 5 low \
             power, 6 brown-out.";
        NODE_SWITCHES = 4: state("Node switches", "", Kind::U8),
            "Node that the switches on the board give.";
        NODE_STORED = 5: state("Stored node", "", Kind::U8),
            "Node that was stored by LSS and comes before the switches; 0 for none.";
        CHIP = 6: state("Chip", "", Kind::U32),
            "Device number of the microcontroller in the lowest 12 bits, its revision from bit 16 \
             on (DBGMCU_IDCODE); 0 where the chip does not tell, or there is none.";
    }
    0x2002 "Configuration" {
        CONFIGURATION_STATUS = 1: state("Configuration status", "", Kind::U32),
            "0 when the configuration is complete and valid. Otherwise index, sub-index and reason \
             of the first objection from the top down: reason 1 not written, 2 does not fit the \
             rest, 3 refused as stored (0 for the object: the stored image as a whole).";
        CONFIGURATION_CRC = 2: state("Configuration CRC", "", Kind::U32),
            "CRC-32 (IEEE 802.3) over all parameters in the order of this table, four bytes each \
             (of the compensation set its CRC), so that a master can tell whether a robot has the \
             intended configuration.";
        GROUP_CRC = 3: state("Group CRC", "", Kind::U32),
            "The same over the parameters that must be equal in all members of a group: \
             acceleration, jerk, deceleration, group, members, times, restart and stops of the \
             group, brake release. Members that differ here would not move as one.";
    }
}
