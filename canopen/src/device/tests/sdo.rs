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
    assert_eq!(bench.od.setpoint, 0x1234);
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
    assert_eq!(bench.od.setpoint, 0x1234);
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
    assert_eq!(bench.write(0x1019, 0, &[1]), Err(0x0609_0032));
    assert_eq!(bench.write(0x1019, 0, &[241]), Err(0x0609_0031));
    let too_high = 1001u32.to_le_bytes();
    assert_eq!(bench.write(0x2001, 0, &too_high), Err(0x0609_0031));
    assert_eq!(bench.od.limited, 0);
    bench.receive(0, [1, 0]);
    assert_eq!(bench.write(0x2001, 0, &[0; 4]), Err(0x0800_0022));
    assert_eq!(bench.device.counters().sdo_aborts, 15);
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
