//! What comes over a cable that is no slcan, is broken, or ends in the middle.

use super::*;

/// 10^6 bytes without a meaning: nothing goes to the bus, no fault, no reset, and the next command
/// is answered. The channel is open, which is the worst case.
#[test]
fn a_million_bytes_of_noise_do_nothing() {
    let mut desk = Desk::new(Bus::Other);
    desk.open();
    let mut state = 0x2545_F491_u32;
    let mut random = move || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        state.to_le_bytes()[1]
    };
    desk.left.clear();
    for _ in 0..1_000_000 / 250 {
        let bytes: Vec<u8> = (0..250).map(|_| random()).collect();
        desk.send(&bytes);
        desk.run(2_500_000);
        desk.answers.clear();
    }
    assert!(desk.left.iter().all(|(_, frame)| frame.id() == HEARTBEAT));
    assert_eq!(desk.board.resets(), 0);
    desk.send(b"\rO\r");
    desk.run(5 * MS);
    // Error register and history of the device.
    assert_eq!(desk.read(0x1001, 0).map(|data| data[0]), Some(0));
    assert_eq!(desk.read(0x1003, 0).map(|data| data[0]), Some(0));
}

/// Frames with one wrong character, at every place: none of them is a frame, whatever it begins
/// with.
#[test]
fn a_frame_with_one_wrong_character_does_nothing() {
    let mut desk = Desk::new(Bus::Other);
    desk.open();
    desk.left.clear();
    let good = b"t34551122334455\r";
    let mut lines = 0;
    for place in 0..good.len() - 1 {
        for wrong in [
            0x00, b' ', b'/', b':', b'@', b'G', b'`', b'g', b'x', 0x80, 0xB5, 0xFF,
        ] {
            let mut line = *good;
            line[place] = wrong;
            desk.send(&line);
            desk.run(300_000);
            lines += 1;
        }
        // One too few.
        let mut line = good.to_vec();
        line.remove(5 + place % 10);
        desk.send(&line);
        desk.run(300_000);
        lines += 1;
    }
    desk.run(10 * MS);
    assert!(desk.left.iter().all(|(_, frame)| frame.id() == HEARTBEAT));
    let answers = desk.take_answers();
    let refused = answers.iter().filter(|answer| **answer == Answer::Refused);
    assert_eq!(refused.count(), lines);
    desk.send(good);
    desk.run(5 * MS);
    assert_eq!(desk.left.last().map(|(_, frame)| frame.id()), Some(0x345));
}

/// What a modem manager tries, a boot loader prints, and a terminal at another speed makes of both.
#[test]
fn what_is_no_slcan_does_nothing() {
    let mut desk = Desk::new(Bus::Other);
    desk.left.clear();
    let text = b"AT+GCAP\r\nATI\r\n~\x00x\xF0\x7E\r\nU-Boot 2026.01\r\nHit any key: 3 2 1\r\n";
    for baud in [1e6, 115_200.0, 9_600.0, 921_600.0] {
        desk.board.serial().send(text, baud);
        desk.run(100 * MS);
    }
    desk.board.serial().send_broken(0, 1e6);
    desk.run(MS);
    assert!(desk.left.iter().all(|(_, frame)| frame.id() == HEARTBEAT));
    desk.send(b"\r");
    desk.run(MS);
    desk.open();
    assert!(desk.read(0x1000, 0).is_some());
    assert_eq!(desk.board.resets(), 0);
}

/// A broken byte takes its line with it and no other.
#[test]
fn a_framing_error_spoils_its_line() {
    let mut desk = Desk::new(Bus::Other);
    desk.open();
    desk.left.clear();
    desk.send(b"t3451");
    desk.board.serial().send_broken(b'1', BAUD);
    desk.run(MS);
    desk.send(b"1\rt3460\r");
    desk.run(5 * MS);
    let left = desk.left.iter().map(|(_, frame)| *frame);
    let left: Vec<Frame> = left.filter(|frame| frame.id() != HEARTBEAT).collect();
    assert_eq!(left, [Frame::of(0x346, [])]);
    let overrun = slcan::flags::OVERRUN;
    assert_eq!(desk.flags() & overrun, overrun);
    assert_eq!(desk.flags() & overrun, 0, "once");

    // The beginning of the line has been read when the byte breaks; what is left of it and what
    // follows would be a frame together.
    desk.left.clear();
    desk.send(b"t3451");
    desk.run(MS);
    desk.board.serial().send_broken(b'1', BAUD);
    desk.run(MS);
    desk.send(b"11\r");
    desk.run(5 * MS);
    assert!(desk.left.iter().all(|(_, frame)| frame.id() == HEARTBEAT));
}

/// A cable that is pulled in the middle of a frame: the line stays low, or open, for as long as one
/// likes. That is one damaged line at most, no interrupt after it, no frame, no fault; plugged in
/// again, the port works at once.
#[test]
fn a_pulled_line_is_one_damage_and_silence() {
    for (level, damages) in [(false, 1), (true, 0)] {
        let mut desk = Desk::new(Bus::Other);
        desk.open();
        desk.left.clear();
        desk.send(b"t3451");
        // In the second bit of the last character.
        desk.run(41_500);
        desk.board.serial().release(level);
        desk.run(10 * MS);
        let busy = |desk: &Desk| {
            let (cycles, slept) = desk.board.cycles();
            cycles - slept
        };
        let before = busy(&desk);
        desk.run(100 * MS);
        let pulled = busy(&desk) - before;
        desk.board.serial().drive();
        desk.run(10 * MS);
        let before = busy(&desk);
        desk.run(100 * MS);
        let idle = busy(&desk) - before;
        // The same work within a twentieth: heartbeats fall differently.
        assert!(pulled.abs_diff(idle) * 20 < idle, "{pulled}, {idle} cycles");

        desk.send(b"11\rt3460\r");
        desk.run(5 * MS);
        let left = desk.left.iter().map(|(_, frame)| *frame);
        let left: Vec<Frame> = left.filter(|frame| frame.id() != HEARTBEAT).collect();
        assert_eq!(left, [Frame::of(0x346, [])], "the line is {level}");
        let count = desk.read(CABLE, 3).map(u32::from_le_bytes);
        assert_eq!(count, Some(damages), "the line is {level}");
        assert_eq!(desk.read(0x1001, 0).map(|data| data[0]), Some(0));
        assert_eq!(desk.board.resets(), 0);
    }
}
