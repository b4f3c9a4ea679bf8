//! Surveys a bus: every robot that answers, its identity, and contradictions between them.
//!
//! A survey only reads and does not claim to be the master, so a running group is not disturbed.
//!
//! All sixteen robots are asked for their serial number at once. Robots that are one node by
//! mistake answer with different bits: on the wire the answers destroy each other until both robots
//! are error passive, then they come one after the other. What would be the same in both, like a
//! version, comes as one frame and shows nothing. Then LSS asks whether there are further
//! robots, which needs no node id.

use std::collections::BTreeMap;

use canopen::{Frame, Micros, NmtState, client};
use group::GroupFile;
use protocol::{Code, Kind, MemberState, Value, address, cob};

use crate::bus::link::Link;
use crate::bus::wire::Wire;
use crate::commission::lss;
use crate::error::MasterError;

/// How long heartbeats are listened for before robots are asked, in µs.
const LISTEN_US: u64 = 500_000;
/// How long answers may take, in µs.
const ANSWERS_US: u64 = 100_000;

/// A robot that answered.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// Node id.
    pub node: u8,
    /// Robots that answered under this node id.
    pub answers: u32,
    /// Serial numbers of those robots, as far as they are known.
    pub serials: Vec<u32>,
    /// NMT state from its heartbeat.
    pub nmt: Option<NmtState>,
    /// Version of the bytes on the bus; this and what follows is 0 where several robots answered.
    pub wire_version: u32,
    /// Serial number.
    pub serial: u32,
    /// Firmware version: major, minor, patch in the upper three bytes.
    pub firmware: u32,
    /// What it is doing; `None` when this release does not know the number.
    pub state: Option<MemberState>,
    /// Its limit or fault, as sent.
    pub code: u16,
}

impl Found {
    /// A robot about which nothing more is known.
    fn unread(node: u8, answers: u32, serials: Vec<u32>) -> Self {
        Self {
            node,
            answers,
            serials,
            nmt: None,
            wire_version: 0,
            serial: 0,
            firmware: 0,
            state: None,
            code: 0,
        }
    }

    /// The firmware version as people write it.
    #[must_use]
    pub fn firmware_text(&self) -> String {
        let [major, minor, patch, _] = self.firmware.to_be_bytes();
        format!("{major}.{minor}.{patch}")
    }

    /// Its limit or fault in words.
    #[must_use]
    pub fn code_text(&self) -> String {
        Code::from_code(self.code).map_or_else(
            || format!("unknown {:#06x}", self.code),
            |code| code.to_string(),
        )
    }
}

/// What a survey found.
#[derive(Clone, Debug, PartialEq)]
pub struct Survey {
    /// Robots, by rising node id.
    pub found: Vec<Found>,
    /// Nodes of the group file that are silent.
    pub missing: Vec<u8>,
    /// Nodes with a robot's id that answer but are none of these robots.
    pub foreign: Vec<u8>,
    /// Another master's heartbeat was heard.
    pub master: bool,
    /// What cannot be right, in sentences that say what to do.
    pub conflicts: Vec<String>,
}

