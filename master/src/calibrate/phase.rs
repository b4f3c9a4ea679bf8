//! Roller phases from a robot's motion.
//!
//! A wheel whose index has been seen knows its angle, but not how its rollers stand there. While the robot moves
//! sideways or turns slowly, each wheel's ripple shows in the pose. The wheels' angles and the pose are cut into
//! intervals of about a twelfth of a roller; for assumed phases the wheels' angle increments predict the robot's
//! displacement in each ([`PhasePlatform`] with secants that are means over the interval); the phases are those with the
//! smallest squared difference. Three gains, one an axis, go along, so that constant slip does not matter.
//!
//! First each wheel is tried alone over a whole pitch, by the rolling condition of its own contact; from there the four
//! are refined together by Gauss-Newton steps, because wheels that contradict each other share the slip. The interval of
//! 95 % follows from the residual and the curvature, widened for residuals that are not independent.
//!
//! Nothing is returned that the data do not show: too few rollers passed, a ripple that explains too little, or an
//! interval that is wide against a roller are refused by name.

use kinematics::{FourWheelGeometry, PhasePlatform, Rollers, Twist};

/// Passages of a roller that every wheel needs.
const PASSAGES: f64 = 3.0;
/// Intervals in a passage.
const INTERVALS: f64 = 12.0;
/// Share of the ripple's squares that the phases have to explain.
const EXPLAINED: f64 = 0.5;
/// Widest half interval of confidence, pitches.
const CONFIDENCE: f64 = 1.0 / 16.0;
/// Phases tried for each wheel.
const TRIES: u32 = 64;
/// Gauss-Newton steps.
const STEPS: usize = 12;
/// Two-sided 95 % of the normal distribution.
const NORMAL_95: f64 = 1.96;

/// A moment of a robot's motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Pose in any fixed frame, m and rad, heading unwrapped.
    pub pose: [f64; 3],
    /// Wheel angles since their index, rad, unwrapped: front left, front right, rear left, rear right.
    pub angles: [f64; 4],
}

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phases {
    /// Roller angle at the index, rad, within half a pitch.
    pub phases: [f64; 4],
    /// Half the interval of 95 % confidence, rad.
    pub confidence: [f64; 4],
    /// Root mean square of what is left in an interval's displacement, mm.
    pub residual_mm: f64,
    /// Share of the ripple's squares that the phases explain.
    pub explained: f64,
    /// Measured over predicted displacement: longitudinal, lateral, yaw; `None` where there was no such motion.
    pub gains: [Option<f64>; 3],
    /// Intervals used.
    pub intervals: usize,
}

/// Why no phases can be given.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PhaseError {
    /// The robot has not moved far enough.
    #[error(
        "{wheel} wheel: {passages:.1} rollers have passed, {PASSAGES} are needed; drive further sideways"
    )]
    TooShort {
        /// Which wheel.
        wheel: &'static str,
        /// Rollers that have passed.
        passages: f64,
    },
    /// The ripple is not there, or drowns.
    #[error(
        "the ripple is not observable: the best phases explain {percent:.0} % of what the mean leaves, 50 are needed; move \
         sideways, more slowly, or use a pose source with less noise"
    )]
    NotObservable {
        /// Share explained, per cent.
        percent: f64,
    },
    /// One wheel's phase could be nearly anything.
    #[error(
        "{wheel} wheel: the phase is only known to ±{degrees:.1} degrees, ±{limit:.1} are needed; drive longer, or use a \
         pose source with less noise"
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

/// One interval: what the robot did and between which wheel angles.
struct Interval {
    /// Displacement in the robot's own frame at the middle of the interval: m, m, rad.
    moved: [f64; 3],
    from: [f64; 4],
    to: [f64; 4],
}

struct Problem {
    rollers: Rollers<f64>,
    platform: PhasePlatform<4, f64>,
    intervals: Vec<Interval>,
    /// By what a turn is multiplied to be compared with metres.
    lever: f64,
}

