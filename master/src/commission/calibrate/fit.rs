//! From motions to coefficients: tables over speed, ahead, sideways and oblique, with intervals.
//!
//! [`kinematics::estimate::fit`] fits one axis at one speed: it rejects outliers, takes least
//! squares, gives a 95 % interval, and refuses data that do not determine the coefficient. Oblique
//! motions at any angle are first converted to 45 degrees by the rule with which
//! [`kinematics::DirectionalCompensation`] interpolates. Motions in a wrong direction are refused
//! before that: the axes of the pose source are turned, or a wheel is in the wrong place, and no
//! coefficient corrects either.

use group::{CompensationTable, GroupFile};
use kinematics::estimate::{Fit, Limits, Sample, fit, student_95};
use kinematics::{AxisTable, DirectionalCompensation, VelocityCompensation};
use protocol::compensation::{self, ObliqueRow};

use super::CalibrateError;
use super::manoeuvre::Way;
use super::measure::Observation;

/// A motion along an axis may lead this far to the side, rad.
const ASKEW: f64 = 0.035;
/// A straight motion may turn the group this much, rad per m.
const TURNS: f64 = 0.09;
/// No motion shows a coefficient more exactly than this, whatever its fellows say.
const SUREST: f64 = 1e-5;
/// What every interval has in it to either side for what all motions of a row share: robots tell
/// their poses in steps of 0.1 mm, two of which make a motion of a metre, and ramps lose otherwise
/// than even motion. On contact plants that the fit does not know, 24 of 42 intervals held
/// with none of it and steep ramps, and of 100 robots with two thirds of it 94 % up to 0.5 m/s.
const SHARED: f64 = 3e-4;
/// The same sideways and in turns, where rollers carry all of the motion: with half of it 38 of 45
/// intervals held in a multi-body simulation (docs/kinematics.md).
const SHARED_ACROSS: f64 = 6e-4;
/// A motion is an outlier if it is off by more than this share of its speed: the few of a row
/// cannot tell how far they scatter.
const OUTLIER: f64 = 5e-3;
/// With less alignment what robots lose ahead and sideways is not told apart: an error of the
/// motions would count more than twice.
const SEPARABLE: f64 = 0.25;
/// Rows of a table.
const ROWS: usize = protocol::compensation::ROWS;

/// One coefficient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Speed by the wheels, m/s or rad/s.
    pub speed: f64,
    /// The coefficient and how sure it is.
    pub fit: Fit,
}

impl Row {
    /// The speed that was reached, m/s or rad/s.
    fn achieved(&self) -> f64 {
        self.speed / self.fit.coefficient
    }

    /// The row of a robot's table.
    #[expect(clippy::cast_possible_truncation, reason = "a robot holds 16 bits")]
    fn as_held(&self) -> compensation::Row {
        compensation::Row {
            speed: self.achieved() as f32,
            coefficient: self.fit.coefficient as f32,
        }
    }
}

/// All that was found of one subject.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Longitudinal.
    pub ahead: Vec<Row>,
    /// Lateral.
    pub aside: Vec<Row>,
    /// Longitudinal and lateral at 45 degrees.
    pub oblique: Vec<[Row; 2]>,
    /// About z.
    pub yaw: Vec<Row>,
}

/// What a fit accepts: two motions are the least, one each way.
const LIMITS: Limits = Limits {
    least_speed: 0.01,
    resolution: 1e-4,
    outlier_deviations: 4.0,
    least_samples: 2,
    widest_interval: 0.02,
};

fn refused(
    way: Way,
    speed: f64,
) -> impl Fn(kinematics::estimate::EstimationError) -> CalibrateError {
    move |reason| CalibrateError::NotDetermined {
        motion: way.name(),
        speed,
        unit: way.unit(),
        reason: reason.to_string(),
    }
}

/// One coefficient from ratios of measured to believed.
pub(super) fn row(
    way: Way,
    speed: f64,
    ratios: impl Iterator<Item = f64> + Clone,
) -> Result<Row, CalibrateError> {
    let samples = ratios.map(|ratio| Sample {
        commanded: speed,
        measured: speed * ratio,
    });
    let limits = Limits {
        resolution: OUTLIER * speed,
        ..LIMITS
    };
    let fit = fit(samples, &limits).map_err(refused(way, speed))?;
    Ok(Row { speed, fit })
}

