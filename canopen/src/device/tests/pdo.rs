//! RPDO and TPDO.

use super::*;

fn applied(bench: &mut Bench) -> Vec<bool> {
    let syncs = bench.app.syncs.drain(..);
    syncs.map(|sync| sync.applied.contains(1)).collect()
}

#[test]
fn setpoint_sync_setpoint_back_to_back_applies_the_first() {
    let mut bench = Bench::operational(CONFIG);
    for round in 0..200u16 {
        let [low, high] = (2 * round).to_le_bytes();
        bench.receive(0x181, [low, high]);
        bench.receive(0x80, []);
        let [low, high] = (2 * round + 1).to_le_bytes();
        bench.receive(0x181, [low, high]);
        assert_eq!(bench.app.setpoint, 2 * round);
        assert_eq!(applied(&mut bench), [true]);
    }
    bench.receive(0x80, []);
    assert_eq!(bench.app.setpoint, 399);
}

#[test]
fn a_setpoint_waits_for_sync_and_is_applied_once() {
    let mut bench = Bench::operational(CONFIG);
    bench.receive(0x181, [1, 0]);
    bench.receive(0x181, [2, 0]);
    bench.pass(50);
    assert_eq!(bench.app.setpoint, 0);
    bench.receive(0x80, []);
    assert_eq!(bench.app.setpoint, 2);
    bench.app.setpoint = 9;
    bench.receive(0x80, []);
    assert_eq!(bench.app.setpoint, 9);
    assert_eq!(applied(&mut bench), [true, false]);
}

#[test]
fn setpoints_outside_operational_are_discarded() {
    for command in [128, 2] {
        let mut bench = Bench::booted(CONFIG);
        bench.receive(0, [command, 0]);
        bench.receive(0x181, [1, 0]);
        bench.receive(0x205, [1, 0]);
        bench.receive(0, [1, 0]);
        bench.receive(0x80, []);
        assert_eq!(bench.app.setpoint, 0);
    }
}

#[test]
fn a_latched_setpoint_does_not_survive_an_nmt_change() {
    for command in [2, 128, 129, 130] {
        let mut bench = Bench::operational(CONFIG);
        bench.receive(0x181, [1, 0]);
        bench.receive(0, [command, 0]);
        bench.receive(0, [1, 0]);
        bench.receive(0x80, []);
        assert_eq!(bench.app.setpoint, 0);
    }
}

#[test]
fn a_short_setpoint_is_discarded_and_counted_a_long_one_is_cut() {
    let mut bench = Bench::operational(CONFIG);
    bench.receive(0x181, [1]);
    bench.receive(0x80, []);
    assert_eq!(bench.app.setpoint, 0);
    assert!(bench.events().contains(&Event::RpdoTooShort { number: 1 }));
    assert_eq!(bench.device.counters().rpdo_too_short, 1);
    bench.receive(0x181, [1, 2, 3]);
    bench.receive(0x80, []);
    assert_eq!(bench.app.setpoint, 0x0201);
}

/// A config whose RPDO1 is this one.
fn with_rpdo(rpdo: PdoConfig) -> Config {
    Config {
        rpdos: std::vec![rpdo].leak(),
        heartbeat_ms: 0,
        ..CONFIG
    }
}

#[test]
fn an_rpdo_that_misses_its_deadline_is_reported_once_until_it_comes_again() {
    for transmission in [1, 254, 255] {
        let mut bench = Bench::operational(with_rpdo(PdoConfig {
            event_ms: 50,
            transmission,
            ..CONFIG.rpdos[0]
        }));
        // Nothing is expected before the first.
        bench.pass(1_000);
        assert_eq!(bench.frames(), []);
        bench.receive(0x181, [1, 0]);
        bench.pass(49);
        bench.receive(0x181, [1, 0]);
        bench.pass(49);
        assert_eq!(bench.frames(), []);
        bench.pass(1);
        let late = Frame::of(0x085, [0x50, 0x82, 0x11, 1, 0, 0, 0, 0]);
        assert_eq!(bench.frames(), [late]);
        assert!(bench.events().contains(&Event::RpdoLate { number: 1 }));
        bench.pass(1_000);
        assert_eq!(bench.frames(), []);
        bench.receive(0x181, [1, 0]);
        let over = Frame::of(0x085, [0, 0, 0, 0x50, 0x82, 1, 0, 0]);
        assert_eq!(bench.frames(), [over]);
        // Out of OPERATIONAL nothing is expected either.
        bench.receive(0, [128, 0]);
        bench.pass(1_000);
        assert_eq!(bench.frames(), []);
    }
}

