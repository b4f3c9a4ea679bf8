//! The group, its times and its stops: 0x2040 on.

use super::record::{Record, byte, long, records, word};
use crate::MEMBER_MASK;
use crate::address::Address;
use crate::object::Object;

records! { GROUP_RECORDS:
    0x2040 "Group" {
        GROUP_ID = 1: required("Group", "", byte(0, 255, 0)),
            "Group twists for another group are not for this robot: they are neither followed nor \
             counted, so several groups can share a bus, its SYNC and its master's heartbeat.";
        MEMBERS = 2: required("Members", "", long(4, MEMBER_MASK, 4)),
            "Bit n stands for node n; robots are 2 to 17. This robot must be among them; only a \
             robot that is alone among them may move on its own (0x2050:1).";
    }
    0x2041 "Times" {
        SYNC_PERIOD = 1: parameter("SYNC period", "us", long(2_000, 100_000, 10_000)),
            "Also the time over which one setpoint passes into the next.";
        SYNC_TIMEOUT = 2: parameter("SYNC timeout", "ms", word(0, 1000, 0)),
            "Moving, without SYNC for this long: ramp down; 0 for two and a quarter periods. When \
             a member's status is missing, too, a period and a quarter is enough.";
        SETPOINT_TIMEOUT = 3: parameter("Setpoint timeout", "ms", word(4, 5000, 100)),
            "Moving, without a fresh setpoint for this long: ramp down.";
        HEARTBEAT_TIMEOUT = 4: parameter("Master heartbeat timeout", "ms", word(10, 10_000, 500)),
            "Armed or moving, without the master's heartbeat for this long: ramp down. Only one \
             that says OPERATIONAL counts; a boot-up message is a stop.";
        AGREEMENT_DELAY = 5: parameter("Agreement delay", "us", word(0, 65_535, 0)),
            "After SYNC, without its jitter, the setpoint latched there takes effect; shorter than \
             the SYNC period. 0 for the smallest that fits the members.";
    }
    0x2042 "Restart and stops" {
        STANDSTILL_SYNCS = 1: parameter("Standstill before motion", "SYNCs", byte(1, 250, 3)),
            "After a start, this many SYNCs in a row must bring a setpoint of less than 0.01 m/s \
             and 0.01 rad/s that all members agree on; until then any other setpoint gives a scale \
             of 0.";
        PROTECTIVE_STOP = 2: parameter("Protective stop", "", byte(0, 1, 0)),
            "1: a normally closed contact is connected to the protective stop input; open is a \
             ramp, then outputs off.";
        CUTS_TOGETHER = 3: parameter("Cut together", "", byte(0, 1, 0)),
            "1: the emergency stop of one member is a cut for all, announced by its emergency \
             message; 0: the others ramp.";
    }
}
