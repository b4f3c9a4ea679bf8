//! The session against mock robots: what it sends and when, and what it makes of trouble.

use std::sync::{Arc, Mutex};

use group::GroupFile;
use kinematics::Twist;
use protocol::timing::SETPOINT_LEAD_US;
use protocol::{Fault, GroupTwist, Kind, Value, cob};

use crate::bus::foreign::Sign;
use crate::bus::link::Link;
use crate::bus::wire::Wire;
use crate::error::MasterError;
use crate::fake::FakeBus;
use crate::monitor::telemetry::{EventKind, SessionState, Subscription, Telemetry};
use crate::path::curve::Curve;
use crate::session::Group;

mod configuration;

fn file() -> GroupFile {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-3.toml");
    GroupFile::load(path).unwrap()
}

/// Drives the beginning of the figure-eight; returns what `follow` said.
fn follow(bus: &mut FakeBus, file: &GroupFile) -> Result<(), MasterError> {
    let mut group = Group::connect(bus, file)?;
    group.configure(true)?;
    group.start()?;
    group.follow(&Curve::FigureEight.plan(true), &mut |_, _| {})
}

/// A drive ends in PRE-OPERATIONAL, where robots follow nothing.
#[test]
fn a_group_is_started_before_every_drive() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    let mut group = Group::connect(&mut bus, &file).unwrap();
    let plan = Curve::FigureEight.plan(true);
    for started in [false, true, false] {
        if started {
            group.start().unwrap();
            group.run(0.1).unwrap();
            group.follow(&plan, &mut |_, _| {}).unwrap();
        }
        let rows = group.recorder().rows().len();
        let refused = |result| matches!(result, Err(MasterError::NotStarted));
        assert!(refused(group.follow(&plan, &mut |_, _| {})));
        assert!(refused(group.run(1.0)));
        assert_eq!(group.recorder().rows().len(), rows, "nothing was sent");
    }
}

#[test]
fn sync_is_punctual_counted_and_preceded_by_its_setpoint() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    follow(&mut bus, &file).unwrap();
    let (syncs, twists) = (bus.sent_as(cob::SYNC), bus.sent_as(cob::GROUP_TWIST));
    assert!(syncs.len() > 800);
    assert_eq!(syncs.len(), twists.len());
    for (k, pair) in syncs.windows(2).enumerate() {
        assert_eq!(pair[1].0 - pair[0].0, 10_000, "period after SYNC {k}");
        assert_eq!(pair[1].1[0], pair[0].1[0] % 240 + 1, "counter");
    }
    for (sync, twist) in syncs.iter().zip(&twists) {
        assert_eq!(sync.0 - twist.0, u64::from(SETPOINT_LEAD_US));
    }
    for pair in twists.windows(2) {
        assert_eq!(pair[1].1[6], pair[0].1[6].wrapping_add(1), "sequence");
    }
    let beats = bus.sent_as(cob::MASTER_HEARTBEAT);
    let late = beats.windows(2).map(|pair| pair[1].0 - pair[0].0).max();
    assert!(late <= Some(110_000), "{late:?}");
}

#[test]
fn setpoints_are_those_of_two_syncs_and_the_apply_delay_later() {
    /// Half a step of the wire format, m/s.
    const HALF_STEP: f32 = 0.000_05 + 1e-6;
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    let mut times = Vec::new();
    let plan = Curve::FigureEight.plan(true);
    let mut group = Group::connect(&mut bus, &file).unwrap();
    group.configure(true).unwrap();
    group.start().unwrap();
    group
        .follow(&plan, &mut |link, instant| {
            times.push((crate::bus::link::Link::now(link).0, instant.t));
        })
        .unwrap();
    let twists = bus.sent_as(cob::GROUP_TWIST);
    for (at, t) in times {
        let (_, data) = twists
            .iter()
            .find(|(sent, _)| sent + u64::from(SETPOINT_LEAD_US) == at)
            .unwrap();
        let sent = GroupTwist::try_from(&data[..]).unwrap().twist;
        let wanted = plan.setpoint(t + 0.01 + 0.0023);
        assert!((sent.vx - wanted.vx).abs() < HALF_STEP, "at {t}");
        assert!((sent.vy - wanted.vy).abs() < HALF_STEP, "at {t}");
    }
}

