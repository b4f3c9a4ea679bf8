//! Keeps a group at rest after a start until the master has commanded standstill.
//!
//! A master that goes on streaming a speed, or whose stick is not in the middle, would move the
//! group with the first setpoint after an NMT start. So a started member permits nothing but
//! standstill until all members have agreed on standstill at several SYNCs in a row. It expresses
//! that by its vote, scale 0, and it counts decisions, which are the same in every member; so all
//! are ready at the same SYNC, and one that was started late holds all of them back.

use kinematics::Twist;

/// Slower than this is standstill, m/s.
const LINEAR: f32 = 0.01;
/// The same about z, rad/s.
const YAW: f32 = 0.01;

/// Decisions to go until motion is permitted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Interlock {
    needed: u8,
    left: u8,
    /// There was a start since the last vote: the others have not been told yet.
    started: bool,
}

impl Interlock {
    /// Right after a start; so many agreed setpoints must be near standstill.
    pub const fn new(needed: u8) -> Self {
        Self {
            needed,
            left: needed,
            started: true,
        }
    }

    /// Whether a member that has not moved yet may vote for standstill. Not right after a start:
    /// the others, which may have counted already, learn of it by the vote that is missing.
    pub const fn permits_standstill(&mut self) -> bool {
        !core::mem::replace(&mut self.started, false)
    }

    /// All members agree on standstill; true when motion may begin.
    pub const fn agree(&mut self) -> bool {
        self.left = self.left.saturating_sub(1);
        self.left == 0
    }

    /// A robot that is asked alone: true when motion may begin with this setpoint.
    pub fn begins_with(&mut self, twist: Twist) -> bool {
        if is_standstill(twist) {
            return self.agree();
        }
        self.disagree();
        false
    }

    /// They did not agree.
    pub const fn disagree(&mut self) {
        self.left = self.needed;
    }
}

/// Whether this setpoint asks for standstill.
pub fn is_standstill(twist: Twist) -> bool {
    let linear = twist.vx * twist.vx + twist.vy * twist.vy;
    linear < LINEAR * LINEAR && twist.omega.abs() < YAW
}
