//! The device's interface to values that are too long to be collected.
//!
//! The SDO server passes what a client writes to such an object on as it arrives, in pieces of at
//! most seven bytes, and keeps one piece back, because only the end of a block transfer says how
//! much of it is used. The calls of one transfer are [`begin`](Sink::begin), any number of
//! [`write`](Sink::write), then [`finish`](Sink::finish) or [`cancel`](Sink::cancel). A sink
//! therefore sees a value before it is complete, and has to be able to do without its end.

use crate::{AbortCode, NmtState};

/// Takes the value of one object piece by piece.
pub trait Sink {
    /// A client begins to write the object. `size` is the length it announces, if it does; the
    /// server refuses what turns out to be longer or shorter. `state` is the NMT state of the
    /// device.
    ///
    /// # Errors
    /// Any [`AbortCode`]; no other call follows then.
    fn begin(&mut self, size: Option<u32>, state: NmtState) -> Result<(), AbortCode>;

    /// The next bytes of the value.
    ///
    /// # Errors
    /// Any [`AbortCode`]; [`cancel`](Self::cancel) follows.
    fn write(&mut self, bytes: &[u8]) -> Result<(), AbortCode>;

    /// The value is complete, as long as announced, and its CRC is right if there is one.
    ///
    /// # Errors
    /// Any [`AbortCode`]; [`cancel`](Self::cancel) follows.
    fn finish(&mut self) -> Result<(), AbortCode>;

    /// The transfer has ended without success.
    fn cancel(&mut self);
}
