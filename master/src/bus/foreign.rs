//! Other masters on the bus: how they are detected, and a check before the bus is taken.
//!
//! A bus has one master. It shows itself by SYNC and its heartbeat as long as it is connected, and
//! by group twists and NMT commands while it drives. [`look`] listens for longer than any of their
//! periods; a command that would take the robots away asks it first.

use canopen::{Frame, Micros};
use protocol::cob;

use super::link::{Link, LinkError};

/// How long to listen: the master's heartbeat comes every 100 ms, SYNC every 10 to 50 ms.
const LISTEN_US: u64 = 350_000;

/// A frame that only a master sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sign {
    /// The heartbeat of node 1.
    Heartbeat,
    /// SYNC.
    Sync,
    /// A setpoint for a group.
    GroupTwist,
    /// An NMT command.
    Nmt,
}

impl Sign {
    /// What a frame gives away.
    #[must_use]
    pub fn of(frame: &Frame) -> Option<Self> {
        match frame.id() {
            cob::MASTER_HEARTBEAT => Some(Self::Heartbeat),
            cob::SYNC => Some(Self::Sync),
            cob::GROUP_TWIST => Some(Self::GroupTwist),
            cob::NMT => Some(Self::Nmt),
            _ => None,
        }
    }
}

impl std::fmt::Display for Sign {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Heartbeat => "the heartbeat of node 1",
            Self::Sync => "SYNC",
            Self::GroupTwist => "setpoints for a group",
            Self::Nmt => "NMT commands",
        })
    }
}

/// Listens for a third of a second and returns the first sign of another master.
///
/// # Errors
/// When the link fails.
pub fn look(link: &mut impl Link) -> Result<Option<Sign>, LinkError> {
    let until = Micros(link.now().0 + LISTEN_US);
    while let Some((_, frame)) = link.receive(until)? {
        if let Some(sign) = Sign::of(&frame) {
            return Ok(Some(sign));
        }
    }
    Ok(None)
}
