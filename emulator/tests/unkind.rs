//! The release image on a board to which the world is unkind: a debug probe that was unplugged,
//! clocks that do not start or stop, a supply that sags, wires that pick up noise.
//!
//! Needs the image, as `image.rs` does.

mod common;

use common::{board, board_with, firmware, frames, nmt, register, run};
use emulator::system::flash::{OPTIONS_ERASED, OPTIONS_FROM_FACTORY, OPTIONS_ON_A_ROBOT};
use emulator::{BoardConfig, CanFrame, Firmware, FlashOperations, PinLevel, Port, ResetCause};

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

/// Driver enable and brake release on port B, the LED on port A.
const GATES: [u8; 2] = [0, 1];
const LED: u8 = 5;

/// Heartbeat of node 2; with a zero in it, its boot-up.
const BOOT_UP: (u16, &[u8]) = (0x702, &[0]);
/// Emergency of node 2.
const EMERGENCY: u16 = 0x82;

/// Error codes of the emergencies among these frames.
fn emergencies(frames: &[(u64, CanFrame)]) -> Vec<u16> {
    frames
        .iter()
        .filter(|(_, frame)| frame.standard_id() == Some(EMERGENCY))
        .map(|(_, frame)| u16::from_le_bytes([frame.data()[0], frame.data()[1]]))
        .collect()
}

/// When the boot-up came, ns.
fn booted(frames: &[(u64, CanFrame)]) -> Option<u64> {
    let is_boot_up =
        |frame: &CanFrame| frame.standard_id() == Some(BOOT_UP.0) && frame.data() == BOOT_UP.1;
    frames
        .iter()
        .find(|(_, frame)| is_boot_up(frame))
        .map(|(at, _)| *at)
}

#[test]
fn without_its_clock_the_robot_stays_safe_says_so_and_comes_up_when_there_is_one() {
    let mut board = board(&firmware());
    board.set_hse(false);
    let mut light = Vec::new();
    for ms in 1..1_800 {
        assert!(
            frames(&mut board, ms * MS).is_empty(),
            "no frame without a clock"
        );
        // The pins are inputs as after reset for the first instants only.
        for pin in GATES {
            assert_eq!(
                board.output(Port::B, pin),
                PinLevel::Low,
                "PB{pin} at {ms} ms"
            );
        }
        for pin in 8..12 {
            assert_eq!(
                board.output(Port::A, pin),
                PinLevel::Low,
                "PA{pin} at {ms} ms"
            );
        }
        light.push(board.output(Port::A, LED) == PinLevel::High);
    }
    assert_eq!(board.resets(), 0);
    // Four flashes, then nothing for a second.
    let begins: Vec<usize> = (1..light.len())
        .filter(|at| light[*at] && !light[*at - 1])
        .collect();
    println!("the LED lights at {begins:?} ms");
    // And then a second without.
    assert_eq!(begins.len(), 4);
    let between: Vec<usize> = begins.windows(2).map(|two| two[1] - two[0]).collect();
    for (between, expected) in between.iter().zip([400, 400, 400]) {
        // The internal oscillator's loop is a little longer than what it counts.
        assert!(between.abs_diff(expected) <= expected / 20, "{between} ms");
    }

    board.set_hse(true);
    let at = board.now_ns();
    let received = frames(&mut board, at + 100 * MS);
    let took = booted(&received).expect("it boots") - at;
    println!("on the bus {} ms after the clock", took / MS);
    assert!(emergencies(&received).is_empty());
}

#[test]
fn a_clock_that_comes_late_is_waited_for() {
    let mut board = board(&firmware());
    board.set_hse(false);
    run(&mut board, 150 * MS);
    board.set_hse(true);
    let received = frames(&mut board, 300 * MS);
    assert!(booted(&received).is_some());
    assert_eq!(board.resets(), 0);
}