impl Survey {
    /// Surveys a bus; `group` says who should be there.
    ///
    /// # Errors
    /// When the link fails, or a robot that answered once refuses to go on.
    pub fn take<L: Link>(
        wire: &mut Wire<L>,
        group: Option<&GroupFile>,
    ) -> Result<Self, MasterError> {
        let mut states = BTreeMap::new();
        let until = wire.now() + Micros(LISTEN_US);
        while let Some((_, frame)) = wire.next(until)? {
            if let Some((node, state)) = client::parse_heartbeat(&frame) {
                states.insert(node.get(), state);
            }
        }
        let mut answered = ask_all(wire)?;
        let mut known: Vec<u32> = answered.values().flatten().copied().collect();
        known.sort_unstable();
        known.dedup();
        for (serial, node) in lss::unknown(wire, &known)? {
            if let Some(node) = node {
                answered.entry(node.get()).or_default().push(serial);
            }
        }
        let mut found = Vec::new();
        let mut foreign = Vec::new();
        for (node, serials) in answered {
            let answers = u32::try_from(serials.len()).unwrap_or(u32::MAX);
            if answers > 1 {
                // Their answers cannot be told apart.
                found.push(Found::unread(node, answers, serials));
                continue;
            }
            let mut read =
                |at, kind| -> Result<u32, MasterError> { Ok(wire.read(node, at, kind)?.to_bits()) };
            let mut robot = || -> Result<Found, MasterError> {
                let wire_version = read(address::WIRE_VERSION, Kind::U16)?;
                let state = read(address::STATE, Kind::U8)?;
                let code = read(address::STATUS_CODE, Kind::U16)?;
                Ok(Found {
                    node,
                    answers,
                    serials: serials.clone(),
                    nmt: states.get(&node).copied(),
                    wire_version,
                    serial: read(address::SERIAL_NUMBER, Kind::U32)?,
                    firmware: read(address::FIRMWARE_VERSION, Kind::U32)?,
                    state: u8::try_from(state).ok().and_then(|s| s.try_into().ok()),
                    code: u16::try_from(code).unwrap_or(u16::MAX),
                })
            };
            match robot() {
                Ok(robot) => found.push(robot),
                // Any CANopen device has a serial number; only these robots have the rest.
                Err(MasterError::Refused { .. } | MasterError::Answer { .. }) => foreign.push(node),
                Err(error) => return Err(error),
            }
        }
        let missing = group.map_or_else(Vec::new, |group| {
            let nodes = group.robots.iter().map(|robot| robot.node);
            nodes
                .filter(|n| !found.iter().any(|f| f.node == *n))
                .collect()
        });
        let mut conflicts = conflicts(&found, group);
        conflicts.extend(foreign.iter().map(|node| {
            format!(
                "node {node} is a CANopen device, but not one of these robots; give it an id outside \
                 {} to {}",
                protocol::FIRST_ROBOT,
                protocol::LAST_ROBOT
            )
        }));
        Ok(Self {
            found,
            missing,
            foreign,
            master: states.contains_key(&protocol::MASTER),
            conflicts,
        })
    }
}

/// The serial numbers that come from each node when all are asked for theirs.
fn ask_all<L: Link>(wire: &mut Wire<L>) -> Result<BTreeMap<u8, Vec<u32>>, MasterError> {
    let at = address::SERIAL_NUMBER;
    let [low, high] = at.index.to_le_bytes();
    for node in protocol::FIRST_ROBOT..=protocol::LAST_ROBOT {
        let request = [0x40, low, high, at.sub, 0, 0, 0, 0];
        wire.send(&Frame::of(cob::sdo_request(node), request))?;
    }
    let mut answers: BTreeMap<u8, Vec<u32>> = BTreeMap::new();
    let until = wire.now() + Micros(ANSWERS_US);
    while let Some((_, frame)) = wire.next(until)? {
        let node = (protocol::FIRST_ROBOT..=protocol::LAST_ROBOT)
            .find(|node| frame.id() == cob::sdo_response(*node));
        // Another master's transfer with the robot concerns another object.
        if let (Some(node), [_, a, b, c, serial @ ..]) = (node, frame.data())
            && [*a, *b, *c] == [low, high, at.sub]
            && let Ok(serial) = serial.try_into()
        {
            let serials = answers.entry(node).or_default();
            serials.push(u32::from_le_bytes(serial));
        }
    }
    Ok(answers)
}

fn conflicts(found: &[Found], group: Option<&GroupFile>) -> Vec<String> {
    let mut out = Vec::new();
    for robot in found {
        let node = robot.node;
        if robot.answers > 1 {
            let serials = robot.serials.iter().map(|serial| format!("{serial:08X}"));
            let serials: Vec<String> = serials.collect();
            out.push(format!(
                "{} robots answer as node {node}, serial numbers {}; set the node switches of all \
                 but one to another number (docs/bring-up.md says which switch counts what), or \
                 use `omnibus lss`, and switch them off and on",
                robot.answers,
                serials.join(", ")
            ));
            continue;
        }
        if robot.wire_version != u32::from(protocol::WIRE_VERSION) {
            out.push(format!(
                "node {node} has wire version {}, this master {}; flash the robot with the \
                 firmware of this release",
                robot.wire_version,
                protocol::WIRE_VERSION
            ));
        }
        if group.is_some_and(|group| !group.robots.iter().any(|r| r.node == node)) {
            out.push(format!(
                "node {node} is not in the group file; add it there, or take it off the bus"
            ));
        }
        let twin = found
            .iter()
            .find(|o| o.answers == 1 && o.node < node && o.serial == robot.serial);
        if let Some(twin) = twin {
            out.push(format!(
                "nodes {} and {node} have the same serial number {:08X}; one of them runs a copy \
                 of the other's settings",
                twin.node, robot.serial
            ));
        }
    }
    out
}

