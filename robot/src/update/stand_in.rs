//! Answers for a robot while its program cannot run.
//!
//! A sector of the flash takes a second or two to erase, and the program in that flash stops
//! meanwhile. A few instructions in RAM go on. They know nothing of CANopen and send what the bus
//! side has prepared here: the answer to a client that reads 0x1F57 to learn whether the erase is
//! finished, and the heartbeat. All other frames to this robot wait.

use canopen::{Frame, NodeId};
use protocol::{address as at, cob};

/// Prepared frames; see the [module](self).
#[derive(Clone, Copy, Debug)]
pub struct StandIn {
    /// The robot.
    pub node: NodeId,
    /// The question: a frame with the same identifier and the same first four bytes.
    pub question: Frame,
    /// The answer to it, now and for as long as the erase lasts.
    pub answer: Frame,
    /// The heartbeat.
    pub heartbeat: Frame,
    /// Its period; 0 for none.
    pub heartbeat_ms: u16,
}

impl StandIn {
    /// For a robot with this status of its flash (0x1F57), NMT state and period of its heartbeat.
    pub(crate) fn new(node: NodeId, status: [u8; 4], state: u8, heartbeat_ms: u16) -> Self {
        // CiA 301, 7.2.4.3: upload of an object, and four bytes of it in the answer.
        const ASK: u8 = 0x40;
        const UPLOADED: u8 = 0x43;
        let [low, high] = at::FLASH_STATUS.index.to_le_bytes();
        let sub = at::FLASH_STATUS.sub;
        let [a, b, c, d] = status;
        let number = node.get();
        Self {
            node,
            question: Frame::of(cob::sdo_request(number), [ASK, low, high, sub, 0, 0, 0, 0]),
            answer: Frame::of(
                cob::sdo_response(number),
                [UPLOADED, low, high, sub, a, b, c, d],
            ),
            heartbeat: Frame::of(cob::heartbeat(number), [state]),
            heartbeat_ms,
        }
    }
}
