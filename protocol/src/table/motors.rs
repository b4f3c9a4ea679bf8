//! Encoders, motors and what drives them: 0x2020 on.

use super::record::{Record, byte, real, records, word};
use crate::address::Address;
use crate::object::Object;

records! { WHEELS_RECORDS:
    0x2020 "Wheels" {
        ENCODER_COUNTS = 1: required(
            "Encoder counts per revolution", "counts", real(16.0, 1_000_000.0, 2048.0)
        ),
            "All edges counted, in a revolution of the encoder's shaft: of the wheel where \
             0x2018:1 is 1. May be a fraction. Smart drives report 8192.";
        ENCODER_REVERSED = 2: required("Reversed encoders", "", byte(0, 15, 0)),
            "Bit 0 front left, 1 front right, 2 rear left, 3 rear right: this encoder counts down \
             when the wheel rolls the base forward.";
        MOTOR_REVERSED = 3: required("Reversed motors", "", byte(0, 15, 0)),
            "Bits as above: this motor rolls the base backward with a positive duty.";
        OBSERVER_BANDWIDTH = 4: parameter("Observer bandwidth", "rad/s", real(5.0, 400.0, 100.0)),
            "Natural frequency of the wheel-rate observer.";
    }
}

records! { SUPPLY_RECORDS:
    0x2025 "Supply" {
        SUPPLY_NOMINAL = 1: required("Nominal supply", "V", real(1.0, 100.0, 24.0)),
            "Voltage at full duty where the supply is not measured.";
        SUPPLY_MINIMUM = 2: parameter("Minimum supply", "V", real(0.0, 100.0, 0.0)),
            "Below this for 100 ms the robot comes to rest. 0 says that the supply is not \
             measured: no check, and no correction of the duty.";
        SUPPLY_MAXIMUM = 3: parameter("Maximum supply", "V", real(0.0, 100.0, 0.0)),
            "Above this for 10 ms the drivers are switched off, because braking on would raise it \
             further. 0 for no check. Not checked where the supply is not measured (0x2025:2 is \
             0).";
        SUPPLY_MARGIN = 4: parameter("Supply margin", "V", real(0.0, 50.0, 1.0)),
            "Less than this above the minimum, the supply limit is reported.";
        SUPPLY_DIVIDER = 5: parameter("Supply divider", "", real(1.0, 100.0, 11.0)),
            "Supply voltage per voltage at the measuring input; 11 is 100 kOhm and 10 kOhm, for at \
             most 36 V at 3.3 V.";
    }
}

records! { TORQUE_RECORDS:
    0x2026 "Torque" {
        WINDING_RESISTANCE = 1: parameter("Winding resistance", "ohm", real(0.0, 100.0, 0.0)),
            "Of a motor with its leads and bridge; 0 where it is not known.";
        CURRENT_MAX = 2: parameter("Largest current", "A", real(0.0, 1000.0, 0.0)),
            "Of a motor. A wheel gets at most this times the resistance beyond its back EMF. With \
             both 0 the bound is half of the nominal supply; one without the other is refused.";
        CURRENT_SCALE = 3: parameter("Current scale", "A/V", real(0.0, 1000.0, 0.0)),
            "Current per voltage at a current sensor's input; 0: none is connected. More than 1.25 \
             times what four motors may take (0x2026:2), or an input at the end of its range, for \
             20 ms is fault OverCurrent. The range must reach that far. Refused by boards that have \
             no input for a sensor.";
        CURRENT_OFFSET = 4: parameter("Current offset", "V", real(0.0, 3.3, 0.0)),
            "Voltage at the input without current: 0 for a shunt, half of the range for most Hall \
             sensors.";
        CURRENT_INPUTS = 5: parameter("Current inputs", "", byte(1, 3, 1)),
            "How many inputs are added up, from the first: 1 for one sensor that sees all motors, \
             2 or 3 for sensors that each see some of them. They have the same scale and offset.";
    }
}

