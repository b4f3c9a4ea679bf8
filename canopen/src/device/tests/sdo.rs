//! The SDO server.

use super::*;

#[test]
fn reads_are_expedited_with_the_size() {
    let mut bench = Bench::booted(CONFIG);
    assert_eq!(
        bench.sdo([0x40, 0x00, 0x10, 0, 0, 0, 0, 0]),
        [0x43, 0x00, 0x10, 0, 0x03, 0x02, 0x01, 0x00]
    );
    assert_eq!(
        bench.sdo([0x40, 0x18, 0x10, 4, 0, 0, 0, 0]),
        [0x43, 0x18, 0x10, 4, 0x78, 0x56, 0x34, 0x12]
    );
    assert_eq!(
        bench.sdo([0x40, 0x17, 0x10, 0, 0, 0, 0, 0]),
        [0x4B, 0x17, 0x10, 0, 100, 0, 0, 0]
    );
    assert_eq!(
        bench.sdo([0x40, 0x18, 0x10, 0, 0, 0, 0, 0]),
        [0x4F, 0x18, 0x10, 0, 4, 0, 0, 0]
    );
}

#[test]
fn writes_are_confirmed_and_reported() {
    let mut bench = Bench::booted(CONFIG);
    assert_eq!(
        bench.sdo([0x2B, 0x00, 0x20, 0, 0x34, 0x12, 0, 0]),
        [0x60, 0x00, 0x20, 0, 0, 0, 0, 0]
    );
    assert_eq!(bench.app.setpoint, 0x1234);
    assert_eq!(
        bench.events(),
        [Event::ObjectWritten {
            index: 0x2000,
            sub: 0
        }]
    );
}

#[test]
fn a_write_that_does_not_say_its_size_has_that_of_the_object() {
    let mut bench = Bench::booted(CONFIG);
    assert_eq!(
        bench.sdo([0x22, 0x00, 0x20, 0, 0x34, 0x12, 0, 0]),
        [0x60, 0x00, 0x20, 0, 0, 0, 0, 0]
    );
    assert_eq!(bench.app.setpoint, 0x1234);
}

#[test]
fn refusals_say_why_and_change_nothing() {
    let mut bench = Bench::booted(CONFIG);
    assert_eq!(bench.read(0x2FFF, 0), Err(0x0602_0000));
    assert_eq!(bench.read(0x2000, 1), Err(0x0609_0011));
    assert_eq!(bench.read(0x2004, 0), Err(0x0601_0001));
    assert_eq!(bench.read(0x1018, 5), Err(0x0609_0011));
    assert_eq!(bench.write(0x1018, 1, &[0; 4]), Err(0x0601_0002));
    assert_eq!(bench.write(0x1018, 9, &[0; 4]), Err(0x0609_0011));
    assert_eq!(bench.write(0x1000, 0, &[0; 4]), Err(0x0601_0002));
    assert_eq!(bench.write(0x2002, 0, &[0; 2]), Err(0x0601_0002));
    assert_eq!(bench.write(0x2000, 0, &[1]), Err(0x0607_0013));
    assert_eq!(bench.write(0x2000, 0, &[1, 0, 0]), Err(0x0607_0012));
    assert_eq!(bench.write(0x1017, 0, &[1]), Err(0x0607_0013));
    assert_eq!(bench.write(0x1017, 0, &[1, 0, 0]), Err(0x0607_0012));
    assert_eq!(bench.write(0x1019, 0, &[1]), Err(0x0609_0032));
    assert_eq!(bench.write(0x1019, 0, &[241]), Err(0x0609_0031));
    let too_high = 1001u32.to_le_bytes();
    assert_eq!(bench.write(0x2001, 0, &too_high), Err(0x0609_0031));
    assert_eq!(bench.app.limited, 0);
    bench.receive(0, [1, 0]);
    assert_eq!(bench.write(0x2001, 0, &[0; 4]), Err(0x0800_0022));
    assert_eq!(bench.device.counters().sdo_aborts, 16);
}

