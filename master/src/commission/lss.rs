//! Node ids over the bus (CiA 305): finding robots that have none, and giving them one.
//!
//! A conversation goes over a [`Wire`] and claims nothing; robots take part in every NMT state.
//! What a robot is given counts from its next communication reset, and is kept only when it is told
//! to store it. Whatever happens, all robots are switched back to waiting at the end.

use canopen::client::{
    FastScan, LssAnswer, Scanned, lss_identify, lss_inquire_node, lss_select, lss_set_node,
    lss_store, lss_switch_all, parse_lss,
};
use canopen::{Frame, Identity, Micros, NodeId};
use protocol::{Address, Kind};

use crate::bus::link::Link;
use crate::bus::wire::Wire;
use crate::error::MasterError;

/// How long an answer may take, in µs. Silence is an answer too, so a scan takes this often.
const ANSWER_US: u64 = 20_000;
/// Storing may have to erase flash first, in µs.
const STORE_US: u64 = 2_000_000;
/// More robots than this cannot be on one bus.
const MOST: usize = 16;

/// An identity as people write it.
#[must_use]
pub fn show(identity: &Identity) -> String {
    format!(
        "vendor {:08X} product {:08X} revision {:08X} serial {:08X}",
        identity.vendor, identity.product, identity.revision, identity.serial
    )
}

fn problem(text: &str) -> MasterError {
    MasterError::Lss(text.into())
}

/// Sends requests and waits for the answer that `wanted` picks.
fn talk<L: Link, T>(
    wire: &mut Wire<L>,
    requests: &[Frame],
    patience_us: u64,
    mut wanted: impl FnMut(LssAnswer) -> Option<T>,
) -> Result<Option<T>, MasterError> {
    for frame in requests {
        wire.send(frame)?;
    }
    let until = wire.now() + Micros(patience_us);
    while let Some((_, frame)) = wire.next(until)? {
        if let Some(answer) = parse_lss(&frame).and_then(&mut wanted) {
            return Ok(Some(answer));
        }
    }
    Ok(None)
}

/// Switches all robots back to waiting; a robot that has just got its first node id boots by that.
fn leave<L: Link>(wire: &mut Wire<L>) -> Result<(), MasterError> {
    wire.send(&lss_switch_all(false))
}

/// The robots without a node id, one after the other.
///
/// # Errors
/// When the link fails or a robot stops answering in the middle.
pub fn unconfigured<L: Link>(wire: &mut Wire<L>) -> Result<Vec<Identity>, MasterError> {
    let mut found = Vec::new();
    leave(wire)?;
    while found.len() < MOST {
        // One that has been found listens to configuration and takes no part in the next scan.
        match scan_once(wire)? {
            Scanned::Found(identity) => found.push(identity),
            Scanned::NoUnconfiguredSlave => break,
            Scanned::Lost => {
                leave(wire)?;
                return Err(problem(
                    "a robot stopped answering in the middle of a scan; check its power and try \
                     again",
                ));
            }
        }
    }
    leave(wire)?;
    Ok(found)
}

/// Robots of this release whose serial number is none of `known`, which must rise, each with its
/// node id. Robots that have the same node id are found like any others: all that match a range of
/// numbers give the same answer, which on the wire is one frame, and a range that answers is halved
/// until one number is left.
///
/// Nothing but the answers is asked of robots, unless there are unknown ones: those are selected to
/// ask for their node id. One more robot costs some 0.7 s.
///
/// # Errors
/// When the link fails.
pub fn unknown<L: Link>(
    wire: &mut Wire<L>,
    known: &[u32],
) -> Result<Vec<(u32, Option<NodeId>)>, MasterError> {
    let mut serials = Vec::new();
    let mut low = Some(0);
    for known in known.iter().copied().map(Some).chain([None]) {
        // From after the one before to before this one.
        let high = known.map_or(Some(u32::MAX), |serial| serial.checked_sub(1));
        if let (Some(low), Some(high)) = (low, high)
            && low <= high
            && is_any(wire, low, high)?
        {
            halve(wire, low, high, &mut serials)?;
        }
        low = known.and_then(|serial| serial.checked_add(1));
    }
    let mut found = Vec::new();
    for serial in serials {
        let identity = Identity { serial, ..ROBOT };
        leave(wire)?;
        talk(wire, &lss_select(&identity), ANSWER_US, |answer| {
            (answer == LssAnswer::Selected).then_some(())
        })?;
        let node = talk(wire, &[lss_inquire_node()], ANSWER_US, |a| match a {
            LssAnswer::Node(node) => Some(node),
            _ => None,
        })?;
        leave(wire)?;
        found.push((serial, node.flatten()));
    }
    Ok(found)
}

