//! The core: interrupts, sleep, faults, resets, watchdog.

use emulator::{BoardConfig, ResetCause, StopKind};

use super::code::{Code, NVIC_ISER0, RAM, RCC_APB1ENR, RCC_APB2ENR};

fn is_send<T: Send>(_: &T) {}

#[test]
fn boards_can_move_between_threads() {
    let mut code = Code::default();
    code.branch_to_itself();
    let board = code.board(0, BoardConfig::default());
    is_send(&board);
}

/// Sleeps, and counts the update interrupts of TIM2 every 1000 clocks.
fn counting_program() -> (Code, u32) {
    let mut code = Code::default();
    code.store(RCC_APB1ENR, 1);
    code.store(0x4000_002C, 999); // ARR
    code.store(0x4000_000C, 1); // DIER.UIE
    code.store(NVIC_ISER0, 1 << 28);
    code.store(0x4000_0000, 1); // CR1.CEN
    let sleep = code.here();
    code.wait_for_event();
    code.branch(sleep);
    let handler = code.here();
    code.store(0x4000_0010, 0); // SR
    code.count(RAM);
    code.ret();
    (code, handler)
}

#[test]
fn a_sleeping_core_wakes_for_every_interrupt() {
    let (code, handler) = counting_program();
    let mut board = code.board(handler, BoardConfig::default());
    // 10 ms at 16 MHz are 160 000 clocks: 160 periods, the last of them after the 40 or so clocks
    // of set-up.
    board.run_until(10_000_000).unwrap();
    assert_eq!(board.read_word(RAM), Some(159));
    assert!(board.is_asleep());
    let (cycles, slept) = board.cycles();
    assert_eq!(cycles, 160_000);
    // 159 times an interrupt of about 60 cycles.
    assert!(slept > 145_000, "slept {slept} of {cycles} cycles");
    let next = board.next_event_ns().unwrap() - 10_000_000;
    assert!(next < 62_500, "less than one period away, not {next} ns");
}

/// The rest of an IT block must keep its condition when an interrupt comes in the middle of it.
#[test]
fn an_interrupt_in_an_it_block_returns_into_the_block() {
    for reference_core in [false, true] {
        let mut code = Code::default();
        code.load(4, RAM + 16);
        code.store(RCC_APB1ENR, 1);
        code.store(0x4000_002C, 96); // ARR: 97 has no factor in common with the loop
        code.store(0x4000_000C, 1); // DIER.UIE
        code.store(NVIC_ISER0, 1 << 28);
        code.store(0x4000_0000, 1); // CR1.CEN
        code.0.extend([0x2200, 0x2300]); // MOVS r2, #0; MOVS r3, #0
        let again = code.here();
        code.0.push(0x2A00); // CMP r2, #0: equal
        code.0.push(0xBF1F); // ITTTT NE
        code.0.extend([0x3301; 4]); // ADDNE r3, #1
        code.0.push(0x6023); // STR r3, [r4]
        code.branch(again);
        let handler = code.here();
        code.store(0x4000_0010, 0); // SR
        code.count(RAM);
        code.ret();
        let mut board = code.board_on(reference_core, handler);
        board.run_until(10_000_000).unwrap();
        assert!(board.read_word(RAM).unwrap() > 1_500, "interrupts came");
        assert_eq!(board.read_word(RAM + 16), Some(0), "nothing was executed");
    }
}

#[test]
fn the_crystal_error_shows_in_the_world() {
    let (code, handler) = counting_program();
    let counted = |crystal_ppm| {
        let config = BoardConfig {
            crystal_ppm,
            ..BoardConfig::default()
        };
        let mut board = code.board(handler, config);
        board.run_until(1_000_000_000).unwrap();
        board.read_word(RAM).unwrap()
    };
    // 16 000 interrupts a second; 1000 ppm are 16 of them.
    assert_eq!(counted(1000.0) - counted(0.0), 16);
    assert_eq!(counted(0.0) - counted(-1000.0), 16);
}

#[test]
fn how_a_run_is_cut_into_pieces_changes_nothing() {
    let (code, handler) = counting_program();
    let run = |step: u64| {
        let mut board = code.board(handler, BoardConfig::default());
        let mut t = 0;
        while t < 5_000_000 {
            t = (t + step).min(5_000_000);
            board.run_until(t).unwrap();
        }
        (board.read_word(RAM), board.cycles().0)
    };
    assert_eq!(run(5_000_000), run(777));
}

/// Starts the watchdog with 50 ms at 32 kHz and feeds it once what it was given has arrived, which
/// takes up to 294 us at 17 kHz: 1 600 rounds of three or four cycles at 16 MHz.
fn start_watchdog(code: &mut Code) {
    for (offset, value) in [(0, 0x5555), (4, 0), (8, 399), (0, 0xCCCC)] {
        code.store(0x4000_3000 + offset, value);
    }
    code.wait(1_600);
    code.store(0x4000_3000, 0xAAAA);
}

