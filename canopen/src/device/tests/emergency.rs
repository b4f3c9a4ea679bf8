//! Emergency messages, error objects and what errors do to the NMT state.

use super::*;

const QUIET: Config = Config {
    heartbeat_ms: 0,
    ..CONFIG
};

const NONE: [u8; 5] = [0; 5];

#[test]
fn an_error_is_announced_when_it_appears_and_when_it_has_gone() {
    let mut bench = Bench::booted(QUIET);
    let now = bench.now;
    let raise = |bench: &mut Bench, code, class, info| {
        bench.device.errors(now).raise(code, class, info);
        bench.frames()
    };
    assert_eq!(
        raise(&mut bench, 0x4210, ErrorClass::Temperature, [1, 2, 3, 4, 5]),
        [Frame::of(0x085, [0x10, 0x42, 0x09, 1, 2, 3, 4, 5])]
    );
    assert_eq!(
        raise(&mut bench, 0x4210, ErrorClass::Temperature, [1, 9, 9, 9, 9]),
        []
    );
    assert_eq!(
        raise(&mut bench, 0x3210, ErrorClass::Voltage, NONE),
        [Frame::of(0x085, [0x10, 0x32, 0x0D, 0, 0, 0, 0, 0])]
    );
    assert_eq!(bench.read(0x1001, 0), Ok(std::vec![0x0D]));
    bench.device.errors(now).clear(0x4210, 1);
    bench.device.errors(now).clear(0x4210, 1);
    assert_eq!(
        bench.frames(),
        [Frame::of(0x085, [0, 0, 0x05, 0x10, 0x42, 1, 0, 0])]
    );
    bench.device.errors(now).clear(0x3210, 0);
    assert_eq!(
        bench.frames(),
        [Frame::of(0x085, [0, 0, 0, 0x10, 0x32, 0, 0, 0])]
    );
    assert_eq!(bench.device.error_register(), 0);
}

#[test]
fn the_history_is_newest_first_bounded_and_can_be_cleared() {
    let mut bench = Bench::booted(QUIET);
    assert_eq!(bench.read(0x1003, 0), Ok(std::vec![0]));
    assert_eq!(bench.read(0x1003, 1), Err(0x0800_0024));
    for code in 0..10u8 {
        let info = [code, 0xAA, 0, 0, 0];
        let now = bench.now;
        let class = ErrorClass::Manufacturer;
        bench
            .device
            .errors(now)
            .raise(0xFF00 | u16::from(code), class, info);
        bench
            .device
            .errors(now)
            .clear(0xFF00 | u16::from(code), code);
    }
    bench.frames();
    assert_eq!(bench.read(0x1003, 0), Ok(std::vec![8]));
    assert_eq!(bench.read(0x1003, 1), Ok(std::vec![9, 0xFF, 9, 0xAA]));
    assert_eq!(bench.read(0x1003, 8), Ok(std::vec![2, 0xFF, 2, 0xAA]));
    assert_eq!(bench.read(0x1003, 9), Err(0x0609_0011));
    assert_eq!(bench.write(0x1003, 1, &[0; 4]), Err(0x0601_0002));
    assert_eq!(bench.write(0x1003, 0, &[1]), Err(0x0609_0030));
    assert_eq!(bench.write(0x1003, 0, &[0]), Ok(()));
    assert_eq!(bench.read(0x1003, 0), Ok(std::vec![0]));
}

#[test]
fn the_inhibit_time_spaces_messages_and_stopped_holds_them_back() {
    let mut bench = Bench::booted(QUIET);
    bench.write(0x1015, 0, &[100, 0]).unwrap(); // 10 ms
    let raise = |bench: &mut Bench, code| {
        let now = bench.now;
        bench
            .device
            .errors(now)
            .raise(code, ErrorClass::Generic, NONE);
    };
    raise(&mut bench, 0x1001);
    raise(&mut bench, 0x1002);
    assert_eq!(bench.frames().len(), 1);
    bench.pass(9);
    assert_eq!(bench.frames(), []);
    bench.pass(1);
    assert_eq!(bench.frames().len(), 1);
    bench.receive(0, [2, 0]);
    bench.pass(100);
    raise(&mut bench, 0x1003);
    bench.pass(100);
    assert_eq!(bench.frames(), []);
    bench.receive(0, [128, 0]);
    bench.pass(10);
    assert_eq!(
        bench.frames(),
        [Frame::of(0x085, [0x03, 0x10, 1, 0, 0, 0, 0, 0])]
    );
}

/// Others may rely on an emergency message: the device says how long it may be held back.
#[test]
fn an_inhibit_time_beyond_what_the_device_allows_is_refused() {
    let mut bench = Bench::booted(Config {
        longest_emergency_inhibit_100us: 100,
        ..QUIET
    });
    assert_eq!(bench.write(0x1015, 0, &[101, 0]), Err(0x0609_0031));
    assert_eq!(bench.read(0x1015, 0), Ok(std::vec![0, 0]));
    assert_eq!(bench.write(0x1015, 0, &[100, 0]), Ok(()));
}