/// How far the motions of some rows scatter about their rows, as a share of their speeds, and the
/// degrees of freedom from which that is known.
fn scatter<'a>(rows: impl Iterator<Item = &'a Row>) -> (f64, usize) {
    let (squares, free) = rows.fold((0.0, 0), |(squares, free), row| {
        let relative = row.fit.residual / row.speed;
        let used = row.fit.used;
        (squares + relative.powi(2) * used as f64, free + used - 1)
    });
    ((squares / free.max(1) as f64).sqrt().max(SUREST), free)
}

/// Widens the interval of every row to what the scatter of all rows of its kind says, and by what
/// all motions of a row share.
pub(super) fn widen(way: Way, rows: &mut [&mut Row]) {
    by_scatter(rows);
    let shared = match way {
        Way::Ahead | Way::Oblique => SHARED,
        Way::Aside | Way::Turn => SHARED_ACROSS,
    };
    for row in rows {
        let Fit {
            coefficient,
            interval: (low, high),
            ..
        } = row.fit;
        let wider = |half: f64| half.hypot(shared * coefficient);
        row.fit.interval = (
            coefficient - wider(coefficient - low),
            coefficient + wider(high - coefficient),
        );
    }
}

/// Widens the interval of every row to what the scatter of all rows of its kind says. Two motions
/// that happen to agree prove nothing; those of the other speeds show how far motions scatter.
fn by_scatter(rows: &mut [&mut Row]) {
    let (scatter, free) = scatter(rows.iter().map(|row| &**row));
    for row in rows {
        let Fit {
            coefficient, used, ..
        } = row.fit;
        let half = coefficient * student_95(free) * scatter / (used as f64).sqrt();
        let (low, high) = row.fit.interval;
        row.fit.interval = (low.min(coefficient - half), high.max(coefficient + half));
    }
}

impl Found {
    /// From the straight motions, all driven without compensation.
    ///
    /// # Errors
    /// When they do not make sense, or do not determine a coefficient.
    pub fn straight(seen: &[Observation]) -> Result<Self, CalibrateError> {
        sensible(seen)?;
        let of = |way| seen.iter().filter(move |o| o.way == way);
        let axis = |way, n: usize| -> Result<Vec<Row>, CalibrateError> {
            if of(way).next().is_none() {
                return Err(CalibrateError::NotMeasured { motion: way.name() });
            }
            speeds(of(way))
                .into_iter()
                .map(|speed| {
                    let here = of(way).filter(move |o| o.speed.total_cmp(&speed).is_eq());
                    row(way, speed, here.map(move |o| o.measured[n] / o.believed[n]))
                })
                .collect()
        };
        let mut found = Self {
            ahead: axis(Way::Ahead, 0)?,
            aside: axis(Way::Aside, 1)?,
            ..Self::default()
        };
        for speed in speeds(of(Way::Oblique)) {
            let axial = [&found.ahead, &found.aside].map(|rows| {
                let near = rows
                    .iter()
                    .min_by(|a, b| (a.speed - speed).abs().total_cmp(&(b.speed - speed).abs()));
                near.map_or(1.0, |row| row.fit.coefficient)
            });
            let ratios = |n: usize| {
                let here = of(Way::Oblique).filter(move |o| o.speed.total_cmp(&speed).is_eq());
                here.map(move |o| {
                    // coefficient = axial + 2 share (oblique - axial), the share being the other
                    // axis's.
                    let square = o.measured.map(|v| v * v);
                    let share = square[1 - n] / (square[0] + square[1]);
                    let coefficient = o.believed[n] / o.measured[n];
                    1.0 / (axial[n] + (coefficient - axial[n]) / (2.0 * share))
                })
            };
            let row = |n| row(Way::Oblique, speed, ratios(n));
            found.oblique.push([row(0)?, row(1)?]);
        }
        widen(Way::Ahead, &mut found.ahead.iter_mut().collect::<Vec<_>>());
        widen(Way::Aside, &mut found.aside.iter_mut().collect::<Vec<_>>());
        for n in [0, 1] {
            let rows = found.oblique.iter_mut().map(|row| &mut row[n]);
            widen(Way::Oblique, &mut rows.collect::<Vec<_>>());
        }
        Ok(found)
    }

