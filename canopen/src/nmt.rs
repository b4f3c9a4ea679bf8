//! Network management: the four states of a device and the five commands that change them.
//!
//! CiA 301, 7.3.2. The numbers are those on the wire: of the states in the heartbeat, of the
//! commands in the frame with identifier 0.

use crate::{Frame, NodeId};

/// The NMT state of a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum NmtState {
    /// Not on the bus yet: before the boot-up frame, or without a node-ID.
    #[default]
    Initialising,
    /// SDO, SYNC, EMCY and heartbeat; no PDO.
    PreOperational,
    /// Everything.
    Operational,
    /// NMT and heartbeat only.
    Stopped,
}

impl NmtState {
    /// The byte of the heartbeat: 0, 127, 5 or 4.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Initialising => 0,
            Self::Stopped => 4,
            Self::Operational => 5,
            Self::PreOperational => 127,
        }
    }

    /// The state a heartbeat byte stands for. Bit 7, the toggle bit of node guarding, must be 0.
    #[must_use]
    pub const fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Initialising),
            4 => Some(Self::Stopped),
            5 => Some(Self::Operational),
            127 => Some(Self::PreOperational),
            _ => None,
        }
    }
}

/// A command of the NMT master.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum NmtCommand {
    /// To OPERATIONAL.
    Start,
    /// To STOPPED.
    Stop,
    /// To PRE-OPERATIONAL.
    EnterPreOperational,
    /// Restarts the application and the communication.
    ResetNode,
    /// Restarts the communication alone.
    ResetCommunication,
}

impl NmtCommand {
    /// The command specifier: 1, 2, 128, 129 or 130.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Start => 1,
            Self::Stop => 2,
            Self::EnterPreOperational => 128,
            Self::ResetNode => 129,
            Self::ResetCommunication => 130,
        }
    }

    /// The command of a specifier.
    #[must_use]
    pub const fn from_code(code: u8) -> Option<Self> {
        match code {
            1 => Some(Self::Start),
            2 => Some(Self::Stop),
            128 => Some(Self::EnterPreOperational),
            129 => Some(Self::ResetNode),
            130 => Some(Self::ResetCommunication),
            _ => None,
        }
    }
}

/// The addressee of an NMT command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum NmtTarget {
    /// Every node but the sender.
    All,
    /// One node.
    Node(NodeId),
}

impl NmtTarget {
    /// The node byte of an NMT frame: 0 for all.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::All => 0,
            Self::Node(node) => node.get(),
        }
    }

    /// Whether `node` is meant.
    #[must_use]
    pub fn includes(self, node: NodeId) -> bool {
        match self {
            Self::All => true,
            Self::Node(one) => one == node,
        }
    }
}

/// Reads an NMT frame; `None` if it is something else or malformed.
pub(crate) fn parse(frame: &Frame) -> Option<(NmtCommand, NmtTarget)> {
    match (frame.id(), frame.data()) {
        (0, &[command, node]) => {
            let target = match node {
                0 => NmtTarget::All,
                _ => NmtTarget::Node(NodeId::new(node)?),
            };
            Some((NmtCommand::from_code(command)?, target))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_those_of_cia_301() {
        use NmtCommand::*;
        for (command, code) in [
            (Start, 1),
            (Stop, 2),
            (EnterPreOperational, 128),
            (ResetNode, 129),
            (ResetCommunication, 130),
        ] {
            assert_eq!(command.code(), code);
            assert_eq!(NmtCommand::from_code(code), Some(command));
        }
        for (state, code) in [
            (NmtState::Initialising, 0),
            (NmtState::Stopped, 4),
            (NmtState::Operational, 5),
            (NmtState::PreOperational, 127),
        ] {
            assert_eq!(state.code(), code);
            assert_eq!(NmtState::from_code(code), Some(state));
        }
    }

    #[test]
    fn only_two_bytes_are_a_command() {
        let all = Some((NmtCommand::Start, NmtTarget::All));
        assert_eq!(parse(&Frame::of(0, [1, 0])), all);
        assert_eq!(parse(&Frame::of(0, [1])), None);
        assert_eq!(parse(&Frame::of(0, [1, 0, 0])), None);
        assert_eq!(parse(&Frame::of(0, [3, 0])), None);
        assert_eq!(parse(&Frame::of(0, [1, 128])), None);
        assert_eq!(parse(&Frame::of(1, [1, 0])), None);
    }
}