/// The setpoints sent at the end stand still, and the last NMT command is "enter PRE-OPERATIONAL".
fn assert_stopped(bus: &FakeBus) {
    let twists = bus.sent_as(cob::GROUP_TWIST);
    assert!(twists.iter().rev().take(4).all(|(_, d)| d[..6] == [0; 6]));
    assert_eq!(bus.sent_as(cob::NMT).last().unwrap().1, [0x80, 0]);
}

#[test]
fn a_fault_stops_the_group_and_its_cause_is_named() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    bus.robots[0].fault = Some((3_000_000, Fault::MemberStopped));
    bus.robots[2].fault = Some((3_000_000, Fault::EmergencyStop));
    let error = follow(&mut bus, &file).unwrap_err();
    let fault = Fault::EmergencyStop;
    assert_eq!(error, MasterError::MemberFault { node: 4, fault });
    assert_stopped(&bus);
}

#[test]
fn a_request_is_repeated_before_a_robot_counts_as_silent() {
    let read = |deaf_to| {
        let mut bus = FakeBus::new(&[2]);
        bus.robots[0].deaf_to = deaf_to;
        let mut wire = Wire::visiting(&mut bus);
        wire.read(2, protocol::address::WIRE_VERSION, Kind::U16)
    };
    assert_eq!(read(2), Ok(Value::U16(protocol::WIRE_VERSION)));
    assert_eq!(read(3), Err(MasterError::NodeSilent { node: 2 }));
}

/// An answer that comes after its request was given up is not taken for that of the next one.
#[test]
fn an_answer_that_comes_late_is_no_answer_to_another_request() {
    let mut bus = FakeBus::new(&[2]);
    bus.robots[0].slow_us = 300_000;
    let mut wire = Wire::visiting(&mut bus);
    let version = wire.read(2, protocol::address::WIRE_VERSION, Kind::U16);
    assert_eq!(version, Ok(Value::U16(protocol::WIRE_VERSION)));
    let status = wire.read(2, protocol::address::CONFIGURATION_STATUS, Kind::U32);
    assert_eq!(status, Ok(Value::U32(0)));
}

/// A master that hung names that, not the wiring; one that was on time names what it sees.
#[test]
fn lateness_is_named_as_lateness() {
    let file = file();
    // How long the master hangs beyond what it waited for, us.
    let failed = |hangs: Option<u64>, fault: Fault| {
        let mut bus = paced();
        let mut group = Group::connect(&mut bus, &file).unwrap();
        group.start().unwrap();
        let now = group.next_sync().0;
        if let Some(late) = hangs {
            group.link().hang = Some((now + 200_200, now + 201_000 + late));
        }
        group.link().robots[1].fault = Some((now + 260_000, fault));
        group.run(0.5).unwrap_err()
    };
    // The second is the shortest by which robots miss SYNC: they wait 12.5 ms more than a period.
    let late = [80_000, 12_500].map(|late| failed(Some(late), Fault::SyncLost));
    for late in &late {
        assert!(matches!(late, MasterError::Busy { .. }), "{late}");
    }
    let fault = MasterError::MemberFault {
        node: 3,
        fault: Fault::SyncLost,
    };
    assert_eq!(*late[0].cause(), fault);
    assert_eq!(failed(None, Fault::SyncLost), fault);
    // What lateness does not explain is not excused by it.
    let pressed = failed(Some(80_000), Fault::EmergencyStop);
    assert!(
        matches!(pressed, MasterError::MemberFault { .. }),
        "{pressed}"
    );
}