    /// The coefficients of robots that face differently, from those of the group along and across
    /// their mean axis ([`super::measure`]). The shares that a group achieves there are the mean of
    /// the robots' shares, more or less `alignment` times half their difference.
    #[must_use]
    pub fn separated(mut self, alignment: f64) -> Self {
        let pull = if alignment < SEPARABLE {
            0.0
        } else {
            1.0 / alignment
        };
        let (own, other) = (0.5 * (1.0 + pull), 0.5 * (1.0 - pull));
        let mix = |row: &Row, across: &Row| {
            let share = |row: &Row| row.fit.coefficient.recip();
            let half =
                |row: &Row| 0.5 * (row.fit.interval.1 - row.fit.interval.0) * share(row).powi(2);
            let mut out = *row;
            let coefficient = (own * share(row) + other * share(across)).recip();
            let half = (own * half(row)).hypot(other * half(across)) * coefficient.powi(2);
            out.fit.coefficient = coefficient;
            out.fit.interval = (coefficient - half, coefficient + half);
            out
        };
        let at = |rows: &[Row], speed: f64| {
            let near = |row: &&Row| row.speed.total_cmp(&speed).is_eq();
            rows.iter().find(near).copied()
        };
        let each = |rows: &[Row], others: &[Row]| -> Vec<Row> {
            let pairs = rows
                .iter()
                .filter_map(|row| Some((row, at(others, row.speed)?)));
            pairs.map(|(row, other)| mix(row, &other)).collect()
        };
        (self.ahead, self.aside) = (
            each(&self.ahead, &self.aside),
            each(&self.aside, &self.ahead),
        );
        self
    }

    /// The tables as a robot takes them.
    #[must_use]
    pub fn table(&self, version: u32) -> CompensationTable {
        let pairs = |rows: &[Row]| rows.iter().map(Row::as_held).collect();
        let oblique = self.oblique.iter().map(|[x, y]| {
            let (along, across) = (x.as_held(), y.as_held());
            ObliqueRow {
                speed: along.speed,
                longitudinal: along.coefficient,
                lateral: across.coefficient,
            }
        });
        CompensationTable {
            version,
            longitudinal: pairs(&self.ahead),
            lateral: pairs(&self.aside),
            oblique: oblique.collect(),
            yaw: pairs(&self.yaw),
        }
    }

    /// One coefficient an axis: the mean of its rows, of the lateral ones less what the rollers'
    /// hand-over loses.
    ///
    /// # Errors
    /// When they are none.
    #[expect(clippy::cast_possible_truncation, reason = "a robot holds f32")]
    pub fn constant(&self, hand_over_loss: f32) -> Result<VelocityCompensation, CalibrateError> {
        let mean = |rows: &[Row], loss: f64| {
            let left = |row: &Row| row.fit.coefficient - loss * row.achieved();
            let sum: f64 = rows.iter().map(left).sum();
            if rows.is_empty() {
                1.0
            } else {
                (sum / rows.len() as f64) as f32
            }
        };
        let (x, turn) = (mean(&self.ahead, 0.0), mean(&self.yaw, 0.0));
        let y = mean(&self.aside, f64::from(hand_over_loss));
        VelocityCompensation::new(x, y, turn).map_err(unusable)
    }

    /// By how much the lateral coefficient grows with the speed, s/m: what the rollers' hand-over
    /// loses. The slope is shrunk by the share of its square that the scatter of the motions alone
    /// would make, so that what is hardly known is hardly used; 0 where that is all of it.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "a group file holds f32")]
    pub fn hand_over_loss(&self) -> f32 {
        let (scatter, _) = scatter(self.aside.iter());
        let rows = self.aside.iter().map(|row| {
            let deviation = row.fit.coefficient * scatter / (row.fit.used as f64).sqrt();
            (row.achieved(), row.fit.coefficient, deviation.powi(-2))
        });
        let weight: f64 = rows.clone().map(|(.., w)| w).sum();
        let mean_speed = rows.clone().map(|(v, _, w)| w * v).sum::<f64>() / weight;
        let (products, squares) = rows.fold((0.0, 0.0), |(products, squares), (v, c, w)| {
            let away = v - mean_speed;
            (products + w * away * c, squares + w * away * away)
        });
        let slope = products / squares;
        let by_chance = 1.0 / squares / (slope * slope);
        if slope > 0.0 && by_chance < 1.0 {
            ((slope * (1.0 - by_chance)) as f32).min(GroupFile::LARGEST_HAND_OVER_LOSS)
        } else {
            0.0
        }
    }

