//! Downloads into a sink.

use super::*;
use crate::client::{Outcome, SdoClient, SdoError};

/// The start of a segmented download of the sink's object.
const fn start(len: u32) -> [u8; 8] {
    let [a, b, c, d] = len.to_le_bytes();
    [0x21, 0x06, 0x20, 1, a, b, c, d]
}

/// The same as a block transfer with CRC.
const fn start_block(len: u32) -> [u8; 8] {
    let [a, b, c, d] = len.to_le_bytes();
    [0xC6, 0x06, 0x20, 1, a, b, c, d]
}

const SEGMENT: [u8; 8] = [0x00, 1, 2, 3, 4, 5, 6, 7];
const LAST: [u8; 8] = [0x1B, 8, 9, 0, 0, 0, 0, 0];

fn code(answer: [u8; 8]) -> Option<u32> {
    let code = u32::from_le_bytes(answer[4..].try_into().unwrap());
    (answer[0] == 0x80).then_some(code)
}

fn image(len: usize) -> Vec<u8> {
    (0..len).map(|at| (at * 7 + at / 256) as u8).collect()
}

/// Writes a value by block transfer. Every so many frames one is lost, but neither the first nor
/// the last of a block, for which the client would have to wait.
fn download(bench: &mut Bench, value: &[u8], lost: usize) -> Outcome {
    let mut client = SdoClient::new(NODE, Micros::from_millis(100));
    client
        .download_block_of(bench.now, 0x2006, 1, value)
        .unwrap();
    let mut sent = 0usize;
    loop {
        if let Some(frame) = bench.device.pop_frame() {
            if let Some(outcome) = client.on_frame(bench.now, &frame) {
                return outcome;
            }
            continue;
        }
        let frame = client.pop_frame().expect("one of the two has to speak");
        sent += 1;
        if !sent.is_multiple_of(lost) || !(2..32).contains(&frame.data()[0]) {
            bench.device.on_frame(bench.now, &frame, &mut bench.app);
        }
    }
}

#[test]
fn a_sink_gets_segments_as_they_come_and_the_end() {
    let mut bench = Bench::booted(CONFIG);
    assert_eq!(bench.sdo(start(9))[0], 0x60);
    let begun = (Some(9), NmtState::PreOperational);
    assert_eq!(bench.app.received.begun, [begun]);
    assert_eq!(bench.sdo(SEGMENT)[0], 0x20);
    assert_eq!(bench.app.received.finished, 0);
    assert_eq!(bench.sdo(LAST)[0], 0x30);
    let received = &bench.app.received;
    assert_eq!(received.bytes, [1, 2, 3, 4, 5, 6, 7, 8, 9]);
    assert_eq!((received.finished, received.cancelled), (1, 0));
    let written = Event::ObjectWritten {
        index: 0x2006,
        sub: 1,
    };
    assert_eq!(bench.events(), [written]);
}

#[test]
fn short_values_reach_a_sink_too() {
    let mut bench = Bench::booted(CONFIG);
    assert_eq!(bench.write(0x2006, 1, &[1, 2, 3]), Ok(()));
    assert_eq!(bench.app.received.bytes, [1, 2, 3]);
    assert_eq!(bench.app.received.finished, 1);
}

/// 224 bytes are a block of 32 segments; lengths around it, and one of thousands.
#[test]
fn a_sink_gets_blocks_of_any_length_and_what_was_lost_is_repeated() {
    for len in [1, 6, 7, 8, 223, 224, 225, 511, 512, 5_000] {
        for lost in [usize::MAX, 7] {
            let mut bench = Bench::booted(CONFIG);
            let value = image(len);
            let outcome = download(&mut bench, &value, lost);
            assert_eq!(outcome, Outcome::Downloaded, "{len} {lost}");
            assert_eq!(bench.app.received.bytes, value, "{len} {lost}");
            assert_eq!(bench.app.received.finished, 1);
        }
    }
}

#[test]
fn a_value_of_another_length_than_announced_is_refused() {
    for (requests, expected) in [
        (&[start(0)][..], 0x0607_0013),
        (&[start(10), SEGMENT, LAST], 0x0607_0013),
        (&[start(8), SEGMENT, LAST], 0x0607_0012),
        (&[start(1), SEGMENT], 0x0607_0012),
    ] {
        let mut bench = Bench::booted(CONFIG);
        let last = requests.iter().map(|request| bench.sdo(*request)).last();
        assert_eq!(code(last.unwrap()), Some(expected), "{requests:02X?}");
        let received = &bench.app.received;
        assert_eq!(received.finished, 0);
        assert_eq!(received.cancelled, received.begun.len());
        assert!(bench.read(0x1000, 0).is_ok());
    }
}

