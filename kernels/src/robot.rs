//! Whole control ticks of a robot that drives: with ideal wheels, with every table of a
//! compensation, and by the phase of the rollers.
//!
//! The robot accelerates in all three axes at once and its encoders follow exactly, so every part
//! of the tick works and no limit or suspicion takes a part of it away.

use core::f32::consts::{FRAC_PI_4, TAU};

use control::brake::BrakeTimes;
use control::configuration::{Configuration, Thresholds, Times, WheelConfiguration};
use control::drivetrain::{Contact, Drivetrain};
use control::interface::{Command, Inputs, Mode, Outputs};
use control::limiter::ChangeLimits;
use control::output_stage::OutputStage;
use control::quantity::{Divider, InputVoltage, Rate, Ratio, Voltage};
use control::rollers::{IndexPulse, RollerConfiguration, RollerWheel, Rolling};
use control::smart_drive::DriveConfiguration;
use control::supply::SupplyConfiguration;
use control::tick::ControlSide;
use control::time::{Micros, TICK_US};
use control::wheel::Gains;
use control::wheel_drive::MotorLimits;
use kinematics::{
    AxisTable, DirectionalCompensation, FourWheelGeometry, Mount, Pose, Twist, VelocityCompensation,
};

/// Ticks that are counted, after as many in which the index passes and the robot starts.
const TICKS: u16 = 64;
/// Counts of a turn of a wheel.
const COUNTS: u16 = 4096;

#[inline(never)]
fn tick(side: &mut ControlSide, now: Micros, given: &(Command, Inputs), out: &mut Outputs) {
    *out = side.tick(now, &given.0, &given.1);
}

#[inline(never)]
fn tick_phase(side: &mut ControlSide, now: Micros, given: &(Command, Inputs), out: &mut Outputs) {
    // Not the same function as the one above.
    core::hint::black_box(());
    *out = side.tick(now, &given.0, &given.1);
}

#[inline(never)]
fn tick_tables(side: &mut ControlSide, now: Micros, given: &(Command, Inputs), out: &mut Outputs) {
    // Nor this one.
    core::hint::black_box(0_u8);
    *out = side.tick(now, &given.0, &given.1);
}

/// What a tick runs in: one that is not counted, or one of those above.
type Run = fn(&mut ControlSide, Micros, &(Command, Inputs), &mut Outputs);

/// Drives the three robots.
pub fn run() -> Option<()> {
    drive(&configuration(false, false)?, tick)?;
    drive(&configuration(false, true)?, tick_tables)?;
    drive(&configuration(true, false)?, tick_phase)
}

/// What a calibration writes.
fn tables() -> Option<DirectionalCompensation<3, 3, 2, 2>> {
    let axis = |rows| AxisTable::<3>::new(rows).ok();
    let two = |rows| AxisTable::<2>::new(rows).ok();
    DirectionalCompensation::new(
        axis(&[(0.1, 1.012), (0.25, 1.011), (0.5, 1.013)])?,
        axis(&[(0.1, 1.086), (0.25, 1.088), (0.5, 1.091)])?,
        two(&[(0.1, 1.048), (0.5, 1.052)])?,
        two(&[(0.1, 1.049), (0.5, 1.053)])?,
        two(&[(0.25, 1.022), (0.5, 1.024)])?,
    )
    .ok()
}

fn uncounted(
    side: &mut ControlSide,
    now: Micros,
    (command, inputs): &(Command, Inputs),
    out: &mut Outputs,
) {
    *out = side.tick(now, command, inputs);
}

/// Drives one robot; `None` where it does not move.
fn drive(configuration: &Configuration, counted: Run) -> Option<()> {
    let mut side = ControlSide::new();
    side.configure(configuration);
    let (mut turns, mut outputs) = ([0.0_f32; 4], Outputs::SAFE);
    for number in 0..2 * TICKS {
        let now = Micros(u64::from(number) * u64::from(TICK_US));
        let counts = turns.map(|turn| ((turn * f32::from(COUNTS)) as i32) as u16);
        let given = given(configuration.crc, number, now, counts);
        let run = if number < TICKS { uncounted } else { counted };
        run(core::hint::black_box(&mut side), now, &given, &mut outputs);
        let rates: [f32; 4] = side.report().rates_ref().into();
        for (turn, rate) in turns.iter_mut().zip(rates) {
            *turn += rate * (TICK_US as f32 * 1e-6 / TAU);
        }
    }
    (outputs.drivers_enabled && outputs.drive != Outputs::SAFE.drive).then_some(())
}

