//! Saving and restoring.

use super::*;

const CONFIG: Config = Config {
    storage: true,
    heartbeat_ms: 0,
    ..super::CONFIG
};

fn bench() -> Bench {
    let mut bench = Bench::booted(CONFIG);
    bench.app.memory.progress = Some(StoreProgress::Done);
    bench
}

/// Switches the device off and on again; what is in memory stays.
fn power_cycle(bench: &Bench) -> Bench {
    power_cycle_as(bench, CONFIG)
}

/// The same, with another configuration: its node-ID has been changed meanwhile.
fn power_cycle_as(bench: &Bench, config: Config) -> Bench {
    let mut next = Bench::cold(config);
    next.app.memory = bench.app.memory.clone();
    next.poll();
    next.frames();
    next
}

#[test]
fn only_the_signature_saves() {
    let mut bench = bench();
    for (index, right, wrong) in [(0x1010, b"save", b"load"), (0x1011, b"load", b"save")] {
        assert_eq!(bench.read(index, 0), Ok(std::vec![3]));
        assert_eq!(bench.read(index, 1), Ok(std::vec![1, 0, 0, 0]));
        assert_eq!(bench.read(index, 4), Err(0x0609_0011));
        assert_eq!(bench.write(index, 0, &[3]), Err(0x0601_0002));
        assert_eq!(bench.write(index, 1, wrong), Err(0x0800_0020));
        assert_eq!(bench.write(index, 1, b"sav"), Err(0x0607_0013));
        assert_eq!(bench.write(index, 1, right), Ok(()));
        assert_eq!(bench.write(index, 2, right), Ok(()));
        assert_eq!(bench.write(index, 3, right), Ok(()));
    }
    let all = [
        StoreScope::All,
        StoreScope::Communication,
        StoreScope::Application,
    ];
    assert_eq!(bench.app.memory.saved, all);
    assert_eq!(bench.app.memory.restored, all);
}

#[test]
fn without_storage_the_objects_do_not_exist() {
    let mut bench = Bench::booted(super::CONFIG);
    assert_eq!(bench.read(0x1010, 1), Err(0x0602_0000));
    assert_eq!(bench.write(0x1011, 1, b"load"), Err(0x0602_0000));
}

#[test]
fn a_device_as_configured_has_an_empty_image() {
    let mut bench = bench();
    bench.write(0x1010, 1, b"save").unwrap();
    assert_eq!(bench.app.memory.image, []);
}

/// Objects, each with a value that is not its default.
const CHANGED: &[(u16, u8, &[u8])] = &[
    (0x1007, 0, &[0x10, 0x27, 0, 0]),
    (0x1014, 0, &[0x90, 0, 0, 0]),
    (0x1015, 0, &[1, 2]),
    (0x1016, 1, &[0, 0, 0, 0]),
    (0x1016, 17, &[0x64, 0, 9, 0]),
    (0x1017, 0, &[0xF4, 1]),
    (0x1019, 0, &[240]),
    (0x1029, 1, &[1]),
    (0x1F80, 0, &[0, 0, 0, 0]),
    (0x1400, 1, &[0x81, 0x01, 0, 0x80]),
    (0x1401, 2, &[254]),
    (0x1401, 5, &[7, 0]),
    (0x1800, 1, &[0x91, 0x01, 0, 0]),
    (0x1800, 2, &[3]),
    (0x1800, 3, &[8, 0]),
    (0x1800, 5, &[9, 0]),
    (0x1800, 6, &[5]),
    (0x1A00, 0, &[2]),
    (0x1A00, 1, &[16, 0, 0x02, 0x20]),
    (0x1A00, 2, &[16, 0, 0x02, 0x20]),
    (0x1006, 0, &[0x10, 0x27, 0, 0]),
];

