//! bxCAN against RM0390 section 30, by its registers alone. One core cycle is one APB1 clock here,
//! and a bit is 45 clocks: prescaler 5, 1 + 7 + 1 quanta, 1 Mbit/s at 45 MHz.

use super::*;

const BIT: u64 = 45;
const BTR: u32 = 4 | 6 << 16;
const IDE_RTR: u32 = 6;

/// On the bus, one filter that takes every data frame with an 11-bit identifier into FIFO 0.
fn started(mcr: u32, extra_btr: u32) -> Can {
    let mut can = Can::default();
    let mut write = |offset, value| can.write(0, offset, value).unwrap();
    write(0x000, mcr | 1);
    write(0x01C, BTR | extra_btr);
    write(0x20C, 1);
    write(0x240, 0);
    write(0x244, IDE_RTR);
    write(0x21C, 1);
    write(0x200, 0x2A1C_0E00);
    write(0x000, mcr);
    can.sync(11 * BIT);
    can
}

fn request(can: &mut Can, mailbox: u32, id: u32) {
    can.write(1000, 0x184 + 16 * mailbox, 1).unwrap();
    can.write(1000, 0x188 + 16 * mailbox, 0xAB).unwrap();
    can.write(1000, 0x180 + 16 * mailbox, id << 21 | 1).unwrap();
}

fn next_id(can: &Can) -> Option<u16> {
    can.pending().and_then(|(frame, _)| frame.standard_id())
}

fn frame(id: u16) -> CanFrame {
    CanFrame::new(id, &[1, 2, 3]).unwrap()
}

#[test]
fn reset_values() {
    let mut can = Can::default();
    for (offset, value) in [
        (0, 0x0001_0002),
        (4, 0xC02),
        (8, 0x1C00_0000),
        (0x1C, 0x0123_0000),
        (0x200, 0x2A1C_0E01),
    ] {
        assert_eq!(can.read(0, offset), Some(value), "offset {offset:#x}");
    }
}

#[test]
fn handshakes() {
    let mut can = Can::default();
    can.write(0, 0, 1).unwrap();
    assert_eq!(can.read(0, 4).unwrap() & 3, 1);
    can.write(0, 0x1C, BTR).unwrap();
    can.write(0, 0, 0).unwrap();
    // Still in initialisation mode until 11 recessive bits have passed.
    assert_eq!(can.read(11 * BIT - 1, 4).unwrap() & 3, 1);
    assert_eq!(can.next_event(), Some(11 * BIT));
    assert_eq!(can.read(11 * BIT, 4).unwrap() & 3, 0);
    can.write(1000, 0, 2).unwrap();
    assert_eq!(can.read(1000, 4).unwrap() & 3, 2);
}

#[test]
fn bit_timing_is_written_in_initialisation_mode_only() {
    let mut can = started(0, 0);
    assert_eq!(can.clocks_per_bit(), 45);
    assert_eq!(can.sample_point(), 8.0 / 9.0);
    can.write(1000, 0x1C, 0).unwrap();
    assert_eq!(can.clocks_per_bit(), 45);
}

#[test]
fn the_lowest_identifier_leaves_first() {
    let mut can = started(0, 0);
    for (mailbox, id) in [(0, 0x300), (1, 0x100), (2, 0x200)] {
        request(&mut can, mailbox, id);
    }
    assert_eq!(
        can.read(1000, 8).unwrap() >> 24,
        0b0010_0000,
        "LOW and CODE name mailbox 0, TME none"
    );
    let mut order = Vec::new();
    while let Some(id) = next_id(&can) {
        order.push(id);
        can.begin(1000).unwrap();
        can.transmitted();
    }
    assert_eq!(order, [0x100, 0x200, 0x300]);
    // RQCP and TXOK of all three.
    assert_eq!(can.read(1000, 8).unwrap() & 0x00FF_FFFF, 0x0003_0303);
}

#[test]
fn with_txfp_the_first_request_leaves_first() {
    let mut can = started(mcr::TXFP, 0);
    for (mailbox, id) in [(2, 0x300), (0, 0x100)] {
        request(&mut can, mailbox, id);
    }
    assert_eq!(next_id(&can), Some(0x300));
}

#[test]
fn a_frame_on_the_wire_is_not_overtaken_or_aborted() {
    let mut can = started(0, 0);
    request(&mut can, 0, 0x300);
    can.begin(1000).unwrap();
    request(&mut can, 1, 0x100);
    can.write(1000, 8, 0x80).unwrap();
    assert_eq!(next_id(&can), Some(0x300));
    can.transmitted();
    assert_eq!(
        can.read(1000, 8).unwrap() & 0xFF,
        3,
        "sent in spite of the abort"
    );
}

