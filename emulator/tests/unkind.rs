//! The release image on a board to which the world is unkind: a debug probe that was unplugged, clocks that do not
//! start or stop, a supply that sags, wires that pick up noise.
//!
//! Needs the image, as `image.rs` does.

mod common;

use common::{board, firmware, nmt, register, run};
use emulator::Port;

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

/// TIM1_BDTR and TIM8_BDTR (RM0390 17.4.18).
const BDTR: [u32; 2] = [0x4001_0044, 0x4001_0444];

#[test]
fn a_program_gone_astray_cannot_take_the_break_inputs_away() {
    const BKE: u32 = 1 << 12;
    const BKP: u32 = 1 << 13;
    const MOE: u32 = 1 << 15;
    let mut board = board(&firmware());
    run(&mut board, 30 * MS);
    for at in BDTR {
        for value in [0, BKE, 0xFFFF & !BKP, 0xFFFF & !BKE] {
            board.write_register(at, value);
            let word = register(&board, at);
            assert_eq!(word & (BKE | BKP), BKE | BKP, "{at:#010x} after {value:#x}");
        }
        board.write_register(at, MOE);
        assert_ne!(register(&board, at) & MOE, 0, "outputs can be switched on");
    }
    // And a stop switches them off.
    board.set_input(Port::B, 12, true);
    board.set_input(Port::A, 6, true);
    for at in BDTR {
        assert_eq!(register(&board, at) & MOE, 0);
    }
}
