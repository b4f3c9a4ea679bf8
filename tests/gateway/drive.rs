//! Robots that drive with the master at the cable of the first.

use super::*;

/// The world's robots, the first of them with the master at its cable. USB carries bytes once a
/// millisecond either way, by a clock of its own.
struct CableLink {
    world: World,
    node: u8,
    answers: Answers,
    received: std::collections::VecDeque<(Micros, Frame)>,
    outgoing: Vec<u8>,
    /// The next USB frame, ns; `None` for a cable without USB.
    usb_ns: Option<u64>,
}

/// A USB frame of a host whose crystal is off by 300 ppm, so that all delays up to a millisecond
/// come up.
const USB_FRAME_NS: u64 = 1_000_300;

impl CableLink {
    fn new(mut world: World, node: u8, usb: bool) -> Self {
        world.set_listening(sim::MASTER, false);
        Self {
            world,
            node,
            answers: Answers::new(),
            received: Default::default(),
            outgoing: b"C\rS8\rO\r".to_vec(),
            usb_ns: usb.then_some(0),
        }
    }

    /// What the cable carries now.
    fn carry(&mut self) {
        let now = self.world.now_ns();
        match &mut self.usb_ns {
            Some(at) if now < *at => return,
            Some(at) => *at += USB_FRAME_NS,
            None => {}
        }
        let bytes = std::mem::take(&mut self.outgoing);
        self.world.send_cable(self.node, &bytes);
        for (_, byte) in self.world.take_cable(self.node) {
            if let Some(Answer::Frame(frame, _)) = self.answers.push(byte) {
                self.received.push_back((self.world.now(), frame));
            }
        }
    }
}

impl Link for CableLink {
    fn now(&self) -> Micros {
        self.world.now()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), LinkError> {
        let line = slcan::frame(frame, None);
        self.outgoing.extend_from_slice(line.as_bytes());
        Ok(())
    }

