//! Handlers that meet in every way, on the fast path and on the reference core.

use emulator::BoardConfig;

use super::code::{Code, NVIC_ISER0, RAM, RCC_APB1ENR};

const TIM2: u32 = 0x4000_0000;
const TIM3: u32 = 0x4000_0400;
/// The words that the program counts in: its rounds, the same as a float, and from here on the
/// calls of handlers by exception number.
const CALLS: u32 = RAM + 0x100;
const TIM2_EXCEPTION: u32 = 44;
const TIM3_EXCEPTION: u32 = 45;

/// What a program does.
#[derive(Debug, Clone, Copy)]
struct Kind {
    /// The program computes with floats, and handlers do.
    floats: [bool; 2],
    /// How handlers begin and end.
    frame: Frame,
    /// The program has a stack of its own.
    process_stack: bool,
    /// The timers have one priority, so that a handler waits for the other one's end.
    one_priority: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Frame {
    /// Nothing is saved; BX lr.
    None,
    /// PUSH {r4, lr} and POP {r4, pc}.
    Even,
    /// The same with r5, so that the next frame has to be aligned.
    Odd,
}

/// Counts rounds until it is interrupted by timers of 97 and 61 clocks times eleven.
fn program(kind: Kind) -> (Code, u32) {
    let mut code = Code::default();
    code.store(0xE000_ED88, 0xF << 20); // CPACR: the unit is on
    code.store(RCC_APB1ENR, 3);
    let urgency = if kind.one_priority { 0x80 } else { 0x40 };
    code.store(0xE000_E41C, urgency << 8 | 0x80); // NVIC_IPR7
    code.store(NVIC_ISER0, 3 << 28);
    for (timer, clocks) in [(TIM2, 97 * 11), (TIM3, 61 * 11)] {
        code.store(timer + 0x2C, clocks - 1); // ARR
        code.store(timer + 0xC, 1); // DIER.UIE
        code.store(timer, 1); // CR1.CEN
    }
    if kind.process_stack {
        code.load(0, RAM + 0x2000);
        code.0.extend([0xF380, 0x8809]); // MSR PSP, r0
        code.0.push(0x2002); // MOVS r0, #2
        code.0.extend([0xF380, 0x8814]); // MSR CONTROL, r0
    }
    code.load(4, RAM);
    code.0.extend([0x2500, 0x2600]); // MOVS r5, #0; MOVS r6, #0
    if kind.floats[0] {
        code.0.extend([0xEE01, 0x5A10]); // VMOV s2, r5
        code.0.extend([0xEEF7, 0x1A00]); // VMOV.F32 s3, #1.0
    }
    let round = code.here();
    code.0.push(0x3501); // ADDS r5, #1
    code.0.push(0x6025); // STR r5, [r4]
    code.0.push(0xB440); // PUSH {r6}
    if kind.floats[0] {
        code.0.extend([0xEE31, 0x1A21]); // VADD.F32 s2, s2, s3
        code.0.extend([0xED84, 0x1A01]); // VSTR s2, [r4, #4]
    }
    code.0.push(0xBC40); // POP {r6}
    code.branch(round);

    let handler = code.here();
    match kind.frame {
        Frame::None => {}
        Frame::Even => code.0.push(0xB510),
        Frame::Odd => code.0.push(0xB530),
    }
    code.0.extend([0xF3EF, 0x8205]); // MRS r2, IPSR
    code.load(0, TIM2);
    code.0.extend([0xF1A2, 0x032C]); // SUB r3, r2, #44
    code.0.push(0x029B); // LSLS r3, r3, #10
    code.0.push(0x18C0); // ADDS r0, r0, r3
    code.0.push(0x2100); // MOVS r1, #0
    code.0.push(0x6101); // STR r1, [r0, #16]: the timer's SR
    if kind.floats[1] {
        code.0.extend([0xEE00, 0x2A10]); // VMOV s0, r2
        code.0.extend([0xEEB5, 0x0A40]); // VCMP.F32 s0, #0
        code.0.extend([0xEEB0, 0x1A40]); // VMOV.F32 s2, s0
    }
    code.load(0, CALLS);
    code.0.extend([0xF850, 0x1022]); // LDR r1, [r0, r2, LSL #2]
    code.0.push(0x3101); // ADDS r1, #1
    code.0.extend([0xF840, 0x1022]); // STR r1, [r0, r2, LSL #2]
    code.wait(40);
    match kind.frame {
        Frame::None => code.ret(),
        Frame::Even => code.0.push(0xBD10),
        Frame::Odd => code.0.push(0xBD30),
    }
    (code, handler)
}

#[test]
fn handlers_meet_alike_on_the_fast_path_and_the_reference_core() {
    let both = [false, true];
    let kinds = both.into_iter().flat_map(|own| {
        let frames = [Frame::None, Frame::Even, Frame::Odd];
        frames.into_iter().flat_map(move |frame| {
            (0..8).map(move |bits| Kind {
                floats: [own, bits & 1 != 0],
                frame,
                process_stack: bits & 2 != 0,
                one_priority: bits & 4 != 0,
            })
        })
    });
    for kind in kinds {
        let (code, handler) = program(kind);
        let run = |reference_core| {
            let config = BoardConfig {
                reference_core,
                ..BoardConfig::default()
            };
            let mut board = code.board(handler, config);
            board.run_until(20_000_000).unwrap();
            let mut ram = vec![0; 128 * 1024];
            board.read_memory(RAM, &mut ram).unwrap();
            (board.cycles(), board.instructions(), ram)
        };
        let (fast, reference) = (run(false), run(true));
        assert_eq!((fast.0, fast.1), (reference.0, reference.1), "{kind:?}");
        assert!(fast.2 == reference.2, "{kind:?}: memory differs");

        let word = |address: u32| {
            let at = (address - RAM) as usize;
            u32::from_le_bytes(fast.2[at..at + 4].try_into().unwrap())
        };
        // 20 ms are 320 000 clocks: 299 and 476 periods, but for what the set-up takes.
        let calls = [TIM2_EXCEPTION, TIM3_EXCEPTION].map(|number| word(CALLS + 4 * number));
        assert!(
            (298..=299).contains(&calls[0]) && (475..=476).contains(&calls[1]),
            "{kind:?}: {calls:?}"
        );
        let rounds = word(RAM);
        assert!(rounds > 1_000, "{kind:?}: {rounds}");
        if kind.floats[0] {
            // What a handler does to s2 is not seen outside of it.
            let counted = f32::from_bits(word(RAM + 4));
            assert!(
                counted == rounds as f32 || counted == (rounds - 1) as f32,
                "{kind:?}: {counted} of {rounds}"
            );
        }
    }
}

/// A return to a handler where none was interrupted, by codes that do not exist, and to a process
/// stack without a frame: the handler of the fault is entered.
#[test]
fn a_return_without_what_it_names_faults() {
    for code_of_return in [0xFFFF_FFF1_u32, 0xFFFF_FFF5, 0xFFFF_FFE5, 0xFFFF_FFFD] {
        let [fast, reference] = [false, true].map(|reference_core| {
            let mut code = Code::default();
            code.store(NVIC_ISER0, 1 << 28);
            code.store(0xE000_E200, 1 << 28); // NVIC_ISPR0
            code.branch_to_itself();
            let handler = code.here();
            code.0.extend([0xF3EF, 0x8205]); // MRS r2, IPSR
            code.load(0, CALLS);
            code.0.extend([0xF850, 0x1022]); // LDR r1, [r0, r2, LSL #2]
            code.0.push(0x3101); // ADDS r1, #1
            code.0.extend([0xF840, 0x1022]); // STR r1, [r0, r2, LSL #2]
            code.0.push(0x2A03); // CMP r2, #3: the fault's handler stays
            code.0.push(0xD0FE); // BEQ to itself
            code.load(14, code_of_return);
            code.ret();
            let mut board = code.board_on(reference_core, handler);
            board.run_until(1_000_000).unwrap();
            let calls = [3, TIM2_EXCEPTION].map(|number| board.read_word(CALLS + 4 * number));
            (board.cycles(), calls)
        });
        assert_eq!(fast, reference, "{code_of_return:#x}");
        assert_eq!(fast.1, [Some(1); 2], "{code_of_return:#x}");
    }
}

/// An interrupt whose line is still up when its handler ends is taken again without a return.
#[test]
fn a_line_that_stays_up_calls_its_handler_again() {
    let [fast, reference] = [false, true].map(|reference_core| {
        let mut code = Code::default();
        code.store(RCC_APB1ENR, 1);
        code.store(TIM2 + 0x2C, 999); // ARR
        code.store(TIM2 + 0xC, 1); // DIER.UIE
        code.store(NVIC_ISER0, 1 << 28);
        code.store(TIM2, 9); // CR1: CEN, one period
        code.load(4, RAM);
        code.0.extend([0x2500, 0x3501, 0x6065]); // MOVS r5, #0; ADDS r5, #1; STR r5, [r4, #4]
        code.branch(code.here() - 4);
        let handler = code.here();
        code.count(RAM);
        code.0.push(0x2903); // CMP r1, #3
        code.0.push(0xD100); // BNE over the next
        code.0.push(0xE000); // B over the next
        code.ret();
        code.store(TIM2 + 0x10, 0); // SR
        code.ret();
        let mut board = code.board_on(reference_core, handler);
        board.run_until(1_000_000).unwrap();
        [RAM, RAM + 4].map(|address| board.read_word(address))
    });
    assert_eq!(fast, reference);
    assert_eq!(fast[0], Some(3));
}

/// ICSR says which exception is active and which waits (ARMv7-M ARM, table B3-12); STIR makes one
/// wait.
#[test]
fn the_core_says_which_exceptions_are_active_and_pending() {
    const ICSR: u32 = 0xE000_ED04;
    for reference_core in [false, true] {
        let mut code = Code::default();
        code.store(0xE000_E41C, 0x4080); // NVIC_IPR7: interrupt 29 before 28
        code.store(NVIC_ISER0, 3 << 28);
        code.load(4, RAM);
        code.load(5, ICSR);
        code.load(6, 0xE000_EF00); // STIR
        code.0.extend([0x6828, 0x6020]); // LDR r0, [r5]; STR r0, [r4]
        code.0.extend([0x201D, 0x6030]); // MOVS r0, #29; STR r0, [r6]: the handler runs
        code.branch_to_itself();
        let handler = code.here();
        code.0.extend([0x6828, 0x6060]); // LDR r0, [r5]; STR r0, [r4, #4]
        code.0.extend([0x201C, 0x6030]); // MOVS r0, #28; STR r0, [r6]: not yet
        code.0.extend([0xF8D5, 0x0000, 0x60A0]); // LDR.W r0, [r5]; STR r0, [r4, #8]
        code.0.extend([0x7828, 0x7320]); // LDRB r0, [r5]; STRB r0, [r4, #12]
        code.0.extend([0x2000, 0x2800]); // MOVS r0, #0; CMP r0, #0: equal
        code.0.extend([0xBF18, 0x7828, 0x6120]); // IT NE; LDRBNE r0, [r5]; STR r0, [r4, #16]
        code.branch_to_itself();
        let mut board = code.board_on(reference_core, handler);
        board.run_until(1_000_000).unwrap();
        let words = [0, 4, 8, 12, 16].map(|at| board.read_word(RAM + at).unwrap());
        // RETTOBASE (bit 11) is not defined in thread mode.
        assert_eq!(words[0] & !(1 << 11), 0);
        let active = TIM3_EXCEPTION | 1 << 11;
        let pending = TIM2_EXCEPTION << 12 | 1 << 22;
        assert_eq!(words[1..], [active, active | pending, TIM3_EXCEPTION, 0]);
    }
}
