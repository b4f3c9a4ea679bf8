//! A robot's configuration: all its parameters, checked as a whole.
//!
//! Built from the [`Parameters`] at every start, and only then, so that a half-written set never
//! drives anything. What the control loop needs is computed here: the folded kinematics, signed
//! angles per count, limits as reciprocals. Nothing that uses the configuration can fail.

mod wheel_drives;

use control::brake::BrakeTimes;
use control::configuration::{Configuration, Thresholds, Times, WheelConfiguration};
use control::current::CurrentConfiguration;
use control::drivetrain::{Contact, Drivetrain};
use control::limiter::ChangeLimits;
use control::quantity::{AccelerationGain, Angle, Divider, Rate, Ratio, Voltage};
use control::rollers::{RollerConfiguration, RollerWheel, Rolling};
use control::supply::{FULL_SCALE, SupplyConfiguration};
use control::time::TICK_US;
use control::wheel::Gains;
use control::wheel_drive::MotorLimits;
use kinematics::{FourWheelGeometry, GeometryError, Mount, Pose, Twist, Wheel};
use protocol::address::{self as at, motor, rollers, wheel};
use protocol::timing::{BIT_RATE, agreement_delay_us, latest_delay_us};
use protocol::{Address, MEMBER_MASK, Value, entry};

use crate::compensation::tabulate;
use crate::hardware::Hardware;
use crate::parameters::Parameters;

/// Longest ramp while the bus side is silent, s: the watchdog waits no longer.
pub const RAMP_GRACE: f32 = 3.0;

/// Longest time between two control ticks that is no fault, s.
const LATEST_TICK: f32 = 0.020;

/// Voltage beyond the back EMF where no largest current is given, as a share of the nominal supply.
const TORQUE_SHARE: f32 = 0.5;

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

/// What a robot `node` on this hardware makes of these values, the others being at their defaults.
/// Values are not checked against their own limits.
///
/// # Errors
/// As [`build`].
pub fn of_values(
    values: impl IntoIterator<Item = (Address, Value)>,
    node: u8,
    hardware: Hardware,
) -> Result<Configuration, ConfigurationError> {
    let mut parameters = Parameters::new();
    for (address, value) in values {
        if let Some(slot) = entry(address).and_then(|entry| entry.slot()) {
            parameters.set(slot, value);
        }
    }
    build(&parameters, node, hardware)
}

/// Makes the configuration of robot `node` on this hardware.
///
/// # Errors
/// The first objection, by address.
pub fn build(
    parameters: &Parameters,
    node: u8,
    hardware: Hardware,
) -> Result<Configuration, ConfigurationError> {
    if let Some(address) = parameters.first_missing() {
        return Err(ConfigurationError::Missing(address));
    }
    let real = |address| parameters.real(address);
    let mount = mount(parameters)?;
    let drivetrain = drivetrain(parameters, mount)?;
    let members = members(parameters, node)?;
    check_thresholds(parameters)?;
    check_stop(parameters, &drivetrain)?;
    check_counts(parameters)?;
    check_gains(parameters)?;
    check_quantities(parameters)?;
    check_supply(parameters)?;
    check_torque(parameters)?;
    let output_stage = wheel_drives::output_stage(parameters, hardware.output_stages)?;
    let current = current(parameters, hardware)?;
    let times = times(parameters, members)?;
    let encoder_filter = encoder_filter(parameters, hardware)?;
    Ok(Configuration {
        crc: parameters.crc().max(1),
        check: parameters.check(),
        group: parameters.unsigned(at::GROUP_ID).to_le_bytes()[0],
        members,
        standstill_syncs: parameters.unsigned(at::STANDSTILL_SYNCS).to_le_bytes()[0],
        protective_stop: parameters.unsigned(at::PROTECTIVE_STOP) == 1,
        cuts_together: parameters.unsigned(at::CUTS_TOGETHER) == 1,
        drivetrain,
        encoder_filter,
        mount,
        wheel_rate_max: real(at::WHEEL_RATE_MAX),
        speed_max: group_limit(parameters, at::SPEED_MAX),
        yaw_rate_max: group_limit(parameters, at::YAW_RATE_MAX),
        follow: change_limits(parameters, at::ACCELERATION, at::ACCELERATION_YAW),
        ramp: change_limits(parameters, at::DECELERATION, at::DECELERATION_YAW),
        wheels: [0, 1, 2, 3].map(|wheel| wheel_configuration(parameters, wheel)),
        observer_bandwidth: real(at::OBSERVER_BANDWIDTH),
        supply: supply(parameters),
        current,
        pwm_hz: parameters.unsigned(at::PWM_FREQUENCY),
        output_stage,
        drives: wheel_drives::drives(parameters, output_stage)?,
        motors: MotorLimits::new(
            real(at::WINDING_RESISTANCE),
            real(at::CURRENT_MAX),
            real(at::DRIVE_CONSTANT),
        ),
        direction_pause: parameters.unsigned(at::DIRECTION_PAUSE) != 0,
        brake: BrakeTimes {
            release_us: u64::from(parameters.unsigned(at::BRAKE_RELEASE)) * 1000,
            engage_us: u64::from(parameters.unsigned(at::BRAKE_ENGAGE)) * 1000,
        },
        thresholds: thresholds(parameters),
        times,
    })
}

