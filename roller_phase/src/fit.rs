//! The fit: linear start, then Gauss-Newton on the whole model.
//!
//! The unknowns beside the four phases are: the distance between a wheel's axle and its rollers',
//! the rollers' drag, the angle over which a wheel touches the floor, the time constant of creeping
//! contacts and the delay between source and bus (each once for translation and once for turns), a
//! gain for each axis, and for a gyro a bias and a drift in every motion. Each has a prior, mostly
//! so wide that it matters only where the data contain no information: an axis without motion has
//! no gain of its own.

use crate::intervals::{Interval, cut};
use crate::model::{Back, Lean, Model, Shape};
use crate::solve::{dot, invert};
use crate::{Motion, PhaseError, Samples, WHEELS};

/// Gauss-Newton steps.
const STEPS: usize = 30;
/// How often a step is halved at most.
const HALVINGS: i32 = 8;
/// Intervals over which residuals are taken to follow each other: two passages.
const MEMORY: usize = 24;
/// The fit is done when no phase moves by more, pitches.
const STILL: f64 = 1e-5;

/// Standard deviation to which a wheel's fundamental has to be known by itself, of its amplitude.
const LARGEST_SPREAD: f64 = 0.3;

/// Places of the parameters; the phases come first.
const DISTANCE: usize = 4;
/// The logarithm of the share: no roller pushes.
const DRAG: usize = 5;
const FOOTPRINT: usize = 6;
/// Logarithms of time constants.
const LAGS: [usize; 3] = [7, 7, 8];
const DELAYS: [usize; 3] = [9, 9, 10];
const GAINS: usize = 11;
/// Two a motion: bias (rad/s) and drift (rad/s^2).
const BIASES: usize = 14;

/// What the wheels do in an interval, for a delay.
#[derive(Clone, Copy)]
struct Rolled {
    /// At its ends.
    angles: [[f64; 4]; 2],
    leans: [Lean; 4],
    /// Displacement.
    moved: [f64; 3],
}

/// What the model means for some parameters, and what that was worked out from: near by, most of
/// it is the same.
struct Meant {
    parameters: Vec<f64>,
    /// Of all intervals, for one delay after the other.
    rolled: Vec<Rolled>,
    /// What the wheels mean on an axis, before gain and bias.
    bare: Vec<f64>,
}

pub(crate) struct Problem<'a> {
    model: Model,
    motions: &'a [Motion],
    intervals: Vec<Interval>,
    /// The axes that are measured.
    axes: &'static [usize],
    /// By what each axis is multiplied to be compared with the others: a turn is one at the wheels.
    weights: [f64; 3],
}

/// Where a fit ended.
pub(crate) struct Fit {
    /// In the order and the units of the model.
    pub parameters: Vec<f64>,
    /// What is left, axis after axis, turns as metres at the wheels.
    pub left: Vec<f64>,
    /// Sum of the squares of that, m^2.
    pub squares: f64,
    /// Of the phases, rad^2.
    pub variances: [f64; 4],
}

impl Fit {
    pub fn yaw_gain(&self) -> f64 {
        self.parameters[GAINS + 2]
    }
}

impl<'a> Problem<'a> {
    /// `finest` is the angle (rad) by which the fastest wheel turns in an interval at least.
    pub fn new(model: Model, motions: &'a [Motion], lever: f64, finest: f64) -> Self {
        let gyro = motions
            .iter()
            .any(|m| matches!(m.seen, Samples::YawRates(_)));
        let intervals = motions.iter().enumerate();
        Self {
            model,
            motions,
            intervals: intervals.flat_map(|(n, m)| cut(n, m, finest)).collect(),
            axes: if gyro { &[2] } else { &[0, 1, 2] },
            weights: [1.0, 1.0, lever],
        }
    }

    pub fn intervals(&self) -> usize {
        self.intervals.len()
    }

    /// Mean length of an interval, s.
    pub fn seconds(&self) -> f64 {
        let all: f64 = self.intervals.iter().map(|i| i.to - i.from).sum();
        all / self.intervals.len().max(1) as f64
    }

    fn has_bias(&self) -> bool {
        self.axes.len() == 1
    }

