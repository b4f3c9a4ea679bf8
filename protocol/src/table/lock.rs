//! The lock of parameters, node-IDs and updates: 0x2004.

use super::record::{Record, records};
use crate::address::Address;
use crate::object::{Kind, Object};

records! { LOCK_RECORDS:
    0x2004 "Lock" {
        LOCK_STATE = 1: command("Lock state", "", Kind::U8),
            "0 no key is set, and everything may be written; 1 locked; 2 unlocked. Write 1 to lock. \
             The robot also locks itself at every reset and when nothing guarded has been written \
             for ten minutes. While it is locked, writes of guarded objects, of communication \
             objects, and of 0x1010 and 0x1011 are refused with 0x08000021, and a node-ID by LSS \
             with an error.";
        LOCK_CHALLENGE = 2: state("Challenge", "", Kind::Domain),
            "64 bytes that change with every response. Not while OPERATIONAL, and not in the first \
             second after a start (0x08000022); without a key 0x08000024.";
        LOCK_RESPONSE = 3: download("Response"),
            "64 bytes: HMAC-SHA-512, under the key, of the challenge and one byte with the node-ID. \
             The right one unlocks the robot; a wrong one (0x06090030) bars others for a second, \
             and each in a row for twice as long, up to 64 s (0x08000022).";
        LOCK_KEY = 4: guarded_download("Key"),
            "32 bytes, kept in flash at once; 32 zeros for no key. It cannot be read. Only at rest, \
             with the outputs off. The robot is unlocked afterwards. 0x1011 leaves it alone.";
    }
}
