//! Giving a node-ID to a board that has no switches for it, as is done on a real one: by LSS (CiA
//! 305), on a bus of its own, which stores it in the board's flash.

use canopen::client::{lss_set_node, lss_store, lss_switch_all, parse_lss};
use canopen::{Frame, NodeId};
use emulator::{Board, CanFrame};

/// How long the board may take to start, and to answer, ns.
const START_NS: u64 = 1_000_000_000;
const ANSWER_NS: u64 = 1_000_000_000;
/// Steps in which its mailboxes are emptied, ns.
const STEP_NS: u64 = 200_000;

/// The content of the flash of a board, wired and just switched on, after it was given a node-ID.
pub(super) fn commissioned(mut board: Board, node: NodeId) -> Result<Vec<u8>, String> {
    let requests = [lss_switch_all(true), lss_set_node(Some(node)), lss_store()];
    run(&mut board, START_NS, |_| false)?;
    for (number, request) in requests.into_iter().enumerate() {
        if let Some(frame) = CanFrame::new(request.id(), request.data()) {
            board.can().receive(&frame);
        }
        // The switch is not answered.
        let answered = run(&mut board, ANSWER_NS, |frame| parse_lss(frame).is_some())?;
        if number > 0 && !answered {
            return Err(format!("the board did not answer LSS request {number}"));
        }
    }
    Ok(board.flash())
}

/// Runs a board for so long, or until it sends such a frame; whether it did.
fn run(board: &mut Board, ns: u64, is_wanted: impl Fn(&Frame) -> bool) -> Result<bool, String> {
    let end_ns = board.now_ns() + ns;
    while board.now_ns() < end_ns {
        let next_ns = board.now_ns() + STEP_NS;
        board.run_until(next_ns).map_err(|stop| stop.to_string())?;
        let sent = board.can().begin();
        if sent.is_some() {
            board.can().transmitted();
        }
        let sent = sent.and_then(|frame| Frame::new(frame.standard_id()?, frame.data()));
        if sent.is_some_and(|frame| is_wanted(&frame)) {
            return Ok(true);
        }
    }
    Ok(false)
}