#[test]
fn the_identifier_can_be_changed_only_while_the_service_is_off() {
    let mut bench = Bench::booted(QUIET);
    assert_eq!(bench.read(0x1014, 0), Ok(std::vec![0x85, 0, 0, 0]));
    assert_eq!(bench.write(0x1014, 0, &[0x86, 0, 0, 0]), Err(0x0609_0030));
    bench.write(0x1014, 0, &[0x85, 0, 0, 0x80]).unwrap();
    let now = bench.now;
    bench
        .device
        .errors(now)
        .raise(0x1000, ErrorClass::Generic, NONE);
    assert_eq!(bench.frames(), []);
    assert_eq!(bench.write(0x1014, 0, &[0x85, 5, 0, 0]), Err(0x0609_0030));
    assert_eq!(
        bench.write(0x1014, 0, &[0x86, 0, 0, 0x20]),
        Err(0x0609_0030)
    );
    bench.write(0x1014, 0, &[0x90, 0, 0, 0]).unwrap();
    bench.device.errors(now).clear(0x1000, 0);
    assert_eq!(bench.frames()[0].id(), 0x090);
}

#[test]
fn a_lost_heartbeat_is_an_error_and_does_what_0x1029_says() {
    use NmtState::*;
    for (behaviour, from, to) in [
        (0, Operational, PreOperational),
        (0, PreOperational, PreOperational),
        (1, Operational, Operational),
        (2, Operational, Stopped),
        (2, PreOperational, Stopped),
    ] {
        let mut bench = Bench::booted(QUIET);
        bench.write(0x1029, 1, &[behaviour]).unwrap();
        if from == Operational {
            bench.receive(0, [1, 0]);
        }
        bench.receive(0x701, [5]);
        bench.events();
        bench.pass(250);
        assert_eq!(bench.device.state(), to, "{behaviour} {from:?}");
        let events = bench.events();
        assert_eq!(events[0], Event::HeartbeatLost { node: NodeId::MIN });
        assert_eq!(events[1..].contains(&Event::CommunicationError), from != to);
        let lost = Frame::of(0x085, [0x30, 0x81, 0x11, 1, 0, 0, 0, 0]);
        // In STOPPED even that has to wait.
        assert_eq!(bench.frames().contains(&lost), to != Stopped);
        if to != Stopped {
            bench.receive(0x701, [5]);
            let over = Frame::of(0x085, [0, 0, 0, 0x30, 0x81, 1, 0, 0]);
            assert_eq!(bench.frames(), [over]);
        }
    }
    let mut bench = Bench::booted(QUIET);
    assert_eq!(bench.write(0x1029, 1, &[3]), Err(0x0609_0030));
    assert_eq!(bench.read(0x1029, 0), Ok(std::vec![1]));
}

#[test]
fn a_pdo_that_is_too_short_is_an_error_until_one_is_long_enough() {
    let mut bench = Bench::operational(QUIET);
    bench.receive(0x181, [1]);
    bench.receive(0x181, [1]);
    let short = Frame::of(0x085, [0x10, 0x82, 0x11, 1, 1, 2, 0, 0]);
    assert_eq!(bench.frames(), [short]);
    bench.receive(0x181, [1, 0]);
    let over = Frame::of(0x085, [0, 0, 0, 0x10, 0x82, 1, 0, 0]);
    assert_eq!(bench.frames(), [over]);
}

#[test]
fn a_sync_of_the_wrong_length_is_taken_but_reported() {
    for (overflow, wrong, right) in [(0, &[1u8][..], &[][..]), (10, &[], &[1])] {
        let mut bench = Bench::booted(Config {
            sync_overflow: overflow,
            ..QUIET
        });
        let receive = |bench: &mut Bench, data: &[u8]| {
            let frame = Frame::new(0x80, data).unwrap();
            bench.device.on_frame(bench.now, &frame, &mut bench.app);
        };
        receive(&mut bench, wrong);
        receive(&mut bench, wrong);
        let len = wrong.len() as u8;
        let error = Frame::of(0x085, [0x40, 0x82, 0x11, len, 0, 0, 0, 0]);
        assert_eq!(bench.frames(), [error]);
        assert_eq!(bench.app.syncs.len(), 2);
        receive(&mut bench, right);
        let over = Frame::of(0x085, [0, 0, 0, 0x40, 0x82, len, 0, 0]);
        assert_eq!(bench.frames(), [over]);
    }
}

