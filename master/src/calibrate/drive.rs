//! The slow motions that show what a calibration looks for, and what was seen of them.
//!
//! Wheel angles are those the robots give at rest before and after; between, their measured wheel rates are summed up
//! and brought to fit. Poses come from whoever calls, at every SYNC.

use kinematics::Twist;
use std::f64::consts::TAU;

use super::phase::Sample;
use crate::error::MasterError;
use crate::link::Link;
use crate::session::Group;

/// How long the group waits at rest before and after each motion, s.
const REST: f64 = 0.3;

/// Poses of the robots in the order of the group file, now: m, m, rad, heading unwrapped.
pub type Poses<'a, L> = &'a mut dyn FnMut(&mut L) -> Result<Vec<[f64; 3]>, MasterError>;

/// Drives a started group with a twist for some seconds and records every robot. The group stands afterwards and stays
/// started.
///
/// # Errors
/// When driving fails, or the pose source does.
pub fn record<L: Link>(
    group: &mut Group<L>,
    (twist, seconds): (Twist, f64),
    poses: Poses<'_, L>,
) -> Result<Vec<Vec<Sample>>, MasterError> {
    let period = group.period_us() as f64 * 1e-6;
    let pitches: Vec<f64> = group
        .config()
        .robots
        .iter()
        .map(|robot| {
            TAU / robot
                .rollers
                .map_or(8.0, |rollers| f64::from(rollers.count))
        })
        .collect();
    let nodes: Vec<u8> = group
        .config()
        .robots
        .iter()
        .map(|robot| robot.node)
        .collect();
    let mut out = vec![Vec::new(); nodes.len()];
    let before = angles(group, &nodes)?;
    let cycles = |seconds: f64| (seconds / period).ceil() as u32;
    let mut turned = vec![[0.0; 4]; nodes.len()];
    for k in 0..cycles(seconds) + cycles(REST) {
        let asked = if k < cycles(seconds) {
            twist
        } else {
            Twist::ZERO
        };
        group.cycle(asked)?;
        let seen = poses(group.link())?;
        let rows = group.recorder().rows();
        // The row of this SYNC is being filled still; the one before is complete.
        let last = rows.len().checked_sub(2).and_then(|n| rows.get(n));
        for (robot, (out, pose)) in out.iter_mut().zip(seen).enumerate() {
            let rates = last
                .and_then(|row| row.members.get(robot))
                .and_then(|member| member.wheel_rates);
            if let Some(rates) = rates {
                let rates: [f32; 4] = rates.into();
                for (turned, rate) in turned[robot].iter_mut().zip(rates) {
                    *turned += f64::from(rate) * period;
                }
            }
            out.push(Sample {
                pose,
                angles: std::array::from_fn(|n| before[robot][n] + turned[robot][n]),
            });
        }
    }
    let after = angles(group, &nodes)?;
    for (robot, samples) in out.iter_mut().enumerate() {
        fit(samples, &after[robot], pitches[robot]);
    }
    Ok(out)
}

/// Roller angles of all robots at rest.
fn angles<L: Link>(group: &mut Group<L>, nodes: &[u8]) -> Result<Vec<[f64; 4]>, MasterError> {
    nodes
        .iter()
        .map(|node| {
            let angles: [f32; 4] = group.roller_angles(*node)?.into();
            Ok(angles.map(f64::from))
        })
        .collect()
}

/// Spreads over a motion what its end is off from the angles read there, which are known but for whole pitches.
fn fit(samples: &mut [Sample], end: &[f64; 4], pitch: f64) {
    let Some(last) = samples.last().map(|sample| sample.angles) else {
        return;
    };
    let first = samples.first().map_or(last, |sample| sample.angles);
    for wheel in 0..4 {
        let off = end[wheel] - last[wheel];
        let off = off - (off / pitch).round() * pitch;
        let way = last[wheel] - first[wheel];
        for sample in samples.iter_mut() {
            let share = if way.abs() > pitch {
                (sample.angles[wheel] - first[wheel]) / way
            } else {
                0.0
            };
            sample.angles[wheel] += share * off;
        }
    }
}
