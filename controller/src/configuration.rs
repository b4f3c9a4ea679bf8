//! A robot's configuration: everything it was told about itself, checked as a whole.
//!
//! Built from the [`Parameters`] at every start, and only then, so that a half-written set never
//! drives anything. What the control loop needs is worked out here: the folded kinematics, signed
//! angles per count, limits as reciprocals. After this there is nothing left to go wrong.

#[cfg(feature = "fixed-point")]
use kinematics::FixedMember as Kinematics;
#[cfg(not(feature = "fixed-point"))]
use kinematics::MemberKinematics as Kinematics;
use kinematics::{FourWheelGeometry, Mount, Pose, VelocityCompensation};
use protocol::address::{self as at, motor};
use protocol::{Address, MEMBER_MASK};

use crate::limiter::ChangeLimits;
use crate::parameters::Parameters;
use crate::wheel::Gains;

/// Why a set of parameters is no configuration.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ConfigurationError {
    /// This required parameter has not been written.
    Missing(Address),
    /// This parameter does not fit the rest.
    Inconsistent(Address),
}

impl ConfigurationError {
    /// The word that object 0x2002:1 shows: index, sub-index, reason from the top down.
    #[must_use]
    pub const fn code(self) -> u32 {
        match self {
            Self::Missing(address) => address.packed() << 8 | 1,
            Self::Inconsistent(address) => address.packed() << 8 | 2,
        }
    }
}

/// One wheel: encoder, motor, loop.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct WheelConfiguration {
    /// rad for one count up; negative where the encoder is reversed.
    pub step: f32,
    /// 1, or -1 where the motor is reversed.
    pub motor_sign: f32,
    /// Feedforward and gains.
    pub gains: Gains,
}

/// Times, all in microseconds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Times {
    /// Period of SYNC.
    pub sync_period_us: u32,
    /// Longest time without SYNC.
    pub sync_timeout_us: u64,
    /// Longest time without a fresh setpoint.
    pub setpoint_timeout_us: u64,
    /// Longest time without the master's heartbeat.
    pub heartbeat_timeout_us: u64,
    /// How long a wheel may look faulty.
    pub wheel_fault_us: u64,
}

/// Thresholds; 0 turns one off.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Thresholds {
    /// rad/s.
    pub slip_limit: f32,
    /// rad/s.
    pub slip_fault: f32,
    /// m/s.
    pub strain_limit: f32,
    /// m/s.
    pub strain_fault: f32,
    /// rad/s.
    pub blocked_rate: f32,
    /// V.
    pub supply_minimum: f32,
}

/// A complete and consistent configuration.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Configuration {
    /// CRC over the parameters it was made from; never 0.
    pub crc: u32,
    /// Group this robot belongs to.
    pub group: u8,
    /// Bit n stands for node n.
    pub members: u32,
    /// Group twist to wheel rates and back; in fixed point with the feature of that name.
    pub kinematics: Kinematics,
    /// Where this robot stands in the group.
    pub mount: Mount,
    /// Fastest wheel rate, rad/s.
    pub wheel_rate_max: f32,
    /// Limits while following.
    pub follow: ChangeLimits,
    /// Limits of the ramp to standstill.
    pub ramp: ChangeLimits,
    /// Front left, front right, rear left, rear right.
    pub wheels: [WheelConfiguration; 4],
    /// rad/s.
    pub observer_bandwidth: f32,
    /// V.
    pub supply_nominal: f32,
    /// When something counts as slip, strain, blocked, low.
    pub thresholds: Thresholds,
    /// Time-outs.
    pub times: Times,
}

