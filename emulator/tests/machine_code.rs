//! Boards that run a few instructions assembled by hand: what needs a core and not only registers.
//!
//! [`Code`] knows the handful of encodings that are used (ARMv7-M Architecture Reference Manual, section A7.7).

use emulator::{
    Board, BoardConfig, CanFrame, Change, Firmware, PinLevel, Port, ResetCause, StopKind,
};

const RCC_AHB1ENR: u32 = 0x4002_3830;
const RCC_APB1ENR: u32 = 0x4002_3840;
const RCC_APB2ENR: u32 = 0x4002_3844;
const GPIOA: u32 = 0x4002_0000;
const GPIOB: u32 = 0x4002_0400;
const NVIC_ISER0: u32 = 0xE000_E100;

/// Base of the counters that programs keep in RAM.
const RAM: u32 = 0x2000_0000;

#[derive(Default)]
struct Code(Vec<u16>);

impl Code {
    /// Address of the next instruction.
    fn here(&self) -> u32 {
        0x0800_0200 + 2 * self.0.len() as u32
    }

    /// MOVW and MOVT: a register gets a 32-bit value.
    fn load(&mut self, register: u16, value: u32) {
        for (opcode, half) in [(0xF240, value & 0xFFFF), (0xF2C0, value >> 16)] {
            let half = half as u16;
            self.0.push(opcode | half >> 12 | (half >> 11 & 1) << 10);
            self.0
                .push((half >> 8 & 7) << 12 | register << 8 | half & 0xFF);
        }
    }

    /// A store of a word to an address; uses r0 and r1.
    fn store(&mut self, address: u32, value: u32) {
        self.load(0, address);
        self.load(1, value);
        self.0.push(0x6001); // STR r1, [r0]
    }

    /// A load of a word; into r1.
    fn read(&mut self, address: u32) {
        self.load(0, address);
        self.0.push(0x6801); // LDR r1, [r0]
    }

    /// Adds one to a word in RAM.
    fn count(&mut self, address: u32) {
        self.read(address);
        self.0.push(0x3101); // ADDS r1, #1
        self.0.push(0x6001); // STR r1, [r0]
    }

    /// So many rounds of a loop; uses r2.
    fn wait(&mut self, rounds: u32) {
        self.load(2, rounds);
        let again = self.here();
        self.0.push(0x3A01); // SUBS r2, #1
        let back = (again as i32 - self.here() as i32 - 4) / 2;
        self.0.push(0xD100 | back as u16 & 0xFF); // BNE
    }

    fn wait_for_event(&mut self) {
        self.0.push(0xBF20); // WFE
    }

    /// A branch back to an address.
    fn branch(&mut self, to: u32) {
        let offset = (to as i32 - self.here() as i32 - 4) / 2;
        self.0.push(0xE000 | offset as u16 & 0x7FF);
    }

    fn branch_to_itself(&mut self) {
        self.0.push(0xE7FE);
    }

    fn ret(&mut self) {
        self.0.push(0x4770); // BX lr
    }

    /// The image: initial stack pointer, reset at the first instruction, everything else at `handler`.
    fn image(&self, handler: u32) -> Firmware {
        let mut bytes = Vec::new();
        for index in 0..0x80 {
            let word = match index {
                0 => 0x2000_4000,
                1 => 0x0800_0201,
                _ => handler | 1,
            };
            bytes.extend_from_slice(&u32::to_le_bytes(word));
        }
        for half in &self.0 {
            bytes.extend_from_slice(&half.to_le_bytes());
        }
        Firmware::from_flash(&bytes).unwrap()
    }

    fn board(&self, handler: u32, config: BoardConfig) -> Board {
        Board::new(&self.image(handler), config)
    }
}

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
    // 10 ms at 16 MHz are 160 000 clocks: 160 periods, the last of them after the 40 or so clocks of set-up.
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
        let config = BoardConfig {
            reference_core,
            ..BoardConfig::default()
        };
        let mut board = code.board(handler, config);
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