#[test]
fn every_communication_object_survives_a_power_cycle_and_load_brings_the_defaults_back() {
    let mut bench = bench();
    let defaults: Vec<_> = CHANGED
        .iter()
        .map(|(index, sub, _)| bench.read(*index, *sub).unwrap())
        .collect();
    bench.write(0x1014, 0, &[0x85, 0, 0, 0x80]).unwrap();
    bench.write(0x1800, 1, &[0x85, 1, 0, 0x80]).unwrap();
    bench.write(0x1A00, 0, &[0]).unwrap();
    for (index, sub, value) in CHANGED {
        if !matches!((*index, *sub), (0x1800, 1) | (0x1A00, 0)) {
            bench.write(*index, *sub, value).unwrap();
        }
    }
    bench.write(0x1A00, 0, &[2]).unwrap();
    bench.write(0x1800, 1, &[0x91, 1, 0, 0]).unwrap();
    bench.write(0x1010, 2, b"save").unwrap();
    for mut again in [power_cycle(&bench), {
        // A reset of the communication is as good.
        bench.receive(0, [130, 0]);
        bench.poll();
        bench.frames();
        bench
    }] {
        for (index, sub, value) in CHANGED {
            let read = again.read(*index, *sub);
            assert_eq!(read.as_deref(), Ok(*value), "{index:#x}:{sub}");
        }
        assert_eq!(again.device.state(), NmtState::Operational, "0x1F80");
        again.write(0x1011, 1, b"load").unwrap();
        // They hold from the next reset on.
        assert_eq!(again.read(0x1017, 0).as_deref(), Ok(&[0xF4, 1][..]));
        let mut again = power_cycle(&again);
        for ((index, sub, _), default) in CHANGED.iter().zip(&defaults) {
            let read = again.read(*index, *sub);
            assert_eq!(read.as_ref(), Ok(default), "{index:#x}:{sub}");
        }
    }
}

/// An identifier of the device as node 9.
fn read_as_nine(bench: &mut Bench, index: u16, sub: u8) -> u32 {
    let mut value = [0; 4];
    let len = bench.device.read(index, sub, &mut value, &bench.app);
    assert_eq!(len, Ok(4), "{index:#x}:{sub}");
    u32::from_le_bytes(value)
}

const NINE: Config = Config {
    node: NodeId::new(9),
    ..CONFIG
};

/// CiA 301, 7.3.5: the pre-defined identifiers are those of the node-ID.
#[test]
fn default_identifiers_follow_the_node_whatever_else_of_a_pdo_is_saved() {
    const OFF: u32 = 1 << 31;
    const NO_RTR: u32 = 1 << 30;
    // What is written to 0x1800:1 at node 5, and what node 9 has then.
    for (as_five, as_nine) in [
        (0x185, 0x189),
        (0x185 | OFF, 0x189 | OFF),
        (0x185 | NO_RTR, 0x189 | NO_RTR),
        (0x191, 0x191),
        (0x191 | OFF, 0x191 | OFF),
    ] {
        let mut bench = bench();
        bench
            .write(0x1800, 1, &(0x185 | OFF).to_le_bytes())
            .unwrap();
        bench.write(0x1800, 2, &[7]).unwrap();
        bench.write(0x1800, 1, &as_five.to_le_bytes()).unwrap();
        bench.write(0x1401, 5, &[7, 0]).unwrap();
        bench.write(0x1010, 2, b"save").unwrap();
        let mut same = power_cycle(&bench);
        assert_eq!(
            same.read(0x1800, 1).as_deref(),
            Ok(&as_five.to_le_bytes()[..])
        );
        let mut nine = power_cycle_as(&bench, NINE);
        assert_eq!(read_as_nine(&mut nine, 0x1800, 1), as_nine);
        assert_eq!(read_as_nine(&mut nine, 0x1401, 1), 0x209);
        let mut transmission = [0];
        nine.device
            .read(0x1800, 2, &mut transmission, &nine.app)
            .unwrap();
        assert_eq!(transmission, [7]);
        nine.app.measured = 0x1234;
        nine.receive(0, [1, 0]);
        for _ in 0..7 {
            nine.receive(0x80, []);
        }
        let sent = nine
            .frames()
            .iter()
            .any(|frame| frame.id() == as_nine as u16);
        assert_eq!(sent, as_nine & OFF == 0, "{as_nine:#x}");
    }
}

