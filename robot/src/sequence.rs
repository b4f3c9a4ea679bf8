//! Decides which setpoint is fresh, and detects two masters.
//!
//! A setpoint is *fresh* when its sequence lies 1 to 127 ahead of the last one, wrapping. The same
//! sequence again is a repetition; one that lies behind is stale. Neither resets the timeout, so a
//! master that is stuck, or an old frame, stops the group. After a start any sequence is accepted
//! except the one that was in force before, which could be an old frame.
//!
//! One master sends one setpoint per SYNC and its sequence goes up. More than one in a SYNC period,
//! sequences that jump back and forth, or SYNC counters that run backwards or repeat, mean that two
//! masters send. Each such disorder adds two to a score and each orderly setpoint subtracts one, so
//! that a single doubled frame is tolerated and two masters are detected within six SYNCs. Lost
//! SYNCs are no disorder: see [`crate::rhythm`].

use control::time::Micros;
use protocol::{DecodeError, GroupTwist};

use crate::rhythm::Beat;

/// Disorder at which it must be two masters.
const TWO_MASTERS: u8 = 6;

/// What a SYNC brought.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Reception {
    /// Nothing new.
    Nothing,
    /// A new setpoint, now latched.
    Fresh,
    /// Two masters are at work.
    TwoMasters,
}

/// The setpoints of one source.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Setpoints {
    latched: Option<GroupTwist>,
    /// The last sequence that counted.
    sequence: Option<u8>,
    /// The sequence that was in force before the last start.
    barred: Option<u8>,
    fresh_at: Micros,
    /// Frames since the last SYNC.
    frames: u8,
    disorder: u8,
    ignored: u32,
    /// What came since the last fresh setpoint was not valid, or stale.
    invalid: bool,
}

impl Default for Setpoints {
    fn default() -> Self {
        Self::new()
    }
}

