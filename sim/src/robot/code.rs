//! Places in a robot's machine code from which its program goes wrong.
//!
//! Instructions by the ARMv7-M Architecture Reference Manual (DDI 0403E), chapter A7.7.

use emulator::{Board, Firmware};

/// Where the program calls a panic; the calls have no arguments.
pub fn panic_site(firmware: &Firmware, board: &Board) -> Option<u32> {
    let functions = firmware.functions();
    let panics: Vec<u32> = functions
        .iter()
        .filter(|function| function.name.contains("panicking::panic"))
        .map(|function| function.address)
        .collect();
    let mut halfwords = functions
        .iter()
        .flat_map(|f| (f.address..f.address + f.size).step_by(2));
    halfwords.find(|at| call(board, *at).is_some_and(|to| panics.contains(&to)))
}

/// A loop of one or two instructions that do nothing.
pub fn endless_loop(firmware: &Firmware, board: &Board) -> Option<u32> {
    /// `B .`, T2.
    const HERE: u16 = 0xE7FE;
    /// `NOP`, T1, and `B` to it.
    const NOP: u16 = 0xBF00;
    const BACK: u16 = 0xE7FD;
    let functions = firmware.functions().iter();
    let mut halfwords = functions.flat_map(|f| (f.address..f.address + f.size).step_by(2));
    halfwords.find(|at| match half(board, *at) {
        Some(HERE) => true,
        Some(NOP) => half(board, at + 2) == Some(BACK),
        _ => false,
    })
}

/// The function that is called at an address: `BL`, T1.
fn call(board: &Board, at: u32) -> Option<u32> {
    let (first, second) = (u32::from(half(board, at)?), u32::from(half(board, at + 2)?));
    if first & 0xF800 != 0xF000 || second & 0xD000 != 0xD000 {
        return None;
    }
    let sign = first >> 10 & 1;
    let [one, two] = [second >> 13 & 1, second >> 11 & 1].map(|j| !(j ^ sign) & 1);
    let offset = sign << 24 | one << 23 | two << 22 | (first & 0x3FF) << 12 | (second & 0x7FF) << 1;
    let offset = (offset << 7).cast_signed() >> 7;
    Some((at + 4).wrapping_add_signed(offset))
}

fn half(board: &Board, at: u32) -> Option<u16> {
    let mut bytes = [0; 2];
    board.read_memory(at, &mut bytes)?;
    Some(u16::from_le_bytes(bytes))
}