/// A client that announces 14 bytes and sends a third segment is stopped by that segment, not at
/// the end of the block.
#[test]
fn a_block_that_goes_on_past_the_announced_length_is_stopped_at_once() {
    let mut bench = Bench::booted(CONFIG);
    assert_eq!(bench.sdo(start_block(14))[0], 0xA4);
    for seq in [1, 2] {
        bench.receive(0x605, [seq, 1, 2, 3, 4, 5, 6, 7]);
    }
    assert_eq!(code(bench.sdo([3, 1, 2, 3, 4, 5, 6, 7])), Some(0x0607_0012));
    assert_eq!(bench.app.received.cancelled, 1);
}

#[test]
fn a_wrong_crc_cancels_before_the_end() {
    let mut bench = Bench::booted(CONFIG);
    bench.sdo(start_block(9));
    bench.receive(0x605, [1, b'1', b'2', b'3', b'4', b'5', b'6', b'7']);
    assert_eq!(bench.sdo([0x82, b'8', b'9', 0, 0, 0, 0, 0])[0], 0xA2);
    // Right would be 0x31C3 (CIA 301, 7.2.4.3.16).
    let answer = bench.sdo([0xD5, 0xC2, 0x31, 0, 0, 0, 0, 0]);
    assert_eq!(code(answer), Some(0x0504_0004));
    assert_eq!(bench.app.received.finished, 0);
    assert_eq!(bench.app.received.cancelled, 1);
}

#[test]
fn what_the_sink_refuses_ends_the_transfer_with_its_code() {
    let mut bench = Bench::booted(CONFIG);
    bench.app.received.room = Some(300);
    let refused = Outcome::Failed(SdoError::Aborted(0x0606_0000));
    assert_eq!(download(&mut bench, &image(5_000), usize::MAX), refused);
    assert_eq!(bench.app.received.cancelled, 1);
    bench.app.received = Received {
        spoils: true,
        ..Received::default()
    };
    let refused = Outcome::Failed(SdoError::Aborted(0x0800_0020));
    assert_eq!(download(&mut bench, &image(5_000), usize::MAX), refused);
    assert_eq!(bench.app.received.cancelled, 1);
}

/// Abort, silence, NMT and reset each cancel once, and the next transfer starts from the beginning.
#[test]
fn a_transfer_that_does_not_end_is_cancelled_once() {
    let ends: [fn(&mut Bench); 5] = [
        |bench| bench.receive(0x605, [0x80, 0x06, 0x20, 1, 0, 0, 0, 8]),
        |bench| bench.pass(1_000),
        |bench| bench.receive(0, [2, 0]),
        |bench| bench.receive(0, [129, 0]),
        |bench| bench.receive(0, [130, 0]),
    ];
    for (at, end) in ends.into_iter().enumerate() {
        let mut bench = Bench::booted(CONFIG);
        bench.sdo(start(9));
        bench.sdo(SEGMENT);
        end(&mut bench);
        assert_eq!(bench.app.received.cancelled, 1, "{at}");
        bench.receive(0, [128, 0]);
        bench.poll();
        bench.frames();
        bench.pass(2_000);
        bench.frames();
        assert_eq!(
            download(&mut bench, &image(600), usize::MAX),
            Outcome::Downloaded
        );
        assert_eq!(bench.app.received.bytes, image(600));
        assert_eq!(bench.app.received.cancelled, 1, "{at}");
    }
}

#[test]
fn a_second_client_does_not_disturb_a_stream() {
    let mut bench = Bench::booted(CONFIG);
    bench.sdo(start(9));
    bench.sdo(SEGMENT);
    assert_eq!(code(bench.sdo(start(9))), Some(0x060A_0023));
    assert_eq!(bench.sdo(LAST)[0], 0x30);
    assert_eq!(bench.app.received.bytes, [1, 2, 3, 4, 5, 6, 7, 8, 9]);
    assert_eq!(bench.app.received.begun.len(), 1);
}

/// Without a size in the request the value is as long as the object; what the object held is no
/// part of it.
#[test]
fn an_expedited_value_without_a_size_reaches_the_sink_alone() {
    for (sub, expected) in [(1, &[1, 2, 3, 4][..]), (2, &[1, 2])] {
        let mut bench = Bench::booted(CONFIG);
        assert_eq!(bench.sdo([0x22, 0x06, 0x20, sub, 1, 2, 3, 4])[0], 0x60);
        assert_eq!(bench.app.received.bytes, expected, "{sub}");
        assert_eq!(bench.app.received.finished, 1);
    }
}
