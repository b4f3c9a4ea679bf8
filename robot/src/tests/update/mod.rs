//! An update over the bus, from the client's first request to the reset, and what is refused.

pub mod bench;
mod parameters;
mod power;
mod second_client;

use std::vec;

use boot::Flash;
use boot::Slot;
use boot::header::{Board, LENGTH};
use boot::records::State;
use canopen::{Frame, NodeId};
use control::interface::Report;
use protocol::address as at;

use crate::update::{Job, Problem, order};
use crate::{BusSide, Identity};
use bench::{Bench, File, NODE};

/// The whole sequence of Zephyr's client.
#[test]
fn a_foreign_client_updates_a_robot() {
    let mut bench = Bench::new();
    assert_eq!(bench.read(at::FLASH_STATUS), 0);
    assert_eq!(bench.read(at::PROGRAM_IDENTIFICATION), Identity::FIRMWARE);
    assert_eq!(bench.read(at::PROGRAM_CONTROL), 1);
    assert_eq!(
        (bench.read(at::RUNNING_SLOT), bench.read(at::WANTED_SLOT)),
        (1, 2)
    );
    bench.control(order::STOP).unwrap();
    bench.works = false;
    bench.control(order::CLEAR).unwrap();
    assert_eq!(
        bench.read(at::FLASH_STATUS),
        1,
        "busy before the first sector"
    );
    bench.works = true;
    bench.work();
    assert_eq!(bench.jobs, [Job::Erase(0), Job::Erase(1)]);
    assert_eq!(bench.chip.erased, [7, 6], "that with the tail first");
    assert_eq!(bench.read(at::FLASH_STATUS), 0);
    assert_eq!(bench.read(at::PROGRAM_CONTROL), 3);
    let file = File::new(|_| ());
    bench.download(&file.download(Slot::B)).unwrap();
    assert_eq!(bench.read(at::FLASH_STATUS), 0);
    assert_eq!(bench.read(at::OTHER_VERSION), 0x0002_0000);
    let new = bench.read(at::PROGRAM_IDENTIFICATION);
    assert_ne!(new, Identity::FIRMWARE);
    assert!(bench.is_unchanged());
    bench.control(order::START).unwrap();
    assert_eq!(bench.resets, 1);
    assert_eq!(bench.read(at::RUNNING_SLOT), 2);
    assert_eq!(bench.read(at::PROGRAM_IDENTIFICATION), new);
    assert_eq!(bench.read(at::PROGRAM_CONTROL), 0x80);
    bench.control(order::CONFIRM).unwrap();
    assert_eq!(bench.read(at::PROGRAM_CONTROL), 1);
    let settled = State::read(&bench.chip, Slot::B);
    assert!(matches!(
        settled,
        State::Confirmed {
            is_settled: true,
            ..
        }
    ));
    assert_eq!(bench.read(at::SECURITY_COUNTER), 3);
    // And back again into slot A, by the same way.
    bench.control(order::STOP).unwrap();
    bench.control(order::CLEAR).unwrap();
    bench.download(&file.download(Slot::A)).unwrap();
    bench.control(order::START).unwrap();
    bench.control(order::CONFIRM).unwrap();
    assert_eq!(bench.read(at::RUNNING_SLOT), 1);
}

/// Every bit of the header and some of the image.
#[test]
fn one_wrong_bit_is_enough() {
    let good = File::new(|_| ()).download(Slot::B);
    // Only the link for the other slot may differ, and that is signed, too.
    let bits = (0..LENGTH * 8).chain((LENGTH * 8..good.len() * 8).step_by(97));
    for bit in bits {
        let mut bytes = good.clone();
        bytes[bit / 8] ^= 1 << (bit % 8);
        let mut bench = Bench::cleared();
        let taken = bench.download(&bytes);
        let problem = bench.problem();
        assert_ne!(problem, Problem::None as u32, "bit {bit}");
        assert!(
            taken.is_err() || bench.read(at::FLASH_STATUS) > 1,
            "bit {bit}"
        );
        let _ = bench.control(order::START);
        assert!(bench.is_unchanged(), "bit {bit}");
        assert_eq!(
            State::read(&bench.chip, Slot::B),
            State::Receiving,
            "bit {bit}"
        );
    }
}

