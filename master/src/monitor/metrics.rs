//! How far a driven path is from the path asked for: the figures of the paper's Tables 6 and 9.
//!
//! The paper judges a curve by the relative error of displacement (RED): the mean of the largest
//! and the smallest coordinate's magnitude over the nominal amplitude, minus one, per axis. For a
//! curve about the origin `(|max| + |min|) / 2` is half of the extent, so the extent is what is
//! compared here: it gives the same number and does not depend on where the run started. The
//! denominator is the extent of the theory over the very instants that were sampled, so a shortened
//! run is judged by what it asked for and not by a curve it never finished.
//!
//! Everything in the crate is REP-103 (x forward, y left). The axes of these figures are the
//! paper's: x lateral (right positive), y longitudinal (forward positive). [`to_paper`] is the one
//! place where a path changes frame.
//!
//! Nothing here knows where a path came from: a simulated plant, odometry or a motion-capture
//! system all end as [`PathPoint`]s.

use std::f64::consts::{PI, TAU};

use kinematics::Pose;

/// Where the group was asked to be and where it was, at one instant. Both in one frame (REP-103,
/// m, m, rad), both about the curve's own origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPoint {
    /// Time since the first instant of the curve, in s.
    pub t: f64,
    /// The pose the curve asks for at `t`.
    pub theory: Pose,
    /// The pose the group had at `t`.
    pub actual: Pose,
}

/// The figures of one run. Axes as in the paper: x lateral, y longitudinal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathErrors {
    /// Relative error of the lateral displacement, in per cent; negative means too short.
    pub x_percent: f64,
    /// Relative error of the longitudinal displacement, in per cent; negative means too short.
    pub y_percent: f64,
    /// Root mean square of the distance between theory and group at the same instant, in mm.
    pub rms_mm: f64,
    /// Largest distance between theory and group at the same instant, in mm.
    pub max_mm: f64,
}

/// What the mean errors do not show. See [`evenness`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evenness {
    /// Standard deviation of the speed along the motion over the speed asked for, in per cent,
    /// where that is within [`FAST`] of the fastest.
    pub ripple_percent: f64,
    /// Heading at the end less the heading asked for, in degrees.
    pub heading_error_deg: f64,
    /// Relative error of the turned angle, in per cent; 0 for a curve that does not turn.
    pub turn_percent: f64,
    /// Time by which the group trails the curve, in ms: the least-squares fit of its error against
    /// velocity, freed of what a wrong gain or a shifted start explain.
    pub lag_ms: f64,
}

/// Share of the fastest speed from which on ripple is evaluated: ramps and slow parts stay out.
const FAST: f64 = 0.95;

/// Judges how evenly and how straight a path was driven, from speeds between neighbouring points.
///
/// # Errors
/// As [`path_errors`].
pub fn evenness(path: &[PathPoint]) -> Result<Evenness, MetricsError> {
    path_errors(path)?;
    let step = |from: Pose, to: Pose| {
        [
            f64::from(to.x) - f64::from(from.x),
            f64::from(to.y) - f64::from(from.y),
            f64::from(to.heading) - f64::from(from.heading),
        ]
    };
    let size = |[x, y, _]: [f64; 3]| x.hypot(y);
    let steps: Vec<_> = path
        .windows(2)
        .map(|pair| {
            (
                step(pair[0].theory, pair[1].theory),
                step(pair[0].actual, pair[1].actual),
            )
        })
        .collect();
    let fastest = steps
        .iter()
        .map(|(asked, _)| size(*asked))
        .fold(0.0, f64::max);
    let fastest_turn = steps
        .iter()
        .map(|(asked, _)| asked[2].abs())
        .fold(0.0, f64::max);
    // A curve turns, or it goes somewhere; of one that does both the distance is evaluated.
    let turns = fastest < 1e-6;
    let ratios: Vec<f64> = steps
        .iter()
        .filter_map(|(asked, done)| {
            if turns {
                (asked[2].abs() > FAST * fastest_turn).then(|| done[2] / asked[2])
            } else {
                let along = done[0] * asked[0] + done[1] * asked[1];
                (size(*asked) > FAST * fastest).then(|| along / size(*asked).powi(2))
            }
        })
        .collect();
    let mean = ratios.iter().sum::<f64>() / ratios.len().max(1) as f64;
    let variance = ratios
        .iter()
        .map(|ratio| (ratio - mean).powi(2))
        .sum::<f64>()
        / ratios.len().max(1) as f64;
    let heading =
        |pose: fn(&PathPoint) -> Pose| path.iter().map(move |p| f64::from(pose(p).heading));
    // Whole turns that one of them counts and the other does not are no error.
    let last = path.last().map_or(0.0, |p| {
        let off = f64::from(p.actual.heading) - f64::from(p.theory.heading);
        (off + PI).rem_euclid(TAU) - PI
    });
    Ok(Evenness {
        lag_ms: lag(path, turns) * 1e3,
        ripple_percent: variance.sqrt() * 100.0,
        heading_error_deg: last.to_degrees(),
        turn_percent: red_percent(extent(heading(|p| p.actual)), extent(heading(|p| p.theory))),
    })
}

