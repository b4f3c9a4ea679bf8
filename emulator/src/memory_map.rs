//! Where memory begins for the processor (RM0390 2.2.2).

/// First address of flash.
pub(crate) const FLASH_BASE: u32 = 0x0800_0000;

/// First address of RAM.
pub(crate) const RAM_BASE: u32 = 0x2000_0000;