#[test]
fn an_unknown_command_is_aborted_and_an_abort_is_not() {
    let mut bench = Bench::booted(CONFIG);
    assert_eq!(
        bench.sdo([0xE0, 0x00, 0x20, 0, 0, 0, 0, 0]),
        [0x80, 0x00, 0x20, 0, 0x01, 0x00, 0x04, 0x05]
    );
    bench.receive(0x605, [0x80, 0x00, 0x20, 0, 0, 0, 0, 8]);
    bench.receive(0x605, [0x40, 0x00, 0x20, 0]);
    assert_eq!(bench.frames(), []);
}

#[test]
fn no_answer_when_stopped() {
    let mut bench = Bench::booted(CONFIG);
    bench.receive(0, [2, 0]);
    bench.receive(0x605, [0x40, 0x00, 0x10, 0, 0, 0, 0, 0]);
    bench.poll();
    assert_eq!(bench.frames(), []);
}

#[test]
fn long_values_are_read_in_segments() {
    let mut bench = Bench::booted(CONFIG);
    assert_eq!(
        bench.sdo([0x40, 0x03, 0x20, 0, 0, 0, 0, 0]),
        [0x41, 0x03, 0x20, 0, 12, 0, 0, 0]
    );
    let mut first = [0x00; 8];
    first[1..].copy_from_slice(b"twelve ");
    assert_eq!(bench.sdo([0x60, 0, 0, 0, 0, 0, 0, 0]), first);
    let mut last = [0x15, 0, 0, 0, 0, 0, 0, 0];
    last[1..6].copy_from_slice(b"bytes");
    assert_eq!(bench.sdo([0x70, 0, 0, 0, 0, 0, 0, 0]), last);
    // It is over: another segment request has nothing to refer to.
    assert_eq!(bench.sdo([0x60, 0, 0, 0, 0, 0, 0, 0])[4..], [1, 0, 4, 5]);
}

#[test]
fn long_values_are_written_in_segments_and_all_at_once() {
    let mut bench = Bench::booted(CONFIG);
    assert_eq!(
        bench.sdo([0x21, 0x05, 0x20, 0, 9, 0, 0, 0]),
        [0x60, 0x05, 0x20, 0, 0, 0, 0, 0]
    );
    assert_eq!(
        bench.sdo([0x00, 1, 2, 3, 4, 5, 6, 7]),
        [0x20, 0, 0, 0, 0, 0, 0, 0]
    );
    assert_eq!(bench.app.long, []);
    assert_eq!(
        bench.sdo([0x1B, 8, 9, 0, 0, 0, 0, 0]),
        [0x30, 0, 0, 0, 0, 0, 0, 0]
    );
    assert_eq!(bench.app.long, [1, 2, 3, 4, 5, 6, 7, 8, 9]);
}

/// The code of the abort that answers the last of these requests.
fn abort_of(bench: &mut Bench, requests: &[[u8; 8]]) -> u32 {
    let answers: Vec<_> = requests.iter().map(|request| bench.sdo(*request)).collect();
    let (last, before) = answers.split_last().unwrap();
    assert!(
        before.iter().all(|answer| answer[0] != 0x80),
        "{answers:02X?}"
    );
    assert_eq!(last[0], 0x80, "{answers:02X?}");
    u32::from_le_bytes(last[4..].try_into().unwrap())
}

