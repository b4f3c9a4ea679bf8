//! A request to stop, from another thread or a signal: once means ramp down, twice means at once.
//!
//! The session checks it once per SYNC period. "At once" still goes by the robots' own rules: they
//! are taken out of OPERATIONAL while they may be moving, which cuts their drivers.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use crate::error::MasterError;

/// A wish to stop that can be shared between threads.
#[derive(Clone, Debug, Default)]
pub struct Abort(Arc<AtomicU32>);

impl Abort {
    /// Wishes to stop, once more.
    pub fn ask(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// Takes the wish back, once it has been fulfilled.
    pub fn forget(&self) {
        self.0.store(0, Ordering::Relaxed);
    }

    /// Whether the group shall ramp down.
    #[must_use]
    pub fn is_asked(&self) -> bool {
        self.0.load(Ordering::Relaxed) > 0
    }

    /// Ends with an error what shall be stopped.
    ///
    /// # Errors
    /// [`MasterError::Aborted`] when it is asked for.
    pub fn check(&self) -> Result<(), MasterError> {
        if self.is_asked() {
            Err(MasterError::Aborted)
        } else {
            Ok(())
        }
    }

    /// Whether the group shall stop at once.
    #[must_use]
    pub fn is_urgent(&self) -> bool {
        self.0.load(Ordering::Relaxed) > 1
    }
}
