//! Roller phases from a robot's motion.
//!
//! After a wheel's index has passed, the wheel's angle is known, but not the angle of its rollers.
//! While the robot moves, each wheel's ripple shows in the robot's pose, and in its yaw rate alone
//! if all wheels turn at different rates. Wheel angles and samples are cut into intervals of about
//! a twelfth of a roller. For assumed phases the wheels' angle increments predict the robot's
//! displacement in each interval ([`model`]), and the phases with the smallest squared difference
//! are the result ([`fit`]). Gains, delays and the bias of a gyro are fitted as well, so that
//! constant slip and late clocks do not matter.
//!
//! The 95 % interval follows from how the residuals pull on a phase and how they correlate, widened
//! for what the model leaves out. Data that do not determine the phases are refused by name: too
//! few passages of rollers, samples too slow for the ripple, a turn that is not the wheels', a
//! ripple that explains too little, or an interval that is wide compared with a roller.

mod fit;
mod intervals;
mod model;
mod solve;

use kinematics::{FourWheelGeometry, Rollers};
use serde::{Deserialize, Serialize};

use fit::{Fit, Problem};
use model::Model;

/// Passages of a roller that every wheel needs.
const PASSAGES: f64 = 3.0;
/// Intervals in a passage.
const INTERVALS: f64 = 12.0;
/// Samples of a gyro that a passage needs.
const SAMPLES: f64 = 6.0;
/// Share that the phases have to explain of what wheels without ripple leave. Where there is none,
/// or one of other rollers, a ripple explains less than nothing; the rest is for the intervals of
/// confidence to say.
const EXPLAINED: f64 = 0.1;
/// Widest half interval of confidence, pitches.
const CONFIDENCE: f64 = 1.0 / 16.0;
/// Standard deviation of what the model leaves out of a phase and no residual shows, pitches. In a
/// multi-body simulation, which is not of the model's kind, errors are normal with this variance
/// and the fit's: the value of greatest likelihood for 13 robots with other friction, mass, rollers
/// and contacts (`docs/kinematics.md`). The contact plant needs a fifth of it.
const MODEL: f64 = 2.4e-3;
/// The least and the most that a gyro may show of the wheels' turn.
const YAW_GAIN: std::ops::RangeInclusive<f64> = 0.7..=1.4;
/// A ramp is where the rate of a wheel changes by more than this share of the fastest wheel's...
const UNEVEN: f64 = 0.25;
/// ... from one stretch this long to another, s, on both sides of an interval.
const ASIDE: f64 = 0.1;
/// Two-sided 95 % of the normal distribution.
const NORMAL_95: f64 = 1.96;

/// What a source saw of a robot, with times (s) on one clock with the wheels' but for a constant
/// delay.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Samples {
    /// Poses in any fixed frame, m and rad, heading unwrapped.
    Poses(Vec<(f64, [f64; 3])>),
    /// Yaw rates, rad/s, counter-clockwise positive, each the mean since the one before.
    YawRates(Vec<(f64, f64)>),
}

/// A stretch of continuous motion, from rest to rest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Motion {
    /// Times of the wheel angles, s, rising.
    pub times: Vec<f64>,
    /// Wheel angles since their index, rad, unwrapped: front left, front right, rear left, rear
    /// right.
    pub angles: Vec<[f64; 4]>,
    /// What was seen meanwhile.
    pub seen: Samples,
}

impl Motion {
    /// The wheels at a time, which before and after are where they were first and last.
    fn angles_at(&self, t: f64) -> [f64; 4] {
        let after = self.times.partition_point(|at| *at < t);
        let (Some(before), Some(to)) = (after.checked_sub(1), self.angles.get(after)) else {
            let end = if after == 0 {
                self.angles.first()
            } else {
                self.angles.last()
            };
            return end.copied().unwrap_or_default();
        };
        let from = self.angles[before];
        let share = (t - self.times[before]) / (self.times[after] - self.times[before]);
        std::array::from_fn(|n| from[n] + share * (to[n] - from[n]))
    }

