//! Saving, restoring, and what a robot does with a bad image.

use std::boxed::Box;
use std::vec::Vec;

use canopen::{Frame, NodeId};
use control::time::Micros;
use protocol::address as at;
use protocol::{Fault, cob, crc32};

use crate::{BusSide, IMAGE_MAX, Identity, State, Stored};

const DEVICE_STATE: [u8; 4] = 0x0800_0022_u32.to_le_bytes();
const HARDWARE: [u8; 4] = 0x0606_0000_u32.to_le_bytes();

fn robot(stored: Stored<'_>) -> BusSide {
    robot_with(2, stored)
}

fn robot_with(node: u8, stored: Stored<'_>) -> BusSide {
    let identity = Identity {
        storage: true,
        ..Identity::new(NodeId::new(node).unwrap(), 1)
    };
    let mut bus = BusSide::new(identity);
    bus.load(Micros(1), Box::leak(Box::new([0; IMAGE_MAX])), stored);
    bus.poll(Micros(2));
    bus
}

/// Sends an SDO request; the answers, emergencies and the rest.
fn request(bus: &mut BusSide, data: [u8; 8]) -> Vec<Frame> {
    bus.on_frame(Micros(10), &Frame::new(0x602, &data).unwrap());
    core::iter::from_fn(|| bus.pop_frame()).collect()
}

fn store(bus: &mut BusSide, index: u8, sub: u8, signature: &[u8; 4]) -> Vec<Frame> {
    let [a, b, c, d] = *signature;
    request(bus, [0x23, index, 0x10, sub, a, b, c, d])
}

fn answer(frames: &[Frame]) -> &[u8] {
    let answer = frames.iter().find(|frame| frame.id() == 0x582);
    answer.expect("an answer").data()
}

fn half_track(bus: &mut BusSide) -> f32 {
    let frames = request(bus, [0x40, 0x10, 0x20, 1, 0, 0, 0, 0]);
    f32::from_le_bytes(answer(&frames)[4..].try_into().unwrap())
}

fn set_half_track(bus: &mut BusSide, value: f32) {
    assert_eq!(at::HALF_TRACK.index, 0x2010);
    let [a, b, c, d] = value.to_le_bytes();
    let frames = request(bus, [0x23, 0x10, 0x20, at::HALF_TRACK.sub, a, b, c, d]);
    assert_eq!(answer(&frames)[0], 0x60);
}

/// An image with half track 0.4.
fn saved() -> Vec<u8> {
    let mut bus = robot(Stored::Nothing);
    set_half_track(&mut bus, 0.4);
    assert!(store(&mut bus, 0x10, 1, b"save").is_empty(), "it waits");
    let image = bus.image_to_store().unwrap().to_vec();
    bus.finish_store(Ok(()));
    let frame = bus.pop_frame().unwrap();
    assert_eq!(frame.data()[..4], [0x60, 0x10, 0x10, 1]);
    assert_eq!(bus.image_to_store(), None);
    image
}

#[test]
fn what_was_saved_is_there_at_the_next_start_and_after_an_nmt_reset() {
    let mut bus = robot(Stored::Image(&saved()));
    assert_eq!(half_track(&mut bus), 0.4);
    set_half_track(&mut bus, 0.5);
    bus.on_frame(Micros(20), &Frame::new(0, &[0x81, 2]).unwrap());
    bus.poll(Micros(21));
    assert_eq!(half_track(&mut bus), 0.4);
}

#[test]
fn load_brings_the_defaults_back_at_the_next_start() {
    let mut bus = robot(Stored::Image(&saved()));
    store(&mut bus, 0x11, 1, b"load");
    let image = bus.image_to_store().unwrap().to_vec();
    bus.finish_store(Ok(()));
    while bus.pop_frame().is_some() {}
    assert_eq!(half_track(&mut bus), 0.4, "not before");
    assert_eq!(half_track(&mut robot(Stored::Image(&image))), 0.2);
}

