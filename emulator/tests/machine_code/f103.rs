//! The STM32F103 as instructions and pins see it: a program sets up clocks, pins and peripherals
//! through its own registers (RM0008 rev 21).

use emulator::chip::F103;
use emulator::{Board, BoardConfig, CanFrame, Firmware, PinLevel, Port, Stop, StopKind};

use super::code::{Code, NVIC_ISER0, RAM};

const APB2ENR: u32 = 0x4002_1018;
const APB1ENR: u32 = 0x4002_101C;
const MAPR: u32 = 0x4001_0004;
const GPIOA: u32 = 0x4001_0800;
const GPIOB: u32 = 0x4001_0C00;
const GPIOC: u32 = 0x4001_1000;
const CRL: u32 = 0x00;
const CRH: u32 = 0x04;
const TIM1: u32 = 0x4001_2C00;
const TIM8: u32 = 0x4001_3400;
const FPEC: u32 = 0x4002_2000;

fn board_on(code: &Code, handler: u32, reference_core: bool) -> Board {
    let firmware = Firmware::for_chip(&F103, &code.bytes(handler)).unwrap();
    let config = BoardConfig {
        reference_core,
        ..BoardConfig::default()
    };
    Board::new(&firmware, config)
}

fn board(code: &Code, handler: u32) -> Board {
    board_on(code, handler, false)
}

/// The clocks of everything on APB2 and APB1.
fn clocks(code: &mut Code) {
    code.store(APB2ENR, 0x0000_FFFD);
    code.store(APB1ENR, 0x3EFE_C83F);
}

fn stop_of(code: &Code) -> Stop {
    board(code, 0).run_until(1_000_000).unwrap_err()
}

/// 72 MHz from 8 MHz by 9, two wait states, APB1 at 36 MHz; CAN on PB8 and PB9 with 4 x (1 + 7 + 1)
/// of its clocks a bit.
fn fast_with_can(times: u32, latency: u32) -> Code {
    let mut code = Code::default();
    clocks(&mut code);
    code.store(FPEC, 0x10 | latency);
    code.store(0x4002_1000, 0x83 | 1 << 16); // HSEON
    code.wait(8_000); // 2 ms at 8 MHz
    let cfgr = 1 << 16 | (times - 2) << 18 | 4 << 8;
    code.store(0x4002_1004, cfgr);
    code.store(0x4002_1000, 0x83 | 1 << 16 | 1 << 24); // PLLON
    code.wait(1_000);
    code.store(0x4002_1004, cfgr | 2);
    code.store(MAPR, 2 << 13 | 2 << 24);
    code.store(GPIOB + CRH, 0x4444_44B8); // PB9 driven by CAN, PB8 with a pull
    code.store(GPIOB + 0x10, 1 << 8);
    for (offset, value) in [(0x00, 1), (0x1C, 3 | 6 << 16), (0x00, 0)] {
        code.store(0x4000_6400 + offset, value);
    }
    // One filter for everything, of 14.
    for (offset, value) in [
        (0x200, 1),
        (0x20C, 1),
        (0x240, 0),
        (0x244, 0),
        (0x21C, 1),
        (0x200, 0),
    ] {
        code.store(0x4000_6400 + offset, value);
    }
    code
}

#[test]
fn a_program_reaches_72_mhz_and_1_mbit() {
    for reference_core in [false, true] {
        let mut code = fast_with_can(9, 2);
        code.branch_to_itself();
        let mut board = board_on(&code, 0, reference_core);
        board.run_until(20_000_000).unwrap();
        assert_eq!(board.can().bit_rate(), Some(1_000_000));
        let before = board.cycles().0;
        board.run_until(21_000_000).unwrap();
        assert_eq!(board.cycles().0 - before, 72_000);
    }
}

#[test]
fn clocks_past_the_data_sheet_stop() {
    for (times, latency, what) in [(10, 2, "72 MHz"), (9, 1, "wait states")] {
        let mut code = fast_with_can(times, latency);
        code.branch_to_itself();
        let stop = board(&code, 0).run_until(20_000_000).unwrap_err();
        assert!(
            matches!(&stop.kind, StopKind::Clock(text) if text.contains(what)),
            "{stop}"
        );
    }
}