#[test]
fn a_pending_frame_is_aborted_at_once() {
    let mut can = started(0, 0);
    request(&mut can, 0, 0x300);
    can.write(1000, 8, 0x80).unwrap();
    assert_eq!(can.read(1000, 8).unwrap() & 0xFF, 1);
    assert_eq!(can.pending(), None);
}

#[test]
fn lost_arbitration_is_repeated_unless_nart() {
    let mut can = started(0, 0);
    request(&mut can, 0, 0x300);
    can.begin(1000).unwrap();
    can.lost_arbitration();
    assert_eq!(next_id(&can), Some(0x300));
    let mut can = started(mcr::NART, 0);
    request(&mut can, 0, 0x300);
    can.lost_arbitration();
    assert_eq!(can.pending(), None);
    assert_eq!(can.read(1000, 8).unwrap() & 0xFF, 5, "RQCP and ALST");
}

#[test]
fn transmit_interrupt() {
    let mut can = started(0, 0);
    can.write(1000, 0x14, ier::TMEIE).unwrap();
    request(&mut can, 0, 1);
    assert!(!can.lines().tx);
    can.transmitted();
    assert!(can.lines().tx);
    can.write(1000, 8, 1).unwrap();
    assert!(!can.lines().tx);
}

#[test]
fn frames_come_out_of_the_fifo_in_order() {
    let mut can = started(0, 0);
    can.write(1000, 0x14, ier::FMPIE0).unwrap();
    can.receive(1000, &frame(0x181), 50);
    can.receive(2000, &frame(0x080), 50);
    assert!(can.lines().rx[0]);
    assert_eq!(can.read(2000, 0x0C), Some(2));
    assert_eq!(can.read(2000, 0x1B0), Some(0x181 << 21));
    assert_eq!(can.read(2000, 0x1B4).unwrap() & 0xFF, 3);
    assert_eq!(can.read(2000, 0x1B8), Some(0x0003_0201));
    can.write(2000, 0x0C, 1 << 5).unwrap();
    assert_eq!(can.read(2000, 0x1B0), Some(0x080 << 21));
    can.write(2000, 0x0C, 1 << 5).unwrap();
    assert!(!can.lines().rx[0]);
}

#[test]
fn the_fourth_frame_is_an_overrun() {
    let mut can = started(0, 0);
    for id in 1..=4 {
        can.receive(1000, &frame(id), 50);
    }
    assert_eq!(can.read(1000, 0x0C), Some(3 | 1 << 3 | 1 << 4));
    let ids: Vec<_> = (0..3)
        .map(|_| {
            let id = can.read(1000, 0x1B0).unwrap() >> 21;
            can.write(1000, 0x0C, 1 << 5).unwrap();
            id
        })
        .collect();
    assert_eq!(ids, [1, 2, 4], "the newest is overwritten");
    let mut can = started(mcr::RFLM, 0);
    for id in 1..=4 {
        can.receive(1000, &frame(id), 50);
    }
    can.write(1000, 0x0C, 1 << 5).unwrap();
    can.write(1000, 0x0C, 1 << 5).unwrap();
    assert_eq!(
        can.read(1000, 0x1B0).unwrap() >> 21,
        3,
        "locked: the newcomer is dropped"
    );
}

#[test]
fn filters_choose_what_comes_in() {
    let mut can = started(0, 0);
    can.receive(1000, &CanFrame::remote(CanId::Standard(5), 0).unwrap(), 50);
    can.receive(
        1000,
        &CanFrame::with_id(CanId::Extended(5), &[]).unwrap(),
        50,
    );
    assert_eq!(can.read(1000, 0x0C), Some(0));
    // Bank 1: list of two 11-bit identifiers in 32 bits, to FIFO 1; before bank 0, because a list
    // is.
    for (offset, value) in [
        (0x200, 0x0E01),
        (0x204, 2),
        (0x20C, 3),
        (0x214, 2),
        (0x248, 7 << 21),
        (0x24C, 9 << 21),
        (0x21C, 3),
        (0x200, 0x0E00),
    ] {
        can.write(1000, offset, value).unwrap();
    }
    can.receive(1000, &frame(9), 50);
    can.receive(1000, &frame(8), 50);
    assert_eq!(can.read(1000, 0x10), Some(1));
    assert_eq!(
        can.read(1000, 0x1C4).unwrap() >> 8 & 0xFF,
        1,
        "second filter of FIFO 1"
    );
    assert_eq!(can.read(1000, 0x0C), Some(1));
}

