//! Levels 2 and 3 of the acceptance, with simulated robots.

use acceptance::report::{Count, line};
use acceptance::{Check, Outcome};
use group::GroupFile;
use kinematics::{Pose, VelocityCompensation};
use omnibus::abort::Abort;
use omnibus::accept::floor::{Errors, Floor, level_three};
use omnibus::accept::hand::{Hand, Prepared, Task};
use omnibus::accept::{AcceptError, Options, Step, level_two, names};
use omnibus::error::MasterError;
use omnibus::path::course::Course;
use omnibus::path::curve::Curve;
use omnibus::run::{Drive, DriveError};
use omnibus::session::Group;
use omnibus::simulation::hand::Injection;
use omnibus::simulation::link::SimLink;
use omnibus::simulation::run::{simulated, world};
use protocol::{Value, address};

fn file() -> GroupFile {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-2.toml");
    GroupFile::load(path).unwrap()
}

fn options() -> Options {
    Options {
        watched: 2,
        speed: 0.3,
        skip: Vec::new(),
    }
}

fn session(file: &GroupFile) -> Group<SimLink> {
    let world = world(file, None, Pose::new(0.0, 0.0, 0.0)).unwrap();
    Group::connect(SimLink::new(world, "sim"), file).unwrap()
}

fn outcome(checks: &[Check], outcome: Outcome) -> Vec<&str> {
    let chosen = checks.iter().filter(|check| check.outcome() == outcome);
    chosen.map(|check| check.name.as_str()).collect()
}

#[test]
fn simulated_robots_keep_every_promise_of_level_two() {
    let file = file();
    let mut session = session(&file);
    // What the group file does not say, so that these causes are tried as well.
    for (at, value) in [
        (address::SUPPLY_MINIMUM, Value::F32(18.0)),
        (address::SUPPLY_MAXIMUM, Value::F32(30.0)),
        (address::PROTECTIVE_STOP, Value::U8(1)),
    ] {
        session.wire().write(2, at, value).unwrap();
    }
    let checks = level_two(&mut session, &mut Injection, &options(), &mut |_| {}).unwrap();
    for check in &checks {
        println!("{}", line(check));
    }
    assert_eq!(outcome(&checks, Outcome::Missed), [""; 0]);
    let count = Count::of(&checks);
    assert!(count.kept > 50, "{count}");
}

/// The same with the release image, and the figures that reports of robots have beside theirs.
#[test]
#[cfg(feature = "elf")]
fn emulated_robots_keep_every_promise_of_level_two() {
    let image = std::env::var("OMNIBUS_ELF").expect("OMNIBUS_ELF names the image");
    let file = file();
    let origin = Pose::new(0.0, 0.0, 0.0);
    let world = world(&file, Some(image.as_ref()), origin).unwrap();
    let mut session = Group::connect(SimLink::new(world, "sim"), &file).unwrap();
    let mut checks = level_two(&mut session, &mut Injection, &options(), &mut |_| {}).unwrap();
    assert_eq!(outcome(&checks, Outcome::Missed), [""; 0]);
    // `omnibus accept --level 2 --backend emulator --report` rewrites it.
    let known = include_str!("../../acceptance/emulated/level-2.json");
    acceptance::report::expect(&mut checks, &serde_json::from_str(known).unwrap());
    let lacks = |check: &&Check| check.measured.is_some() != check.expected.is_some();
    let lacking: Vec<_> = checks
        .iter()
        .filter(lacks)
        .map(|check| &check.name)
        .collect();
    assert!(lacking.is_empty(), "{lacking:?}");
}

/// Hands that do what they are asked for in their own way.
struct Clumsy {
    /// Does it this much later than it says, µs.
    late_us: u64,
    /// To this robot instead.
    instead: Option<u8>,
    /// Wishes to stop in the n-th of its moments.
    stop: Option<(Abort, u32)>,
}

