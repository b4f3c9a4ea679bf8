//! How each cause is injected, or why it is not.
//!
//! A cause acts on the robot from outside, not inside its program, which is the shipped image.
//! Robots are numbered by their position: number 0 is watched; where the cause is in another
//! member, that is number 2.

use canopen::Frame;
use group::StageKind;
use kinematics::Twist;
use protocol::{Fault, address as at, cob};
use sim::smart_drive::DriveChange;
use sim::test_master::TestMaster;
use sim::{Crash, EncoderState, SimError};

use crate::firmware::Board;

/// The robot that is watched.
pub const WATCHED: usize = 0;
/// Its node number.
const WATCHED_NODE: u8 = 2;
/// The member that fails.
const OTHER: usize = 2;
/// Speed ahead, m/s, unless a case has its own.
pub const SPEED: f32 = 0.6;
/// The wheel that fails.
const WHEEL: usize = 0;

/// What drags at a blocked wheel, N·m: half of the motor's torque at rest. One that is held fast
/// cannot be distinguished from a dead encoder.
const DRAG: f64 = 32.0;

/// Supply at which it is too low, V; the robots have 24 V otherwise, and 18 V as their minimum.
const LOW_SUPPLY: f64 = 17.0;
/// Supply that is too high for a maximum of 30 V, V.
const HIGH_SUPPLY: f64 = 32.0;
/// A current that the driver does not bear, A: less than the 1.4 A with which the motors overcome
/// friction.
const TRIPS_AT: f64 = 1.0;
/// After the supply has changed the duty does, for the same voltage at the motors; ms until it has.
const SUPPLY_SETTLES_MS: u64 = 30;

/// What is done about a cause.
#[derive(Clone, Copy)]
pub enum Procedure {
    /// It appears at a word.
    Now(fn(&mut TestMaster)),
    /// It takes some time to bring about, and appears when this is done.
    After(fn(&mut TestMaster) -> Result<(), SimError>),
    /// It concerns what is stored, and is tried with one board: see [`super::power`].
    Stored(super::power::Procedure),
}

impl Procedure {
    /// Brings the cause about.
    ///
    /// # Errors
    /// When a robot stops, or cannot be made to.
    pub fn appear(self, master: &mut TestMaster) -> Result<(), SimError> {
        match self {
            Self::Now(appear) => appear(master),
            Self::After(appear) => appear(master)?,
            Self::Stored(_) => {}
        }
        Ok(())
    }
}

/// What turns the wheels of the robots that a cause can happen to.
#[derive(Clone, Copy)]
pub enum Drives {
    /// Whatever does.
    Any,
    /// Bridges.
    Bridges,
    /// Bridges with one PWM each, whose enable a timer cuts.
    OnePwm,
    /// Bridges with two PWMs each, whose enable the program cuts.
    TwoPwms,
    /// Smart drives.
    Smart,
}

impl Drives {
    /// Whether robots of this kind are among them.
    pub const fn concern(self, kind: StageKind) -> bool {
        let smart = kind.drive_current().is_some();
        match self {
            Self::Any => true,
            Self::Bridges => !smart,
            Self::OnePwm => !smart && !kind.has_two_pwms(),
            Self::TwoPwms => kind.has_two_pwms(),
            Self::Smart => smart,
        }
    }
}

/// One trial.
#[derive(Clone, Copy)]
pub struct Case {
    /// Number of the cause in `docs/safety.md`.
    pub number: u8,
    /// The way in which it is brought about, where that is not all that could be meant.
    pub variant: &'static str,
    /// How.
    pub procedure: Procedure,
    /// What is announced, if not the fault of the page.
    pub announced: Option<Fault>,
    /// Time for which the duty is ignored, ms: the cause itself changes it.
    pub settles_ms: u64,
    /// Speed of the group, m/s.
    pub speed: f32,
    /// What is promised at this speed, ms, if not the time of the page's table.
    pub millis: Option<f64>,
    /// The largest ratio of a wheel rate to what was asked at this speed, if not that of the page's
    /// table.
    pub wheel_rate: Option<f64>,
    /// The robots that it can happen to.
    pub drives: Drives,
    /// The boards that it can happen to.
    pub boards: fn(Board) -> bool,
    /// Not for a pair with another.
    pub alone: bool,
    /// What is done before the start.
    pub prepare: Option<fn(&mut TestMaster)>,
}

