//! Acceptance: whether a board keeps the promises of the documents.
//!
//! Every check measures one figure and compares it with a number that it reads from a document
//! ([`promise`]), so every promise is written once. Level 1 ([`level_one`]) needs a bare board, the
//! wires of [`wires`] and the self-test image, whose objects are in `protocol::self_test`. The
//! procedure is the same for a real board and an emulated one: it uses a [`Bench`], which is a bus
//! and someone who handles wires.
//!
//! Limits: level 1 does not test motors or floors, and on an emulated board it tests the procedure
//! and the firmware, not the chip.

pub mod bench;
pub mod causes;
pub mod check;
pub mod chip;
pub mod covered;
#[cfg(feature = "emulated")]
pub mod emulated;
pub mod hardware;
pub mod level_one;
pub mod node;
pub mod picture;
pub mod promise;
pub mod report;
pub mod wires;

pub use bench::{Bench, Debugger, Image, Reading};
pub use check::{Bound, Check, Outcome};