/// The time by which a path trails its theory, s; of the heading when the curve only turns.
fn lag(path: &[PathPoint], turns: bool) -> f64 {
    let coordinates: &[fn(&Pose) -> f32] = if turns {
        &[|pose| pose.heading]
    } else {
        &[|pose| pose.x, |pose| pose.y]
    };
    let (mut product, mut square) = (0.0, 0.0);
    for coordinate in coordinates {
        let of = |pose: &Pose| f64::from(coordinate(pose));
        let inner = path.windows(3).map(|three| {
            let [before, point, after] = [&three[0], &three[1], &three[2]];
            let velocity = (of(&after.theory) - of(&before.theory)) / (after.t - before.t);
            let error = of(&point.actual) - of(&point.theory);
            [of(&point.theory), velocity, error]
        });
        let [place, velocity, error] = centred(inner.collect());
        let velocity = without(&velocity, &place);
        let error = without(&error, &place);
        product += dot(&velocity, &error);
        square += dot(&velocity, &velocity);
    }
    if square > 0.0 { -product / square } else { 0.0 }
}

/// Columns less their means.
fn centred(rows: Vec<[f64; 3]>) -> [Vec<f64>; 3] {
    [0, 1, 2].map(|column| {
        let mean = rows.iter().map(|row| row[column]).sum::<f64>() / rows.len().max(1) as f64;
        rows.iter().map(|row| row[column] - mean).collect()
    })
}

/// A column less what follows from another in proportion.
fn without(column: &[f64], other: &[f64]) -> Vec<f64> {
    let square = dot(other, other);
    let share = if square > 0.0 {
        dot(column, other) / square
    } else {
        0.0
    };
    let pairs = column.iter().zip(other);
    pairs.map(|(value, other)| value - share * other).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Why a path cannot be judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MetricsError {
    /// Fewer than two instants were recorded.
    #[error("a path of fewer than two points has no displacement error")]
    TooShort,
    /// A coordinate is NaN or infinite.
    #[error("the recorded path holds a coordinate that is not a number")]
    NotFinite,
}

/// Coordinates of a REP-103 position in the paper's frame: `[x lateral right, y forward]`, in m.
#[must_use]
pub fn to_paper(pose: &Pose) -> [f64; 2] {
    [-f64::from(pose.y), f64::from(pose.x)]
}

/// Largest minus smallest of `values`.
fn extent(values: impl Iterator<Item = f64>) -> f64 {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    });
    high - low
}

/// Relative error of displacement in per cent, from two extents; 0 for an axis that was not to
/// move.
fn red_percent(actual: f64, theory: f64) -> f64 {
    if theory > 0.0 {
        (actual / theory - 1.0) * 100.0
    } else {
        0.0
    }
}

