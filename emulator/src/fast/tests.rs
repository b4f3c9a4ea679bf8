//! The fast path against the reference core: random instructions on random registers, one at a
//! time.

use std::sync::Arc;

use super::*;
use crate::address_space;
use crate::board::BoardConfig;
use crate::chip::F446;
use crate::soc::Soc;

/// A small generator of even quality and fixed seed (xorshift64*).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u32 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 32) as u32
    }

    /// One of a number of choices.
    fn of(&mut self, choices: u32) -> u32 {
        self.next() % choices
    }

    /// What a register may hold: an address in the middle of RAM, a small number, anything; never
    /// the address of a peripheral.
    fn value(&mut self) -> u32 {
        match self.of(4) {
            0 | 1 => 0x2000_8000 + self.of(0x1000),
            2 => self.of(0x40),
            _ => self.next() | 0x8000_0000,
        }
    }

    /// Bits of a single-precision number, with the odd ones more frequent than by chance.
    fn float(&mut self) -> u32 {
        match self.of(8) {
            0 => [
                0,
                0x8000_0000,
                0x7F80_0000,
                0x7FC0_0000,
                0x0000_0001,
                0x7F7F_FFFF,
            ][self.of(6) as usize],
            1 => self.next(),
            _ => (self.of(40) as f32 - 20.0 + self.of(1000) as f32 * 1e-3).to_bits(),
        }
    }
}

/// As many 32-bit instructions as 16-bit ones, and among them the FPU's more often than by chance.
fn any(random: &mut Random) -> [u32; 2] {
    let half = match random.of(5) {
        0 | 1 => random.of(0xE800),
        2 => 0xED00 | random.of(0x400),
        _ => 0xE800 + random.of(0x1800),
    };
    let second = match half {
        0xED00..=0xEEFF => random.next() & 0xF0FF | 0x0A00 | random.of(2) << 8,
        _ => random.next(),
    };
    [half, second]
}

/// Encodings of saturation and of the DSP extension that have no operand in the program counter:
/// the fixed bits of both halfwords, and which of the second are free beside the registers'.
const SIGNAL: [[u32; 3]; 19] = [
    [0xFBE0, 0x0060, 0],      // UMAAL
    [0xF300, 0x0000, 0x70DF], // SSAT, shifted left
    [0xF320, 0x0040, 0x709F], // SSAT, shifted right
    [0xF380, 0x0000, 0x70DF], // USAT
    [0xF3A0, 0x0040, 0x709F],
    [0xFA80, 0xF080, 0],      // QADD
    [0xFA80, 0xF090, 0],      // QDADD
    [0xFA80, 0xF0A0, 0],      // QSUB
    [0xFA80, 0xF0B0, 0],      // QDSUB
    [0xFA80, 0xF050, 0],      // UQADD8
    [0xFAC0, 0xF050, 0],      // UQSUB8
    [0xFA00, 0xF080, 0x30],   // SXTAH
    [0xFA10, 0xF080, 0x30],   // UXTAH
    [0xFA40, 0xF080, 0x30],   // SXTAB
    [0xFA50, 0xF080, 0x30],   // UXTAB
    [0xEAC0, 0x0000, 0x70C0], // PKHBT
    [0xEAC0, 0x0020, 0x70C0], // PKHTB
    [0xFB50, 0xF000, 0],      // SMMUL
    [0xFB50, 0xF010, 0],      // SMMULR
];

/// One of those, with registers that differ from SP and PC.
fn signal(random: &mut Random) -> [u32; 2] {
    let [first, second, free] = SIGNAL[random.of(SIGNAL.len() as u32) as usize];
    let [n, m, d, high] = [(); 4].map(|()| random.of(13));
    let second = second | random.next() & free;
    let registers = match first {
        0xFBE0 => high << 12 | ((high + 1) % 13) << 8 | m,
        0xF300..0xF400 => d << 8,
        _ => d << 8 | m,
    };
    [first | n, second | registers]
}

struct Machine {
    flash: Arc<RamStore>,
    ram: Arc<Ram>,
    shared: Arc<Shared>,
    cpu: Arc<ArmV7m>,
}