/// Longest time until that feeding, ns.
const WATCHDOG_STARTS_NS: u64 = 450_000;

/// Counts its starts in RAM, starts the watchdog and sleeps.
fn watched_program() -> Code {
    let mut code = Code::default();
    code.count(RAM);
    code.read(0x4002_3874); // RCC_CSR
    code.load(0, RAM + 4);
    code.0.push(0x6001);
    start_watchdog(&mut code);
    let sleep = code.here();
    code.wait_for_event();
    code.branch(sleep);
    code
}

#[test]
fn the_watchdog_resets_a_sleeping_core() {
    let mut board = watched_program().board(0, BoardConfig::default());
    board.run_until(49_900_000).unwrap();
    assert_eq!(board.read_word(RAM), Some(1));
    assert_eq!(
        board.read_word(RAM + 4).unwrap() >> 25,
        0b111,
        "POR, PIN, BOR"
    );
    board.run_until(50_100_000 + WATCHDOG_STARTS_NS).unwrap();
    assert_eq!(board.read_word(RAM), Some(2), "RAM survives");
    assert_eq!(board.reset_cause(), ResetCause::Watchdog);
    assert_ne!(board.read_word(RAM + 4).unwrap() & 1 << 29, 0, "IWDGRSTF");
    board.run_until(1_000_000_000).unwrap();
    assert_eq!(board.resets(), 19);
}

#[test]
fn a_halted_core_counts_nothing_until_it_goes_on() {
    let (code, handler) = counting_program();
    let mut board = code.board(handler, BoardConfig::default());
    board.run_until(5_000_000).unwrap();
    let counted = board.read_word(RAM);
    board.halt(true);
    board.run_until(10_000_000).unwrap();
    assert_eq!(board.read_word(RAM), counted);
    board.halt(false);
    board.run_until(15_000_000).unwrap();
    // One for all the periods in which it was halted, and 80 more: 5 ms of 62.5 us.
    assert_eq!(board.read_word(RAM), counted.map(|n| n + 81));
}

#[test]
fn the_watchdog_resets_a_halted_core_and_lets_it_go() {
    let mut board = watched_program().board(0, BoardConfig::default());
    board.run_until(10_000_000).unwrap();
    board.halt(true);
    board.run_until(50_100_000 + WATCHDOG_STARTS_NS).unwrap();
    assert_eq!(board.reset_cause(), ResetCause::Watchdog);
    assert_eq!(board.read_word(RAM), Some(2), "it runs again");
}

#[test]
fn a_slow_watchdog_oscillator_waits_longer() {
    let config = BoardConfig {
        lsi_hz: 17_000,
        ..BoardConfig::default()
    };
    let mut board = watched_program().board(0, config);
    board.run_until(94_000_000).unwrap();
    assert_eq!(board.resets(), 0);
    board.run_until(94_300_000 + WATCHDOG_STARTS_NS).unwrap();
    assert_eq!(board.resets(), 1);
}

#[test]
fn software_reset() {
    let mut code = Code::default();
    code.count(RAM);
    code.store(0xE000_ED0C, 0x05FA_0004); // AIRCR.SYSRESETREQ
    code.branch_to_itself();
    let mut board = code.board(0, BoardConfig::default());
    board.run_until(1_000_000).unwrap();
    assert!(board.resets() > 1);
    assert_eq!(board.reset_cause(), ResetCause::Software);
}

#[test]
fn a_fault_without_a_handler_locks_up() {
    let mut code = Code::default();
    code.read(0x6000_0000);
    code.branch_to_itself();
    // The handler's address faults as well.
    let stop = code
        .board(0x7000_0000, BoardConfig::default())
        .run_until(1_000_000)
        .unwrap_err();
    assert_eq!(stop.kind, StopKind::LockedUp);
}

#[test]
fn the_core_waits_while_its_flash_is_erased() {
    let mut code = Code::default();
    code.store(0x4002_3C04, 0x4567_0123);
    code.store(0x4002_3C04, 0xCDEF_89AB);
    code.store(0x4002_3C10, 2 | 1 << 3 | 2 << 8 | 1 << 16); // sector 1, x32, start
    code.count(RAM);
    code.branch_to_itself();
    let mut board = code.board(0, BoardConfig::default());
    board.run_until(249_900_000).unwrap();
    assert_eq!(board.read_word(RAM), Some(0), "stalled for 250 ms");
    board.run_until(250_100_000).unwrap();
    assert_eq!(board.read_word(RAM), Some(1));
    assert_eq!(board.read_word(0x0800_4000), Some(0xFFFF_FFFF));
}