#[test]
fn past_the_synchronous_window_pdos_wait_for_the_next_sync() {
    let mut bench = Bench::operational(Config {
        heartbeat_ms: 0,
        sync_window_us: 2_000,
        ..CONFIG
    });
    bench.receive(0x80, []);
    bench.poll();
    assert_eq!(bench.frames().len(), 1);
    bench.pass(1);
    bench.receive(0x181, [1, 0]);
    bench.pass(1);
    bench.receive(0x181, [2, 0]);
    bench.receive(0x80, []);
    assert_eq!(bench.app.setpoint, 1);
    assert_eq!(bench.frames().len(), 1);
    assert_eq!(bench.device.counters().pdos_late, 1);
}

#[test]
fn every_synchronous_type_of_an_rpdo_waits_for_one_sync() {
    for transmission in [0, 1, 2, 240] {
        let mut bench = Bench::operational(with_rpdo(PdoConfig {
            transmission,
            ..CONFIG.rpdos[0]
        }));
        bench.receive(0x181, [1, 0]);
        assert_eq!(bench.app.setpoint, 0);
        bench.receive(0x80, []);
        assert_eq!(bench.app.setpoint, 1);
    }
}

#[test]
fn an_event_driven_setpoint_is_applied_at_once() {
    let mut bench = Bench::operational(CONFIG);
    bench.receive(0x205, [7, 0]);
    assert_eq!(bench.app.setpoint, 7);
    assert_eq!(bench.events(), [Event::RpdoApplied { number: 2 }]);
}

#[test]
fn at_a_sync_the_application_is_between_its_rpdos_and_its_tpdos() {
    let mut bench = Bench::operational(CONFIG);
    bench.app.at_sync = Some(|app, errors| {
        app.measured = app.setpoint + 1;
        errors.raise(0x1000, ErrorClass::Generic, [0; 5]);
    });
    bench.receive(0x181, [0x33, 0x12]);
    bench.receive(0x80, []);
    let error = Frame::of(0x085, [0, 0x10, 1, 0, 0, 0, 0, 0]);
    let tpdo = Frame::of(0x185, [0x34, 0x12]);
    assert_eq!(bench.frames(), [error, tpdo]);
    bench.poll();
    assert_eq!(bench.frames(), []);
}

#[test]
fn a_frame_of_an_rpdo_that_is_for_others_is_ignored() {
    let mut bench = Bench::operational(CONFIG);
    bench.app.refused = Some(9);
    bench.receive(0x181, [1, 0]);
    bench.receive(0x181, [9, 0]);
    bench.receive(0x181, [9]);
    bench.receive(0x80, []);
    assert_eq!(bench.app.setpoint, 1);
    assert_eq!(bench.device.counters().rpdo_too_short, 0);
}

#[test]
fn no_tpdo_outside_operational() {
    for command in [128, 2] {
        let mut bench = Bench::operational(CONFIG);
        bench.receive(0, [command, 0]);
        bench.receive(0x80, []);
        bench.poll();
        assert_eq!(bench.frames(), []);
    }
}

#[test]
fn every_third_sync() {
    let mut bench = Bench::booted(CONFIG);
    bench.write(0x1800, 2, &[3]).unwrap();
    bench.receive(0, [1, 0]);
    let mut sent = Vec::new();
    for _ in 0..7 {
        bench.receive(0x80, []);
        bench.poll();
        sent.push(bench.frames().len());
    }
    assert_eq!(sent, [0, 0, 1, 0, 0, 1, 0]);
}

/// Operational, with this as TPDO1, what entering OPERATIONAL sent taken.
fn with_tpdo(tpdo: PdoConfig) -> Bench {
    Bench::operational(Config {
        tpdos: std::vec![tpdo].leak(),
        heartbeat_ms: 0,
        ..CONFIG
    })
}

