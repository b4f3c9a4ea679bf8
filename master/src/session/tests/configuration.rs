//! What is written into the robots, and what speaks against it.

use canopen::AbortCode;
use protocol::compensation::Row;
use protocol::{Address, address, cob};

use super::file;
use crate::bus::wire::Wire;
use crate::error::MasterError;
use crate::fake::FakeBus;
use crate::session::Group;
use crate::session::configure::{compensation_set, parameters};

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
        assert_eq!(value.check(entry.min(), entry.max()), Ok(()), "{at}");
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
fn a_refusal_says_what_was_to_be_done() {
    let mut bus = FakeBus::new(&[2]);
    let store = protocol::Address::new(0x1010, 1);
    bus.robots[0].refuses = Some((store, AbortCode::DeviceState));
    let text = Wire::visiting(bus).save(2).unwrap_err().to_string();
    assert!(
        text.starts_with("node 2: saving the parameters was refused: "),
        "{text}"
    );
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

#[test]
fn a_compensation_table_is_written_once() {
    let mut file = file();
    file.robots[1].compensation_table = group::CompensationTable {
        version: 20_261_121,
        lateral: vec![Row::new(0.1, 1.141), Row::new(0.5, 1.157)],
        ..Default::default()
    };
    let set = compensation_set(&file.robots[1], true).unwrap();
    let [a, b, c, d, ..] = set[..] else {
        panic!("a set has a CRC");
    };
    // A robot that has this set already is left alone; the others get the empty one they have.
    let mut bus = FakeBus::new(&[2, 3, 4]);
    bus.robots[1]
        .store
        .insert(address::COMPENSATION_CRC, vec![a, b, c, d]);
    let mut group = Group::connect(&mut bus, &file).unwrap();
    group.configure(true).unwrap();
    let [low, high] = address::COMPENSATION_SET.index.to_le_bytes();
    let writes = |bus: &FakeBus, node: u8| {
        let requests = bus.sent_as(cob::sdo_request(node));
        requests
            .iter()
            .filter(|(_, data)| data[0] & 0xE0 == 0x20 && data[1..4] == [low, high, 1])
            .count()
    };
    assert_eq!([2, 3, 4].map(|node| writes(&bus, node)), [0, 0, 0]);

    // One that has another is given this one, in a segmented transfer that cardboard does not
    // answer.
    let mut bus = FakeBus::new(&[2, 3, 4]);
    let mut group = Group::connect(&mut bus, &file).unwrap();
    assert!(group.configure(true).is_err());
    assert_eq!([2, 3, 4].map(|node| writes(&bus, node)), [0, 1, 0]);
    assert_eq!(
        compensation_set(&file.robots[1], false).unwrap(),
        protocol::compensation::EMPTY
    );
}
