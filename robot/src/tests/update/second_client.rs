//! A second client or master during an update. It shares the identifiers of the first, so the robot
//! cannot tell them apart: an update may end early, but it never ends in another image.

use std::vec::Vec;

use boot::Slot;
use canopen::Frame;
use canopen::client::SdoClient;
use protocol::address as at;

use super::bench::{Bench, File, NODE};
use crate::update::{Problem, order};

/// CiA 301, table 22: no resource available, invalid sequence number, CRC error.
const NO_RESOURCE: u32 = 0x060A_0023;
const SEQUENCE: u32 = 0x0504_0003;
const CRC: u32 = 0x0504_0004;
/// The client's frame after which the other one speaks: in the second block.
const MIDDLE: usize = 45;

fn request(bytes: [u8; 8]) -> Frame {
    Frame::new(0x600 + u16::from(NODE), &bytes).unwrap()
}

/// What another client may begin: a read, each order of 0x1F51, and downloads.
fn requests() -> Vec<Frame> {
    let orders = [
        order::STOP,
        order::START,
        order::RESET,
        order::CLEAR,
        order::CONFIRM,
        order::GO_BACK,
    ];
    let mut all: Vec<_> = orders
        .into_iter()
        .map(|value| request([0x2F, 0x51, 0x1F, 1, value, 0, 0, 0]))
        .collect();
    all.push(request([0x40, 0x57, 0x1F, 1, 0, 0, 0, 0]));
    all.push(request([0x21, 0x50, 0x1F, 1, 0, 8, 0, 0]));
    all.push(request([0xC6, 0x50, 0x1F, 1, 0, 8, 0, 0]));
    all
}

/// The next update of a robot on which one came to nothing.
fn takes_the_next(bench: &mut Bench, bytes: &[u8], name: &Frame) {
    assert!(bench.is_unchanged(), "{name:?}");
    bench.control(order::STOP).unwrap();
    bench.control(order::CLEAR).unwrap();
    bench.download(bytes).unwrap();
    bench.control(order::START).unwrap();
    assert_eq!(bench.read(at::RUNNING_SLOT), 2, "{name:?}");
}

/// Between two segments a new request is refused, and the transfer goes on to its end.
#[test]
fn a_request_between_segments_is_refused_and_the_update_goes_on() {
    let bytes = File::new(|_| ()).download(Slot::B);
    for other in requests() {
        let mut bench = Bench::cleared();
        let size = (bytes.len() as u32).to_le_bytes();
        let start = [0x21, 0x50, 0x1F, 1, size[0], size[1], size[2], size[3]];
        bench.bus.on_frame(bench.now, &request(start));
        let parts = bytes.chunks(7);
        let last = parts.len() - 1;
        for (nth, part) in parts.enumerate() {
            let mut segment = [0; 8];
            segment[1..=part.len()].copy_from_slice(part);
            segment[0] = (nth as u8 & 1) << 4 | (7 - part.len() as u8) << 1 | (nth == last) as u8;
            bench.bus.on_frame(bench.now, &request(segment));
            bench.work();
            while let Some(answer) = bench.bus.pop_frame() {
                assert_ne!(answer.data()[0], 0x80, "{other:?}");
            }
            if nth == MIDDLE {
                bench.bus.on_frame(bench.now, &other);
                let [_, low, high, sub, ..] = *other.padded();
                let [a, b, c, d] = NO_RESOURCE.to_le_bytes();
                let answer = bench.bus.pop_frame().unwrap();
                assert_eq!(answer.data(), [0x80, low, high, sub, a, b, c, d]);
            }
        }
        assert_eq!(bench.read(at::FLASH_STATUS), 0, "{other:?}");
        bench.control(order::START).unwrap();
        assert_eq!(bench.read(at::RUNNING_SLOT), 2, "{other:?}");
    }
}

/// Within a block a request is a segment with an impossible number: the transfer ends, nothing is
/// started, and the next update is taken.
#[test]
fn a_request_within_a_block_ends_the_update_and_the_next_one_is_taken() {
    let bytes = File::new(|_| ()).download(Slot::B);
    for other in requests() {
        let mut bench = Bench::cleared();
        assert_eq!(
            beside(&mut bench, &bytes, other),
            Err(SEQUENCE),
            "{other:?}"
        );
        assert_eq!(bench.problem(), Problem::Transfer as u32, "{other:?}");
        takes_the_next(&mut bench, &bytes, &other);
    }
}

/// A frame that happens to be the next segment takes the place of the client's own.
#[test]
fn a_foreign_segment_within_a_block_is_noticed_at_its_end() {
    let bytes = File::new(|_| ()).download(Slot::B);
    // The first frame starts the transfer, so the next is segment 13 of the second block.
    let number = (MIDDLE - 32) as u8;
    let other = request([number, 1, 2, 3, 4, 5, 6, 7]);
    let mut bench = Bench::cleared();
    assert_eq!(beside(&mut bench, &bytes, other), Err(CRC));
    takes_the_next(&mut bench, &bytes, &other);
}

/// A second master that starts, stops or resets the robots.
#[test]
fn another_master_ends_the_update_and_the_old_image_runs() {
    let bytes = File::new(|_| ()).download(Slot::B);
    // Start, stop, reset of the node and of its communication (CiA 301, 7.2.8.3.1).
    for command in [1, 2, 129, 130] {
        let mut bench = Bench::cleared();
        let size = (bytes.len() as u32).to_le_bytes();
        let start = [0xC6, 0x50, 0x1F, 1, size[0], size[1], size[2], size[3]];
        bench.bus.on_frame(bench.now, &request(start));
        for number in 1..=20 {
            bench.bus.on_frame(bench.now, &request([number; 8]));
            bench.work();
        }
        bench.nmt(command);
        bench.nmt(128);
        // The server waits a second for the rest of the transfer.
        bench.pass(1_500, false);
        let name = Frame::new(0, &[command, NODE]).unwrap();
        takes_the_next(&mut bench, &bytes, &name);
    }
}

/// While a sector is erased, or the image read back, nothing else can be begun.
#[test]
fn an_order_while_the_robot_is_busy_is_refused() {
    let mut bench = Bench::new();
    bench.control(order::STOP).unwrap();
    bench.works = false;
    bench.control(order::CLEAR).unwrap();
    let orders = [
        order::STOP,
        order::START,
        order::RESET,
        order::CLEAR,
        order::CONFIRM,
        order::GO_BACK,
    ];
    for value in orders {
        assert_eq!(bench.control(value), Err(0x0800_0022), "{value}");
    }
    bench.works = true;
    bench.work();
    let bytes = File::new(|_| ()).download(Slot::B);
    bench.download(&bytes).unwrap();
    bench.control(order::START).unwrap();
    assert_eq!(bench.read(at::RUNNING_SLOT), 2);
}

/// A download in blocks, with one frame of another client in the middle.
fn beside(bench: &mut Bench, bytes: &[u8], other: Frame) -> Result<(), u32> {
    let mut client: SdoClient<'_> = Bench::client();
    let now = canopen::Micros(bench.now.0);
    client
        .download_block_of(now, at::PROGRAM_DATA.index, at::PROGRAM_DATA.sub, bytes)
        .unwrap();
    bench
        .transfer_beside(&mut client, &[other], MIDDLE)
        .map(|_| ())
}