#[test]
fn type_0_is_sent_at_the_sync_after_a_change_and_only_then() {
    let mut bench = with_tpdo(PdoConfig {
        transmission: 0,
        ..CONFIG.tpdos[0]
    });
    let mut sent = Vec::new();
    for changed in [false, true, false, true, true, false] {
        if changed {
            bench.device.trigger_tpdo(1);
            bench.poll();
            assert_eq!(bench.frames(), []);
        }
        bench.receive(0x80, []);
        bench.poll();
        sent.push(bench.frames().len() == 1);
    }
    assert_eq!(sent, [false, true, false, true, true, false]);
}

#[test]
fn event_driven_types_are_sent_on_a_change_and_by_the_event_timer() {
    for transmission in [254, 255] {
        let mut bench = with_tpdo(PdoConfig {
            transmission,
            event_ms: 30,
            ..CONFIG.tpdos[0]
        });
        bench.receive(0x80, []);
        bench.pass(29);
        assert_eq!(bench.frames(), []);
        bench.pass(1);
        assert_eq!(bench.frames().len(), 1);
        bench.pass(20);
        bench.device.trigger_tpdo(1);
        bench.poll();
        assert_eq!(bench.frames().len(), 1);
        // The timer counts from the last frame.
        bench.pass(29);
        assert_eq!(bench.frames(), []);
        bench.pass(1);
        assert_eq!(bench.frames().len(), 1);
    }
}

#[test]
fn an_event_driven_tpdo_is_sent_once_on_entering_operational() {
    let mut bench = with_tpdo(PdoConfig {
        transmission: 255,
        ..CONFIG.tpdos[0]
    });
    for _ in 0..2 {
        bench.receive(0, [128, 0]);
        bench.receive(0, [1, 0]);
        bench.poll();
        assert_eq!(bench.frames().len(), 1);
        bench.pass(1_000);
        assert_eq!(bench.frames(), []);
    }
}

#[test]
fn the_inhibit_time_holds_back_and_loses_nothing() {
    let mut bench = with_tpdo(PdoConfig {
        transmission: 254,
        inhibit_100us: 100,
        ..CONFIG.tpdos[0]
    });
    bench.pass(10);
    bench.device.trigger_tpdo(1);
    bench.poll();
    assert_eq!(bench.frames().len(), 1);
    bench.pass(2);
    bench.device.trigger_tpdo(1);
    bench.pass(2);
    bench.app.measured = 7;
    bench.device.trigger_tpdo(1);
    bench.pass(5);
    assert_eq!(bench.frames(), []);
    bench.pass(1);
    assert_eq!(bench.frames(), [Frame::of(0x185, [7, 0])]);
    bench.pass(100);
    assert_eq!(bench.frames(), []);
}

#[test]
fn timers_of_a_tpdo_follow_its_parameters() {
    let mut bench = with_tpdo(PdoConfig {
        transmission: 255,
        ..CONFIG.tpdos[0]
    });
    // The inhibit time and the start value belong to a PDO that is off.
    assert_eq!(bench.write(0x1800, 3, &[10, 0]), Err(0x0800_0022));
    assert_eq!(bench.write(0x1800, 6, &[1]), Err(0x0800_0022));
    bench.write(0x1800, 5, &[20, 0]).unwrap();
    bench.frames();
    bench.pass(20);
    assert_eq!(bench.frames().len(), 1);
    bench.write(0x1800, 1, &[0x85, 1, 0, 0x80]).unwrap();
    bench.write(0x1800, 3, &[10, 0]).unwrap();
    bench.write(0x1800, 6, &[3]).unwrap();
    bench.pass(100);
    assert_eq!(bench.frames(), []);
}

