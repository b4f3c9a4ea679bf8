//! Limits and faults: what a robot says about itself in sixteen bits.
//!
//! A *limit* is active but the robot moves on; it goes away by itself. A *fault* is latched: the
//! robot comes to rest, in the way its [`Reaction`] says, and its outputs stay off until an NMT
//! start finds the cause gone. Limits have numbers below 0x1000; a fault's number is the error code
//! of the emergency message that announces it (CiA 301 7.2.7.1), where the standard has one, else
//! 0xFF00 plus its number in `docs/safety.md`. Zero is "nothing to report".

/// How a robot comes to rest when a fault appears.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Reaction {
    /// Along the present direction of motion with the group's common deceleration; then the drivers
    /// go off and the brake engages.
    Ramp,
    /// Drivers off and brake engaged in the same control tick.
    Cut,
}

/// What kind of fault it is, as the error register tells it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum FaultClass {
    /// No particular kind.
    Generic,
    /// Supply voltage.
    Voltage,
    /// Temperature.
    Temperature,
    /// Communication.
    Communication,
    /// Particular to these robots.
    Manufacturer,
}

macro_rules! codes {
    ($(#[$meta:meta])* $name:ident {
        $($(#[doc = $text:literal])+ $variant:ident = $code:literal,)+
    }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, PartialEq, Eq, Debug)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[repr(u16)]
        pub enum $name { $($(#[doc = $text])+ $variant = $code,)+ }

        impl $name {
            /// Every one, by rising declaration.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)+];

            /// The number on the wire.
            #[must_use]
            pub const fn code(self) -> u16 {
                self as u16
            }

            /// The one with this number.
            #[must_use]
            pub const fn from_code(code: u16) -> Option<Self> {
                match code {
                    $($code => Some(Self::$variant),)+
                    _ => None,
                }
            }

            /// Its name as the source has it.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => stringify!($variant),)+
                }
            }

            /// What it means, for people.
            #[must_use]
            pub const fn text(self) -> &'static str {
                match self {
                    $(Self::$variant => concat!($($text),+),)+
                }
            }
        }
    };
}

codes! {
    /// Something holds the robot back, but it moves.
    Limit {
        /// This robot's wheels cannot turn as fast as the group twist asks; the group is scaled
        /// down.
        WheelRate = 0x0001,
        /// Another member's wheels are the slowest; the group is scaled down.
        GroupScale = 0x0002,
        /// The group twist changed faster than the acceleration or jerk limit allows.
        Acceleration = 0x0003,
        /// A wheel's controller asks for more than the supply voltage.
        Voltage = 0x0004,
        /// The four wheels disagree by more than the slip limit.
        Slip = 0x0005,
        /// This robot's motion disagrees with another member's by more than the strain limit.
        Strain = 0x0006,
        /// The supply voltage is close to its minimum.
        Supply = 0x0007,
        /// A setpoint was ignored: invalid, or with a sequence that does not follow the last.
        Setpoint = 0x0008,
        /// A wheel's index came at an unexpected angle, or not at all; the wheel computes with the
        /// mean over its rollers.
        RollerPhase = 0x0009,
        /// A wheel's controller asks for more than the torque bound allows.
        Torque = 0x000A,
        /// The CAN controller is error passive, or was and its error counters are still above 95;
        /// see 0x2130.
        BusErrors = 0x000B,
        /// Started, but setpoints ask for motion: first they must stay near standstill, see
        /// 0x2042:1.
        AwaitingStandstill = 0x000C,
        /// SYNC comes at another period than object 0x2041:1 says; the robot does not follow.
        SyncPeriod = 0x000D,
        /// This robot is declared alone for now (0x2050:2): it does not follow the group and keeps
        /// it at rest.
        Alone = 0x000E,
        /// The votes on the last SYNC came later than the agreement delay, see 0x2121:8.
        LateVote = 0x000F,
        /// The gyro is not used, and headings come from the wheels; 0x2132:1 says why.
        Gyro = 0x0010,
        /// The group twist is faster than 0x2030:8 and :9 allow; the group is scaled down.
        GroupSpeed = 0x0011,
    }
}

codes! {
    /// The robot came to rest, or is about to, and stays so until it is started again.
    Fault {
        /// The master's heartbeat is overdue.
        MasterSilent = 0x8130,
        /// SYNC is overdue.
        SyncLost = 0xFF02,
        /// No fresh setpoint within its timeout.
        SetpointOverdue = 0x8250,
        /// A member sent no status between two SYNCs.
        MemberSilent = 0xFF04,
        /// A member is in fault or stopped.
        MemberStopped = 0xFF05,
        /// A member follows another setpoint than this robot.
        SequenceMismatch = 0xFF06,
        /// Two masters command this group.
        TwoMasters = 0xFF07,
        /// The setpoints received are not valid.
        SetpointInvalid = 0xFF08,
        /// The CAN controller went off the bus.
        BusOff = 0x8140,
        /// Frames were lost on reception.
        ReceiveOverrun = 0x8110,
        /// A wheel is driven and its encoder does not count.
        EncoderDead = 0xFF0B,
        /// A wheel turns against its drive: encoder or motor reversed.
        EncoderInverted = 0xFF0C,
        /// A wheel is blocked.
        WheelBlocked = 0xFF0D,
        /// The motor driver reports a fault.
        DriverFault = 0xFF0E,
        /// The emergency stop is pressed, or its wire is broken.
        EmergencyStop = 0xFF0F,
        /// The supply voltage is too low.
        SupplyLow = 0x3220,
        /// Control ticks came too late.
        ControlLate = 0xFF11,
        /// The bus side gave no sign of life to the control side.
        BusStarved = 0xFF12,
        /// The program failed and was restarted.
        Crash = 0xFF13,
        /// The watchdog restarted the robot.
        WatchdogReset = 0xFF14,
        /// Power was lost while parameters were being stored; 0x2002:2 says which set is in use.
        StoreInterrupted = 0xFF15,
        /// The stored parameters are corrupt.
        ParametersCorrupt = 0x6300,
        /// The configuration is incomplete or not consistent; object 0x2002:1 says where.
        Unconfigured = 0xFF17,
        /// The four wheels disagree by more than the slip fault threshold.
        SlipExcess = 0xFF18,
        /// This robot's motion disagrees with another member's by more than the strain threshold.
        StrainExcess = 0xFF19,
        /// The supply voltage is too high, or cannot be measured.
        SupplyHigh = 0x3210,
        /// Members would move differently: their setpoint, group parameters or communication
        /// objects differ.
        PlanMismatch = 0xFF1B,
        /// Another robot sends with this one's node number.
        DuplicateNode = 0xFF1C,
        /// The protective stop is open, or its wire is broken.
        ProtectiveStop = 0xFF1D,
        /// The processor's clock failed and it was restarted.
        ClockLost = 0xFF1E,
        /// The processor's supply fell below its minimum and it was restarted.
        SupplyCollapse = 0xFF1F,
        /// The motors' current exceeds its bound, or cannot be measured.
        OverCurrent = 0xFF20,
        /// Wheels turn, so the robot cannot be started.
        WheelsTurn = 0xFF22,
        /// A motor behind a smart drive is hotter than 0x202C:5 allows.
        DriveHot = 0x4310,
        /// A wheel's smart drive does not report: it is off or unplugged, or its bus is broken.
        DriveSilent = 0xFF24,
        /// A smart drive reports with an identifier that no wheel has.
        DriveIdentifier = 0xFF25,
        /// Two smart drives report with one identifier.
        DriveDoubled = 0xFF26,
    }
}

impl Fault {
    /// How a robot comes to rest with this fault.
    #[must_use]
    pub const fn reaction(self) -> Reaction {
        match self {
            Self::EncoderInverted
            | Self::DriverFault
            | Self::EmergencyStop
            | Self::SupplyHigh
            | Self::Crash
            | Self::WatchdogReset
            | Self::StoreInterrupted
            | Self::ParametersCorrupt
            | Self::Unconfigured
            | Self::ClockLost
            | Self::SupplyCollapse
            | Self::OverCurrent
            | Self::WheelsTurn
            | Self::DriveSilent
            | Self::DriveIdentifier
            | Self::DriveDoubled => Reaction::Cut,
            Self::MasterSilent
            | Self::SyncLost
            | Self::SetpointOverdue
            | Self::MemberSilent
            | Self::MemberStopped
            | Self::SequenceMismatch
            | Self::TwoMasters
            | Self::SetpointInvalid
            | Self::BusOff
            | Self::ReceiveOverrun
            | Self::EncoderDead
            | Self::WheelBlocked
            | Self::SupplyLow
            | Self::ControlLate
            | Self::BusStarved
            | Self::SlipExcess
            | Self::StrainExcess
            | Self::DuplicateNode
            | Self::PlanMismatch
            | Self::ProtectiveStop
            | Self::DriveHot => Reaction::Ramp,
        }
    }

    /// Whether it is another robot's doing as a rule: the cause is to be looked for there.
    #[must_use]
    pub const fn is_consequence(self) -> bool {
        matches!(
            self,
            Self::MemberStopped | Self::MemberSilent | Self::SequenceMismatch
        )
    }

    /// Which bit of the error register (object 0x1001, CiA 301 7.5.2.2) this fault sets.
    #[must_use]
    pub const fn error_class(self) -> FaultClass {
        match self.code() >> 8 {
            0x32 => FaultClass::Voltage,
            0x43 => FaultClass::Temperature,
            0x81 | 0x82 => FaultClass::Communication,
            0xFF => FaultClass::Manufacturer,
            _ => FaultClass::Generic,
        }
    }
}

/// The sixteen bits a member reports: nothing, a limit, or a fault.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Code {
    /// Nothing to report.
    #[default]
    None,
    /// Active but moving.
    Limit(Limit),
    /// Latched, at rest or on the way there.
    Fault(Fault),
}