#[test]
fn what_is_not_for_this_robot_is_refused_with_its_reason() {
    let file = File::new(|_| ());
    let swapped = [&file.header[..], &file.a].concat();
    let mut longer = file.download(Slot::B);
    longer.extend([0; 4]);
    let other_link = {
        // As long as the right one, so that only the hash tells.
        let mut bytes = file.download(Slot::A);
        bytes.extend([0; 4]);
        bytes
    };
    for (bytes, code, problem) in [
        (
            File::new(|header| header.board = Board::ROBOMASTER_C).download(Slot::B),
            Some(0x0604_0043),
            Problem::Board,
        ),
        (
            File::new(|header| header.hardware = 2).download(Slot::B),
            Some(0x0604_0043),
            Problem::Hardware,
        ),
        (
            File::new(|header| header.security_counter = 1).download(Slot::B),
            Some(0x0604_0043),
            Problem::Downgrade,
        ),
        (
            File::signed(b"the key of somebody else, 32 byt", |_| ()).download(Slot::B),
            None,
            Problem::Signature,
        ),
        (swapped, Some(0x0607_0010), Problem::Length),
        (longer, Some(0x0607_0010), Problem::Length),
        (other_link, None, Problem::Hash),
        (
            file.download(Slot::B)[..1_000].to_vec(),
            Some(0x0607_0010),
            Problem::Length,
        ),
        (vec![0; 0x5_0000], Some(0x0607_0012), Problem::Length),
        (vec![0; 100], Some(0x0607_0013), Problem::Length),
        (vec![], Some(0x0607_0013), Problem::Length),
        (vec![0; 3_000], Some(0x0609_0030), Problem::Header),
    ] {
        let mut bench = Bench::cleared();
        assert_eq!(bench.download(&bytes).err(), code, "{problem:?}");
        assert_eq!(bench.problem(), problem as u32);
        assert!(bench.is_unchanged());
        let _ = bench.control(order::START);
        assert!(bench.is_unchanged());
        // A right one, later, is taken.
        bench.control(order::STOP).unwrap();
        bench.control(order::CLEAR).unwrap();
        bench.download(&file.download(Slot::B)).unwrap();
        assert_eq!(bench.problem(), 0);
        bench.control(order::START).unwrap();
        assert_eq!(bench.read(at::RUNNING_SLOT), 2);
    }
}

#[test]
fn equal_and_lower_versions_are_taken_with_a_security_counter_that_is_not_lower() {
    for version in [0, Identity::FIRMWARE] {
        let file = File::new(|header| {
            header.version = version;
            header.security_counter = 2;
        });
        let mut bench = Bench::cleared();
        bench.download(&file.download(Slot::B)).unwrap();
        bench.control(order::START).unwrap();
        assert_eq!(bench.read(at::RUNNING_SLOT), 2);
    }
}

#[test]
fn nothing_is_permitted_in_the_wrong_order_or_state() {
    const DEVICE_STATE: Result<(), u32> = Err(0x0800_0022);
    let download = File::new(|_| ()).download(Slot::B);
    let mut bench = Bench::new();
    assert_eq!(bench.control(order::CLEAR), DEVICE_STATE, "not stopped");
    assert_eq!(bench.download(&download), DEVICE_STATE, "not cleared");
    assert_eq!(bench.control(0x42), Err(0x0609_0030));
    assert_eq!(bench.control(order::GO_BACK), DEVICE_STATE, "nothing there");
    bench.control(order::START).unwrap();
    assert_eq!(bench.resets, 0, "there is nothing new to start");
    bench.nmt(1);
    for value in [order::STOP, order::CLEAR, order::START, order::CONFIRM] {
        assert_eq!(bench.control(value), DEVICE_STATE, "OPERATIONAL");
    }
    assert_eq!(bench.download(&download), DEVICE_STATE);
    assert_eq!(bench.jobs, []);
    // Sent twice: the second finds a slot that is not erased.
    let mut bench = Bench::cleared();
    bench.download(&download).unwrap();
    assert_eq!(bench.download(&download), DEVICE_STATE);
    bench.control(order::START).unwrap();
    assert_eq!(bench.read(at::RUNNING_SLOT), 2);
}

#[test]
fn a_robot_without_slots_says_that_it_takes_no_update() {
    let mut bench = Bench::new();
    bench.bus = BusSide::new(Identity::new(NodeId::new(NODE).unwrap(), 1));
    bench.bus.poll(bench.now);
    while bench.bus.pop_frame().is_some() {}
    assert_eq!(bench.read(at::RUNNING_SLOT), 0);
    assert_eq!(bench.control(order::STOP), Err(0x0601_0000));
    assert_eq!(bench.download(&[0; 900]), Err(0x0601_0000));
}