impl Case {
    const fn new(number: u8, variant: &'static str, procedure: Procedure) -> Self {
        Self {
            number,
            variant,
            procedure,
            announced: None,
            settles_ms: 0,
            speed: SPEED,
            millis: None,
            wheel_rate: None,
            drives: Drives::Any,
            boards: |_| true,
            alone: false,
            prepare: None,
        }
    }

    /// The same, where bridges turn the wheels: of their encoders, drivers or current sensors.
    const fn of_bridges(self) -> Self {
        Self {
            drives: Drives::Bridges,
            ..self
        }
    }

    /// The same, on these boards.
    const fn on(self, boards: fn(Board) -> bool) -> Self {
        Self { boards, ..self }
    }

    /// The same, where smart drives turn the wheels.
    const fn of_smart_drives(self) -> Self {
        Self {
            drives: Drives::Smart,
            alone: true,
            ..self
        }
    }
}

const fn now(number: u8, variant: &'static str, appear: fn(&mut TestMaster)) -> Case {
    Case::new(number, variant, Procedure::Now(appear))
}

const fn after(
    number: u8,
    variant: &'static str,
    appear: fn(&mut TestMaster) -> Result<(), SimError>,
) -> Case {
    Case::new(number, variant, Procedure::After(appear))
}

const fn stored(number: u8, variant: &'static str, procedure: super::power::Procedure) -> Case {
    Case::new(number, variant, Procedure::Stored(procedure))
}

/// An emergency stop without a program that could follow it.
const fn stopped_while_halted(variant: &'static str) -> Case {
    Case {
        announced: Some(Fault::WatchdogReset),
        ..now(15, variant, |master| {
            master.world.halt(WATCHED, true);
            master.world.set_emergency_stop(WATCHED, true);
        })
    }
}

/// An encoder that counts backwards from now on.
fn reversed(master: &mut TestMaster) {
    master
        .world
        .set_encoder(WATCHED, WHEEL, EncoderState::Reversed);
}

/// The same at a low speed, m/s, with what is promised there: ms, and the wheel rate over what was
/// asked.
const fn slow_reversed(variant: &'static str, speed: f32, millis: f64, rate: f64) -> Case {
    Case {
        alone: true,
        speed,
        millis: Some(millis),
        wheel_rate: Some(rate),
        ..now(12, variant, reversed).of_bridges()
    }
}

/// The identifiers of another wheel's smart drive and of none.
const OTHER_DRIVE: u8 = 4;
const NO_WHEEL: u8 = 7;
/// A degree more than a motor behind a smart drive may have by default.
const HOT: u8 = 81;

/// Something happens to the smart drive of the wheel, in motion.
const fn on_drive(number: u8, variant: &'static str, appear: fn(&mut TestMaster)) -> Case {
    now(number, variant, appear).of_smart_drives()
}

/// The smart drive of the wheel is changed.
fn change_drive(master: &mut TestMaster, change: DriveChange) {
    master.world.set_smart_drive(WATCHED, WHEEL, change);
}

/// The current sensor of cause 32: A/V, and V at no current.
const CURRENT_SENSOR: (f64, f64) = (160.0, 1.65);

