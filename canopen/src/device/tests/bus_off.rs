//! The bus-off policy.

use super::*;

#[test]
fn the_pause_doubles_up_to_a_limit_and_starts_over_after_ten_good_seconds() {
    let mut bench = Bench::operational(CONFIG);
    bench.pass(20_000);
    let mut pauses = Vec::new();
    for good_ms in [0, 0, 0, 0, 0, 0, 0, 9_999, 10_000] {
        bench.pass(good_ms);
        bench.events();
        let start = bench.now;
        bench.device.on_bus_off(bench.now);
        bench.device.on_bus_off(bench.now);
        while !bench.events().contains(&Event::RecoverBus) {
            bench.now = bench.device.next_deadline().unwrap();
            bench.poll();
        }
        pauses.push((bench.now - start).0 / 1_000);
        bench.device.on_bus_recovered(bench.now);
    }
    assert_eq!(
        pauses,
        [100, 200, 400, 800, 1_600, 3_200, 3_200, 3_200, 100]
    );
    assert_eq!(bench.device.counters().bus_off, 9);
}

#[test]
fn nothing_is_sent_meanwhile_and_an_emergency_afterwards() {
    let mut bench = Bench::operational(CONFIG);
    bench.receive(0x80, []);
    bench.poll();
    bench.device.on_bus_off(bench.now);
    // As object 0x1029 is by default; motion ends with OPERATIONAL.
    assert_eq!(bench.device.state(), NmtState::PreOperational);
    bench
        .device
        .errors(bench.now)
        .raise(0x1000, ErrorClass::Generic, [0; 5]);
    bench.pass(1_000);
    assert_eq!(bench.frames(), []);
    assert_eq!(bench.device.counters().tx_overflow, 0);
    bench.device.on_bus_recovered(bench.now);
    assert_eq!(
        bench.frames(),
        [
            Frame::of(0x085, [0x00, 0x10, 0x01, 0, 0, 0, 0, 0]),
            Frame::of(0x085, [0x40, 0x81, 0x11, 0, 0, 0, 0, 0]),
        ]
    );
    let events = bench.events();
    assert!(events.contains(&Event::BusOff) && events.contains(&Event::BusRecovered));
    bench.device.on_bus_recovered(bench.now);
    assert_eq!(bench.frames(), []);
}