/// Command and inputs of one tick: a new setpoint every ten, and an index pulse after the first.
fn given(crc: u32, number: u16, now: Micros, counts: [u16; 4]) -> (Command, Inputs) {
    let update = number / 10;
    let size = 0.02 * f32::from(update);
    let command = Command {
        mode: Mode::Follow,
        twist_cmd: Twist::new(size, 0.5 * size, 0.3 * size),
        update,
        at: Micros(u64::from(update) * 10 * u64::from(TICK_US)),
        configuration: crc,
        alive: now,
        ..Command::NONE
    };
    let pulse = IndexPulse {
        number: u8::from(number > 0),
        count: 0,
    };
    let inputs = Inputs {
        encoder_counts: counts,
        supply_input: Some(const { InputVoltage::new(24.0 / 11.0) }),
        index: Some([pulse; 4]),
        ..Inputs::default()
    };
    (command, inputs)
}

/// A robot as heavy as the paper's; `phase` says whether its rollers are known,
/// `has_tables` whether its compensation depends on the motion.
fn configuration(phase: bool, has_tables: bool) -> Option<Configuration> {
    let geometry = FourWheelGeometry::new(0.370, 0.350, 0.1524, FRAC_PI_4).ok()?;
    let mount = Mount::new(Pose::new(1.2, -0.4, 0.3)).ok()?;
    let compensation = VelocityCompensation::new(1.002, 1.033, 1.0195).ok()?;
    let roller = RollerWheel::new(8, 0.0, f32::from(COUNTS)).ok()?;
    let rollers = RollerConfiguration::new([roller; 4], true, 8);
    let contact = if phase {
        Contact::Rolling(Rolling::new(&geometry, &rollers).ok()?)
    } else {
        Contact::Ideal
    };
    let wheels = &geometry.wheels().ok()?;
    let mut drivetrain = Drivetrain::new(wheels, mount, &compensation, &contact).ok()?;
    if has_tables {
        drivetrain.compensation_mut().sample_directions(&tables()?);
    }
    let wheel = WheelConfiguration {
        step: TAU / f32::from(COUNTS),
        motor_sign: 1.0,
        gains: Gains {
            static_friction: 0.4,
            speed: 0.8,
            acceleration: 0.15,
            proportional: 1.0,
            integral: 10.0,
        },
        torque: 12.0,
    };
    Some(Configuration {
        crc: 1,
        check: 1,
        group: 1,
        members: 2,
        standstill_syncs: 0,
        protective_stop: false,
        cuts_together: false,
        drivetrain,
        encoder_filter: 0,
        mount,
        wheel_rate_max: 30.0,
        speed_max: f32::INFINITY,
        yaw_rate_max: f32::INFINITY,
        follow: ChangeLimits::new(2.4, 4.0, 100.0, 100.0),
        ramp: ChangeLimits::new(2.4, 4.0, 100.0, 100.0),
        wheels: [wheel; 4],
        observer_bandwidth: 100.0,
        supply: SUPPLY,
        current: None,
        pwm_hz: 20_000,
        output_stage: OutputStage::PwmDirection,
        direction_pause: false,
        brake: BrakeTimes::default(),
        thresholds: THRESHOLDS,
        times: TIMES,
        drives: DriveConfiguration::DEFAULT,
        motors: MotorLimits::new(0.3, 40.0, 0.0),
    })
}

const SUPPLY: SupplyConfiguration = SupplyConfiguration {
    nominal: Voltage::new(24.0),
    minimum: Voltage::new(18.0),
    maximum: Voltage::new(30.0),
    margin: Voltage::new(1.0),
    divider: Divider::new(11.0),
    duty_max: Ratio::new(1.0),
};

const THRESHOLDS: Thresholds = Thresholds {
    slip_limit: Rate::new(1.0),
    slip_fault: Rate::new(2.5),
    strain_limit: Rate::new(0.05),
    strain_fault: Rate::new(0.3),
    blocked_rate: Rate::new(2.0),
};

const TIMES: Times = Times {
    sync_period_us: 10_000,
    agreement_delay_us: 2_000,
    sync_timeout_us: 25_000,
    setpoint_timeout_us: 100_000,
    heartbeat_timeout_us: 1_000_000,
    wheel_fault_us: 200_000,
};
