//! The rules by which the members of a group move as one.
//!
//! 1. At SYNC *k* every member latches the twist received before it, works out the scale at which
//!    its own wheels could follow, and publishes it with the sequence it latched.
//! 2. With the last member's vote all know the smallest scale. They apply twist(*k*) times that, at
//!    one time after SYNC *k* ([`protocol::timing::agreement_delay_us`]).
//! 3. A member that is in no state to follow, echoes another sequence, or would do something else
//!    with it (see [`protocol::Plan`]), counts as scale 0, and scale 0 is a stop. So does one
//!    whose status does not arrive before SYNC *k+1*; until then the others hold the last setpoint.
//!
//! Every member runs this on the same frames in the same order and compares the same integers, its
//! own published scale included, so all of them decide the same. No member leads.

use protocol::{FIRST_ROBOT, Fault, MAX_ROBOTS, MemberStatus, Scale};

/// What one member has published since the last SYNC.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Vote {
    sequence: u8,
    plan: u8,
    scale: Scale,
    follows: bool,
}

impl Vote {
    /// That of a member which has not voted.
    const NONE: Self = Self {
        sequence: 0,
        plan: 0,
        scale: Scale::ZERO,
        follows: false,
    };
}

/// What a member publishes about the setpoint it latched.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Own {
    /// Its sequence.
    pub sequence: u8,
    /// Checksum over what the member would do with it.
    pub plan: u8,
    /// The scale at which its own wheels can follow.
    pub scale: Scale,
}

impl Own {
    /// Nothing is permitted.
    pub const NONE: Self = Self {
        sequence: 0,
        plan: 0,
        scale: Scale::ZERO,
    };
}

/// What the members came to.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Verdict {
    /// All follow, at this scale; `own` when it is this member that sets it.
    Go {
        /// Above zero.
        scale: Scale,
        /// No other member permits less.
        own: bool,
    },
    /// A member does not.
    Stop(Fault),
}

/// The members' votes between two SYNCs.
#[derive(Clone, Copy, Debug)]
pub struct Agreement {
    votes: [Vote; MAX_ROBOTS],
    /// Bit n stands for the vote of node n; where it is clear, there is none since the last SYNC.
    voted: u32,
}

impl Default for Agreement {
    fn default() -> Self {
        Self::new()
    }
}

impl Agreement {
    /// No vote received yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            votes: [Vote::NONE; MAX_ROBOTS],
            voted: 0,
        }
    }

    /// Forgets all votes.
    pub const fn clear(&mut self) {
        self.voted = 0;
    }

    /// A member's status came in.
    pub fn record(&mut self, node: u8, status: &MemberStatus) {
        let place = usize::from(node.wrapping_sub(FIRST_ROBOT));
        if let Some(vote) = self.votes.get_mut(place) {
            self.voted |= 1 << node;
            *vote = Vote {
                sequence: status.sequence,
                plan: status.plan,
                scale: status.scale,
                follows: status.state.can_follow(),
            };
        }
    }

    /// How many of `members` (a mask of nodes) but this `node` were not heard since the last SYNC.
    #[must_use]
    pub const fn missing(&self, members: u32, node: u8) -> u32 {
        (members & !(1 << node) & !self.voted).count_ones()
    }

    /// What do `members` (a mask of nodes) say about the setpoint about which this `node` published
    /// its `own`? The votes are used up by that.
    pub fn decide(&mut self, members: u32, node: u8, own: Own) -> Verdict {
        let mut voted = core::mem::take(&mut self.voted) >> FIRST_ROBOT;
        let mut smallest = own.scale;
        let mut others = others(members, node);
        for vote in &self.votes {
            if others == 0 {
                break;
            }
            let (is_other, has_voted) = (others & 1 == 1, voted & 1 == 1);
            others >>= 1;
            voted >>= 1;
            if !is_other {
                continue;
            }
            if own.scale == Scale::ZERO {
                // No robot moves. One that permits it has latched the same setpoint: that the plans
                // for it differ is the fault all the same, in all of them.
                let permits = has_voted && vote.follows && vote.scale > Scale::ZERO;
                if permits && vote.sequence == own.sequence && vote.plan != own.plan {
                    return Verdict::Stop(Fault::PlanMismatch);
                }
                continue;
            }
            if !has_voted {
                return Verdict::Stop(Fault::MemberSilent);
            }
            if !vote.follows {
                return Verdict::Stop(Fault::MemberStopped);
            }
            if vote.sequence != own.sequence {
                return Verdict::Stop(Fault::SequenceMismatch);
            }
            if vote.plan != own.plan {
                return Verdict::Stop(Fault::PlanMismatch);
            }
            if vote.scale == Scale::ZERO {
                return Verdict::Stop(Fault::MemberStopped);
            }
            smallest = smallest.min(vote.scale);
        }
        if own.scale == Scale::ZERO {
            return Verdict::Stop(Fault::MemberStopped);
        }
        Verdict::Go {
            scale: smallest,
            own: smallest == own.scale,
        }
    }
}

