//! The port alone, with the test as its DMA.

use super::*;

/// On at 1 Mbit/s from 45 MHz: USARTDIV 2.8125 (table 139 gives no such row; 45 / 16), a core
/// clock four times as fast.
fn port() -> Usart {
    let mut port = Usart::new();
    port.set_ratio(4);
    port.write(0, reg::BRR, 45).unwrap();
    port.write(0, reg::CR1, cr1::UE | cr1::RE | cr1::TE)
        .unwrap();
    port
}

const BIT: u64 = 180;

/// Lets time pass; takes every byte that comes at once, as DMA would.
fn bytes(port: &mut Usart, until: u64) -> Vec<(u8, bool)> {
    let mut found = Vec::new();
    while let Some(at) = port.next_event().filter(|at| *at <= until) {
        port.sync(at);
        let status = port.read(reg::SR).unwrap();
        if status & sr::RXNE != 0 {
            let byte = port.read(reg::DR).unwrap() as u8;
            found.push((byte, status & sr::FE != 0));
        }
    }
    found
}

#[test]
fn a_byte_takes_ten_bits_out_and_the_next_waits() {
    let mut port = port();
    port.write(0, reg::DR, 0x55).unwrap();
    assert_eq!(port.read(reg::SR).unwrap() & (sr::TXE | sr::TC), sr::TXE);
    port.write(0, reg::DR, 0xAA).unwrap();
    assert_eq!(port.read(reg::SR).unwrap() & sr::TXE, 0);
    assert_eq!(port.next_event(), Some(10 * BIT));
    assert!(port.sync(10 * BIT));
    assert_eq!(port.read(reg::SR).unwrap() & (sr::TXE | sr::TC), sr::TXE);
    assert!(port.sync(20 * BIT));
    assert_ne!(port.read(reg::SR).unwrap() & sr::TC, 0);
    assert_eq!(port.take_sent(), [(10 * BIT, 0x55), (20 * BIT, 0xAA)]);
}

#[test]
fn bytes_come_in_whole_and_then_the_line_is_idle_once() {
    let mut port = port();
    for byte in [0x00, 0xFF, 0xA5] {
        port.arrive(0, byte, BIT as f64, true);
    }
    // The third stop bit is sampled after 29.5 bits.
    let expected = [(0x00, false), (0xFF, false), (0xA5, false)];
    assert_eq!(bytes(&mut port, 30 * BIT), expected);
    assert_eq!(port.read(reg::SR).unwrap() & sr::IDLE, 0);
    assert_eq!(port.next_event(), Some(39 * BIT + BIT / 2));
    port.sync(40 * BIT);
    assert_ne!(port.read(reg::SR).unwrap() & sr::IDLE, 0);
    port.read(reg::DR);
    assert_eq!(port.read(reg::SR).unwrap() & sr::IDLE, 0);
    assert_eq!(port.next_event(), None);
}

/// 25.4.5, table 147: 3.33 % is what the receiver bears when nothing else is off; 115 200
/// instead of a million is another matter.
#[test]
fn a_sender_may_be_off_by_three_percent() {
    for (percent, good) in [(-3.0, true), (3.0, true), (-8.0, false), (8.0, false)] {
        let mut port = port();
        let sent: Vec<u8> = (0..200).map(|n: u8| n.wrapping_mul(37)).collect();
        for byte in &sent {
            port.arrive(0, *byte, BIT as f64 * (1.0 + percent / 100.0), true);
        }
        let found = bytes(&mut port, u64::MAX - 1);
        let right = found.iter().map(|(byte, _)| *byte).eq(sent) && !found.iter().any(|f| f.1);
        assert_eq!(right, good, "{percent} %");
    }
    let mut port = port();
    for byte in *b"O\r" {
        port.arrive(0, byte, BIT as f64 * 1e6 / 115_200.0, true);
    }
    let found = bytes(&mut port, u64::MAX - 1);
    assert!(found.iter().any(|(_, framing)| *framing), "{found:?}");
}