/// Reads an object; `None` when the node does not answer.
///
/// # Errors
/// As [`Wire::read`] otherwise.
pub fn ask<L: Link>(
    wire: &mut Wire<L>,
    node: u8,
    at: protocol::Address,
    kind: Kind,
) -> Result<Option<Value>, MasterError> {
    match wire.read(node, at, kind) {
        Ok(value) => Ok(Some(value)),
        Err(error) if matches!(error.cause(), MasterError::NodeSilent { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fake::FakeBus;

    fn bus(nodes: &[u8]) -> FakeBus {
        let mut bus = FakeBus::new(nodes);
        for (n, robot) in (0u8..).zip(&mut bus.robots) {
            robot.store.extend([
                (address::SERIAL_NUMBER, vec![n, 0, 0, 1]),
                (address::FIRMWARE_VERSION, vec![0, 3, 2, 1]),
                (address::STATE, vec![1]),
                (address::STATUS_CODE, vec![0, 0]),
            ]);
        }
        bus
    }

    fn file() -> GroupFile {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-3.toml");
        GroupFile::load(path).unwrap()
    }

    #[test]
    fn a_bus_in_order_has_no_conflicts_and_is_only_read() {
        let mut bus = bus(&[2, 3, 4]);
        let survey = Survey::take(&mut Wire::visiting(&mut bus), Some(&file())).unwrap();
        assert_eq!(survey.conflicts, [""; 0]);
        assert_eq!(survey.missing, [0; 0]);
        assert_eq!(survey.found.len(), 3);
        assert_eq!(survey.found[1].firmware_text(), "1.2.3");
        assert_eq!(survey.found[1].state, Some(MemberState::Ready));
        let requests = bus.sent.iter().all(|(_, frame)| {
            matches!(
                (frame.id(), frame.data()[0]),
                (0x600..0x680, 0x40) | (0x7E5, 0x46..=0x4B)
            )
        });
        assert!(
            requests,
            "a survey sends nothing but SDO reads and LSS identify"
        );
    }

    /// A device of another maker on node 5: it has a serial number and nothing else.
    #[test]
    fn a_foreign_device_hides_no_robot() {
        let mut bus = bus(&[2, 3, 4, 5]);
        let serial = bus.robots[3].store[&address::SERIAL_NUMBER].clone();
        bus.robots[3].store.clear();
        bus.robots[3].store.insert(address::SERIAL_NUMBER, serial);
        let survey = Survey::take(&mut Wire::visiting(&mut bus), Some(&file())).unwrap();
        let nodes: Vec<u8> = survey.found.iter().map(|robot| robot.node).collect();
        assert_eq!((nodes, survey.foreign), (vec![2, 3, 4], vec![5]));
        assert!(survey.conflicts[0].starts_with("node 5 is a CANopen device"));
    }

    #[test]
    fn conflicts_are_named() {
        let mut bus = bus(&[2, 3, 3, 5]);
        bus.robots[0]
            .store
            .insert(address::WIRE_VERSION, vec![9, 0]);
        let serial = bus.robots[0].store[&address::SERIAL_NUMBER].clone();
        bus.robots[3].store.insert(address::SERIAL_NUMBER, serial);
        let survey = Survey::take(&mut Wire::visiting(&mut bus), Some(&file())).unwrap();
        assert_eq!(survey.missing, [4]);
        let text = survey.conflicts.join("\n");
        for part in [
            "node 2 has wire version 9",
            "2 robots answer as node 3, serial numbers",
            "node 5 is not in the group file",
            "nodes 2 and 5 have the same serial number",
        ] {
            assert!(text.contains(part), "{part} in {text}");
        }
        assert_eq!(survey.conflicts.len(), 4);
    }
}