/// All of them, by number.
pub const CASES: &[Case] = &[
    now(1, "", |master| master.heartbeat = false),
    now(2, "", |master| master.sync = false),
    now(3, "", |master| master.twist = None),
    now(4, "", |master| master.world.set_connected(OTHER, false)),
    now(5, "", |master| master.world.set_emergency_stop(OTHER, true)),
    now(6, "", |master| {
        master.world.set_misses(OTHER, Some(cob::GROUP_TWIST));
    }),
    now(7, "", |master| master.second = true),
    now(8, "NaN", |master| {
        master.twist = Some(Twist::new(f32::NAN, 0.0, 0.0));
    }),
    // All that a field can carry is within its range, but for this one value.
    now(8, "vy is -32768, out of range", |master| {
        master.twist = Some(Twist::new(0.6, f32::NAN, 0.0));
    }),
    now(8, "stale sequence", |master| master.counts = false),
    after(9, "", bus_off),
    now(10, "", |master| master.world.overrun(WATCHED)),
    now(11, "", |master| {
        master.world.set_encoder(WATCHED, WHEEL, EncoderState::Dead);
    })
    .of_bridges(),
    Case {
        alone: true,
        ..now(11, "channel B open", |master| {
            let open = EncoderState::Floats;
            master.world.set_encoder(WATCHED, WHEEL, open);
        })
        .of_bridges()
    },
    // The same with so many stray counts a second, and slowly: what the page's text promises.
    Case {
        alone: true,
        ..now(11, "15 stray counts a second", |master| {
            dead_and_noisy(master, 15.0)
        })
        .of_bridges()
    },
    Case {
        alone: true,
        speed: 0.3,
        ..now(11, "0.3 m/s, 15 stray counts a second", |master| {
            dead_and_noisy(master, 15.0);
        })
        .of_bridges()
    },
    Case {
        alone: true,
        speed: 0.1,
        millis: Some(300.0),
        ..now(11, "0.1 m/s, 15 stray counts a second", |master| {
            dead_and_noisy(master, 15.0);
        })
        .of_bridges()
    },
    now(12, "", reversed).of_bridges(),
    // At a crawl: what the second table of the page promises, 0.66, 0.2 and 0.1 rad/s.
    slow_reversed("0.1 m/s", 0.1, 90.0, 2.0),
    slow_reversed("0.031 m/s", 0.031, 90.0, 2.0),
    slow_reversed("0.0155 m/s", 0.0155, 150.0, 3.0),
    now(13, "turns hardly", |master| {
        master.world.set_wheel_drag(WATCHED, WHEEL, DRAG);
    }),
    now(14, "", |master| {
        master.world.set_driver_fault(WATCHED, true)
    }),
    Case {
        alone: true,
        ..now(14, "trips at a current", |master| {
            master.world.set_driver_trip(WATCHED, Some(TRIPS_AT));
        })
        .of_bridges()
    },
    now(15, "", |master| {
        master.world.set_emergency_stop(WATCHED, true)
    }),
    // The break inputs of the timers have to cut alone. The watchdog then resets the robot, which
    // announces that.
    Case {
        drives: Drives::OnePwm,
        ..stopped_while_halted("processor halted")
    },
    // The brake waits for the watchdog; both PWMs are low at once (tests/output_stages.rs).
    Case {
        drives: Drives::TwoPwms,
        millis: Some(100.0),
        alone: true,
        ..stopped_while_halted("processor halted: until the brake is engaged")
    },
    Case {
        settles_ms: SUPPLY_SETTLES_MS,
        ..now(16, "", |master| {
            master.world.set_supply(WATCHED, LOW_SUPPLY)
        })
    },
    after(17, "", late).of_bridges(),
    // What the drives reported meanwhile is lost, and with it the angles of the wheels.
    Case {
        announced: Some(Fault::DriveSilent),
        ..after(17, "", late).of_smart_drives()
    },
    after(18, "loops for ever", |master| crash(master, Crash::Loop)),
    now(19, "HardFault", |master| {
        _ = master.world.crash(WATCHED, Crash::Nowhere);
    }),
    after(19, "panic", |master| crash(master, Crash::Panic)),
    after(19, "stack overflow", |master| {
        crash(master, Crash::StackOverflow)
    }),
    now(20, "processor halted", |master| {
        _ = master.world.halt(WATCHED, true);
    }),
    stored(21, "in any of its operations", super::power::interrupted),
    stored(22, "a value out of its limits", super::power::corrupt),
    Case {
        settles_ms: SUPPLY_SETTLES_MS,
        ..now(26, "", |master| {
            master.world.set_supply(WATCHED, HIGH_SUPPLY)
        })
    },
    after(27, "another twist understood", another_twist),
    // Another robot switched on whose node switches are set to the same number.
    after(28, "boot-up", boot_up),
    Case {
        prepare: Some(connect_current_sensor),
        ..now(32, "its wire comes off, the input is pulled up", |master| {
            let (scale, _) = CURRENT_SENSOR;
            master.world.set_current_sensor(WATCHED, Some((scale, 3.3)));
        })
        .of_bridges()
        // The kit has no input for a sensor.
        .on(|board| board != Board::KitF103rc)
    },
    Case {
        prepare: Some(connect_protective_stop),
        ..now(29, "", |master| {
            master.world.set_protective_stop(WATCHED, true)
        })
    },
    now(30, "a gap", |master| {
        on_board(master, |board| {
            board.set_hse(false);
            board.set_hse(true);
        });
    }),
    now(31, "a dip to 2.9 V", |master| {
        on_board(master, |board| {
            board.set_vdd(2.9);
            board.set_vdd(3.3);
        });
    })
    .on(|board| board != Board::KitF103rc),
    // An STM32F1's detector is set 0.15 V lower at most.
    now(31, "a dip to 2.7 V", |master| {
        on_board(master, |board| {
            board.set_vdd(2.7);
            board.set_vdd(3.3);
        });
    })
    .on(|board| board == Board::KitF103rc),
    on_drive(35, "", |master| {
        change_drive(master, DriveChange::Temperature(HOT))
    }),
    on_drive(36, "", |master| {
        change_drive(master, DriveChange::Power(false))
    }),
    // It hears no command any more: its own timeout counts, the robot's others have no current at
    // once (tests/smart_drives.rs).
    Case {
        millis: Some(100.0),
        ..on_drive(37, "in motion, that drive itself", |master| {
            change_drive(master, DriveChange::Identifier(NO_WHEEL));
        })
    },
    // It is silent under its own identifier before it has doubled the other.
    Case {
        announced: Some(Fault::DriveSilent),
        millis: Some(5.0),
        ..on_drive(38, "in motion", |master| {
            change_drive(master, DriveChange::Identifier(OTHER_DRIVE));
        })
    },
];