/// What is in RAM runs on, until it reads from the flash.
#[test]
fn code_in_ram_goes_on_while_flash_is_erased_and_waits_for_a_constant_there() {
    for (name, source, ms) in [
        ("a peripheral", 0x4002_3C10, 0),
        ("flash", 0x0800_0100, 250),
    ] {
        // LDR r1, [r0]; STR r1, [r2]; branch to itself. And STR r6, [r5]; BX r7.
        let in_ram = 0x2000_0200;
        let mut code = Code::default();
        code.store(in_ram, 0x6011_6801);
        code.store(in_ram + 4, 0xE7FE_E7FE);
        code.store(in_ram + 8, 0x4738_602E);
        code.store(0x4002_3C04, 0x4567_0123);
        code.store(0x4002_3C04, 0xCDEF_89AB);
        code.load(0, source);
        code.load(2, RAM + 16);
        code.load(4, in_ram + 9);
        code.load(5, 0x4002_3C10);
        code.load(6, 2 | 1 << 3 | 2 << 8 | 1 << 16); // sector 1, x32, start
        code.load(7, in_ram + 1);
        code.0.push(0x4720); // BX r4
        for reference_core in [false, true] {
            let mut board = code.board_on(reference_core, 0);
            board
                .run_until((ms.max(1) - 1) * 1_000_000 + 500_000)
                .unwrap();
            let stored = board.read_word(RAM + 16) != Some(0);
            assert_eq!(stored, ms == 0, "{name}");
            board.run_until((ms + 1) * 1_000_000).unwrap();
            assert_ne!(board.read_word(RAM + 16), Some(0), "{name}");
            assert_eq!(board.flash_operations().erases, 1);
        }
    }
}

#[test]
fn a_watchdog_can_cut_an_erase_short() {
    let mut code = Code::default();
    code.count(RAM);
    start_watchdog(&mut code);
    code.store(0x4002_3C04, 0x4567_0123);
    code.store(0x4002_3C04, 0xCDEF_89AB);
    code.store(0x4002_3C10, 2 | 1 << 3 | 2 << 8 | 1 << 16);
    code.branch_to_itself();
    let mut board = code.board(0, BoardConfig::default());
    board.run_until(120_000_000).unwrap();
    assert_eq!(board.read_word(RAM), Some(3));
}

#[test]
fn a_masked_interrupt_still_ends_wfi() {
    let mut code = Code::default();
    code.store(RCC_APB1ENR, 1);
    code.store(0x4000_002C, 99);
    code.store(0x4000_000C, 1);
    code.store(NVIC_ISER0, 1 << 28);
    code.0.push(0xB672); // CPSID i
    code.store(0x4000_0000, 1);
    for _ in 0..120 {
        code.0.push(0xBF00); // NOP: the interrupt is pending before the core goes to sleep
    }
    code.0.push(0xBF30); // WFI
    code.count(RAM);
    code.branch_to_itself();
    let mut board = code.board(0, BoardConfig::default());
    board.run_until(1_000_000).unwrap();
    assert_eq!(board.read_word(RAM), Some(1));
}

#[test]
fn stop_mode_is_refused() {
    let mut code = Code::default();
    code.store(0xE000_ED10, 4);
    code.wait_for_event();
    code.branch_to_itself();
    let stop = code
        .board(0, BoardConfig::default())
        .run_until(1_000_000)
        .unwrap_err();
    assert!(stop.to_string().contains("SLEEPDEEP"), "{stop}");
}

/// The flags of a comparison of floats must outlive an interrupt before they are read, whether its
/// handler uses the floating-point unit or not.
#[test]
fn an_interrupt_leaves_the_flags_of_a_float_comparison() {
    for (reference_core, floats) in [(false, false), (false, true), (true, false), (true, true)] {
        let mut code = Code::default();
        code.store(0xE000_ED88, 0xF << 20); // CPACR: the unit is on
        code.store(NVIC_ISER0, 1 << 28);
        code.load(0, 0xE000_E200); // NVIC_ISPR0
        code.load(1, 1 << 28);
        code.load(4, RAM + 16);
        code.0.push(0x2200); // MOVS r2, #0
        code.0.extend([0xEE00, 0x2A10]); // VMOV s0, r2
        code.0.push(0x2A01); // CMP r2, #1: not equal
        code.0.extend([0xEEB5, 0x0A40]); // VCMP.F32 s0, #0: equal
        code.0.push(0x6001); // STR r1, [r0]: the interrupt comes after this
        code.0.extend([0xEEF1, 0xFA10]); // VMRS APSR_nzcv, FPSCR
        code.0.extend([0xBF0C, 0x2301, 0x2302]); // ITE EQ; MOVEQ r3, #1; MOVNE r3, #2
        code.0.push(0x6023); // STR r3, [r4]
        code.branch_to_itself();
        let handler = code.here();
        code.count(RAM);
        if floats {
            code.0.extend([0xEE00, 0x1A10]); // VMOV s0, r1: not zero
            code.0.extend([0xEEB5, 0x0A40]); // VCMP.F32 s0, #0: not equal
        }
        code.ret();
        let mut board = code.board_on(reference_core, handler);
        board.run_until(1_000_000).unwrap();
        assert_eq!(board.read_word(RAM), Some(1), "the interrupt came");
        assert_eq!(board.read_word(RAM + 16), Some(1), "equal");
    }
}