    /// Whether the wheels turn as fast before a stretch of time as they do after it, but for the
    /// ripple of their rates.
    fn is_even(&self, from: f64, to: f64) -> bool {
        let most = UNEVEN * self.fastest() * ASIDE;
        let [a, b, c, d] = [from - ASIDE, from, to, to + ASIDE].map(|t| self.angles_at(t));
        (0..4).all(|n| ((b[n] - a[n]) - (d[n] - c[n])).abs() <= most)
    }

    /// How far each wheel turned, rad, there and back counted twice.
    fn turned(&self) -> [f64; 4] {
        let pairs = self.angles.windows(2);
        pairs.fold([0.0; 4], |sum, pair| {
            std::array::from_fn(|n| sum[n] + (pair[1][n] - pair[0][n]).abs())
        })
    }

    fn seconds(&self) -> f64 {
        self.times.last().unwrap_or(&0.0) - self.times.first().unwrap_or(&0.0)
    }

    fn middle(&self) -> f64 {
        self.times.first().unwrap_or(&0.0) + 0.5 * self.seconds()
    }

    /// Mean rate of the wheel that turned furthest, rad/s.
    fn fastest(&self) -> f64 {
        self.turned().into_iter().fold(0.0, f64::max) / self.seconds().max(f64::MIN_POSITIVE)
    }
}

/// What is left when the phases are known, root mean square.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Residual {
    /// Of an interval's displacement, m.
    Displacement(f64),
    /// Of the yaw rate over an interval, rad/s.
    YawRate(f64),
}

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phases {
    /// Roller angle at the index, rad, within half a pitch.
    pub phases: [f64; 4],
    /// Half the interval of 95 % confidence, rad.
    pub confidence: [f64; 4],
    /// What is left.
    pub residual: Residual,
    /// Share that the phases explain of what wheels without ripple leave.
    pub explained: f64,
    /// Ratio of the measured turn to the wheels'.
    pub yaw_gain: f64,
    /// Intervals used.
    pub intervals: usize,
}

/// Why no phases can be given.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PhaseError {
    /// The robot has not moved far enough.
    #[error(
        "{wheel} wheel: {passages:.1} rollers have passed, and {PASSAGES} are needed; drive further \
         (--repeats)"
    )]
    TooShort {
        /// Which wheel.
        wheel: &'static str,
        /// Rollers that have passed.
        passages: f64,
    },
    /// The gyro is too slow for the wheels.
    #[error(
        "the gyro sent as few as {hz:.1} samples a second; {needed:.0} are needed while a roller \
         of the fastest wheel passes: configure it for 100 or 200 a second"
    )]
    TooSlow {
        /// Its samples.
        hz: f64,
        /// What is needed.
        needed: f64,
    },
    /// The gyro shows another turn than the wheels.
    #[error(
        "the gyro shows {gain:.2} times the turn that the wheels make; yaw_rate must be in rad/s \
         about the axis that points up, counter-clockwise positive: {advice}"
    )]
    OtherTurn {
        /// Measured over expected.
        gain: f64,
        /// What it looks like.
        advice: &'static str,
    },
    /// There is no ripple, or noise hides it.
    #[error(
        "the ripple is not observable: the best phases explain {percent:.0} % of the residual of \
         wheels without ripple, and 10 % are needed; check the number of rollers, and use a \
         quieter source of poses or gyro"
    )]
    NotObservable {
        /// Share explained, per cent.
        percent: f64,
    },
    /// The motions do not show a wheel's ripple by itself, or noise hides it.
    #[error(
        "{wheel} wheel: its ripple cannot be distinguished from the other wheels' or from noise; \
         every wheel has to turn at its own rate: calibrate the robots one by one, facing as the \
         group file says, or use a quieter source of poses or gyro"
    )]
    Alike {
        /// Which wheel.
        wheel: &'static str,
    },
    /// The interval of one wheel's phase is too wide.
    #[error(
        "{wheel} wheel: the phase is only known to ±{degrees:.1} degrees, and ±{limit:.1} are needed; \
         drive longer (--repeats), or use a quieter source of poses or gyro"
    )]
    Unsure {
        /// Which wheel.
        wheel: &'static str,
        /// Half interval of confidence.
        degrees: f64,
        /// Its bound.
        limit: f64,
    },
    /// The robot cannot be computed.
    #[error("the robot's geometry has no solution")]
    Geometry,
}

const WHEELS: [&str; 4] = ["front left", "front right", "rear left", "rear right"];

