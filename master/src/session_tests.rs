//! The session against cardboard robots: what it sends and when, and what it makes of trouble.

use canopen::AbortCode;
use group::GroupFile;
use protocol::{Address, Fault, GroupTwist, address, cob};

use crate::configure::parameters;
use crate::curve::Curve;
use crate::error::MasterError;
use crate::fake::FakeBus;
use crate::session::Group;

fn file() -> GroupFile {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-3.toml");
    GroupFile::load(path).unwrap()
}

#[test]
fn writes_every_value_of_the_file_into_every_robot() {
    let file = file();
    for compensation in [false, true] {
        let mut bus = FakeBus::new(&[2, 3, 4]);
        let mut group = Group::connect(&mut bus, &file).unwrap();
        group.configure(compensation).unwrap();
        for (robot, fake) in file.robots.iter().zip(&bus.robots) {
            for (at, value) in parameters(&file, robot, compensation) {
                let length = usize::from(value.kind().bytes());
                assert_eq!(fake.store[&at], value.to_bytes()[..length], "{at}");
            }
        }
        let lateral = &bus.robots[0].store[&address::COMPENSATION_LATERAL];
        let lateral = f32::from_le_bytes(lateral[..].try_into().unwrap());
        assert_eq!(lateral, if compensation { 1.033 } else { 1.0 });
        assert_eq!(
            bus.robots[0].store[&address::MEMBERS],
            0b1_1100_u32.to_le_bytes()
        );
    }
}

#[test]
fn values_are_of_the_type_the_table_has() {
    let file = file();
    for (at, value) in parameters(&file, &file.robots[0], true) {
        let entry = protocol::entry(at).unwrap();
        assert_eq!(entry.kind, value.kind(), "{at}");
        assert_eq!(value.check(entry.min, entry.max), Ok(()), "{at}");
    }
}

#[test]
fn every_required_object_is_written() {
    let file = file();
    let written = parameters(&file, &file.robots[0], true);
    for object in protocol::OBJECTS.iter().filter(|object| object.required) {
        let found = written.iter().any(|(at, _)| *at == object.address);
        assert!(found, "{} {}", object.address, object.name);
    }
}

#[test]
fn a_missing_robot_is_named_and_nothing_is_started() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 4]);
    let error = Group::connect(&mut bus, &file).err().unwrap();
    assert_eq!(error, MasterError::NodeSilent { node: 3 });
    assert!(bus.sent_as(cob::NMT).is_empty());
    assert!(bus.sent_as(cob::SYNC).is_empty());
}

#[test]
fn a_refusal_names_node_object_and_remedy() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    bus.robots[1].refuses = Some((address::WHEEL_RADIUS, AbortCode::ValueTooHigh));
    let mut group = Group::connect(&mut bus, &file).unwrap();
    let text = group.configure(true).unwrap_err().to_string();
    for part in ["node 3", "2010:3", "0.1524", "value too high", "group file"] {
        assert!(text.contains(part), "{part} in {text}");
    }
    assert!(bus.sent_as(cob::SYNC).is_empty());
}

#[test]
fn a_value_that_does_not_read_back_is_an_error() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    bus.robots[2].forgets = Some(address::HALF_TRACK);
    let mut group = Group::connect(&mut bus, &file).unwrap();
    let error = group.configure(true).unwrap_err();
    assert!(
        matches!(&error, MasterError::ReadBack { node: 4, found, .. } if found == "0"),
        "{error}"
    );
}

#[test]
fn another_wire_version_is_refused() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    let at: Address = address::WIRE_VERSION;
    bus.robots[0].store.insert(at, vec![99, 0]);
    let error = Group::connect(&mut bus, &file).err().unwrap();
    assert_eq!(error, MasterError::WireVersion { node: 2, found: 99 });
}

#[test]
fn an_incomplete_configuration_is_explained() {
    let file = file();
    let mut bus = FakeBus::new(&[2, 3, 4]);
    let at = address::CONFIGURATION_STATUS;
    // 2010:3, reason 1.
    bus.robots[0].store.insert(at, vec![1, 3, 0x10, 0x20]);
    let mut group = Group::connect(&mut bus, &file).unwrap();
    let text = group.configure(true).unwrap_err().to_string();
    assert!(
        text.contains("2010:3") && text.contains("not written"),
        "{text}"
    );
}

/// Drives the beginning of the figure-eight; returns what `follow` said.
fn follow(bus: &mut FakeBus, file: &GroupFile) -> Result<(), MasterError> {
    let mut group = Group::connect(bus, file)?;
    group.configure(true)?;
    group.start()?;
    group.follow(&Curve::FigureEight.plan(true), &mut |_, _| {})
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
        assert_eq!(sync.0 - twist.0, 2_000);
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
            times.push((crate::link::Link::now(link).0, instant.t));
        })
        .unwrap();
    let twists = bus.sent_as(cob::GROUP_TWIST);
    for (at, t) in times {
        let (_, data) = twists.iter().find(|(sent, _)| sent + 2_000 == at).unwrap();
        let sent = GroupTwist::try_from(&data[..]).unwrap().twist;
        let wanted = plan.setpoint(t + 0.022);
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