#[test]
fn the_identifier_of_emergencies_follows_the_node_unless_it_has_been_moved() {
    for (as_five, as_nine) in [(0x8000_0085_u32, 0x8000_0089), (0x90, 0x90)] {
        let mut bench = bench();
        bench.write(0x1014, 0, &[0x85, 0, 0, 0x80]).unwrap();
        bench.write(0x1014, 0, &as_five.to_le_bytes()).unwrap();
        bench.write(0x1010, 2, b"save").unwrap();
        let mut nine = power_cycle_as(&bench, NINE);
        assert_eq!(read_as_nine(&mut nine, 0x1014, 0), as_nine);
    }
}

/// What earlier versions have stored of node 5: the PDO off, type 7, on again, four bytes each.
#[test]
fn an_image_with_whole_identifiers_is_loaded_as_it_says() {
    let mut bench = bench();
    bench.app.memory.image = [
        &[0x00, 0x18, 1, 4, 0x85, 0x01, 0, 0x80][..],
        &[0x00, 0x18, 2, 1, 7],
        &[0x00, 0x18, 1, 4, 0x85, 0x01, 0, 0],
    ]
    .concat();
    let mut same = power_cycle(&bench);
    assert_eq!(same.read(0x1800, 1), Ok(std::vec![0x85, 1, 0, 0]));
    assert_eq!(same.read(0x1800, 2), Ok(std::vec![7]));
}

#[test]
fn heartbeat_consumers_that_have_changed_places_are_loaded() {
    const TWO: Config = Config {
        consumers: &[(NodeId::MIN, 250), (NODE_NINE, 300)],
        ..CONFIG
    };
    const NODE_NINE: NodeId = match NodeId::new(9) {
        Some(node) => node,
        None => NodeId::MIN,
    };
    let swapped: [&[u8]; 3] = [&[0x2C, 1, 9, 0], &[0, 0, 0, 0], &[250, 0, 1, 0]];
    let mut bench = Bench::booted(TWO);
    bench.app.memory.progress = Some(StoreProgress::Done);
    for sub in 1..=2 {
        bench.write(0x1016, sub, &[0; 4]).unwrap();
    }
    for (sub, entry) in (1..).zip(swapped) {
        bench.write(0x1016, sub, entry).unwrap();
    }
    bench.write(0x1010, 2, b"save").unwrap();
    let mut again = power_cycle_as(&bench, TWO);
    for (sub, entry) in (1..).zip(swapped) {
        assert_eq!(again.read(0x1016, sub).as_deref(), Ok(entry), "{sub}");
    }
}

#[test]
fn a_client_waits_until_saving_has_ended() {
    let save = [0x23, 0x10, 0x10, 1, b's', b'a', b'v', b'e'];
    for (result, answer) in [
        (Ok(()), [0x60, 0x10, 0x10, 1, 0, 0, 0, 0]),
        (
            Err(AbortCode::Hardware),
            [0x80, 0x10, 0x10, 1, 0, 0, 0x06, 0x06],
        ),
    ] {
        let mut bench = bench();
        bench.app.memory.progress = Some(StoreProgress::Pending);
        bench.receive(0x605, save);
        bench.pass(5_000);
        assert_eq!(bench.frames(), []);
        // No other client is served meanwhile.
        assert_eq!(bench.read(0x1000, 0), Err(0x060A_0023));
        bench.device.finish_store(result);
        assert_eq!(bench.frames(), [Frame::of(0x585, answer)]);
        assert!(bench.read(0x1000, 0).is_ok());
        bench.device.finish_store(result);
        assert_eq!(bench.frames(), []);
    }
}

#[test]
fn a_reset_while_saving_ends_the_waiting() {
    let mut bench = bench();
    bench.app.memory.progress = Some(StoreProgress::Pending);
    bench.receive(0x605, [0x23, 0x10, 0x10, 1, b's', b'a', b'v', b'e']);
    bench.receive(0, [130, 0]);
    bench.poll();
    bench.frames();
    assert_eq!(bench.write(0x1010, 1, b"save"), Err(0x0800_0022));
    bench.device.finish_store(Ok(()));
    assert_eq!(bench.frames(), []);
}

proptest! {
    /// Whatever an old memory holds, the device starts.
    #[test]
    fn any_image_is_survived(image in prop::collection::vec(any::<u8>(), 0..512)) {
        let mut bench = bench();
        bench.app.memory.image = image;
        let mut bench = power_cycle(&bench);
        prop_assert!(bench.read(0x1000, 0).is_ok());
    }
}
