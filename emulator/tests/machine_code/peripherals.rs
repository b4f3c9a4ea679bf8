//! Peripherals as instructions and pins see them.

use emulator::{Board, BoardConfig, CanFrame, Change, PinLevel, Port, StopKind};

use super::code::{Code, GPIOA, GPIOB, NVIC_ISER0, RAM, RCC_AHB1ENR, RCC_APB1ENR, RCC_APB2ENR};

#[test]
fn an_unmodelled_register_stops_with_its_name() {
    let mut code = Code::default();
    code.store(RCC_APB1ENR, 1 << 18);
    let at = code.here();
    code.read(0x4000_4800);
    code.branch_to_itself();
    let stop = code
        .board(0, BoardConfig::default())
        .run_until(1_000_000)
        .unwrap_err();
    assert_eq!(
        stop.kind,
        StopKind::Unmodelled {
            what: "USART3_+0x0".to_owned(),
            address: 0x4000_4800,
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
    let (applied, quarter) = duties[duties.len() - 1];
    assert_eq!((zero, quarter), (0.0, 0.25));
    // The period began when the counter was started, a few instructions before the compare value
    // was written.
    assert!(
        (990_000..1_000_400).contains(&(applied - written)),
        "{}",
        applied - written
    );
}