/// Rows of the page of which nothing is tried here, because they promise no time, and where they
/// are tried.
#[cfg(test)]
pub const ELSEWHERE: &[(u8, &str)] = &[
    (23, "refuses a start: robot/src/tests/start.rs"),
    (24, "a threshold: robot/src/tests/safety.rs"),
    (25, "a threshold: tests/group_rules.rs"),
    (34, "refuses a start: robot/src/tests/interlock.rs"),
];

/// Does something to the watched robot's board.
fn on_board(master: &mut TestMaster, what: fn(&mut emulator::Board)) {
    if let Some(board) = master.world.board(WATCHED_NODE) {
        what(board);
    }
}

/// Says to the watched robot that a protective stop is connected.
fn connect_protective_stop(master: &mut TestMaster) {
    let [low, high] = at::PROTECTIVE_STOP.index.to_le_bytes();
    let write = [0x2F, low, high, at::PROTECTIVE_STOP.sub, 1, 0, 0, 0];
    master
        .world
        .send(Frame::of(cob::sdo_request(WATCHED_NODE), write));
}

/// Gives the watched robot a current sensor of 160 A/V about 1.65 V, and says so.
fn connect_current_sensor(master: &mut TestMaster) {
    master
        .world
        .set_current_sensor(WATCHED, Some(CURRENT_SENSOR));
    let (scale, offset) = CURRENT_SENSOR;
    for (address, value) in [(at::CURRENT_SCALE, scale), (at::CURRENT_OFFSET, offset)] {
        let [low, high] = address.index.to_le_bytes();
        let [a, b, c, d] = (value as f32).to_le_bytes();
        let write = [0x23, low, high, address.sub, a, b, c, d];
        master
            .world
            .send(Frame::of(cob::sdo_request(WATCHED_NODE), write));
    }
}

