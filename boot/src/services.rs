//! Functions of the boot code that an image may call: a table at a fixed address.
//!
//! Nearly all of the boot code's 11 KB are for signatures. Sector 0 has room for them, so they are
//! in flash once and not in either slot. The functions use the caller's stack, some 3 KB, and no
//! other RAM; the state of a hash is in the caller's memory.
//!
//! A caller guarantees that every pointer is valid for the call, aligned, and unchanged by others;
//! that `update` and `finish` get memory which `begin` has written; and that this memory is not
//! used as a hash after `finish`. `program_flash` of the firmware is the only caller, and its safe
//! functions keep these promises.

/// Where the table is: behind the processor's sixteen vectors.
pub const ADDRESS: u32 = crate::slots::BOOT + 0x40;

/// First word of the table; the last byte is its version.
pub const MAGIC: u32 = u32::from_le_bytes(*b"OMB\x01");

/// Memory for a hash under way.
#[derive(Debug)]
#[repr(C, align(8))]
pub struct HashMemory(pub [u8; HASH_BYTES]);

/// Bytes of it.
pub const HASH_BYTES: usize = 224;

/// The table.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Services {
    /// [`MAGIC`].
    pub magic: u32,
    /// Begins a hash in this memory.
    pub begin: unsafe extern "C" fn(*mut HashMemory),
    /// Goes on with the hash over so many bytes at an address.
    pub update: unsafe extern "C" fn(*mut HashMemory, *const u8, usize),
    /// Ends the hash and writes it.
    pub finish: unsafe extern "C" fn(*mut HashMemory, *mut [u8; 64]),
    /// Whether a message, so many bytes at an address, has this signature: 1 or 0.
    pub is_signed: unsafe extern "C" fn(*const u8, usize, *const [u8; 64]) -> u32,
    /// Whether it is checked with the development key: 1 or 0.
    pub is_development: u32,
}
