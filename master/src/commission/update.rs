//! A new image for robots, over the bus: either all of them start it, or all of them keep what they
//! have.
//!
//! # Theory of operation
//!
//! Robots are asked first what they run and which slot they want; nothing is written unless all of
//! them can take the file. Then each gets the image linked for its slot, one after the other, and
//! checks it. Only when all have one that is whole are they told to start it, and only when all
//! have started it, and say so, and none has a fault that it did not have before, is it confirmed.
//! When anything fails before the start, no robot starts anything; when it fails after, those that
//! have started go back, and a robot that cannot be reached goes back by itself because its image
//! is not confirmed. The same follows from an abort up to the first confirmation; from then on the
//! update is completed.
//!
//! # Interface
//!
//! `omnibus update` calls [`Image::read`], [`survey`], [`check`], then [`update`] or [`go_back`],
//! and shows every [`Step`]. Its [`Abort`] is what Ctrl-C asks for.
//!
//! # Limits
//!
//! The master does not check the signature: each robot knows the key that it believes.

use boot::header::{Header, LENGTH};
use boot::{Crypto, Slot, Software};
use canopen::{AbortCode, Micros, NmtCommand, NmtState, NmtTarget, NodeId, client};
use protocol::{Address, Code, Fault, Kind, MemberState, Value, address as at, cob};
use robot::update::{Problem, order};

use crate::abort::Abort;
use crate::bus::link::Link;
use crate::bus::wire::Wire;
use crate::error::MasterError;
use crate::session::sdo;

/// How long a robot may receive nothing while it erases a sector, in µs (DS10693 rev 10, table 49:
/// 2 s for 128 KiB).
const ERASE_US: u64 = 3_000_000;
/// How long a robot may be busy in all, in µs.
const BUSY_US: u64 = 10_000_000;
/// How long a robot may take to start, in µs.
const BOOT_US: u64 = 5_000_000;
/// How often a busy robot is asked, in µs.
const ASK_US: u64 = 20_000;

/// An image file.
#[derive(Debug)]
pub struct Image {
    /// What it is for.
    pub header: Header,
    bytes: Vec<u8>,
}

impl Image {
    /// Reads the bytes of a file, which have to be whole.
    ///
    /// # Errors
    /// In words, what is wrong with it.
    pub fn read(bytes: Vec<u8>) -> Result<Self, String> {
        let header = Header::parse(&bytes).map_err(|error| error.to_string())?;
        let whole = header.offset(Slot::B) + header.b.length as usize;
        if bytes.len() != whole {
            return Err(format!(
                "the file has {} bytes, but its header says {whole}; copy it again",
                bytes.len()
            ));
        }
        let image = Self { header, bytes };
        for slot in Slot::ALL {
            let crypto = Software::default();
            let mut hash = crypto.begin();
            crypto.update(&mut hash, image.link(slot));
            if crypto.finish(hash) != header.link(slot).hash {
                return Err(format!(
                    "the image for slot {slot:?} is damaged; copy the file again"
                ));
            }
        }
        Ok(image)
    }

    fn link(&self, slot: Slot) -> &[u8] {
        let start = self.header.offset(slot);
        let end = start + self.header.link(slot).length as usize;
        self.bytes.get(start..end).unwrap_or(&[])
    }

    /// What a robot that wants this slot is sent.
    #[must_use]
    pub fn download(&self, slot: Slot) -> Vec<u8> {
        [self.bytes.get(..LENGTH).unwrap_or(&[]), self.link(slot)].concat()
    }
}

/// What a robot says before an update.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Before {
    /// Node.
    pub node: u8,
    /// Version that it runs, as object 0x2001:2 has it.
    pub version: u32,
    /// Slot that it runs from; `None` for a robot without slots.
    pub slot: Option<Slot>,
    /// Version of the image in its other slot; 0 for none.
    pub other: u32,
    /// Board.
    pub board: u16,
    /// Revision of its hardware.
    pub hardware: u16,
    /// Security counter of what it runs.
    pub security_counter: u32,
    /// The image that it runs is on trial.
    pub is_unconfirmed: bool,
    /// Number of the fault that is latched, if one is.
    pub fault: Option<u16>,
}

/// What happens with one robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Its slot is being erased.
    Erases(u8),
    /// So many bytes of so many have arrived.
    Receives(u8, usize, usize),
    /// It has a whole image.
    HasIt(u8),
    /// It starts the image.
    Starts(u8),
    /// The image is confirmed.
    Confirmed(u8),
    /// It goes back to what it had.
    GoesBack(u8),
}

