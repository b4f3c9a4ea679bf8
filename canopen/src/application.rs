//! The device's interface to the application: its objects, and what it does when frames come.
//!
//! The device routes every frame once and calls the application for what concerns it: an object is
//! read when its value is needed and written when it has come, a SYNC is the application's turn
//! between its receive and its transmit PDOs, and frames that are for no service of the device are
//! passed on. All calls happen inside [`Device::on_frame`](crate::Device::on_frame) and
//! [`Device::poll`](crate::Device::poll); what needs the device itself waits until they return, and
//! so do errors to report, except at a SYNC, where [`Errors`] sends them before the PDOs.
//!
//! Values travel as their little-endian bytes. The device answers for the communication objects it
//! knows and asks the application for every other index, so an application may add objects of the
//! 0x1000 range that the device lacks.
//!
//! Two shortcuts, [`rpdo`](Application::rpdo) and [`tpdo`](Application::tpdo), let the
//! application receive or provide a whole PDO at once instead of object by object. They are used
//! only while that PDO has the mapping of the [`Config`](crate::Config); once a master has changed
//! the mapping, the device uses the objects.

use crate::{AbortCode, Errors, Frame, Micros, NmtState, NodeId, RpdoSet, Sink, Storage};

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

/// A SYNC as the application gets it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ReceivedSync {
    /// The counter, if the frame had one.
    pub counter: Option<u8>,
    /// When the frame was received.
    pub at: Micros,
    /// Which RPDOs it applied.
    pub applied: RpdoSet,
}

/// The application of a device: its objects, and its part in the services. Only the objects must be
/// there; everything else does nothing unless it is implemented.
pub trait Application {
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

    /// A SYNC came in. The synchronous RPDOs that were waiting for it have just been written; the
    /// synchronous TPDOs are read when this returns.
    fn on_sync(&mut self, sync: ReceivedSync, errors: &mut Errors<'_>) {
        let _ = (sync, errors);
    }

    /// A frame of receive PDO `number` (1 is 0x1400) came in while OPERATIONAL. `false` says that
    /// it is meant for other devices: this one then ignores it.
    fn on_rpdo(&mut self, number: u8, data: &[u8]) -> bool {
        let _ = (number, data);
        true
    }

    /// Another node, or one with the same number, has sent its heartbeat or boot-up message.
    fn on_heartbeat(&mut self, now: Micros, node: NodeId, state: NmtState) {
        let _ = (now, node, state);
    }

    /// A frame came in that is for no service of this device, except perhaps for a receive PDO:
    /// what other nodes send. `state` is the NMT state of the device.
    fn on_frame(&mut self, now: Micros, frame: &Frame, state: NmtState) {
        let _ = (now, frame, state);
    }

    /// The non-volatile memory behind objects 0x1010 and 0x1011, if there is one.
    fn storage(&mut self) -> Option<&mut dyn Storage> {
        None
    }

    /// What takes the value of this object piece by piece when a client writes it, for values of
    /// more than [`MAX_SDO`](crate::MAX_SDO) bytes; `None` for all others, which
    /// [`write`](Self::write) gets whole.
    fn sink(&mut self, index: u16, sub: u8) -> Option<&mut dyn Sink> {
        let _ = (index, sub);
        None
    }

    /// Whether LSS may give the device another node-ID now, or store it. It is asked only while the
    /// device is not OPERATIONAL; a machine that is still coming to rest says no.
    fn may_change_node(&self) -> bool {
        true
    }

    /// Whether a client may change communication objects now; those that were saved are loaded
    /// without asking.
    fn may_configure(&self) -> bool {
        true
    }

    /// An NMT reset is in progress: bring the objects of that scope back to their power-on values.
    fn reset(&mut self, scope: ResetScope) {
        let _ = scope;
    }
}
