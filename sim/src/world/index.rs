//! The index of each wheel: a pulse once a turn of the wheel, at an angle of its own.
//!
//! With an encoder on the wheel it is the encoder's index; with a gear it represents a sensor on
//! the wheel, and the play of the gear lies between it and the counts. A pulse begins when the
//! wheel reaches the angle of the index, from either side. The seed determines that angle. The
//! rollers of a wheel have an independent initial angle ([`crate::plant::contact::phases`]); their
//! angle at the index is the parameter that a robot needs ([`roller_phases`]).

use std::f64::consts::TAU;

use group::{GroupFile, Plant};

use crate::plant::contact::{Contact, phases};
use crate::random::Random;

/// Makes the indexes' angles independent of the rollers'.
const SALT: u64 = 0x0049_4E44_4558;
/// Stray pulses of a noisy index in a turn, on average.
const STRAY: f64 = 3.0;

/// The state of an index.
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

/// A pulse that has begun.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pulse {
    /// Counts by which the encoder has gone on since.
    pub counts_ago: i32,
    /// World time at which it began, ns.
    pub at_ns: u64,
}

/// The four indexes of a robot.
#[derive(Debug, Clone)]
pub struct Indexes {
    /// Encoder counts in a radian of a wheel, gear included.
    counts_per_rad: f64,
    /// Where the pulses begin, rad.
    at: [f64; 4],
    pub(super) state: [IndexState; 4],
    /// Where the wheels stand, rad.
    angles: [f64; 4],
    /// The pulses' angles on either side of that, the lower one first.
    between: [[f64; 4]; 2],
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

/// How far each wheel has rolled on past a roller's middle when its index comes, within half a
/// pitch, one row a robot, rad: what a calibration finds. `None` for plants without rollers.
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
    /// The indexes of one robot at these angles, with encoders of so many counts in a turn of a
    /// wheel.
    pub fn new(angles: &[f64; 4], counts_per_turn: f64, seed: u64) -> Self {
        Self {
            counts_per_rad: counts_per_turn / TAU,
            at: *angles,
            state: [IndexState::default(); 4],
            angles: [0.0; 4],
            between: [[0.0; 4]; 2],
            random: Random::new(seed ^ SALT),
        }
    }

    /// Follows the wheels to these angles (rad) if all stay between two pulses, as nearly always;
    /// only for indexes that work.
    #[inline]
    pub fn stays_between_pulses(&mut self, angles: [f64; 4]) -> bool {
        let [low, high] = &self.between;
        let stays = |n: usize| low[n] < angles[n] && angles[n] < high[n];
        let stay = stays(0) & stays(1) & stays(2) & stays(3);
        if stay {
            self.angles = angles;
        }
        stay
    }

    /// Follows a wheel to an angle (rad) in a span of time (ns) while its encoder has come to
    /// another angle: when the last pulse began, if one did.
    #[inline]
    pub fn follow(
        &mut self,
        wheel: usize,
        angle: f64,
        encoder: f64,
        span_ns: (u64, u64),
    ) -> Option<Pulse> {
        let from = std::mem::replace(&mut self.angles[wheel], angle);
        let [low, high] = &self.between;
        if low[wheel] < angle && angle < high[wheel] && self.state[wheel] == IndexState::Works {
            return None;
        }
        self.pulse(wheel, (from, angle), encoder, span_ns)
    }

    /// The last pulse of a wheel that went from one angle to another, if one began.
    fn pulse(
        &mut self,
        wheel: usize,
        (from, to): (f64, f64),
        encoder: f64,
        (begin_ns, end_ns): (u64, u64),
    ) -> Option<Pulse> {
        let at = self.passed(wheel, from, to)?;
        // Where the encoder stood then: the two move together while the wheel moves.
        let count = |angle: f64| (angle * self.counts_per_rad).floor() as i64;
        let share = (to - at) / (to - from);
        Some(Pulse {
            counts_ago: (count(encoder) - count(encoder - (to - at))) as i32,
            at_ns: end_ns - (share * (end_ns - begin_ns) as f64).round() as u64,
        })
    }

