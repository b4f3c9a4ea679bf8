//! The index of each encoder: a pulse once a turn, at an angle of its own.
//!
//! A pulse begins when the wheel comes to the count the index stands at, from either side. Where that is, the seed
//! says; a wheel's rollers stand somewhere else yet ([`crate::plant::contact::phases`]), and how they stand at the
//! index is what a robot has to be told ([`roller_phases`]).

use std::f64::consts::TAU;

use group::{GroupFile, Plant};

use crate::plant::contact::{Contact, phases};
use crate::random::Random;

/// Makes the indexes' angles independent of the rollers'.
const SALT: u64 = 0x0049_4E44_4558;
/// Stray pulses of a noisy index in a turn, on average.
const STRAY: f64 = 3.0;

/// What an index tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum IndexState {
    /// One pulse a turn.
    #[default]
    Works,
    /// Nothing: a broken wire.
    Missing,
    /// A second pulse half a turn on.
    Double,
    /// Stray pulses between, three a turn on average.
    Noisy,
}

/// The four indexes of a robot.
#[derive(Debug, Clone)]
pub struct Indexes {
    /// Counts of a turn.
    turn: i64,
    /// Counts at which the pulses begin, within a turn.
    at: [i64; 4],
    pub(super) state: [IndexState; 4],
    /// Where the wheels stand, counts.
    counts: [i64; 4],
    random: Random,
}

/// Angles of the indexes from where the wheels stand at the beginning, one row a robot, rad.
#[must_use]
pub fn angles(group: &GroupFile) -> Vec<[f64; 4]> {
    let places = 0..group.robots.len();
    places
        .map(|place| robot_angles(group.simulation.seed, place))
        .collect()
}

/// Those of one robot, by its place in the group file.
pub(super) fn robot_angles(seed: u64, place: usize) -> [f64; 4] {
    let mut random = Random::new((seed ^ SALT).wrapping_add(place as u64));
    std::array::from_fn(|_| TAU * random.unit())
}

/// How far each wheel has rolled on past a roller's middle when its index comes, within half a pitch, one row a robot,
/// rad: what a calibration finds. `None` for plants without rollers.
#[must_use]
pub fn roller_phases(group: &GroupFile) -> Option<Vec<[f64; 4]>> {
    let Plant::Contact { rollers } = group.simulation.plant else {
        return None;
    };
    let pitch = TAU / f64::from(rollers);
    let phases = phases(group, &Contact::of(group, rollers));
    let rows = phases.iter().zip(angles(group));
    let fold = |angle: f64| angle - (angle / pitch).round() * pitch;
    Some(
        rows.map(|(phases, angles)| std::array::from_fn(|n| fold(phases[n] + angles[n])))
            .collect(),
    )
}

impl Indexes {
    /// The indexes of one robot at these angles, of encoders with these counts a turn.
    pub fn new(angles: &[f64; 4], counts_per_turn: f64, seed: u64) -> Self {
        let turn = counts_per_turn.round().max(1.0);
        Self {
            turn: turn as i64,
            at: angles.map(|angle| (angle / TAU * turn).floor() as i64),
            state: [IndexState::default(); 4],
            counts: [0; 4],
            random: Random::new(seed ^ SALT),
        }
    }

    /// Follows a wheel to an angle (rad): how many counts ago the last pulse began, if one did.
    pub fn follow(&mut self, wheel: usize, angle: f64) -> Option<i32> {
        let to = (angle / TAU * self.turn as f64).floor() as i64;
        let from = std::mem::replace(&mut self.counts[wheel], to);
        self.passed(wheel, from, to).map(|ago| ago as i32)
    }

    /// The wheel went from one count to another: how many counts ago the last pulse began, if one did.
    fn passed(&mut self, wheel: usize, from: i64, to: i64) -> Option<i64> {
        if from == to {
            return None;
        }
        let at = self.at[wheel];
        let last = |at: i64, turn: i64| {
            // The last count of the way that is the index's.
            let at = if to > from {
                to - (to - at).rem_euclid(turn)
            } else {
                to + (at - to).rem_euclid(turn)
            };
            let on_the_way = if to > from { at > from } else { at < from };
            on_the_way.then_some(to - at)
        };
        match self.state[wheel] {
            IndexState::Works => last(at, self.turn),
            IndexState::Missing => None,
            IndexState::Double => last(at, self.turn / 2),
            IndexState::Noisy => {
                let chance = STRAY * (to - from).unsigned_abs() as f64 / self.turn as f64;
                let stray = self.random.unit() < chance;
                last(at, self.turn).or(stray.then_some(0))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn indexes(state: IndexState) -> Indexes {
        // A quarter turn of 1000 counts.
        let mut indexes = Indexes::new(&[TAU / 4.0; 4], 1000.0, 1);
        indexes.state = [state; 4];
        indexes
    }

    #[test]
    fn a_pulse_begins_at_its_count_from_either_side() {
        let mut works = indexes(IndexState::Works);
        assert_eq!(works.passed(0, 200, 249), None);
        assert_eq!(works.passed(0, 249, 250), Some(0));
        assert_eq!(works.passed(0, 250, 260), None);
        assert_eq!(works.passed(0, 260, 240), Some(-10));
        assert_eq!(works.passed(0, 1240, 1257), Some(7));
        assert_eq!(works.passed(0, -740, -760), Some(-10));
        assert_eq!(works.passed(0, 250, 250), None);
    }

    #[test]
    fn faults_are_what_they_are_called() {
        assert_eq!(indexes(IndexState::Missing).passed(0, 0, 900), None);
        assert_eq!(indexes(IndexState::Double).passed(0, 700, 760), Some(10));
        let mut noisy = indexes(IndexState::Noisy);
        let strays = (0..100_000)
            .filter(|count| count % 1000 != 249 && noisy.passed(0, *count, count + 1).is_some())
            .count();
        // Three a turn over a hundred turns: 300, standard deviation 17.
        assert!((215..385).contains(&strays), "{strays}");
    }
}