/// The instruction that makes the interrupt pending may be in the block itself.
#[test]
fn an_it_block_that_pends_an_interrupt_goes_on_with_its_condition() {
    for reference_core in [false, true] {
        let mut code = Code::default();
        code.store(NVIC_ISER0, 1 << 28);
        code.load(0, 0xE000_E200); // NVIC_ISPR0
        code.load(1, 1 << 28);
        code.load(4, RAM + 16);
        code.0.extend([0x2200, 0x2300]); // MOVS r2, #0; MOVS r3, #0
        code.0.push(0x2A00); // CMP r2, #0: equal
        code.0.push(0xBF06); // ITTE EQ
        code.0.push(0x6001); // STREQ r1, [r0]: the interrupt comes after this
        code.0.push(0x3301); // ADDEQ r3, #1
        code.0.push(0x3302); // ADDNE r3, #2
        code.0.push(0x6023); // STR r3, [r4]
        code.branch_to_itself();
        let handler = code.here();
        code.count(RAM);
        code.ret();
        let mut board = code.board_on(reference_core, handler);
        board.run_until(1_000_000).unwrap();
        assert_eq!(board.read_word(RAM), Some(1));
        assert_eq!(board.read_word(RAM + 16), Some(1));
    }
}

/// What LDREX reserves outlasts an interrupt that may not be taken yet, and not one that is taken.
#[test]
fn a_reservation_outlasts_a_masked_interrupt() {
    for (reference_core, masked) in [(false, true), (true, true), (false, false), (true, false)] {
        let mut code = Code::default();
        code.store(RCC_APB2ENR, 1 << 14);
        code.store(0x4001_3C00, 1); // EXTI0 interrupts
        code.store(NVIC_ISER0, 1 << 6);
        code.load(4, RAM + 16);
        code.load(0, 0x4001_3C10); // EXTI_SWIER
        code.load(1, 1);
        code.0.push(if masked { 0xB672 } else { 0xBF00 }); // CPSID i; NOP
        code.0.extend([0xE854, 0x2F00]); // LDREX r2, [r4]
        code.0.push(0x6001); // STR r1, [r0]: the interrupt's line goes up
        code.0.extend([0xE844, 0x1300]); // STREX r3, r1, [r4]
        code.0.push(0x6063); // STR r3, [r4, #4]
        code.0.push(0xB662); // CPSIE i
        code.0.push(0xBF00);
        code.branch_to_itself();
        let handler = code.here();
        code.store(0x4001_3C14, 1); // EXTI_PR
        code.count(RAM);
        code.0.extend([0xE854, 0x2F00]); // LDREX r2, [r4]: gone with the handler's end
        code.ret();
        let mut board = code.board_on(reference_core, handler);
        board.run_until(1_000_000).unwrap();
        let words = [RAM, RAM + 16, RAM + 20].map(|address| board.read_word(address));
        let (stored, failed) = if masked { (1, 0) } else { (0, 1) };
        assert_eq!(words, [Some(1), Some(stored), Some(failed)]);
    }
}

/// A load and a store take two cycles each, the others one (Cortex-M4 TRM, table 3-1).
#[test]
fn the_cycle_counter_counts_up_to_the_instruction_that_reads_it() {
    for reference_core in [false, true] {
        let mut code = Code::default();
        code.store(0xE000_EDFC, 1 << 24); // DEMCR.TRCENA
        code.store(0xE000_1000, 1); // DWT_CTRL.CYCCNTENA
        code.load(4, RAM);
        code.load(0, 0xE000_1004); // DWT_CYCCNT
        code.0.push(0x6802); // LDR r2, [r0]
        code.0.push(0x6022); // STR r2, [r4]
        code.0.extend([0xBF00; 3]); // NOP
        code.0.push(0x6803); // LDR r3, [r0]
        code.0.push(0x6063); // STR r3, [r4, #4]
        code.branch_to_itself();
        let mut board = code.board_on(reference_core, 0);
        board.run_until(1_000_000).unwrap();
        let [first, second] = [RAM, RAM + 4].map(|address| board.read_word(address).unwrap());
        // The store to DWT_CTRL counts itself, and four instructions lie before the first read.
        assert_eq!((first, second), (6, 13));
    }
}