/// Asks robots what they run. Each has to be in PRE-OPERATIONAL, where an update is permitted.
///
/// # Errors
/// When a robot does not answer, or is OPERATIONAL.
pub fn survey<L: Link>(
    wire: &mut Wire<L>,
    nodes: &[(u8, Option<NmtState>)],
) -> Result<Vec<Before>, MasterError> {
    let one = |(node, state): &(u8, Option<NmtState>)| {
        let node = *node;
        if *state == Some(NmtState::Operational) {
            return Err(refused(
                node,
                "it is OPERATIONAL; stop the group first, then try again",
            ));
        }
        let mut read = |address, kind| wire.read(node, address, kind).map(Value::to_bits);
        let slot = read(at::RUNNING_SLOT, Kind::U8).map_err(|error| match error {
            MasterError::Refused {
                abort: AbortCode::NoObject,
                ..
            } => refused(
                node,
                "its firmware is older than updates over the bus and has no boot code; flash it \
                 once by cable (cargo xtask flash), which keeps its parameters",
            ),
            other => other,
        })?;
        let version = read(at::FIRMWARE_VERSION, Kind::U32)?;
        let slot = match slot {
            1 => Some(Slot::A),
            2 => Some(Slot::B),
            _ => None,
        };
        let low = |bits: u32| u16::try_from(bits).unwrap_or(u16::MAX);
        Ok(Before {
            node,
            version,
            slot,
            other: read(at::OTHER_VERSION, Kind::U32)?,
            board: low(read(at::BOARD, Kind::U16)?),
            hardware: low(read(at::HARDWARE_REVISION, Kind::U16)?),
            security_counter: read(at::SECURITY_COUNTER, Kind::U32)?,
            is_unconfirmed: read(at::PROGRAM_CONTROL, Kind::U8)? == u32::from(order::CONFIRM),
            fault: latched(wire, node)?,
        })
    };
    nodes.iter().map(one).collect()
}

/// Whether all of these robots can take a file.
///
/// # Errors
/// The first that cannot.
pub fn check(image: &Image, robots: &[Before]) -> Result<(), MasterError> {
    for robot in robots {
        let device = boot::header::Device {
            board: boot::header::Board(robot.board),
            hardware: robot.hardware,
            security_counter: robot.security_counter,
        };
        let node = robot.node;
        if robot.slot.is_none() {
            return Err(refused(
                node,
                "it has no second slot in flash; update it by cable (cargo xtask flash)",
            ));
        }
        if robot.is_unconfirmed {
            let reason = "its image is on trial; wait until it is confirmed, or has gone back";
            return Err(refused(node, reason));
        }
        if let Err(refusal) = image.header.admit(&device) {
            return Err(refused(
                node,
                &format!("{refusal}; take the file that was made for it"),
            ));
        }
    }
    Ok(())
}

/// Brings an image to all of these robots, or to none.
///
/// # Errors
/// What went wrong first, or [`MasterError::Aborted`]. Unless the error says otherwise, all robots
/// run what they did before.
pub fn update<L: Link>(
    wire: &mut Wire<L>,
    image: &Image,
    robots: &[Before],
    abort: &Abort,
    show: &mut dyn FnMut(Step),
) -> Result<(), MasterError> {
    check(image, robots)?;
    for robot in robots {
        let sent = send(wire, image, robot, abort, show);
        sent.map_err(|error| explain(wire, robot.node, error))?;
        show(Step::HasIt(robot.node));
    }
    let mut started = Vec::new();
    let done = start_all(wire, robots, &mut started, abort, show);
    if let Err(error) = done {
        back(wire, &started, show);
        return Err(error);
    }
    Ok(())
}

/// Lets all of these robots go back to the image that they had before.
///
/// # Errors
/// When one has none, before any is told; when one refuses, and when one does not start. The error
/// names those that have gone back before.
pub fn go_back<L: Link>(
    wire: &mut Wire<L>,
    robots: &[Before],
    show: &mut dyn FnMut(Step),
) -> Result<(), MasterError> {
    for robot in robots {
        if robot.slot.is_none() || robot.other == 0 && robot.slot == Some(Slot::A) {
            return Err(refused(robot.node, "it has no other image to go back to"));
        }
    }
    let mut gone: Vec<u8> = Vec::new();
    for robot in robots {
        let node = robot.node;
        if let Err(error) = restart(wire, node, order::GO_BACK) {
            return Err(stays(node, &gone, error));
        }
        show(Step::GoesBack(node));
        await_boot(wire, node)?;
        gone.push(node);
    }
    Ok(())
}

