//! A new image over the bus: 0x1F50 on as CiA 302-3 has them, and 0x2003.

use super::record::{Record, byte, records};
use crate::address::Address;
use crate::object::{Kind, Object};

records! { PROGRAM_RECORDS:
    0x1F50 "Program data" {
        PROGRAM_DATA = 1: guarded_download("Program"),
            "The signed header of an image file and the image linked for the slot of 0x2003:2, in \
             one download. It cannot be read.";
    }
    0x1F51 "Program control" {
        PROGRAM_CONTROL = 1: guarded_setting("Program control", "", byte(0, 255, 1)),
            "Write 0 to prepare for an update, 3 to erase the other slot, 1 to start what was \
             received, 2 to start again, 0x80 to confirm an image on trial, 0x81 to go back to \
             the image in the other slot. Only in PRE-OPERATIONAL, with the outputs off. Reads 1 \
             as long as no update has begun, 0 after it has, 3 when the slot is erased, 0x80 when \
             the running image is on trial. While that is so, 0x80 and 0x81 are taken from a locked \
             robot, too.";
    }
    0x1F56 "Program software identification" {
        PROGRAM_IDENTIFICATION = 1: state("Program software identification", "", Kind::U32),
            "Checksum of the image that runs, or of the one received, which a start would start; \
             of an image written by cable its version.";
    }
    0x1F57 "Flash status" {
        FLASH_STATUS = 1: state("Flash status", "", Kind::U32),
            "Bit 0: busy. Bits 1 to 7: 0 no error, 1 no valid program, 2 unknown format, 3 wrong \
             data, 4 not erased, 5 flash cannot be written, 7 not permitted; 0x2003:3 says more.";
    }
}

records! { UPDATE_RECORDS:
    0x2003 "Update" {
        RUNNING_SLOT = 1: state("Running slot", "", Kind::U8),
            "Slot of flash that the running image lies in: 1 is A, 2 is B; 0 for a robot that has \
             no slots and is updated by cable.";
        WANTED_SLOT = 2: state("Wanted slot", "", Kind::U8),
            "Slot that an update is written to: the image has to be linked for it.";
        UPDATE_PROBLEM = 3: state("Update problem", "", Kind::U8),
            "What ended the last update: 0 nothing, 1 no header, 2 image for another board, 3 for \
             another hardware revision, 4 security counter below that of the running image, 5 \
             length or link for the other slot, 6 hash, 7 signature, 8 flash, 9 transfer ended, 10 \
             running image on trial.";
        SECURITY_COUNTER = 4: state("Security counter", "", Kind::U32),
            "Of the running image; an image with a lower one is refused.";
        OTHER_VERSION = 5: state("Other version", "", Kind::U32),
            "Version of the image in the other slot, as in 0x2001:2; 0 if there is none that is \
             whole and checked.";
        BOARD = 6: state("Board", "", Kind::U16),
            "Board that images have to be made for: 1 NUCLEO-F446RE, 2 RoboMaster C, 3 \
             NUCLEO-F446RE with smart drives.";
        HARDWARE_REVISION = 7: state("Hardware revision", "", Kind::U16),
            "Revision of its hardware that images have to be made for.";
    }
}