/// A client that does not say how long its download is.
#[test]
fn a_download_of_unknown_length_has_to_be_that_of_its_header() {
    let whole = File::new(|_| ()).download(Slot::B);
    for (length, answer) in [(whole.len(), 0x20), (whole.len() - 4, 0x80)] {
        let mut bench = Bench::cleared();
        let request = |bench: &mut Bench, request: [u8; 8]| {
            bench
                .bus
                .on_frame(bench.now, &Frame::new(0x602, &request).unwrap());
            bench.work();
            bench.bus.pop_frame().unwrap().data()[0]
        };
        assert_eq!(request(&mut bench, [0x20, 0x50, 0x1F, 1, 0, 0, 0, 0]), 0x60);
        let parts = whole[..length].chunks(7);
        let last = parts.len() - 1;
        for (nth, part) in parts.enumerate() {
            let mut segment = [0; 8];
            segment[0] = (nth as u8 & 1) << 4 | (7 - part.len() as u8) << 1;
            segment[0] |= u8::from(nth == last);
            segment[1..1 + part.len()].copy_from_slice(part);
            let got = request(&mut bench, segment);
            let want = if nth == last { answer } else { 0x20 };
            assert_eq!(got & 0xE0, want, "{nth}");
        }
        let problem = if answer == 0x20 {
            Problem::None
        } else {
            Problem::Length
        };
        assert_eq!(bench.problem(), problem as u32);
    }
}

/// A transfer that ends early, for whatever reason, leaves the old image, and another one follows.
#[test]
fn a_transfer_that_ends_early_is_begun_anew() {
    let file = File::new(|_| ());
    let abort: [u8; 8] = [0x80, 0x50, 0x1F, 1, 0, 0, 0, 8];
    let ends: [fn(&mut Bench, [u8; 8]); 3] = [
        |bench, abort| {
            bench
                .bus
                .on_frame(bench.now, &Frame::new(0x602, &abort).unwrap())
        },
        |bench, _| bench.pass(1_500, false),
        |bench, _| {
            bench.nmt(1);
            bench.nmt(128);
        },
    ];
    for end in ends {
        let mut bench = Bench::cleared();
        let bytes = file.download(Slot::B);
        let size = (bytes.len() as u32).to_le_bytes();
        let start = [0x21, 0x50, 0x1F, 1, size[0], size[1], size[2], size[3]];
        bench
            .bus
            .on_frame(bench.now, &Frame::new(0x602, &start).unwrap());
        for (nth, part) in bytes[..700].chunks(7).enumerate() {
            let mut segment = [(nth as u8 & 1) << 4; 8];
            segment[1..].copy_from_slice(part);
            bench
                .bus
                .on_frame(bench.now, &Frame::new(0x602, &segment).unwrap());
            bench.work();
        }
        while let Some(answer) = bench.bus.pop_frame() {
            assert_ne!(answer.data()[0], 0x80);
        }
        end(&mut bench, abort);
        // An aborted segment of the old transfer does not go on either.
        while bench.bus.pop_frame().is_some() {}
        bench.pass(1_500, false);
        assert_eq!(bench.problem(), Problem::Transfer as u32);
        assert_eq!(bench.read(at::FLASH_STATUS), 2);
        assert!(bench.is_unchanged());
        bench.control(order::STOP).unwrap();
        bench.control(order::CLEAR).unwrap();
        bench.download(&bytes).unwrap();
        bench.control(order::START).unwrap();
        assert_eq!(bench.read(at::RUNNING_SLOT), 2);
    }
}

/// Flash that fails at every operation of an update in turn.
#[test]
fn flash_that_fails_leaves_the_old_image() {
    let bytes = File::new(|_| ()).download(Slot::B);
    for left in (0..8).chain([200, 490, 503, 504, 505, 509, 510, 511]) {
        let mut bench = Bench::new();
        bench.chip.left = Some(left);
        bench.control(order::STOP).unwrap();
        bench.control(order::CLEAR).unwrap();
        let _ = bench.download(&bytes);
        let _ = bench.control(order::START);
        let started = bench.resets > 0;
        // Two erases, two marks, 501 words, seven of the seal, one for the trial.
        assert_eq!(started, left >= 512, "{left}");
        assert!(bench.is_unchanged(), "{left}");
        assert_eq!(bench.problem(), Problem::Flash as u32, "{left}");
    }
}

#[test]
fn an_image_on_trial_confirms_itself_when_it_hears_its_master() {
    let mut bench = Bench::on_trial();
    // A pause of more than a second counts from the beginning.
    bench.pass(3_500, true);
    bench.pass(1_500, false);
    bench.pass(4_900, true);
    assert_eq!(bench.read(at::PROGRAM_CONTROL), 0x80);
    bench.pass(300, true);
    assert_eq!(bench.read(at::PROGRAM_CONTROL), 1);
}