/// Why a robot does not go back, and which others have.
fn stays(node: u8, gone: &[u8], error: MasterError) -> MasterError {
    if !matches!(
        error,
        MasterError::Refused {
            abort: AbortCode::DeviceState,
            ..
        }
    ) {
        return error;
    }
    let others = match gone {
        [] => String::new(),
        gone => format!("; before it nodes {gone:?} went back"),
    };
    refused(
        node,
        &format!(
            "its other image was rejected or never confirmed, so it does not go back to that; \
             bring the right one with omnibus update{others}"
        ),
    )
}

fn send<L: Link>(
    wire: &mut Wire<L>,
    image: &Image,
    robot: &Before,
    abort: &Abort,
    show: &mut dyn FnMut(Step),
) -> Result<(), MasterError> {
    abort.check()?;
    let node = robot.node;
    let server = NodeId::new(node).ok_or(MasterError::NodeSilent { node })?;
    let to = NmtTarget::Node(server);
    wire.send(&client::nmt(NmtCommand::EnterPreOperational, to))?;
    command(wire, node, order::STOP)?;
    show(Step::Erases(node));
    command(wire, node, order::CLEAR)?;
    await_idle(wire, node)?;
    abort.check()?;
    let slot = robot.slot.map_or(Slot::B, Slot::other);
    let bytes = image.download(slot);
    let length = bytes.len();
    wire.download(node, at::PROGRAM_DATA, &bytes, &mut |sent| {
        show(Step::Receives(node, sent.min(length), length));
        abort.check()
    })?;
    await_idle(wire, node)
}

fn start_all<L: Link>(
    wire: &mut Wire<L>,
    robots: &[Before],
    started: &mut Vec<u8>,
    abort: &Abort,
    show: &mut dyn FnMut(Step),
) -> Result<(), MasterError> {
    for robot in robots {
        abort.check()?;
        let node = robot.node;
        let new = read(wire, node, at::PROGRAM_IDENTIFICATION, Kind::U32)?;
        restart(wire, node, order::START)?;
        show(Step::Starts(node));
        started.push(node);
        await_boot(wire, node)?;
        let runs = read(wire, node, at::PROGRAM_IDENTIFICATION, Kind::U32)?;
        if runs != new {
            return Err(refused(
                node,
                "the new image did not start, and the robot runs the old one; all robots go back",
            ));
        }
    }
    for robot in robots {
        has_no_new_fault(wire, robot)?;
    }
    abort.check()?;
    for robot in robots {
        command(wire, robot.node, order::CONFIRM)?;
        await_idle(wire, robot.node)?;
        show(Step::Confirmed(robot.node));
    }
    Ok(())
}

/// The fault that a robot has latched.
fn latched<L: Link>(wire: &mut Wire<L>, node: u8) -> Result<Option<u16>, MasterError> {
    let state = read(wire, node, at::STATE, Kind::U8)?;
    if state != MemberState::Faulted as u32 {
        return Ok(None);
    }
    let code = read(wire, node, at::STATUS_CODE, Kind::U16)?;
    Ok(u16::try_from(code).ok())
}

/// An image that came up with a fault which the one before did not have is not confirmed: it may
/// for instance not be able to read the parameters.
fn has_no_new_fault<L: Link>(wire: &mut Wire<L>, robot: &Before) -> Result<(), MasterError> {
    let node = robot.node;
    let Some(code) = latched(wire, node)?.filter(|code| robot.fault != Some(*code)) else {
        return Ok(());
    };
    let name = Code::from_code(code)
        .map_or_else(|| format!("unknown {code:#06x}"), |code| code.to_string());
    let object = if code == Fault::ParametersCorrupt.code() {
        let status = read(wire, node, at::CONFIGURATION_STATUS, Kind::U32)?;
        let [_, sub, low, high] = status.to_le_bytes();
        match Address::new(u16::from_le_bytes([low, high]), sub) {
            Address { index: 0, .. } => " (the stored image as a whole)".into(),
            address => format!(" ({})", sdo::name(address)),
        }
    } else {
        String::new()
    };
    Err(refused(
        node,
        &format!("the new image came up with a new fault, {name}{object}; all robots go back"),
    ))
}

