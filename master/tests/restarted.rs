//! A robot that is switched off and on in a session has the parameters of its flash, which may be
//! those of an older group file. The master configures it again before the group moves, and names
//! the restart where it ends something.

use canopen::{Frame, Micros};
use group::{GroupFile, Plant, Tables, parameters};
use kinematics::{FourWheelGeometry, Pose, Twist, VelocityCompensation};
use omnibus::bus::link::{Link, LinkError};
use omnibus::commission::calibrate::journal::{Journal, Step, What};
use omnibus::commission::calibrate::manoeuvre::Settings;
use omnibus::commission::calibrate::measure::Instrument;
use omnibus::commission::calibrate::{Calibration, calibrate};
use omnibus::commission::motors::{self, identify_motors};
use omnibus::commission::wheel_test::test_wheels;
use omnibus::error::MasterError;
use omnibus::session::Group;
use omnibus::simulation::{link::SimLink, run::world};
use protocol::{GroupTwist, Kind, address, cob};

/// The robot that restarts, and its place in the group file.
const NODE: u8 = 3;
const INDEX: usize = 1;
/// How long it is without power, in µs.
const OFF_US: u64 = 100_000;

/// Whether a frame of the master is the one at which the robot loses its power.
type Trigger = Box<dyn FnMut(&Frame) -> bool>;

/// A simulated bus on which a robot loses its power once.
struct Cycled {
    link: SimLink,
    trigger: Trigger,
    off: Option<Micros>,
}

impl Cycled {
    fn new(file: &GroupFile, trigger: impl FnMut(&Frame) -> bool + 'static) -> Self {
        let world = world(file, None, Pose::new(0.0, 0.0, 0.0)).unwrap();
        Self {
            link: SimLink::new(world, "sim"),
            trigger: Box::new(trigger),
            off: None,
        }
    }

    fn switch(&mut self) {
        let now = self.link.now();
        if self.off.is_some_and(|off| now.0 >= off.0 + OFF_US) {
            self.link.world.set_power(INDEX, true);
        }
    }
}

impl Link for Cycled {
    fn now(&self) -> Micros {
        self.link.now()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), LinkError> {
        if self.off.is_none() && (self.trigger)(frame) {
            self.off = Some(self.link.now());
            self.link.world.set_power(INDEX, false);
        }
        self.switch();
        self.link.send(frame)
    }