    /// Checks that a robot could take the tables.
    ///
    /// # Errors
    /// When they have no inverse, or coefficients no floor explains.
    pub fn check(&self) -> Result<(), CalibrateError> {
        let table = self.table(0);
        let axis = |rows: &[compensation::Row]| {
            let pairs = rows.iter().map(|row| row.pair());
            AxisTable::<ROWS>::filled(pairs, 1.0).map_err(unusable)
        };
        let (ahead, aside) = (axis(&table.longitudinal)?, axis(&table.lateral)?);
        let yaw = axis(&table.yaw)?;
        if !table.oblique.is_empty() {
            let (along, across): (Vec<_>, Vec<_>) = table
                .oblique
                .iter()
                .map(|row| (row.along(), row.across()))
                .unzip();
            let (x, y) = (axis(&along)?, axis(&across)?);
            DirectionalCompensation::new(ahead, aside, x, y, yaw).map_err(unusable)?;
        }
        let mut bytes = [0; compensation::LENGTH_MAX];
        let tables = compensation::Tables {
            version: 0,
            longitudinal: &table.longitudinal,
            lateral: &table.lateral,
            oblique: &table.oblique,
            yaw: &table.yaw,
        };
        tables.encode(&mut bytes).map_err(unusable)?;
        Ok(())
    }
}

fn unusable(error: impl std::fmt::Display) -> CalibrateError {
    CalibrateError::Unusable(error.to_string())
}

/// The speeds there are, rising.
fn speeds<'a>(seen: impl Iterator<Item = &'a Observation>) -> Vec<f64> {
    let mut out: Vec<f64> = seen.map(|o| o.speed).collect();
    out.sort_by(f64::total_cmp);
    out.dedup_by(|a, b| a.total_cmp(b).is_eq());
    out
}