#[test]
fn narrow_filters() {
    let mut can = started(0, 0);
    // Bank 0: 16-bit masks, 0x180..=0x18F data frames, and the exact identifier 0x80.
    let half = |id: u32| id << 5;
    for (offset, value) in [
        (0x200, 0x0E01),
        (0x20C, 0),
        (0x240, half(0x180) | half(0x7F0) << 16 | 0x18 << 16),
        (0x244, half(0x080) | half(0x7FF) << 16 | 0x18 << 16),
        (0x200, 0x0E00),
    ] {
        can.write(1000, offset, value).unwrap();
    }
    for id in [0x185, 0x190, 0x080, 0x081] {
        can.receive(1000, &frame(id), 50);
    }
    assert_eq!(can.read(1000, 0x0C).unwrap() & 3, 2);
}

#[test]
fn sixteen_failures_lead_to_error_passive_and_thirty_two_to_bus_off() {
    let mut can = started(mcr::ABOM, 0);
    can.write(1000, 0x14, ier::ERRIE | ier::BOFIE).unwrap();
    request(&mut can, 0, 1);
    for _ in 0..16 {
        can.transmit_error(1000, CanError::BitDominant);
    }
    let ErrorCounters { transmit, receive } = can.error_counters();
    assert_eq!((transmit, receive), (128, 0));
    assert!(can.error_passive() && !can.bus_off() && !can.lines().sce);
    for _ in 0..16 {
        can.transmit_error(1000, CanError::BitDominant);
    }
    assert!(can.bus_off() && can.lines().sce);
    assert_eq!(can.read(1000, 0x18).unwrap() & 0x77, 7 | 5 << 4);
    assert_eq!(can.pending(), None);
    // 128 x 11 recessive bits later the frame is tried again.
    let back = 1000 + 128 * 11 * BIT;
    assert_eq!(can.next_event(), Some(back));
    can.sync(back);
    let ErrorCounters { transmit, receive } = can.error_counters();
    assert_eq!((transmit, receive), (0, 0));
    assert_eq!(next_id(&can), Some(1));
}

#[test]
fn without_abom_bus_off_lasts_until_software_asks() {
    let mut can = started(0, 0);
    request(&mut can, 0, 1);
    for _ in 0..32 {
        can.transmit_error(1000, CanError::BitDominant);
    }
    can.sync(1_000_000_000);
    assert!(can.bus_off());
    can.write(1_000_000_000, 0, 1).unwrap();
    can.write(1_000_000_000, 0, 0).unwrap();
    can.sync(1_000_000_000 + 128 * 11 * BIT);
    assert!(!can.bus_off());
}

#[test]
fn a_node_alone_on_the_bus_becomes_passive_and_stays() {
    let mut can = started(0, 0);
    request(&mut can, 0, 1);
    for _ in 0..1000 {
        can.transmit_error(1000, CanError::Acknowledge);
    }
    assert_eq!(can.error_counters().transmit, 128);
    assert!(can.error_passive() && !can.bus_off());
    can.transmitted();
    assert_eq!(can.error_counters().transmit, 127);
}

#[test]
fn receive_errors_count_and_heal() {
    let mut can = started(0, 0);
    for _ in 0..200 {
        can.receive_error(CanError::Crc);
    }
    assert_eq!(can.error_counters().receive, 200);
    can.receive(1000, &frame(1), 50);
    assert_eq!(can.error_counters().receive, 120);
    can.receive(1000, &frame(1), 50);
    assert_eq!(can.error_counters().receive, 119);
}

#[test]
fn loop_back_receives_its_own_frame() {
    let mut can = started(0, BTR_LBKM);
    request(&mut can, 0, 0x123);
    assert_eq!(can.pending(), None, "nothing reaches the bus");
    // 47 bits and one byte.
    assert_eq!(can.next_event(), Some(1000 + 55 * BIT));
    can.sync(1000 + 55 * BIT);
    assert_eq!(can.read(4000, 0x0C), Some(1));
    assert_eq!(can.read(4000, 8).unwrap() & 3, 3);
}

#[test]
fn automatic_wake_up_loses_the_frame_that_wakes() {
    let mut can = started(mcr::AWUM, 0);
    can.write(1000, 0, mcr::AWUM | mcr::SLEEP).unwrap();
    can.receive(2000, &frame(1), 50);
    can.receive(2000 + 11 * BIT, &frame(2), 50);
    assert_eq!(can.read(5000, 0x0C), Some(1));
    assert_eq!(can.read(5000, 0x1B0), Some(2 << 21));
}