#[test]
fn a_robot_that_falls_silent_stops_the_group() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    bus.robots[1].silent_from = 3_000_000;
    let error = follow(&mut bus, &file).unwrap_err();
    assert!(
        matches!(error, MasterError::MemberMissing { node: 3, .. }),
        "{error}"
    );
    assert_stopped(&bus);
}

/// One cause is likelier than one for each robot, so none of them is blamed.
#[test]
fn robots_that_fall_silent_together_are_not_blamed_one_by_one() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    for robot in &mut bus.robots {
        robot.silent_from = 3_000_000;
    }
    let error = follow(&mut bus, &file).unwrap_err();
    assert!(
        matches!(error, MasterError::MembersMissing { syncs: 3 }),
        "{error}"
    );
    assert_stopped(&bus);
}

/// The others report first that a member is silent; the one that is silent is named.
#[test]
fn the_silent_member_is_named_and_not_the_one_that_misses_it() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    bus.robots[1].silent_from = 3_000_000;
    bus.robots[0].fault = Some((3_010_000, Fault::MemberSilent));
    let error = follow(&mut bus, &file).unwrap_err();
    assert!(
        matches!(error, MasterError::MemberMissing { node: 3, syncs: 2 }),
        "{error}"
    );
    assert_stopped(&bus);
}

#[test]
fn a_robot_that_does_not_arm_is_named() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    let mut group = Group::connect(&mut bus, &file).unwrap();
    group.configure(true).unwrap();
    group.link().robots[2].silent_from = 0;
    let error = group.start().unwrap_err();
    assert!(
        matches!(error, MasterError::NotReady { node: 4, .. }),
        "{error}"
    );
    let text = error.to_string();
    assert!(
        text.contains("member state ") && !text.contains("Some("),
        "{text}"
    );
    assert_stopped(&bus);
}

#[test]
fn asked_to_stop_it_ramps_down() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    let mut group = Group::connect(&mut bus, &file).unwrap();
    group.configure(true).unwrap();
    group.start().unwrap();
    let abort = group.abort();
    let plan = Curve::FigureEight.plan(true);
    let stopped = group.follow(&plan, &mut |_, instant| {
        if instant.t >= 2.0 && !abort.is_asked() {
            abort.ask();
        }
    });
    assert_eq!(stopped, Err(MasterError::Aborted));
    assert_stopped(&bus);
}

/// A bus that sends SYNC by itself.
fn paced() -> FakeBus {
    let mut bus = FakeBus::new(&[2, 3, 4]);
    bus.paces = true;
    bus
}

#[test]
fn a_bus_that_paces_gets_setpoints_ahead_of_its_syncs() {
    let file = file();
    let mut bus = paced();
    let mut group = Group::connect(&mut bus, &file).unwrap();
    group.start().unwrap();
    group.run(1.0).unwrap();
    group.stop().unwrap();
    assert_eq!(group.punctuality().unwrap().missed, 0);
    let (twists, syncs) = (bus.sent_as(cob::GROUP_TWIST), bus.sent_as(cob::SYNC));
    assert!(syncs.len() > 100, "{}", syncs.len());
    for (k, ((twist_at, _), (sync_at, data))) in twists.iter().zip(&syncs).enumerate() {
        assert_eq!(sync_at - twist_at, 1_250, "SYNC {k}");
        assert_eq!(usize::from(data[0]), k % 240 + 1, "counter of SYNC {k}");
    }
}

