//! The state of a robot, as one pure function of the state before and an event.
//!
//! Terms: *started* is an accepted NMT start; *ready* is stopped and well; *armed* is started, with
//! drivers on, standing; *ramping* is on the way to standstill; *faulted* is at rest with the cause
//! saved. The function knows no time and no messages: the code that watches timers, members and
//! wheels converts what it detects into one of eight [`Event`]s. There are two ways out of a
//! standstill, and both begin with a start from the master.

use protocol::{Fault, MemberState, Reaction};

/// What follows a ramp.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum After {
    /// The robot was commanded to stop.
    Ready,
    /// Something made it stop.
    Faulted(Fault),
}

/// What a robot is doing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum State {
    /// Outputs off, brake engaged, nothing wrong.
    Ready,
    /// Started, drivers on, standing, waiting for a new setpoint that all members agree on.
    Armed,
    /// Following the group twist.
    Moving,
    /// Following a commissioning twist of its own.
    Alone,
    /// Ramping down along the direction of motion.
    Ramping(After),
    /// Outputs off, brake engaged, until the next start.
    Faulted(Fault),
}

/// What happens to a robot.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Event {
    /// NMT start, and nothing speaks against it.
    Started,
    /// NMT start, but this does.
    StartRefused(Fault),
    /// NMT took it out of OPERATIONAL, or an identification is over.
    Left,
    /// All members agree on a new setpoint, at a scale above zero.
    GroupSetpoint,
    /// A commissioning twist came, and it is permitted.
    OwnSetpoint,
    /// Something went wrong.
    Failed(Fault),
    /// The same, and whatever it is, it is no time for a ramp: another member was cut.
    Cut(Fault),
    /// The ramp is over: reference and wheels stand.
    Standstill,
}

impl State {
    /// The state after `event`.
    ///
    /// The first fault is kept: what follows from a stop must not hide its cause. Only a fault that
    /// cuts replaces one that ramps, while the ramp still runs.
    #[must_use]
    pub const fn after(self, event: Event) -> Self {
        use Event as E;
        match (self, event) {
            // A start begins from standstill only.
            (Self::Ready | Self::Armed | Self::Faulted(_), E::Started) => Self::Armed,
            (Self::Ready | Self::Armed | Self::Faulted(_), E::StartRefused(fault)) => {
                Self::Faulted(fault)
            }
            (Self::Moving | Self::Alone | Self::Ramping(_), E::Started | E::StartRefused(_)) => {
                self
            }

            (Self::Ready | Self::Armed, E::Left) => Self::Ready,
            (Self::Moving | Self::Alone, E::Left) => Self::Ramping(After::Ready),
            (Self::Ramping(_) | Self::Faulted(_), E::Left) => self,

            (Self::Armed | Self::Moving, E::GroupSetpoint) => Self::Moving,
            (Self::Ready | Self::Alone | Self::Ramping(_) | Self::Faulted(_), E::GroupSetpoint) => {
                self
            }

            (Self::Armed | Self::Alone, E::OwnSetpoint) => Self::Alone,
            (Self::Ready | Self::Moving | Self::Ramping(_) | Self::Faulted(_), E::OwnSetpoint) => {
                self
            }

            (Self::Armed, E::Failed(fault)) => Self::Faulted(fault),
            (Self::Moving | Self::Alone, E::Failed(fault)) => match fault.reaction() {
                Reaction::Ramp => Self::Ramping(After::Faulted(fault)),
                Reaction::Cut => Self::Faulted(fault),
            },
            (Self::Ramping(after), E::Failed(fault)) => match (fault.reaction(), after) {
                (Reaction::Cut, _) => Self::Faulted(fault),
                (Reaction::Ramp, After::Ready) => Self::Ramping(After::Faulted(fault)),
                (Reaction::Ramp, After::Faulted(_)) => self,
            },
            (Self::Ready | Self::Faulted(_), E::Failed(_) | E::Cut(_)) => self,
            (Self::Armed | Self::Moving | Self::Alone | Self::Ramping(_), E::Cut(fault)) => {
                Self::Faulted(fault)
            }

            (Self::Ramping(After::Ready), E::Standstill) => Self::Ready,
            (Self::Ramping(After::Faulted(fault)), E::Standstill) => Self::Faulted(fault),
            (
                Self::Ready | Self::Armed | Self::Moving | Self::Alone | Self::Faulted(_),
                E::Standstill,
            ) => self,
        }
    }