/// Judges `path` against its own theory.
///
/// # Errors
/// When there are fewer than two points or a coordinate is not finite.
pub fn path_errors(path: &[PathPoint]) -> Result<PathErrors, MetricsError> {
    if path.len() < 2 {
        return Err(MetricsError::TooShort);
    }
    let finite = |pose: &Pose| pose.x.is_finite() && pose.y.is_finite();
    if !path.iter().all(|p| finite(&p.theory) && finite(&p.actual)) {
        return Err(MetricsError::NotFinite);
    }
    let axis = |axis: usize| {
        red_percent(
            extent(path.iter().map(|p| to_paper(&p.actual)[axis])),
            extent(path.iter().map(|p| to_paper(&p.theory)[axis])),
        )
    };
    let distance = |p: &PathPoint| {
        let ([x, y], [x0, y0]) = (to_paper(&p.actual), to_paper(&p.theory));
        (x - x0).hypot(y - y0)
    };
    let squares: f64 = path.iter().map(|p| distance(p).powi(2)).sum();
    Ok(PathErrors {
        x_percent: axis(0),
        y_percent: axis(1),
        rms_mm: (squares / path.len() as f64).sqrt() * 1000.0,
        max_mm: path.iter().map(distance).fold(0.0, f64::max) * 1000.0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(x: f32, y: f32) -> Pose {
        Pose { x, y, heading: 0.0 }
    }

    /// The rows of Table 6: max and min in mm, nominal 2500 mm, and the error it prints.
    #[test]
    fn table_6_errors_follow_from_its_extents() {
        /// Table 6 prints two decimals.
        const LAST_DIGIT: f64 = 0.006;
        let rows = [
            (2430.51, -2395.56, -3.48),
            (2494.11, -2498.98, -0.14),
            (2423.55, -2430.37, -2.92),
            (2494.90, -2490.90, -0.28),
        ];
        for (max, min, printed) in rows {
            let path = [
                PathPoint {
                    t: 0.0,
                    theory: pose(0.0, -2.5),
                    actual: pose(0.0, -max / 1000.0),
                },
                PathPoint {
                    t: 1.0,
                    theory: pose(0.0, 2.5),
                    actual: pose(0.0, -min / 1000.0),
                },
            ];
            let errors = path_errors(&path).unwrap();
            assert!(
                (errors.x_percent - printed).abs() < LAST_DIGIT,
                "{max} {min}"
            );
            assert_eq!(errors.y_percent, 0.0);
        }
    }

    #[test]
    fn lateral_is_the_papers_x_and_forward_its_y() {
        assert_eq!(to_paper(&pose(1.0, 0.25)), [-0.25, 1.0]);
    }

    #[test]
    fn rms_is_of_the_distance_at_the_same_instant() {
        let point = |dx: f32, dy: f32| PathPoint {
            t: 0.0,
            theory: pose(1.0, 1.0),
            actual: pose(1.0 + dx, 1.0 + dy),
        };
        // 3-4-5: distances 5 mm and 0 mm; the root mean square is 5 / sqrt 2.
        let errors = path_errors(&[point(0.003, 0.004), point(0.0, 0.0)]).unwrap();
        assert!((errors.rms_mm - 5.0 / 2f64.sqrt()).abs() < 1e-3);
        assert!((errors.max_mm - 5.0).abs() < 1e-3);
    }

    #[test]
    fn a_start_away_from_the_origin_changes_nothing() {
        let point = |theory: f32, actual: f32| PathPoint {
            t: 0.0,
            theory: pose(theory, 0.0),
            actual: pose(actual, 0.0),
        };
        let centred = path_errors(&[point(-1.0, -0.96), point(1.0, 0.96)]).unwrap();
        let from_start = path_errors(&[point(-1.0, -1.0), point(1.0, 0.92)]).unwrap();
        assert!((centred.y_percent - -4.0).abs() < 1e-4);
        assert!((from_start.y_percent - centred.y_percent).abs() < 1e-4);
    }

    /// Five millimetres a step with a sine of 2 % on top: a standard deviation of 2 % over the
    /// square root of two.
    #[test]
    fn ripple_is_the_deviation_of_the_speed() {
        let mut y = 0.0_f64;
        let mut path = Vec::new();
        for k in 0..=400_u16 {
            let theory = 0.005 * f64::from(k);
            let turned = f64::from(k) * 1e-4;
            path.push(PathPoint {
                t: f64::from(k),
                theory: pose(0.0, theory as f32),
                actual: Pose {
                    heading: turned as f32,
                    ..pose(0.0, y as f32)
                },
            });
            y += 0.005 * (1.0 + 0.02 * (f64::from(k) * std::f64::consts::TAU / 40.0).sin());
        }
        let found = evenness(&path).unwrap();
        // f32 at 2 m has steps of 1.2e-7 m, 2.4e-5 of a step.
        assert!(
            (found.ripple_percent - 2.0 / 2f64.sqrt()).abs() < 5e-3,
            "{found:?}"
        );
        assert!((found.heading_error_deg - 0.04_f64.to_degrees()).abs() < 1e-4);
        assert_eq!(found.turn_percent, 0.0);
    }

    /// Ahead and back as a cosine, driven 3 % too short and 12 ms late, from a start 20 mm aside.
    #[test]
    fn a_lag_is_told_from_a_gain_and_a_shift() {
        let ahead = |t: f64| 1.0 - (0.5 * t).cos();
        let path: Vec<_> = (0..=1257_u16)
            .map(|k| {
                let t = f64::from(k) * 0.01;
                PathPoint {
                    t,
                    theory: pose(ahead(t) as f32, 0.0),
                    actual: pose((0.97 * ahead(t - 0.012)) as f32 + 0.02, 0.02),
                }
            })
            .collect();
        // The share of the gain, and the velocity over a step of 20 ms: 2e-5 of it.
        let found = evenness(&path).unwrap().lag_ms;
        assert!((found - 0.97 * 12.0).abs() < 0.01, "{found}");
    }

    /// A circle that the curve counts as a whole turn and the robots as none.
    #[test]
    fn a_whole_turn_is_no_heading_error() {
        let point = |t: f64, theory: f32, actual: f32| PathPoint {
            t,
            theory: Pose::new(t as f32, 0.0, theory),
            actual: Pose::new(t as f32, 0.0, actual),
        };
        let path = [
            point(0.0, 0.0, 0.0),
            point(1.0, 3.0, 3.0),
            point(2.0, std::f32::consts::TAU, 0.01),
        ];
        let found = evenness(&path).unwrap().heading_error_deg;
        assert!((found - 0.01_f64.to_degrees()).abs() < 1e-3, "{found}");
    }

    #[test]
    fn refuses_what_cannot_be_judged() {
        assert_eq!(path_errors(&[]), Err(MetricsError::TooShort));
        let bad = PathPoint {
            t: 0.0,
            theory: pose(0.0, 0.0),
            actual: pose(f32::NAN, 0.0),
        };
        assert_eq!(path_errors(&[bad, bad]), Err(MetricsError::NotFinite));
    }
}
