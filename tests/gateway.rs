//! The robot as a CAN adapter: the release image with a program at its cable.
//!
//! Single boards with a bus made by hand show what an adapter does when things go wrong; three
//! robots in a world, one of them the gateway, show that the group does not notice. `OMNIBUS_ELF`
//! names the image (`cargo xtask test` builds it and says so).

mod common;

use can_text::slcan::{self, Answer, Answers};
use canopen::{Frame, Micros, NmtCommand};
use emulator::{Board, BoardConfig, CanError, CanFrame, CanId, Firmware, Port};
use kinematics::Twist;
use omnibus::bus::link::{Link, LinkError};
use omnibus::path::curve::Curve;
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;
use protocol::{Fault, MemberState};
use sim::test_master::TestMaster;
use sim::{Backend, Cable, MASTER, Options, TruthSample, World};

#[path = "gateway/drive.rs"]
mod drive;
#[path = "gateway/noise.rs"]
mod noise;

const MS: u64 = 1_000_000;
const BAUD: f64 = 1e6;
/// The node of a board whose switches are open.
const NODE: u8 = 2;
const HEARTBEAT: u16 = 0x700 + NODE as u16;
const LATE_TICKS: (u16, u8) = (0x2121, 1);
/// Lost to the cable, lost to the bus, damaged.
const CABLE: u16 = 0x2131;

fn firmware() -> Firmware {
    common::image("OMNIBUS_ELF")
}

/// What is at the CAN connector of a board.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Bus {
    /// Another node that acknowledges.
    Other,
    /// A transceiver and no other node.
    NoOtherNode,
    /// No transceiver: the controller does not see its own dominant bits.
    NoTransceiver,
    /// A node that keeps the bus for itself.
    Blocked,
}

/// One board, its bus and the program at its cable.
struct Desk {
    board: Board,
    bus: Bus,
    decoder: Answers,
    answers: Vec<Answer>,
    /// Frames that left for the bus, with the time in ns at which they ended.
    left: Vec<(u64, Frame)>,
}

impl Desk {
    /// A robot on its desk, booted.
    fn new(bus: Bus) -> Self {
        let mut board = Board::new(&firmware(), BoardConfig::default());
        for (port, pin, level) in [
            (Port::B, 12, false),
            (Port::A, 6, false),
            (Port::C, 12, false),
            (Port::B, 13, true),
        ] {
            board.set_input(port, pin, level);
        }
        // 12 V behind the divider.
        board.set_analog(Port::A, 4, 12.0 / 11.0);
        let mut desk = Self {
            board,
            bus,
            decoder: Answers::new(),
            answers: Vec::new(),
            left: Vec::new(),
        };
        desk.run(50 * MS);
        desk
    }

    fn now(&self) -> u64 {
        self.board.now_ns()
    }

    /// Lets time pass.
    fn run(&mut self, ns: u64) {
        let end = self.now() + ns;
        // What was requested while the last frame left, at the end of the time before.
        self.serve_bus(end);
        while self.now() < end {
            let until = end.max(self.now() + 1);
            self.board.run_until_request(until).unwrap();
            self.serve_bus(end);
        }
        let sent = self.board.serial().take_sent();
        let received = sent.iter().filter_map(|(_, byte)| self.decoder.push(*byte));
        self.answers.extend(received);
    }

    /// Carries what the controller wants to send, a frame at a time, each for as long as it takes.
    fn serve_bus(&mut self, end: u64) {
        while self.now() < end
            && self.bus != Bus::Blocked
            && let Some(frame) = self.board.can().begin()
        {
            let bits = u64::from(frame.bits());
            let until = self.now() + bits * 1_000;
            match self.bus {
                Bus::Other => {
                    self.board.run_until(until).unwrap();
                    self.board.can().transmitted();
                    if let CanId::Standard(id) = frame.id() {
                        let frame = Frame::new(id, frame.data()).unwrap();
                        self.left.push((self.now(), frame));
                    }
                }
                Bus::NoOtherNode => {
                    self.board.run_until(until).unwrap();
                    self.board.can().error(CanError::Acknowledge);
                }
                Bus::NoTransceiver => {
                    // An error frame at the first bit, and the pause.
                    let until = self.now() + 25_000;
                    self.board.run_until(until).unwrap();
                    self.board.can().error(CanError::BitDominant);
                }
                Bus::Blocked => {}
            }
        }
    }