    /// The fault this state keeps, if it does.
    #[must_use]
    pub const fn fault(self) -> Option<Fault> {
        match self {
            Self::Faulted(fault) | Self::Ramping(After::Faulted(fault)) => Some(fault),
            Self::Ready
            | Self::Armed
            | Self::Moving
            | Self::Alone
            | Self::Ramping(After::Ready) => None,
        }
    }

    /// What the others are told; `configured` tells a ready robot from an unconfigured one.
    #[must_use]
    pub const fn reported(self, configured: bool) -> MemberState {
        match self {
            Self::Ready if configured => MemberState::Ready,
            Self::Ready => MemberState::Unconfigured,
            Self::Armed => MemberState::Armed,
            Self::Moving => MemberState::Moving,
            Self::Alone => MemberState::Alone,
            Self::Ramping(_) => MemberState::Ramping,
            Self::Faulted(_) => MemberState::Faulted,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const RAMP: Fault = Fault::MasterSilent;
    const RAMP_TOO: Fault = Fault::SyncLost;
    const CUT: Fault = Fault::EmergencyStop;

    fn states() -> Vec<State> {
        let mut all = std::vec![
            State::Ready,
            State::Armed,
            State::Moving,
            State::Alone,
            State::Ramping(After::Ready),
        ];
        for fault in Fault::ALL {
            all.push(State::Faulted(*fault));
            all.push(State::Ramping(After::Faulted(*fault)));
        }
        all
    }

    fn events() -> Vec<Event> {
        let mut all = std::vec![
            Event::Started,
            Event::Left,
            Event::GroupSetpoint,
            Event::OwnSetpoint,
            Event::Standstill,
        ];
        for fault in Fault::ALL {
            all.push(Event::Failed(*fault));
            all.push(Event::Cut(*fault));
            all.push(Event::StartRefused(*fault));
        }
        all
    }

    fn is_at_rest(state: State) -> bool {
        matches!(state, State::Ready | State::Faulted(_))
    }

    /// Every state with every event, against a table written out by hand. A dash is "no
    /// change".
    #[test]
    fn every_state_with_every_event() {
        use Event as E;
        use State as S;
        let ramping = S::Ramping(After::Ready);
        let failing = S::Ramping(After::Faulted(RAMP));
        let faulted = S::Faulted(RAMP);
        let from = [
            S::Ready,
            S::Armed,
            S::Moving,
            S::Alone,
            ramping,
            failing,
            faulted,
        ];
        let table = [
            (
                E::Started,
                [
                    S::Armed,
                    S::Armed,
                    S::Moving,
                    S::Alone,
                    ramping,
                    failing,
                    S::Armed,
                ],
            ),
            (
                E::StartRefused(CUT),
                [
                    S::Faulted(CUT),
                    S::Faulted(CUT),
                    S::Moving,
                    S::Alone,
                    ramping,
                    failing,
                    S::Faulted(CUT),
                ],
            ),
            (
                E::Left,
                [
                    S::Ready,
                    S::Ready,
                    ramping,
                    ramping,
                    ramping,
                    failing,
                    faulted,
                ],
            ),
            (
                E::GroupSetpoint,
                [
                    S::Ready,
                    S::Moving,
                    S::Moving,
                    S::Alone,
                    ramping,
                    failing,
                    faulted,
                ],
            ),
            (
                E::OwnSetpoint,
                [
                    S::Ready,
                    S::Alone,
                    S::Moving,
                    S::Alone,
                    ramping,
                    failing,
                    faulted,
                ],
            ),
            (
                E::Failed(RAMP_TOO),
                [
                    S::Ready,
                    S::Faulted(RAMP_TOO),
                    S::Ramping(After::Faulted(RAMP_TOO)),
                    S::Ramping(After::Faulted(RAMP_TOO)),
                    S::Ramping(After::Faulted(RAMP_TOO)),
                    failing,
                    faulted,
                ],
            ),
            (
                E::Failed(CUT),
                [
                    S::Ready,
                    S::Faulted(CUT),
                    S::Faulted(CUT),
                    S::Faulted(CUT),
                    S::Faulted(CUT),
                    S::Faulted(CUT),
                    faulted,
                ],
            ),
            (
                E::Cut(RAMP_TOO),
                [
                    S::Ready,
                    S::Faulted(RAMP_TOO),
                    S::Faulted(RAMP_TOO),
                    S::Faulted(RAMP_TOO),
                    S::Faulted(RAMP_TOO),
                    S::Faulted(RAMP_TOO),
                    faulted,
                ],
            ),
            (
                E::Standstill,
                [
                    S::Ready,
                    S::Armed,
                    S::Moving,
                    S::Alone,
                    S::Ready,
                    faulted,
                    faulted,
                ],
            ),
        ];
        for (event, to) in table {
            for (from, to) in from.into_iter().zip(to) {
                assert_eq!(from.after(event), to, "{from:?} with {event:?}");
            }
        }
    }

    #[test]
    fn nothing_but_a_start_leaves_rest() {
        for state in states().into_iter().filter(|state| is_at_rest(*state)) {
            for event in events() {
                if event != Event::Started {
                    assert!(is_at_rest(state.after(event)), "{state:?} {event:?}");
                }
            }
        }
    }

    #[test]
    fn a_start_never_moves_anything_by_itself() {
        for state in states().into_iter().filter(|state| is_at_rest(*state)) {
            assert_eq!(state.after(Event::Started), State::Armed);
        }
    }

    #[test]
    fn a_fault_that_cuts_is_at_rest_at_once() {
        for state in states() {
            for fault in Fault::ALL {
                assert!(is_at_rest(state.after(Event::Cut(*fault))));
                if fault.reaction() == Reaction::Cut {
                    assert!(is_at_rest(state.after(Event::Failed(*fault))));
                }
            }
        }
    }

    #[test]
    fn a_fault_that_ramps_is_never_a_hard_stop_of_a_moving_robot() {
        for state in [State::Moving, State::Alone] {
            for fault in Fault::ALL {
                if fault.reaction() == Reaction::Ramp {
                    let next = state.after(Event::Failed(*fault));
                    assert_eq!(next, State::Ramping(After::Faulted(*fault)));
                }
            }
        }
    }

    #[test]
    fn the_first_cause_is_kept() {
        for state in states() {
            let Some(first) = state.fault() else { continue };
            for event in events() {
                match (state, event) {
                    (State::Faulted(_), Event::Started | Event::StartRefused(_)) => {}
                    (State::Ramping(_), Event::Failed(fault))
                        if fault.reaction() == Reaction::Cut => {}
                    (State::Ramping(_), Event::Cut(_)) => {}
                    _ => assert_eq!(state.after(event).fault(), Some(first)),
                }
            }
        }
    }

    #[test]
    fn only_a_ramp_ends_by_standstill() {
        for state in states() {
            let next = state.after(Event::Standstill);
            match state {
                State::Ramping(After::Ready) => assert_eq!(next, State::Ready),
                State::Ramping(After::Faulted(fault)) => assert_eq!(next, State::Faulted(fault)),
                _ => assert_eq!(next, state),
            }
        }
    }
}
