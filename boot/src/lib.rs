//! Two images in flash, the choice between them, and the file format of a new one.
//!
//! # Theory of operation
//!
//! Flash holds two [slots], and a program runs where it lies. An update writes the slot that is not
//! running, checks what it has written and [seals](records) it. A sealed image is started on trial;
//! it confirms itself when it has shown that it works, and otherwise the boot code goes back to the
//! other one. The state of a slot is written at its end, word by word and never over an earlier
//! word. So erasing a slot erases its state, and a loss of power between any two words leaves a
//! valid state.
//!
//! A [file](header) has one signed header and the image linked for either slot.
//!
//! # Interface
//!
//! Flash is the trait [`Flash`]; signatures and hashes are the trait [`Crypto`]. A robot's program
//! calls, in this order, [`Header::parse`](header::Header::parse),
//! [`Header::is_signed`](header::Header::is_signed) and [`Header::admit`](header::Header::admit)
//! for what it receives first; [`records::may_be_replaced`], [`Flash::erase`] for the sectors of
//! the slot, the one with the tail first, and [`records::begin`]; the image's words;
//! [`records::seal`], once the hash is right; [`records::request_trial`] and a reset. After it,
//! [`records::confirm`].
//!
//! # Limits
//!
//! The boot code does not check signatures at a start, only the checksum of an image whose
//! signature was checked when it was received. Anyone who can write flash with a debugger can run
//! anything.
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::unreachable,
        clippy::indexing_slicing,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )
)]

mod checksum;
mod crypto;
pub mod header;
pub mod key;
pub mod records;
pub mod release;
pub mod services;
pub mod slots;
#[cfg(feature = "software")]
mod software;

pub use checksum::Checksum;
pub use crypto::Crypto;
pub use records::{Flash, FlashError};
pub use slots::Slot;
#[cfg(feature = "software")]
pub use software::{Software, public_key, sign};