fn mount(parameters: &Parameters) -> Result<Mount, ConfigurationError> {
    Mount::new(Pose {
        x: parameters.real(at::MOUNT_X),
        y: parameters.real(at::MOUNT_Y),
        heading: parameters.real(at::MOUNT_HEADING),
    })
    .map_err(|_| ConfigurationError::Inconsistent(at::MOUNT_X))
}

/// Wheels, rollers and compensation together. Not inlined: otherwise all its numbers are kept and
/// copied one by one.
#[inline(never)]
fn drivetrain(parameters: &Parameters, mount: Mount) -> Result<Drivetrain, ConfigurationError> {
    let bad = ConfigurationError::Inconsistent;
    let (wheels, geometry_at) = wheels(parameters)?;
    let constant = parameters
        .constant_compensation()
        .map_err(|_| bad(at::COMPENSATION_LONGITUDINAL))?;
    let contact = match rollers(parameters)? {
        None => Contact::Ideal,
        // The fast way with rollers is for wheels at the corners of a rectangle.
        Some(_) if parameters.unsigned(at::INDIVIDUAL_WHEELS) != 0 => {
            return Err(bad(rollers::count(0)));
        }
        Some(rollers) => Contact::Rolling(
            Rolling::new(&geometry(parameters)?, &rollers).map_err(|_| bad(geometry_at))?,
        ),
    };
    let mut drivetrain =
        Drivetrain::new(&wheels, mount, &constant, &contact).map_err(|_| bad(geometry_at))?;
    if let Some(set) = parameters.compensation_set() {
        tabulate(drivetrain.compensation_mut(), &set, &constant)
            .map_err(|_| bad(at::COMPENSATION_SET))?;
    }
    Ok(drivetrain)
}

/// The members, of which the robot itself is one; bit n stands for node n.
fn members(parameters: &Parameters, node: u8) -> Result<u32, ConfigurationError> {
    let members = parameters.unsigned(at::MEMBERS);
    let own = 1_u32.checked_shl(u32::from(node)).unwrap_or(0);
    if members & own == 0 || members & !MEMBER_MASK != 0 {
        return Err(ConfigurationError::Inconsistent(at::MEMBERS));
    }
    Ok(members)
}

fn change_limits(parameters: &Parameters, linear: Address, yaw: Address) -> ChangeLimits {
    let real = |address| parameters.real(address);
    ChangeLimits::new(real(linear), real(yaw), real(at::JERK), real(at::JERK_YAW))
}

