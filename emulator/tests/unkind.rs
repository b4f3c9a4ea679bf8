//! The release image on a board to which the world is unkind: a debug probe that was unplugged, clocks that do not
//! start or stop, a supply that sags, wires that pick up noise.
//!
//! Needs the image, as `image.rs` does.

mod common;

use common::{board, firmware, nmt, run};

const START: u8 = 1;
const STOP: u8 = 2;
const PRE_OPERATIONAL: u8 = 128;
const MS: u64 = 1_000_000;

#[test]
fn a_log_that_nobody_reads_stops_nothing() {
    let mut board = board(&firmware());
    run(&mut board, 30 * MS);
    board.unplug_debugger().expect("the image has a log");
    for change in 1..=400_u64 {
        let command = [STOP, PRE_OPERATIONAL, START][(change % 3) as usize];
        nmt(&mut board, command);
        run(&mut board, (30 + 20 * change) * MS);
        assert_eq!(board.resets(), 0, "after {change} changes of the NMT state");
    }
}