#[test]
fn a_missing_stop_bit_is_a_framing_error() {
    let mut port = port();
    port.arrive(0, 0x41, BIT as f64, false);
    assert_eq!(bytes(&mut port, 10 * BIT), [(0x41, true)]);
}

#[test]
fn a_byte_that_nobody_takes_costs_the_next_one() {
    let mut port = port();
    port.write(0, reg::CR3, cr3::EIE | cr3::DMAR).unwrap();
    port.arrive(0, 1, BIT as f64, true);
    port.arrive(0, 2, BIT as f64, true);
    while port.sync(20 * BIT) {}
    assert!(port.line());
    assert_ne!(port.read(reg::SR).unwrap() & sr::ORE, 0);
    assert_eq!(port.read(reg::DR), Some(1));
    assert!(!port.line());
    assert_eq!(port.read(reg::SR).unwrap() & (sr::ORE | sr::RXNE), 0);
}

#[test]
fn what_comes_while_it_is_off_is_lost() {
    let mut port = port();
    port.write(0, reg::CR1, cr1::UE).unwrap();
    port.arrive(0, 1, BIT as f64, true);
    port.write(5 * BIT, reg::CR1, cr1::UE | cr1::RE).unwrap();
    port.arrive(5 * BIT, 2, BIT as f64, true);
    assert_eq!(bytes(&mut port, 100 * BIT), [(2, false)]);
}

#[test]
fn other_modes_are_refused() {
    let mut port = port();
    for mode in [1 << 12, 1 << 10, 1 << 1] {
        assert!(port.write(0, reg::CR1, cr1::UE | mode).is_err());
    }
    assert!(port.write(0, reg::CR2, 1 << 13).is_err());
    assert!(port.write(0, reg::CR3, 1 << 3).is_err());
}

/// What `bytes` does, and whether the line was found idle.
fn bytes_and_idle(port: &mut Usart, until: u64) -> (Vec<(u8, bool)>, bool) {
    let mut idle = false;
    let mut found = Vec::new();
    while let Some(at) = port.next_event().filter(|at| *at <= until) {
        port.sync(at);
        let status = port.read(reg::SR).unwrap();
        let byte = port.read(reg::DR).unwrap() as u8;
        idle |= status & sr::IDLE != 0;
        if status & sr::RXNE != 0 {
            found.push((byte, status & sr::FE != 0));
        }
    }
    (found, idle)
}

/// A line that is held low is one byte without a stop bit, and then nothing: there is no edge,
/// and it is not idle until it is high again.
#[test]
fn a_line_held_low_is_one_break_and_silence() {
    let mut port = port();
    port.release(1_000, false);
    port.arrive(2_000, 0x55, BIT as f64, true);
    let second = 1_000 * 1_000 * BIT;
    assert_eq!(bytes_and_idle(&mut port, second), (vec![(0, true)], false));
    port.drive(second);
    assert_eq!(bytes_and_idle(&mut port, second + 9 * BIT), (vec![], false));
    assert_eq!(bytes_and_idle(&mut port, second + 10 * BIT), (vec![], true));
    port.arrive(second + 20 * BIT, 0x55, BIT as f64, true);
    let last = second + 100 * BIT;
    assert_eq!(bytes_and_idle(&mut port, last), (vec![(0x55, false)], true));
}

/// In the middle of a byte the rest of it is what the line is then: 0x55 is 1, 0, 1, 0 in its
/// first four bits.
#[test]
fn a_line_that_is_cut_in_a_byte_ends_it() {
    for (level, want) in [(false, (0x05, true)), (true, (0xF5, false))] {
        let mut port = port();
        port.arrive(0, 0x55, BIT as f64, true);
        port.arrive(0, 0x55, BIT as f64, true);
        assert_eq!(bytes(&mut port, 5 * BIT), []);
        port.release(5 * BIT, level);
        assert_eq!(bytes_and_idle(&mut port, 1_000 * BIT), (vec![want], level));
    }
}
