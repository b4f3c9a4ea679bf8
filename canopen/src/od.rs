//! The device's interface to the application: its part of the object dictionary.
//!
//! Values travel as their little-endian bytes. The device answers for the communication objects it
//! knows and asks the application for every other index, so an application may add objects of the
//! 0x1000 range that the device lacks.
//!
//! Two shortcuts, [`rpdo`](ObjectDictionary::rpdo) and [`tpdo`](ObjectDictionary::tpdo), let the
//! application receive or provide a whole PDO at once instead of object by object. They are used
//! only while that PDO has the mapping of the [`Config`](crate::Config); once a master has changed
//! the mapping, the device uses the objects.

use crate::{AbortCode, NmtState, Storage};

/// Which way a PDO carries its objects.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PdoDirection {
    /// Into the device: the object is written.
    Receive,
    /// Out of the device: the object is read.
    Transmit,
}

/// Which parts of the application an NMT reset restarts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ResetScope {
    /// Reset communication: only 0x1000 to 0x1FFF go back to their power-on values.
    Communication,
    /// Reset node: all objects go back to their power-on values.
    Application,
}

/// The application's objects.
pub trait ObjectDictionary {
    /// Writes the value of an object to the front of `out` and returns its length in bytes.
    ///
    /// # Errors
    /// [`AbortCode::NoObject`], [`AbortCode::NoSubIndex`], [`AbortCode::WriteOnly`], or
    /// [`AbortCode::OutOfMemory`] if `out` is too short.
    fn read(&self, index: u16, sub: u8, out: &mut [u8]) -> Result<usize, AbortCode>;

    /// Checks a value completely, then sets the object; after an error nothing has changed.
    /// `state` is the NMT state of the device, for objects that must not change while operational.
    ///
    /// # Errors
    /// Whatever [`AbortCode`] says why not, among them [`AbortCode::TooLong`],
    /// [`AbortCode::TooShort`], [`AbortCode::ValueTooHigh`] and [`AbortCode::DeviceState`].
    fn write(&mut self, index: u16, sub: u8, data: &[u8], state: NmtState)
    -> Result<(), AbortCode>;

    /// The length in bits of an object that may be mapped into a PDO of this direction; a multiple
    /// of 8.
    ///
    /// # Errors
    /// [`AbortCode::NotMappable`], or [`AbortCode::NoObject`] or [`AbortCode::NoSubIndex`] if it
    /// does not exist.
    fn mappable(&self, index: u16, sub: u8, direction: PdoDirection) -> Result<u8, AbortCode> {
        let _ = (index, sub, direction);
        Err(AbortCode::NotMappable)
    }

    /// Takes the whole content of receive PDO `number` (1 is 0x1400) as mapped by default; returns
    /// whether it did. If not, every mapped object is written on its own.
    fn rpdo(&mut self, number: u8, data: &[u8]) -> bool {
        let _ = (number, data);
        false
    }

    /// Fills transmit PDO `number` (1 is 0x1800) as mapped by default and returns its length in
    /// bytes, or `None` to have every mapped object read on its own.
    fn tpdo(&self, number: u8, out: &mut [u8; 8]) -> Option<usize> {
        let _ = (number, out);
        None
    }

    /// The non-volatile memory behind objects 0x1010 and 0x1011, if there is one.
    fn storage(&mut self) -> Option<&mut dyn Storage> {
        None
    }

    /// Whether LSS may give the device another node-ID now, or store it. It is asked only while the
    /// device is not OPERATIONAL; a machine that is still coming to rest says no.
    fn may_change_node(&self) -> bool {
        true
    }

    /// An NMT reset is in progress: bring the objects of that scope back to their power-on values.
    fn reset(&mut self, scope: ResetScope) {
        let _ = scope;
    }
}