/// CAN1_RX0 is interrupt 20 (table 63).
#[test]
fn a_frame_interrupts_and_a_request_leaves() {
    let mut code = fast_with_can(9, 2);
    code.store(0x4000_6414, 1 << 1); // FMPIE0
    code.store(NVIC_ISER0, 1 << 20);
    for (offset, value) in [(0x184, 2), (0x188, 0xBBAA), (0x180, 0x123 << 21 | 1)] {
        code.store(0x4000_6400 + offset, value);
    }
    let sleep = code.here();
    code.wait_for_event();
    code.branch(sleep);
    let handler = code.here();
    code.store(0x4000_640C, 1 << 5); // RFOM0
    code.count(RAM);
    code.ret();
    let mut board = board(&code, handler);
    board.run_until(20_000_000).unwrap();
    assert!(board.can().pending().is_some(), "the request");
    let frame = CanFrame::new(0x80, &[1]).unwrap();
    board.can().receive(&frame);
    board.run_until(21_000_000).unwrap();
    assert_eq!(board.read_word(RAM), Some(1));
}

#[test]
fn banks_past_the_fourteenth_do_not_exist() {
    let mut code = Code::default();
    clocks(&mut code);
    code.read(0x4000_6640 + 13 * 8);
    code.read(0x4000_6640 + 14 * 8);
    assert!(stop_of(&code).to_string().contains("CAN_"));
}

/// VADD.F32 s0, s0, s0 and UADD8 r0, r0, r0 are not the core's; nor UXTAB r0, r0, r1, which the
/// fast path knows.
#[test]
fn instructions_of_a_larger_core_fault() {
    let larger = [[0xEE30, 0x0A00], [0xFA80, 0xF040], [0xFA50, 0xF081]];
    for reference_core in [false, true] {
        for halves in larger {
            let mut code = Code::default();
            code.store(0xE000_ED88, 0x00F0_0000); // CPACR, which is not there
            code.0.extend(halves);
            code.count(RAM + 4);
            code.branch_to_itself();
            let handler = code.here();
            code.count(RAM);
            code.branch_to_itself();
            let mut board = board_on(&code, handler, reference_core);
            board.run_until(1_000_000).unwrap();
            let words = [RAM, RAM + 4].map(|at| board.read_word(at));
            assert_eq!(words, [Some(1), Some(0)], "{halves:x?}");
        }
    }
}

#[test]
fn there_are_48_kib_of_ram() {
    for (at, faults) in [(0x2000_BFFC, 0), (0x2000_C000, 1)] {
        for reference_core in [false, true] {
            let mut code = Code::default();
            code.store(at, 7);
            code.branch_to_itself();
            let handler = code.here();
            code.count(RAM);
            code.branch_to_itself();
            let mut board = board_on(&code, handler, reference_core);
            board.run_until(1_000_000).unwrap();
            assert_eq!(board.read_word(RAM), Some(faults), "{at:#x}");
        }
    }
}

/// TIM8 on PC6, TIM1 on PA8 and its complementary CH3N on PB1 by the partial remap; PA6 is the
/// break input of both.
fn pwm_board(mapr: u32) -> Board {
    let mut code = Code::default();
    clocks(&mut code);
    code.store(MAPR, mapr);
    code.store(GPIOA + CRL, 0x4844_4444); // PA6 pulled
    code.store(GPIOA + CRH, 0x4444_444B);
    code.store(GPIOB + CRL, 0x4444_44B4);
    code.store(GPIOC + CRL, 0x4B44_4444);
    for timer in [TIM1, TIM8] {
        for (offset, value) in [
            (0x2C, 799),
            (0x34, 200),
            (0x3C, 400),
            (0x18, 0x60),
            (0x1C, 0x60),
            (0x20, if timer == TIM1 { 1 | 1 << 10 } else { 1 }),
            (0x44, 0xB000), // MOE, BKE, BKP
            (0x00, 1),
        ] {
            code.store(timer + offset, value);
        }
    }
    code.branch_to_itself();
    let mut board = board(&code, 0);
    board.set_input(Port::A, 6, false);
    board.run_until(1_000_000).unwrap();
    board
}

#[test]
fn remaps_decide_which_pins_a_timer_has() {
    let mut mapped = pwm_board(1 << 6);
    assert_eq!(mapped.pwm(8, 1).duty, 0.25);
    assert_eq!(mapped.pwm(1, 1).duty, 0.25);
    assert_ne!(mapped.output(Port::B, 1), PinLevel::Floating, "TIM1_CH3N");
    mapped.set_input(Port::A, 6, true);
    assert!(!mapped.pwm(8, 1).active && !mapped.pwm(1, 1).active);
    assert_eq!(mapped.output(Port::B, 1), PinLevel::Floating);
    let mut plain = pwm_board(0);
    assert_eq!(plain.output(Port::B, 1), PinLevel::Floating, "PB15 has it");
    plain.set_input(Port::A, 6, true);
    assert!(!plain.pwm(8, 1).active, "PA6 is TIM8's in any case");
    assert!(plain.pwm(1, 1).active, "and TIM1's is PB12");
}