impl Machine {
    fn new(random: &mut Random, instruction: fn(&mut Random) -> [u32; 2]) -> Self {
        let flash = Arc::new(RamStore::new(F446.flash_size()));
        let mut at = 0;
        while at < F446.flash_size() {
            for half in instruction(random) {
                flash
                    .write_value(at, Width::U16, u64::from(half & 0xFFFF), Endian::Little)
                    .unwrap();
                at += 2;
            }
        }
        let ram = Arc::new(Ram::new(&F446));
        for at in (0..ram.size()).step_by(4) {
            ram.write(at, Width::U32, random.next()).unwrap();
        }
        let shared = Arc::new(Shared::new(
            Soc::new(
                &F446,
                Arc::clone(&flash),
                Arc::clone(&ram),
                &BoardConfig {
                    hse_hz: 0,
                    ..BoardConfig::default()
                },
            ),
            true,
        ));
        let space = address_space::address_space(&F446, &shared, &flash, &ram, [0; 12]).unwrap();
        let cpu = Arc::new(ArmV7m::new(rsemu::cpu::arm::v7m::Config::CORTEX_M4F));
        cpu.attach_space(Arc::new(space));
        cpu.step(); // the reset sequence
        cpu.with_sys(|sys| {
            sys.cpacr = 0x00F0_0000;
            sys.ccr &= !(UNALIGN_TRP | DIV_0_TRP);
        });
        Self {
            flash,
            ram,
            shared,
            cpu,
        }
    }

    fn window(&self) -> Vec<u8> {
        let mut bytes = vec![0; 0x4000];
        self.ram.read_at(0x7000, &mut bytes).unwrap();
        bytes
    }

    fn float_state(&self) -> ([u32; 32], u32) {
        (
            std::array::from_fn(|index| self.cpu.s(index as u8)),
            self.cpu.fpscr(),
        )
    }

    fn set_float_state(&self, (s, fpscr): ([u32; 32], u32)) {
        for (index, value) in s.into_iter().enumerate() {
            self.cpu.set_s(index as u8, value);
        }
        self.cpu.set_fpscr(fpscr);
    }
}

/// Runs random instructions both ways; returns how many the fast path took.
fn compare(seed: u64, rounds: u32, instruction: fn(&mut Random) -> [u32; 2]) -> u32 {
    let mut random = Random(seed);
    let machine = Machine::new(&mut random, instruction);
    let Machine { cpu, shared, .. } = &machine;
    let memory = Memory {
        cpu,
        ram: &machine.ram,
        flash: &machine.flash,
        shared,
    };
    let mut fast = Fast::new(
        Arc::new(Programmed::new(&F446, Vec::new())),
        &Defects::new(&[]),
    );
    let mut instructions = 0;
    for _ in 0..rounds {
        let mut regs = Regs {
            control: FPCA,
            ..Regs::new()
        };
        for register in 0..15 {
            regs.r[register] = random.value();
        }
        regs.r[13] &= !3;
        regs.msp = regs.r[13];
        regs.r[15] = FLASH_BASE + 4 * random.of(F446.flash_size() as u32 / 4 - 2);
        regs.xpsr = xpsr::T | random.next() & (xpsr::N | xpsr::Z | xpsr::C | xpsr::V | xpsr::Q);
        if random.of(3) == 0 {
            // In an IT block: any condition, one to four instructions to come.
            let it = (random.of(15) << 4) | (1 + random.of(15));
            regs.xpsr |= (it >> 2) << 10 | (it & 3) << 25;
        }
        let float = (std::array::from_fn(|_| random.float()), random.of(2) << 4);
        let ram = machine.window();

        cpu.set_regs(regs);
        machine.set_float_state(float);
        // What the test sets, only a step of the reference core could have set.
        fast.forget_floats();
        let (cycles, executed) = fast.run(memory, 0, 1);
        if executed == 0 {
            assert_eq!(cpu.regs(), regs, "left with a trace");
            continue;
        }
        instructions += 1;
        let result = (cpu.regs(), machine.float_state(), machine.window(), cycles);

        cpu.set_regs(regs);
        machine.set_float_state(float);
        machine.ram.write_at(0x7000, &ram).unwrap();
        let cycles = cpu.step();
        let expected = (cpu.regs(), machine.float_state(), machine.window(), cycles);
        let listing = cpu.disassemble(regs.r[15], 1)[0];
        assert!(
            result == expected,
            "{listing}\nbefore {regs}\nfast {} ({})\nslow {} ({})",
            result.0,
            result.3,
            expected.0,
            expected.3
        );
        cpu.with_sys(|sys| sys.cfsr = 0);
    }
    instructions
}

#[test]
fn random_instructions_do_what_the_reference_core_does() {
    let instructions: u32 = [0x0123_4567_89AB_CDEF, 0x9E37_79B9_7F4A_7C15]
        .into_iter()
        .map(|seed| compare(seed, 40_000, any))
        .sum();
    assert!(instructions > 30_000, "only {instructions} were compared");
}

/// All of them are the fast path's: none is left to the slower core.
#[test]
fn saturation_and_signal_instructions_do_what_the_reference_core_does() {
    let rounds = 20_000;
    assert_eq!(compare(0x0123_4567_89AB_CDEF, rounds, signal), rounds);
}