    /// Parameters to begin with, and how far each may be from there.
    fn priors(&self) -> Vec<(f64, f64)> {
        let radius = self.model.wheel_radius;
        let mut out = vec![(0.0, self.model.rollers.pitch()); 4];
        // A roller's radius is between a tenth and four tenths of the wheel's.
        out.push((0.75 * radius, 0.1 * radius));
        // At a calibration's 0.2 m/s, rolling about their own axles costs rollers up to a hundredth
        // or two of the load; creeping by 0.02 m/s costs a third of it. A factor of e either way.
        out.push((0.002_f64.ln(), 1.0));
        // A wheel that settles by a thousandth of its radius touches the floor 2.6 degrees to both
        // sides.
        out.push((0.045, 0.045));
        // Contacts trail by `2 c / (mu g)` if friction holds at the slip c: some milliseconds. A
        // factor of e either way.
        out.extend([(0.005_f64.ln(), 1.0); 2]);
        out.extend([(0.0, 0.05); 2]);
        if self.has_bias() {
            // What a gyro shows may be nonsense; that is to be seen.
            out.extend([(1.0, 1e3); 3]);
            out.extend(self.motions.iter().flat_map(|_| [(0.0, 1e3), (0.0, 1e2)]));
        } else {
            out.extend([(1.0, 0.2); 3]);
        }
        out
    }

    /// Wheel angles at both ends of an interval, for a delay.
    fn angles(&self, interval: &Interval, delay: f64) -> [[f64; 4]; 2] {
        let motion = &self.motions[interval.motion];
        [interval.from, interval.to].map(|t| motion.angles_at(t - delay))
    }

    /// The way back and the displacement for wheel angles at both ends.
    fn moved(
        &self,
        [from, to]: &[[f64; 4]; 2],
        leans: &[Lean; 4],
        drag: f64,
    ) -> Option<(Back, [f64; 3])> {
        let turned: [f64; 4] = std::array::from_fn(|n| to[n] - from[n]);
        let back = self.model.back(leans, drag)?;
        Some((back, back.map(|row| dot(&row, &turned))))
    }