/// Encoders on TIM2 (PA15, PB3) and TIM5 (PA0, PA1).
fn encoder_board(mapr: u32) -> Board {
    let mut code = Code::default();
    clocks(&mut code);
    code.store(MAPR, mapr);
    for timer in [0x4000_0000, 0x4000_0C00] {
        for (offset, value) in [(0x18, 0x101), (0x08, 3), (0x00, 1)] {
            code.store(timer + offset, value);
        }
    }
    let again = code.here();
    for (timer, to) in [(0x4000_0000, RAM), (0x4000_0C00, RAM + 4)] {
        code.read(timer + 0x24);
        code.load(0, to);
        code.0.push(0x6001);
    }
    code.branch(again);
    let mut board = board(&code, 0);
    board.run_until(1_000_000).unwrap();
    board.encoder_add(2, -3);
    board.encoder_add(5, 5);
    board.run_until(2_000_000).unwrap();
    board
}

#[test]
fn encoders_count_16_bits_on_pins_that_are_inputs() {
    let counts = |mapr| {
        let board = encoder_board(mapr);
        [RAM, RAM + 4].map(|at| board.read_word(at).unwrap())
    };
    assert_eq!(counts(1 << 8 | 2 << 24), [0xFFFD, 5]);
    assert_eq!(counts(1 << 8), [0, 5], "PA15 and PB3 are the debug port's");
    assert_eq!(counts(0), [0xFFFD, 5], "TIM2 is on PA0 and PA1, too");
}

/// A kit with four bridges of two inputs each uses every channel of TIM1 and TIM8, two of them as
/// complementary outputs without their main ones, beside four encoders and CAN: one value of MAPR
/// for all of them. `docs/boards.md` has the sources of these pins.
fn kit_board() -> Board {
    let mut code = Code::default();
    clocks(&mut code);
    // TIM1 partial, TIM2 partial 1, TIM3 partial, CAN on PB8 and PB9, SWD without JTAG.
    code.store(MAPR, 1 << 6 | 1 << 8 | 2 << 10 | 2 << 13 | 2 << 24);
    code.store(GPIOA + CRH, 0x4444_B44B); // PA8, PA11
    code.store(GPIOB + CRL, 0x4444_44BB); // PB0, PB1
    code.store(GPIOC + CRL, 0xBB44_4444); // PC6, PC7
    code.store(GPIOC + CRH, 0x4444_44BB); // PC8, PC9
    for (timer, enable, first) in [(TIM1, 0x1441, 1), (TIM8, 0x1111, 5)] {
        for (offset, value) in [(0x2C, 799), (0x18, 0x6060), (0x1C, 0x6060), (0x20, enable)] {
            code.store(timer + offset, value);
        }
        for channel in 0..4 {
            code.store(timer + 0x34 + 4 * channel, 80 * (first + channel));
        }
        code.store(timer + 0x44, 0x8000); // MOE
        code.store(timer, 1);
    }
    for timer in ENCODERS {
        for (offset, value) in [(0x18, 0x101), (0x08, 3), (0x00, 1)] {
            code.store(timer + offset, value);
        }
    }
    let again = code.here();
    for (timer, to) in ENCODERS.into_iter().zip((RAM..).step_by(4)) {
        code.read(timer + 0x24);
        code.load(0, to);
        code.0.push(0x6001);
    }
    code.branch(again);
    let mut board = board(&code, 0);
    board.run_until(1_000_000).unwrap();
    board
}

/// TIM2 to TIM5.
const ENCODERS: [u32; 4] = [0x4000_0000, 0x4000_0400, 0x4000_0800, 0x4000_0C00];

#[test]
fn a_kit_has_eight_pwm_pins_beside_four_encoders() {
    let mut board = kit_board();
    // Channels 1, 2N, 3N and 4 of TIM1, then 1 to 4 of TIM8: 10 % to 80 % high.
    let pins = [
        (Port::A, 8),
        (Port::B, 0),
        (Port::B, 1),
        (Port::A, 11),
        (Port::C, 6),
        (Port::C, 7),
        (Port::C, 8),
        (Port::C, 9),
    ];
    let mut high = [0; 8];
    for sample in 0..100 {
        // A period takes 100 us.
        board.run_until(2_000_500 + 1_000 * sample).unwrap();
        for (count, (port, pin)) in high.iter_mut().zip(pins) {
            *count += i32::from(board.output(port, pin) == PinLevel::High);
        }
    }
    for (channel, count) in (1..).zip(high) {
        assert!((count - 10 * channel).abs() <= 1, "{high:?}");
    }
    for channel in [2, 3] {
        let state = board.complementary_pwm(1, channel);
        assert!(state.active && (state.duty - 0.1 * channel as f32).abs() < 1e-3);
        assert!(!board.pwm(1, channel).active, "its main output is off");
    }
    for (timer, edges) in [(2, 7), (3, -5), (4, 3), (5, -2)] {
        board.encoder_add(timer, edges);
    }
    board.run_until(3_000_000).unwrap();
    let counts = [RAM, RAM + 4, RAM + 8, RAM + 12].map(|at| board.read_word(at).unwrap());
    assert_eq!(counts, [7, 0xFFFB, 3, 0xFFFE]);
}