#[test]
fn broken_segmented_transfers_are_aborted_with_the_code_that_says_why() {
    let start = |len: u16| [0x21, 0x05, 0x20, 0, len as u8, (len >> 8) as u8, 0, 0];
    let segment = [0x00, 1, 2, 3, 4, 5, 6, 7];
    let last = [0x11, 1, 2, 3, 4, 5, 6, 7];
    for (requests, code) in [
        (&[start(14), segment, segment][..], 0x0503_0000),
        (&[start(14), [0x10, 1, 2, 3, 4, 5, 6, 7]], 0x0503_0000),
        (&[start(13), segment, last], 0x0607_0012),
        (&[start(15), segment, last], 0x0607_0013),
        (&[start(512)], 0x0504_0005),
        (&[[0x21, 0x06, 0x20, 0, 9, 0, 0, 0]], 0x0602_0000),
        (
            &[
                [0x21, 0x03, 0x20, 0, 7, 0, 0, 0],
                [0x01, 1, 2, 3, 4, 5, 6, 7],
            ],
            0x0601_0002,
        ),
        (&[start(14), [0x60, 0, 0, 0, 0, 0, 0, 0]], 0x0504_0001),
        (
            &[
                [0x40, 0x03, 0x20, 0, 0, 0, 0, 0],
                [0x70, 0, 0, 0, 0, 0, 0, 0],
            ],
            0x0503_0000,
        ),
    ] {
        let mut bench = Bench::booted(CONFIG);
        assert_eq!(abort_of(&mut bench, requests), code, "{requests:02X?}");
        assert_eq!(bench.app.long, []);
        // And the server is free again.
        assert!(bench.read(0x1000, 0).is_ok());
    }
}

#[test]
fn a_silent_client_loses_its_transfer_after_a_second() {
    let mut bench = Bench::booted(Config {
        heartbeat_ms: 0,
        ..CONFIG
    });
    bench.sdo([0x21, 0x05, 0x20, 0, 9, 0, 0, 0]);
    bench.pass(999);
    assert_eq!(bench.frames(), []);
    bench.pass(1);
    assert_eq!(
        bench.frames(),
        [Frame::of(0x585, [0x80, 0x05, 0x20, 0, 0, 0, 4, 5])]
    );
    bench.pass(10_000);
    assert_eq!(bench.frames(), []);
}

#[test]
fn a_second_client_is_refused_and_the_first_goes_on() {
    let mut bench = Bench::booted(CONFIG);
    bench.sdo([0x21, 0x05, 0x20, 0, 9, 0, 0, 0]);
    assert_eq!(bench.read(0x1000, 0), Err(0x060A_0023));
    bench.sdo([0x00, 1, 2, 3, 4, 5, 6, 7]);
    assert_eq!(bench.write(0x2000, 0, &[1, 0]), Err(0x060A_0023));
    bench.sdo([0x1B, 8, 9, 0, 0, 0, 0, 0]);
    assert_eq!(bench.app.long, [1, 2, 3, 4, 5, 6, 7, 8, 9]);
    assert_eq!(bench.app.setpoint, 0);
}

#[test]
fn an_nmt_reset_ends_a_transfer_without_a_word() {
    for command in [2, 129, 130] {
        let mut bench = Bench::booted(CONFIG);
        bench.sdo([0x21, 0x05, 0x20, 0, 9, 0, 0, 0]);
        bench.receive(0, [command, 0]);
        bench.receive(0, [128, 0]);
        bench.poll();
        bench.frames();
        assert_eq!(bench.sdo([0x00, 1, 2, 3, 4, 5, 6, 7])[0], 0x80);
    }
}