records! { OUTPUT_STAGE_RECORDS:
    0x2027 "Output stage" {
        DUTY_MAX = 1: parameter("Largest duty", "", real(0.1, 1.0, 1.0)),
            "Less than 1 for bridges whose high side needs pauses to charge (bootstrap).";
        DIRECTION_PAUSE = 2: parameter("Direction pause", "", byte(0, 1, 0)),
            "1: a bridge gets no duty for one tick before it changes its direction.";
        BRAKE_RELEASE = 3: parameter("Brake release time", "ms", word(0, 1000, 0)),
            "Time that the slowest brake of the group needs to release, the same in all members. \
             For this long after its release no setpoint is followed and no wheel is monitored; \
             the loops hold.";
        BRAKE_ENGAGE = 4: parameter("Brake engage time", "ms", word(0, 1000, 0)),
            "Time that the brake needs to engage. For this long after it was engaged at standstill \
             the drivers stay on and the loops hold. A cut does not wait.";
        PWM_FREQUENCY = 5: parameter("PWM frequency", "Hz", word(8_000, 40_000, 20_000)),
            "As drivers and motors require. Below 16 kHz it is audible; above 20 kHz many drivers \
             lose more power.";
        OUTPUT_STAGE = 6: parameter("Kind", "", byte(0, 6, 0)),
            "How a duty is put on a bridge's inputs: 0 PWM and direction; 1 IN/IN, slow decay: \
             PWM on IN1, direction on IN2, inverted PWM while reversing; 3 locked antiphase, half \
             the period high is no voltage. Kinds 1 and 3 need 0x2027:7 = 1 and a board that cuts \
             the drivers' enable in hardware. 4 C620 and 5 C610 are smart drives on a CAN bus of \
             their own, for images that are built for them; they need 0x2026:1 and 0x2026:2. 2 and \
             6 have two PWMs a wheel, on IN1 and IN2, for images that are built for them: 2 fast \
             decay, both low between the pulses; 6 both high between the pulses.";
        ENABLE_WIRED = 7: parameter("Enable wired", "", byte(0, 1, 0)),
            "1: the output \"driver enable\" is wired to the drivers and switches all bridges off. \
             With kinds 1 and 3 nothing else does, because PWM low is not their safe state.";
    }
}

records! { SMART_DRIVES_RECORDS:
    0x202C "Smart drives" {
        DRIVE_FRONT_LEFT = 1: parameter("Front left", "", byte(1, 4, 1)),
            "Identifier of the drive of this wheel, where 0x2027:6 is 4 or 5; all four differ.";
        DRIVE_FRONT_RIGHT = 2: parameter("Front right", "", byte(1, 4, 2)), "The same.";
        DRIVE_REAR_LEFT = 3: parameter("Rear left", "", byte(1, 4, 3)), "The same.";
        DRIVE_REAR_RIGHT = 4: parameter("Rear right", "", byte(1, 4, 4)), "The same.";
        DRIVE_HOTTEST = 5: parameter("Highest temperature", "degC", byte(30, 150, 80)),
            "Of a motor, as its drive reports it; hotter is fault DriveHot. A C610 reports none.";
        DRIVE_CONSTANT = 6: parameter("Motor constant", "V s/rad", real(0.0, 100.0, 0.0)),
            "Back EMF per wheel rate, which is torque per current in N m/A, gear included. 0 takes \
             the speed feedforward, and the loops then make up for the viscous friction in it.";
    }
}

records! { ROLLER_REFERENCE_RECORDS:
    0x202A "Roller reference" {
        ROLLER_REFERENCE = 1: parameter("Source", "", byte(0, 1, 0)),
            "Where the angle of the rollers comes from: 0 nowhere, every wheel computes with the \
             mean over its rollers; 1 the index inputs, once a turn of the wheel each: behind a \
             gear that takes a sensor on the wheel.";
        INDEX_TOLERANCE = 2: parameter("Index tolerance", "counts", word(1, 10_000, 20)),
            "An index further than this from a whole number of turns after the last is unexpected. \
             Covers two counts and the play between encoder and wheel; at most 1/64 of a turn is \
             used.";
    }
}

records! { ENCODER_INPUTS_RECORDS:
    0x202B "Encoder inputs" {
        ENCODER_FILTER = 1: parameter("Filter", "", byte(0, 15, 3)),
            "Digital filter of the encoder channels, ICxF of RM0390 18.4.7: a level counts once it \
             has lasted 0, 2, 4, 8, 12, 16, 24, 32, 48, 64, 80, 96, 128, 160, 192 or 256 clocks of \
             the timers, at 90 MHz 11.1 ns each, on the kit at 72 MHz 13.9 ns; 3 is 89 ns or 111 \
             ns. Refused where the counts at the maximum wheel rate come faster than one in that \
             time.";
    }
}