    fn send(&mut self, bytes: &[u8]) {
        self.board.serial().send(bytes, BAUD);
    }

    fn send_frame(&mut self, frame: &Frame) {
        self.send(slcan::frame(frame, None).as_bytes());
    }

    /// What the adapter has said since the last call.
    fn take_answers(&mut self) -> Vec<Answer> {
        std::mem::take(&mut self.answers)
    }

    /// Frames that it has said.
    fn take_frames(&mut self) -> Vec<Frame> {
        let answers = self.take_answers().into_iter();
        answers
            .filter_map(|answer| match answer {
                Answer::Frame(frame, _) => Some(frame),
                _ => None,
            })
            .collect()
    }

    fn open(&mut self) {
        self.send(b"C\rS8\rO\r");
        self.run(MS);
        let answers = self.take_answers();
        let accepted = answers.iter().filter(|answer| **answer == Answer::Other);
        assert_eq!(accepted.count(), 3, "{answers:?}");
    }

    /// Asks for the status flags.
    fn flags(&mut self) -> u8 {
        self.take_answers();
        self.send(b"F\r");
        self.run(3 * MS);
        let flags = self
            .take_answers()
            .into_iter()
            .find_map(|answer| match answer {
                Answer::Flags(flags) => Some(flags),
                _ => None,
            });
        flags.expect("an answer to F")
    }

    /// Reads an object of the robot by SDO, through the cable.
    fn read(&mut self, index: u16, sub: u8) -> Option<[u8; 4]> {
        let [low, high] = index.to_le_bytes();
        self.take_answers();
        self.send_frame(&Frame::of(
            0x600 + u16::from(NODE),
            [0x40, low, high, sub, 0, 0, 0, 0],
        ));
        for _ in 0..50 {
            self.run(MS);
            let answer = self
                .take_frames()
                .into_iter()
                .find(|frame| frame.id() == 0x580 + u16::from(NODE));
            if let Some(answer) = answer {
                let [command, .., a, b, c, d] = *answer.padded();
                return (command >> 5 == 2).then_some([a, b, c, d]);
            }
        }
        None
    }

    /// From the bus: a frame of another node.
    fn receive(&mut self, frame: &Frame) {
        let frame = CanFrame::new(frame.id(), frame.data()).unwrap();
        self.board.can().receive(&frame);
    }
}

/// Device type and identity come over the cable whatever is at the CAN connector: NMT, SDO,
/// heartbeats, for as long as one likes.
fn robot_answers(bus: Bus) {
    let mut desk = Desk::new(bus);
    desk.open();
    for round in 0..5 {
        assert!(desk.read(0x1000, 0).is_some(), "round {round}");
        desk.run(100 * MS);
    }
    desk.take_answers();
    // Reset of the communication: it says that it has booted.
    desk.send_frame(&Frame::of(0, [0x82, NODE]));
    desk.run(50 * MS);
    let boot_up = Frame::of(HEARTBEAT, [0]);
    assert!(desk.take_frames().contains(&boot_up));
    // Heartbeats go on, and the processor has not been reset.
    desk.run(500 * MS);
    let received = desk.take_frames();
    let beats = received
        .iter()
        .filter(|frame| frame.id() == HEARTBEAT)
        .count();
    assert!((4..=6).contains(&beats), "{beats} heartbeats in 0.5 s");
    assert_eq!(desk.board.resets(), 0);
}