#[test]
fn a_clock_that_stops_cuts_the_outputs_at_once_and_is_announced() {
    const MOE: u32 = 1 << 15;
    let mut board = board(&firmware());
    run(&mut board, 100 * MS);
    for at in BDTR {
        board.write_register(at, MOE | register(&board, at));
    }
    board.set_hse(false);
    for at in BDTR {
        assert_eq!(register(&board, at) & MOE, 0, "cut without the program");
    }
    let stopped = board.now_ns();
    while board.resets() == 0 {
        let now = board.now_ns();
        run(&mut board, now + MS);
        assert!(board.now_ns() < stopped + 100 * MS, "no reset");
    }
    println!(
        "reset {} ms after the clock stopped",
        (board.now_ns() - stopped) / MS
    );
    board.set_hse(true);
    let from = board.now_ns();
    let received = frames(&mut board, from + 200 * MS);
    let up = booted(&received).expect("it boots") - from;
    println!("on the bus {} ms later", up / MS);
    assert_eq!(emergencies(&received), [0xFF1E]);
}

/// What fails on the way to the reset, here the program after the supply, does not replace the
/// record of what failed first.
#[test]
fn the_first_failure_is_the_one_that_is_announced() {
    const NOWHERE: u32 = 0xC000_0000;
    let mut board = board(&firmware());
    run(&mut board, 100 * MS);
    board.set_vdd(2.95);
    let failed = board.now_ns();
    run(&mut board, failed + MS);
    board.set_vdd(3.3);
    board.jump(NOWHERE);
    while board.resets() == 0 {
        let now = board.now_ns();
        run(&mut board, now + MS);
        assert!(now < failed + 100 * MS, "no reset");
    }
    let from = board.now_ns();
    let received = frames(&mut board, from + 200 * MS);
    assert!(booted(&received).is_some());
    assert_eq!(emergencies(&received), [0xFF1F]);
}

#[test]
fn a_supply_that_sinks_resets_is_announced_and_never_leaves_the_specification() {
    // A chip from the factory has no brown-out reset before its first start.
    let config = BoardConfig {
        option_bytes: OPTIONS_FROM_FACTORY,
        ..BoardConfig::default()
    };
    let mut board = board_with(&firmware(), config);
    run(&mut board, 400 * MS);
    // 3.3 V to 2.0 V and back, 10 mV a millisecond. The run would end where the chip is not made
    // for its clock.
    let mut received = Vec::new();
    for step in 0..400_u32 {
        let volts = if step < 130 {
            3.3 - 0.01 * f64::from(step)
        } else {
            (2.0 + 0.01 * f64::from(step - 130)).min(3.3)
        };
        board.set_vdd(volts);
        let now = board.now_ns();
        received.extend(frames(&mut board, now + MS));
    }
    assert_eq!(board.reset_cause(), ResetCause::BrownOut);
    let now = board.now_ns();
    received.extend(frames(&mut board, now + 300 * MS));
    assert!(booted(&received).is_some());
    assert_eq!(emergencies(&received), [0xFF1F]);
}

#[test]
fn a_chip_from_the_factory_gets_its_brown_out_reset_once() {
    let config = BoardConfig {
        option_bytes: OPTIONS_FROM_FACTORY,
        ..BoardConfig::default()
    };
    let mut board = board_with(&firmware(), config);
    let received = frames(&mut board, 1_000 * MS);
    assert!(booted(&received).is_some());
    assert_eq!(board.resets(), 0);
    assert_eq!(board.option_bytes(), OPTIONS_ON_A_ROBOT);
    let once = FlashOperations {
        options: 1,
        ..FlashOperations::default()
    };
    assert_eq!(board.flash_operations(), once);
}

/// Power that fails while the option bytes are written leaves a read-protected chip without a
/// brown-out reset. The robot still starts and programs the reset, but never the protection:
/// changing that would erase the program.
#[test]
fn power_that_fails_while_the_brown_out_reset_is_programmed_leaves_a_robot() {
    const PROTECTION: u32 = 0xFF00;
    const BROWN_OUT: u32 = 0xC;
    let config = BoardConfig {
        option_bytes: OPTIONS_FROM_FACTORY,
        ..BoardConfig::default()
    };
    let mut board = board_with(&firmware(), config);
    board.cut_power_at_flash_operation(1);
    assert!(board.run_until(1_000 * MS).is_err(), "the power fails");
    assert_eq!(board.option_bytes(), OPTIONS_ERASED);

    let config = BoardConfig {
        option_bytes: board.option_bytes(),
        ..BoardConfig::default()
    };
    let program = board.flash();
    let mut board = board_with(&firmware(), config);
    let received = frames(&mut board, 1_000 * MS);
    assert!(booted(&received).is_some());
    assert_eq!(board.resets(), 0);
    assert_eq!(board.option_bytes() & BROWN_OUT, 0);
    assert_eq!(board.option_bytes() & PROTECTION, PROTECTION);
    assert_eq!(board.flash()[..0x4000], program[..0x4000]);
}

