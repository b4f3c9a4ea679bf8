//! Level 1 on emulated boards: one that works, one for every mutation, and wrong wires.
//!
//! `OMNIBUS_ELF` and `OMNIBUS_ELF_SELF_TEST` name the images (`cargo xtask test` builds them).

use std::collections::VecDeque;

use acceptance::emulated::mutation::MUTATIONS;
use acceptance::emulated::{EmulatedBench, Faults, Images, Mutation, NODE};
use acceptance::level_one::{self, Options, Parts};
use acceptance::node::Node;
use acceptance::wires::{self, WIRES, Wire};
use acceptance::{Bench, Check, Image};
use canopen::{Frame, NodeId};
use emulator::Firmware;
use protocol::self_test::{FAIL, OUTPUTS, PIN};

/// As short as can be: the emulated board is the same each time.
const OPTIONS: Options = Options {
    frames: 200,
    starts: 1,
    skew_s: 5,
    ..Options::SHORT
};

/// More than a board takes to start, us.
const AWAY_US: u64 = 50_000;

fn images() -> Images {
    let load = |name: &str| {
        let path = std::env::var(name).unwrap_or_else(|_| panic!("{name} names no image"));
        Firmware::load(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
    };
    Images {
        self_test: load("OMNIBUS_ELF_SELF_TEST"),
        shipped: load("OMNIBUS_ELF"),
    }
}

fn run(mut bench: EmulatedBench<'_>) -> Vec<Check> {
    level_one::run(&mut bench, NodeId::new(NODE).unwrap(), &OPTIONS).unwrap()
}

fn broken(checks: &[Check]) -> Vec<&str> {
    let broken = checks.iter().filter(|check| !check.within());
    broken.map(|check| check.name.as_str()).collect()
}

#[test]
fn a_board_that_works_keeps_every_promise() {
    let images = images();
    let checks = run(EmulatedBench::new(&images, None));
    for check in &checks {
        println!("{}", acceptance::report::line(check));
    }
    assert_eq!(broken(&checks), [""; 0]);
    assert!(checks.len() > 75, "{} checks", checks.len());
}

/// An emulated bench at which frames come late: a heartbeat from before the bus went comes after it
/// from a slow adapter, and a busy computer is away while a board that was to fail starts again.
struct Late<'a> {
    bench: EmulatedBench<'a>,
    frames: VecDeque<(u64, Frame)>,
    fails: bool,
}

impl Bench for Late<'_> {
    fn now_us(&self) -> u64 {
        self.bench.now_us()
    }

    fn send(&mut self, frame: &Frame) -> anyhow::Result<()> {
        self.fails = frame.data().get(1..3) == Some(&FAIL.to_le_bytes());
        self.bench.send(frame)
    }

    fn receive(&mut self, until_us: u64) -> anyhow::Result<Option<(u64, Frame)>> {
        if let Some(frame) = self.frames.pop_front() {
            return Ok(Some(frame));
        }
        let received = self.bench.receive(until_us)?;
        if std::mem::take(&mut self.fails) {
            let back = self.now_us() + AWAY_US;
            while let Some(late) = self.bench.receive(back)? {
                self.frames.push_back(late);
            }
        }
        Ok(received)
    }

    fn flash(&mut self, image: Image) -> anyhow::Result<()> {
        self.bench.flash(image)
    }

    fn power_cycle(&mut self) -> anyhow::Result<()> {
        self.bench.power_cycle()
    }

    fn force_bus_off(&mut self) -> anyhow::Result<()> {
        self.bench.force_bus_off()?;
        let heartbeat = Frame::new(0x700 + u16::from(NODE), &[0x7f]);
        let at = self.now_us();
        self.frames.extend(heartbeat.map(|frame| (at, frame)));
        Ok(())
    }

    fn take_out(&mut self, wires: &[u8]) -> anyhow::Result<()> {
        self.bench.take_out(wires)
    }
}

fn run_late(parts: Parts) -> Vec<Check> {
    let images = images();
    let mut bench = Late {
        bench: EmulatedBench::new(&images, None),
        frames: VecDeque::new(),
        fails: false,
    };
    let options = Options { parts, ..OPTIONS };
    level_one::run(&mut bench, NodeId::new(NODE).unwrap(), &options).unwrap()
}

#[test]
fn a_board_that_starts_while_the_computer_is_busy_is_measured_by_its_frames() {
    assert_eq!(broken(&run_late(Parts::SelfTest)), [""; 0]);
}

#[test]
fn a_heartbeat_from_before_bus_off_does_not_end_it() {
    let checks = run_late(Parts::Shipped);
    let recovery = checks.iter().find(|check| check.name == "can.recovery");
    let after_ms = recovery.and_then(|check| check.measured).unwrap();
    // 128 times 11 recessive bits end bus-off; the robot begins that after 100 ms.
    assert!((100.0..250.0).contains(&after_ms), "{after_ms} ms");
}