#[test]
fn a_robot_on_its_cable_answers_with_others_on_the_bus() {
    robot_answers(Bus::Other);
}

#[test]
fn a_robot_on_its_cable_answers_with_nobody_on_the_bus() {
    robot_answers(Bus::NoOtherNode);
}

#[test]
fn a_robot_on_its_cable_answers_without_a_transceiver() {
    robot_answers(Bus::NoTransceiver);
}

#[test]
fn a_robot_on_its_cable_answers_while_the_bus_is_blocked() {
    robot_answers(Bus::Blocked);
}

/// The commands of programs, and what they are answered with.
#[test]
fn commands_are_answered_as_adapters_do() {
    let mut desk = Desk::new(Bus::Other);
    let mut answer = |text: &[u8]| {
        desk.send(text);
        desk.run(2 * MS);
        desk.board.serial().take_sent();
        desk.take_answers()
    };
    for text in [
        &b"\r"[..],
        b"C\r",
        b"S8\r",
        b"V\r",
        b"N\r",
        b"Z1\r",
        b"Z0\r",
    ] {
        assert_eq!(answer(text), [Answer::Other], "{text:?}");
    }
    for text in [
        &b"S6\r"[..],
        b"t0800\r",
        b"T000000800\r",
        b"r0800\r",
        b"R000000800\r",
        b"AT\r",
    ] {
        assert_eq!(answer(text), [Answer::Refused], "{text:?}");
    }
    assert_eq!(answer(b"F\r"), [Answer::Flags(0)]);
    assert!(desk.left.iter().all(|(_, frame)| frame.id() == HEARTBEAT));
}

/// A command is answered when the line is idle behind it, whatever the control tick is doing, and
/// costs one interrupt: 10 us of an idle line, at most a tick and a turn of the bus task in
/// progress, and the answer's own 10 us.
#[test]
fn a_command_is_answered_at_once() {
    const SOON_NS: u64 = 60_000;
    let mut desk = Desk::new(Bus::NoOtherNode);
    // Every phase of the tick.
    for _ in 0..50 {
        desk.board.serial().send(b"\r", BAUD);
        let came = desk.now() + 10_000;
        let (begin, slept) = desk.board.cycles();
        let until = came + 500_000;
        desk.board.run_until(until).unwrap();
        let sent = desk.board.serial().take_sent();
        let [(at, b'\r')] = sent[..] else {
            panic!("{sent:?}")
        };
        assert!(at < came + SOON_NS, "{} us", (at - came) / 1_000);
        let (end, slept_then) = desk.board.cycles();
        let busy = (end - begin) - (slept_then - slept);
        assert!(busy < BUSY_CYCLES, "{busy} cycles for one command");
        desk.run(520_000);
    }
}

/// What half a millisecond with one command may cost: a control tick, two turns of the bus task,
/// and the interrupts of the port.
const BUSY_CYCLES: u64 = 12_000;

/// While the robot writes its flash the port goes on by itself: what comes then is late, and not
/// lost as long as the ring holds it.
#[test]
fn what_comes_while_the_flash_is_written_is_not_lost() {
    let mut desk = Desk::new(Bus::Other);
    desk.open();
    desk.run(300 * MS);
    desk.flags();
    desk.left.clear();
    let programmed = desk.board.flash_operations();
    let save = Frame::of(0x602, [0x23, 0x10, 0x10, 1, b's', b'a', b'v', b'e']);
    desk.send_frame(&save);
    let sent: Vec<Frame> = (0..16).map(|n| Frame::of(0x345, [n])).collect();
    for frame in &sent {
        desk.run(200_000);
        desk.send_frame(frame);
    }
    desk.run(20 * MS);
    assert_ne!(desk.board.flash_operations(), programmed, "nothing written");
    let left: Vec<Frame> = desk.left.iter().map(|(_, frame)| *frame).collect();
    let left: Vec<Frame> = left.into_iter().filter(|f| f.id() == 0x345).collect();
    assert_eq!(left, sent);
    assert_eq!(desk.flags() & slcan::flags::OVERRUN, 0);
}