/// Robots take a jump of the counter for a second master.
#[test]
fn the_sync_counter_goes_on_where_it_was_though_syncs_were_left_out() {
    let file = file();
    let mut bus = paced();
    let mut group = Group::connect(&mut bus, &file).unwrap();
    for _ in 0..2 {
        group.start().unwrap();
        // The link's thread was late, and leaves two out.
        let period_us = group.period_us();
        let schedule = group.link().schedule.as_mut().unwrap();
        schedule.first.0 += 2 * period_us;
        group.run(0.5).unwrap();
        group.stop().unwrap();
    }
    let syncs = bus.sent_as(cob::SYNC);
    assert!(syncs.len() > 100, "{}", syncs.len());
    for (k, (_, data)) in syncs.iter().enumerate() {
        assert_eq!(usize::from(data[0]), k % 240 + 1, "counter of SYNC {k}");
    }
}

#[test]
fn a_master_that_falls_behind_says_so_and_goes_on() {
    let file = file();
    let mut bus = paced();
    let mut group = Group::connect(&mut bus, &file).unwrap();
    let noted = Arc::new(Mutex::new(Vec::new()));
    let log = Arc::clone(&noted);
    group.wire().tap(Arc::new(move |at, frame, _| {
        if frame.id() == cob::SYNC {
            log.lock().unwrap().push((at.0, frame.data().to_vec()));
        }
    }));
    group.start().unwrap();
    let telemetry = group.telemetry();
    // Between two SYNCs the machine hangs for 38 ms: three SYNCs pass without their setpoints.
    let now = group.next_sync().0;
    group.link().hang = Some((now + 200_200, now + 238_000));
    group.run(0.5).unwrap();
    group.stop().unwrap();
    assert_eq!(group.punctuality().unwrap().missed, 3);
    let late = telemetry_until(&telemetry, |what| matches!(what, EventKind::Late(3)));
    assert!(late, "the miss was reported");
    drop(group);
    let syncs = bus.sent_as(cob::SYNC);
    for pair in syncs.windows(2) {
        assert_eq!(pair[1].0 - pair[0].0, 10_000, "SYNC went on meanwhile");
    }
    assert_eq!(
        *noted.lock().unwrap(),
        syncs,
        "none is missing from a recording"
    );
    let twists = bus.sent_as(cob::GROUP_TWIST);
    for pair in twists.windows(2) {
        let (before, after) = (pair[0].1[6], pair[1].1[6]);
        assert_eq!(after, before.wrapping_add(1), "sequences have no gap");
    }
    let gap = twists.windows(2).map(|p| p[1].0 - p[0].0).max().unwrap();
    // Four periods; and from then on setpoints go out 2 ms before their SYNC instead of 1.25.
    assert_eq!(gap, 40_000 - (2_000 - 1_250));
    let last = twists[twists.len() - 1].0;
    assert!(syncs.iter().any(|(at, _)| *at == last + 2_000));
}

fn telemetry_until(stream: &Subscription, wanted: impl Fn(&EventKind) -> bool) -> bool {
    std::iter::from_fn(|| stream.try_next())
        .any(|item| matches!(&item, Telemetry::Event(event) if wanted(&event.what)))
}

#[test]
fn subscribers_get_one_snapshot_per_sync_with_what_members_said() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    let mut group = Group::connect(&mut bus, &file).unwrap();
    group.start().unwrap();
    let stream = group.telemetry();
    group.set_twist(Twist::new(0.25, 0.0, 0.0)).unwrap();
    group.run(0.1).unwrap();
    let items: Vec<_> = std::iter::from_fn(|| stream.try_next()).collect();
    assert_eq!(items.len(), 10, "ten SYNCs in 0.1 s");
    let Some(Telemetry::Snapshot(last)) = items.last() else {
        panic!("{items:?}");
    };
    assert_eq!(last.phase, SessionState::Running);
    assert_eq!(last.command, Twist::new(0.25, 0.0, 0.0));
    assert_eq!(last.scale, Some(1.0));
    assert_eq!(last.strain, Some(0.0));
    assert_eq!(last.sync, None, "time is virtual here");
    let nodes: Vec<u8> = last.members.iter().map(|member| member.node).collect();
    assert_eq!(nodes, [2, 3, 4]);
    assert_eq!(last.members[1].permitted_scale, Some(1.0));
    assert_eq!(last.members[1].nmt, Some(canopen::NmtState::Operational));
    drop(group);
    assert!(stream.is_over());
}