    fn receive(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, LinkError> {
        loop {
            self.carry();
            if let Some(received) = self.received.pop_front() {
                return Ok(Some(received));
            }
            if self.world.now() >= until {
                return Ok(None);
            }
            let step = (self.world.now() + Micros(100)).min(until);
            self.world.run_until(step).map_err(|error| LinkError {
                bus: "cable".into(),
                problem: error.to_string(),
                remedy: String::new(),
            })?;
        }
    }
}

/// Circles of three robots, each as `quick_drive` has it, with the master at the cable of the
/// first; and the largest shape error until the end of each, mm.
fn cable_drive(usb: bool, rounds: usize) -> (CableLink, Vec<TruthSample>, Vec<f64>) {
    let group = common::group("tcc-3");
    let plan = Curve::Circle.plan(true);
    let options = Options {
        truth_period_ns: u64::from(group.sync_period_us) * 1_000,
        start: plan.start(),
        ..Options::default()
    };
    let mut world = World::new(&group, Backend::Emulator(firmware()), options).unwrap();
    // Power-on, and 300 ms for all to boot.
    world.run_until(Micros(300_000)).unwrap();
    let mut link = CableLink::new(world, group.robots[0].node, usb);
    let (mut truth, mut shapes) = (Vec::new(), Vec::new());
    let mut drive = || -> Result<(), Box<dyn std::error::Error>> {
        let mut session = Group::connect(&mut link, &group)?;
        session.configure(true)?;
        session.start()?;
        session.link().world.take_truth();
        session.link().world.reset_worst_shape_error();
        session.link().world.start_trace();
        for round in 0..rounds {
            if round > 0 {
                session.start()?;
            }
            session.follow(&plan, &mut |link, _| truth.extend(link.world.take_truth()))?;
            shapes.push(session.link().world.worst_shape_error_mm());
        }
        Ok(())
    };
    if let Err(error) = drive() {
        for (node, line) in link.world.take_logs() {
            println!(
                "node {node} {:>10} us {} {}",
                line.time_us, line.level, line.text
            );
        }
        panic!("{error}");
    }
    (link, truth, shapes)
}

/// Largest distance between the group with an adapter and the group with the cable at any SYNC over
/// the circle: the setpoints reach the bus a fraction of a millisecond later.
const POSITION_MM: f64 = 0.5;
/// What docs/safety.md and docs/performance.md promise of the pulse widths of a group, ns.
const SKEW_NS: u64 = 5_000;

/// Largest distance in time between the duty changes of the robots that belong together.
fn skew_ns(world: &mut World) -> u64 {
    let changes: Vec<Vec<u64>> = (0..3).map(|robot| world.take_duty_changes(robot)).collect();
    let [first, others @ ..] = &changes[..] else {
        panic!("three robots")
    };
    assert!(first.len() > 1_000, "{} changes", first.len());
    let mut worst = 0;
    for other in others {
        for at in first {
            let place = other.partition_point(|time| time < at);
            let near = [place.checked_sub(1), Some(place)];
            let near = near.into_iter().flatten().filter_map(|n| other.get(n));
            let distance = near.map(|time| time.abs_diff(*at)).min().unwrap();
            // A duty that has not changed in one robot is no skew.
            if distance < 500_000 {
                worst = worst.max(distance);
            }
        }
    }
    worst
}

#[test]
fn three_robots_behind_a_cable_drive_as_behind_an_adapter() {
    let adapter = common::quick_drive(
        &common::group("tcc-3"),
        Backend::Emulator(firmware()),
        Curve::Circle,
        true,
    );
    let (mut link, truth, _) = cable_drive(false, 1);
    assert!(adapter.result.is_ok());
    let skew = skew_ns(&mut link.world);
    let count = adapter.truth.len().min(truth.len());
    assert!(count > 700, "{count} samples");
    let mut position = 0.0_f64;
    for (a, c) in adapter.truth.iter().zip(&truth) {
        position = position.max((a.group.x - c.group.x).hypot(a.group.y - c.group.y) * 1e3);
    }
    println!("position {position:.3} mm, skew {skew} ns");
    assert!(position < POSITION_MM, "{position} mm");
    assert!(skew < SKEW_NS, "{skew} ns");
}

/// The same over USB for a minute. USB holds every byte up to a millisecond, each time another
/// while: SYNC comes to the bus by that much too early or too late, and the robots' clocks bridge
/// it. The gateway takes the time of SYNC when the frame has left for the bus, the others when they
/// have received it, and its pulse widths change with those of the others all the same. The shape
/// error is that of one circle: where the robots would be, had each been alone, adds up from round
/// to round.
#[test]
fn sync_that_usb_has_held_up_is_bridged() {
    let (mut link, truth, shapes) = cable_drive(true, 9);
    let [first, .., last] = &truth[..] else {
        panic!("no truth")
    };
    let seconds = (last.time_ns - first.time_ns) as f64 * 1e-9;
    assert!(seconds > 60.0, "{seconds} s");
    assert!(truth.len() > 9 * 700, "{} samples", truth.len());
    let skew = skew_ns(&mut link.world);
    let shape = shapes[0];
    println!(
        "over USB for {seconds:.0} s: shape {shape:.3} mm in the first circle, skew {skew} ns"
    );
    assert!(shape < SHAPE_MM, "{shape} mm");
    assert!(skew < SKEW_NS, "{skew} ns");
}

/// Largest strain on the load, as with native robots on an adapter.
const SHAPE_MM: f64 = 1.0;

/// A group of three that drives, with its master at the cable of the first.
fn driving() -> TestMaster {
    let group = common::group("tcc-3");
    let options = Options {
        truth_period_ns: 0,
        ..Options::default()
    };
    let world = World::new(&group, Backend::Emulator(firmware()), options).unwrap();
    let mut link = SimLink::new(world, "test");
    let mut session = Group::connect(&mut link, &group).unwrap();
    session.configure(false).unwrap();
    let mut master = TestMaster::new(link.world, &group);
    master.plug_in(NODE);
    master.run(100).unwrap();
    master.command(NmtCommand::Start, None);
    master.run(100).unwrap();
    assert!(master.all_are(MemberState::Moving));
    master.twist = Some(Twist::new(0.4, 0.0, 0.0));
    master.run(500).unwrap();
    assert!(master.all_are(MemberState::Moving));
    assert!(master.measured(NODE).unwrap().vx > 0.3);
    master
}

/// The setpoint latched at a SYNC is the same in the gateway as in the others.
#[test]
fn all_robots_latch_the_same_setpoint() {
    let mut master = driving();
    for _ in 0..50 {
        // Between the answers to a SYNC and the next setpoint.
        master.run_to_phase(10, 6).unwrap();
        let sequence = master.sequence();
        for node in [2, 3, 4] {
            assert_eq!(
                master.status(node).unwrap().sequence,
                sequence,
                "node {node}"
            );
        }
    }
}

/// docs/safety.md, cause 2: no SYNC is a ramp within this time, µs, and the robot has gone this far
/// at most when it rests, m.
const SYNC_LOST_US: u64 = 24_000;
const SYNC_LOST_WAY: f64 = 0.12;

/// The promise for a silent master holds whatever the line does when the cable is pulled, for the
/// gateway and for the others; and with the cable plugged in again the group starts as after any
/// stop.
fn pull_and_plug_in(pulled: Cable) {
    let mut master = driving();
    // A SYNC has just gone through: the next one would be due in 9 ms.
    master.run_to_phase(10, 1).unwrap();
    // What the robots say is now only heard on the bus; the program goes on sending.
    master.world.set_listening(MASTER, true);
    let at = master.world.now();
    let before = master.world.truth();
    // In the middle of a byte.
    master.world.send_cable(NODE, b"t1818");
    master.world.run_until(at + Micros(25)).unwrap();
    master.world.set_cable(0, pulled);
    master.world.run_until(at + Micros(250)).unwrap();
    master.run(2_000).unwrap();
    let truth = master.world.truth();
    for (node, (robot, before)) in (2..).zip(truth.robots.iter().zip(&before.robots)) {
        let mut emergencies = master.emergencies(node);
        let announced = emergencies.find(|(sent, _)| *sent > at);
        let after_us = announced.map(|(sent, _)| sent.since(at).0);
        assert!(
            after_us.is_some_and(|after_us| after_us < SYNC_LOST_US),
            "{pulled:?}: node {node} ramps after {after_us:?} us"
        );
        let rates: [f64; 4] = robot.wheel_rates.into();
        assert!(rates.iter().all(|rate| rate.abs() < 1e-3), "{rates:?}");
        let way = (robot.pose.x - before.pose.x).hypot(robot.pose.y - before.pose.y);
        assert!(way < SYNC_LOST_WAY, "node {node} went {way} m");
    }

    master.world.set_cable(0, Cable::Plugged);
    master.world.set_listening(MASTER, false);
    master.plug_in(NODE);
    master.twist = Some(Twist::default());
    master.command(NmtCommand::EnterPreOperational, None);
    master.run(200).unwrap();
    master.command(NmtCommand::Start, None);
    master.run(200).unwrap();
    assert!(master.all_are(MemberState::Moving), "{pulled:?}");
    master.twist = Some(Twist::new(0.4, 0.0, 0.0));
    master.run(500).unwrap();
    assert!(master.all_are(MemberState::Moving), "{pulled:?}");
    assert!(master.measured(NODE).unwrap().vx > 0.3);
}

#[test]
fn a_pulled_cable_whose_line_is_low_is_a_silent_master() {
    pull_and_plug_in(Cable::Low);
}

#[test]
fn a_pulled_cable_whose_line_is_open_is_a_silent_master() {
    pull_and_plug_in(Cable::Open);
}

/// What all three robots say of a second master.
fn all_notice_two_masters(master: &TestMaster) {
    for node in [2, 3, 4] {
        let mut codes = master.emergencies(node).map(|(_, code)| code);
        let two = codes.any(|code| code == Fault::TwoMasters.code());
        assert!(two, "node {node}");
    }
}

/// Two programs at one cable are one too many, as on the bus.
#[test]
fn a_second_master_at_the_cable_is_noticed() {
    let mut master = driving();
    master.second = true;
    master.run(500).unwrap();
    all_notice_two_masters(&master);
}

/// So are one at the cable and one on the bus.
#[test]
fn a_master_on_the_bus_beside_that_at_the_cable_is_noticed() {
    let mut master = driving();
    for sequence in 0..50 {
        let other = protocol::GroupTwist {
            twist: Twist::default(),
            sequence,
            group: common::group("tcc-3").group_id,
        };
        let frame = Frame::of(protocol::cob::GROUP_TWIST, other.encode());
        master.world.send(frame);
        master.run(10).unwrap();
    }
    all_notice_two_masters(&master);
}
