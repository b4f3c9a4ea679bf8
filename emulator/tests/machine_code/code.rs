//! Programs by hand: instructions one after the other, and the addresses most of them use.

use emulator::{Board, BoardConfig, Firmware};

pub const RCC_AHB1ENR: u32 = 0x4002_3830;
pub const RCC_APB1ENR: u32 = 0x4002_3840;
pub const RCC_APB2ENR: u32 = 0x4002_3844;
pub const GPIOA: u32 = 0x4002_0000;
pub const GPIOB: u32 = 0x4002_0400;
pub const NVIC_ISER0: u32 = 0xE000_E100;

/// Base of the counters that programs keep in RAM.
pub const RAM: u32 = 0x2000_0000;

/// A program as it grows.
#[derive(Default)]
pub struct Code(pub Vec<u16>);

impl Code {
    /// Address of the next instruction.
    pub fn here(&self) -> u32 {
        0x0800_0200 + 2 * self.0.len() as u32
    }

    /// MOVW and MOVT: a register gets a 32-bit value.
    pub fn load(&mut self, register: u16, value: u32) {
        for (opcode, half) in [(0xF240, value & 0xFFFF), (0xF2C0, value >> 16)] {
            let half = half as u16;
            self.0.push(opcode | half >> 12 | (half >> 11 & 1) << 10);
            self.0
                .push((half >> 8 & 7) << 12 | register << 8 | half & 0xFF);
        }
    }

    /// A store of a word to an address; uses r0 and r1.
    pub fn store(&mut self, address: u32, value: u32) {
        self.load(0, address);
        self.load(1, value);
        self.0.push(0x6001); // STR r1, [r0]
    }

    /// A load of a word; into r1.
    pub fn read(&mut self, address: u32) {
        self.load(0, address);
        self.0.push(0x6801); // LDR r1, [r0]
    }

    /// Adds one to a word in RAM.
    pub fn count(&mut self, address: u32) {
        self.read(address);
        self.0.push(0x3101); // ADDS r1, #1
        self.0.push(0x6001); // STR r1, [r0]
    }

    /// So many rounds of a loop; uses r2.
    pub fn wait(&mut self, rounds: u32) {
        self.load(2, rounds);
        let again = self.here();
        self.0.push(0x3A01); // SUBS r2, #1
        let back = (again as i32 - self.here() as i32 - 4) / 2;
        self.0.push(0xD100 | back as u16 & 0xFF); // BNE
    }

    pub fn wait_for_event(&mut self) {
        self.0.push(0xBF20); // WFE
    }

    /// A branch back to an address.
    pub fn branch(&mut self, to: u32) {
        let offset = (to as i32 - self.here() as i32 - 4) / 2;
        self.0.push(0xE000 | offset as u16 & 0x7FF);
    }

    pub fn branch_to_itself(&mut self) {
        self.0.push(0xE7FE);
    }

    pub fn ret(&mut self) {
        self.0.push(0x4770); // BX lr
    }

    /// The image: initial stack pointer, reset at the first instruction, everything else at
    /// `handler`.
    pub fn image(&self, handler: u32) -> Firmware {
        Firmware::from_flash(&self.bytes(handler)).unwrap()
    }

    /// The content of the flash.
    pub fn bytes(&self, handler: u32) -> Vec<u8> {
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
        bytes
    }

    /// A board on which only the reference core executes, or the fast path as well.
    pub fn board_on(&self, reference_core: bool, handler: u32) -> Board {
        let config = BoardConfig {
            reference_core,
            ..BoardConfig::default()
        };
        self.board(handler, config)
    }

    pub fn board(&self, handler: u32, config: BoardConfig) -> Board {
        Board::new(&self.image(handler), config)
    }
}
