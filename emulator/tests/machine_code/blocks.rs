//! Random programs on the fast path and on the reference core: loops, IT blocks, stacks, floats and
//! masked interrupts, interrupted by a timer at every place in turn.

use emulator::{Board, BoardConfig, CoreRegisters};

use super::code::{Code, NVIC_ISER0, RAM, RCC_APB1ENR};

/// What the programs load and store, and the register that points to it.
const DATA: u32 = RAM + 0x1000;
const DATA_REGISTER: u16 = 4;
/// Interrupt of TIM2.
const TIM2: u32 = 28;

/// A small generator of even quality and fixed seed (xorshift64*).
struct Random(u64);

impl Random {
    fn of(&mut self, choices: u16) -> u16 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        ((self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 32) as u32 % u32::from(choices)) as u16
    }

    /// A low register that is not the data register.
    fn low(&mut self) -> u16 {
        [0, 1, 2, 3, 5, 6, 7][usize::from(self.of(7))]
    }
}

/// A 16-bit instruction on low registers without a branch.
fn short(random: &mut Random) -> u16 {
    let (d, n, m) = (random.low(), random.low(), random.low());
    let registers = m << 6 | n << 3 | d;
    let data = DATA_REGISTER << 3 | d;
    match random.of(12) {
        0 => random.of(3) << 11 | random.of(32) << 6 | n << 3 | d, // LSLS, LSRS, ASRS
        1 => 0x1800 | random.of(2) << 9 | registers,               // ADDS, SUBS
        2 => 0x1C00 | random.of(2) << 9 | random.of(8) << 6 | n << 3 | d,
        3 => 0x2000 | d << 8 | random.of(256), // MOVS
        4 => 0x2800 | d << 8 | random.of(8),   // CMP
        5 => 0x3000 | random.of(2) << 11 | d << 8 | random.of(256), // ADDS, SUBS
        6 | 7 => 0x4000 | random.of(16) << 6 | n << 3 | d,
        8 => 0x6000 | random.of(2) << 11 | random.of(32) << 6 | data, // STR, LDR
        9 => 0x7000 | random.of(2) << 11 | random.of(32) << 6 | data, // STRB, LDRB
        10 => 0x8000 | random.of(2) << 11 | random.of(32) << 6 | data, // STRH, LDRH
        _ => 0xB200 | random.of(4) << 6 | n << 3 | d,                 // SXTH to UXTB
    }
}

/// One instruction, or a few that belong together.
fn piece(code: &mut Vec<u16>, random: &mut Random) {
    let (d, n, m) = (random.low(), random.low(), random.low());
    match random.of(16) {
        0 => {
            // An IT block of one to four, each then or else.
            let cond = random.of(14);
            let length = 1 + random.of(4);
            let stop = 1 << (4 - length);
            let mask = random.of(16) & !(2 * stop - 1) | stop;
            code.push(0xBF00 | cond << 4 | mask);
            code.extend((0..length).map(|_| short(random)));
        }
        1 => {
            // A branch over the next one.
            code.push(0xD000 | random.of(14) << 8);
            code.push(short(random));
        }
        2 => {
            code.push(0xB100 | random.of(2) << 11 | d); // CBZ, CBNZ
            code.push(short(random));
        }
        3 => {
            let list = 1 | random.of(256) & 0xEF;
            code.push(0xB400 | list); // PUSH
            code.push(short(random));
            code.push(0xBC00 | list); // POP
        }
        4 => code.extend([0xB672, short(random), short(random), 0xB662]), // CPSID i, CPSIE i
        5 => {
            code.extend([0xF3EF, 0x8310, 0xB672]); // MRS r3, PRIMASK; CPSID i
            code.push(0x6000 | DATA_REGISTER << 3 | d);
            code.extend([0xF383, 0x8810]); // MSR PRIMASK, r3
        }
        6 => code.extend([0xFB00 | n, 0xF000 | d << 8 | m]), // MUL
        7 => code.extend([0xFBA0 | n, d << 12 | 6 << 8 | m]), // UMULL
        8 => code.extend([0xF3C0 | n, random.of(4) << 12 | d << 8 | random.of(16)]), // UBFX
        9 => code.extend([
            0xE9C0 | random.of(2) << 4 | DATA_REGISTER,
            d << 12 | 7 << 8 | random.of(64),
        ]),
        10 => code.extend([
            0xED80 | random.of(2) << 4 | DATA_REGISTER,
            random.of(8) << 12 | 0x0A00 | random.of(32),
        ]),
        11 => {
            // VADD, VSUB, VMUL, VMLA, VDIV.
            let (op, sub) =
                [(0x30, 0), (0x30, 0x40), (0x20, 0), (0, 0), (0x80, 0)][usize::from(random.of(5))];
            code.extend([
                0xEE00 | op | random.of(4),
                random.of(4) << 12 | 0x0A00 | sub | random.of(4),
            ]);
        }
        12 => code.extend([
            0xEEB4,
            random.of(4) << 12 | 0x0A40 | random.of(4),
            0xEEF1,
            0xFA10,
        ]), // VCMP, VMRS
        _ => code.push(short(random)),
    }
}