#[test]
fn every_mutation_is_caught_by_the_check_that_should() {
    let images = images();
    let tried = |mutation: &Mutation| {
        let of_the_shipped = [
            "flash.program",
            "flash.erase",
            "start.",
            "can.errors",
            "can.bus_off",
            "load.",
            "stack.",
        ];
        let shipped = of_the_shipped
            .iter()
            .any(|area| mutation.caught_by.starts_with(area));
        let parts = match mutation.caught_by {
            "skew.pwm" => Parts::Second,
            _ if shipped => Parts::Shipped,
            _ => Parts::SelfTest,
        };
        let options = Options { parts, ..OPTIONS };
        let mut bench = EmulatedBench::new(&images, Some(mutation));
        let checks = level_one::run(&mut bench, NodeId::new(NODE).unwrap(), &options).unwrap();
        let broken = broken(&checks);
        println!("{}: {broken:?}", mutation.name);
        (!broken.contains(&mutation.caught_by)).then(|| format!("{}: {broken:?}", mutation.name))
    };
    let (one, other) = MUTATIONS.split_at(MUTATIONS.len() / 2);
    let missed = std::thread::scope(|scope| {
        let half = scope.spawn(|| one.iter().filter_map(tried).collect::<Vec<_>>());
        let mut missed: Vec<String> = other.iter().filter_map(tried).collect();
        missed.extend(half.join().unwrap());
        missed
    });
    assert_eq!(missed, [""; 0]);
}

/// What the checks note about the wires when these are put in.
fn notes(images: &Images, wires: Vec<Wire>) -> Vec<String> {
    let mut bench = EmulatedBench::wired(images, wires);
    let checks = level_one::wires_alone(&mut bench, NodeId::new(NODE).unwrap()).unwrap();
    let broken = checks.iter().filter(|check| !check.within());
    broken.map(|check| check.note.clone()).collect()
}

#[test]
fn a_missing_wire_is_named() {
    let images = images();
    for (place, wire) in WIRES.iter().enumerate() {
        let mut all = WIRES.to_vec();
        all.remove(place);
        let (from, to) = (wires::name(wire.from), wires::name(wire.to));
        let words = format!(
            "wire {} is missing: connect {from} with {to} ({})",
            place + 1,
            wire.what
        );
        assert_eq!(notes(&images, all), [words]);
    }
}

#[test]
fn swapped_wires_are_named() {
    let images = images();
    for place in 1..WIRES.len() {
        let (one, other) = (place - 1, place);
        let mut all = WIRES.to_vec();
        (all[one].to, all[other].to) = (WIRES[other].to, WIRES[one].to);
        let notes = notes(&images, all);
        let words = |a: usize, b: usize| format!("wires {} and {} are swapped", a + 1, b + 1);
        let named = notes == [words(one, other), words(other, one)];
        // One of the two is a gate and the other is not: each is named on its own.
        let edge = [12, 14].contains(&place);
        assert!(named || edge && notes.len() == 2, "{place}: {notes:?}");
    }
}

#[test]
fn a_missing_wire_from_the_second_board_is_named() {
    let images = images();
    let faults = Faults {
        second_wire_missing: true,
        ..Faults::default()
    };
    let mut bench = EmulatedBench::with_faults(&images, faults);
    let options = Options {
        parts: Parts::Second,
        ..OPTIONS
    };
    let checks = level_one::run(&mut bench, NodeId::new(NODE).unwrap(), &options).unwrap();
    assert_eq!(broken(&checks), ["skew.pwm"]);
    let words = "the second board's PD2 is not seen at PB14: is wire 18 in?";
    assert_eq!(checks[0].note, words);
}

#[test]
fn a_wire_to_another_pin_is_named() {
    let images = images();
    let mut all = WIRES.to_vec();
    // Both PWM of the front at the encoder of the left wheel.
    all[1].to = WIRES[0].to;
    let notes = notes(&images, all);
    assert_eq!(notes.len(), 2, "{notes:?}");
    assert_eq!(
        notes[0],
        "wire 1 is wrong: PA15 is connected with PA8 or PA9 instead of PA8"
    );
    assert!(notes[1].starts_with("wire 2 is missing"), "{notes:?}");
}

/// The self-test image never has a duty and driver enable on together, by no way round.
#[test]
fn a_duty_and_driver_enable_are_never_on_together() {
    let images = images();
    let mut bench = EmulatedBench::new(&images, None);
    let mut node = Node::new(&mut bench, NodeId::new(NODE).unwrap());
    node.bench.flash(Image::SelfTest).unwrap();
    node.boot_up(1_000_000).unwrap().unwrap();
    for stop in wires::STOP {
        let pin = wires::at(stop).from;
        node.write(PIN, 2, &[pin, 0]).unwrap();
    }
    let half = 500_i16.to_le_bytes();
    node.write(OUTPUTS, 1, &half).unwrap();
    assert!(node.write(OUTPUTS, 5, &[1]).is_err(), "enable over a duty");
    node.write(OUTPUTS, 1, &[0, 0]).unwrap();
    node.write(OUTPUTS, 5, &[1]).unwrap();
    assert!(node.write(OUTPUTS, 1, &half).is_err(), "a duty over enable");
    let pwm = wires::at(wires::PWM[0]).from;
    assert!(node.write(PIN, 2, &[pwm, 1]).is_err(), "a pin over enable");
    node.write(OUTPUTS, 5, &[0]).unwrap();
    node.write(PIN, 2, &[pwm, 1]).unwrap();
    assert!(node.write(OUTPUTS, 5, &[1]).is_err(), "enable over a pin");
    for gate in [wires::ENABLE, wires::BRAKE] {
        let gate = wires::at(gate).from;
        assert!(node.write(PIN, 2, &[gate, 1]).is_err(), "a gate as a pin");
    }
}
