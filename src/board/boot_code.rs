//! The boot code in the image.
//!
//! An image for slot A has the boot code (`boot/code/`, which `build.rs` builds) and the mark of
//! the cable with it, so that one file is all that a programmer writes. An image for slot B has
//! neither: it comes over the bus, to a robot that has them.

#![expect(unsafe_code, reason = "sections by name")]

/// The boot code, at the start of flash.
#[used]
#[unsafe(link_section = ".boot")]
static CODE: [u8; include_bytes!(concat!(env!("OUT_DIR"), "/boot.bin")).len()] =
    *include_bytes!(concat!(env!("OUT_DIR"), "/boot.bin"));

/// Says that slot A was written by cable. Writing it erases what was there of earlier updates.
#[used]
#[unsafe(link_section = ".boot_mark")]
static MARK: u32 = boot::records::CABLE;
