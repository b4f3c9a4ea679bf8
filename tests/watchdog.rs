//! How long a robot whose program has stopped goes on: the release image on an emulated board, over
//! the whole range of the watchdog's oscillator.
//!
//! `OMNIBUS_ELF` names the image (`cargo xtask test` builds it and says so).

mod common;

use emulator::{Board, BoardConfig, Firmware, Port, ResetCause};

/// What docs/safety.md promises from a halted core or a panic to the reset.
const PROMISE_NS: u64 = 100_000_000;
/// The data sheet's range (DS10693 rev 10, table 42) and the nominal frequency.
const LSI_HZ: [u64; 4] = [17_000, 24_000, 32_000, 47_000];
const MS: u64 = 1_000_000;

fn firmware() -> Firmware {
    common::image("OMNIBUS_ELF")
}

/// A robot as it is `ms` after power-on, on the bus and well.
fn robot(firmware: &Firmware, lsi_hz: u64, ms: u64) -> Board {
    let config = BoardConfig {
        lsi_hz,
        ..BoardConfig::default()
    };
    let mut board = Board::new(firmware, config);
    for (port, pin, level) in [
        (Port::B, 12, false),
        (Port::A, 6, false),
        (Port::B, 13, true),
    ] {
        board.set_input(port, pin, level);
    }
    run(&mut board, ms * MS);
    assert_eq!(board.resets(), 0, "LSI at {lsi_hz} Hz");
    board
}

fn run(board: &mut Board, end_ns: u64) {
    while board.now_ns() < end_ns {
        board.run_until_request(end_ns).unwrap();
        while board.can().begin().is_some() {
            board.can().transmitted();
        }
    }
}

/// Time to the next reset, which must be the watchdog's.
fn to_reset(board: &mut Board) -> u64 {
    let (from, before) = (board.now_ns(), board.resets());
    while board.resets() == before && board.now_ns() < from + 2_000 * MS {
        let next = board.now_ns() + MS / 10;
        run(board, next);
    }
    assert_eq!(board.resets(), before + 1, "no reset within 2 s");
    assert_eq!(board.reset_cause(), ResetCause::Watchdog);
    board.now_ns() - from
}

#[test]
fn a_halted_core_is_reset_within_the_promise_on_any_oscillator() {
    let firmware = firmware();
    for lsi_hz in LSI_HZ {
        // At moments that differ in their distance from the last feeding, the first of them during
        // start-up. In the first five milliseconds the stack is painted and the clocks start; it is
        // not running yet, and nothing is switched on.
        for ms in [6, 7, 8, 60, 63, 66, 400] {
            let mut board = robot(&firmware, lsi_hz, ms);
            board.halt(true);
            let ns = to_reset(&mut board);
            println!("LSI {lsi_hz} Hz, halted at {ms} ms: {} us", ns / 1000);
            assert!(
                ns <= PROMISE_NS,
                "LSI {lsi_hz} Hz, halted at {ms} ms: {ns} ns"
            );
            // It is fed every 10 ms, and a reset any earlier would come to a robot that is well.
            assert!(ns >= 20 * MS, "LSI {lsi_hz} Hz, halted at {ms} ms: {ns} ns");
        }
    }
}

#[test]
fn a_panic_ends_in_a_reset_within_the_promise_on_any_oscillator() {
    let firmware = firmware();
    let mut functions = firmware.functions().iter();
    let panic = functions.find(|function| function.name == "_defmt_panic");
    let panic = panic.expect("the handler is in the image").address;
    for lsi_hz in LSI_HZ {
        let mut board = robot(&firmware, lsi_hz, 60);
        board.jump(panic);
        let ns = to_reset(&mut board);
        println!("LSI {lsi_hz} Hz, panic: {} us", ns / 1000);
        assert!(ns <= PROMISE_NS, "LSI {lsi_hz} Hz, panic: {ns} ns");
    }
}