/// What robots of this release have in common, object 0x1018.
const ROBOT: Identity = Identity {
    vendor: 0,
    product: protocol::PRODUCT,
    revision: (protocol::WIRE_VERSION as u32) << 16,
    serial: 0,
};

/// Whether a robot has a serial number from `low` to `high`.
fn is_any<L: Link>(wire: &mut Wire<L>, low: u32, high: u32) -> Result<bool, MasterError> {
    let requests = lss_identify(&ROBOT, &(low..=high));
    let answer = talk(wire, &requests, ANSWER_US, |answer| {
        (answer == LssAnswer::Present).then_some(())
    })?;
    Ok(answer.is_some())
}

/// The serial numbers of a range in which there is one.
fn halve<L: Link>(
    wire: &mut Wire<L>,
    low: u32,
    high: u32,
    found: &mut Vec<u32>,
) -> Result<(), MasterError> {
    if found.len() >= MOST {
        return Ok(());
    }
    if low == high {
        found.push(low);
        return Ok(());
    }
    let middle = low + (high - low) / 2;
    let below = is_any(wire, low, middle)?;
    if below {
        halve(wire, low, middle, found)?;
    }
    if !below || is_any(wire, middle + 1, high)? {
        halve(wire, middle + 1, high, found)?;
    }
    Ok(())
}

fn scan_once<L: Link>(wire: &mut Wire<L>) -> Result<Scanned, MasterError> {
    let mut scan = FastScan::new(wire.now(), Micros(ANSWER_US));
    loop {
        while let Some(frame) = scan.pop_frame() {
            wire.send(&frame)?;
        }
        let deadline = scan.next_deadline().unwrap_or(wire.now());
        let outcome = match wire.next(deadline)? {
            Some((at, frame)) => scan.on_frame(at, &frame),
            None => scan.poll(wire.now()),
        };
        if let Some(outcome) = outcome {
            return Ok(outcome);
        }
    }
}

/// The identity of a robot that has a node id.
///
/// # Errors
/// When it does not answer.
pub fn identity<L: Link>(wire: &mut Wire<L>, node: u8) -> Result<Identity, MasterError> {
    let mut part = |sub| -> Result<u32, MasterError> {
        Ok(wire
            .read(node, Address::new(0x1018, sub), Kind::U32)?
            .to_bits())
    };
    Ok(Identity {
        vendor: part(1)?,
        product: part(2)?,
        revision: part(3)?,
        serial: part(4)?,
    })
}

/// Gives the robot with this identity a node id, and stores it in the robot if asked to.
///
/// # Errors
/// When no robot has that identity, or it refuses; then it keeps what it had.
pub fn assign<L: Link>(
    wire: &mut Wire<L>,
    identity: &Identity,
    node: NodeId,
    store: bool,
) -> Result<(), MasterError> {
    leave(wire)?;
    let done = assign_selected(wire, identity, node, store);
    leave(wire)?;
    done
}

fn assign_selected<L: Link>(
    wire: &mut Wire<L>,
    identity: &Identity,
    node: NodeId,
    store: bool,
) -> Result<(), MasterError> {
    let selected = talk(wire, &lss_select(identity), ANSWER_US, |answer| {
        (answer == LssAnswer::Selected).then_some(())
    })?;
    if selected.is_none() {
        return Err(problem(&format!(
            "no robot answers as {}; `omnibus lss scan` lists those that do",
            show(identity)
        )));
    }
    let set = talk(wire, &[lss_set_node(Some(node))], ANSWER_US, |a| match a {
        LssAnswer::NodeIdSet(error) => Some(error),
        _ => None,
    })?;
    match set {
        Some(0) => {}
        Some(_) => {
            return Err(problem(
                "the robot refuses that node id; a locked one takes none before `omnibus unlock`",
            ));
        }
        None => {
            return Err(problem(
                "the robot was selected and then did not answer; check its \
                                    power and try again",
            ));
        }
    }
    if store {
        let stored = talk(wire, &[lss_store()], STORE_US, |answer| match answer {
            LssAnswer::Stored(error) => Some(error),
            _ => None,
        })?;
        match stored {
            Some(0) => {}
            Some(1) => return Err(problem("the robot has no storage for a node id")),
            Some(_) => {
                return Err(problem(
                    "the robot could not store its node id; stop it (PRE-OPERATIONAL), then try \
                     again",
                ));
            }
            None => {
                return Err(problem(
                    "the robot did not confirm that it stored its node id; try \
                                        again",
                ));
            }
        }
    }
    let now = talk(wire, &[lss_inquire_node()], ANSWER_US, |a| match a {
        LssAnswer::Node(node) => Some(node),
        _ => None,
    })?;
    // It answers with the id in force, which changes at the reset.
    now.map(|_| ()).ok_or_else(|| {
        problem(
            "the robot accepted its node id and then did not answer; `omnibus \
                                lss scan` shows its id",
        )
    })
}
