//! Encoding and decoding of NMT, SYNC and heartbeat frames.

use crate::{Frame, NmtCommand, NmtState, NmtTarget, NodeId};

const NMT: u16 = 0x000;
const SYNC: u16 = 0x080;
const HEARTBEAT: u16 = 0x700;

/// An NMT command.
#[must_use]
pub fn nmt(command: NmtCommand, target: NmtTarget) -> Frame {
    Frame::of(NMT, [command.code(), target.code()])
}

/// Reads an NMT command; `None` if the frame is not one.
#[must_use]
pub fn parse_nmt(frame: &Frame) -> Option<(NmtCommand, NmtTarget)> {
    crate::nmt::parse(frame)
}

/// A SYNC, with or without counter (1 to 240).
#[must_use]
pub fn sync(counter: Option<u8>) -> Frame {
    match counter {
        Some(counter) => Frame::of(SYNC, [counter]),
        None => Frame::of(SYNC, []),
    }
}

/// A heartbeat; with `Initialising` it is the boot-up frame.
#[must_use]
pub fn heartbeat(node: NodeId, state: NmtState) -> Frame {
    Frame::of(node.cob_id(HEARTBEAT), [state.code()])
}

/// Reads a heartbeat; `Initialising` says that the node has just booted. `None` if the frame is
/// not one.
#[must_use]
pub fn parse_heartbeat(frame: &Frame) -> Option<(NodeId, NmtState)> {
    match (frame.id() & 0x780, frame.data()) {
        (HEARTBEAT, &[code]) => Some((NodeId::of_cob_id(frame.id())?, NmtState::from_code(code)?)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn golden_frames() {
        let node = NodeId::new(5).unwrap();
        assert_eq!(nmt(NmtCommand::Start, NmtTarget::All), Frame::of(0, [1, 0]));
        assert_eq!(
            nmt(NmtCommand::ResetNode, NmtTarget::Node(node)),
            Frame::of(0, [0x81, 5])
        );
        assert_eq!(sync(None), Frame::of(0x80, []));
        assert_eq!(sync(Some(240)), Frame::of(0x80, [240]));
        assert_eq!(
            heartbeat(node, NmtState::Initialising),
            Frame::of(0x705, [0])
        );
    }

    #[test]
    fn heartbeats_are_read_back_and_nothing_else_is() {
        let node = NodeId::new(17).unwrap();
        for state in [
            NmtState::Initialising,
            NmtState::PreOperational,
            NmtState::Operational,
            NmtState::Stopped,
        ] {
            assert_eq!(
                parse_heartbeat(&heartbeat(node, state)),
                Some((node, state))
            );
        }
        assert_eq!(parse_heartbeat(&Frame::of(0x700, [5])), None);
        assert_eq!(parse_heartbeat(&Frame::of(0x711, [5, 0])), None);
        assert_eq!(parse_heartbeat(&Frame::of(0x711, [6])), None);
        assert_eq!(parse_heartbeat(&Frame::of(0x691, [5])), None);
    }
}