impl Clumsy {
    fn moment(&mut self) {
        if let Some((abort, left)) = &mut self.stop {
            *left = left.saturating_sub(1);
            if *left == 0 {
                abort.ask();
            }
        }
    }
}

impl Hand<SimLink> for Clumsy {
    fn prepare(&mut self, _: &mut Group<SimLink>, _: Task) -> Result<Prepared, MasterError> {
        self.moment();
        Ok(Prepared::Ready)
    }

    fn act(&mut self, group: &mut Group<SimLink>, task: Task) -> Option<omnibus::canopen::Micros> {
        self.moment();
        let before = group.link().world.now();
        if self.late_us > 0 {
            // SYNC and setpoints go on by themselves only in cycles.
            let cycles = self.late_us / 10_000;
            for _ in 0..cycles {
                let _ = group.cycle(kinematics::Twist::new(0.3, 0.0, 0.0));
            }
        }
        let task = match (task, self.instead) {
            (Task::PressStop { .. }, Some(node)) => Task::PressStop { node },
            (task, _) => task,
        };
        Injection.act(group, task)?;
        Some(before)
    }

    fn undo(&mut self, group: &mut Group<SimLink>, task: Task) -> Result<(), MasterError> {
        self.moment();
        if let (Task::PressStop { .. }, Some(node)) = (task, self.instead) {
            return Injection.undo(group, Task::PressStop { node });
        }
        Injection.undo(group, task)
    }

    fn patience_us(&self) -> u64 {
        0
    }
}

const SKILLED: Clumsy = Clumsy {
    late_us: 0,
    instead: None,
    stop: None,
};

/// What is missed by robots that were given so, and by these hands.
fn missed(given: &[(protocol::Address, Value)], mut hand: Clumsy) -> Vec<String> {
    let file = file();
    let mut session = session(&file);
    for (at, value) in given {
        for node in [2, 3] {
            session.wire().write(node, *at, *value).unwrap();
        }
    }
    let checks = level_two(&mut session, &mut hand, &options(), &mut |_| {}).unwrap();
    let missed = outcome(&checks, Outcome::Missed).into_iter();
    missed.map(str::to_owned).collect()
}

/// Whatever is wrong with robots or hands is noticed by the check of that cause, and by no other.
#[test]
fn what_is_wrong_is_noticed_by_its_own_check() {
    let heartbeat = [(address::HEARTBEAT_TIMEOUT, Value::U16(600))];
    assert_eq!(missed(&heartbeat, SKILLED), ["fault.01.time"]);
    // Without the watch over the wheels neither a dead nor a reversed encoder is a fault.
    let unwatched = missed(&[(address::BLOCKED_RATE, Value::F32(0.0))], SKILLED);
    for check in ["fault.11.reaction", "fault.11.time", "fault.12.reaction"] {
        assert!(
            unwatched.iter().any(|name| name == check),
            "{check}: {unwatched:?}"
        );
    }
    let others = |name: &&String| !name.starts_with("fault.11") && !name.starts_with("fault.12");
    assert_eq!(unwatched.iter().find(others), None, "{unwatched:?}");
    // A member that cuts where the page has it ramp.
    let together = missed(&[(address::CUTS_TOGETHER, Value::U8(1))], SKILLED);
    assert_eq!(together, ["fault.05.reaction"]);
    let late = Clumsy {
        late_us: 30_000,
        ..SKILLED
    };
    let late = missed(&[], late);
    for check in ["fault.04.time", "fault.14.time", "fault.15.time"] {
        assert!(late.iter().any(|name| name == check), "{check}: {late:?}");
    }
    assert!(late.iter().all(|name| name.ends_with(".time")), "{late:?}");
    let elsewhere = Clumsy {
        instead: Some(3),
        ..SKILLED
    };
    let elsewhere = missed(&[], elsewhere);
    assert!(
        elsewhere.iter().any(|name| name == "fault.15.reaction"),
        "{elsewhere:?}"
    );
}