#[test]
fn a_start_value_puts_tpdos_of_several_nodes_in_step() {
    let mut bench = Bench::booted(CONFIG);
    bench.write(0x1800, 1, &[0x85, 1, 0, 0x80]).unwrap();
    bench.write(0x1800, 2, &[2]).unwrap();
    // The counter of a SYNC is 240 at most.
    assert_eq!(bench.write(0x1800, 6, &[241]), Err(0x0609_0031));
    assert_eq!(bench.write(0x1800, 6, &[255]), Err(0x0609_0031));
    assert_eq!(bench.read(0x1800, 6), Ok(std::vec![0]));
    bench.write(0x1800, 6, &[240]).unwrap();
    bench.write(0x1800, 6, &[5]).unwrap();
    bench.write(0x1800, 1, &[0x85, 1, 0, 0]).unwrap();
    bench.receive(0, [1, 0]);
    let mut sent = Vec::new();
    for counter in 2..=9 {
        bench.receive(0x80, [counter]);
        bench.poll();
        if bench.frames().iter().any(|frame| frame.id() == 0x185) {
            sent.push(counter);
        }
    }
    assert_eq!(sent, [5, 7, 9]);
}

#[test]
fn a_mapping_is_changed_in_the_order_cia_301_asks_for_and_no_other() {
    let mut bench = Bench::booted(CONFIG);
    let on = [0x85, 0x01, 0, 0];
    let off = [0x85, 0x01, 0, 0x80];
    let entry = [16, 0, 0x02, 0x20];
    // While the PDO exists nothing can be mapped, nor its identifier changed.
    assert_eq!(bench.write(0x1A00, 0, &[0]), Err(0x0601_0000));
    assert_eq!(bench.write(0x1A00, 1, &entry), Err(0x0601_0000));
    assert_eq!(bench.write(0x1800, 1, &[0x86, 1, 0, 0]), Err(0x0609_0030));
    bench.write(0x1800, 1, &off).unwrap();
    // While objects are mapped no entry can be changed.
    assert_eq!(bench.write(0x1A00, 2, &entry), Err(0x0601_0000));
    bench.write(0x1A00, 0, &[0]).unwrap();
    // Without any object there is no PDO.
    assert_eq!(bench.write(0x1800, 1, &on), Err(0x0609_0030));
    for (wrong, code) in [
        ([16, 0, 0x00, 0x20], 0x0604_0041), // Receive only.
        ([8, 0, 0x02, 0x20], 0x0604_0041),  // Wrong length.
        ([16, 1, 0x02, 0x20], 0x0609_0011),
        ([16, 0, 0x02, 0x30], 0x0602_0000),
    ] {
        assert_eq!(bench.write(0x1A00, 1, &wrong), Err(code));
    }
    for sub in 1..=5 {
        bench.write(0x1A00, sub, &entry).unwrap();
    }
    assert_eq!(bench.write(0x1A00, 9, &entry), Err(0x0609_0011));
    assert_eq!(bench.write(0x1A00, 0, &[5]), Err(0x0604_0042));
    assert_eq!(bench.write(0x1A00, 0, &[6]), Err(0x0604_0043));
    bench.write(0x1A00, 0, &[2]).unwrap();
    for restricted in [0x000, 0x101, 0x585, 0x605, 0x6E0, 0x701u32] {
        let cob_id = restricted.to_le_bytes();
        assert_eq!(bench.write(0x1800, 1, &cob_id), Err(0x0609_0030));
    }
    let extended = [0x85, 1, 0, 0x20];
    assert_eq!(bench.write(0x1800, 1, &extended), Err(0x0609_0030));
    bench.write(0x1800, 1, &[0x90, 2, 0, 0x40]).unwrap();
    bench.receive(0, [1, 0]);
    bench.app.measured = 0x1234;
    bench.receive(0x80, []);
    bench.poll();
    assert_eq!(bench.frames(), [Frame::of(0x290, [0x34, 0x12, 0x34, 0x12])]);
}

#[test]
fn an_rpdo_can_leave_gaps() {
    let mut bench = Bench::booted(CONFIG);
    bench.write(0x1400, 1, &[0x81, 0x01, 0, 0x80]).unwrap();
    bench.write(0x1600, 0, &[0]).unwrap();
    bench.write(0x1600, 1, &[8, 0, 0x05, 0x00]).unwrap();
    assert_eq!(
        bench.write(0x1600, 2, &[16, 0, 0x05, 0x00]),
        Err(0x0604_0041)
    );
    bench.write(0x1600, 2, &[16, 0, 0x00, 0x20]).unwrap();
    bench.write(0x1600, 0, &[2]).unwrap();
    bench.write(0x1400, 1, &[0x81, 0x01, 0, 0]).unwrap();
    bench.receive(0, [1, 0]);
    bench.receive(0x181, [0xFF, 0x34, 0x12]);
    bench.receive(0x80, []);
    assert_eq!(bench.app.setpoint, 0x1234);
}

