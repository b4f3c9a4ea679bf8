//! Wheels, mount and compensation: 0x2010 on.

use super::record::{Record, byte, real, records};
use crate::address::Address;
use crate::object::{Kind, Object};

records! { ROBOT_RECORDS:
    0x2010 "Geometry" {
        HALF_TRACK = 1: required("Half track", "m", real(0.02, 5.0, 0.2)),
            "Half the distance between left and right wheel centres.";
        HALF_WHEELBASE = 2: required("Half wheelbase", "m", real(0.02, 5.0, 0.2)),
            "Half the distance between front and rear wheel centres.";
        WHEEL_RADIUS = 3: required("Wheel radius", "m", real(0.01, 1.0, 0.05)),
            "From the wheel axle to the ground under a roller.";
        ROLLER_ANGLE = 4: required(
            "Roller angle", "rad", real(0.1, 1.47, core::f32::consts::FRAC_PI_4)
        ),
            "Between roller axle and wheel axle.";
        INDIVIDUAL_WHEELS = 5: parameter("Individual wheels", "", byte(0, 1, 0)),
            "0: four wheels alike, placed by the values above. 1: each wheel is what 0x2014 to \
             0x2017 say; the values above then only have to be written.";
    }
    0x2011 "Mount" {
        MOUNT_X = 1: required("Mount x", "m", real(-50.0, 50.0, 0.0)),
            "Position of the robot in the group frame, forward.";
        MOUNT_Y = 2: required("Mount y", "m", real(-50.0, 50.0, 0.0)),
            "Position of the robot in the group frame, left.";
        MOUNT_HEADING = 3: required("Mount heading", "rad", real(-6.3, 6.3, 0.0)),
            "Heading of the robot in the group frame, counter-clockwise.";
    }
    0x2012 "Compensation" {
        COMPENSATION_LONGITUDINAL = 1: required(
            "Longitudinal compensation", "", real(0.5, 2.0, 1.0)
        ),
            "Commanded over achieved velocity along x of the robot, at any speed. For an axis that \
             has no rows in 0x2013.";
        COMPENSATION_LATERAL = 2: required("Lateral compensation", "", real(0.5, 2.0, 1.0)),
            "Commanded over achieved velocity along y of the robot.";
        COMPENSATION_YAW = 3: required("Yaw compensation", "", real(0.5, 2.0, 1.0)),
            "Commanded over achieved angular velocity.";
    }
    0x2013 "Compensation tables" {
        COMPENSATION_SET = 1: block("Compensation set"),
            "Tables of these coefficients over speed and direction, as one block with its version \
             and CRC; layout above. Taken whole or refused: 0x06090030 for a wrong CRC, format or \
             order of rows, 0x06090032 for a coefficient below 0.5, 0x06040043 for tables that \
             cannot be inverted. After a reset to defaults a set without rows.";
        COMPENSATION_VERSION = 2: state("Version of the set", "", Kind::U32),
            "As its writer chose it; 0 where there is none.";
        COMPENSATION_CRC = 3: state("CRC of the set", "", Kind::U32),
            "The first four bytes of the set.";
    }
}

records! { DRIVE_RECORDS:
    0x2018 "Drive" {
        GEAR_RATIO = 1: parameter("Gear ratio", "", real(0.01, 1_000.0, 1.0)),
            "Revolutions of the encoder's shaft in one of the wheel. 1 where the counts are those \
             of the wheel.";
    }
}