/// A program without end; and its interrupt handler.
fn program(seed: u64) -> (Code, u32) {
    let mut random = Random(seed);
    let mut code = Code::default();
    code.store(0xE000_ED88, 0xF << 20); // CPACR: the floating-point unit is on
    code.store(0x4002_3C00, 0x705); // FLASH_ACR: five wait states, prefetch, caches
    code.store(RCC_APB1ENR, 1);
    code.store(0x4000_002C, 210 + u32::from(random.of(100))); // ARR
    code.store(0x4000_000C, 1); // DIER.UIE
    code.store(NVIC_ISER0, 1 << TIM2);
    code.load(DATA_REGISTER, DATA);
    for register in [0, 1, 2, 3, 5, 6, 7] {
        code.load(register, u32::from(random.of(u16::MAX)) << random.of(17));
    }
    code.0.extend([0xEE00, 0x1A10]); // VMOV s0, r1
    code.store(0x4000_0000, 1); // CR1.CEN
    let again = code.here();
    for _ in 0..250 {
        piece(&mut code.0, &mut random);
    }
    code.branch(again);
    let handler = code.here();
    code.store(0x4000_0010, 0); // SR
    code.count(RAM);
    code.ret();
    (code, handler)
}

/// What can be seen of a board.
fn seen(board: &Board) -> (CoreRegisters, (u64, u64), u64, Vec<u8>) {
    let mut ram = vec![0; 0x5000];
    board.read_memory(RAM, &mut ram).unwrap();
    (board.registers(), board.cycles(), board.instructions(), ram)
}

/// Runs two boards side by side, in pieces of any length; the interrupts that came.
fn side_by_side(seed: u64, mut one: Board, mut other: Board) -> u32 {
    let mut random = Random(seed);
    let mut t = 0;
    while t < 3_000_000 {
        t += 1 + u64::from(random.of(20_000));
        one.run_until(t).unwrap();
        other.run_until(t).unwrap();
        assert_eq!(one.now_ns(), other.now_ns());
        let (first, second) = (seen(&one), seen(&other));
        assert!(
            first == second,
            "seed {seed} at {t} ns: {:x?}\n{:x?}",
            (first.0, first.1),
            (second.0, second.1)
        );
    }
    one.read_word(RAM).unwrap()
}

#[test]
fn random_programs_run_as_on_the_reference_core() {
    for seed in 1..=24 {
        let (code, handler) = program(seed);
        let board = |reference_core| {
            let config = BoardConfig {
                reference_core,
                // What the reference core reads from flash it does not tell.
                ideal_flash: true,
                ..BoardConfig::default()
            };
            code.board(handler, config)
        };
        let interrupts = side_by_side(seed, board(false), board(true));
        assert!(interrupts > 100, "{interrupts} interrupts");
    }
}

/// Breakpoints make the board look at every instruction. What it waits for the flash must not
/// depend on that.
#[test]
fn random_programs_run_the_same_instruction_by_instruction() {
    for seed in 101..=112 {
        let (code, handler) = program(seed);
        let whole = code.board(handler, BoardConfig::default());
        let mut stepped = code.board(handler, BoardConfig::default());
        stepped.add_breakpoint(0x0804_0000);
        side_by_side(seed, whole, stepped);
    }
}

/// A loop counts with what an instruction in it says, which the program changes in flash while it
/// runs.
#[test]
fn an_instruction_that_is_programmed_anew_is_executed_anew() {
    for reference_core in [false, true] {
        let mut code = Code::default();
        code.store(0x4002_3C04, 0x4567_0123); // FLASH_KEYR
        code.store(0x4002_3C04, 0xCDEF_89AB);
        code.store(0x4002_3C10, 1 << 8 | 1); // FLASH_CR: PG, halfwords
        code.load(4, RAM + 16);
        code.0.push(0x2500); // MOVS r5, #0
        let again = code.here();
        let changed = code.here();
        code.0.push(0x23FF); // MOVS r3, #255, later #1
        code.0.push(0x6023); // STR r3, [r4]
        code.0.push(0x6065); // STR r5, [r4, #4]
        code.0.push(0x3501); // ADDS r5, #1
        code.0.push(0x2D64); // CMP r5, #100
        code.0.push(0xD108); // BNE to the branch
        code.load(0, changed);
        code.load(1, 0x2301);
        code.0.push(0x8001); // STRH r1, [r0]
        code.branch(again);
        let mut board = code.board_on(reference_core, 0);
        board.run_until(30_000).unwrap();
        assert_eq!(board.read_word(RAM + 16), Some(255), "before");
        assert!(board.read_word(RAM + 20).unwrap() < 100);
        board.run_until(2_000_000).unwrap();
        assert!(board.read_word(RAM + 20).unwrap() > 100);
        assert_eq!(board.read_word(RAM + 16), Some(1), "after");
    }
}
