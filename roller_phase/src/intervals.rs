//! Motions cut into intervals: what the fit compares its model with.

use crate::{Motion, Samples};

/// How long a robot may slide on after its wheels have come to their speed, s: from 0.3 m/s with
/// friction 0.15 along axles at 45 degrees.
const AFTER_RAMP: f64 = 0.3;

/// One interval: what the robot did between two times.
pub(crate) struct Interval {
    pub motion: usize,
    pub from: f64,
    pub to: f64,
    /// Displacement in the robot's own frame at the middle of the interval: m, m, rad; those that
    /// are measured.
    pub moved: [f64; 3],
}

/// Cuts a motion into intervals in which the fastest wheel turns by about `finest` rad, ramps left
/// out, and what follows them: there contacts carry what accelerates the robot and slip as they do
/// at no other time, on a smooth floor for longer than the wheels take to their speed.
pub(crate) fn cut(number: usize, motion: &Motion, finest: f64) -> Vec<Interval> {
    let mut out = match &motion.seen {
        Samples::Poses(poses) => cut_poses(number, motion, poses, finest),
        Samples::YawRates(samples) => cut_rates(number, motion, samples, finest),
    };
    let uneven: Vec<f64> = out
        .iter()
        .filter(|interval| !motion.is_even(interval.from, interval.to))
        .map(|interval| 0.5 * (interval.from + interval.to))
        .collect();
    out.retain(|interval| {
        let since_ramp = uneven.iter().map(|ramp| interval.from - ramp);
        motion.is_even(interval.from, interval.to)
            && !since_ramp
                .into_iter()
                .any(|t| (0.0..AFTER_RAMP).contains(&t))
    });
    out
}

fn cut_poses(
    number: usize,
    motion: &Motion,
    poses: &[(f64, [f64; 3])],
    finest: f64,
) -> Vec<Interval> {
    let mut out = Vec::new();
    let Some(mut from) = poses.first() else {
        return out;
    };
    for to in poses {
        let (before, after) = (motion.angles_at(from.0), motion.angles_at(to.0));
        let turned = before.iter().zip(after).map(|(a, b)| (b - a).abs());
        if turned.fold(0.0, f64::max) < finest {
            continue;
        }
        let [dx, dy, turn] = [0, 1, 2].map(|n| to.1[n] - from.1[n]);
        let (sin, cos) = (from.1[2] + 0.5 * turn).sin_cos();
        out.push(Interval {
            motion: number,
            from: from.0,
            to: to.0,
            moved: [cos * dx + sin * dy, cos * dy - sin * dx, turn],
        });
        from = to;
    }
    out
}

/// In steps of time, standstill included: that shows the bias.
fn cut_rates(number: usize, motion: &Motion, samples: &[(f64, f64)], finest: f64) -> Vec<Interval> {
    let mut out = Vec::new();
    let least = finest / motion.fastest().max(f64::MIN_POSITIVE);
    let (mut from, mut turn) = (None, 0.0);
    for pair in samples.windows(2) {
        let [(before, _), (t, rate)] = [pair[0], pair[1]];
        let began = *from.get_or_insert(before);
        turn += rate * (t - before);
        // Nine tenths, so that whole samples do not miss it by a hair.
        if t - began > 0.9 * least {
            out.push(Interval {
                motion: number,
                from: began,
                to: t,
                moved: [0.0, 0.0, turn],
            });
            (from, turn) = (None, 0.0);
        }
    }
    out
}