impl Code {
    /// The number on the wire.
    #[must_use]
    pub const fn code(self) -> u16 {
        match self {
            Self::None => 0,
            Self::Limit(limit) => limit.code(),
            Self::Fault(fault) => fault.code(),
        }
    }

    /// What the number means; `None` for a number this version does not know.
    #[must_use]
    pub const fn from_code(code: u16) -> Option<Self> {
        if code == 0 {
            return Some(Self::None);
        }
        if let Some(limit) = Limit::from_code(code) {
            return Some(Self::Limit(limit));
        }
        match Fault::from_code(code) {
            Some(fault) => Some(Self::Fault(fault)),
            None => None,
        }
    }
}

/// A limit or fault in words.
impl core::fmt::Display for Code {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::None => f.write_str("none"),
            Self::Limit(limit) => write!(f, "limit {}: {}", limit.name(), limit.text().trim()),
            Self::Fault(fault) => write!(f, "fault {}: {}", fault.name(), fault.text().trim()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_is_found_again_and_unique() {
        let mut seen = std::collections::BTreeSet::new();
        for limit in Limit::ALL {
            assert_eq!(Code::from_code(limit.code()), Some(Code::Limit(*limit)));
            assert!(limit.code() < 0x1000 && seen.insert(limit.code()));
        }
        for fault in Fault::ALL {
            assert_eq!(Code::from_code(fault.code()), Some(Code::Fault(*fault)));
            assert!(fault.code() >= 0x1000 && seen.insert(fault.code()));
        }
        assert_eq!(Code::from_code(0), Some(Code::None));
        assert_eq!(Code::from_code(0x0999), None);
    }

    #[test]
    fn standard_faults_have_standard_codes() {
        assert_eq!(Fault::MasterSilent.code(), 0x8130);
        assert_eq!(Fault::SetpointOverdue.code(), 0x8250);
        let class = Fault::error_class;
        assert_eq!(class(Fault::MasterSilent), FaultClass::Communication);
        assert_eq!(class(Fault::EmergencyStop), FaultClass::Manufacturer);
        assert_eq!(class(Fault::SupplyLow), FaultClass::Voltage);
        assert_eq!(class(Fault::ParametersCorrupt), FaultClass::Generic);
    }

    #[test]
    fn only_faults_that_leave_no_way_to_brake_cut() {
        assert_eq!(Fault::EmergencyStop.reaction(), Reaction::Cut);
        assert_eq!(Fault::DriverFault.reaction(), Reaction::Cut);
        assert_eq!(Fault::EncoderInverted.reaction(), Reaction::Cut);
        assert_eq!(Fault::MasterSilent.reaction(), Reaction::Ramp);
        assert_eq!(Fault::EncoderDead.reaction(), Reaction::Ramp);
    }
}