fn supply(parameters: &Parameters) -> SupplyConfiguration {
    let real = |address| parameters.real(address);
    SupplyConfiguration {
        nominal: Voltage::new(real(at::SUPPLY_NOMINAL)),
        minimum: Voltage::new(real(at::SUPPLY_MINIMUM)),
        maximum: Voltage::new(real(at::SUPPLY_MAXIMUM)),
        margin: Voltage::new(real(at::SUPPLY_MARGIN)),
        divider: Divider::new(real(at::SUPPLY_DIVIDER)),
        duty_max: Ratio::new(real(at::DUTY_MAX)),
    }
}

fn thresholds(parameters: &Parameters) -> Thresholds {
    let rate = |address| Rate::new(parameters.real(address));
    Thresholds {
        slip_limit: rate(at::SLIP_LIMIT),
        slip_fault: rate(at::SLIP_FAULT),
        strain_limit: rate(at::STRAIN_LIMIT),
        strain_fault: rate(at::STRAIN_FAULT),
        blocked_rate: rate(at::BLOCKED_RATE),
    }
}

/// A limit comes before its fault.
fn check_thresholds(parameters: &Parameters) -> Result<(), ConfigurationError> {
    let real = |address| parameters.real(address);
    let pairs = [
        (at::SLIP_LIMIT, at::SLIP_FAULT),
        (at::STRAIN_LIMIT, at::STRAIN_FAULT),
    ];
    for (limit, fault) in pairs {
        if real(fault) != 0.0 && real(limit) > real(fault) {
            return Err(ConfigurationError::Inconsistent(fault));
        }
    }
    Ok(())
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
    let configuration = RollerConfiguration::new(
        wheels,
        parameters.unsigned(at::ROLLER_REFERENCE) == 1,
        wheel_drives::index_tolerance(parameters),
    );
    Ok((!configuration.is_ideal()).then_some(configuration))
}

/// Clocks of its timer for which a channel must keep its level to get through its filter, by
/// 0x202B:1 (RM0390 18.4.7, RM0008 15.4.7).
const FILTER_CLOCKS: [f32; 16] = [
    0.0, 2.0, 4.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 80.0, 96.0, 128.0, 160.0, 192.0, 256.0,
];

/// The filter of the encoder channels. A level lasts two counts; uneven channels may take one of
/// them away.
fn encoder_filter(parameters: &Parameters, hardware: Hardware) -> Result<u8, ConfigurationError> {
    let clock_hz = f32::from(hardware.encoder_clock_mhz) * 1e6;
    let [filter, ..] = parameters.unsigned(at::ENCODER_FILTER).to_le_bytes();
    let clocks = FILTER_CLOCKS.get(usize::from(filter)).copied();
    let turns = parameters.real(at::WHEEL_RATE_MAX) * parameters.real(at::GEAR_RATIO)
        / core::f32::consts::TAU;
    let fits = |place| {
        let counts = turns * encoder_counts(parameters, place);
        clocks.is_some_and(|clocks| counts * clocks <= clock_hz)
    };
    if (0..4).all(fits) {
        Ok(filter)
    } else {
        Err(ConfigurationError::Inconsistent(at::ENCODER_FILTER))
    }
}

/// The usual four wheels.
#[inline(never)]
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