/// Pins of the encoders' channels A and B, and their counters.
const ENCODERS: [([(Port, u8); 2], u32); 4] = [
    ([(Port::A, 15), (Port::B, 3)], 0x4000_0024),
    ([(Port::C, 6), (Port::C, 7)], 0x4000_0424),
    ([(Port::B, 6), (Port::B, 7)], 0x4000_0824),
    ([(Port::A, 0), (Port::A, 1)], 0x4000_0C24),
];

/// A glitch on A while B changes: without a filter it turns one count back into three counts on.
#[test]
fn glitches_on_an_encoder_channel_do_not_count() {
    let mut board = board(&firmware());
    for (channels, _) in ENCODERS {
        for (port, pin) in channels {
            board.set_input(port, pin, false);
        }
    }
    run(&mut board, 60 * MS);
    let mut at = 60 * MS;
    for ([a, b], counter) in ENCODERS {
        for width_ns in [20, 40, 60] {
            let before = register(&board, counter) as u16;
            for (rises, expected) in [(true, -1), (false, 0)] {
                board.set_input(a.0, a.1, true);
                run(&mut board, at + width_ns / 2);
                board.set_input(b.0, b.1, rises);
                run(&mut board, at + width_ns);
                board.set_input(a.0, a.1, false);
                at += 1_000;
                run(&mut board, at);
                let counts = (register(&board, counter) as u16).wrapping_sub(before) as i16;
                assert_eq!(counts, expected, "{width_ns} ns at {counter:#010x}");
            }
        }
    }
}

/// The image that is built with the feature `bench`.
fn bench_image() -> Firmware {
    let path = std::env::var("OMNIBUS_ELF_BENCH").expect("OMNIBUS_ELF_BENCH names a bench image");
    Firmware::load(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
}

#[test]
fn a_bench_image_stands_at_a_breakpoint_and_a_release_image_is_reset() {
    for (image, resets) in [(bench_image(), 0), (firmware(), 1)] {
        let mut board = board(&image);
        run(&mut board, 100 * MS);
        board.debug_stop();
        board.run_until(600 * MS).unwrap();
        assert_eq!(board.resets(), resets);
        if resets == 0 {
            let timer = board.pwm(1, 1);
            assert!(!timer.active);
            board.debug_resume(false);
            let received = frames(&mut board, 1_000 * MS);
            assert_eq!(board.resets(), 0);
            assert!(!received.is_empty(), "it goes on");
        }
    }
}

#[test]
fn a_bench_image_does_not_arm_and_says_so() {
    const MOE: u32 = 1 << 15;
    let mut board = board(&bench_image());
    run(&mut board, 100 * MS);
    assert!(
        board
            .take_log()
            .iter()
            .any(|line| line.text.contains("bench"))
    );
    nmt(&mut board, START);
    run(&mut board, 200 * MS);
    for at in BDTR {
        assert_eq!(register(&board, at) & MOE, 0);
    }
    // Upload of 0x2001:2, the firmware's version: the highest bit says that it is a bench image.
    let request = CanFrame::new(0x602, &[0x40, 0x01, 0x20, 2, 0, 0, 0, 0]);
    board.can().receive(&request.expect("a frame"));
    let received = frames(&mut board, 250 * MS);
    let answer = received
        .iter()
        .find(|(_, frame)| frame.standard_id() == Some(0x582))
        .expect("an answer");
    assert_eq!(answer.1.data()[7] >> 7, 1);
}
