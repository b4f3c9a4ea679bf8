//! A new image for a group of native robots: all start it, or all stay; whichever robot fails, and
//! in whichever phase.

use std::collections::VecDeque;
use std::path::Path;

use boot::header::{Board, Header, Link as ImageLink};
use boot::{Crypto, Slot, Software, sign};
use canopen::{Frame, Micros};
use omnibus::abort::Abort;
use omnibus::bus::link::{Link, LinkError};
use omnibus::bus::wire::Wire;
use omnibus::commission::update::{self, Before, Image, Step};
use omnibus::error::MasterError;
use omnibus::simulation;
use protocol::{Address, Fault, Kind, MemberState, address as at};
use robot::update::order;

#[path = "common/mod.rs"]
mod common;

const NEW: u32 = 0x0002_0000;
const OLD: u32 = 0x0001_0000;

/// A file signed with the development key.
fn file(version: u32, change: impl FnOnce(&mut Header)) -> Vec<u8> {
    let image = |slot: Slot, length: u32| -> Vec<u8> {
        let mut bytes: Vec<u8> = (0..length).map(|at| (at * 31 + at / 256) as u8).collect();
        bytes[..4].copy_from_slice(&0x2000_8000_u32.to_le_bytes());
        bytes[4..8].copy_from_slice(&(slot.address() + 0x201).to_le_bytes());
        bytes
    };
    let (a, b) = (image(Slot::A, 4_000), image(Slot::B, 4_100));
    let link = |bytes: &[u8]| {
        let crypto = Software::default();
        let mut hash = crypto.begin();
        crypto.update(&mut hash, bytes);
        ImageLink {
            length: bytes.len() as u32,
            hash: crypto.finish(hash),
        }
    };
    let mut header = Header {
        board: Board::NUCLEO_F446RE,
        hardware: boot::release::HARDWARE_REVISION,
        wire_version: protocol::WIRE_VERSION,
        version,
        security_counter: boot::release::SECURITY_COUNTER,
        a: link(&a),
        b: link(&b),
    };
    change(&mut header);
    let mut bytes = header.to_bytes().to_vec();
    let signature = sign(&boot::key::DEVELOPMENT_PRIVATE, &bytes);
    bytes.extend(signature);
    [bytes, a, b].concat()
}

/// What goes wrong with one robot.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Failure {
    /// It refuses this value of 0x1F51.
    Refuses(u8),
    /// Nothing of it is heard from the moment when it is told this.
    FallsSilent(u8),
    /// One bit of what it receives is another one.
    Damaged,
    /// Its transfer is aborted in the middle.
    Aborted,
    /// It answers this to the question from which slot it runs; an abort where there is no object.
    RunsFrom(Option<u8>),
    /// Its new image says that it has this fault, and this of its configuration.
    ComesUpWith(Fault, u32),
}

/// A bus on which one robot fails.
struct Trouble<L> {
    inner: L,
    node: u8,
    failure: Option<Failure>,
    segments: u32,
    silent: bool,
    started: bool,
    made_up: VecDeque<Frame>,
}