#[test]
fn an_image_on_trial_that_hears_nobody_starts_three_times_and_gives_way() {
    let mut bench = Bench::on_trial();
    for _ in 0..3 {
        assert_eq!(bench.read(at::RUNNING_SLOT), 2);
        assert_eq!(bench.control(order::STOP), Err(0x0800_0022), "on trial");
        bench.pass(61_000, false);
    }
    assert_eq!(bench.read(at::RUNNING_SLOT), 1);
    assert_eq!(bench.read(at::PROGRAM_CONTROL), 1);
}

#[test]
fn a_confirmed_robot_goes_back_to_the_image_before() {
    let mut bench = Bench::on_trial();
    bench.control(order::CONFIRM).unwrap();
    bench.control(order::GO_BACK).unwrap();
    assert_eq!(bench.read(at::RUNNING_SLOT), 1);
}

/// While something is being stored.
#[test]
fn an_update_does_not_begin_while_parameters_are_stored() {
    let mut bench = Bench::new();
    // LSS stores a node; the answer comes when the platform has stored it.
    for request in [
        [4, 1, 0, 0, 0, 0, 0, 0],
        [17, 3, 0, 0, 0, 0, 0, 0],
        [23, 0, 0, 0, 0, 0, 0, 0],
    ] {
        let frame = Frame::new(0x7E5, &request).unwrap();
        bench.bus.on_frame(bench.now, &frame);
    }
    assert!(bench.bus.image_to_store().is_some());
    assert_eq!(bench.control(order::STOP), Err(0x0800_0022));
    bench.bus.finish_store(Ok(()));
    bench.control(order::STOP).unwrap();
}

/// Outputs that are not known to be off.
#[test]
fn an_update_needs_the_outputs_off() {
    let mut bench = Bench::new();
    bench.bus.on_report(&Report {
        mode: control::interface::Mode::Hold,
        ..Report::NONE
    });
    assert_eq!(bench.control(order::STOP), Err(0x0800_0022));
}

/// While a sector is erased, code that knows nothing of CANopen speaks for the robot.
#[test]
fn the_stand_in_says_what_the_robot_would_say() {
    let mut bench = Bench::new();
    bench.works = false;
    bench.control(order::STOP).unwrap();
    bench.control(order::CLEAR).unwrap();
    let stand_in = bench.bus.stand_in().unwrap();
    assert_eq!(stand_in.node, NodeId::new(NODE).unwrap());
    bench.bus.on_frame(bench.now, &stand_in.question);
    assert_eq!(bench.bus.pop_frame(), Some(stand_in.answer));
    assert_eq!(stand_in.answer.data()[4] & 1, 1, "busy");
    let period = bench.read(protocol::Address::new(0x1017, 0));
    assert_eq!(u32::from(stand_in.heartbeat_ms), period);
    let mut beats = 0;
    for _ in 0..2 * period {
        bench.now = bench.now + control::time::Micros(1_000);
        bench.bus.poll(bench.now);
        while let Some(frame) = bench.bus.pop_frame() {
            assert_eq!(frame, stand_in.heartbeat);
            beats += 1;
        }
    }
    assert_eq!(beats, 2);
}

/// The second word of a confirmation may read otherwise the next time, so it is written again.
#[test]
fn a_confirmation_that_was_cut_is_settled_at_the_next_start_and_once() {
    let cut = || {
        let mut bench = Bench::on_trial();
        // Words 12 and 13 of what is known about the slot: one is whole, the power fails in the
        // other.
        let word = |nth: u32| Slot::B.tail() + 4 * nth;
        bench.chip.program(word(12), 0).unwrap();
        bench.chip.program(word(13), 0xFFFF_0000).unwrap();
        bench.restart();
        bench
    };
    let is_settled = |bench: &Bench| match State::read(&bench.chip, Slot::B) {
        State::Confirmed { is_settled, .. } => is_settled,
        other => panic!("{other:?}"),
    };
    let mut bench = cut();
    assert!(!is_settled(&bench));
    bench.jobs.clear();
    bench.pass(100, false);
    assert!(is_settled(&bench));
    assert_eq!(bench.jobs, [Job::Confirm]);
    bench.restart();
    bench.pass(100, false);
    assert_eq!(bench.jobs, [Job::Confirm], "it is settled");
    // Flash that cannot be written is not tried again and again.
    let mut bench = cut();
    bench.jobs.clear();
    bench.chip.left = Some(0);
    bench.pass(100, false);
    assert_eq!(bench.jobs, [Job::Confirm]);
    assert!(!is_settled(&bench));
}