#[test]
fn a_dead_encoder_is_found_before_anything_else() {
    let file = file();
    let mut session = session(&file);
    let world = &mut session.link().world;
    world.set_encoder(1, 2, sim::EncoderState::Dead);
    let skip = vec!["fault".to_owned()];
    let options = Options { skip, ..options() };
    let checks = level_two(&mut session, &mut Injection, &options, &mut |_| {}).unwrap();
    assert_eq!(outcome(&checks, Outcome::Missed), ["wheels.3", "motors.3"]);
    let wheels = checks
        .iter()
        .find(|check| check.name == "wheels.3")
        .unwrap();
    assert_eq!(wheels.measured, Some(3.0));
    assert!(
        wheels.note.starts_with("rear left: no encoder counts"),
        "{}",
        wheels.note
    );
}

/// What is skipped is listed with its reason.
#[test]
fn what_is_left_out_is_not_tried_and_says_so() {
    let file = file();
    let mut session = session(&file);
    let skip = ["wheels", "motors.2", "fault"].map(str::to_owned).to_vec();
    let options = Options { skip, ..options() };
    let (mut shown, mut begun) = (0, Vec::new());
    let mut show = |step: Step<'_>| match step {
        Step::Found(checks) => shown = checks.len(),
        Step::Begins(what) => begun.push(what.to_owned()),
    };
    let checks = level_two(&mut session, &mut Injection, &options, &mut show).unwrap();
    assert_eq!(shown, checks.len(), "the report has what was shown");
    assert_eq!(begun, ["identifying the motors of node 3"]);
    for name in names(2, &[2, 3]) {
        let found = checks.iter().filter(|check| check.name == name);
        assert_eq!(found.count(), 1, "{name}");
    }
    assert_eq!(outcome(&checks, Outcome::Kept), ["motors.3"]);
    assert_eq!(outcome(&checks, Outcome::Missed), [""; 0]);
    assert!(
        checks
            .iter()
            .all(|check| check.tried || !check.note.is_empty())
    );
}

/// The others' fault is tried with the stop of one member, but it can be left out without.
#[test]
fn a_cause_that_is_tried_with_another_is_left_out_alone() {
    let file = file();
    let mut session = session(&file);
    let mut skip = names(2, &[2, 3]);
    skip.retain(|name| name != "fault.15");
    let options = Options { skip, ..options() };
    let mut begun = Vec::new();
    let mut show = |step: Step<'_>| {
        if let Step::Begins(what) = step {
            begun.push(what.to_owned());
        }
    };
    let checks = level_two(&mut session, &mut Injection, &options, &mut show).unwrap();
    assert_eq!(begun.len(), 1, "{begun:?}");
    assert!(begun[0].starts_with("15: "), "{begun:?}");
    let fifth = checks.iter().filter(|check| check.name.contains(".05"));
    let fifth: Vec<_> = fifth.map(|check| (&*check.name, &*check.note)).collect();
    assert_eq!(fifth, [("fault.05", "left out by --skip")]);
    let tried = checks.iter().filter(|check| check.tried);
    let others = tried.filter(|check| !check.name.starts_with("fault.15"));
    assert_eq!(others.count(), 0);
}

/// The robots stand with drivers off, and as they were configured.
fn assert_at_rest(session: &mut Group<SimLink>, why: &str) {
    let until = omnibus::canopen::Micros(session.link().world.now().0 + 1_000_000);
    session.listen(until).unwrap();
    for robot in session.link().world.truth().robots {
        let rates: [f64; 4] = robot.wheel_rates.into();
        assert!(
            rates.iter().all(|rate| rate.abs() < 0.01),
            "{why}: {rates:?}"
        );
        assert!(!robot.drivers_enabled, "{why}: drivers on");
    }
    // A plug that was pulled is put in again.
    session.link().world.set_connected(0, true);
    for node in [2, 3] {
        let wire = session.wire();
        let kind = protocol::Kind::U8;
        let reversed = wire.read(node, address::ENCODER_REVERSED, kind).unwrap();
        assert_eq!(reversed.to_bits(), 0, "{why}");
        let alone = wire.read(node, address::COMMISSIONING, kind).unwrap();
        assert_eq!(alone.to_bits(), 0, "{why}");
    }
}