impl Setpoints {
    /// None yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            latched: None,
            sequence: None,
            barred: None,
            fresh_at: Micros(0),
            frames: 0,
            disorder: 0,
            ignored: 0,
            invalid: false,
        }
    }

    /// Forgets what is latched, and never takes it again.
    pub const fn restart(&mut self) {
        if self.sequence.is_some() {
            self.barred = self.sequence;
        }
        self.sequence = None;
        self.latched = None;
        self.disorder = 0;
        self.invalid = false;
    }

    /// The setpoint in force.
    #[must_use]
    pub const fn latched(&self) -> Option<GroupTwist> {
        self.latched
    }

    /// The sequence to echo.
    #[must_use]
    pub fn sequence(&self) -> u8 {
        self.sequence.or(self.barred).unwrap_or(0)
    }

    /// When the last fresh setpoint was latched.
    #[must_use]
    pub const fn fresh_at(&self) -> Micros {
        self.fresh_at
    }

    /// Takes the present setpoint for fresh: motion begins now.
    pub const fn touch(&mut self, at: Micros) {
        self.fresh_at = at;
    }

    /// Setpoints that came and were not followed.
    #[must_use]
    pub const fn ignored(&self) -> u32 {
        self.ignored
    }

    /// Whether what came since the last fresh setpoint was not valid.
    #[must_use]
    pub const fn is_invalid(&self) -> bool {
        self.invalid
    }

    /// Whether anything was wrong lately.
    #[must_use]
    pub const fn is_disturbed(&self) -> bool {
        self.disorder > 0 || self.invalid
    }

    /// A setpoint frame passed by.
    pub const fn count_frame(&mut self) {
        self.frames = self.frames.saturating_add(1);
    }

    /// Something was out of order.
    const fn count_disorder(&mut self) {
        self.disorder = self.disorder.saturating_add(2);
    }

    /// A SYNC at `at` latches what was `received` since the last one, for `group`.
    pub fn on_sync(
        &mut self,
        at: Micros,
        beat: Beat,
        received: Option<&[u8; 8]>,
        group: u8,
    ) -> Reception {
        if core::mem::take(&mut self.frames) > beat.periods {
            self.count_disorder();
        }
        if beat.disorder {
            self.count_disorder();
        }
        let reception = match received.map(|bytes| GroupTwist::try_from(&bytes[..])) {
            None => Reception::Nothing,
            Some(Ok(setpoint)) if setpoint.group != group => Reception::Nothing,
            Some(Ok(setpoint)) => self.accept(at, setpoint),
            Some(Err(error)) => {
                self.refuse(error);
                Reception::Nothing
            }
        };
        if self.disorder >= TWO_MASTERS {
            return Reception::TwoMasters;
        }
        reception
    }

    fn accept(&mut self, at: Micros, setpoint: GroupTwist) -> Reception {
        let sequence = setpoint.sequence;
        let ahead = match self.sequence {
            Some(last) => sequence.wrapping_sub(last),
            None if self.barred == Some(sequence) => 0,
            None => 1,
        };
        match ahead {
            0 => {
                // Another of the same after it had been followed: a master that is stuck.
                self.invalid |= self.sequence.is_some();
                Reception::Nothing
            }
            1..=127 => {
                self.barred = None;
                self.sequence = Some(sequence);
                self.latched = Some(setpoint);
                self.fresh_at = at;
                self.invalid = false;
                self.disorder = self.disorder.saturating_sub(1);
                Reception::Fresh
            }
            128..=255 => {
                self.ignored = self.ignored.wrapping_add(1);
                self.count_disorder();
                Reception::Nothing
            }
        }
    }

    const fn refuse(&mut self, _error: DecodeError) {
        self.ignored = self.ignored.wrapping_add(1);
        self.invalid = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kinematics::Twist;

    const GROUP: u8 = 3;
    const BEAT: Beat = Beat {
        periods: 1,
        disorder: false,
        off_period: false,
    };

    fn bytes(vx: f32, sequence: u8) -> [u8; 8] {
        GroupTwist {
            twist: Twist::new(vx, 0.0, 0.0),
            sequence,
            group: GROUP,
        }
        .encode()
    }

    fn sync(setpoints: &mut Setpoints, at: u64, vx: f32, sequence: u8) -> Reception {
        setpoints.count_frame();
        setpoints.on_sync(Micros(at), BEAT, Some(&bytes(vx, sequence)), GROUP)
    }

    #[test]
    fn a_sequence_ahead_is_fresh_and_wraps() {
        let mut setpoints = Setpoints::new();
        assert_eq!(sync(&mut setpoints, 1, 0.1, 254), Reception::Fresh);
        assert_eq!(sync(&mut setpoints, 2, 0.2, 255), Reception::Fresh);
        assert_eq!(sync(&mut setpoints, 3, 0.3, 0), Reception::Fresh);
        assert_eq!(setpoints.fresh_at(), Micros(3));
        assert_eq!(setpoints.sequence(), 0);
    }

    #[test]
    fn a_repeated_sequence_is_not_fresh_whatever_it_says() {
        let mut setpoints = Setpoints::new();
        sync(&mut setpoints, 1, 0.1, 9);
        assert_eq!(sync(&mut setpoints, 2, 0.9, 9), Reception::Nothing);
        assert_eq!(setpoints.fresh_at(), Micros(1));
        assert_eq!(setpoints.latched().unwrap().twist.vx, 0.1);
    }

    #[test]
    fn a_stale_sequence_is_ignored_and_counted() {
        let mut setpoints = Setpoints::new();
        sync(&mut setpoints, 1, 0.1, 9);
        assert_eq!(sync(&mut setpoints, 2, 0.9, 8), Reception::Nothing);
        assert_eq!(setpoints.ignored(), 1);
        assert_eq!(setpoints.latched().unwrap().sequence, 9);
        assert!(setpoints.is_disturbed());
    }

    #[test]
    fn an_invalid_setpoint_is_ignored_and_named() {
        let mut setpoints = Setpoints::new();
        sync(&mut setpoints, 1, 0.1, 9);
        assert_eq!(sync(&mut setpoints, 2, f32::NAN, 10), Reception::Nothing);
        assert!(setpoints.is_invalid());
        assert_eq!(sync(&mut setpoints, 3, 0.1, 11), Reception::Fresh);
        assert!(!setpoints.is_invalid());
    }

    #[test]
    fn another_group_is_not_listened_to() {
        let mut setpoints = Setpoints::new();
        let reception = setpoints.on_sync(Micros(1), BEAT, Some(&bytes(1.0, 1)), GROUP + 1);
        assert_eq!(reception, Reception::Nothing);
        assert_eq!(setpoints.latched(), None);
        assert_eq!(setpoints.ignored(), 0);
    }

    #[test]
    fn after_a_start_the_old_sequence_is_not_taken_again() {
        let mut setpoints = Setpoints::new();
        sync(&mut setpoints, 1, 0.1, 9);
        setpoints.restart();
        assert_eq!(setpoints.latched(), None);
        assert_eq!(sync(&mut setpoints, 2, 0.1, 9), Reception::Nothing);
        assert_eq!(setpoints.latched(), None);
        // A master that was restarted may begin anywhere.
        assert_eq!(sync(&mut setpoints, 3, 0.1, 2), Reception::Fresh);
    }

    #[test]
    fn two_masters_with_one_sync_are_found_out() {
        let mut setpoints = Setpoints::new();
        for round in 0..6 {
            setpoints.count_frame();
            if sync(&mut setpoints, 1, 0.1, round) == Reception::TwoMasters {
                return;
            }
        }
        panic!("not found out");
    }

    #[test]
    fn two_masters_with_a_sync_each_are_found_out() {
        let mut setpoints = Setpoints::new();
        for round in 0..6 {
            let first = sync(&mut setpoints, 1, 0.1, round);
            let second = sync(&mut setpoints, 1, 0.1, 200_u8.wrapping_add(round));
            if first == Reception::TwoMasters || second == Reception::TwoMasters {
                return;
            }
        }
        panic!("not found out");
    }

    #[test]
    fn one_doubled_setpoint_is_forgiven() {
        let mut setpoints = Setpoints::new();
        for round in 0..100 {
            if round % 4 == 0 {
                setpoints.count_frame();
            }
            assert_eq!(sync(&mut setpoints, 1, 0.1, round), Reception::Fresh);
        }
    }
}
