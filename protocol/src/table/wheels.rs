//! Records of which every wheel has one: the wheel itself, its motor, and what an identification
//! has found about the motor. Wheels are in the order front left, front right, rear left, rear
//! right.

/// Declares the objects of four records, one behind the other; their addresses are functions of the
/// wheel, 0 to 3.
macro_rules! per_wheel {
    ($first:literal $record:literal {
        $($name:ident = $sub:literal: $make:ident($title:literal $(, $arg:expr)*), $text:expr;)+
    }) => {
        use super::super::record::Record;
        use crate::address::Address;
        use crate::object::Object;

        /// Index of the front left wheel's record; the others follow.
        pub const FIRST: u16 = $first;

        $(
            #[doc = concat!($title, ", sub-index ", stringify!($sub), ".")]
            #[must_use]
            pub const fn $name(wheel: u16) -> Address {
                Address::new(FIRST + wheel, $sub)
            }
        )+

        const fn objects(wheel: u16) -> [Object; [$($sub),+].len()] {
            [$(Object::$make($name(wheel), $title $(, $arg)*, $text)),+]
        }

        pub(in crate::table) const RECORDS: &[Record] = &[
            Record::new(FIRST, concat!($record, " front left"), &objects(0)),
            Record::new(FIRST + 1, concat!($record, " front right"), &objects(1)),
            Record::new(FIRST + 2, concat!($record, " rear left"), &objects(2)),
            Record::new(FIRST + 3, concat!($record, " rear right"), &objects(3)),
        ];
    };
}

/// A wheel of its own kind.
pub mod wheel {
    use super::super::record::real;

    per_wheel! { 0x2014 "Wheel" {
        x = 1: parameter("x", "m", real(-10.0, 10.0, 0.0)),
            "Wheel centre, forward of the robot's origin.";
        y = 2: parameter("y", "m", real(-10.0, 10.0, 0.0)),
            "Wheel centre, left of the robot's origin.";
        radius = 3: parameter("Radius", "m", real(0.0, 1.0, 0.0)),
            "From the axle to the ground under a roller; used where 0x2010:5 is 1, and then above \
             0.";
        roller_angle = 4: parameter("Roller angle", "rad", real(-1.47, 1.47, 0.0)),
            "Of the ground roller's axle against the wheel's axle, counter-clockwise from above; \
             on the usual robot positive front left and rear right, negative on the others. Not 0 \
             where 0x2010:5 is 1.";
        encoder_counts = 5: parameter("Encoder counts", "counts", real(0.0, 1_000_000.0, 0.0)),
            "Of this wheel, in place of 0x2020:1; 0 for the same as the others.";
    } }
}

/// The motor of one wheel.
pub mod motor {
    use super::super::record::real;

    per_wheel! { 0x2021 "Motor" {
        static_friction = 1: required("Static friction", "V", real(0.0, 50.0, 0.0)),
            "Voltage at which the wheel just keeps turning.";
        speed = 2: required("Speed feedforward", "V s/rad", real(0.0, 100.0, 0.0)),
            "Additional voltage per wheel rate.";
        acceleration = 3: required("Acceleration feedforward", "V s^2/rad", real(0.0, 50.0, 0.0)),
            "Additional voltage per wheel acceleration.";
        proportional = 4: required("Proportional gain", "V s/rad", real(0.0, 100.0, 0.0)),
            "Voltage per error of the wheel rate.";
        integral = 5: required("Integral gain", "V/rad", real(0.0, 2000.0, 0.0)),
            "Voltage per error of the wheel angle.";
    } }
}

/// What an identification has found, with the sub-indices of [`motor`].
pub mod identified {
    use crate::object::Kind;

    const FOUND: &str = "Found by the last identification; 0 before. Not in effect until it is \
        written to the motor's object.";

    per_wheel! { 0x2052 "Identified" {
        static_friction = 1: state("Static friction", "V", Kind::F32), FOUND;
        speed = 2: state("Speed", "V s/rad", Kind::F32), FOUND;
        acceleration = 3: state("Acceleration", "V s^2/rad", Kind::F32), FOUND;
        proportional = 4: state("Proportional", "V s/rad", Kind::F32), FOUND;
        integral = 5: state("Integral", "V/rad", Kind::F32), FOUND;
        residual = 6: state("Misfit", "V", Kind::F32), FOUND;
    } }

    /// The value that would be written to this sub-index of the wheel's motor.
    #[must_use]
    pub const fn value(wheel: u16, sub: u8) -> Address {
        Address::new(FIRST + wheel, sub)
    }
}
