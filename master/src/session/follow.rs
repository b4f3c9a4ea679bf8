//! Driving a curve: one setpoint per SYNC, sent ahead of the time it is for.
//!
//! The way of a setpoint is known. Sent before SYNC k, it is latched there, is in force a fixed
//! time later, when the members have agreed on it, and they pass to it evenly over one period, so
//! that it is reached that time after SYNC k + 1 ([`group::preview_us`]). The setpoint sent before
//! SYNC k is therefore the curve's at that later time.
//!
//! The way from the wheels to the floor is known too, where the group file says so: contacts creep,
//! and a group that accelerates trails its wheels by a fixed time ([`group::ContactLag`]). The
//! setpoint leads by that time's worth of the curve's acceleration ([`led`]), and by what rollers
//! cost that meet the floor at rest ([`crate::path::roller_transition`]). What is left (motors,
//! wheel loops, rounding to 0.1 mm/s, uneven contacts) shows in the tracking error.

use canopen::Micros;
use group::{ContactLag, GroupFile};
use kinematics::Twist;

use crate::bus::link::Link;
use crate::error::MasterError;
use crate::path::curve::{Instant, Plan};
use crate::path::steering::{Lost, Steering, limited};
use crate::session::{Group, STOP_PATIENCE_US};

/// How long the group is watched after the curve's end, in s: the pipeline's delay and a little
/// more.
const TAIL: f64 = 0.1;

/// How far ahead of what this group does a plan is asked, at most, in s.
#[must_use]
pub fn lead(file: &GroupFile) -> f64 {
    f64::from(group::preview_us(file)) * 1e-6 + SHORTLY
}

/// One period of a plan.
pub(crate) struct Period<'a> {
    /// The plan.
    pub plan: &'a Plan,
    /// The SYNC it began with.
    pub began: Micros,
    /// Feedback.
    pub steering: Option<&'a mut Steering>,
    /// Whether the pose it asks for is shown as the group's target: in the frame of its poses.
    pub shown: bool,
}

/// Half the stretch of time over which a curve's acceleration is taken, s.
const SHORTLY: f64 = 5e-3;

/// The velocity and the acceleration of a curve at `t`, in the frame of a group with this heading.
fn motion(plan: &Plan, t: f64, heading: f32) -> (Twist, Twist) {
    let (before, after) = (plan.at(t - SHORTLY).1, plan.at(t + SHORTLY).1);
    let acceleration = (after - before) * (0.5 / SHORTLY as f32);
    (plan.at(t).1.to_body(heading), acceleration.to_body(heading))
}

/// The twist that a group with this heading has to ask of its wheels at `t` for moving as the curve
/// does then: the curve's, and the slip its acceleration costs.
fn led(plan: &Plan, t: f64, heading: f32, lag: &ContactLag) -> Twist {
    let (velocity, acceleration) = motion(plan, t, heading);
    velocity
        + Twist::new(
            lag.longitudinal * acceleration.vx,
            lag.lateral * acceleration.vy,
            lag.yaw * acceleration.omega,
        )
}

impl<L: Link> Group<L> {
    /// Drives `plan` from rest to rest; call [`Group::start`] before. `observe` is called at every
    /// SYNC, at the time of the [`Instant`] it is given. However it ends, the group stands
    /// afterwards and is in PRE-OPERATIONAL.
    ///
    /// # Errors
    /// When the curve is too fast for the group or the group is not started (then nothing has
    /// moved), when a member faults or goes missing, or the link fails.
    pub fn follow(
        &mut self,
        plan: &Plan,
        observe: &mut dyn FnMut(&mut L, &Instant),
    ) -> Result<(), MasterError> {
        self.follow_with(plan, None, observe)
    }

    /// The same with feedback.
    ///
    /// # Errors
    /// As [`Group::follow`], and when sightings of the group stop coming.
    pub fn follow_with(
        &mut self,
        plan: &Plan,
        steering: Option<&mut Steering>,
        observe: &mut dyn FnMut(&mut L, &Instant),
    ) -> Result<(), MasterError> {
        plan.check(&self.file.limits)?;
        self.check_started()?;
        let driven = self.drive(plan, steering, observe);
        if let Err(error) = &driven {
            self.fail(error);
        }
        let stopped = self.ramp_down(STOP_PATIENCE_US);
        driven.and(stopped)
    }

    /// Drives a checked plan; the group stands afterwards and stays started.
    pub(crate) fn drive(
        &mut self,
        plan: &Plan,
        mut steering: Option<&mut Steering>,
        observe: &mut dyn FnMut(&mut L, &Instant),
    ) -> Result<(), MasterError> {
        let began = self.next_sync();
        if let Some(steering) = &mut steering {
            steering.begin(began);
        }
        loop {
            let period = Period {
                plan,
                began,
                steering: steering.as_deref_mut(),
                shown: true,
            };
            let Some(instant) = self.period_of(period)? else {
                return Ok(());
            };
            observe(self.link(), &instant);
        }
    }

    /// One period of a plan: its setpoint is sent and the SYNC seen through. What the plan asked
    /// for then; `None`, and nothing was sent, when it is over.
    pub(crate) fn period_of(&mut self, period: Period<'_>) -> Result<Option<Instant>, MasterError> {
        let Period {
            plan,
            began,
            steering,
            shown,
        } = period;
        self.await_turn()?;
        let t = self.next_sync().since(began).0 as f64 * 1e-6;
        let duration = plan.duration();
        if t > duration + TAIL {
            return Ok(None);
        }
        let preview = f64::from(group::preview_us(&self.file)) * 1e-6;
        let (pose, twist) = plan.at(t);
        let setpoint = match steering {
            Some(steering) => self.steer(plan, t + preview, steering)?,
            None => self.forward(plan, t + preview),
        };
        self.set_target(shown.then_some(pose));
        self.run_period(setpoint)?;
        Ok(Some(Instant {
            t,
            row: self.recorder().rows().len() - 1,
            duration,
            pose,
            twist,
        }))
    }

    /// The setpoint for the time `t` of the curve.
    fn forward(&self, plan: &Plan, t: f64) -> Twist {
        self.asked(plan, t, plan.at(t).0.heading)
    }

    /// What a group with this heading is to be asked for at `t`.
    fn asked(&self, plan: &Plan, t: f64, heading: f32) -> Twist {
        let led = led(plan, t, heading, &self.file.contact_lag);
        led + self.lost_by_hand_over(led)
    }

    /// The setpoint for the time `t` of the curve, corrected by what was seen.
    fn steer(&self, plan: &Plan, t: f64, steering: &mut Steering) -> Result<Twist, MasterError> {
        let now = self.wire.now();
        let seen = steering
            .look(now, self.rows_began(), self.recorder().rows())
            .map_err(|Lost| MasterError::PoseLost)?;
        let Some(seen) = seen.filter(|_| steering.corrects) else {
            return Ok(self.forward(plan, t));
        };
        let (wanted, _) = plan.at(seen.t);
        let correction = steering.law.correction(wanted, seen.pose);
        let (velocity, acceleration) = motion(plan, seen.t, seen.pose.heading);
        steering.learn(&seen, correction, velocity, acceleration);
        // The heading error stays as it was seen until something is done about it.
        let heading = plan.at(t).0.heading + seen.pose.heading - wanted.heading;
        let (velocity, acceleration) = motion(plan, t, heading);
        let forward =
            self.asked(plan, t, heading) + steering.adaptation.added(velocity, acceleration);
        Ok(limited(
            forward + correction.to_body(heading),
            &self.file.limits,
        ))
    }
}