/// The four wheels, and the object to blame when they make no robot. Not inlined, as above.
#[inline(never)]
fn wheels(parameters: &Parameters) -> Result<([Wheel; 4], Address), ConfigurationError> {
    let real = |address| parameters.real(address);
    if parameters.unsigned(at::INDIVIDUAL_WHEELS) == 0 {
        let bad = ConfigurationError::Inconsistent(at::HALF_TRACK);
        let wheels = geometry(parameters)?.wheels();
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

fn times(parameters: &Parameters, members: u32) -> Result<Times, ConfigurationError> {
    let bad = |address| Err(ConfigurationError::Inconsistent(address));
    let ms = |address| u64::from(parameters.unsigned(address)) * 1000;
    let sync_period_us = parameters.unsigned(at::SYNC_PERIOD);
    let period = u64::from(sync_period_us);
    let agreement_delay_us = match parameters.unsigned(at::AGREEMENT_DELAY) {
        0 => agreement_delay_us(members, sync_period_us, BIT_RATE),
        given => Some(given).filter(|given| *given <= latest_delay_us(sync_period_us)),
    };
    let Some(agreement_delay_us) = agreement_delay_us else {
        return bad(at::AGREEMENT_DELAY);
    };
    let times = Times {
        sync_period_us,
        agreement_delay_us,
        sync_timeout_us: match ms(at::SYNC_TIMEOUT) {
            // Two periods, so that one lost SYNC is forgiven, and what the next may be late.
            0 => period * 9 / 4,
            timeout => timeout,
        },
        setpoint_timeout_us: ms(at::SETPOINT_TIMEOUT),
        heartbeat_timeout_us: ms(at::HEARTBEAT_TIMEOUT),
        wheel_fault_us: ms(at::WHEEL_FAULT_TIME),
    };
    // Otherwise the control ticks could not keep in step with it.
    if !sync_period_us.is_multiple_of(TICK_US) {
        return bad(at::SYNC_PERIOD);
    }
    // Closer than that, the first late SYNC would be a stop.
    if times.sync_timeout_us < 2 * period {
        return bad(at::SYNC_TIMEOUT);
    }
    if times.setpoint_timeout_us < 2 * period {
        return bad(at::SETPOINT_TIMEOUT);
    }
    Ok(times)
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

/// Largest voltage beyond the back EMF, V.
fn torque(parameters: &Parameters) -> f32 {
    let given = parameters.real(at::CURRENT_MAX) * parameters.real(at::WINDING_RESISTANCE);
    if given > 0.0 {
        given
    } else {
        TORQUE_SHARE * parameters.real(at::SUPPLY_NOMINAL)
    }
}

/// What four motors may take at most, over what [`torque`] allows them: no sensor and no resistance
/// is exact.
const CURRENT_MARGIN: f32 = 1.25;

/// The sensors of the motors' current, if there are any. The board must have inputs for them, and
/// they must be able to show more than is allowed.
fn current(
    parameters: &Parameters,
    hardware: Hardware,
) -> Result<Option<CurrentConfiguration>, ConfigurationError> {
    let scale = parameters.real(at::CURRENT_SCALE);
    if scale == 0.0 {
        return Ok(None);
    }
    let [inputs, ..] = parameters.unsigned(at::CURRENT_INPUTS).to_le_bytes();
    let offset = parameters.real(at::CURRENT_OFFSET);
    let bound = 4.0 * CURRENT_MARGIN * parameters.real(at::CURRENT_MAX);
    let reach = (FULL_SCALE - offset) * scale * f32::from(inputs);
    if inputs > hardware.current_inputs || bound == 0.0 || reach <= bound {
        return Err(ConfigurationError::Inconsistent(at::CURRENT_SCALE));
    }
    Ok(Some(CurrentConfiguration {
        scale,
        offset,
        inputs,
        bound,
    }))
}

/// A limit of the group's motion; infinite where there is none.
fn group_limit(parameters: &Parameters, address: Address) -> f32 {
    Some(parameters.real(address))
        .filter(|limit| *limit > 0.0)
        .unwrap_or(f32::INFINITY)
}

/// From the fastest that its wheels and the group's limits allow, a robot has to come to rest while
/// the watchdog still waits for a ramp.
fn check_stop(parameters: &Parameters, drivetrain: &Drivetrain) -> Result<(), ConfigurationError> {
    let real = |address| parameters.real(address);
    let translation = (at::DECELERATION, at::JERK, at::SPEED_MAX);
    let rotation = (at::DECELERATION_YAW, at::JERK_YAW, at::YAW_RATE_MAX);
    let axes = [
        (Twist::new(1.0, 0.0, 0.0), translation),
        (Twist::new(0.0, 1.0, 0.0), translation),
        (Twist::new(0.0, 0.0, 1.0), rotation),
    ];
    for (unit, (deceleration, jerk, limit)) in axes {
        let rates: [f32; 4] = drivetrain.fastest(unit).into();
        let fastest = rates.into_iter().map(f32::abs).fold(0.0, f32::max);
        let wheels = real(at::WHEEL_RATE_MAX) / fastest;
        let speed = wheels.min(group_limit(parameters, limit));
        let stop = speed / real(deceleration) + real(deceleration) / real(jerk);
        if stop > RAMP_GRACE {
            return Err(ConfigurationError::Inconsistent(deceleration));
        }
    }
    Ok(())
}

/// A counter of 16 bits must not go half way round between two ticks, however late the second may
/// be.
fn check_counts(parameters: &Parameters) -> Result<(), ConfigurationError> {
    let rate = parameters.real(at::WHEEL_RATE_MAX) * parameters.real(at::GEAR_RATIO);
    for place in 0..4 {
        let counts = encoder_counts(parameters, place) / core::f32::consts::TAU;
        if rate * counts * LATEST_TICK >= f32::from(i16::MAX) {
            let own = wheel::encoder_counts(place);
            let own_counts = parameters.real(own) > 0.0;
            let at = if own_counts { own } else { at::ENCODER_COUNTS };
            return Err(ConfigurationError::Inconsistent(at));
        }
    }
    Ok(())
}

/// A wheel needs something that makes it follow.
fn check_gains(parameters: &Parameters) -> Result<(), ConfigurationError> {
    let real = |address| parameters.real(address);
    for wheel in 0..4 {
        let gains = [
            motor::speed(wheel),
            motor::proportional(wheel),
            motor::integral(wheel),
        ];
        if gains.into_iter().all(|gain| real(gain) == 0.0) {
            return Err(ConfigurationError::Inconsistent(motor::proportional(wheel)));
        }
    }
    Ok(())
}

/// The control tick has numbers for all of these. In single precision it has them for whatever the
/// table accepts (docs/numbers.md).
fn check_quantities(parameters: &Parameters) -> Result<(), ConfigurationError> {
    for wheel in 0..4 {
        if !AccelerationGain::holds(parameters.real(motor::acceleration(wheel))) {
            return Err(ConfigurationError::Inconsistent(motor::acceleration(wheel)));
        }
        let counts = encoder_counts(parameters, wheel) * parameters.real(at::GEAR_RATIO);
        if !Angle::holds(core::f32::consts::TAU / counts) {
            return Err(ConfigurationError::Inconsistent(at::GEAR_RATIO));
        }
    }
    Ok(())
}

/// The nominal supply lies between its bounds, and what the input can show reaches to the upper
/// one.
fn check_supply(parameters: &Parameters) -> Result<(), ConfigurationError> {
    let real = |address| parameters.real(address);
    let (nominal, maximum) = (real(at::SUPPLY_NOMINAL), real(at::SUPPLY_MAXIMUM));
    let bad = |address| Err(ConfigurationError::Inconsistent(address));
    if real(at::SUPPLY_MINIMUM) >= nominal {
        return bad(at::SUPPLY_MINIMUM);
    }
    if maximum > 0.0 && maximum <= nominal {
        return bad(at::SUPPLY_MAXIMUM);
    }
    let highest = FULL_SCALE * real(at::SUPPLY_DIVIDER);
    let measured = real(at::SUPPLY_MINIMUM) > 0.0;
    if measured && (highest <= nominal || highest <= maximum) {
        return bad(at::SUPPLY_DIVIDER);
    }
    Ok(())
}

/// A torque bound needs both of its parameters, and has to be enough to turn every wheel.
fn check_torque(parameters: &Parameters) -> Result<(), ConfigurationError> {
    let given = |address| parameters.real(address) > 0.0;
    if given(at::CURRENT_MAX) && !given(at::WINDING_RESISTANCE) {
        return Err(ConfigurationError::Inconsistent(at::WINDING_RESISTANCE));
    }
    let bound = torque(parameters);
    let turns = (0..4).all(|wheel| parameters.real(motor::static_friction(wheel)) < bound);
    if given(at::WINDING_RESISTANCE) && !given(at::CURRENT_MAX) || !turns {
        return Err(ConfigurationError::Inconsistent(at::CURRENT_MAX));
    }
    Ok(())
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
        torque: torque(parameters),
    }
}
