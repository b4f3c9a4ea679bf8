//! Parameters over an update: they lie beside both images, so that each reads what the other has
//! stored, or says what it cannot read and leaves it there for the other one.

use std::vec::Vec;

use boot::Slot;
use canopen::{Frame, NodeId};
use protocol::{Address, Fault, address as at, crc32};

use super::bench::{Bench, File, NODE};
use crate::State;
use crate::update::order;

/// What a robot that cannot read its image says of it: kind 3 and the object.
const STATUS: Address = Address::new(0x2002, 1);

fn half_track(bench: &mut Bench) -> f32 {
    f32::from_bits(bench.read(at::HALF_TRACK))
}

/// Writes the half track and saves it, as a master does.
fn save(bench: &mut Bench, half_track: f32) {
    bench
        .write(at::HALF_TRACK, &half_track.to_le_bytes())
        .unwrap();
    let request = [0x23, 0x10, 0x10, 1, b's', b'a', b'v', b'e'];
    let request = Frame::new(0x600 + u16::from(NODE), &request).unwrap();
    bench.bus.on_frame(bench.now, &request);
    bench.stored = bench.bus.image_to_store().unwrap().to_vec();
    bench.bus.finish_store(Ok(()));
    while bench.bus.pop_frame().is_some() {}
}

/// An image with half track 0.4 and node 7, of this format, then so many bytes.
fn image(format: u8, rest: &[u8]) -> Vec<u8> {
    let half_track = [&[0x10, 0x20, 1][..], &0.4_f32.to_le_bytes()].concat();
    let length = (half_track.len() + rest.len()) as u8;
    let content = [&[format, length, 0, 7], &half_track[..], rest].concat();
    let crc = crc32(content.iter().copied());
    [&crc.to_le_bytes()[..], &content].concat()
}

/// What an image on trial, one that is confirmed, and the one before it read.
#[test]
fn each_image_reads_what_the_other_has_saved() {
    let mut bench = Bench::new();
    save(&mut bench, 0.4);
    bench.control(order::STOP).unwrap();
    bench.control(order::CLEAR).unwrap();
    bench
        .download(&File::new(|_| ()).download(Slot::B))
        .unwrap();
    bench.control(order::START).unwrap();
    assert_eq!(bench.read(at::RUNNING_SLOT), 2);
    assert_eq!(half_track(&mut bench), 0.4);
    save(&mut bench, 0.5);
    // It is not confirmed.
    bench.pass(200_000, false);
    assert_eq!(bench.read(at::RUNNING_SLOT), 1);
    assert_eq!(half_track(&mut bench), 0.5);
    // The next is confirmed, saves, and is sent back.
    bench.control(order::STOP).unwrap();
    bench.control(order::CLEAR).unwrap();
    bench
        .download(&File::new(|_| ()).download(Slot::B))
        .unwrap();
    bench.control(order::START).unwrap();
    bench.control(order::CONFIRM).unwrap();
    assert_eq!(half_track(&mut bench), 0.5);
    save(&mut bench, 0.6);
    bench.control(order::GO_BACK).unwrap();
    assert_eq!(bench.read(at::RUNNING_SLOT), 1);
    assert_eq!(half_track(&mut bench), 0.6);
}

/// An older image has stored fewer parameters: the others have their defaults, on trial, after the
/// confirmation, and in the image before.
#[test]
fn parameters_that_an_older_image_did_not_have_are_at_their_defaults() {
    let mut bench = Bench::new();
    let default = bench.read(at::HALF_WHEELBASE);
    bench.stored = image(2, &[]);
    let stored = bench.stored.clone();
    bench.control(order::RESET).unwrap();
    let reads = |bench: &mut Bench, slot: u32| {
        assert_eq!(bench.read(at::RUNNING_SLOT), slot);
        assert_eq!(half_track(bench), 0.4);
        assert_eq!(bench.read(at::HALF_WHEELBASE), default);
        assert_ne!(bench.bus.state(), State::Faulted(Fault::ParametersCorrupt));
        assert_eq!(bench.stored, stored);
    };
    reads(&mut bench, 1);
    bench.control(order::STOP).unwrap();
    bench.control(order::CLEAR).unwrap();
    bench
        .download(&File::new(|_| ()).download(Slot::B))
        .unwrap();
    bench.control(order::START).unwrap();
    reads(&mut bench, 2);
    bench.control(order::CONFIRM).unwrap();
    reads(&mut bench, 2);
    bench.control(order::GO_BACK).unwrap();
    reads(&mut bench, 1);
}