#[test]
fn a_missing_sync_is_reported_after_one_and_a_half_periods() {
    let mut bench = Bench::operational(Config {
        sync_period_us: 10_000,
        ..QUIET
    });
    bench.pass(1_000);
    assert_eq!(bench.events(), []);
    bench.receive(0x80, []);
    bench.events();
    bench.pass(14);
    bench.frames();
    assert_eq!(bench.events(), []);
    bench.pass(1);
    assert_eq!(bench.events(), [Event::SyncLost]);
    assert_eq!(
        bench.frames(),
        [Frame::of(0x085, [0x00, 0x87, 0x11, 0, 0, 0, 0, 0])]
    );
    bench.receive(0x80, []);
    bench.poll();
    assert!(
        bench
            .frames()
            .contains(&Frame::of(0x085, [0, 0, 0, 0x00, 0x87, 0, 0, 0]))
    );
    bench.receive(0, [128, 0]);
    bench.pass(1_000);
    assert_eq!(bench.device.counters().syncs_lost, 1);
}

#[test]
fn what_is_not_expected_any_more_is_not_missed_any_more() {
    let mut bench = Bench::booted(QUIET);
    bench.write(0x1029, 1, &[1]).unwrap();
    bench.write(0x1400, 5, &[50, 0]).unwrap();
    bench.write(0x1006, 0, &10_000u32.to_le_bytes()).unwrap();
    bench.receive(0, [1, 0]);
    bench.receive(0x701, [5]);
    bench.receive(0x181, [1, 0]);
    bench.receive(0x80, []);
    bench.pass(1_000);
    let codes = |frames: Vec<Frame>| {
        let emergencies = frames.iter().filter_map(Emergency::parse);
        emergencies.map(|(_, it)| it.code).collect::<Vec<_>>()
    };
    assert_eq!(codes(bench.frames()), [0x8700, 0x8250, 0x8130]);
    for (index, sub, value) in [
        (0x1016, 1, &[0; 4][..]),
        (0x1400, 5, &[0; 2]),
        (0x1006, 0, &[0; 4]),
    ] {
        let (now, device) = (bench.now, &mut bench.device);
        device
            .write(now, index, sub, value, &mut bench.app)
            .unwrap();
    }
    assert_eq!(codes(bench.frames()), [0, 0, 0]);
    assert_eq!(bench.device.error_register(), 0);
}

/// The master and sixteen peers fall silent, and nothing else is forgotten for it.
#[test]
fn seventeen_lost_nodes_are_seventeen_errors_that_are_announced_once_each() {
    let mut bench = Bench::booted(QUIET);
    bench.write(0x1029, 1, &[1]).unwrap();
    let nodes = || (1..=17u8).map(|node| if node == 5 { 18 } else { node });
    for (sub, node) in (1..).zip(nodes()) {
        bench.write(0x1016, sub, &[100, 0, node, 0]).unwrap();
    }
    let now = bench.now;
    let mut errors = bench.device.errors(now);
    errors.raise(0x3210, ErrorClass::Voltage, NONE);
    bench.frames();
    let heartbeat = |bench: &mut Bench, node: u8| bench.receive(0x700 + u16::from(node), [5]);
    for node in nodes() {
        heartbeat(&mut bench, node);
    }
    let announced = |bench: &mut Bench| {
        bench.pass(50);
        let emergencies = bench.frames().into_iter();
        let emergencies = emergencies.filter_map(|frame| Emergency::parse(&frame));
        emergencies
            .map(|(_, it)| (it.code, it.info))
            .collect::<Vec<_>>()
    };
    assert_eq!(announced(&mut bench), []);
    bench.pass(49);
    let mut lost = Vec::new();
    for _ in 0..4 {
        lost.extend(announced(&mut bench));
    }
    let expected: Vec<_> = nodes().map(|node| (0x8130, [node, 0, 0, 0, 0])).collect();
    assert_eq!(lost, expected);
    // All are remembered: an error more is announced once, although it comes with every frame.
    bench.receive(0, [1, 0]);
    for _ in 0..3 {
        bench.receive(0x181, [1]);
    }
    assert_eq!(announced(&mut bench), [(0x8210, [1, 1, 2, 0, 0])]);
    for node in nodes() {
        heartbeat(&mut bench, node);
        assert_eq!(announced(&mut bench), [(0, [0x30, 0x81, node, 0, 0])]);
        bench
            .write(0x1016, if node == 18 { 5 } else { node }, &[0; 4])
            .unwrap();
    }
    assert_eq!(bench.device.error_register(), 0x15);
}

#[test]
fn an_error_that_there_is_no_room_for_is_announced_once_too() {
    let mut bench = Bench::booted(QUIET);
    let now = bench.now;
    let mut raise = |code| {
        let mut errors = bench.device.errors(now);
        errors.raise(code, ErrorClass::Voltage, NONE);
        bench.frames().len()
    };
    for code in 0x3000..0x3100 {
        assert_eq!(raise(code), 1);
    }
    assert_eq!(raise(0x30FF), 0);
    assert_eq!(raise(0x3000), 0);
    assert_eq!(bench.device.error_register(), 0x05);
}