#[test]
fn a_wish_to_stop_leaves_the_robots_standing_at_any_moment() {
    let file = file();
    let mut tried = 0;
    for moment in 1..200 {
        let mut session = session(&file);
        let abort = session.abort();
        let mut hand = Clumsy {
            stop: Some((abort.clone(), moment)),
            ..SKILLED
        };
        match level_two(&mut session, &mut hand, &options(), &mut |_| {}) {
            Err(AcceptError::Master(MasterError::Aborted)) => {}
            Ok(_) => break,
            Err(error) => panic!("{moment}: {error}"),
        }
        assert_at_rest(&mut session, &format!("moment {moment} of the hands"));
        tried += 1;
    }
    assert!(tried >= 9, "{tried} moments of hands");
    for step in 1..20 {
        let mut session = session(&file);
        let abort = session.abort();
        let mut given = 0;
        let mut show = |shown: Step<'_>| {
            given += usize::from(matches!(shown, Step::Begins(_)));
            if given == step {
                abort.ask();
            }
        };
        let ended = level_two(&mut session, &mut Injection, &options(), &mut show);
        if ended.is_ok() {
            assert!(step > 14, "{step} steps");
            break;
        }
        assert_at_rest(&mut session, &format!("step {step}"));
    }
}

/// A simulated floor, which may differ from the one that is predicted.
struct Simulated {
    real: GroupFile,
    predicted: GroupFile,
}

fn errors(group: &GroupFile, curve: Curve, compensation: bool) -> Result<Errors, DriveError> {
    let drive = Drive {
        group,
        course: Course::of(curve),
        feedback: None,
        compensation,
        elf: None,
        candump: None,
        log: None,
        abort: Abort::default(),
        record: None,
        index_search: None,
    };
    Ok(Errors::of(&simulated(&drive, &mut |_, _| {})?))
}

impl Floor for Simulated {
    fn drive(&mut self, curve: Curve, compensation: bool) -> Result<Errors, DriveError> {
        errors(&self.real, curve, compensation)
    }

    fn predict(&mut self, curve: Curve, compensation: bool) -> Result<Option<Errors>, DriveError> {
        errors(&self.predicted, curve, compensation).map(Some)
    }
}

#[test]
fn a_calibrated_group_keeps_level_three_and_another_does_not() {
    let mut floor = Simulated {
        real: file(),
        predicted: file(),
    };
    let checks = level_three(&mut floor, &[], &mut |_| {}).unwrap();
    for check in &checks {
        println!("{}", line(check));
        assert_eq!(check.measured, check.expected, "the same floor");
    }
    assert_eq!(outcome(&checks, Outcome::Kept).len(), 5);
    // A coefficient that is 1 % too large is a strafe that is 1 % too long.
    for robot in &mut floor.real.robots {
        let [ahead, aside, about] = [
            robot.compensation.longitudinal(),
            robot.compensation.lateral() * 1.01,
            robot.compensation.yaw(),
        ];
        robot.compensation = VelocityCompensation::new(ahead, aside, about).unwrap();
    }
    let skip = ["floor.turn".to_owned(), "floor.figure".to_owned()];
    let mut shown = 0;
    let mut show = |step: Step<'_>| {
        if let Step::Found(checks) = step {
            shown = checks.len();
        }
    };
    let checks = level_three(&mut floor, &skip, &mut show).unwrap();
    assert_eq!(shown, checks.len(), "the report has what was shown");
    let missed = outcome(&checks, Outcome::Missed);
    assert_eq!(missed, ["floor.strafe.aside"]);
    assert_eq!(
        outcome(&checks, Outcome::NotTried),
        [
            "floor.turn.turned",
            "floor.figure_eight.ahead",
            "floor.figure_eight.aside"
        ]
    );
}
