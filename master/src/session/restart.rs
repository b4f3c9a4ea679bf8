//! Members that may have lost their parameters.
//!
//! A robot that was switched off and on comes back with the parameters of its flash, which may be
//! those of an older group file, and robots with different ones pull at one load. So
//! [`Group::start`] configures all robots again, with the compensation that they had, before it
//! moves the group when
//!
//! - the boot-up message of a member was received,
//! - a member was missing, or silent for longer than [`SILENCE_US`]: its boot-up may be lost, or
//! - another master drove the robots.
//!
//! Values that another program writes into a standing robot, as `omnibus param set` does, are not
//! noticed.

use canopen::{Micros, NmtState};

use super::{Configured, Group};
use crate::bus::link::Link;
use crate::error::MasterError;
use crate::monitor::telemetry::EventKind;

/// A member without a heartbeat for so long, in µs, may have restarted; it sends one every 100 ms.
const SILENCE_US: u64 = 1_000_000;

impl<L: Link> Group<L> {
    /// Notes what a heartbeat says about a restart; `before` is when the member was received last.
    pub(super) fn note_restart(
        &mut self,
        node: u8,
        state: NmtState,
        at: Micros,
        before: Option<Micros>,
    ) {
        if state == NmtState::Initialising {
            self.restarted = Some(node);
            self.doubt_configuration();
        } else if before.is_some_and(|before| at.0 > before.0 + SILENCE_US) {
            self.doubt_configuration();
        }
    }

    /// Members may have other parameters than those of the file from now on.
    pub(super) fn doubt_configuration(&mut self) {
        if self.configured == Configured::Whole {
            self.configured = Configured::Doubtful;
        }
    }

    /// Writes the group file into the robots where they have not got it in this session, or may
    /// have lost it. The robots stand: a session that does not run has stopped them, and those that
    /// it lost have stopped by themselves.
    pub(super) fn ensure_configured(&mut self) -> Result<(), MasterError> {
        // A boot-up may still be waiting.
        self.listen(self.wire.now())?;
        match self.configured {
            Configured::Whole => Ok(()),
            Configured::Never => self.configure(true),
            Configured::Doubtful => {
                let restarted = self.restarted;
                // A robot that was away may still be booting, and may be another one.
                self.find_members()?;
                self.configure(self.compensation)?;
                self.publish(restarted, EventKind::ConfiguredAgain);
                Ok(())
            }
        }
    }

    /// As [`Group::start`], for motions that are evaluated by the rollers' angles: a robot that
    /// knew them and has restarted does not know them any more.
    ///
    /// # Errors
    /// [`MasterError::RollersLost`] then, and as [`Group::start`].
    #[cfg(feature = "calibration")]
    pub(crate) fn start_measuring(&mut self) -> Result<(), MasterError> {
        self.listen(self.wire.now())?;
        if self.configured == Configured::Doubtful {
            self.ensure_configured()?;
            if let Some((node, ..)) = self.unreferenced_wheel()? {
                return Err(MasterError::RollersLost { node });
            }
        }
        self.start()
    }

    /// An error of a drive, or the restart of a member that explains it.
    #[cfg(feature = "calibration")]
    pub(crate) fn explained(&self, error: MasterError) -> MasterError {
        let Some(restarted) = self.restarted else {
            return error;
        };
        let explains = match error.cause() {
            MasterError::MemberMissing { node, .. }
            | MasterError::MemberLeft { node, .. }
            | MasterError::NodeSilent { node } => *node == restarted,
            MasterError::MemberFault { fault, .. } => fault.is_consequence(),
            MasterError::MembersMissing { .. } => true,
            _ => false,
        };
        if explains {
            MasterError::MemberRestarted { node: restarted }
        } else {
            error
        }
    }
}
