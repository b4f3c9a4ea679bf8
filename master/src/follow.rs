//! Driving a curve: one setpoint per SYNC, sent ahead of the time it is for.
//!
//! The way of a setpoint is known. Sent before SYNC k, it is latched there, is in force a fixed time
//! after SYNC k + 1, and members pass to it evenly over one period, so that it is reached that time
//! after SYNC k + 2 ([`preview_us`]). The setpoint sent before SYNC k is therefore the curve's at
//! that later time, and the group is where the curve says without any lag that could have been foreseen. What
//! is left (motors, wheel loops, rounding to 0.1 mm/s) shows in the tracking error.

use kinematics::{Pose, Twist};

use crate::curve::Plan;
use crate::error::MasterError;
use crate::link::Link;
use crate::session::Group;

/// SYNC periods from latching a setpoint to its being reached.
const PREVIEW_SYNCS: u64 = 2;
/// Longest time a group may take to come to rest after the curve's end, in µs.
const STOP_PATIENCE_US: u64 = 3_000_000;
/// How long the group is watched after the curve's end, in s: the pipeline's delay and a little more.
const TAIL: f64 = 0.1;

/// Time from the SYNC that latches a setpoint to its being reached, for a SYNC period, both in µs.
#[must_use]
pub const fn preview_us(period_us: u64) -> u64 {
    PREVIEW_SYNCS * period_us + protocol::APPLY_DELAY_US
}

/// What the curve asks for at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instant {
    /// Time since the start of the curve, in s.
    pub t: f64,
    /// Place of this SYNC's row in the recorder.
    pub row: usize,
    /// Duration of the curve, in s.
    pub duration: f64,
    /// Pose asked for, world frame of the curve.
    pub pose: Pose,
    /// Twist asked for, world frame of the curve.
    pub twist: Twist,
}

impl<L: Link> Group<'_, L> {
    /// Drives `plan` from rest to rest; call [`Group::start`] before. `observe` is called at every
    /// SYNC, at the time of the [`Instant`] it is given. However it ends, the group stands
    /// afterwards and is in PRE-OPERATIONAL.
    ///
    /// # Errors
    /// When the curve is too fast for the group (then nothing has moved), when a member faults or
    /// goes missing, or the link fails.
    pub fn follow(
        &mut self,
        plan: &Plan,
        observe: &mut dyn FnMut(&mut L, &Instant),
    ) -> Result<(), MasterError> {
        plan.check(&self.file.limits)?;
        let driven = self.drive(plan, observe);
        let stopped = self.ramp_down(STOP_PATIENCE_US);
        driven.and(stopped)
    }

    fn drive(
        &mut self,
        plan: &Plan,
        observe: &mut dyn FnMut(&mut L, &Instant),
    ) -> Result<(), MasterError> {
        let period = self.period_us() as f64 * 1e-6;
        let preview = preview_us(self.period_us()) as f64 * 1e-6;
        let duration = plan.duration();
        let mut k = 0.0;
        while k * period <= duration + TAIL {
            let t = k * period;
            self.cycle(plan.setpoint(t + preview))?;
            let (pose, twist) = plan.at(t);
            let instant = Instant {
                t,
                row: self.recorder().rows().len() - 1,
                duration,
                pose,
                twist,
            };
            observe(self.link(), &instant);
            k += 1.0;
        }
        Ok(())
    }
}