/// Refuses motions that drift sideways or turn on the way.
fn sensible(seen: &[Observation]) -> Result<(), CalibrateError> {
    let along = |o: &Observation| {
        let ([bx, by, _], [mx, my, _]) = (o.believed, o.measured);
        (bx * my - by * mx).atan2(bx * mx + by * my)
    };
    let axial = || {
        seen.iter()
            .filter(|o| matches!(o.way, Way::Ahead | Way::Aside))
    };
    let mut angles: Vec<f64> = axial().map(along).collect();
    angles.sort_by(f64::total_cmp);
    let middle = angles.get(angles.len() / 2).copied().unwrap_or(0.0);
    if middle.abs() > ASKEW {
        return Err(CalibrateError::Askew {
            degrees: middle.to_degrees(),
        });
    }
    for o in axial() {
        if along(o).abs() > 2.0 * ASKEW {
            return Err(CalibrateError::Sidelong {
                motion: o.way.name(),
                speed: o.speed,
                degrees: along(o).to_degrees(),
            });
        }
        let metres = o.believed[0].hypot(o.believed[1]);
        if o.measured[2].abs() > TURNS * metres.max(1.0) {
            return Err(CalibrateError::Turned {
                motion: o.way.name(),
                speed: o.speed,
                degrees: o.measured[2].to_degrees(),
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a robot with these coefficients does, asked for a way of its wheels.
    fn seen(way: Way, speed: f64, believed: [f64; 3], [x, y]: [f64; 2]) -> Observation {
        let measured = [believed[0] / x, believed[1] / y, 0.0];
        Observation {
            way,
            speed,
            believed,
            measured,
        }
    }

    /// The coefficients of the paper's Tables 3 and 4 at 0.3 m/s.
    const AHEAD: f64 = 1.0022;
    const ASIDE: f64 = 1.0326;
    const OBLIQUE: [f64; 2] = [1.0170, 1.0175];

    fn motions() -> Vec<Observation> {
        let mut out = Vec::new();
        for sign in [1.0, -1.0] {
            out.push(seen(Way::Ahead, 0.3, [sign, 0.0, 0.0], [AHEAD, 1.0]));
            out.push(seen(Way::Aside, 0.3, [0.0, sign, 0.0], [1.0, ASIDE]));
            for angle in [0.54_f64, -1.03] {
                // The share is that of the achieved motion: found by going there.
                let (dy, dx) = angle.sin_cos();
                let (mx, my) = (sign * dx, sign * dy);
                let s = dy * dy;
                let x = AHEAD + 2.0 * s * (OBLIQUE[0] - AHEAD);
                let y = ASIDE + 2.0 * (1.0 - s) * (OBLIQUE[1] - ASIDE);
                out.push(seen(Way::Oblique, 0.3, [x * mx, y * my, 0.0], [x, y]));
            }
        }
        out
    }

    #[test]
    fn finds_the_coefficients_it_was_made_with() {
        let found = Found::straight(&motions()).unwrap();
        let near = |row: &Row, want: f64| (row.fit.coefficient - want).abs() < 1e-9;
        assert!(near(&found.ahead[0], AHEAD) && near(&found.aside[0], ASIDE));
        assert!(near(&found.oblique[0][0], OBLIQUE[0]), "{found:?}");
        assert!(near(&found.oblique[0][1], OBLIQUE[1]), "{found:?}");
        found.check().unwrap();
        let row = found.table(7).lateral[0];
        assert!((f64::from(row.speed) - 0.3 / ASIDE).abs() < 1e-6);
        assert!((f64::from(row.coefficient) - ASIDE).abs() < 1e-6);
    }

    /// Robots 30 degrees apart, by hand: along their mean axis each moves at 15 degrees to itself,
    /// and the group achieves `a cos^2 + b sin^2` there.
    #[test]
    fn robots_that_face_differently_are_told_apart() {
        let (sin, cos) = 15_f64.to_radians().sin_cos();
        let [a, b] = [AHEAD, ASIDE].map(f64::recip);
        let along = (a * cos * cos + b * sin * sin).recip();
        let across = (a * sin * sin + b * cos * cos).recip();
        let mut seen_so = Vec::new();
        for sign in [1.0, -1.0] {
            seen_so.push(seen(Way::Ahead, 0.3, [sign, 0.0, 0.0], [along, 1.0]));
            seen_so.push(seen(Way::Aside, 0.3, [0.0, sign, 0.0], [1.0, across]));
        }
        let group = Found::straight(&seen_so).unwrap();
        let found = group.clone().separated(30_f64.to_radians().cos());
        let of = |rows: &[Row]| rows[0].fit.coefficient;
        assert!((of(&found.ahead) - AHEAD).abs() < 1e-9, "{found:?}");
        assert!((of(&found.aside) - ASIDE).abs() < 1e-9, "{found:?}");
        let width = |rows: &[Row]| rows[0].fit.interval.1 - rows[0].fit.interval.0;
        assert!(width(&found.ahead) > width(&group.ahead));
        // Nothing to tell apart: both are their mean.
        let mean = group.separated(0.0);
        let share = 0.5 * (a + b);
        assert!((of(&mean.ahead) - share.recip()).abs() < 1e-9);
        assert!((of(&mean.aside) - share.recip()).abs() < 1e-9);
    }

    /// Lateral rows of `1.005 + slope v`, two motions each, that are off by so much either way.
    fn rows(speeds: &[f64], slope: f64, off: f64) -> Found {
        let row = |v: &f64| {
            let coefficient = 1.005 + slope * v;
            let ratios = [1.0 - off, 1.0 + off].map(|share| share / coefficient);
            row(Way::Aside, v * coefficient, ratios.into_iter()).unwrap()
        };
        Found {
            aside: speeds.iter().map(row).collect(),
            ..Found::default()
        }
    }

    /// Rows of 1.005 and 0.002 s/m, to a hundred-thousandth; the rest is what stays of the mean.
    /// Rows that scatter by more than they rise show nothing, and neither does one row.
    #[test]
    fn what_grows_with_speed_is_told_apart() {
        let found = rows(&[0.1, 0.3, 0.8], 0.002, 0.0);
        assert!((found.hand_over_loss() - 0.002).abs() < 1e-6);
        let rest = found.constant(0.002).unwrap();
        assert!((rest.lateral() - 1.005).abs() < 1e-6, "{rest:?}");
        assert!((found.constant(0.0).unwrap().lateral() - 1.0058).abs() < 1e-6);
        assert_eq!(rows(&[0.1, 0.3, 0.8], 0.002, 1.2e-3).hand_over_loss(), 0.0);
        assert_eq!(rows(&[0.1, 0.8], -0.002, 0.0).hand_over_loss(), 0.0);
        assert_eq!(rows(&[0.3], 0.0, 0.0).hand_over_loss(), 0.0);
    }

    /// Two motions a row that differ by 3e-4 either way: rows of 0.25, 0.5 and 1 m/s show 0.0013
    /// s/m with a standard deviation of 0.00052, by hand: 3e-4 sqrt(2) (six motions with three
    /// degrees of freedom) over sqrt(2) and over sqrt(sum of squared distances from the mean speed)
    /// = 0.540. What is left is 1 - (0.00056 / 0.0013)^2 of it.
    #[test]
    fn a_hand_over_that_two_motions_show_is_not_lost() {
        let found = f64::from(rows(&[0.25, 0.5, 1.0], 0.0013, 3e-4).hand_over_loss());
        let expected = 0.0013 - 0.000_56 * 0.000_56 / 0.0013;
        assert!((found - expected).abs() < 3e-5, "{found} {expected}");
    }

    /// Coefficients of three speeds from two motions each, whose scatter is normal and 3e-4: of 900
    /// intervals of 95 % 855 hold on average, with a deviation of 6.5 were they independent; those
    /// of one trial share their scatter, which makes it up to 1.7 times as much. They may hold more
    /// often, for a row whose own motions scatter more than the others' keeps its own interval.
    #[test]
    fn intervals_from_two_motions_hold() {
        let mut state = 7_u64;
        let mut normal = || {
            let mut one = || {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_041);
                (state >> 33) as f64 / (1_u64 << 31) as f64 - 0.5
            };
            (0..12).map(|_| one()).sum::<f64>()
        };
        let mut held = 0;
        for _ in 0..300 {
            let mut all = [0.25, 0.5, 1.0].map(|speed| {
                let ratios = [3e-4 * normal(), 3e-4 * normal()].map(|off| 1.0 + off);
                row(Way::Ahead, speed, ratios.into_iter()).unwrap()
            });
            by_scatter(&mut all.each_mut());
            let holds = |row: &&Row| (row.fit.interval.0..=row.fit.interval.1).contains(&1.0);
            held += all.iter().filter(holds).count();
        }
        assert!((833..=891).contains(&held), "{held} of 900");
    }

    fn refusal(change: impl Fn(&mut Observation)) -> String {
        let mut seen = motions();
        seen.iter_mut().for_each(change);
        let found = Found::straight(&seen).and_then(|found| found.check().map(|()| found));
        found.unwrap_err().to_string()
    }

    #[test]
    fn bad_data_are_refused_with_the_reason() {
        let contradicting = refusal(|o| {
            if o.way == Way::Aside && o.believed[1] > 0.0 {
                o.measured[1] *= 0.9;
            }
        });
        assert!(
            contradicting.contains("sideways at 0.3 m/s"),
            "{contradicting}"
        );
        assert!(contradicting.contains("uncertain"), "{contradicting}");
        let askew = refusal(|o| {
            let [x, y, _] = o.measured;
            o.measured = [x - 0.05 * y, y + 0.05 * x, 0.0];
        });
        assert!(askew.contains("2.9 degrees"), "{askew}");
        let backwards = refusal(|o| {
            if o.way == Way::Ahead {
                o.measured[0] = -o.measured[0];
            }
        });
        assert!(backwards.contains("ahead"), "{backwards}");
        let turning = refusal(|o| {
            if o.way == Way::Aside {
                o.measured[2] = 0.2;
            }
        });
        assert!(turning.contains("turned by 11.5 degrees"), "{turning}");
        let nonsense = refusal(|o| o.measured[0] = f64::NAN);
        assert!(nonsense.contains("not a finite number"), "{nonsense}");
        // Half of the way sideways lost: no table takes that.
        let lost = refusal(|o| o.measured[1] *= 0.49);
        assert!(lost.contains("2 or more"), "{lost}");
    }
}