#[test]
fn saving_one_part_keeps_the_other() {
    let mut bus = robot(Stored::Image(&saved()));
    set_half_track(&mut bus, 0.5);
    // Heartbeat 200 ms.
    request(&mut bus, [0x2B, 0x17, 0x10, 0, 200, 0, 0, 0]);
    store(&mut bus, 0x10, 2, b"save");
    let image = bus.image_to_store().unwrap().to_vec();
    bus.finish_store(Ok(()));
    let mut bus = robot(Stored::Image(&image));
    assert_eq!(half_track(&mut bus), 0.4);
    let heartbeat = request(&mut bus, [0x40, 0x17, 0x10, 0, 0, 0, 0, 0]);
    assert_eq!(answer(&heartbeat)[4..6], [200, 0]);
}

/// A transmission type is saved at node 2, and the switches say 9 at the next start.
#[test]
fn a_saved_pdo_takes_the_identifier_of_the_present_node() {
    let mut bus = robot(Stored::Nothing);
    let frames = request(&mut bus, [0x2F, 0x01, 0x18, 2, 3, 0, 0, 0]);
    assert_eq!(answer(&frames)[0], 0x60);
    store(&mut bus, 0x10, 2, b"save");
    let image = bus.image_to_store().unwrap().to_vec();
    for node in [2, 9] {
        let mut bus = robot_with(node, Stored::Image(&image));
        let mut read = |sub| {
            let request = [0x40, 0x01, 0x18, sub, 0, 0, 0, 0];
            let frame = Frame::new(cob::sdo_request(node), &request).unwrap();
            bus.on_frame(Micros(10), &frame);
            let mut frames = core::iter::from_fn(|| bus.pop_frame());
            let answer = frames.find(|frame| frame.id() == cob::sdo_response(node));
            u32::from_le_bytes(answer.unwrap().data()[4..].try_into().unwrap())
        };
        assert_eq!(read(2), 3);
        assert_eq!(read(1), 0x280 + u32::from(node));
    }
}

#[test]
fn nothing_is_saved_while_operational() {
    let mut bus = robot(Stored::Nothing);
    bus.on_frame(Micros(5), &Frame::new(0, &[1, 2]).unwrap());
    for (index, signature) in [(0x10, b"save"), (0x11, b"load")] {
        let frames = store(&mut bus, index, 1, signature);
        assert_eq!(answer(&frames)[4..], DEVICE_STATE);
        assert_eq!(bus.image_to_store(), None);
    }
}

#[test]
fn a_failed_save_is_told_and_what_was_stored_stays() {
    let old = saved();
    let mut bus = robot(Stored::Image(&old));
    set_half_track(&mut bus, 0.5);
    store(&mut bus, 0x10, 1, b"save");
    bus.finish_store(Err(Stored::Image(&old)));
    let frames: Vec<Frame> = core::iter::from_fn(|| bus.pop_frame()).collect();
    assert_eq!(answer(&frames)[4..], HARDWARE);
    bus.on_frame(Micros(20), &Frame::new(0, &[0x81, 2]).unwrap());
    bus.poll(Micros(21));
    assert_eq!(half_track(&mut bus), 0.4);
}

