//! A robot's configuration: everything it was told about itself, checked as a whole.
//!
//! Built from the [`Parameters`] at every start, and only then, so that a half-written set never
//! drives anything. What the control loop needs is worked out here: the folded kinematics, signed
//! angles per count, limits as reciprocals. After this there is nothing left to go wrong.

use kinematics::{FourWheelGeometry, GeometryError, GridCompensation, Mount, Pose, Wheel};
pub use motion::configuration::{Configuration, Thresholds, Times, WheelConfiguration};
use motion::drivetrain::{Drivetrain, compensation};
use motion::limiter::ChangeLimits;
use motion::rollers::{RollerConfiguration, RollerWheel};
use motion::wheel::Gains;
use protocol::address::{self as at, motor, rollers, wheel};
use protocol::{Address, MEMBER_MASK};

use crate::parameters::Parameters;

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

/// Makes the configuration of robot `node`.
///
/// # Errors
/// The first objection, by address.
pub fn build(parameters: &Parameters, node: u8) -> Result<Configuration, ConfigurationError> {
    if let Some(address) = parameters.first_missing() {
        return Err(ConfigurationError::Missing(address));
    }
    let bad = ConfigurationError::Inconsistent;
    let real = |address| parameters.real(address);

    let (wheels, geometry_at) = wheels(parameters)?;
    let mount = Mount::new(Pose {
        x: real(at::MOUNT_X),
        y: real(at::MOUNT_Y),
        heading: real(at::MOUNT_HEADING),
    })
    .map_err(|_| bad(at::MOUNT_X))?;
    let constant = parameters
        .constant_compensation()
        .map_err(|_| bad(at::COMPENSATION_LONGITUDINAL))?;
    let compensation = parameters
        .compensation_set()
        .map_or(Ok(GridCompensation::from(&constant)), |set| {
            compensation(&set, &constant)
        })
        .map_err(|_| bad(at::COMPENSATION_SET))?;
    let rollers = rollers(parameters)?;
    // The fast way with rollers is for wheels at the corners of a rectangle.
    let rolling = match &rollers {
        None => None,
        Some(_) if parameters.unsigned(at::INDIVIDUAL_WHEELS) != 0 => {
            return Err(bad(rollers::count(0)));
        }
        Some(rollers) => Some((geometry(parameters)?, rollers)),
    };
    let rolling = rolling
        .as_ref()
        .map(|(geometry, rollers)| (geometry, *rollers));
    let drivetrain =
        Drivetrain::new(&wheels, mount, compensation, rolling).map_err(|_| bad(geometry_at))?;

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
    let ordered = |limit: Address, fault: Address| real(fault) == 0.0 || real(limit) <= real(fault);
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
    Ok(Configuration {
        crc: parameters.crc().max(1),
        group: parameters.unsigned(at::GROUP_ID).to_le_bytes()[0],
        members,
        drivetrain,
        rollers,
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

/// The wheels' rollers, if any wheel has a number of them.
fn rollers(parameters: &Parameters) -> Result<Option<RollerConfiguration>, ConfigurationError> {
    let number = |wheel: u8| parameters.unsigned(rollers::count(wheel)).to_le_bytes()[0];
    if (0..4).all(|wheel| number(wheel) == 0) {
        return Ok(None);
    }
    let reversed = parameters.unsigned(at::ENCODER_REVERSED);
    let one = |wheel: u8| {
        let sign = if reversed >> wheel & 1 == 1 {
            -1.0
        } else {
            1.0
        };
        // The index comes once a turn of the wheel.
        let counts = encoder_counts(parameters, u16::from(wheel)) * parameters.real(at::GEAR_RATIO);
        RollerWheel::new(
            number(wheel),
            parameters.real(rollers::phase(wheel)),
            sign * counts,
        )
        .map_err(|_| ConfigurationError::Inconsistent(rollers::count(wheel)))
    };
    let wheels = [one(0)?, one(1)?, one(2)?, one(3)?];
    let [tolerance, high, ..] = parameters.unsigned(at::INDEX_TOLERANCE).to_le_bytes();
    let configuration = RollerConfiguration::new(
        wheels,
        parameters.unsigned(at::ROLLER_REFERENCE) == 1,
        u16::from_le_bytes([tolerance, high]),
    );
    Ok((!configuration.is_ideal()).then_some(configuration))
}

/// The usual four wheels.
fn geometry(parameters: &Parameters) -> Result<FourWheelGeometry, ConfigurationError> {
    let real = |address| parameters.real(address);
    FourWheelGeometry::new(
        real(at::HALF_TRACK),
        real(at::HALF_WHEELBASE),
        real(at::WHEEL_RADIUS),
        real(at::ROLLER_ANGLE),
    )
    .map_err(|_| ConfigurationError::Inconsistent(at::HALF_TRACK))
}

/// The four wheels, and the object to blame when they make no robot.
fn wheels(parameters: &Parameters) -> Result<([Wheel; 4], Address), ConfigurationError> {
    let real = |address| parameters.real(address);
    if parameters.unsigned(at::INDIVIDUAL_WHEELS) == 0 {
        let bad = ConfigurationError::Inconsistent(at::HALF_TRACK);
        let geometry = FourWheelGeometry::new(
            real(at::HALF_TRACK),
            real(at::HALF_WHEELBASE),
            real(at::WHEEL_RADIUS),
            real(at::ROLLER_ANGLE),
        );
        let wheels = geometry.and_then(|geometry| geometry.wheels());
        return Ok((wheels.map_err(|_| bad)?, at::HALF_TRACK));
    }
    let one = |at: u16| {
        let (radius, angle) = (wheel::radius(at), wheel::roller_angle(at));
        let (x, y) = (real(wheel::x(at)), real(wheel::y(at)));
        Wheel::new(x, y, 0.0, real(angle), real(radius)).map_err(|error| {
            ConfigurationError::Inconsistent(match error {
                GeometryError::RollerAngle => angle,
                _ => radius,
            })
        })
    };
    Ok(([one(0)?, one(1)?, one(2)?, one(3)?], at::INDIVIDUAL_WHEELS))
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

/// Counts of an encoder's turn: the wheel's own, or what all have.
fn encoder_counts(parameters: &Parameters, place: u16) -> f32 {
    let own = parameters.real(wheel::encoder_counts(place));
    if own > 0.0 {
        own
    } else {
        parameters.real(at::ENCODER_COUNTS)
    }
}

fn wheel_configuration(parameters: &Parameters, place: u16) -> WheelConfiguration {
    let real = |address| parameters.real(address);
    let sign = |mask: Address| {
        if parameters.unsigned(mask) >> place & 1 == 1 {
            -1.0
        } else {
            1.0
        }
    };
    let counts = encoder_counts(parameters, place);
    WheelConfiguration {
        step: sign(at::ENCODER_REVERSED) * core::f32::consts::TAU / (counts * real(at::GEAR_RATIO)),
        motor_sign: sign(at::MOTOR_REVERSED),
        gains: Gains {
            static_friction: real(motor::static_friction(place)),
            speed: real(motor::speed(place)),
            acceleration: real(motor::acceleration(place)),
            proportional: real(motor::proportional(place)),
            integral: real(motor::integral(place)),
        },
    }
}