impl<L: Link> Trouble<L> {
    /// The frame as it gets to the robot, if it does.
    fn bend(&mut self, frame: &Frame) -> Option<Frame> {
        if frame.id() != 0x600 + u16::from(self.node) || self.failure.is_none() {
            return Some(*frame);
        }
        if self.silent {
            return None;
        }
        let mut data = *frame.padded();
        let is_control = data[..4] == [0x2F, 0x51, 0x1F, 1];
        let abort = |code: u32| {
            let [a, b, c, d] = code.to_le_bytes();
            let answer = [0x80, data[1], data[2], data[3], a, b, c, d];
            Frame::new(0x580 + u16::from(self.node), &answer)
        };
        match self.failure? {
            Failure::Refuses(value) if is_control && data[4] == value => {
                self.made_up.extend(abort(0x0606_0000));
                None
            }
            Failure::FallsSilent(value) if is_control && data[4] == value => {
                self.silent = true;
                None
            }
            Failure::RunsFrom(slot) => {
                let [low, high] = at::RUNNING_SLOT.index.to_le_bytes();
                if data[..4] != [0x40, low, high, at::RUNNING_SLOT.sub] {
                    return Some(*frame);
                }
                let id = 0x580 + u16::from(self.node);
                let answer = |slot| Frame::new(id, &[0x4F, low, high, data[3], slot, 0, 0, 0]);
                self.made_up
                    .extend(slot.map_or_else(|| abort(0x0602_0000), answer));
                None
            }
            Failure::ComesUpWith(fault, status) => {
                self.started |= is_control && data[4] == order::START;
                let says = [
                    (at::STATE, MemberState::Faulted as u32),
                    (at::STATUS_CODE, fault.code().into()),
                    (at::CONFIGURATION_STATUS, status),
                ];
                let asked = |(address, _): &(Address, u32)| {
                    let [low, high] = address.index.to_le_bytes();
                    data[..4] == [0x40, low, high, address.sub]
                };
                let Some((address, value)) = says.into_iter().find(asked) else {
                    return Some(*frame);
                };
                if !self.started {
                    return Some(*frame);
                }
                let length = protocol::entry(address).map_or(4, |entry| entry.kind.bytes());
                let [a, b, c, d] = value.to_le_bytes();
                let answer = [
                    0x43 | (4 - length) << 2,
                    data[1],
                    data[2],
                    data[3],
                    a,
                    b,
                    c,
                    d,
                ];
                let answer = Frame::new(0x580 + u16::from(self.node), &answer);
                self.made_up.extend(answer);
                None
            }
            Failure::Damaged | Failure::Aborted if matches!(data[0] & 0x7F, 1..=32) => {
                self.segments += 1;
                if self.segments != 200 {
                    return Some(*frame);
                }
                if self.failure == Some(Failure::Aborted) {
                    self.made_up.extend(abort(0x0800_0020));
                    data = [0x80, 0x50, 0x1F, 1, 0x20, 0, 0, 8];
                } else {
                    data[3] ^= 4;
                }
                Frame::new(frame.id(), &data)
            }
            _ => Some(*frame),
        }
    }
}

impl<L: Link> Link for Trouble<L> {
    fn now(&self) -> Micros {
        self.inner.now()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), LinkError> {
        match self.bend(frame) {
            Some(frame) => self.inner.send(&frame),
            None => Ok(()),
        }
    }

    fn receive(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, LinkError> {
        if let Some(frame) = self.made_up.pop_front() {
            return Ok(Some((self.now(), frame)));
        }
        while let Some((at, frame)) = self.inner.receive(until)? {
            let own = frame.id() & 0x7F == u16::from(self.node);
            if !(self.silent && own) {
                return Ok(Some((at, frame)));
            }
        }
        Ok(None)
    }
}

/// Robots 2 and up on a bus that has run for 100 ms.
fn bus(robots: u8, node: u8, failure: Option<Failure>) -> Wire<Trouble<impl Link>> {
    let text = std::fs::read_to_string(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../groups/single.toml"
    ))
    .expect("the group file");
    let members: String = (2..2 + robots)
        .map(|node| format!("[[robots]]\nnode = {node}\nx = {}.0\n", 2 * node))
        .collect();
    let text = text
        .replace("[[robots]]\nnode = 2\n", &members)
        .replace("yaw_rate = 1.0 ", "yaw_rate = 0.1 ")
        .replace("crystal_ppm = [-30]\n", "");
    let group = ::group::GroupFile::parse("single.toml", &text).expect("is right");
    let mut inner = simulation::open(&group, None, "sim").expect("the world is built");
    inner.world.run_until(Micros(100_000)).expect("it runs");
    Wire::visiting(Trouble {
        inner,
        node,
        failure,
        segments: 0,
        silent: false,
        started: false,
        made_up: VecDeque::new(),
    })
}

