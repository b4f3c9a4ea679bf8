//! The device's interface to non-volatile memory.
//!
//! The device decides when to save and provides its own objects; the implementation decides where
//! to store the bytes, how they survive a power loss, and what the application saves with them. If
//! saving takes time, return [`StoreProgress::Pending`] and call
//! [`Device::finish_store`](crate::Device::finish_store) when it is done; the SDO client waits.

use crate::{AbortCode, NodeId};

/// Which objects are saved or restored: the sub-index of 0x1010 and 0x1011.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StoreScope {
    /// Sub-index 1: everything that can be saved.
    All,
    /// Sub-index 2: the communication objects, 0x1000 to 0x1FFF.
    Communication,
    /// Sub-index 3: the application's objects.
    Application,
}

impl StoreScope {
    /// Whether the communication objects are among them.
    #[must_use]
    pub const fn has_communication(self) -> bool {
        matches!(self, Self::All | Self::Communication)
    }

    /// Whether the application's objects are among them.
    #[must_use]
    pub const fn has_application(self) -> bool {
        matches!(self, Self::All | Self::Application)
    }
}

/// How far saving or restoring has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StoreProgress {
    /// It is done and will survive a power loss.
    Done,
    /// It has begun; [`Device::finish_store`](crate::Device::finish_store) will report the result.
    Pending,
}

/// Non-volatile memory.
pub trait Storage {
    /// Saves the objects of `scope`. `communication` is the image of the communication objects,
    /// opaque bytes to hand back by [`load`](Self::load); it is empty if they are not in the scope.
    /// After an error the old values must still be there.
    ///
    /// # Errors
    /// [`AbortCode::DeviceState`] if not now, [`AbortCode::Hardware`] if it failed.
    fn save(&mut self, scope: StoreScope, communication: &[u8])
    -> Result<StoreProgress, AbortCode>;

    /// Discards the saved objects of `scope`: from the next reset on the defaults apply. The
    /// objects themselves keep their values until then.
    ///
    /// # Errors
    /// As [`save`](Self::save).
    fn restore(&mut self, scope: StoreScope) -> Result<StoreProgress, AbortCode>;

    /// Writes the image saved last to `out` and returns its length; 0 if there is none.
    fn load(&mut self, out: &mut [u8]) -> usize;

    /// Saves the node-ID a LSS master has given, `None` to be without one. It is
    /// [`Config::node`](crate::Config::node) after the next power-on. The LSS master gets its
    /// answer when it is done.
    ///
    /// # Errors
    /// [`AbortCode::UnsupportedAccess`] if it cannot be saved at all, any other if it failed.
    fn save_node(&mut self, node: Option<NodeId>) -> Result<StoreProgress, AbortCode> {
        let _ = node;
        Err(AbortCode::UnsupportedAccess)
    }
}