#[test]
fn unsupported_transmission_types_are_refused() {
    let mut bench = Bench::booted(CONFIG);
    for pdo in [0x1400, 0x1800] {
        for kind in [241, 251, 252, 253] {
            assert_eq!(bench.write(pdo, 2, &[kind]), Err(0x0609_0030));
        }
        for kind in [0, 1, 240, 254, 255] {
            assert_eq!(bench.write(pdo, 2, &[kind]), Ok(()));
        }
    }
    assert_eq!(bench.write(0x1402, 2, &[1]), Err(0x0602_0000));
    assert_eq!(bench.write(0x1400, 4, &[1]), Err(0x0609_0011));
}

#[test]
fn a_full_transmit_queue_is_counted() {
    let mut bench = Bench::operational(CONFIG);
    for _ in 0..20 {
        bench.receive(0x80, []);
        bench.poll();
    }
    assert_eq!(bench.frames().len(), 16);
    assert_eq!(bench.device.counters().tx_overflow, 4);
    // The emergency about it waits for room, and is taken back after a second without overflow.
    bench.pass(1);
    assert_eq!(
        bench.frames(),
        [Frame::of(0x085, [0x10, 0x81, 0x11, 0, 0, 0, 0, 0])]
    );
    bench.pass(1_000);
    assert!(
        bench
            .frames()
            .contains(&Frame::of(0x085, [0, 0, 0, 0x10, 0x81, 0, 0, 0]))
    );
}

/// Takes and gives whole PDOs.
#[derive(Default)]
struct Whole(Vec<(u8, Vec<u8>)>);

impl Application for Whole {
    fn read(&self, _: u16, _: u8, _: &mut [u8]) -> Result<usize, AbortCode> {
        Err(AbortCode::NoObject)
    }

    fn write(&mut self, _: u16, _: u8, _: &[u8], _: NmtState) -> Result<(), AbortCode> {
        Err(AbortCode::NoObject)
    }

    fn rpdo(&mut self, number: u8, data: &[u8]) -> bool {
        self.0.push((number, data.to_vec()));
        true
    }

    fn tpdo(&self, number: u8, out: &mut [u8; 8]) -> Option<usize> {
        *out = [number; 8];
        Some(5)
    }
}

#[test]
fn an_application_may_take_and_give_whole_pdos_as_long_as_the_default_mapping_holds() {
    let mut app = Whole::default();
    let mut device = Device::new(CONFIG);
    device.poll(Micros(0), &mut app);
    let receive = |device: &mut Device, app: &mut Whole, frame: Frame| {
        device.on_frame(Micros(1), &frame, app);
        device.poll(Micros(1), app);
        core::iter::from_fn(|| device.pop_frame()).last()
    };
    receive(
        &mut device,
        &mut app,
        client::nmt(NmtCommand::Start, NmtTarget::All),
    );
    receive(&mut device, &mut app, Frame::of(0x181, [1, 2, 3]));
    let sent = receive(&mut device, &mut app, client::sync(None));
    assert_eq!(sent, Some(Frame::of(0x185, [1; 5])));
    assert_eq!(app.0, [(1, std::vec![1, 2])]);
    // After a remapping, even to the same objects, the entries are used.
    for (index, sub, data) in [
        (0x1400, 1, &[0x81, 0x01, 0, 0x80][..]),
        (0x1600, 0, &[0]),
        (0x1600, 0, &[1]),
        (0x1400, 1, &[0x81, 0x01, 0, 0]),
    ] {
        device.write(Micros(1), index, sub, data, &mut app).unwrap();
    }
    receive(&mut device, &mut app, Frame::of(0x181, [1, 2, 3]));
    receive(&mut device, &mut app, client::sync(None));
    assert_eq!(app.0.len(), 1);
    assert_eq!(device.counters().rpdo_refused, 1);
}