    /// The wheel went from one angle to another: where the last pulse began, if one did.
    fn passed(&mut self, wheel: usize, from: f64, to: f64) -> Option<f64> {
        if from == to {
            return None;
        }
        let at = self.at[wheel];
        let turns = ((to - at) / TAU).floor();
        self.between[0][wheel] = at + turns * TAU;
        self.between[1][wheel] = at + (turns + 1.0) * TAU;
        let last = |period: f64| {
            let turns = (to - at) / period;
            let turns = if to > from {
                turns.floor()
            } else {
                turns.ceil()
            };
            let angle = at + turns * period;
            let on_the_way = if to > from {
                angle > from
            } else {
                angle < from
            };
            on_the_way.then_some(angle)
        };
        match self.state[wheel] {
            IndexState::Works => last(TAU),
            IndexState::Missing => None,
            IndexState::Double => last(TAU / 2.0),
            IndexState::Noisy => {
                let stray = self.random.unit() < STRAY * (to - from).abs() / TAU;
                last(TAU).or(stray.then_some(to))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts of a wheel's turn: 48 of a shaft, 26.85 of those.
    const TURN: f64 = 48.0 * 26.85;

    /// A quarter of a turn on.
    fn indexes(state: IndexState) -> Indexes {
        let mut indexes = Indexes::new(&[TAU / 4.0; 4], TURN, 1);
        indexes.state = [state; 4];
        indexes
    }

    /// Both given in turns.
    fn passed(indexes: &mut Indexes, from: f64, to: f64) -> Option<f64> {
        let found = indexes.passed(0, from * TAU, to * TAU)?;
        Some((found / TAU * 1e9).round() / 1e9)
    }

    #[test]
    fn a_pulse_begins_at_its_angle_from_either_side() {
        let works = &mut indexes(IndexState::Works);
        assert_eq!(passed(works, 0.2, 0.249), None);
        assert_eq!(passed(works, 0.249, 0.26), Some(0.25));
        assert_eq!(passed(works, 0.26, 0.27), None);
        assert_eq!(passed(works, 0.26, 0.24), Some(0.25));
        assert_eq!(passed(works, 1.24, 1.257), Some(1.25));
        assert_eq!(passed(works, -0.74, -0.76), Some(-0.75));
        assert_eq!(passed(works, 0.3, 0.3), None);
    }

    /// Told in counts of the encoder, which has play to go before the wheel follows.
    #[test]
    fn the_encoder_is_read_where_it_stood_at_the_pulse() {
        let mut works = indexes(IndexState::Works);
        let rad = TAU / TURN;
        let (at, play) = (TAU / 4.0, 10.2 * rad);
        let mut to = |counts: f64, play: f64, span| {
            let angle = at + counts * rad;
            let pulse = works.follow(0, angle, angle + play, span)?;
            Some((pulse.counts_ago, pulse.at_ns))
        };
        assert_eq!(to(-1.0, play, (0, 1_000)), None);
        // Three counts on, of which the pulse was after the first.
        assert_eq!(to(2.0, play, (1_000, 4_000)), Some((2, 2_000)));
        // 1e-6 before the count: the same place from the other side, with the play behind.
        assert_eq!(to(-3.0, -play, (4_000, 9_000)), Some((-3, 6_000)));
    }

    #[test]
    fn faults_are_what_they_are_called() {
        assert_eq!(passed(&mut indexes(IndexState::Missing), 0.0, 0.9), None);
        assert_eq!(
            passed(&mut indexes(IndexState::Double), 0.7, 0.76),
            Some(0.75)
        );
        let mut noisy = indexes(IndexState::Noisy);
        let strays = (0..100_000)
            .map(|step| (f64::from(step) / 1e3, f64::from(step + 1) / 1e3))
            .filter(|(from, to)| {
                let found = passed(&mut noisy, *from, *to);
                found.is_some_and(|at| (at - at.floor() - 0.25).abs() > 1e-6)
            })
            .count();
        // Three a turn over a hundred turns: 300, standard deviation 17.
        assert!((215..385).contains(&strays), "{strays}");
    }
}
