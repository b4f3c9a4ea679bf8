//! LSS, slave and master.

use super::*;
use client::{FastScan, LssAnswer, Scanned};

const UNCONFIGURED: Config = Config {
    node: None,
    ..CONFIG
};

fn ask(bench: &mut Bench, frame: Frame) -> Vec<LssAnswer> {
    bench.device.on_frame(bench.now, &frame, &mut bench.app);
    let frames = bench.frames();
    frames.iter().filter_map(client::parse_lss).collect()
}

#[test]
fn a_device_without_a_node_id_is_selected_configured_and_boots() {
    let mut bench = Bench::cold(UNCONFIGURED);
    bench.pass(100);
    let mut answers = Vec::new();
    for frame in client::lss_select(&CONFIG.identity) {
        answers.extend(ask(&mut bench, frame));
    }
    assert_eq!(answers, [LssAnswer::Selected]);
    let answer = ask(&mut bench, client::lss_inquire_node());
    assert_eq!(answer, [LssAnswer::Node(None)]);
    let answer = ask(&mut bench, Frame::of(0x7E5, [0x11, 128, 0, 0, 0, 0, 0, 0]));
    assert_eq!(answer, [LssAnswer::NodeIdSet(1)]);
    let answer = ask(&mut bench, client::lss_set_node(Some(NODE)));
    assert_eq!(answer, [LssAnswer::NodeIdSet(0)]);
    let answer = ask(&mut bench, client::lss_store());
    assert_eq!(answer, [LssAnswer::Stored(0)]);
    assert_eq!(bench.app.memory.node, Some(Some(NODE)));
    assert_eq!(bench.device.node(), None);
    let off = client::lss_switch_all(false);
    bench.device.on_frame(bench.now, &off, &mut bench.app);
    assert_eq!(bench.frames(), [Frame::of(0x705, [0])]);
    assert_eq!(bench.device.node(), Some(NODE));
    assert_eq!(bench.device.state(), NmtState::PreOperational);
    // Identifiers that depend on the node-ID follow it.
    assert_eq!(bench.read(0x1800, 1), Ok(std::vec![0x85, 1, 0, 0]));
}

#[test]
fn storing_that_takes_its_time_is_answered_when_it_is_done() {
    for (result, error) in [(Ok(()), 0), (Err(AbortCode::Hardware), 2)] {
        let mut bench = Bench::booted(Config {
            storage: true,
            ..CONFIG
        });
        bench.app.memory.slow_node = true;
        bench.app.memory.progress = Some(StoreProgress::Done);
        bench.receive(0x7E5, [0x04, 1, 0, 0, 0, 0, 0, 0]);
        assert_eq!(ask(&mut bench, client::lss_store()), []);
        // One at a time, for any client.
        assert_eq!(ask(&mut bench, client::lss_store()), [LssAnswer::Stored(2)]);
        let saved = bench.write(0x1010, 1, b"save");
        assert_eq!(saved, Err(AbortCode::DeviceState.code()));
        bench.device.finish_store(result);
        let answers: Vec<_> = bench
            .frames()
            .iter()
            .filter_map(client::parse_lss)
            .collect();
        assert_eq!(answers, [LssAnswer::Stored(error)]);
        assert_eq!(bench.write(0x1010, 1, b"save"), Ok(()));
    }
}

#[test]
fn golden_frames_of_selection() {
    let mut bench = Bench::booted(CONFIG);
    for (request, answers) in [
        ([0x40, 1, 0, 0, 0, 0, 0, 0], &[][..]),
        ([0x41, 2, 0, 0, 0, 0, 0, 0], &[]),
        ([0x42, 3, 0, 0, 0, 0, 0, 0], &[]),
        (
            [0x43, 0x78, 0x56, 0x34, 0x12, 0, 0, 0],
            &[[0x44, 0, 0, 0, 0, 0, 0, 0]],
        ),
        ([0x5A, 0, 0, 0, 0, 0, 0, 0], &[[0x5A, 1, 0, 0, 0, 0, 0, 0]]),
        (
            [0x5D, 0, 0, 0, 0, 0, 0, 0],
            &[[0x5D, 0x78, 0x56, 0x34, 0x12, 0, 0, 0]],
        ),
        ([0x5E, 0, 0, 0, 0, 0, 0, 0], &[[0x5E, 5, 0, 0, 0, 0, 0, 0]]),
        ([0x13, 0, 4, 0, 0, 0, 0, 0], &[[0x13, 1, 0, 0, 0, 0, 0, 0]]),
    ] {
        bench.receive(0x7E5, request);
        let expected: Vec<_> = answers
            .iter()
            .map(|bytes| Frame::of(0x7E4, *bytes))
            .collect();
        assert_eq!(bench.frames(), expected);
    }
}