/// A bad image: the defaults, fault 22 with the object's name, no start until the next save.
fn refused(image: Stored<'_>, object: [u8; 3]) {
    let mut bus = robot(image);
    assert_eq!(bus.state(), State::Faulted(Fault::ParametersCorrupt));
    let frames: Vec<Frame> = core::iter::from_fn(|| bus.pop_frame()).collect();
    let emergency = frames.iter().find(|frame| frame.id() == cob::emergency(2));
    let data = emergency.unwrap().data();
    assert_eq!(data[..2], 0x6300_u16.to_le_bytes());
    assert_eq!(data[4..7], object);
    assert_eq!(half_track(&mut bus), 0.2);
    let status = request(&mut bus, [0x40, 0x02, 0x20, 1, 0, 0, 0, 0]);
    let [low, high, sub] = object;
    assert_eq!(answer(&status)[4..], [3, sub, low, high]);
    bus.on_frame(Micros(20), &Frame::new(0, &[1, 2]).unwrap());
    assert_eq!(bus.state(), State::Faulted(Fault::ParametersCorrupt));
    bus.on_frame(Micros(30), &Frame::new(0, &[0x80, 2]).unwrap());
    store(&mut bus, 0x11, 1, b"load");
    bus.finish_store(Ok(()));
    bus.on_frame(Micros(40), &Frame::new(0, &[1, 2]).unwrap());
    let now = State::Faulted(Fault::Unconfigured);
    assert_eq!(bus.state(), now, "a start finds that fault gone");
}

#[test]
fn a_corrupt_image_is_refused_whatever_bit_is_wrong() {
    let image = saved();
    for at in 0..image.len() {
        let mut bad = image.clone();
        bad[at] ^= 0x10;
        refused(Stored::Image(&bad), [0, 0, 0]);
        refused(Stored::Image(&image[..at]), [0, 0, 0]);
    }
    refused(Stored::Unreadable, [0, 0, 0]);
}

#[test]
fn a_value_out_of_its_limits_refuses_the_whole_image_and_is_named() {
    let with = |index: u16, value: f32| {
        let mut image = std::vec![2, 7, 0, 0];
        image.extend(index.to_le_bytes());
        image.push(1);
        image.extend(value.to_le_bytes());
        let crc = crc32(image.iter().copied());
        [&crc.to_le_bytes()[..], &image].concat()
    };
    assert_eq!(
        half_track(&mut robot(Stored::Image(&with(0x2010, 0.4)))),
        0.4
    );
    // Half track may be 0.02 to 5 m; there is no object 0x2FFF; 0x2110 is not kept.
    refused(Stored::Image(&with(0x2010, 6.0)), [0x10, 0x20, 1]);
    refused(Stored::Image(&with(0x2010, f32::NAN)), [0x10, 0x20, 1]);
    refused(Stored::Image(&with(0x2FFF, 0.4)), [0xFF, 0x2F, 1]);
    refused(Stored::Image(&with(0x2110, 0.4)), [0x10, 0x21, 1]);
}

fn lss(bus: &mut BusSide, data: [u8; 8]) -> Vec<Frame> {
    bus.on_frame(Micros(15), &Frame::new(0x7E5, &data).unwrap());
    core::iter::from_fn(|| bus.pop_frame()).collect()
}

/// Gives a robot a node-ID by LSS and stores it; the image.
fn with_node(bus: &mut BusSide, node: u8) -> Option<Vec<u8>> {
    lss(bus, [0x04, 1, 0, 0, 0, 0, 0, 0]);
    lss(bus, [0x11, node, 0, 0, 0, 0, 0, 0]);
    let answer = lss(bus, [0x17, 0, 0, 0, 0, 0, 0, 0]);
    let image = bus.image_to_store().map(<[u8]>::to_vec);
    if image.is_some() {
        assert!(answer.is_empty(), "it waits");
        bus.finish_store(Ok(()));
        let frame = bus.pop_frame().unwrap();
        assert_eq!((frame.id(), &frame.data()[..2]), (0x7E4, &[0x17, 0][..]));
    } else {
        assert_eq!(answer[0].data()[..2], [0x17, 2]);
    }
    image
}