/// `L`: everything is heard, nothing goes out and nothing reaches the robot.
#[test]
fn a_channel_that_listens_sends_nothing() {
    let mut desk = Desk::new(Bus::Other);
    desk.send(b"L\r");
    desk.run(2 * MS);
    desk.take_answers();
    desk.left.clear();
    desk.send_frame(&Frame::of(0, [0x82, NODE]));
    desk.run(2 * MS);
    assert_eq!(desk.take_answers(), [Answer::Refused]);
    let foreign = Frame::of(0x345, [1, 2, 3]);
    desk.receive(&foreign);
    desk.run(250 * MS);
    let received = desk.take_frames();
    assert!(received.contains(&foreign));
    assert!(received.contains(&Frame::of(HEARTBEAT, [0x7F])));
    assert!(desk.left.iter().all(|(_, frame)| frame.id() == HEARTBEAT));
}

/// `Z1`: the time at which the interrupt took the frame, in ms modulo 60 000, for a minute and
/// more.
#[test]
fn time_stamps_are_those_of_the_bus() {
    let mut desk = Desk::new(Bus::Other);
    desk.open();
    desk.send(b"Z1\r");
    desk.run(2 * MS);
    let mut stamp = |pause_ms: u64| {
        desk.run(pause_ms * MS - 5 * MS);
        desk.take_answers();
        desk.receive(&Frame::of(0x345, []));
        desk.run(5 * MS);
        let mut answers = desk.take_answers().into_iter();
        let stamp = answers.find_map(|answer| match answer {
            Answer::Frame(frame, stamp) if frame.id() == 0x345 => stamp,
            _ => None,
        });
        stamp.expect("a stamp")
    };
    let first = stamp(10);
    let mut passed = 0;
    for pause in [7, 7, 7, 7, 700, 7_000, 20_000, 30_000, 10_000, 7] {
        passed += pause;
        let wanted = (u64::from(first) + passed) % 60_000;
        let found = u64::from(stamp(pause));
        // The board's crystal is exact; a millisecond may end between two frames.
        let off = (found + 60_000 - wanted) % 60_000;
        assert!(off <= 1 || off == 59_999, "{found} instead of {wanted}");
    }
    assert!(passed > 60_000 + 7_000);
}

/// Every frame of the bus comes to the cable, in order, also those that the robot does not listen
/// to.
#[test]
fn frames_of_the_bus_come_in_their_order() {
    let mut desk = Desk::new(Bus::Other);
    desk.open();
    let sent: Vec<Frame> = (0..500_u16)
        .map(|n| Frame::of(0x300 + n % 7, n.to_le_bytes()))
        .collect();
    for frame in &sent {
        desk.receive(frame);
        // 85 us on the bus at least; 15 characters on the cable.
        desk.run(200_000);
    }
    desk.run(10 * MS);
    let received = desk.take_frames().into_iter();
    let received: Vec<Frame> = received
        .filter(|frame| frame.id() & 0x700 == 0x300)
        .collect();
    assert_eq!(received, sent);
    assert_eq!(desk.flags(), 0);
}

/// Frames of the cable leave in the order in which they were sent, whatever their priorities.
#[test]
fn frames_of_the_cable_leave_in_their_order() {
    let mut desk = Desk::new(Bus::Other);
    desk.open();
    desk.run(150 * MS);
    desk.left.clear();
    let sent: Vec<Frame> = (0..300_u16)
        .map(|n| Frame::of(0x37F - n % 60, n.to_le_bytes()))
        .collect();
    for frame in &sent {
        desk.send_frame(frame);
    }
    desk.run(100 * MS);
    let left = desk.left.iter().map(|(_, frame)| *frame);
    let left: Vec<Frame> = left.filter(|frame| frame.id() != HEARTBEAT).collect();
    assert_eq!(left, sent);
    let answers = desk.take_answers();
    assert_eq!(
        answers
            .iter()
            .filter(|answer| **answer == Answer::Sent)
            .count(),
        sent.len()
    );
}