/// The members other than `node`, one bit each from [`FIRST_ROBOT`] on, in the order of the votes.
const fn others(members: u32, node: u8) -> u32 {
    (members & !(1 << node)) >> FIRST_ROBOT
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::{Code, MemberState};

    const MEMBERS: u32 = 0b11100;

    /// What this member says; of the others only the scale differs.
    const fn own(scale: Scale) -> Own {
        Own {
            sequence: 7,
            plan: 0x5A,
            scale,
        }
    }

    fn status(state: MemberState, sequence: u8, scale: u16) -> MemberStatus {
        MemberStatus {
            state,
            sequence,
            scale: Scale(scale),
            slip_residual: None,
            code: Code::None,
            plan: 0x5A,
        }
    }

    fn after(heard: &[(u8, MemberStatus)]) -> Verdict {
        let mut agreement = Agreement::new();
        for (node, status) in heard {
            agreement.record(*node, status);
        }
        agreement.decide(MEMBERS, 2, own(Scale(50_000)))
    }

    use MemberState::{Armed, Faulted, Moving, Ramping};

    #[test]
    fn smallest_scale_of_all_members_is_applied() {
        let go = |scale, own| Verdict::Go {
            scale: Scale(scale),
            own,
        };
        assert_eq!(
            after(&[
                (3, status(Moving, 7, 60_000)),
                (4, status(Armed, 7, 40_000))
            ]),
            go(40_000, false)
        );
        assert_eq!(
            after(&[
                (3, status(Moving, 7, 60_000)),
                (4, status(Moving, 7, 65_535))
            ]),
            go(50_000, true)
        );
    }

    #[test]
    fn missing_member_is_scale_zero() {
        assert_eq!(
            after(&[(3, status(Moving, 7, 60_000))]),
            Verdict::Stop(Fault::MemberSilent)
        );
    }

    #[test]
    fn member_in_fault_is_scale_zero() {
        for state in [Faulted, Ramping, MemberState::Alone, MemberState::Ready] {
            assert_eq!(
                after(&[
                    (3, status(Moving, 7, 60_000)),
                    (4, status(state, 7, 60_000))
                ]),
                Verdict::Stop(Fault::MemberStopped)
            );
        }
    }

    #[test]
    fn member_with_another_sequence_is_scale_zero() {
        assert_eq!(
            after(&[
                (3, status(Moving, 7, 60_000)),
                (4, status(Moving, 8, 60_000))
            ]),
            Verdict::Stop(Fault::SequenceMismatch)
        );
    }

    #[test]
    fn member_with_another_plan_is_scale_zero() {
        let other = MemberStatus {
            plan: 0x5B,
            ..status(Moving, 7, 60_000)
        };
        assert_eq!(
            after(&[(3, status(Moving, 7, 60_000)), (4, other)]),
            Verdict::Stop(Fault::PlanMismatch)
        );
    }

    #[test]
    fn votes_of_all_others_are_waited_for() {
        let mut agreement = Agreement::new();
        assert_eq!(agreement.missing(0b100, 2), 0);
        agreement.record(3, &status(Moving, 7, 9));
        assert_eq!(agreement.missing(MEMBERS, 2), 1);
        agreement.record(5, &status(Moving, 7, 9));
        assert_eq!(agreement.missing(MEMBERS, 2), 1);
        agreement.record(4, &status(Moving, 7, 9));
        assert_eq!(agreement.missing(MEMBERS, 2), 0);
        agreement.decide(MEMBERS, 2, own(Scale::ONE));
        assert_eq!(agreement.missing(MEMBERS, 2), 2);
    }

    #[test]
    fn scale_zero_of_any_member_is_a_stop() {
        assert_eq!(
            after(&[(3, status(Moving, 7, 0)), (4, status(Moving, 7, 60_000))]),
            Verdict::Stop(Fault::MemberStopped)
        );
        let mut agreement = Agreement::new();
        assert_eq!(
            agreement.decide(0b100, 2, own(Scale::ZERO)),
            Verdict::Stop(Fault::MemberStopped)
        );
    }

    #[test]
    fn votes_count_for_one_sync_only() {
        let mut agreement = Agreement::new();
        agreement.record(3, &status(Moving, 7, 9));
        agreement.record(4, &status(Moving, 7, 9));
        assert!(matches!(
            agreement.decide(MEMBERS, 2, own(Scale::ONE)),
            Verdict::Go { .. }
        ));
        assert_eq!(
            agreement.decide(MEMBERS, 2, own(Scale::ONE)),
            Verdict::Stop(Fault::MemberSilent)
        );
    }

    #[test]
    fn a_robot_alone_is_a_group_of_one() {
        let mut agreement = Agreement::new();
        let verdict = agreement.decide(0b100, 2, own(Scale(9)));
        assert_eq!(
            verdict,
            Verdict::Go {
                scale: Scale(9),
                own: true
            }
        );
    }

    #[test]
    fn strangers_have_no_vote() {
        let mut agreement = Agreement::new();
        agreement.record(17, &status(Faulted, 9, 0));
        agreement.record(1, &status(Faulted, 9, 0));
        agreement.record(18, &status(Faulted, 9, 0));
        assert!(matches!(
            agreement.decide(0b100, 2, own(Scale::ONE)),
            Verdict::Go { .. }
        ));
    }
}