/// Lets those that have started go back. One that runs the old image refuses, and one that cannot
/// be told goes back by itself.
fn back<L: Link>(wire: &mut Wire<L>, started: &[u8], show: &mut dyn FnMut(Step)) {
    for node in started {
        if restart(wire, *node, order::GO_BACK).is_ok() {
            show(Step::GoesBack(*node));
            // What is wrong with it is in the error that led here.
            let _ = await_boot(wire, *node);
        }
    }
}

fn command<L: Link>(wire: &mut Wire<L>, node: u8, value: u8) -> Result<(), MasterError> {
    wire.write(node, at::PROGRAM_CONTROL, Value::U8(value))
}

/// An order that makes the robot start again. What has been received before is forgotten: only the
/// boot-up that follows counts.
fn restart<L: Link>(wire: &mut Wire<L>, node: u8, value: u8) -> Result<(), MasterError> {
    wire.backlog.clear();
    command(wire, node, value)
}

fn read<L: Link>(
    wire: &mut Wire<L>,
    node: u8,
    address: Address,
    kind: Kind,
) -> Result<u32, MasterError> {
    wire.read(node, address, kind).map(Value::to_bits)
}

/// Waits until a robot is no longer busy.
fn await_idle<L: Link>(wire: &mut Wire<L>, node: u8) -> Result<(), MasterError> {
    let before = std::mem::replace(&mut wire.patience_us, ERASE_US);
    let until = wire.now().0 + BUSY_US;
    let status = loop {
        let status = read(wire, node, at::FLASH_STATUS, Kind::U32);
        match status {
            Ok(status) if status & 1 != 0 && wire.now().0 < until => wire.pass(ASK_US)?,
            other => break other,
        }
    };
    wire.patience_us = before;
    match status? {
        0 => Ok(()),
        status if status & 1 != 0 => Err(refused(node, "it is still busy; reset it and try again")),
        _ => {
            let problem = read(wire, node, at::UPDATE_PROBLEM, Kind::U8)?;
            Err(refused(node, reason(problem)))
        }
    }
}

/// Waits for the boot-up message.
fn await_boot<L: Link>(wire: &mut Wire<L>, node: u8) -> Result<(), MasterError> {
    let until = wire.now() + Micros(BOOT_US);
    while let Some((_, frame)) = wire.next(until)? {
        if frame.id() == cob::heartbeat(node) && frame.data() == [0] {
            return Ok(());
        }
    }
    Err(refused(
        node,
        "it did not start again; it goes back to its old image by itself within three minutes",
    ))
}

/// Adds what the robot says about a refusal.
fn explain<L: Link>(wire: &mut Wire<L>, node: u8, error: MasterError) -> MasterError {
    if !matches!(error, MasterError::Refused { .. }) {
        return error;
    }
    match read(wire, node, at::UPDATE_PROBLEM, Kind::U8) {
        Ok(problem) if problem != 0 => refused(node, reason(problem)),
        Ok(_) | Err(_) => error,
    }
}

fn refused(node: u8, reason: &str) -> MasterError {
    MasterError::Update {
        node,
        reason: reason.to_owned(),
    }
}

/// What object 0x2003:3 says, and what to do.
fn reason(problem: u32) -> &'static str {
    const PROBLEMS: [(Problem, &str); 10] = [
        (
            Problem::Header,
            "the file is not an image file; make one with cargo xtask release",
        ),
        (
            Problem::Board,
            "the image is for another board; take the file for this one",
        ),
        (
            Problem::Hardware,
            "the image is for another hardware revision; take the file for this one",
        ),
        (
            Problem::Downgrade,
            "the image has a lower security counter than the one that runs; take a newer file",
        ),
        (
            Problem::Length,
            "the transfer had a wrong length; try again",
        ),
        (
            Problem::Hash,
            "the image arrived damaged; try again, and check the bus wiring",
        ),
        (
            Problem::Signature,
            "the file is not signed with the key that the robot knows; sign it with that one",
        ),
        (
            Problem::Flash,
            "its flash cannot be written; replace the board if this happens again",
        ),
        (Problem::Transfer, "the transfer ended early; try again"),
        (
            Problem::Trial,
            "its image is on trial; wait until it is confirmed, or has gone back",
        ),
    ];
    let known = PROBLEMS.iter().find(|(known, _)| *known as u32 == problem);
    known.map_or(
        "it gives no reason; reset it and try again",
        |(_, reason)| reason,
    )
}