/// Finds the phases. `motions` are stretches of continuous samples, in any order; the robot may have stood between them.
///
/// # Errors
/// [`PhaseError`] when the data do not show them.
pub fn estimate(
    geometry: &FourWheelGeometry<f64>,
    rollers: Rollers<f64>,
    motions: &[Vec<Sample>],
) -> Result<Phases, PhaseError> {
    let wheels = geometry.wheels().map_err(|_| PhaseError::Geometry)?;
    let platform = PhasePlatform::new(&wheels).map_err(|_| PhaseError::Geometry)?;
    let mut passed = [0.0; 4];
    for motion in motions {
        for pair in motion.windows(2) {
            for (passed, (from, to)) in passed
                .iter_mut()
                .zip(pair[0].angles.iter().zip(pair[1].angles))
            {
                *passed += (to - from).abs() / rollers.pitch();
            }
        }
    }
    for (wheel, passages) in WHEELS.into_iter().zip(passed) {
        if passages < PASSAGES {
            return Err(PhaseError::TooShort { wheel, passages });
        }
    }
    let problem = Problem {
        intervals: motions
            .iter()
            .flat_map(|motion| cut(motion, rollers.pitch() / INTERVALS))
            .collect(),
        rollers,
        platform,
        lever: geometry.half_track() + geometry.half_wheelbase(),
    };
    let mut phases = [0, 1, 2, 3].map(|wheel| problem.alone(&wheels[wheel], wheel));
    problem.refine(&mut phases);
    problem.judge(phases)
}

/// Cuts a motion into intervals in which some wheel turns by `least` rad.
fn cut(motion: &[Sample], least: f64) -> Vec<Interval> {
    let mut out = Vec::new();
    let Some(mut from) = motion.first() else {
        return out;
    };
    for to in motion {
        let turned = from
            .angles
            .iter()
            .zip(to.angles)
            .map(|(a, b)| (b - a).abs());
        if turned.fold(0.0, f64::max) < least {
            continue;
        }
        let [dx, dy, turn] = [0, 1, 2].map(|n| to.pose[n] - from.pose[n]);
        let (sin, cos) = (from.pose[2] + 0.5 * turn).sin_cos();
        out.push(Interval {
            moved: [cos * dx + sin * dy, cos * dy - sin * dx, turn],
            from: from.angles,
            to: to.angles,
        });
        from = to;
    }
    out
}

impl Problem {
    /// The mean secant of a wheel over an interval.
    fn secant(&self, interval: &Interval, wheel: usize, phase: f64) -> f64 {
        let ratio = self.rollers.mean_lateral_ratio_between(
            interval.from[wheel],
            interval.to[wheel],
            phase,
        );
        1.0 / ratio
    }

    /// The displacement that the wheels mean in an interval.
    fn predicted(&self, interval: &Interval, phases: &[f64; 4]) -> [f64; 3] {
        let secants = std::array::from_fn(|n| self.secant(interval, n, phases[n]));
        let turned = std::array::from_fn(|n| interval.to[n] - interval.from[n]);
        let Twist { vx, vy, omega } = self
            .platform
            .twist(&turned, &secants)
            .unwrap_or(Twist::new(0.0, 0.0, 0.0));
        [vx, vy, omega]
    }

    /// What is left of the displacements, axis after axis, turns as metres at the lever; and the gain of each axis by
    /// least squares, 1 for an axis with next to no motion.
    fn residual(&self, phases: &[f64; 4]) -> (Vec<f64>, [Option<f64>; 3]) {
        let weights = [1.0, 1.0, self.lever];
        let predicted: Vec<_> = self
            .intervals
            .iter()
            .map(|interval| self.predicted(interval, phases))
            .collect();
        let squares = [0, 1, 2].map(|axis| {
            let square = predicted.iter().map(|p| p[axis] * p[axis]).sum::<f64>();
            square * weights[axis] * weights[axis]
        });
        let most = squares.iter().copied().fold(0.0, f64::max);
        let mut left = Vec::with_capacity(3 * predicted.len());
        let gains = [0, 1, 2].map(|axis| {
            let pairs = || {
                predicted
                    .iter()
                    .zip(&self.intervals)
                    .map(|(p, i)| (p[axis], i.moved[axis]))
            };
            let product: f64 = pairs().map(|(p, m)| p * m).sum();
            let square: f64 = pairs().map(|(p, _)| p * p).sum();
            let gain = (squares[axis] > 0.01 * most).then(|| product / square);
            left.extend(pairs().map(|(p, m)| (m - gain.unwrap_or(1.0) * p) * weights[axis]));
            gain
        });
        (left, gains)
    }

    /// The phase of one wheel by its own rolling condition, for a start.
    fn alone(&self, wheel: &kinematics::Wheel<f64>, index: usize) -> f64 {
        let (straight, across) = wheel.jacobian_parts();
        let pitch = self.rollers.pitch();
        let cost = |phase: f64| {
            let (mut xy, mut xx, mut yy) = (0.0, 0.0, 0.0);
            for interval in &self.intervals {
                let y = interval.to[index] - interval.from[index] - dot(&straight, &interval.moved);
                let x = self.secant(interval, index, phase) * dot(&across, &interval.moved);
                xy += x * y;
                xx += x * x;
                yy += y * y;
            }
            yy - xy * xy / xx.max(f64::MIN_POSITIVE)
        };
        (0..TRIES)
            .map(|n| (f64::from(n) / f64::from(TRIES) - 0.5) * pitch)
            .min_by(|a, b| cost(*a).total_cmp(&cost(*b)))
            .unwrap_or(0.0)
    }

