//! What the robot measures, counts and remembers: 0x2120 on.

use super::record::{Record, records};
use crate::address::Address;
use crate::object::{Kind, Object};

records! { DIAGNOSTICS_RECORDS:
    0x2120 "Measurements" {
        SUPPLY = 1: state("Supply voltage", "V", Kind::F32),
            "As measured; 0 where it is not.";
        SLIP = 2: state("Slip residual", "rad/s", Kind::F32),
            "Wheel rates that no rigid motion explains; 0 when not measured.";
        CURRENT = 3: state("Motor current", "A", Kind::F32),
            "As the sensors of 0x2026:3 measure it, with its sign; 0 where it is not measured.";
        TEMPERATURE = 4: state("Motor temperature", "degC", Kind::U8),
            "Of the hottest motor, as the smart drives report it; 0 where it is not measured.";
    }
    0x2121 "Counters" {
        LATE_TICKS = 1: counter("Late ticks"),
            "Control ticks more than half a period late.";
        LOST_SYNCS = 2: counter("Lost SYNCs"),
            "Gaps in the SYNC counter.";
        IGNORED_SETPOINTS = 3: counter("Ignored setpoints"),
            "Invalid, or with a sequence that does not follow the last.";
        REFUSED_WRITES = 4: counter("Refused writes"),
            "Writes to this table that were refused.";
        STOPS = 5: counter("Stops"),
            "Times a fault brought the robot to rest.";
        WATCHDOG_RESETS = 6: counter("Watchdog resets"),
            "Since power-on.";
        CAN_ERRORS = 7: counter("CAN errors"),
            "Frames lost by overflow or bus-off.";
        LATE_VOTES = 8: counter("Late votes"),
            "SYNCs whose votes came later than the agreement delay (0x2041:5), so the setpoint took \
             effect late.";
        LATEST_VOTE = 9: state("Latest vote", "us", Kind::U32),
            "Longest time from SYNC to the last vote on it, since the start.";
        SATURATED_TICKS = 10: counter("Saturated ticks"),
            "Control ticks in fixed point in which a number was in the last thousandth of its \
             range, where what does not fit stays; 0 in floating point.";
    }
}

records! { STORE_RECORDS:
    0x2126 "Store" {
        SAVES = 1: counter("Saves"),
            "Images stored since the store was new, kept with them.";
        ERASES = 2: counter("Erases"),
            "Sectors erased since the store was new, each of the two half as often; a save that \
             was cut off counts as one. The chip is made for 10 000 of each.";
        CUT_SAVES = 3: counter("Cut saves"),
            "Saves during which power was lost; announced as fault 0xFF15 at the next start.";
    }
}

records! { POWER_RECORDS:
    0x2127 "Clock and supply" {
        CLOCK_WAIT = 1: state("Wait at start", "ms", Kind::U16),
            "How long the last start waited for the clock from outside and for the processor's \
             supply.";
        BROWN_OUT_LEVEL = 2: state("Brown-out reset", "", Kind::U8),
            "Level of the processor's brown-out reset: 3, programmed at the first start, resets \
             below 2.8 V. Below 2.7 V the processor is not reliable; 0 is off.";
    }
}

records! { FAULT_MEMORY_RECORDS:
    0x2128 "Fault memory" {
        STORED_FAULTS = 1: state("Stored faults", "", Kind::Domain),
            "The last eight faults, kept over power losses, the newest first: 32 bytes each, \
             layout above. Shorter while there have been fewer.";
    }
    0x2129 "State of the fault memory" {
        START_NUMBER = 1: counter("Start"),
            "Number of this start, from 1; starts that do not last a second are not counted.";
        UNSTORED_FAULTS = 2: state("Unstored", "", Kind::U8),
            "How many of these faults are not in flash yet: they are written at rest, at most \
             eight every 10 s.";
        UPTIME = 3: state("Uptime", "ms", Kind::U32),
            "Time since the robot started, on the clock of 0x2123 and 0x2125.";
    }
}

records! { CAN_RECORDS:
    0x2130 "CAN" {
        CAN_TRANSMIT_ERRORS = 1: state("Transmit errors", "", Kind::U8),
            "Transmit error counter (ISO 11898-1): 8 up with a frame that failed, 1 down with one \
             that did not; from 128 on the controller is error passive, above 255 it is off the \
             bus.";
        CAN_RECEIVE_ERRORS = 2: state("Receive errors", "", Kind::U8),
            "Receive error counter: 1 to 9 up with a frame that was broken, 1 down with a good \
             one; from 128 on error passive.";
        CAN_LAST_ERROR = 3: state("Last error", "", Kind::U8),
            "0 none since the start, 1 stuffing, 2 form, 3 not acknowledged, 4 recessive bit read \
             as dominant, 5 dominant bit read as recessive, 6 checksum. Read every few ms, so one \
             of several may be missed.";
        CAN_PASSIVES = 4: counter("Times error passive"),
            "Since power-on. Each is announced by emergency message 0x8120 and taken back once \
             both error counters are below 96.";
        CAN_BUS_OFFS = 5: counter("Times bus-off"),
            "Since power-on.";
    }
    0x2131 "Cable" {
        CABLE_LOST = 1: counter("Lost to the cable"),
            "Frames of the bus and of this robot, and answers, that the serial port had no room \
             for. The three counts of this record are since the start; reading them, or the slcan \
             command F, clears none.";
        CABLE_NOT_SENT = 2: counter("Lost to the bus"),
            "Frames of the cable that have not left for the CAN bus: no node acknowledged them \
             within 20 ms, the bus was off, or there was no room. A robot alone on its bus \
             follows them all the same, and counts them here.";
        CABLE_DAMAGED = 3: counter("Damaged"),
            "Times that bytes from the cable were unreadable (baud rate, noise, a line that is \
             held low) or came faster than they were read; each time the line of text they were in \
             is dropped.";
    }
}

records! { GYRO_RECORDS:
    0x2132 "Gyro" {
        GYRO_STATE = 1: process("State", "", Kind::U8),
            "0 the board has none, 1 waits for a second of rest to learn the bias, 2 in use; not \
             believed until the next start: 3 missing, 4 stuck, 5 implausible, 6 silent.";
        GYRO_RATE = 2: process("Yaw rate", "rad/s", Kind::F32),
            "Of the robot, without bias, counter-clockwise positive; 0 while it is not used.";
        GYRO_BIAS = 3: state("Bias", "rad/s", Kind::F32),
            "Mean of what it showed at rest; 0 while it is not known.";
    }
}
