//! The release image of the firmware on the emulated board, as far as it can be judged without
//! knowing what the firmware is for. Needs the image: `cargo xtask test` builds it, switches these
//! tests on and names it in `OMNIBUS_ELF`.

use std::path::PathBuf;

use emulator::{Board, BoardConfig, CanFrame, Firmware, Port, Traced};

fn firmware() -> Firmware {
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

fn board(firmware: &Firmware, crystal_ppm: f64) -> Board {
    let config = BoardConfig {
        crystal_ppm,
        ..BoardConfig::default()
    };
    let mut board = Board::new(firmware, config);
    // The contact of the emergency stop is closed.
    board.set_input(Port::B, 12, false);
    board
}

/// Runs for a time, taking every frame off the bus as soon as it is requested.
fn run(board: &mut Board, end_ns: u64) {
    while board.now_ns() < end_ns {
        board.run_until_request(end_ns).unwrap();
        while board.can().begin().is_some() {
            board.can().transmitted();
        }
    }
}

#[test]
fn boots_and_speaks() {
    let mut board = board(&firmware(), 0.0);
    run(&mut board, 100_000_000);
    assert_eq!(board.resets(), 0);
    assert_eq!(board.hclk_hz(), 180_000_000);
    let log = board.take_log();
    let first = log.first().expect("the firmware logs its start");
    let location = first.location.as_deref().unwrap();
    assert!(location.contains("src/"), "{location}");
}

#[test]
fn can_runs_at_one_megabit() {
    let mut board = board(&firmware(), 0.0);
    run(&mut board, 20_000_000);
    let can = board.can();
    assert_eq!(can.bit_rate(), Some(1_000_000));
    // CiA 301 wants 87.5 %; of 15 quanta 13 are the nearest.
    assert_eq!(can.sample_point(), 13.0 / 15.0);
}

/// How far off each clock on the bus may be, by the Bosch specification, CAN 2.0 part A, section 9,
/// from CAN_BTR (RM0390 30.9.2).
#[test]
fn can_stands_clocks_half_a_per_cent_off() {
    let mut board = board(&firmware(), 0.0);
    run(&mut board, 20_000_000);
    const BTR: u32 = 0x4000_641C;
    let bytes = [0, 1, 2, 3].map(|byte| board.debug_read(BTR + byte).expect("CAN is modelled"));
    let field = |shift: u32, mask: u32| f64::from(u32::from_le_bytes(bytes) >> shift & mask) + 1.0;
    let (one, two, jump) = (field(16, 15), field(20, 7), field(24, 3));
    let quanta = 1.0 + one + two;
    let normal = jump / (20.0 * quanta);
    let after_an_error = one.min(two) / (2.0 * (13.0 * quanta - two));
    assert!(
        normal.min(after_an_error) > 0.005,
        "{normal} {after_an_error}"
    );
}

#[test]
fn another_oscillator_shows_as_another_bit_rate() {
    // The firmware believes in 8 MHz. With 7.9 MHz everything is slower, and so is the bus.
    let config = BoardConfig {
        hse_hz: 7_900_000,
        ..BoardConfig::default()
    };
    let mut board = Board::new(&firmware(), config);
    board.set_input(Port::B, 12, false);
    run(&mut board, 20_000_000);
    assert_eq!(board.can().bit_rate(), Some(987_500));
}

#[test]
fn pwm_is_ready_at_20_khz_and_cut() {
    let mut board = board(&firmware(), 0.0);
    run(&mut board, 20_000_000);
    for channel in 1..=4 {
        let state = board.pwm(1, channel);
        assert_eq!(state.period_ns, 50_000);
        assert!(!state.active);
    }
}

#[test]
fn the_processor_mostly_sleeps() {
    let mut board = board(&firmware(), 0.0);
    run(&mut board, 100_000_000);
    let before = board.cycles();
    run(&mut board, 600_000_000);
    let after = board.cycles();
    let load = 1.0 - (after.1 - before.1) as f64 / (after.0 - before.0) as f64;
    assert!(load < 0.05, "load {load}");
}

#[test]
fn two_runs_are_the_same_to_the_nanosecond() {
    let firmware = firmware();
    let record = || -> (Vec<Traced>, u64, Vec<String>) {
        let mut board = board(&firmware, 17.0);
        board.start_trace();
        run(&mut board, 300_000_000);
        let log = board.take_log().iter().map(ToString::to_string).collect();
        (board.take_trace(), board.instructions(), log)
    };
    let first = record();
    assert!(first.0.len() > 3, "frames at least");
    let second = std::thread::scope(|scope| scope.spawn(record).join().unwrap());
    assert_eq!(first, second);
}

#[test]
fn a_fast_crystal_makes_heartbeats_early() {
    let firmware = firmware();
    let last_frame = |ppm| {
        let mut board = board(&firmware, ppm);
        let mut last = 0;
        while board.now_ns() < 1_000_000_000 {
            board.run_until_request(1_000_000_000).unwrap();
            last = board.can().pending_since_ns().unwrap_or(last);
            while board.can().begin().is_some() {
                board.can().transmitted();
            }
        }
        last
    };
    let (slow, fast) = (last_frame(-50.0), last_frame(50.0));
    // 100 ppm of most of a second; what else moves a frame is below some microseconds.
    let early = slow - fast;
    assert!(
        early.abs_diff(slow / 10_000) < 10_000,
        "{early} ns of {slow} ns"
    );
}

#[test]
fn addresses_have_names() {
    let firmware = firmware();
    let reset = firmware
        .functions()
        .iter()
        .find(|symbol| symbol.name == "Reset");
    let reset = reset.expect("cortex-m-rt's entry");
    assert_eq!(firmware.function_at(reset.address + 2), Some(reset));
    let main = firmware
        .functions()
        .iter()
        .find(|symbol| symbol.name.contains("main"));
    let location = firmware.location(main.expect("a main").address).unwrap();
    assert!(location.contains(".rs:"), "{location}");
}

#[test]
fn profiling_changes_nothing_and_adds_up() {
    let firmware = firmware();
    let mut plain = board(&firmware, 0.0);
    let mut profiled = board(&firmware, 0.0);
    profiled.start_profile();
    run(&mut plain, 50_000_000);
    run(&mut profiled, 50_000_000);
    let profile = profiled.take_profile().unwrap();
    let total = profile.total(0..u32::MAX);
    assert_eq!(total.instructions, profiled.instructions());
    let spent = total.cycles + profile.exceptions().cycles;
    let (cycles, slept) = profiled.cycles();
    assert!(
        (cycles - slept).abs_diff(spent) < 1_000,
        "{} and {spent}",
        cycles - slept
    );
    assert_eq!(plain.instructions(), profiled.instructions());
    assert_eq!(plain.take_log(), profiled.take_log());
}

#[test]
fn the_fast_path_is_the_reference_core_to_the_cycle() {
    let firmware = firmware();
    let record = |reference_core| {
        let config = BoardConfig {
            reference_core,
            // What the reference core reads from flash it does not tell, so nobody waits for it
            // here.
            ideal_flash: true,
            ..BoardConfig::default()
        };
        let mut board = Board::new(&firmware, config);
        board.set_input(Port::B, 12, false);
        board.start_trace();
        // Frames come in too: a SYNC with a counter every 10 ms, and what it may set off.
        for turn in 1..=50_u8 {
            run(&mut board, u64::from(turn) * 10_000_000);
            board.encoder_add(2, i32::from(turn));
            let sync = CanFrame::new(0x80, &[turn]).unwrap();
            board.can().receive(&sync);
        }
        let mut ram = vec![0; 128 * 1024];
        board.read_memory(0x2000_0000, &mut ram).unwrap();
        let log: Vec<_> = board.take_log().iter().map(ToString::to_string).collect();
        let counts = (board.cycles(), board.instructions());
        (board.take_trace(), log, counts, ram)
    };
    let (fast, reference) = (record(false), record(true));
    assert_eq!(fast.0, reference.0);
    assert_eq!(fast.1, reference.1);
    assert_eq!(fast.2, reference.2);
    let different = fast.3.iter().zip(&reference.3).position(|(a, b)| a != b);
    assert_eq!(different, None, "RAM differs first at this offset");
}