/// The STM32F1 has no register that takes clocks away from a sleeping chip.
#[test]
fn a_timer_wakes_a_sleeping_core() {
    let mut code = Code::default();
    clocks(&mut code);
    code.store(0x4000_002C, 7_999); // ARR: 1 ms at 8 MHz
    code.store(0x4000_000C, 1);
    code.store(NVIC_ISER0, 1 << 28);
    code.store(0x4000_0000, 1);
    let sleep = code.here();
    code.wait_for_event();
    code.branch(sleep);
    let handler = code.here();
    code.store(0x4000_0010, 0);
    code.count(RAM);
    code.ret();
    let mut board = board(&code, handler);
    board.run_until(10_500_000).unwrap();
    assert_eq!(board.read_word(RAM), Some(10));
}

/// Erases the page at 0x0801_0000 and programs one half-word; SR into RAM each time.
#[test]
fn the_core_stalls_while_a_page_is_erased() {
    let mut code = Code::default();
    for key in [0x4567_0123, 0xCDEF_89AB] {
        code.store(FPEC + 0x04, key);
    }
    code.store(FPEC + 0x10, 2);
    code.store(FPEC + 0x14, 0x0801_0000);
    code.store(FPEC + 0x10, 2 | 1 << 6);
    code.read(FPEC + 0x0C);
    code.load(0, RAM);
    code.0.push(0x6001);
    code.store(FPEC + 0x10, 1);
    code.load(0, 0x0801_0002);
    code.load(1, 0x1234);
    code.0.push(0x8001); // STRH r1, [r0]
    code.count(RAM + 4);
    code.branch_to_itself();
    for reference_core in [false, true] {
        let mut board = board_on(&code, 0, reference_core);
        board.run_until(39_900_000).unwrap();
        assert_eq!(board.read_word(RAM), Some(0), "stalled");
        board.run_until(40_100_000).unwrap();
        assert_eq!(board.read_word(RAM), Some(1 << 5), "EOP");
        board.run_until(41_000_000).unwrap();
        assert_eq!(board.read_word(RAM + 4), Some(1));
        assert_eq!(board.flash()[0x1_0000..0x1_0004], [0xFF, 0xFF, 0x34, 0x12]);
    }
}

#[test]
fn a_store_of_a_word_to_the_flash_faults() {
    let mut code = Code::default();
    for key in [0x4567_0123, 0xCDEF_89AB] {
        code.store(FPEC + 0x04, key);
    }
    code.store(FPEC + 0x10, 1);
    code.store(0x0801_0000, 0x1234_5678);
    code.branch_to_itself();
    let handler = code.here();
    code.count(RAM);
    code.branch_to_itself();
    let mut board = board(&code, handler);
    board.run_until(1_000_000).unwrap();
    assert_eq!(board.read_word(RAM), Some(1));
    assert_eq!(board.flash()[0x1_0000], 0xFF);
}

#[test]
fn a_program_reads_who_it_runs_on() {
    let mut code = Code::default();
    for (from, to) in [
        (0x1FFF_F7E0, RAM),
        (0x1FFF_F7E8, RAM + 4),
        (0xE004_2000, RAM + 8),
    ] {
        code.read(from);
        code.load(0, to);
        code.0.push(0x6001);
    }
    code.branch_to_itself();
    let mut board = board(&code, 0);
    board.run_until(1_000_000).unwrap();
    let words = [0, 4, 8].map(|at| board.read_word(RAM + at).unwrap());
    assert_eq!(words[0] & 0xFFFF, 256, "KiB of flash");
    assert_eq!(words[1].to_le_bytes(), *b"OMNI");
    assert_eq!(words[2] & 0xFFF, F103.device());
}

#[test]
fn what_is_not_modelled_stops_with_its_name() {
    for (address, name) in [
        (0x4001_3800, "USART1"),
        (0x4002_0000, "DMA1"),
        (0x4000_6C00, "BKP"),
        (GPIOA + 0x1C, "GPIOA"),
        (FPEC + 0x18, "FLASH"),
    ] {
        let mut code = Code::default();
        clocks(&mut code);
        code.store(0x4002_1014, 0x455);
        code.read(address);
        code.branch_to_itself();
        let stop = stop_of(&code);
        assert!(
            matches!(&stop.kind, StopKind::Unmodelled { what, .. } if what.starts_with(name)),
            "{stop}"
        );
    }
}