fn survey<L: Link>(wire: &mut Wire<L>, robots: u8) -> Vec<Before> {
    let nodes: Vec<_> = (2..2 + robots).map(|node| (node, None)).collect();
    update::survey(wire, &nodes).expect("all answer")
}

fn versions<L: Link>(wire: &mut Wire<L>, nodes: impl Iterator<Item = u8>) -> Vec<u32> {
    let version = |node| wire.read(node, at::FIRMWARE_VERSION, Kind::U32);
    nodes
        .map(version)
        .map(|version| version.expect("answers").to_bits())
        .collect()
}

#[test]
fn eight_robots_run_the_new_image_and_go_back() {
    let image = Image::read(file(NEW, |_| ())).unwrap();
    let mut wire = bus(8, 0, None);
    let before = survey(&mut wire, 8);
    assert!(before.iter().all(|robot| robot.version == OLD));
    let mut steps = Vec::new();
    update::update(&mut wire, &image, &before, &Abort::default(), &mut |step| {
        steps.push(step)
    })
    .unwrap();
    assert_eq!(versions(&mut wire, 2..10), [NEW; 8]);
    let first_start = steps
        .iter()
        .position(|step| matches!(step, Step::Starts(_)));
    let last_receipt = steps
        .iter()
        .rposition(|step| matches!(step, Step::HasIt(_)));
    assert!(
        last_receipt < first_start,
        "nobody starts before all have it"
    );
    // A second file goes into the other slot.
    let newer = Image::read(file(NEW + 0x100, |_| ())).unwrap();
    let before = survey(&mut wire, 8);
    assert!(before.iter().all(|robot| robot.slot == Some(Slot::B)));
    update::update(&mut wire, &newer, &before, &Abort::default(), &mut |_| ()).unwrap();
    assert_eq!(versions(&mut wire, 2..10), [NEW + 0x100; 8]);
    let before = survey(&mut wire, 8);
    assert!(before.iter().all(|robot| robot.other == NEW));
    update::go_back(&mut wire, &before, &mut |_| ()).unwrap();
    assert_eq!(versions(&mut wire, 2..10), [NEW; 8]);
}

/// Node 6 of 2 to 9 fails; no robot is left with the new image.
#[test]
fn if_one_of_eight_fails_in_any_phase_all_run_the_old_image() {
    for failure in [
        Failure::Refuses(0),
        Failure::Refuses(3),
        Failure::Aborted,
        Failure::Damaged,
        Failure::Refuses(1),
        Failure::Refuses(0x80),
        Failure::FallsSilent(3),
        Failure::FallsSilent(1),
        Failure::FallsSilent(0x80),
        Failure::ComesUpWith(Fault::WatchdogReset, 0),
    ] {
        let image = Image::read(file(NEW, |_| ())).unwrap();
        let mut wire = bus(8, 6, Some(failure));
        let before = survey(&mut wire, 8);
        let error = update::update(&mut wire, &image, &before, &Abort::default(), &mut |_| ());
        let error = error.expect_err("one has failed").to_string();
        assert!(error.contains("node 6"), "{failure:?}: {error}");
        let others = (2..10).filter(|node| *node != 6);
        assert_eq!(
            versions(&mut wire, others),
            [OLD; 7],
            "{failure:?}: {error}"
        );
        if !matches!(failure, Failure::FallsSilent(_)) {
            assert_eq!(versions(&mut wire, 6..7), [OLD], "{failure:?}: {error}");
        }
    }
}