impl Configuration {
    /// Makes the configuration of robot `node`.
    ///
    /// # Errors
    /// The first objection, by address.
    pub fn new(parameters: &Parameters, node: u8) -> Result<Self, ConfigurationError> {
        if let Some(address) = parameters.first_missing() {
            return Err(ConfigurationError::Missing(address));
        }
        let bad = ConfigurationError::Inconsistent;
        let real = |address| parameters.real(address);

        let geometry = FourWheelGeometry::new(
            real(at::HALF_TRACK),
            real(at::HALF_WHEELBASE),
            real(at::WHEEL_RADIUS),
            real(at::ROLLER_ANGLE),
        )
        .map_err(|_| bad(at::HALF_TRACK))?;
        let mount = Mount::new(Pose {
            x: real(at::MOUNT_X),
            y: real(at::MOUNT_Y),
            heading: real(at::MOUNT_HEADING),
        })
        .map_err(|_| bad(at::MOUNT_X))?;
        let compensation = VelocityCompensation::new(
            real(at::COMPENSATION_LONGITUDINAL),
            real(at::COMPENSATION_LATERAL),
            real(at::COMPENSATION_YAW),
        )
        .map_err(|_| bad(at::COMPENSATION_LONGITUDINAL))?;
        let kinematics =
            Kinematics::new(&geometry, &mount, &compensation).map_err(|_| bad(at::HALF_TRACK))?;

        let members = parameters.unsigned(at::MEMBERS);
        let own = 1_u32.checked_shl(u32::from(node)).unwrap_or(0);
        if members & own == 0 || members & !MEMBER_MASK != 0 {
            return Err(bad(at::MEMBERS));
        }
        let supply_nominal = real(at::SUPPLY_NOMINAL);
        let supply_minimum = real(at::SUPPLY_MINIMUM);
        if supply_minimum >= supply_nominal {
            return Err(bad(at::SUPPLY_MINIMUM));
        }
        let ordered =
            |limit: Address, fault: Address| real(fault) == 0.0 || real(limit) <= real(fault);
        if !ordered(at::SLIP_LIMIT, at::SLIP_FAULT) {
            return Err(bad(at::SLIP_FAULT));
        }
        if !ordered(at::STRAIN_LIMIT, at::STRAIN_FAULT) {
            return Err(bad(at::STRAIN_FAULT));
        }
        let times = times(parameters);
        let period = u64::from(times.sync_period_us);
        // Closer than that, the first late SYNC would be a stop.
        if times.sync_timeout_us < 2 * period {
            return Err(bad(at::SYNC_TIMEOUT));
        }
        if times.setpoint_timeout_us < 2 * period {
            return Err(bad(at::SETPOINT_TIMEOUT));
        }

        let jerk = (real(at::JERK), real(at::JERK_YAW));
        Ok(Self {
            crc: parameters.crc().max(1),
            group: parameters.unsigned(at::GROUP_ID).to_le_bytes()[0],
            members,
            kinematics,
            mount,
            wheel_rate_max: real(at::WHEEL_RATE_MAX),
            follow: ChangeLimits::new(
                real(at::ACCELERATION),
                real(at::ACCELERATION_YAW),
                jerk.0,
                jerk.1,
            ),
            ramp: ChangeLimits::new(
                real(at::DECELERATION),
                real(at::DECELERATION_YAW),
                jerk.0,
                jerk.1,
            ),
            wheels: [0, 1, 2, 3].map(|wheel| wheel_configuration(parameters, wheel)),
            observer_bandwidth: real(at::OBSERVER_BANDWIDTH),
            supply_nominal,
            thresholds: Thresholds {
                slip_limit: real(at::SLIP_LIMIT),
                slip_fault: real(at::SLIP_FAULT),
                strain_limit: real(at::STRAIN_LIMIT),
                strain_fault: real(at::STRAIN_FAULT),
                blocked_rate: real(at::BLOCKED_RATE),
                supply_minimum,
            },
            times,
        })
    }

    /// Whether `node` is one of the group.
    #[must_use]
    pub const fn is_member(&self, node: u8) -> bool {
        node < 32 && self.members >> node & 1 == 1
    }
}

fn times(parameters: &Parameters) -> Times {
    let ms = |address| u64::from(parameters.unsigned(address)) * 1000;
    Times {
        sync_period_us: parameters.unsigned(at::SYNC_PERIOD),
        sync_timeout_us: ms(at::SYNC_TIMEOUT),
        setpoint_timeout_us: ms(at::SETPOINT_TIMEOUT),
        heartbeat_timeout_us: ms(at::HEARTBEAT_TIMEOUT),
        wheel_fault_us: ms(at::WHEEL_FAULT_TIME),
    }
}

fn wheel_configuration(parameters: &Parameters, wheel: u16) -> WheelConfiguration {
    let real = |address| parameters.real(address);
    let sign = |mask: Address| {
        if parameters.unsigned(mask) >> wheel & 1 == 1 {
            -1.0
        } else {
            1.0
        }
    };
    WheelConfiguration {
        step: sign(at::ENCODER_REVERSED) * core::f32::consts::TAU / real(at::ENCODER_COUNTS),
        motor_sign: sign(at::MOTOR_REVERSED),
        gains: Gains {
            static_friction: real(motor::static_friction(wheel)),
            speed: real(motor::speed(wheel)),
            acceleration: real(motor::acceleration(wheel)),
            proportional: real(motor::proportional(wheel)),
            integral: real(motor::integral(wheel)),
        },
    }
}
