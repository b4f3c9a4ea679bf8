//! The temperature of smart drives' motors, asked for beside the setpoints.
//!
//! Object 0x2120:4 is in no PDO. While the group runs, a robot with smart drives is asked for it
//! once in 256 SYNC periods, right after a SYNC, and the session does not wait: the answer comes
//! long before the next setpoint, and one that is lost is asked for again in its turn.

use canopen::Frame;
use protocol::{Address, address};

use super::Group;
use crate::bus::link::Link;
use crate::error::MasterError;
use crate::monitor::telemetry::SessionState;

/// CiA 301, 7.2.4.3.5 and 7.2.4.3.6: first byte of a request to read, and of an answer with one
/// byte in it.
const READ: u8 = 0x40;
const ONE_BYTE: u8 = 0x4F;
/// SDO to a robot and from it, with its node-ID added.
const REQUEST: u16 = 0x600;
const ANSWER: u16 = 0x580;
/// SYNC periods from one robot to the next; a group has sixteen robots at most.
const PERIODS: u8 = 16;

/// The first bytes of either frame.
fn head(command: u8, address: Address) -> [u8; 4] {
    let [low, high] = address.index.to_le_bytes();
    [command, low, high, address.sub]
}

impl<L: Link> Group<L> {
    /// Asks the robot whose turn it is.
    pub(super) fn ask_for_temperature(&mut self) -> Result<(), MasterError> {
        let place = usize::from(self.sequence / PERIODS);
        let its_turn = self.phase == SessionState::Running && self.sequence.is_multiple_of(PERIODS);
        let Some(robot) = self.file.robots.get(place).filter(|_| its_turn) else {
            return Ok(());
        };
        if robot.output.kind.drive_current().is_none() {
            return Ok(());
        }
        let [command, low, high, sub] = head(READ, address::TEMPERATURE);
        let data = [command, low, high, sub, 0, 0, 0, 0];
        let id = REQUEST + u16::from(robot.node);
        self.wire.send(&Frame::of(id, data))
    }

    /// Takes in the answer, whichever program asked.
    pub(super) fn take_temperature(&mut self, id: u16, data: &[u8]) {
        let Some((degrees, _)) = data
            .strip_prefix(&head(ONE_BYTE, address::TEMPERATURE))
            .and_then(<[u8]>::split_first)
        else {
            return;
        };
        let from = |node: u8| id == ANSWER + u16::from(node);
        if let Some(member) = self.members.iter_mut().find(|member| from(member.node)) {
            // 0 is what a robot says that measures none.
            member.temperature = Some(*degrees).filter(|degrees| *degrees > 0);
        }
    }
}