/// The reason is named, with the object that the new image cannot read; a fault from before the
/// update is no reason.
#[test]
fn an_image_that_comes_up_with_a_new_fault_is_not_confirmed() {
    let image = Image::read(file(NEW, |_| ())).unwrap();
    let half_track = u32::from_le_bytes([3, 1, 0x10, 0x20]);
    for (status, named) in [(half_track, "(2010:1)"), (3, "image as a whole")] {
        let failure = Failure::ComesUpWith(Fault::ParametersCorrupt, status);
        let mut wire = bus(2, 3, Some(failure));
        let before = survey(&mut wire, 2);
        let mut steps = Vec::new();
        let mut show = |step| steps.push(step);
        let done = update::update(&mut wire, &image, &before, &Abort::default(), &mut show);
        let error = done.unwrap_err().to_string();
        assert!(error.contains("node 3") && error.contains(named), "{error}");
        assert!(error.contains(Fault::ParametersCorrupt.name()), "{error}");
        assert!(!steps.iter().any(|step| matches!(step, Step::Confirmed(_))));
        assert_eq!(versions(&mut wire, 2..4), [OLD; 2]);
    }
    let failure = Failure::ComesUpWith(Fault::EmergencyStop, 0);
    let mut wire = bus(2, 3, Some(failure));
    let mut before = survey(&mut wire, 2);
    assert_eq!(before[1].fault, None);
    before[1].fault = Some(Fault::EmergencyStop.code());
    update::update(&mut wire, &image, &before, &Abort::default(), &mut |_| ()).unwrap();
    assert_eq!(versions(&mut wire, 2..4), [NEW; 2]);
}

/// Ctrl-C at each step: before the first confirmation all robots stay with the old image, or go
/// back to it, and the next update is taken; after it all get the new one.
#[test]
fn an_abort_at_any_step_leaves_all_robots_with_one_image() {
    let image = Image::read(file(NEW, |_| ())).unwrap();
    let all = |abort: &Abort, wire: &mut Wire<_>, at: usize| {
        let before = survey(wire, 2);
        let mut steps = Vec::new();
        let mut show = |step| {
            if steps.len() == at {
                abort.ask();
            }
            steps.push(step);
        };
        let done = update::update(wire, &image, &before, abort, &mut show);
        (done, steps)
    };
    let (done, steps) = all(&Abort::default(), &mut bus(2, 0, None), usize::MAX);
    assert_eq!(done, Ok(()));
    let confirmed = steps
        .iter()
        .position(|step| matches!(step, Step::Confirmed(_)))
        .expect("a confirmation");
    let receives = steps
        .iter()
        .filter(|step| matches!(step, Step::Receives(..)));
    assert!(
        receives.count() > 4,
        "a transfer can be aborted in its middle"
    );
    for (at, step) in steps.iter().enumerate() {
        let mut wire = bus(2, 0, None);
        let (done, seen) = all(&Abort::default(), &mut wire, at);
        let name = format!("{at}: {step:?}");
        if at >= confirmed {
            assert_eq!(done, Ok(()), "{name}");
            assert_eq!(versions(&mut wire, 2..4), [NEW; 2], "{name}");
            continue;
        }
        assert_eq!(done, Err(MasterError::Aborted), "{name}");
        assert!(!seen.iter().any(|step| matches!(step, Step::Confirmed(_))));
        assert_eq!(versions(&mut wire, 2..4), [OLD; 2], "{name}");
        let (done, _) = all(&Abort::default(), &mut wire, usize::MAX);
        assert_eq!(done, Ok(()), "{name}");
        assert_eq!(versions(&mut wire, 2..4), [NEW; 2], "{name}");
    }
}