/// TIME of a word RDTxR or TDTxR.
fn stamp(can: &mut Can, offset: u32) -> u32 {
    can.read(10_000_000, offset).unwrap() >> 16
}

#[test]
fn time_stamps_count_bits_at_the_sample_point_of_the_start_bit() {
    // 30.7.2. The sample point is 8 of 9 quanta, so 40 of 45 clocks into the bit; the counter began
    // at 0. A start bit that is sampled at clock 45 n has stamp n, one clock earlier n - 1, and 16
    // bits of it are kept.
    for (sampled, expected) in [
        (45_000, 1000),
        (45_044, 1000),
        (44_999, 999),
        (65_536 * BIT - 1, 65_535),
        (65_536 * BIT, 0),
        (65_541 * BIT, 5),
    ] {
        let began = sampled - 40;
        let mut sender = started(mcr::TTCM, 0);
        request(&mut sender, 1, 0x123);
        sender.begin(began).unwrap();
        sender.transmitted();
        assert_eq!(stamp(&mut sender, 0x194), expected, "sent");
        let mut receiver = started(mcr::TTCM, 0);
        receiver.receive(began + 60 * BIT, &frame(0x123), 60);
        assert_eq!(stamp(&mut receiver, 0x1B4), expected, "received");
    }
}

#[test]
fn a_frame_sent_again_is_stamped_again() {
    let mut can = started(mcr::TTCM, 0);
    request(&mut can, 0, 0x123);
    can.begin(100 * BIT).unwrap();
    can.transmit_error(120 * BIT, CanError::BitDominant);
    can.begin(150 * BIT).unwrap();
    assert_eq!(stamp(&mut can, 0x184), 150);
    assert_eq!(can.read(0, 0x184).unwrap() & 0xF, 1, "DLC stays");
}

#[test]
fn loop_back_stamps_both_ways() {
    let mut can = started(mcr::TTCM, BTR_LBKM);
    request(&mut can, 0, 0x123);
    can.sync(1000 + 55 * BIT);
    // 1000 + 40 clocks are 23 whole bits.
    assert_eq!(stamp(&mut can, 0x184), 23);
    assert_eq!(stamp(&mut can, 0x1B4), 23);
}

#[test]
fn without_ttcm_stamps_are_0_and_with_it_they_begin_there() {
    let mut can = started(0, 0);
    can.receive(5000 * BIT, &frame(1), 60);
    assert_eq!(stamp(&mut can, 0x1B4), 0);
    can.write(6000 * BIT, 0x0C, 0x20).unwrap();
    can.write(6000 * BIT, 0, mcr::TTCM).unwrap();
    can.receive(6200 * BIT, &frame(1), 60);
    assert_eq!(stamp(&mut can, 0x1B4), 140);
}

/// 30.9.4, CAN2SB: the banks from there on are CAN2's. With 14 for both, one filter each: bank 13
/// takes 0x201 for CAN1, bank 14 takes 0x202 for CAN2 and puts it into its second FIFO.
#[test]
fn the_banks_from_can2sb_on_are_those_of_can2() {
    let (mut first, mut second) = (started(0, 0), started(0, 0));
    let mut write = |offset, value| first.write(2_000, offset, value).unwrap();
    write(0x200, 14 << 8 | 1);
    write(0x21C, 0);
    write(0x20C, 3 << 13); // 32 bits wide
    write(0x204, 3 << 13); // lists
    write(0x214, 1 << 14); // bank 14 into FIFO 1
    for (bank, id) in [(13, 0x201), (14, 0x202)] {
        write(0x240 + 8 * bank, id << 21);
        write(0x244 + 8 * bank, id << 21);
    }
    write(0x21C, 3 << 13);
    write(0x200, 14 << 8);
    for id in [0x201, 0x202, 0x203] {
        first.receive(3_000, &frame(id), 68);
        second.receive_second(&first, 3_000, &frame(id), 68);
    }
    let received = |can: &mut Can, fifo: u32| {
        let count = can.read(3_000, 0x00C + 4 * fifo).unwrap() & 3;
        let id = can.read(3_000, 0x1B0 + 16 * fifo).unwrap() >> 21;
        (count, id)
    };
    assert_eq!(received(&mut first, 0), (1, 0x201));
    assert_eq!(received(&mut first, 1).0, 0);
    assert_eq!(received(&mut second, 0).0, 0);
    assert_eq!(received(&mut second, 1), (1, 0x202));
}