    /// What the wheels do in all intervals, for the delay at a place among the parameters.
    fn rolled<'s>(
        &'s self,
        p: &'s [f64],
        ripple: bool,
        delay: usize,
        near: Option<(&'s [f64], &'s [Rolled])>,
    ) -> impl Iterator<Item = Rolled> + 's {
        let as_near = |places: &[usize]| {
            near.is_some_and(|(q, _)| places.iter().all(|n| p[*n].total_cmp(&q[*n]).is_eq()))
        };
        let same_angles = as_near(&[delay]);
        let same_leans: [bool; 4] =
            std::array::from_fn(|n| as_near(&[delay, n, DISTANCE, FOOTPRINT]));
        let all_same = same_leans == [true; 4] && as_near(&[DRAG]);
        let shape = Shape {
            distance: p[DISTANCE],
            footprint: p[FOOTPRINT],
        };
        let drag = if ripple { p[DRAG].exp() } else { 0.0 };
        let mean = self.model.mean();
        self.intervals.iter().enumerate().map(move |(n, interval)| {
            let near = near.map(|(_, rolled)| rolled[n]);
            if let Some(near) = near.filter(|_| all_same) {
                return near;
            }
            let angles = near
                .filter(|_| same_angles)
                .map_or_else(|| self.angles(interval, p[delay]), |near| near.angles);
            let leans: [Lean; 4] = std::array::from_fn(|wheel| match near {
                _ if !ripple => mean,
                Some(near) if same_leans[wheel] => near.leans[wheel],
                _ => {
                    let [from, to] = angles.map(|angles| angles[wheel]);
                    self.model.lean(from, to, p[wheel], &shape)
                }
            });
            Rolled {
                angles,
                leans,
                moved: self.moved(&angles, &leans, drag).map_or([0.0; 3], |m| m.1),
            }
        })
    }

    /// The delays of the measured axes, by their places.
    fn delays(&self) -> &'static [usize] {
        if self.axes.len() == 1 {
            &DELAYS[2..]
        } else {
            &DELAYS[1..]
        }
    }

    /// What the model means.
    fn meant(&self, parameters: Vec<f64>, ripple: bool) -> Meant {
        let each = self.delays().iter();
        let rolled: Vec<Rolled> = each
            .flat_map(|delay| self.rolled(&parameters, ripple, *delay, None))
            .collect();
        let moved: Vec<[f64; 3]> = rolled.iter().map(|rolled| rolled.moved).collect();
        Meant {
            bare: self.bare(&parameters, &moved),
            parameters,
            rolled,
        }
    }

    /// What the wheels mean on an axis with other parameters, before gain and bias.
    fn bare_near(&self, near: &Meant, parameters: &[f64], ripple: bool) -> Vec<f64> {
        let each = self
            .delays()
            .iter()
            .zip(near.rolled.chunks(self.intervals.len()));
        let moved: Vec<[f64; 3]> = each
            .flat_map(|(delay, rolled)| {
                let near = Some((&near.parameters[..], rolled));
                self.rolled(parameters, ripple, *delay, near)
            })
            .map(|rolled| rolled.moved)
            .collect();
        self.bare(parameters, &moved)
    }

    /// What the wheels mean on an axis, before gain and bias, from the displacements for each
    /// delay.
    fn bare(&self, parameters: &[f64], moved: &[[f64; 3]]) -> Vec<f64> {
        let count = self.intervals.len();
        let mut out = Vec::with_capacity(self.axes.len() * count);
        for axis in self.axes {
            let mut delays = self.delays().iter();
            let place = delays
                .position(|delay| *delay == DELAYS[*axis])
                .unwrap_or(0);
            let moved = &moved[place * count..(place + 1) * count];
            let from = out.len();
            out.extend(moved.iter().map(|moved| moved[*axis] * self.weights[*axis]));
            self.trail(&mut out[from..], parameters[LAGS[*axis]].exp());
        }
        out
    }

    /// Has displacements trail by a time constant: contacts creep, so a body takes up a velocity
    /// little by little. What the wheels mean is even in an interval.
    fn trail(&self, moved: &mut [f64], lag: f64) {
        let mut before: Option<(usize, f64, f64)> = None;
        for (moved, interval) in moved.iter_mut().zip(&self.intervals) {
            let seconds = interval.to - interval.from;
            let wanted = *moved / seconds;
            let joins = |(motion, to, _): &(usize, f64, f64)| {
                *motion == interval.motion && interval.from <= *to
            };
            let start = before.filter(joins).map_or(wanted, |before| before.2);
            let end = wanted + (start - wanted) * (-seconds / lag).exp();
            *moved -= lag * (end - start);
            before = Some((interval.motion, interval.to, end));
        }
    }

    /// Bias and drift over an interval, as displacement, for one of each.
    fn drift(&self, interval: &Interval) -> [f64; 2] {
        let motion = &self.motions[interval.motion];
        let middle = 0.5 * (interval.from + interval.to) - motion.middle();
        let weight = (interval.to - interval.from) * self.weights[2];
        [weight, weight * middle]
    }

    /// What is left of the measured displacements.
    fn left(&self, meant: &Meant) -> Vec<f64> {
        let Meant {
            parameters, bare, ..
        } = meant;
        let count = self.intervals.len();
        let mut out = Vec::with_capacity(bare.len());
        for (place, axis) in self.axes.iter().enumerate() {
            for (n, interval) in self.intervals.iter().enumerate() {
                let mut meant = parameters[GAINS + axis] * bare[place * count + n];
                if self.has_bias() {
                    let at = BIASES + 2 * interval.motion;
                    meant += dot(&self.drift(interval), &parameters[at..at + 2]);
                }
                out.push(interval.moved[*axis] * self.weights[*axis] - meant);
            }
        }
        out
    }

    /// Derivatives of what the model means, one column a parameter.
    fn slopes(&self, meant: &Meant, ripple: bool) -> Vec<Vec<f64>> {
        let Meant {
            parameters, bare, ..
        } = meant;
        let count = self.intervals.len();
        let steps = [
            [1e-4 * self.model.rollers.pitch(); 4].as_slice(),
            &[1e-4; GAINS - DISTANCE],
        ]
        .concat();
        let gain = |row: usize| parameters[GAINS + self.axes[row / count]];
        let mut out: Vec<Vec<f64>> = Vec::with_capacity(parameters.len());
        for (n, step) in steps.into_iter().enumerate() {
            let at = |by: f64| {
                let mut moved = parameters.clone();
                moved[n] += by;
                self.bare_near(meant, &moved, ripple)
            };
            if !ripple && n <= LAGS[2] {
                out.push(vec![0.0; bare.len()]);
                continue;
            }
            let pairs = at(step).into_iter().zip(at(-step)).enumerate();
            out.push(
                pairs
                    .map(|(row, (after, before))| gain(row) * (after - before) / (2.0 * step))
                    .collect(),
            );
        }
        for axis in 0..3 {
            let mine = |row: usize| self.axes[row / count] == axis;
            let column = bare.iter().enumerate();
            out.push(
                column
                    .map(|(row, bare)| if mine(row) { *bare } else { 0.0 })
                    .collect(),
            );
        }
        for n in BIASES..parameters.len() {
            let (motion, which) = ((n - BIASES) / 2, (n - BIASES) % 2);
            let of = |i: &Interval| {
                if i.motion == motion {
                    self.drift(i)[which]
                } else {
                    0.0
                }
            };
            out.push(self.intervals.iter().map(of).collect());
        }
        out
    }

    /// Variances of the phases by Newey and West: of the pulls of all intervals on a phase, and of
    /// their products with those that follow, with weights that fall to nothing over [`MEMORY`].
    /// Noise of poses, which an interval has of one sign and the next of the other, counts for
    /// less, and what the model leaves out for more, because it stays for a while.
    fn variances(&self, slopes: &[Vec<f64>], left: &[f64], inverse: &[f64]) -> [f64; 4] {
        let (count, size) = (self.intervals.len(), slopes.len());
        std::array::from_fn(|phase| {
            let row = &inverse[phase * size..(phase + 1) * size];
            let mut pulls = vec![0.0; count];
            for (n, left) in left.iter().enumerate() {
                let slope: f64 = row
                    .iter()
                    .zip(slopes)
                    .map(|(h, column)| h * column[n])
                    .sum();
                pulls[n % count] += slope * left;
            }
            let along = |lag: usize| -> f64 {
                let pairs = pulls.iter().zip(&pulls[lag.min(count)..]);
                let motions = self.intervals.iter().zip(&self.intervals[lag.min(count)..]);
                let here = pairs
                    .zip(motions)
                    .filter(|(_, (a, b))| a.motion == b.motion);
                here.map(|((a, b), _)| a * b).sum()
            };
            let weight = |lag: usize| 1.0 - lag as f64 / (MEMORY + 1) as f64;
            along(0)
                + 2.0
                    * (1..=MEMORY)
                        .map(|lag| weight(lag) * along(lag))
                        .sum::<f64>()
        })
    }

    /// Gauss-Newton, each step at most a twentieth of a pitch.
    fn refine(&self, start: Vec<f64>, ripple: bool) -> Option<Fit> {
        let priors = self.priors();
        let size = start.len();
        let longest = self.model.rollers.pitch() / 20.0;
        let mut meant = self.meant(start, ripple);
        let mut step = 0;
        loop {
            let parameters = &meant.parameters;
            let left = self.left(&meant);
            let squares = dot(&left, &left);
            let variance = squares / left.len().saturating_sub(size).max(1) as f64;
            let slopes = self.slopes(&meant, ripple);
            let mut normal = vec![0.0; size * size];
            let mut pull = vec![0.0; size];
            for (i, column) in slopes.iter().enumerate() {
                for (j, other) in slopes.iter().enumerate().skip(i) {
                    let product = dot(column, other);
                    normal[i * size + j] = product;
                    normal[j * size + i] = product;
                }
                let (mean, deviation) = priors[i];
                let weight = variance.max(f64::MIN_POSITIVE) / (deviation * deviation);
                normal[i * size + i] += weight;
                pull[i] = dot(column, &left) + weight * (mean - parameters[i]);
            }
            if !invert(&mut normal, size) {
                return None;
            }
            let by: Vec<f64> = normal.chunks(size).map(|row| dot(row, &pull)).collect();
            let most = by[..4].iter().map(|by| by.abs()).fold(0.0, f64::max);
            step += 1;
            let still = most < STILL * self.model.rollers.pitch() && step > 3;
            let onward = if still || step == STEPS {
                None
            } else {
                let share = (longest / most).min(1.0);
                self.descend(parameters, &by, share, (squares, variance), ripple)
            };
            let Some(next) = onward else {
                return Some(Fit {
                    variances: self.variances(&slopes, &left, &normal),
                    parameters: meant.parameters,
                    left,
                    squares,
                });
            };
            meant = next;
        }
    }

    /// The parameters a share of a step further, halved until what is left and the priors together
    /// are less; `None` when they do not become less.
    fn descend(
        &self,
        from: &[f64],
        by: &[f64],
        share: f64,
        (squares, variance): (f64, f64),
        ripple: bool,
    ) -> Option<Meant> {
        let priors = self.priors();
        let strain = |parameters: &[f64]| -> f64 {
            let off = parameters.iter().zip(&priors);
            variance
                * off
                    .map(|(p, (mean, dev))| ((p - mean) / dev).powi(2))
                    .sum::<f64>()
        };
        let cost = squares + strain(from);
        (0..HALVINGS).find_map(|halved| {
            let share = share * 0.5_f64.powi(halved);
            let next: Vec<f64> = from.iter().zip(by).map(|(p, by)| p + share * by).collect();
            let next = self.meant(next, ripple);
            let left = self.left(&next);
            (dot(&left, &left) + strain(&next.parameters) < cost).then_some(next)
        })
    }

    /// With wheels that do not ripple: what there is to explain.
    pub fn without_ripple(&self) -> Option<Fit> {
        self.refine(self.priors().iter().map(|(mean, _)| *mean).collect(), false)
    }

    /// The phases, from where the fundamental of each wheel's ripple stands in what the fit without
    /// left.
    pub fn with_ripple(&self, without: &Fit) -> Result<Fit, PhaseError> {
        let unseen = PhaseError::NotObservable { percent: 0.0 };
        let mean = [self.model.mean(); 4];
        let mut columns = vec![Vec::new(); 8];
        for axis in self.axes {
            let delay = without.parameters[DELAYS[*axis]];
            let scale = without.parameters[GAINS + axis] * self.weights[*axis];
            for interval in &self.intervals {
                let angles = self.angles(interval, delay);
                let (back, moved) = self.moved(&angles, &mean, 0.0).ok_or(unseen)?;
                for wheel in 0..4 {
                    let angle = 0.5 * (angles[0][wheel] + angles[1][wheel]);
                    let at = (wheel, angle, without.parameters[DISTANCE]);
                    let waves = self.model.fundamentals(&back, &moved, at);
                    for (column, wave) in columns[2 * wheel..].iter_mut().zip(waves) {
                        column.push(scale * wave[*axis]);
                    }
                }
            }
        }
        // A cosine and a sine of something: at most 1.
        let variance = without.squares / without.left.len().max(1) as f64;
        let mut normal: Vec<f64> = (0..64)
            .map(|n| {
                let own = if n / 8 == n % 8 { variance } else { 0.0 };
                dot(&columns[n / 8], &columns[n % 8]) + own
            })
            .collect();
        if !invert(&mut normal, 8) {
            return Err(unseen);
        }
        // What two wheels do together is known when neither alone is: a second best fit would be as
        // good.
        for (wheel, name) in WHEELS.into_iter().enumerate() {
            let unsure = [18 * wheel, 18 * wheel + 9].map(|n| (variance * normal[n]).sqrt());
            if unsure.into_iter().fold(0.0, f64::max) > LARGEST_SPREAD {
                return Err(PhaseError::Alike { wheel: name });
            }
        }
        let pull: Vec<f64> = columns.iter().map(|c| dot(c, &without.left)).collect();
        let waves: Vec<f64> = normal.chunks(8).map(|row| dot(row, &pull)).collect();
        let mut start = without.parameters.clone();
        for (phase, wave) in start.iter_mut().zip(waves.chunks(2)) {
            *phase = wave[1].atan2(wave[0]) * self.model.rollers.pitch() / std::f64::consts::TAU;
        }
        self.refine(start, true).ok_or(unseen)
    }
}