/// Finds the phases, from motions in any order that were all seen by the same source.
///
/// # Errors
/// [`PhaseError`] when the data do not show them.
pub fn estimate(
    geometry: &FourWheelGeometry<f64>,
    rollers: Rollers<f64>,
    motions: &[Motion],
) -> Result<Phases, PhaseError> {
    let pitch = rollers.pitch();
    let mut passed = [0.0; 4];
    for motion in motions {
        for (passed, turned) in passed.iter_mut().zip(motion.turned()) {
            *passed += turned / pitch;
        }
    }
    for (wheel, passages) in WHEELS.into_iter().zip(passed) {
        if passages < PASSAGES {
            return Err(PhaseError::TooShort { wheel, passages });
        }
    }
    for motion in motions {
        fast_enough(motion, pitch)?;
    }
    let model = Model::new(geometry, rollers).ok_or(PhaseError::Geometry)?;
    let lever = geometry.half_track() + geometry.half_wheelbase();
    let problem = Problem::new(model, motions, lever, pitch / INTERVALS);
    let unseen = PhaseError::NotObservable { percent: 0.0 };
    let without = problem.without_ripple().ok_or(unseen)?;
    let gyro = motions
        .iter()
        .any(|m| matches!(m.seen, Samples::YawRates(_)));
    let gain = without.yaw_gain();
    if gyro && !YAW_GAIN.contains(&gain) {
        let advice = if (20.0..150.0).contains(&gain.abs()) {
            "these look like degrees"
        } else if gain < 0.0 {
            "this one counts clockwise"
        } else {
            "is it fixed to this robot?"
        };
        return Err(PhaseError::OtherTurn { gain, advice });
    }
    let with = problem.with_ripple(&without)?;
    judge(&problem, &without, &with, pitch, gyro.then_some(lever))
}

/// Whether a gyro's samples show the ripple of the fastest wheel.
fn fast_enough(motion: &Motion, pitch: f64) -> Result<(), PhaseError> {
    let Samples::YawRates(samples) = &motion.seen else {
        return Ok(());
    };
    let gaps = samples.windows(2).map(|pair| pair[1].0 - pair[0].0);
    let widest = gaps.fold(0.0, f64::max);
    let needed = SAMPLES * motion.fastest() / pitch;
    let spread = samples.last().map_or(0.0, |s| s.0) - samples.first().map_or(0.0, |s| s.0);
    if widest * needed > 1.0 || spread < 0.9 * motion.seconds() {
        let hz = if widest > 0.0 { 1.0 / widest } else { 0.0 };
        return Err(PhaseError::TooSlow { hz, needed });
    }
    Ok(())
}

/// What the fit is worth. `lever` is that of a gyro's turns.
fn judge(
    problem: &Problem<'_>,
    without: &Fit,
    with: &Fit,
    pitch: f64,
    lever: Option<f64>,
) -> Result<Phases, PhaseError> {
    let explained = 1.0 - with.squares / without.squares.max(f64::MIN_POSITIVE);
    if explained < EXPLAINED || explained.is_nan() {
        return Err(PhaseError::NotObservable {
            percent: explained.max(0.0) * 100.0,
        });
    }
    let confidence = with
        .variances
        .map(|variance| NORMAL_95 * variance.sqrt().hypot(MODEL * pitch));
    for (wheel, confidence) in WHEELS.into_iter().zip(confidence) {
        if confidence > CONFIDENCE * pitch || confidence.is_nan() {
            return Err(PhaseError::Unsure {
                wheel,
                degrees: confidence.to_degrees(),
                limit: (CONFIDENCE * pitch).to_degrees(),
            });
        }
    }
    let rms = (with.squares / with.left.len().max(1) as f64).sqrt();
    Ok(Phases {
        phases: std::array::from_fn(|n| {
            let phase = with.parameters[n];
            phase - (phase / pitch).round() * pitch
        }),
        confidence,
        residual: match lever {
            None => Residual::Displacement(rms),
            Some(lever) => Residual::YawRate(rms / (lever * problem.seconds())),
        },
        explained,
        yaw_gain: with.yaw_gain(),
        intervals: problem.intervals(),
    })
}

#[cfg(test)]
mod tests;