#[test]
fn an_unmodelled_register_stops_with_its_name() {
    let mut code = Code::default();
    code.store(RCC_APB1ENR, 1 << 17);
    let at = code.here();
    code.read(0x4000_4400);
    code.branch_to_itself();
    let stop = code
        .board(0, BoardConfig::default())
        .run_until(1_000_000)
        .unwrap_err();
    assert_eq!(
        stop.kind,
        StopKind::Unmodelled {
            what: "USART2_+0x0".to_owned(),
            address: 0x4000_4400,
            written: None
        }
    );
    // The load is the third instruction; both before it are four bytes long.
    assert_eq!(stop.pc, at + 8);
}

#[test]
fn an_unclocked_peripheral_stops() {
    let mut code = Code::default();
    code.store(0x4000_002C, 999);
    code.branch_to_itself();
    let stop = code
        .board(0, BoardConfig::default())
        .run_until(1_000_000)
        .unwrap_err();
    assert_eq!(
        stop.kind,
        StopKind::Unclocked {
            what: "TIM2_ARR".to_owned(),
            address: 0x4000_002C,
            written: Some(999)
        }
    );
}

/// With the PLL at 160 MHz instead of 180, bit timings for PCLK1 = 45 MHz give 40 / 45 of 1 Mbit/s.
#[test]
fn a_wrong_pll_setting_shows_as_a_wrong_can_bit_rate() {
    let rate = |plln: u32| {
        let mut code = Code::default();
        code.store(0x4002_3C00, 5 | 7 << 8); // FLASH_ACR: five wait states
        code.store(0x4002_3804, 1 << 22 | plln << 6 | 4); // RCC_PLLCFGR: 8 MHz / 4 x N / 2
        code.store(0x4002_3840, 1 << 28 | 1 << 25); // RCC_APB1ENR: PWR, CAN1
        code.store(0x4002_3830, 1 << 1); // RCC_AHB1ENR: GPIOB
        code.store(0x4000_7000, 3 << 14 | 1 << 16); // PWR_CR: scale 1, over-drive
        code.store(0x4002_3800, 0x83 | 5 << 16 | 1 << 24); // RCC_CR: HSE, PLL
        code.wait(4000);
        code.store(0x4000_7000, 3 << 14 | 3 << 16); // PWR_CR: over-drive switched
        code.wait(4000);
        code.store(0x4002_3808, 2 | 5 << 10 | 4 << 13); // RCC_CFGR: PLL, APB1 / 4, APB2 / 2
        code.store(0x4002_0424, 9 << 4 | 9); // GPIOB_AFRH: CAN1 on PB8, PB9
        code.store(0x4002_0400, 0x280 | 2 << 18 | 2 << 16); // GPIOB_MODER
        code.store(0x4000_6400, 1); // CAN_MCR: initialisation
        code.store(0x4000_641C, 4 | 6 << 16); // CAN_BTR: PCLK1 / 5, 1 + 7 + 1 = 9 quanta
        code.store(0x4000_6400, 0);
        code.branch_to_itself();
        let mut board = code.board(0, BoardConfig::default());
        board.run_until(10_000_000).unwrap();
        board.can().bit_rate()
    };
    assert_eq!(rate(180), Some(1_000_000));
    assert_eq!(rate(160), Some(888_889));
}

#[test]
fn too_fast_for_the_wait_states_stops() {
    let mut code = Code::default();
    code.store(0x4002_3804, 1 << 22 | 168 << 6 | 4); // 8 / 4 x 168 / 2 = 168 MHz
    code.store(0x4002_3800, 0x83 | 5 << 16 | 1 << 24);
    code.wait(4000);
    code.store(0x4002_3808, 2 | 5 << 10 | 4 << 13);
    code.branch_to_itself();
    let stop = code
        .board(0, BoardConfig::default())
        .run_until(10_000_000)
        .unwrap_err();
    assert!(
        matches!(&stop.kind, StopKind::Clock(what) if what.contains("wait states")),
        "{stop}"
    );
}