/// One member misses a setpoint and receives a different one instead, with the same sequence. The
/// time counts from the SYNC that latches both.
fn another_twist(master: &mut TestMaster) -> Result<(), SimError> {
    const PERIOD_MS: u64 = 10;
    let others = [WATCHED, WATCHED + 1];
    // The regular one goes out 2 ms before SYNC.
    master.run_to_phase(PERIOD_MS, PERIOD_MS - 3)?;
    master.world.set_misses(OTHER, Some(cob::GROUP_TWIST));
    master.run(2)?;
    master.world.set_misses(OTHER, None);
    for other in others {
        master.world.set_misses(other, Some(cob::GROUP_TWIST));
    }
    master.send_setpoint(Twist::new(0.5, 0.0, 0.0), 0);
    master.run(1)?;
    for other in others {
        master.world.set_misses(other, None);
    }
    Ok(())
}

/// A boot-up with the watched robot's number, while the bus is idle; the time counts from its end.
fn boot_up(master: &mut TestMaster) -> Result<(), SimError> {
    const IDLE_MS: u64 = 5;
    const FRAME_US: u64 = 80;
    master.run(IDLE_MS)?;
    let boot_up = Frame::of(cob::heartbeat(WATCHED_NODE), [0]);
    master.world.send(boot_up);
    let end = master.world.now().0 + FRAME_US;
    master.world.run_until(canopen::Micros(end))
}

/// An encoder whose wires are open, with so many strikes of noise a second on them.
fn dead_and_noisy(master: &mut TestMaster, hz: f64) {
    master.world.set_encoder(WATCHED, WHEEL, EncoderState::Dead);
    master.world.set_encoder_noise(WATCHED, WHEEL, hz);
}

/// The program goes wrong as soon as it is where it can.
fn crash(master: &mut TestMaster, how: Crash) -> Result<(), SimError> {
    const PATIENCE_US: u64 = 100_000;
    let begun = master.world.now().0;
    while !master.world.crash(WATCHED, how) {
        let now = master.world.now().0;
        if now > begun + PATIENCE_US {
            let problem = format!("the image has no place for {how:?}");
            return Err(SimError::Plant { problem });
        }
        master.world.run_until(canopen::Micros(now + 10))?;
    }
    Ok(())
}

/// A robot goes off the bus with its next frame.
fn bus_off(master: &mut TestMaster) -> Result<(), SimError> {
    const PATIENCE_US: u64 = 1_000_000;
    let begun = master.world.now().0;
    while !master.world.force_bus_off(WATCHED) {
        if master.world.now().0 > begun + PATIENCE_US {
            let problem = "the robot has nothing to send".to_owned();
            return Err(SimError::Plant { problem });
        }
        let soon = canopen::Micros(master.world.now().0 + 10);
        master.world.run_until(soon)?;
    }
    Ok(())
}

/// The processor stands still a little longer than a control tick may be late; the time counts from
/// its going on.
fn late(master: &mut TestMaster) -> Result<(), SimError> {
    const STANDS_MS: u64 = 22;
    master.world.halt(WATCHED, true);
    master.run(STANDS_MS)?;
    master.world.halt(WATCHED, false);
    Ok(())
}