/// One robot of two has no second slot, or firmware from before updates: the error says what to do,
/// and the other one keeps its image.
#[test]
fn robots_that_take_no_update_are_sent_to_the_cable() {
    let image = Image::read(file(NEW, |_| ())).unwrap();
    let nodes = [(2, None), (3, None)];
    let mut wire = bus(2, 3, Some(Failure::RunsFrom(None)));
    let error = update::survey(&mut wire, &nodes).unwrap_err().to_string();
    assert!(error.contains("node 3"), "{error}");
    assert!(
        error.contains("flash it once by cable (cargo xtask flash)"),
        "{error}"
    );
    let mut wire = bus(2, 3, Some(Failure::RunsFrom(Some(0))));
    let before = update::survey(&mut wire, &nodes).unwrap();
    let done = update::update(&mut wire, &image, &before, &Abort::default(), &mut |_| ());
    let error = done.unwrap_err().to_string();
    assert!(error.contains("node 3"), "{error}");
    assert!(
        error.contains("update it by cable (cargo xtask flash)"),
        "{error}"
    );
    assert_eq!(versions(&mut wire, 2..4), [OLD; 2]);
}

#[test]
fn a_file_that_not_all_can_take_changes_nothing() {
    let foreign = file(NEW, |header| header.board = Board::ROBOMASTER_C);
    let image = Image::read(foreign).unwrap();
    let mut wire = bus(2, 0, None);
    let before = survey(&mut wire, 2);
    let error = update::check(&image, &before).unwrap_err().to_string();
    assert!(error.contains("board-robomaster-c"), "{error}");
    let mut damaged = file(NEW, |_| ());
    damaged[3_000] ^= 1;
    let error = Image::read(damaged).unwrap_err();
    assert!(error.contains("slot A is damaged"), "{error}");
    let mut short = file(NEW, |_| ());
    short.truncate(5_000);
    assert!(Image::read(short).is_err());
    let error = update::go_back(&mut wire, &before, &mut |_| ());
    assert!(error.unwrap_err().to_string().contains("no other image"));
}

/// The command: what it says before it begins, and what each option leaves alone.
#[test]
fn the_command_shows_versions_and_keeps_to_its_options() {
    let write = |name: &str, bytes: Vec<u8>| {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        std::fs::write(&path, bytes).unwrap();
        path.into_os_string().into_string().unwrap()
    };
    let new = write("new.image", file(NEW, |_| ()));
    let update = |arguments: &[&str]| {
        let bus = ["--bus", "sim:groups/tcc-3.toml"];
        let output = common::omnibus(&[&["update"], arguments, &bus[..]].concat());
        let text = |bytes| String::from_utf8(bytes).unwrap();
        (
            output.status.code(),
            text(output.stdout),
            text(output.stderr),
        )
    };
    let before = |node: u8| format!("node {node}: version 0.1.0 in slot A, gets 0.2.0");

    let (code, result, notes) = update(&[&new, "--dry-run"]);
    assert_eq!((code, &*result), (Some(0), "nothing was changed\n"));
    assert!((2..5).all(|node| notes.contains(&before(node))), "{notes}");
    assert!(!notes.contains("erases"), "{notes}");

    let (code, result, notes) = update(&[&new, "--node", "3"]);
    let all = "all robots run the new image\n";
    assert_eq!((code, &*result), (Some(0), all), "{notes}");
    assert!(notes.contains("node 3: confirmed"), "{notes}");
    assert!(
        !notes.contains("node 2") && !notes.contains("node 4"),
        "{notes}"
    );

    let (code, result, notes) = update(&[&new]);
    assert_eq!((code, &*result), (Some(0), all), "{notes}");
    for node in 2..5 {
        assert!(
            notes.contains(&format!("node {node}: confirmed")),
            "{notes}"
        );
    }

    let (code, _, notes) = update(&["--rollback"]);
    assert!(notes.contains("no other image"), "{notes}");
    assert!(code.is_some_and(|code| code != 0) && !notes.contains("goes back\n"));

    // What the other robots would not understand is for all of them or for none.
    let wire = write("wire.image", file(NEW, |header| header.wire_version += 1));
    let (code, _, notes) = update(&[&wire, "--node", "3"]);
    assert!(
        code == Some(2) && notes.contains("update all of them"),
        "{notes}"
    );
    let (code, _, _) = update(&[&new, "--node", "18"]);
    assert_eq!(code, Some(2));
}