#[test]
fn a_block_is_read_with_its_crc() {
    let mut bench = Bench::booted(CONFIG);
    bench.app.long = b"123456789".to_vec();
    assert_eq!(
        bench.sdo([0xA4, 0x05, 0x20, 0, 127, 0, 0, 0]),
        [0xC6, 0x05, 0x20, 0, 9, 0, 0, 0]
    );
    bench.receive(0x605, [0xA3, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(
        bench.frames(),
        [
            Frame::of(0x585, *b"\x011234567"),
            Frame::of(0x585, *b"\x8289\0\0\0\0\0")
        ]
    );
    assert_eq!(
        bench.sdo([0xA2, 2, 127, 0, 0, 0, 0, 0]),
        [0xC1 | 5 << 2, 0xC3, 0x31, 0, 0, 0, 0, 0]
    );
    bench.receive(0x605, [0xA1, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(bench.frames(), []);
}

#[test]
fn a_block_is_written_if_its_crc_is_right() {
    for (crc, answer) in [
        (0x31C3u16, [0xA1, 0, 0, 0, 0, 0, 0, 0]),
        (0x31C4, [0x80, 0x05, 0x20, 0, 0x04, 0, 0x04, 0x05]),
    ] {
        let mut bench = Bench::booted(CONFIG);
        assert_eq!(
            bench.sdo([0xC6, 0x05, 0x20, 0, 9, 0, 0, 0]),
            [0xA4, 0x05, 0x20, 0, 32, 0, 0, 0]
        );
        bench.receive(0x605, *b"\x011234567");
        assert_eq!(bench.frames(), []);
        assert_eq!(
            bench.sdo(*b"\x8289\0\0\0\0\0"),
            [0xA2, 2, 32, 0, 0, 0, 0, 0]
        );
        let [low, high] = crc.to_le_bytes();
        assert_eq!(bench.sdo([0xC1 | 5 << 2, low, high, 0, 0, 0, 0, 0]), answer);
        assert_eq!(bench.app.long == b"123456789", crc == 0x31C3);
    }
}

#[test]
fn broken_block_transfers_are_aborted_with_the_code_that_says_why() {
    let download = [0xC6, 0x05, 0x20, 0, 9, 0, 0, 0];
    let upload = [0xA4, 0x03, 0x20, 0, 127, 0, 0, 0];
    for (requests, code) in [
        (&[[0xA4, 0x03, 0x20, 0, 0, 0, 0, 0]][..], 0x0504_0002),
        (&[[0xA4, 0x03, 0x20, 0, 128, 0, 0, 0]], 0x0504_0002),
        (&[[0xC6, 0x05, 0x20, 0, 0, 2, 0, 0]], 0x0504_0005),
        (&[download, [33, 0, 0, 0, 0, 0, 0, 0]], 0x0504_0003),
        (
            &[download, *b"\x811234567", [0xC1, 0, 0, 0, 0, 0, 0, 0]],
            0x0504_0004,
        ),
        (&[upload, [0xA2, 1, 127, 0, 0, 0, 0, 0]], 0x0504_0001),
        (&[[0xA1, 0, 0, 0, 0, 0, 0, 0]], 0x0504_0001),
        (&[[0xC1, 0, 0, 0, 0, 0, 0, 0]], 0x0504_0001),
    ] {
        let mut bench = Bench::booted(CONFIG);
        assert_eq!(abort_of(&mut bench, requests), code, "{requests:02X?}");
        assert_eq!(bench.app.long, []);
        assert!(bench.read(0x1000, 0).is_ok());
    }
    // An acknowledgement of what has not been sent.
    let mut bench = Bench::booted(CONFIG);
    bench.sdo(upload);
    bench.receive(0x605, [0xA3, 0, 0, 0, 0, 0, 0, 0]);
    bench.frames();
    let beyond = [0xA2, 3, 127, 0, 0, 0, 0, 0];
    assert_eq!(abort_of(&mut bench, &[beyond]), 0x0504_0003);
}

/// How a transfer is to be made.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Way {
    Plain,
    Block,
}

/// Runs a transfer between our client and a device over a bus that loses the frames `lose` names,
/// counted from the first; returns the outcome and how many frames went over the bus.
fn transfer(
    bench: &mut Bench,
    client: &mut client::SdoClient,
    mut lose: impl FnMut(usize, &Frame) -> bool,
) -> (client::Outcome, usize) {
    let mut count = 0;
    loop {
        if let Some(frame) = client.pop_frame() {
            count += 1;
            if !lose(count, &frame) {
                bench.device.on_frame(bench.now, &frame, &mut bench.app);
            }
            continue;
        }
        if let Some(frame) = bench.device.pop_frame() {
            if frame.id() != 0x585 {
                continue;
            }
            count += 1;
            if !lose(count, &frame)
                && let Some(outcome) = client.on_frame(bench.now, &frame)
            {
                while let Some(frame) = client.pop_frame() {
                    bench.device.on_frame(bench.now, &frame, &mut bench.app);
                }
                return (outcome, count);
            }
            continue;
        }
        bench.now = bench.now.max(client.next_deadline().unwrap());
        if let Some(outcome) = client.poll(bench.now) {
            return (outcome, count);
        }
    }
}

fn start(client: &mut client::SdoClient, way: Way, now: Micros, data: Option<&[u8]>) {
    match (way, data) {
        (Way::Plain, None) => client.upload(now, 0x2005, 0),
        (Way::Block, None) => client.upload_block(now, 0x2005, 0),
        (Way::Plain, Some(data)) => client.download(now, 0x2005, 0, data),
        (Way::Block, Some(data)) => client.download_block(now, 0x2005, 0, data),
    }
    .unwrap();
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    /// What the client writes it reads back, whatever the length and the way.
    #[test]
    fn values_of_any_length_come_through(data in prop::collection::vec(any::<u8>(), 0..=MAX_SDO)) {
        for way in [Way::Plain, Way::Block] {
            let mut bench = Bench::booted(CONFIG);
            let mut client = client::SdoClient::new(NODE, Micros::from_millis(100));
            start(&mut client, way, bench.now, Some(&data));
            let (outcome, _) = transfer(&mut bench, &mut client, |_, _| false);
            prop_assert_eq!(outcome, client::Outcome::Downloaded);
            prop_assert_eq!(&bench.app.long, &data);
            start(&mut client, way, bench.now, None);
            let (outcome, _) = transfer(&mut bench, &mut client, |_, _| false);
            prop_assert_eq!(outcome, client::Outcome::Uploaded);
            prop_assert_eq!(client.data(), &data);
        }
    }

    /// With frames lost a value comes through unharmed or not at all, and the server is free again
    /// in the end.
    #[test]
    fn lost_frames_never_harm_a_value(
        len in 8..=MAX_SDO,
        lost in prop::collection::hash_set(1..90usize, 1..4),
        block in any::<bool>(),
        upload in any::<bool>(),
    ) {
        let data: Vec<u8> = (0..len).map(|at| at as u8).collect();
        let way = if block { Way::Block } else { Way::Plain };
        let mut bench = Bench::booted(CONFIG);
        let mut client = client::SdoClient::new(NODE, Micros::from_millis(100));
        if upload {
            bench.app.long = data.clone();
        }
        start(&mut client, way, bench.now, (!upload).then_some(&data[..]));
        let (outcome, _) = transfer(&mut bench, &mut client, |count, _| lost.contains(&count));
        match outcome {
            client::Outcome::Uploaded => prop_assert_eq!(client.data(), &data),
            client::Outcome::Downloaded => prop_assert_eq!(&bench.app.long, &data),
            client::Outcome::Failed(_) if !upload => {
                prop_assert!(bench.app.long.is_empty() || bench.app.long == data);
            }
            client::Outcome::Failed(_) => {}
        }
        bench.pass(1_001);
        bench.frames();
        prop_assert!(bench.read(0x1000, 0).is_ok());
    }
}

#[test]
fn a_segment_lost_inside_a_block_is_repeated() {
    for upload in [false, true] {
        let data: Vec<u8> = (0..=255).collect();
        let mut bench = Bench::booted(CONFIG);
        let mut client = client::SdoClient::new(NODE, Micros::from_millis(100));
        if upload {
            bench.app.long = data.clone();
        }
        start(
            &mut client,
            Way::Block,
            bench.now,
            (!upload).then_some(&data[..]),
        );
        let (outcome, frames) = transfer(&mut bench, &mut client, |count, _| count == 10);
        if upload {
            assert_eq!(outcome, client::Outcome::Uploaded);
            assert_eq!(client.data(), data);
        } else {
            assert_eq!(outcome, client::Outcome::Downloaded);
            assert_eq!(bench.app.long, data);
        }
        assert!(frames > 41, "{frames}");
    }
}
