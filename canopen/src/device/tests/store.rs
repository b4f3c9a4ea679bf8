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
    let mut next = Bench::cold(CONFIG);
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