    /// Derivatives of the residual by the phases.
    fn slopes(&self, phases: &[f64; 4]) -> [Vec<f64>; 4] {
        let step = 1e-4 * self.rollers.pitch();
        [0, 1, 2, 3].map(|wheel| {
            let at = |by: f64| {
                let mut moved = *phases;
                moved[wheel] += by;
                self.residual(&moved).0
            };
            let (after, before) = (at(step), at(-step));
            let pairs = after.iter().zip(before);
            pairs
                .map(|(after, before)| (after - before) / (2.0 * step))
                .collect()
        })
    }

    /// Gauss-Newton, each step at most a twentieth of a pitch.
    fn refine(&self, phases: &mut [f64; 4]) {
        let longest = self.rollers.pitch() / 20.0;
        for _ in 0..STEPS {
            let slopes = self.slopes(phases);
            let (left, _) = self.residual(phases);
            let Some(inverse) = inverse(&slopes) else {
                return;
            };
            let pull = [0, 1, 2, 3].map(|n| dot(&slopes[n], &left));
            for (phase, row) in phases.iter_mut().zip(inverse) {
                *phase -= dot(&row, &pull).clamp(-longest, longest);
            }
        }
    }

    fn judge(&self, phases: [f64; 4]) -> Result<Phases, PhaseError> {
        let pitch = self.rollers.pitch();
        let (left, gains) = self.residual(&phases);
        let squares = dot(&left, &left);
        // What a mean over all phases would leave.
        let mean: f64 = (0..TRIES)
            .map(|n| {
                let by = pitch * f64::from(n) / f64::from(TRIES);
                let left = self.residual(&phases.map(|phase| phase + by)).0;
                dot(&left, &left)
            })
            .sum::<f64>()
            / f64::from(TRIES);
        let explained = 1.0 - squares / mean.max(f64::MIN_POSITIVE);
        if explained < EXPLAINED || explained.is_nan() {
            return Err(PhaseError::NotObservable {
                percent: explained.max(0.0) * 100.0,
            });
        }
        let count = left.len();
        let variance = squares / (count.saturating_sub(7)).max(1) as f64;
        // Residuals that follow their predecessor count less: by (1 + r) / (1 - r).
        let follow = dot(&left[..count - 1], &left[1..]) / squares.max(f64::MIN_POSITIVE);
        let follow = follow.clamp(0.0, 0.95);
        let slopes = self.slopes(&phases);
        let inverse = inverse(&slopes).ok_or(PhaseError::NotObservable { percent: 0.0 })?;
        let confidence: [f64; 4] = std::array::from_fn(|n| {
            NORMAL_95 * (variance * inverse[n][n] * (1.0 + follow) / (1.0 - follow)).sqrt()
        });
        for (wheel, confidence) in WHEELS.into_iter().zip(confidence) {
            if confidence > CONFIDENCE * pitch || confidence.is_nan() {
                return Err(PhaseError::Unsure {
                    wheel,
                    degrees: confidence.to_degrees(),
                    limit: (CONFIDENCE * pitch).to_degrees(),
                });
            }
        }
        Ok(Phases {
            phases: phases.map(|phase| phase - (phase / pitch).round() * pitch),
            confidence,
            residual_mm: (squares / count.max(1) as f64).sqrt() * 1e3,
            explained,
            gains,
            intervals: self.intervals.len(),
        })
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The inverse of the columns' products with each other; `None` when they do not span four directions.
fn inverse(columns: &[Vec<f64>; 4]) -> Option<[[f64; 4]; 4]> {
    // Gauss-Jordan with the identity beside; the matrix is symmetric and positive, so no pivoting.
    let mut rows: [[f64; 8]; 4] = std::array::from_fn(|i| {
        std::array::from_fn(|j| match j {
            0..4 => dot(&columns[i], &columns[j]),
            _ => f64::from(u8::from(j == i + 4)),
        })
    });
    let largest = (0..4).map(|n| rows[n][n]).fold(0.0, f64::max);
    for pivot in 0..4 {
        let head = rows[pivot][pivot];
        if head <= 1e-9 * largest || head.is_nan() {
            return None;
        }
        let row = rows[pivot].map(|entry| entry / head);
        for (n, other) in rows.iter_mut().enumerate() {
            let factor = other[pivot];
            if n == pivot {
                *other = row;
            } else {
                for (entry, from) in other.iter_mut().zip(row) {
                    *entry -= factor * from;
                }
            }
        }
    }
    Some(rows.map(|row| [row[4], row[5], row[6], row[7]]))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PHASES: [f64; 4] = [0.1, -0.3, 0.25, 0.0];

    fn robot() -> FourWheelGeometry<f64> {
        FourWheelGeometry::new(0.370, 0.350, 0.1524, 45_f64.to_radians()).unwrap()
    }

    /// A pseudo-random number in ±1.
    fn noise(state: &mut u64) -> f64 {
        *state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (*state >> 33) as f64 / (1_u64 << 30) as f64 - 1.0
    }

    /// Wheels turned evenly for so many seconds, and where rolling without slip takes the robot.
    fn motion(rates: [f64; 4], seconds: f64, noise_m: f64) -> Vec<Sample> {
        let rollers = Rollers::<f64>::new(8).unwrap();
        let platform = PhasePlatform::new(&robot().wheels().unwrap()).unwrap();
        const DT: f64 = 1e-3;
        let (mut pose, mut angles, mut state) = ([0.0_f64; 3], [0.0; 4], 7);
        let mut out = Vec::new();
        for k in 0..(seconds / DT) as u32 {
            if k % 10 == 0 {
                let mut seen = pose;
                seen[0] += noise_m * noise(&mut state);
                seen[1] += noise_m * noise(&mut state);
                out.push(Sample { pose: seen, angles });
            }
            let secants = std::array::from_fn(|n| {
                let ratio = rollers.mean_lateral_ratio_between(
                    angles[n],
                    angles[n] + rates[n] * DT,
                    PHASES[n],
                );
                1.0 / ratio
            });
            let t = platform.twist(&rates, &secants).unwrap();
            let (sin, cos) = (pose[2] + 0.5 * t.omega * DT).sin_cos();
            // Two per cent of the sideways motion are lost: the gain has to find them.
            let vy = 0.98 * t.vy;
            pose[0] += (cos * t.vx - sin * vy) * DT;
            pose[1] += (sin * t.vx + cos * vy) * DT;
            pose[2] += t.omega * DT;
            for (angle, rate) in angles.iter_mut().zip(rates) {
                *angle += rate * DT;
            }
        }
        out
    }

    const LEFT: [f64; 4] = [-1.0, 1.0, 1.0, -1.0];
    const TURN: [f64; 4] = [-1.0, 1.0, -1.0, 1.0];

    #[test]
    fn finds_the_phases_it_was_made_with() {
        let rollers = Rollers::new(8).unwrap();
        let found = estimate(
            &robot(),
            rollers,
            &[motion(LEFT, 6.0, 0.0), motion(TURN, 6.0, 0.0)],
        )
        .unwrap();
        for (found, made) in found.phases.iter().zip(PHASES) {
            // A thousandth of a pitch.
            assert!((found - made).abs() < 1e-3, "{found} {made}");
        }
        assert!(found.explained > 0.99, "{found:?}");
        assert!((found.gains[1].unwrap() - 0.98).abs() < 1e-3, "{found:?}");
    }

    /// With noise the truth lies within the interval it gives (times 1.5 for four wheels at once).
    #[test]
    fn says_how_sure_it_is() {
        let rollers = Rollers::new(8).unwrap();
        let motions = [motion(LEFT, 10.0, 1e-4), motion(TURN, 10.0, 1e-4)];
        let found = estimate(&robot(), rollers, &motions).unwrap();
        for ((found, made), interval) in found.phases.iter().zip(PHASES).zip(found.confidence) {
            assert!(
                (found - made).abs() < 1.5 * interval,
                "{found} {made} ± {interval}"
            );
            assert!(interval > 1e-5 && interval < 0.05, "{interval}");
        }
    }

    #[test]
    fn refuses_what_shows_no_ripple() {
        let rollers = Rollers::new(8).unwrap();
        let short = estimate(&robot(), rollers, &[motion(LEFT, 1.0, 0.0)]);
        assert!(
            matches!(
                short,
                Err(PhaseError::TooShort {
                    wheel: "front left",
                    ..
                })
            ),
            "{short:?}"
        );
        // Straight ahead no roller leans.
        let ahead = estimate(&robot(), rollers, &[motion([1.0; 4], 6.0, 1e-6)]);
        assert!(ahead.is_err(), "{ahead:?}");
        // A ripple of millimetres under centimetres of noise.
        let noisy = estimate(&robot(), rollers, &[motion(LEFT, 6.0, 0.02)]);
        assert!(noisy.is_err(), "{noisy:?}");
    }
}
