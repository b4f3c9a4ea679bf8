//! One wheel's roller angle: counts track it, the index sets it, and it is lost when they disagree.
//!
//! Every accepted index resets the angle and is the reference for the next. Errors therefore do not
//! accumulate over many turns, even where a turn is not a whole number of counts, as with a gear of
//! 26.85. A correct index may deviate by
//! - a count, because both pulses are read in whole counts;
//! - the play between encoder and wheel, when the wheel has turned back in between;
//! - the error of a turn in single precision: 2^-24 of the counts since the last index, of which
//!   there are at most [`PATIENCE`] turns; below a count to four million a turn.
//!
//! The tolerance has to cover these, and has to stay below the deviation of a wrong gear: the limit
//! of 1/64 of a turn just rejects a wheel of 60 teeth with one tooth more or less, 1.6 %.

use kinematics::{RollerAngle, RollerTrack};

use super::{IndexPulse, RollerState, RollerWheel, Value, scalar};

/// Revolutions without an index after which a reference is no longer trusted.
pub(super) const PATIENCE: f32 = 2.0;

/// Ticks over which a wheel passes from the mean ratio to its angle and back.
pub(super) const BLEND: u16 = 64;

/// One wheel while it runs.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Tracked {
    pub configuration: RollerWheel,
    pub track: RollerTrack,
    pub state: RollerState,
    /// Number of the last pulse that was evaluated; `None` before the first tick.
    number: Option<u8>,
    /// Counts since the last pulse, if there was one.
    since: Option<i32>,
    /// How much of the way from the mean to the angle, 0 to [`BLEND`].
    share: u16,
}

impl Tracked {
    /// A wheel whose angle is unknown, unless it was known `before` of the same wheel. Not inlined:
    /// four times in a row it is two kilobytes.
    #[inline(never)]
    pub fn new(configuration: RollerWheel, before: Option<&Self>) -> Self {
        let same = before.filter(|before| {
            configuration.track == before.configuration.track
                && configuration.turn == before.configuration.turn
        });
        let Some(before) = same else {
            return Self::unknown(configuration);
        };
        let mut wheel = *before;
        wheel.configuration = configuration;
        let (phase, other) = (configuration.phase, before.configuration.phase);
        let shift = RollerAngle::from_bits(phase.to_bits().wrapping_sub(other.to_bits()));
        wheel.track.set(before.track.angle().advanced(shift));
        wheel
    }

    fn unknown(configuration: RollerWheel) -> Self {
        Self {
            configuration,
            track: configuration.track,
            state: if configuration.is_ideal() {
                RollerState::Constant
            } else {
                RollerState::Sought
            },
            number: None,
            since: None,
            share: 0,
        }
    }

    /// Advances by the counts since the last tick.
    #[inline]
    pub fn update(&mut self, passed: i16) {
        let passed = i32::from(passed);
        self.track.advance(passed);
        if let Some(since) = &mut self.since {
            *since = since.saturating_add(passed);
        }
    }

    /// Compares with the index, of which `pulse` is the last; the counter is at `now`.
    #[inline]
    pub fn compare(&mut self, now: u16, pulse: IndexPulse, tolerance: i32) {
        if self.state == RollerState::Constant {
            return;
        }
        let last = self.number.replace(pulse.number);
        if last.is_some_and(|last| last != pulse.number) {
            self.on_index(
                i32::from(now.wrapping_sub(pulse.count).cast_signed()),
                tolerance,
            );
        }
        let patience = self.configuration.patience.saturating_add(tolerance);
        if self.state == RollerState::Known && self.since.is_none_or(|since| since.abs() > patience)
        {
            self.state = RollerState::Lost;
            self.since = None;
        }
    }

    /// Goes a step towards the angle, or towards the mean where that is not known.
    #[inline]
    pub fn blend(&mut self) {
        if self.state == RollerState::Known {
            self.share = (self.share + 1).min(BLEND);
        } else {
            self.share = self.share.saturating_sub(1);
        }
    }

    /// The index passed `ago` counts before now.
    #[cold]
    fn on_index(&mut self, ago: i32, tolerance: i32) {
        let turn = self.configuration.turn;
        // Counts from the pulse before to this one, and how far they are from a whole number of
        // turns.
        let between = self.since.map(|since| since.saturating_sub(ago) as f32);
        let off = between.map(|between| (between - whole(between / turn) * turn).abs());
        let fits = off.is_some_and(|off| off <= tolerance as f32);
        let moved_on = between.is_some_and(|between| between.abs() > 0.5 * turn);
        self.state = match self.state {
            RollerState::Constant => RollerState::Constant,
            RollerState::Sought => RollerState::Known,
            RollerState::Known if fits => RollerState::Known,
            RollerState::Lost if fits && moved_on => RollerState::Known,
            // Back and forth over the same pulse says nothing new.
            RollerState::Lost if fits => return,
            RollerState::Known | RollerState::Lost => RollerState::Lost,
        };
        self.since = Some(ago);
        if self.state == RollerState::Known {
            self.track.set(self.configuration.phase);
            self.track.advance(ago);
        }
    }

    #[inline]
    pub fn secant(&self, ahead: RollerAngle) -> Value {
        let secant = &self.configuration.secant;
        let unknown = secant.unknown();
        if self.share == 0 {
            return unknown;
        }
        let known = secant.at(self.track.angle().advanced(ahead));
        if self.share == BLEND {
            known
        } else {
            scalar::between(unknown, known, self.share, BLEND)
        }
    }
}

/// The nearest whole number.
#[expect(
    clippy::cast_possible_truncation,
    reason = "cut on purpose; turns between two pulses are few"
)]
fn whole(value: f32) -> f32 {
    (value + 0.5_f32.copysign(value)) as i32 as f32
}