/// Starts the watchdog with 50 ms at 32 kHz, counts its starts in RAM and sleeps.
fn watched_program() -> Code {
    let mut code = Code::default();
    code.count(RAM);
    code.read(0x4002_3874); // RCC_CSR
    code.load(0, RAM + 4);
    code.0.push(0x6001);
    for (offset, value) in [(0, 0x5555), (4, 0), (8, 399), (0, 0xCCCC)] {
        code.store(0x4000_3000 + offset, value);
    }
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
    board.run_until(50_100_000).unwrap();
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
    board.run_until(50_100_000).unwrap();
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
    board.run_until(94_300_000).unwrap();
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

#[test]
fn a_watchdog_can_cut_an_erase_short() {
    let mut code = Code::default();
    code.count(RAM);
    for (offset, value) in [(0, 0x5555), (4, 0), (8, 399), (0, 0xCCCC)] {
        code.store(0x4000_3000 + offset, value);
    }
    code.store(0x4002_3C04, 0x4567_0123);
    code.store(0x4002_3C04, 0xCDEF_89AB);
    code.store(0x4002_3C10, 2 | 1 << 3 | 2 << 8 | 1 << 16);
    code.branch_to_itself();
    let mut board = code.board(0, BoardConfig::default());
    board.run_until(120_000_000).unwrap();
    assert_eq!(board.read_word(RAM), Some(3));
}

#[test]
fn an_input_edge_interrupts() {
    let mut code = Code::default();
    code.store(RCC_APB2ENR, 1 << 14);
    code.store(0x4001_3808, 1); // EXTI0 from port B
    code.store(0x4001_3C08, 1); // rising
    code.store(0x4001_3C00, 1);
    code.store(NVIC_ISER0, 1 << 6);
    let sleep = code.here();
    code.wait_for_event();
    code.branch(sleep);
    let handler = code.here();
    code.store(0x4001_3C14, 1);
    code.count(RAM);
    code.ret();
    let mut board = code.board(handler, BoardConfig::default());
    board.set_input(Port::B, 0, false);
    board.run_until(1_000_000).unwrap();
    assert_eq!(
        board.next_event_ns(),
        None,
        "asleep, and nothing will happen by itself"
    );
    for (t, level, count) in [(2, true, 1), (3, false, 1), (4, true, 2)] {
        board.set_input(Port::B, 0, level);
        board.run_until(t * 1_000_000).unwrap();
        assert_eq!(board.read_word(RAM), Some(count));
    }
}

/// TIM1 channel 1 at 25 % with a break input, PA8 in a given mode.
fn pwm_board(moder: u32) -> Board {
    let mut code = Code::default();
    code.store(RCC_AHB1ENR, 3);
    code.store(RCC_APB2ENR, 1);
    code.store(GPIOA, moder);
    code.store(GPIOA + 0x24, 1); // AF1 on PA8
    code.store(GPIOB, 2 << 24);
    code.store(GPIOB + 0x24, 1 << 16); // AF1 on PB12
    for (offset, value) in [
        (0x2C, 799),
        (0x34, 200),
        (0x18, 0x60),
        (0x20, 1),
        (0x44, 0xB000), // MOE, BKE, BKP
        (0x00, 1),
    ] {
        code.store(0x4001_0000 + offset, value);
    }
    code.branch_to_itself();
    let mut board = code.board(0, BoardConfig::default());
    board.set_input(Port::B, 12, false);
    board.run_until(1_000_000).unwrap();
    board
}

#[test]
fn pwm_reaches_the_pin_only_in_its_alternate_function() {
    let state = pwm_board(2 << 16).pwm(1, 1);
    assert_eq!(
        (state.duty, state.period_ns, state.active),
        (0.25, 50_000, true)
    );
    for moder in [0, 1 << 16, 3 << 16] {
        let board = pwm_board(moder);
        assert!(!board.pwm(1, 1).active, "MODER {moder:#x}");
        assert_eq!(board.pwm(1, 1).duty, 0.0);
    }
}

#[test]
fn the_break_input_cuts_pwm_without_an_instruction() {
    let mut board = pwm_board(2 << 16);
    board.set_input(Port::B, 12, true);
    assert!(!board.pwm(1, 1).active);
    board.set_input(Port::B, 12, false);
    assert!(!board.pwm(1, 1).active, "it stays off");
    assert_eq!(board.output(Port::A, 8), PinLevel::Floating);
}

#[test]
fn frames_leave_when_they_are_requested() {
    let mut code = Code::default();
    code.store(RCC_AHB1ENR, 2);
    code.store(RCC_APB1ENR, 1 << 25);
    code.store(GPIOB, 2 << 16 | 2 << 18);
    code.store(GPIOB + 0x24, 9 | 9 << 4);
    // 16 MHz / 1 / (1 + 13 + 2) = 1 Mbit/s.
    for (offset, value) in [(0, 1), (0x1C, 12 << 16 | 1 << 20), (0, 0)] {
        code.store(0x4000_6400 + offset, value);
    }
    code.load(2, 1000);
    let wait = code.here();
    code.0.push(0x3A01);
    code.0
        .push(0xD100 | ((wait as i32 - code.here() as i32 - 4) / 2) as u16 & 0xFF);
    for (offset, value) in [(0x184, 2), (0x188, 0xBBAA), (0x180, 0x123 << 21 | 1)] {
        code.store(0x4000_6400 + offset, value);
    }
    code.branch_to_itself();
    let mut board = code.board(0, BoardConfig::default());
    let t = board.run_until_request(100_000_000).unwrap();
    // 1000 times 4 cycles of waiting at 16 MHz, and some 100 cycles of set-up.
    assert!((250_000..260_000).contains(&t), "{t} ns");
    let mut can = board.can();
    assert_eq!(can.bit_rate(), Some(1_000_000));
    assert_eq!(can.sample_point(), 0.875);
    assert_eq!(can.pending(), CanFrame::new(0x123, &[0xAA, 0xBB]));
    assert!(t.abs_diff(can.pending_since_ns().unwrap()) < 500);
    can.begin().unwrap();
    can.transmitted();
    assert_eq!(can.pending(), None);
}

#[test]
fn a_preloaded_duty_is_traced_when_it_takes_effect() {
    let mut code = Code::default();
    code.store(RCC_AHB1ENR, 1);
    code.store(RCC_APB2ENR, 1);
    code.store(GPIOA, 2 << 16);
    code.store(GPIOA + 0x24, 1);
    for (offset, value) in [
        (0x2C, 15_999), // 1 ms at 16 MHz
        (0x18, 0x68),
        (0x20, 1),
        (0x44, 0x8000),
        (0x14, 1),
        (0x00, 1),
        (0x34, 4_000),
    ] {
        code.store(0x4001_0000 + offset, value);
    }
    code.branch_to_itself();
    let mut board = code.board(0, BoardConfig::default());
    board.start_trace();
    board.run_until(3_000_000).unwrap();
    let duties: Vec<_> = board
        .take_trace()
        .into_iter()
        .filter_map(|traced| match traced.change {
            Change::Pwm {
                timer: 1,
                channel: 1,
                state,
            } => Some((traced.t_ns, state.duty)),
            _ => None,
        })
        .collect();
    let (written, zero) = duties[duties.len() - 2];
    let (taken, quarter) = duties[duties.len() - 1];
    assert_eq!((zero, quarter), (0.0, 0.25));
    // The period began when the counter was started, a few instructions before the compare value was written.
    assert!(
        (990_000..1_000_400).contains(&(taken - written)),
        "{}",
        taken - written
    );
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

/// The flags of a comparison of floats must outlive an interrupt before they are read, whether its handler uses the
/// floating-point unit or not.
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
        let config = BoardConfig {
            reference_core,
            ..BoardConfig::default()
        };
        let mut board = code.board(handler, config);
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
        let config = BoardConfig {
            reference_core,
            ..BoardConfig::default()
        };
        let mut board = code.board(handler, config);
        board.run_until(1_000_000).unwrap();
        assert_eq!(board.read_word(RAM), Some(1));
        assert_eq!(board.read_word(RAM + 16), Some(1));
    }
}
