//! From the master's call to the wheel, and from SYNC to it: one emulated robot that stands, and is told to move.
//!
//! The call comes at every millisecond of a SYNC period in turn. What ends the time is the first change of the front left
//! wheel's PWM, which acts at once.

use anyhow::{Context as _, ensure};
use emulator::Firmware;
use group::GroupFile;
use kinematics::Twist;
use sim::Options;

use super::driving::Driving;
use super::figure::Figure;

/// Calls, twice at each millisecond of ten.
const CALLS: u64 = 20;
/// Time to move, and to stand again, ms.
const MOVES_MS: u64 = 60;
const STANDS_MS: u64 = 400;

/// Calls and measures.
pub fn figures(group: &GroupFile, firmware: &Firmware) -> anyhow::Result<Vec<Figure>> {
    let mut group = group.clone();
    group.robots.truncate(1);
    group.simulation.crystal_ppm.truncate(1);
    let period_us = f64::from(group.sync_period_us);
    let options = Options {
        truth_period_ns: 0,
        ..Options::default()
    };
    let mut driving = Driving::ready(&group, firmware, options)?;
    driving.start()?;
    let period_ms = u64::from(group.sync_period_us) / 1_000;
    let (mut calls, mut syncs) = (Vec::new(), Vec::new());
    for call in 0..CALLS {
        driving.rig.twist = Some(Twist::ZERO);
        driving.rig.run(STANDS_MS)?;
        driving.rig.run_to_phase(period_ms, call % period_ms)?;
        driving.rig.world.start_trace();
        let called_ns = driving.rig.world.now_ns();
        driving.rig.twist = Some(Twist::new(0.2, 0.0, 0.0));
        driving.rig.run(MOVES_MS)?;
        let changes = driving.rig.world.take_duty_changes(0);
        let first = changes.iter().copied().find(|at| *at > called_ns);
        let at = first.context("the robot does not move when it is told to")?;
        calls.push((at - called_ns) as f64 * 1e-3);
        // SYNC comes at whole periods.
        syncs.push((at as f64 * 1e-3) % period_us);
    }
    ensure!(calls.len() == CALLS as usize, "calls are missing");
    calls.sort_by(f64::total_cmp);
    let mean = syncs.iter().sum::<f64>() / syncs.len() as f64;
    let worst = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    Ok(vec![
        Figure::new("sync_to_pwm.mean", mean, "us"),
        Figure::new("sync_to_pwm.worst", worst(&syncs), "us").ceiling(3_500.0),
        Figure::new("call_to_pwm.median", calls[calls.len() / 2], "us"),
        // Of twenty calls the worst.
        Figure::new("call_to_pwm.worst", worst(&calls), "us").ceiling(33_000.0),
    ])
}