    fn receive(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, LinkError> {
        self.switch();
        self.link.receive(until)
    }
}

fn file() -> GroupFile {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-2.toml");
    GroupFile::load(path).unwrap()
}

/// An older file of the same robots: larger wheels, and 30 % more sideways.
fn older(file: &GroupFile) -> GroupFile {
    let mut older = file.clone();
    for robot in &mut older.robots {
        let g = robot.geometry;
        let [track, base] = [g.half_track(), g.half_wheelbase()];
        robot.geometry = FourWheelGeometry::new(track, base, 0.12, g.roller_angle()).unwrap();
        robot.compensation = VelocityCompensation::new(1.0, 1.3, 1.0).unwrap();
    }
    older
}

/// Saves a file in the flash of all robots.
fn save<L: Link>(link: &mut L, file: &GroupFile) {
    let mut group = Group::connect(link, file).unwrap();
    group.configure(true).unwrap();
    for robot in &file.robots {
        group.wire().save(robot.node).unwrap();
    }
}

fn listen<L: Link>(group: &mut Group<L>, us: u64) {
    let until = Micros(group.wire().now().0 + us);
    group.listen(until).unwrap();
}

/// The robots hold every value of the file.
fn assert_configured<L: Link>(group: &mut Group<L>, compensation: bool) {
    let file = group.config().clone();
    for robot in &file.robots {
        for (at, value) in parameters(&file, robot, compensation) {
            let found = group.wire().read(robot.node, at, value.kind()).unwrap();
            assert_eq!(found.to_bits(), value.to_bits(), "{} {at}", robot.node);
        }
    }
}

/// Wheel rates of two robots that go the same way, rad/s: what the loops leave.
const ALIKE: f32 = 0.05;

#[test]
fn a_robot_switched_off_and_on_between_two_drives_has_the_file_again() {
    let file = file();
    for compensation in [true, false] {
        let mut link = Cycled::new(&file, |_| false);
        save(&mut link, &older(&file));
        let mut group = Group::connect(link, &file).unwrap();
        group.configure(compensation).unwrap();
        group.start().unwrap();
        group.set_twist(Twist::new(0.1, 0.0, 0.0)).unwrap();
        group.run(0.2).unwrap();
        group.stop().unwrap();

        group.link().link.world.set_power(INDEX, false);
        listen(&mut group, OFF_US);
        group.link().link.world.set_power(INDEX, true);
        listen(&mut group, 500_000);
        group.start().unwrap();
        group.set_twist(Twist::new(0.1, 0.0, 0.0)).unwrap();
        group.run(1.0).unwrap();
        let rows = group.recorder().rows();
        let last = &rows[rows.len() - 2].members;
        let [a, b] = [0, INDEX].map(|n| last[n].wheel_rates.unwrap().front_left);
        assert!((a - b).abs() < ALIKE, "{a} and {b} rad/s");
        group.stop().unwrap();
        assert_configured(&mut group, compensation);
    }
}

/// The boot-up message of a robot whose connector is out is lost.
#[test]
fn a_robot_that_was_missing_is_configured_again() {
    let file = file();
    let mut link = Cycled::new(&file, |_| false);
    save(&mut link, &older(&file));
    let mut group = Group::connect(link, &file).unwrap();
    group.start().unwrap();
    group.run(0.2).unwrap();
    group.link().link.world.set_connected(INDEX, false);
    let missing = group.run(1.0).unwrap_err();
    assert!(matches!(
        missing.cause(),
        MasterError::MemberMissing { node: NODE, .. }
    ));
    group.stop().unwrap();
    group.link().link.world.set_power(INDEX, false);
    listen(&mut group, OFF_US);
    group.link().link.world.set_power(INDEX, true);
    listen(&mut group, OFF_US);
    group.link().link.world.set_connected(INDEX, true);
    listen(&mut group, 1_500_000);
    group.start().unwrap();
    assert_configured(&mut group, true);
    group.stop().unwrap();
}

/// What was written before is gone: that is neither another master's doing nor the file's.
#[test]
fn a_restart_while_the_file_is_written_is_named() {
    let file = file();
    for after in [20, 40] {
        let mut requests = 0;
        let cycled = Cycled::new(&file, move |frame| {
            requests += u32::from(frame.id() == cob::sdo_request(NODE));
            requests == after
        });
        let mut group = Group::connect(cycled, &file).unwrap();
        let error = group.configure(true).unwrap_err();
        assert_eq!(
            error,
            MasterError::MemberRestarted { node: NODE },
            "{after}"
        );
    }
}

/// The file is in no robot's flash when a member restarts between the configuration and the start.
#[test]
fn a_robot_that_restarts_while_the_group_starts_ends_the_start() {
    let file = file();
    let start = |frame: &Frame| frame.id() == cob::NMT && frame.data() == [1, 0];
    let mut link = Cycled::new(&file, start);
    save(&mut link, &older(&file));
    let mut group = Group::connect(link, &file).unwrap();
    let error = group.start().unwrap_err();
    assert_eq!(error, MasterError::MemberRestarted { node: NODE });
    group.start().unwrap();
    assert_configured(&mut group, true);
    group.stop().unwrap();
}

/// A calibration on the floor of the paper's Table 8, and why motions were driven again.
fn calibrated(trigger: impl FnMut(&Frame) -> bool + 'static) -> (Calibration, Vec<String>) {
    let mut file = file();
    file.simulation.plant = Plant::Table(Tables::Physical);
    let mut link = Cycled::new(&file, trigger);
    let mut older = older(&file);
    for (robot, new) in older.robots.iter_mut().zip(&file.robots) {
        robot.geometry = new.geometry;
    }
    save(&mut link, &older);
    let mut session = Group::connect(link, &file).unwrap();
    let mut poses = |cycled: &mut Cycled| {
        let p = cycled.link.world.truth().group;
        Ok(vec![[p.x, p.y, p.heading]])
    };
    let settings = Settings {
        speeds: vec![0.5],
        rates: vec![0.5],
        repeats: 1,
        ..Settings::default()
    };
    let mut again = Vec::new();
    let mut journal = Journal::new(|step: &Step| {
        if let What::Again(reason) = &step.what {
            again.push(reason.clone());
        }
    });
    let mut instrument = Instrument::Poses(&mut poses);
    let found = calibrate(&mut session, &settings, 1, &mut instrument, &mut journal).unwrap();
    drop(journal);
    (found, again)
}

/// What two calibrations of one floor may differ, relative: the tenth of what a calibration is held
/// to.
const SAME: f32 = 1e-3;

#[test]
fn a_power_cycle_in_a_calibration_changes_nothing_of_its_result() {
    let (expected, again) = calibrated(|_| false);
    assert_eq!(again, [""; 0]);
    let sideways = |frame: &Frame| {
        frame.id() == cob::GROUP_TWIST
            && GroupTwist::try_from(frame.data()).is_ok_and(|g| g.twist.vy.abs() > 0.3)
    };
    let (found, again) = calibrated(sideways);
    let lateral = |c: &Calibration| c.file.robots[0].compensation.lateral();
    let (found, expected) = (lateral(&found), lateral(&expected));
    assert!((found - expected).abs() < SAME, "{found}, not {expected}");
    assert_eq!(again.len(), 1, "{again:?}");
    assert!(again[0].contains("node 3 restarted"), "{again:?}");
}

/// A second after the first SYNC.
fn in_the_run() -> impl FnMut(&Frame) -> bool + 'static {
    let mut syncs = 0;
    move |frame| {
        syncs += u32::from(frame.id() == cob::SYNC);
        syncs > 100
    }
}

/// The robot is named, and not this computer, which was never late.
#[test]
fn a_restart_in_an_identification_or_a_wheel_test_is_named() {
    let file = file();
    let whole = |test: bool| {
        let mut session = Group::connect(Cycled::new(&file, in_the_run()), &file).unwrap();
        session.configure(true).unwrap();
        let period = session.period_us();
        let wire = session.wire();
        let text = if test {
            let findings = test_wheels(wire, NODE, period, &mut |_, _| Ok(None), &mut |_| Ok(()));
            findings.unwrap_err().to_string()
        } else {
            let settings = motors::Settings::default();
            let found = identify_motors(wire, NODE, period, &settings, &mut |_| Ok(()));
            found.unwrap_err().to_string()
        };
        assert!(text.contains("restarted"), "{text}");
        assert!(!text.contains("too busy"), "{text}");
        let members = wire.read(NODE, address::COMMISSIONING, Kind::U8).unwrap();
        assert_eq!(members.to_bits(), 0, "no permission is left");
    };
    whole(false);
    whole(true);
}
