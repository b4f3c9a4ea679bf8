//! One robot by itself: 0x2050 on.

use super::record::{Record, byte, real, records};
use crate::address::Address;
use crate::object::{Kind, Object};

records! { COMMISSIONING_RECORDS:
    0x2050 "Commissioning" {
        COMMISSIONING = 1: command("Commissioning permission", "", Kind::U8),
            "1 declares that this robot may move on its own: not coupled to a load, wheels free or \
             area clear. Refused with 0x06040043 unless 0x2040:2 names this robot alone, or \
             0x2050:2 is 1. Ends with every change of the NMT state and after 60 s; writing 1 \
             again gives another 60 s. 0 ends the motion by a ramp. A commissioning twist is \
             followed up to 0.25 m/s and 0.5 rad/s, after an NMT start once it has asked for \
             standstill as often as 0x2042:1 says.";
        ALONE_FOR_NOW = 2: command("Alone for now", "", Kind::U8),
            "1 makes a robot that is a member of a group its own only member for a test: it needs \
             no votes but its own and follows no group twist, and its vote keeps the group at rest \
             (limit 0x000E). Only before NMT start. Ends when the robot leaves OPERATIONAL, when \
             the master's heartbeat is overdue (0x2041:4) and when the master boots.";
    }
}

records! { IDENTIFICATION_RECORDS:
    0x2051 "Identification" {
        IDENTIFY = 1: command("Identification", "", Kind::U8),
            "1 begins to identify the motors: all wheels forward on a slow ramp of voltage, then \
             backward on a step. Refused unless the robot is started, stands, and 0x2050:1 is 1. 0 \
             stops. However it ends, the robot comes to rest and needs an NMT start.";
        IDENTIFY_STATUS = 2: state("Identification status", "", Kind::U8),
            "0 never run, 1 running, 2 done; stopped: 3 by the master, 4 by a fault, 5 by its time \
             limit of 20 s, 6 wheel too fast, 7 wheel too far, 8 wheel does not turn, 9 wheel \
             turns backwards, 10 not the behaviour of a motor.";
        IDENTIFY_WHEEL = 3: state("Identification wheel", "", Kind::U8),
            "The wheel that stopped it: 0 front left, 1 front right, 2 rear left, 3 rear right; \
             255 none.";
        IDENTIFY_RATE = 4: setting("Identification wheel rate", "rad/s", real(0.5, 50.0, 5.0)),
            "The ramp ends when a wheel is that fast; half as much again stops it.";
        IDENTIFY_TRAVEL = 5: setting("Identification travel", "rad", real(1.0, 200.0, 12.0)),
            "Largest angle by which a wheel may turn from where it stood; the ramp ends at three \
             fifths of it.";
        IDENTIFY_BANDWIDTH = 6: setting(
            "Identification bandwidth", "rad/s", real(1.0, 100.0, 10.0)
        ),
            "Of the loop for which 0x2052 to 0x2055 show gains.";
        IDENTIFY_DAMPING = 7: setting("Identification damping", "", real(0.5, 2.0, 1.0)),
            "Of the same; 1 is critical.";
        IDENTIFY_WHEELS = 8: setting("Identification wheels", "", byte(0, 15, 0)),
            "Wheels that get the voltage: bit 0 front left, 1 front right, 2 rear left, 3 rear \
             right; 0 is all. The others need not turn: for wheels off the floor.";
    }
}

records! { BLINK_RECORDS:
    0x2059 "Blink" {
        BLINK = 0: command("Blink", "s", Kind::U8),
            "The LED shows for this many seconds which robot this is: five short flashes and a \
             pause. 0 ends it. Reads as the seconds left.";
    }
}