#[test]
fn a_node_given_by_lss_is_kept_with_everything_else_and_given_back() {
    let mut bus = robot(Stored::Image(&saved()));
    let image = with_node(&mut bus, 9).unwrap();
    assert_eq!(crate::stored_node(&image), NodeId::new(9));
    assert_eq!(half_track(&mut bus), 0.4);
    // The platform makes the next one with it; the switches say 2.
    let mut bus = robot(Stored::Image(&image));
    assert_eq!(half_track(&mut bus), 0.4, "the parameters are still there");
    let read = |bus: &mut BusSide, sub| answer(&request(bus, [0x40, 1, 0x20, sub, 0, 0, 0, 0]))[4];
    assert_eq!((read(&mut bus, 4), read(&mut bus, 5)), (2, 9));
    // Neither saving nor restoring touches it; 255 takes it away.
    set_half_track(&mut bus, 0.5);
    for (index, signature) in [(0x10, b"save"), (0x11, b"load")] {
        store(&mut bus, index, 1, signature);
        let image = bus.image_to_store().unwrap().to_vec();
        bus.finish_store(Ok(()));
        while bus.pop_frame().is_some() {}
        assert_eq!(crate::stored_node(&image), NodeId::new(9));
    }
    let image = with_node(&mut bus, 255).unwrap();
    assert_eq!(crate::stored_node(&image), None);
}

#[test]
fn a_node_no_robot_may_have_is_not_stored() {
    for node in [1, 18, 127] {
        let mut bus = robot(Stored::Nothing);
        lss(&mut bus, [0x04, 1, 0, 0, 0, 0, 0, 0]);
        let answer = lss(&mut bus, [0x11, node, 0, 0, 0, 0, 0, 0]);
        assert_eq!(answer[0].data()[..2], [0x11, 1]);
        // It can still store the one that it has.
        let image = with_node(&mut bus, node).unwrap();
        assert_eq!(crate::stored_node(&image), NodeId::new(2));
    }
}

#[test]
fn an_image_that_is_not_whole_has_no_node() {
    let image = with_node(&mut robot(Stored::Nothing), 9).unwrap();
    for at in 0..image.len() {
        let mut bad = image.clone();
        bad[at] ^= 0x10;
        assert_eq!(crate::stored_node(&bad), None);
        assert_eq!(crate::stored_node(&image[..at]), None);
    }
}

/// After the reset that makes the new node take effect, the robot is that node in every respect.
#[test]
fn a_node_given_by_lss_is_the_members_own_after_a_reset() {
    let mut bus = robot(Stored::Nothing);
    lss(&mut bus, [0x04, 1, 0, 0, 0, 0, 0, 0]);
    lss(&mut bus, [0x11, 9, 0, 0, 0, 0, 0, 0]);
    lss(&mut bus, [0x04, 0, 0, 0, 0, 0, 0, 0]);
    bus.on_frame(Micros(20), &Frame::new(0, &[0x82, 2]).unwrap());
    bus.poll(Micros(21));
    let boot_up = core::iter::from_fn(|| bus.pop_frame()).find(|frame| frame.id() == 0x709);
    assert_eq!(boot_up.unwrap().data(), [0]);
    for (address, value) in super::world::configuration(0, 1 << 9) {
        let [low, high] = address.index.to_le_bytes();
        let [a, b, c, d] = value.to_bytes();
        let command = 0x23 | (4 - value.kind().bytes()) << 2;
        let data = [command, low, high, address.sub, a, b, c, d];
        bus.on_frame(Micros(30), &Frame::new(0x609, &data).unwrap());
    }
    while bus.pop_frame().is_some() {}
    bus.on_frame(Micros(40), &Frame::new(0, &[1, 9]).unwrap());
    // Node 9 is a member; node 2, which it was, is not.
    assert_eq!(bus.state(), State::Armed);
}

#[test]
fn what_the_store_has_been_through_can_be_read() {
    let mut bus = robot(Stored::Nothing);
    bus.counters_mut().store = crate::StoreWear {
        saves: 41,
        erases: 2,
        cut: 1,
    };
    for (sub, count) in [(1, 41), (2, 2), (3, 1)] {
        let frames = request(&mut bus, [0x40, 0x26, 0x21, sub, 0, 0, 0, 0]);
        assert_eq!(answer(&frames)[4..], [count, 0, 0, 0]);
    }
}