#[test]
fn a_twist_beyond_the_limits_is_refused_and_the_old_one_stays() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    let mut group = Group::connect(&mut bus, &file).unwrap();
    for (twist, name) in [
        (Twist::new(1.5, 1.5, 0.0), "limits.linear_speed"),
        (Twist::new(0.0, f32::NAN, 0.0), "limits.linear_speed"),
        (Twist::new(0.0, 0.0, -1.1), "limits.yaw_rate"),
    ] {
        let text = group.set_twist(twist).unwrap_err().to_string();
        assert!(text.contains(name), "{text}");
    }
    group.set_twist(Twist::new(1.2, -1.2, 1.0)).unwrap();
}

#[test]
fn an_observer_sends_nothing_and_does_not_take_over_from_another_master() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    let mut group = Group::observe(&mut bus, &file);
    let stream = group.telemetry();
    let now = canopen::Micros(0);
    for counter in 1..=3 {
        group.receive_frame(now, &canopen::client::sync(Some(counter)));
    }
    assert_eq!(group.claim(), Err(MasterError::AnotherMaster(Sign::Sync)));
    assert!(matches!(stream.try_next(), Some(Telemetry::Snapshot(_))));
    group.listen(canopen::Micros(1_100_000)).unwrap();
    drop(group);
    assert!(bus.sent.is_empty());
    let mut group = Group::observe(&mut bus, &file);
    group.claim().unwrap();
}

/// Another master's setpoint, while this one drives. An echo of its own frames is no other master.
#[test]
fn a_displaced_master_says_so_and_leaves_the_robots_to_the_other() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    let mut group = Group::connect(&mut bus, &file).unwrap();
    group.start().unwrap();
    group.cycle(Twist::new(0.1, 0.0, 0.0)).unwrap();
    let echo = group.link().sent.iter().map(|(_, frame)| *frame);
    let echo: Vec<_> = echo.rev().take(2).collect();
    let now = group.link().now();
    for frame in &echo {
        group.receive_frame(now, frame);
    }
    group.cycle(Twist::new(0.1, 0.0, 0.0)).unwrap();
    let foreign = GroupTwist {
        twist: Twist::new(-0.1, 0.0, 0.0),
        sequence: 200,
        group: file.group_id,
    };
    let frame = canopen::Frame::of(cob::GROUP_TWIST, foreign.encode());
    let now = group.link().now();
    group.receive_frame(now, &frame);
    let error = group.cycle(Twist::new(0.1, 0.0, 0.0)).unwrap_err();
    assert_eq!(error, MasterError::Displaced(Sign::GroupTwist));
    let sent = group.link().sent.len();
    group.stop().unwrap();
    assert_eq!(group.link().sent.len(), sent, "nothing more is sent");
}

/// A reset that no robot announces, or encoders that lose their count.
#[test]
fn a_pose_that_jumps_in_motion_ends_the_drive_by_name() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    let mut group = Group::connect(&mut bus, &file).unwrap();
    group.start().unwrap();
    let reports = |group: &mut Group<_>, x: f32| {
        let pose = kinematics::Pose::new(x, 0.0, 0.0);
        let report = protocol::PoseReport { pose };
        let now = Link::now(group.link());
        let frame = canopen::Frame::of(cob::pose(3), report.encode());
        group.receive_frame(now, &frame);
        group.cycle(Twist::new(0.1, 0.0, 0.0))
    };
    // 10 mm in a period of 10 ms is 1 m/s.
    for x in [0.0, 0.01, 0.02] {
        reports(&mut group, x).unwrap();
    }
    let error = reports(&mut group, 3.0).unwrap_err();
    assert_eq!(error, MasterError::PoseJumped { node: 3 });
}
