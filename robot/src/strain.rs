//! Detects members that disagree about the motion of the group.
//!
//! Every member publishes the group twist that its own wheels measure. On a rigid load all of them
//! must be the same; a difference is slip or strain in the load. The difference from each other
//! member is computed as a velocity at this robot's own position, where it acts, so a difference in
//! yaw counts in proportion to its lever.

use control::time::Micros;
use kinematics::Twist;
use protocol::{FIRST_ROBOT, Fault, MAX_ROBOTS};

use control::configuration::Configuration;
use control::math::sqrt;
use control::quantity::{Quantity, Rate};
use control::threshold::{Hysteresis, Lasting};
use control::twist::{quantities, single, still};

/// A velocity that differs from another one, m/s or rad/s: 6.6 rad/s at the end of a lever of 71 m
/// are 464 m/s.
type Strained = Quantity<20>;

/// Compares measured twists at every SYNC.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct Strain {
    twists: [Twist<Strained>; MAX_ROBOTS],
    /// Which of them came since the last SYNC, one bit each.
    received: u32,
    /// What this robot published at the last SYNC.
    own: Twist<Strained>,
    worst: f32,
    limit: Hysteresis,
    fault: Lasting,
}

impl Strain {
    pub const fn new() -> Self {
        Self {
            twists: [still(); MAX_ROBOTS],
            received: 0,
            own: still(),
            worst: 0.0,
            limit: Hysteresis { active: false },
            fault: Lasting::new(),
        }
    }

    /// A member's measured group twist came in.
    pub fn record(&mut self, node: u8, measured: Twist) {
        let place = usize::from(node.wrapping_sub(FIRST_ROBOT));
        if let Some(twist) = self.twists.get_mut(place) {
            *twist = quantities(measured);
            self.received |= 1 << place;
        }
    }

    /// A SYNC: compares what was measured at the last one, by then received from all members.
    pub fn on_sync(
        &mut self,
        at: Micros,
        measured: Twist<Strained>,
        configuration: &Configuration,
    ) -> Option<Fault> {
        let mut worst_squared = 0.0_f32;
        let mut received = core::mem::take(&mut self.received);
        for (node, twist) in (FIRST_ROBOT..).zip(&self.twists) {
            if received == 0 {
                break;
            }
            let is_new = received & 1 == 1;
            received >>= 1;
            if !is_new || !configuration.is_member(node) {
                continue;
            }
            let drivetrain = &configuration.drivetrain;
            let here = single(drivetrain.here(*twist - self.own));
            worst_squared = worst_squared.max(here.vx * here.vx + here.vy * here.vy);
        }
        self.own = measured;
        self.worst = sqrt(worst_squared);
        let thresholds = &configuration.thresholds;
        let worst = Rate::new(self.worst);
        self.limit.update(worst, thresholds.strain_limit);
        let bad = thresholds.strain_fault > Rate::ZERO && worst > thresholds.strain_fault;
        // A consequence must not be announced before its cause.
        let lasting_us = configuration.times.consequence_us();
        self.fault
            .update(bad, at, lasting_us)
            .then_some(Fault::StrainExcess)
    }

    pub const fn is_limit(&self) -> bool {
        self.limit.is_active()
    }

    pub fn restart(&mut self) {
        *self = Self::new();
    }
}