#[test]
fn one_wrong_number_or_a_missing_one_selects_nobody() {
    for wrong in 0..4 {
        let mut bench = Bench::booted(CONFIG);
        let mut frames = client::lss_select(&CONFIG.identity);
        frames[wrong] = Frame::of(0x7E5, [0x40 + wrong as u8, 0xEE, 0, 0, 0, 0, 0, 0]);
        for frame in frames {
            assert_eq!(ask(&mut bench, frame), []);
        }
        let mut bench = Bench::booted(CONFIG);
        for (at, frame) in client::lss_select(&CONFIG.identity).into_iter().enumerate() {
            if at != wrong {
                assert_eq!(ask(&mut bench, frame), []);
            }
        }
        assert_eq!(ask(&mut bench, client::lss_inquire_node()), []);
    }
}

#[test]
fn a_device_with_a_node_id_takes_another_at_the_next_reset() {
    let mut bench = Bench::booted(CONFIG);
    bench.receive(0x7E5, [0x04, 1, 0, 0, 0, 0, 0, 0]);
    assert_eq!(
        ask(&mut bench, client::lss_set_node(NodeId::new(9))),
        [LssAnswer::NodeIdSet(0)]
    );
    bench.receive(0x7E5, [0x04, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(bench.device.node(), Some(NODE));
    bench.receive(0, [130, 5]);
    assert_eq!(bench.frames(), [Frame::of(0x709, [0])]);
    assert_eq!(bench.device.node(), NodeId::new(9));
}

/// Error bytes of the answers to configure node-ID 9 and to store.
fn change(bench: &mut Bench) -> [Vec<LssAnswer>; 2] {
    [client::lss_set_node(NodeId::new(9)), client::lss_store()].map(|frame| ask(bench, frame))
}

#[test]
fn no_other_node_while_operational() {
    let mut bench = Bench::booted(CONFIG);
    bench.receive(0, [1, 5]);
    bench.receive(0x7E5, [0x04, 1, 0, 0, 0, 0, 0, 0]);
    assert_eq!(change(&mut bench), [[], []], "not switched");
    for frame in client::lss_select(&CONFIG.identity) {
        ask(&mut bench, frame);
    }
    let refused = [[LssAnswer::NodeIdSet(0xFF)], [LssAnswer::Stored(0xFF)]];
    assert_eq!(change(&mut bench), refused.map(Vec::from));
    bench.receive(0, [130, 5]);
    bench.poll();
    assert_eq!(bench.device.node(), Some(NODE));
}

#[test]
fn one_of_several_takes_no_node_that_was_meant_for_all() {
    // One whose heartbeat was received before, or that answers the same request.
    for (id, answer) in [(0x706, false), (0x7E4, true)] {
        let mut bench = Bench::booted(CONFIG);
        if !answer {
            bench
                .device
                .on_frame(bench.now, &Frame::of(id, [5]), &mut bench.app);
        }
        bench.receive(0x7E5, [0x04, 1, 0, 0, 0, 0, 0, 0]);
        if answer {
            let set = ask(&mut bench, client::lss_set_node(NodeId::new(9)));
            assert_eq!(set, [LssAnswer::NodeIdSet(0)]);
            bench.receive(id, [0x11, 0, 0, 0, 0, 0, 0, 0]);
        }
        let refused = [[LssAnswer::NodeIdSet(0xFF)], [LssAnswer::Stored(0xFF)]];
        assert_eq!(change(&mut bench), refused.map(Vec::from), "{id:#x}");
        bench.receive(0x7E5, [0x04, 0, 0, 0, 0, 0, 0, 0]);
        bench.receive(0, [130, 5]);
        assert_eq!(bench.device.node(), Some(NODE));
        // Selected, it is the one that is meant.
        bench
            .device
            .on_frame(bench.now, &Frame::of(0x706, [5]), &mut bench.app);
        for frame in client::lss_select(&CONFIG.identity) {
            ask(&mut bench, frame);
        }
        let set = ask(&mut bench, client::lss_set_node(NodeId::new(9)));
        assert_eq!(set, [LssAnswer::NodeIdSet(0)]);
    }
}

#[test]
fn node_ids_outside_the_devices_own_are_refused() {
    let mut bench = Bench::booted(Config {
        lowest_node: 2,
        highest_node: 17,
        ..CONFIG
    });
    bench.receive(0x7E5, [0x04, 1, 0, 0, 0, 0, 0, 0]);
    for (node, error) in [(0, 1), (1, 1), (2, 0), (17, 0), (18, 1), (127, 1), (255, 0)] {
        let answer = ask(&mut bench, Frame::of(0x7E5, [0x11, node, 0, 0, 0, 0, 0, 0]));
        assert_eq!(answer, [LssAnswer::NodeIdSet(error)], "{node}");
    }
}

#[test]
fn identify_answers_within_the_bounds() {
    let mut bench = Bench::booted(CONFIG);
    let mut identify = |low: u32, high: u32| {
        let bounds = [1, 2, 3, 3, low, high];
        let mut answers = Vec::new();
        for (command, number) in (0x46u8..).zip(bounds) {
            let [a, b, c, d] = u32::to_le_bytes(number);
            let frame = Frame::of(0x7E5, [command, a, b, c, d, 0, 0, 0]);
            answers.extend(ask(&mut bench, frame));
        }
        !answers.is_empty()
    };
    assert!(identify(0x1234_5678, 0x1234_5678));
    assert!(identify(0, u32::MAX));
    assert!(!identify(0x1234_5679, u32::MAX));
    assert!(!identify(0, 0x1234_5677));
    let none = Frame::of(0x7E5, [0x4C, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(ask(&mut bench, none), []);
    let mut bench = Bench::cold(UNCONFIGURED);
    assert_eq!(ask(&mut bench, none), [LssAnswer::Present]);
}

/// Scans a bus with these devices; how it ended and how many questions it took.
fn scan(devices: &mut [Bench]) -> (Scanned, usize) {
    let mut now = Micros(0);
    let mut scan = FastScan::new(now, Micros::from_millis(10));
    let mut questions = 0;
    loop {
        let question = scan.pop_frame().unwrap();
        questions += 1;
        let mut answers = Vec::new();
        for bench in devices.iter_mut() {
            bench.device.on_frame(now, &question, &mut bench.app);
            answers.extend(bench.frames());
        }
        // Equal answers at the same time are one frame on the bus.
        answers.dedup();
        let mut ended = answers.iter().find_map(|answer| scan.on_frame(now, answer));
        if answers.is_empty() {
            now = scan.next_deadline().unwrap();
            ended = scan.poll(now);
        }
        if let Some(how) = ended {
            return (how, questions);
        }
    }
}

fn unconfigured(serial: u32) -> Bench {
    Bench::cold(Config {
        identity: Identity {
            serial,
            ..CONFIG.identity
        },
        ..UNCONFIGURED
    })
}

#[test]
fn fastscan_finds_one_device_after_the_other_until_there_is_none() {
    let serials = [0x8000_0001, 0x1234_5678, 0x1234_5679, 0];
    let mut devices = serials.map(unconfigured);
    let mut found = Vec::new();
    for node in 10.. {
        let (how, questions) = scan(&mut devices);
        let Scanned::Found(identity) = how else {
            assert_eq!((how, questions), (Scanned::NoUnconfiguredSlave, 1));
            break;
        };
        assert_eq!(questions, 1 + 4 * 33);
        assert_eq!(
            identity,
            Identity {
                serial: identity.serial,
                ..CONFIG.identity
            }
        );
        found.push(identity.serial);
        // Only the one found is in configuration.
        for frame in [
            client::lss_set_node(NodeId::new(node)),
            client::lss_switch_all(false),
        ] {
            for bench in &mut devices {
                bench.device.on_frame(bench.now, &frame, &mut bench.app);
            }
        }
        for bench in &mut devices {
            bench.frames();
        }
    }
    assert_eq!(found, [0, 0x1234_5678, 0x1234_5679, 0x8000_0001]);
    let nodes: Vec<_> = devices
        .iter()
        .map(|d| d.device.node().unwrap().get())
        .collect();
    assert_eq!(nodes, [13, 11, 12, 10]);
}

#[test]
fn fastscan_passes_by_devices_that_have_a_node_id() {
    let (how, _) = scan(&mut [Bench::booted(CONFIG)]);
    assert_eq!(how, Scanned::NoUnconfiguredSlave);
}

#[test]
fn a_device_that_differs_early_keeps_out_of_the_rest_of_a_scan() {
    let device = |vendor, product, serial| {
        Bench::cold(Config {
            identity: Identity {
                vendor,
                product,
                revision: 1,
                serial,
            },
            ..UNCONFIGURED
        })
    };
    let mut devices = [
        device(2, 1, 1),
        device(1, 9, 9),
        device(1, 9, 8),
        device(3, 0, 0),
    ];
    let smallest = Identity {
        vendor: 1,
        product: 9,
        revision: 1,
        serial: 8,
    };
    assert_eq!(scan(&mut devices).0, Scanned::Found(smallest));
}