/// A newer image has stored what the one before it cannot read. That one says so by the name of
/// the object, drops all of it, does not drive, and stores nothing over it: the newer one has it
/// all again.
#[test]
fn what_an_older_image_cannot_read_it_names_and_leaves_there() {
    let new_object = [&[0xFF, 0x20, 1][..], &[0; 4]].concat();
    let new_limit = [&[0x10, 0x20, 2][..], &1e6_f32.to_le_bytes()].concat();
    for (name, newer, object, node) in [
        ("object", image(2, &new_object), [1, 0xFF, 0x20], Some(7)),
        ("limit", image(2, &new_limit), [2, 0x10, 0x20], Some(7)),
        ("format", image(3, &[]), [0, 0, 0], None),
    ] {
        for is_confirmed in [false, true] {
            let mut bench = Bench::new();
            save(&mut bench, 0.3);
            bench.control(order::STOP).unwrap();
            bench.control(order::CLEAR).unwrap();
            let file = File::new(|_| ()).download(Slot::B);
            bench.download(&file).unwrap();
            bench.control(order::START).unwrap();
            // Its own format.
            bench.stored = newer.clone();
            if is_confirmed {
                bench.control(order::CONFIRM).unwrap();
                bench.control(order::GO_BACK).unwrap();
            } else {
                bench.pass(200_000, false);
            }
            assert_eq!(bench.read(at::RUNNING_SLOT), 1, "{name}");
            let refused = State::Faulted(Fault::ParametersCorrupt);
            assert_eq!(bench.bus.state(), refused, "{name}");
            let [sub, low, high] = object;
            let status = u32::from_le_bytes([3, sub, low, high]);
            assert_eq!(bench.read(STATUS), status, "{name}");
            assert_eq!(half_track(&mut bench), 0.2, "{name}: the default");
            // The node stays where the format is known, so its master finds it again.
            assert_eq!(crate::stored_node(&newer), node.and_then(NodeId::new));
            bench.nmt(1);
            assert_eq!(bench.bus.state(), refused, "{name}");
            bench.nmt(128);
            assert_eq!(bench.bus.image_to_store(), None, "{name}");
            // It takes the newer image again, with its parameters.
            bench.control(order::STOP).unwrap();
            bench.control(order::CLEAR).unwrap();
            bench.download(&file).unwrap();
            bench.control(order::START).unwrap();
            assert_eq!(bench.read(at::RUNNING_SLOT), 2, "{name}");
            assert_eq!(bench.stored, newer, "{name}");
        }
    }
}

/// An image on trial that cannot read what is stored does not confirm itself, whatever it hears,
/// and the one before, which can, comes back. Its client's word counts all the same.
#[test]
fn an_image_that_cannot_read_the_parameters_does_not_confirm_itself() {
    let on_trial = || {
        let mut bench = Bench::new();
        bench.control(order::STOP).unwrap();
        bench.control(order::CLEAR).unwrap();
        bench
            .download(&File::new(|_| ()).download(Slot::B))
            .unwrap();
        bench.stored = image(3, &[]);
        bench.control(order::START).unwrap();
        let refused = State::Faulted(Fault::ParametersCorrupt);
        assert_eq!(bench.bus.state(), refused);
        bench
    };
    let mut bench = on_trial();
    bench.pass(10_000, true);
    assert_eq!(bench.read(at::PROGRAM_CONTROL), u32::from(order::CONFIRM));
    bench.pass(190_000, true);
    assert_eq!(bench.read(at::RUNNING_SLOT), 1);
    let mut bench = on_trial();
    bench.control(order::CONFIRM).unwrap();
    assert_eq!(bench.read(at::PROGRAM_CONTROL), u32::from(order::START));
    assert_eq!(bench.read(at::RUNNING_SLOT), 2);
}
