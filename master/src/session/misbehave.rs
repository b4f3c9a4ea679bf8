//! What a master must not do, done on purpose: the acceptance of a group needs robots whose master
//! falls silent, forgets its setpoint or is joined by a second one.
//!
//! Every step keeps the session's own state as it is, so [`Group::ramp_down`] ends it as ever.

use canopen::{Frame, Micros};
use kinematics::Twist;
use protocol::{GroupTwist, cob};

use super::Group;
use crate::bus::link::Link;
use crate::error::MasterError;

impl<L: Link> Group<L> {
    /// Leaves off with SYNC; the last one was sent at the time returned.
    pub(crate) fn pause_sync(&mut self) -> Result<Micros, MasterError> {
        self.end_sync()?;
        Ok(Micros(self.next_sync.0.saturating_sub(self.period_us())))
    }

    /// Goes on with SYNC, a period or two from now.
    pub(crate) fn resume_sync(&mut self) {
        let period = self.period_us();
        self.next_sync = Micros((self.wire.now().0 / period + 2) * period);
        self.begin_sync();
    }

    /// One SYNC period without a setpoint.
    pub(crate) fn cycle_without_setpoint(&mut self) -> Result<(), MasterError> {
        self.await_turn()?;
        self.finish_period(Twist::default())
    }

    /// One SYNC period with `twist`, and after half of it a setpoint that a second master may have
    /// sent.
    pub(crate) fn cycle_beside_another(&mut self, twist: Twist) -> Result<(), MasterError> {
        let between = Micros(self.next_sync.0.saturating_sub(self.period_us() / 2));
        self.listen(between)?;
        let frame = GroupTwist {
            twist,
            sequence: self.sequence.wrapping_add(100),
            group: self.file.group_id,
        };
        self.wire
            .send(&Frame::of(cob::GROUP_TWIST, frame.encode()))?;
        self.cycle(twist)
    }

    /// The boot-up message of another robot that has a member's number.
    pub(crate) fn double(&mut self, node: u8) -> Result<(), MasterError> {
        self.wire.send(&Frame::of(cob::heartbeat(node), [0]))
    }
}