/// What cannot be forwarded is counted frame by frame, in objects that reading does not clear, and
/// told by `F` until it is asked.
#[test]
fn what_is_not_forwarded_is_counted() {
    let mut desk = Desk::new(Bus::Other);
    desk.open();
    desk.run(300 * MS);
    let count = |desk: &mut Desk, sub| u32::from_le_bytes(desk.read(CABLE, sub).unwrap());
    let all = |desk: &mut Desk| [1, 2, 3].map(|sub| count(desk, sub));
    assert_eq!(all(&mut desk), [0, 0, 0]);

    // To the cable: frames of eight bytes without a pause, which are 22 characters each.
    const BURST: u32 = 200;
    desk.take_answers();
    desk.left.clear();
    for n in 0..BURST {
        desk.receive(&Frame::of(0x345, u64::from(n).to_le_bytes()));
        desk.run(130_000);
    }
    desk.run(20 * MS);
    let received = u32::try_from(desk.take_frames().len()).unwrap();
    let own = u32::try_from(desk.left.len()).unwrap();
    let lost = BURST + own - received;
    assert!(lost > 50, "the cable carries six in ten: {lost}");
    assert_eq!(all(&mut desk), [lost, 0, 0]);
    assert_eq!(desk.flags(), slcan::flags::RECEIVE_FULL);
    assert_eq!(desk.flags(), 0, "told once");

    // To the bus, on which there is nobody any more: the requests of SDO are among what is lost.
    desk.bus = Bus::Blocked;
    desk.send_frame(&Frame::of(0x345, []));
    desk.run(200 * MS);
    let before = count(&mut desk, 2);
    for n in 0..10 {
        desk.send_frame(&Frame::of(0x345, [n]));
        desk.run(30 * MS);
    }
    assert_eq!(count(&mut desk, 2), before + 10 + 1);
    let full = slcan::flags::TRANSMIT_FULL;
    assert_eq!(desk.flags() & full, full);
    assert_eq!(desk.flags() & full, 0, "told once");

    // From the cable: bytes that are none.
    for _ in 0..3 {
        desk.board.serial().send_broken(b'1', BAUD);
        desk.run(MS);
        desk.send(b"\r");
        desk.run(MS);
    }
    assert_eq!(count(&mut desk, 3), 3);
    assert_eq!(count(&mut desk, 1), lost);
}

/// The worst that both sides can bring at once: the bus as full of short frames as it can be, and
/// the cable as full of bytes. The control tick is as punctual as ever, the watchdog content, and
/// what was lost is told.
#[test]
fn storms_on_both_sides_do_not_hold_up_the_control_tick() {
    let mut desk = Desk::new(Bus::Other);
    desk.open();
    let short = Frame::of(0x345, []);
    for n in 0..20_000_u32 {
        desk.receive(&short);
        if n % 20 == 0 {
            // A line that is no frame of ours costs as much as one that is.
            desk.send(&b"t3460\r".repeat(17));
        }
        // 47 bits and the pause.
        desk.run(50_000);
        desk.answers.clear();
    }
    assert_eq!(desk.board.resets(), 0);
    desk.run(100 * MS);
    let full = slcan::flags::RECEIVE_FULL;
    assert_eq!(desk.flags() & full, full, "the cable carries half of it");
    // Late ticks, as docs/can-protocol.md has them.
    let late = desk
        .read(LATE_TICKS.0, LATE_TICKS.1)
        .map(u32::from_le_bytes);
    assert_eq!(late, Some(0));
    assert_eq!(
        desk.read(0x1001, 0).map(|data| data[0]),
        Some(0),
        "no fault"
    );
}
