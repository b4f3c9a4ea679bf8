//! An image file made of the two release images of a board, as `cargo xtask release` makes it.

use boot::header::{Board, Header, Link};
use boot::{Crypto, Slot, Software, slots};
use emulator::{Firmware, programmed};
use object::{Object as _, ObjectSymbol as _, SymbolKind};

/// Version of the new image; the old one is what the robots were flashed with.
pub const NEW: u32 = 0x7F00_0000;

fn elf(variable: &str) -> Vec<u8> {
    let path = std::env::var(variable)
        .unwrap_or_else(|_| panic!("{variable} names a release image; cargo xtask test sets it"));
    std::fs::read(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Robots that take the same file.
#[derive(Clone, Copy, Debug)]
pub struct Robots {
    /// As the header has them.
    pub board: Board,
    /// Variables that name the images for slot A and slot B.
    pub images: [&'static str; 2],
}

pub const REFERENCE: Robots = Robots {
    board: Board::NUCLEO_F446RE,
    images: ["OMNIBUS_ELF", "OMNIBUS_ELF_SLOT_B"],
};

pub const BOARD_C: Robots = Robots {
    board: Board::ROBOMASTER_C,
    images: ["OMNIBUS_ELF_BOARD_C", "OMNIBUS_ELF_BOARD_C_SLOT_B"],
};

/// Reference boards with smart drives. They have no image for slot B: what they refuse, they refuse
/// by its header.
pub const DRIVES: Robots = Robots {
    board: Board::NUCLEO_F446RE_C620,
    images: ["OMNIBUS_ELF_DRIVES", "OMNIBUS_ELF_SLOT_B"],
};

/// Both links of the release image.
pub struct File {
    pub board: Board,
    /// That for slot A, with the boot code.
    pub firmware: Firmware,
    a: Vec<u8>,
    b: Vec<u8>,
    elf_b: Vec<u8>,
    cable: Vec<(u32, Vec<u8>)>,
}

impl File {
    pub fn new(robots: &Robots) -> Self {
        let [a, b] = robots.images.map(elf);
        Self {
            board: robots.board,
            cable: programmed(&a).unwrap(),
            a: image(&a, Slot::A),
            b: image(&b, Slot::B),
            elf_b: b,
            firmware: crate::common::image(robots.images[0]),
        }
    }

    /// Puts code at the beginning of a function of the image for slot B.
    pub fn replace(mut self, function: &str, code: &[u16]) -> Self {
        let at = (self.address(function) - Slot::B.address()) as usize;
        for (nth, half) in code.iter().enumerate() {
            self.b[at + 2 * nth..][..2].copy_from_slice(&half.to_le_bytes());
        }
        self
    }

    /// Where a function is in the image for slot B, which has an order of its own.
    pub fn address(&self, function: &str) -> u32 {
        let file = object::File::parse(&*self.elf_b).unwrap();
        // A mangled name has each part behind its length.
        let part = format!("{}{function}", function.len());
        let is_it = |name: &str| name == function || name.contains(&part);
        let mut symbols = file.symbols().filter(|one| one.kind() == SymbolKind::Text);
        let found = symbols.find(|one| one.name().is_ok_and(is_it));
        found.expect("the function is in the image").address() as u32 & !1
    }

    /// The header and the image for slot B, signed with the development key; `change` may change
    /// the header before.
    pub fn download(&self, change: impl FnOnce(&mut Header)) -> Vec<u8> {
        [&self.header(change)[..], &self.b].concat()
    }

    /// The same with the image for slot A.
    pub fn download_a(&self) -> Vec<u8> {
        [&self.header(|_| ())[..], &self.a].concat()
    }

    /// The header and the shortest image there is: every exception leads to code that sleeps.
    pub fn download_that_sleeps(&self, slot: Slot) -> Vec<u8> {
        const CODE: u32 = slots::SHORTEST_IMAGE - 4;
        let entry = slot.address() + CODE + 1;
        // WFI, and a branch back to it.
        let (stack, code) = (0x2000_1000, 0xE7FD_BF30);
        let vectors = (1..CODE / 4).map(|_| entry);
        let words = std::iter::once(stack).chain(vectors).chain([code]);
        let image: Vec<u8> = words.flat_map(u32::to_le_bytes).collect();
        let header = self.header(|header| match slot {
            Slot::A => header.a = link(&image),
            Slot::B => header.b = link(&image),
        });
        [&header[..], &image].concat()
    }

    /// What a programmer writes: it erases the sectors that it writes to, from the first byte to
    /// the end of the last one.
    pub fn by_cable(&self) -> Vec<(u32, Vec<u8>)> {
        let erased = [
            (slots::BOOT, slots::BOOT_LENGTH),
            (slots::MARK, 0x4000),
            (Slot::A.address(), Slot::A.length()),
        ];
        let erased = erased.map(|(address, length)| (address, vec![0xFF; length as usize]));
        erased.into_iter().chain(self.cable.clone()).collect()
    }

    fn header(&self, change: impl FnOnce(&mut Header)) -> Vec<u8> {
        let mut header = Header {
            board: self.board,
            hardware: boot::release::HARDWARE_REVISION,
            wire_version: protocol::WIRE_VERSION,
            version: NEW,
            security_counter: boot::release::SECURITY_COUNTER,
            a: link(&self.a),
            b: link(&self.b),
        };
        change(&mut header);
        let message = header.to_bytes();
        let signature = boot::sign(&boot::key::DEVELOPMENT_PRIVATE, &message);
        [&message[..], &signature].concat()
    }
}

fn link(image: &[u8]) -> Link {
    let software = Software::default();
    let mut hash = software.begin();
    software.update(&mut hash, image);
    Link {
        length: image.len() as u32,
        hash: software.finish(hash),
    }
}

/// The bytes of a slot in an ELF file, filled up to a word.
fn image(elf: &[u8], slot: Slot) -> Vec<u8> {
    let mut image = Vec::new();
    for (address, part) in programmed(elf).unwrap() {
        if slot.range().contains(&address) {
            let start = (address - slot.address()) as usize;
            let end = start + part.len();
            image.resize(image.len().max(end.next_multiple_of(4)), 0xFF);
            image[start..end].copy_from_slice(&part);
        }
    }
    image
}
