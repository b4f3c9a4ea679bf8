//! A board with the release image, wired as on a robot, and what a master says to it.

#![allow(dead_code, reason = "every test uses a part")]

use std::path::PathBuf;

use emulator::{Board, BoardConfig, CanFrame, Firmware, Port};

/// The image that `OMNIBUS_ELF` names, or the one `cargo build` has left.
pub fn firmware() -> Firmware {
    let path = std::env::var_os("OMNIBUS_ELF").map_or_else(
        || {
            let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
            PathBuf::from(root).join("target/thumbv7em-none-eabihf/release/omnibus-firmware")
        },
        PathBuf::from,
    );
    Firmware::load(&path).unwrap_or_else(|error| {
        panic!("{error}; build it with: cargo build --release --target thumbv7em-none-eabihf")
    })
}

/// A board with node 2, emergency stop closed and motor drivers without a fault.
pub fn board(firmware: &Firmware) -> Board {
    board_with(firmware, BoardConfig::default())
}

/// The same with another configuration.
pub fn board_with(firmware: &Firmware, config: BoardConfig) -> Board {
    let mut board = Board::new(firmware, config);
    board.set_input(Port::B, 12, false);
    board.set_input(Port::A, 6, false);
    board.set_input(Port::B, 13, true);
    for pin in 8..12 {
        board.set_input(Port::C, pin, true);
    }
    board.set_analog(Port::A, 4, 24.0 / 11.0);
    board
}

/// Runs until a time, taking every frame off the bus as soon as it is requested.
pub fn run(board: &mut Board, end_ns: u64) {
    for _ in frames(board, end_ns) {}
}

/// The same, and returns the frames with their times in ns.
pub fn frames(board: &mut Board, end_ns: u64) -> Vec<(u64, CanFrame)> {
    let mut frames = Vec::new();
    while board.now_ns() < end_ns {
        board.run_until_request(end_ns).unwrap();
        while let Some(frame) = board.can().begin() {
            frames.push((board.now_ns(), frame));
            board.can().transmitted();
        }
    }
    frames
}

/// Sends an NMT command to all nodes.
pub fn nmt(board: &mut Board, command: u8) {
    let frame = CanFrame::new(0, &[command, 0]).expect("an NMT command is a frame");
    board.can().receive(&frame);
}

/// A word of a peripheral's register; 0 while the peripheral has no clock.
pub fn register(board: &Board, address: u32) -> u32 {
    let byte = |at| board.debug_read(address + at).unwrap_or(0);
    u32::from_le_bytes([0, 1, 2, 3].map(byte))
}
