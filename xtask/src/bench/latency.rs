//! The time from the master's call, and from SYNC, to the wheel: emulated robots at standstill that
//! are commanded to move, one alone and one of eight that have to agree.
//!
//! The calls are made at every step of a SYNC period in turn. The time ends at the first of the
//! changes of the front left wheel's PWM that follow one another tick by tick; this change acts at
//! once.

use anyhow::{Context as _, ensure};
use emulator::Firmware;
use group::GroupFile;
use kinematics::Twist;
use sim::Options;

use super::bus::in_a_row;
use super::driving::Driving;
use super::figure::Figure;

/// Calls: so many that the 99th percentile is one of them and not the last.
const CALLS: u64 = 200;
/// Calls to eight robots: one at every step of a period, so that the last is the 99th percentile.
const CALLS_TO_EIGHT: u64 = 40;
/// What a call to eight robots may take, us.
const BUDGET: [f64; 2] = [9_000.0, 14_000.0];
/// Time to move, and to stand again, ms.
const MOVES_MS: u64 = 60;
const STANDS_MS: u64 = 150;

/// Calls on the bus and measures.
pub fn figures(group: &GroupFile, firmware: &Firmware) -> anyhow::Result<Vec<Figure>> {
    let (calls, syncs) = measure(&in_a_row(group, 1), firmware, false, CALLS)?;
    let mean = syncs.iter().sum::<f64>() / syncs.len() as f64;
    let worst = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    let (eight, eight_syncs) = measure(&in_a_row(group, 8), firmware, false, CALLS_TO_EIGHT)?;
    let name = |what: &str| format!("8_robots.{what}");
    let [median, p99] = BUDGET;
    Ok(vec![
        Figure::new("sync_to_pwm.mean", mean, "us"),
        Figure::new("sync_to_pwm.worst", worst(&syncs), "us").ceiling(1_700.0),
        Figure::new("call_to_pwm.median", calls[calls.len() / 2], "us"),
        Figure::new("call_to_pwm.p99", calls[calls.len() * 99 / 100], "us"),
        Figure::new("call_to_pwm.worst", worst(&calls), "us").ceiling(17_000.0),
        Figure::new(name("sync_to_pwm.worst"), worst(&eight_syncs), "us").ceiling(2_700.0),
        Figure::new(name("call_to_pwm.median"), eight[eight.len() / 2], "us").budget(median),
        Figure::new(name("call_to_pwm.p99"), eight[eight.len() * 99 / 100], "us").budget(p99),
    ])
}

/// Calls at the cable and measures.
pub fn at_cable(group: &GroupFile, firmware: &Firmware) -> anyhow::Result<Vec<Figure>> {
    let (calls, _) = measure(&in_a_row(group, 1), firmware, true, CALLS)?;
    Ok(vec![
        Figure::new("gateway.call_to_pwm.median", calls[calls.len() / 2], "us"),
        Figure::new(
            "gateway.call_to_pwm.p99",
            calls[calls.len() * 99 / 100],
            "us",
        ),
    ])
}

/// Times from the call to the wheel, sorted, and from SYNC to it, us.
fn measure(
    group: &GroupFile,
    firmware: &Firmware,
    cable: bool,
    count: u64,
) -> anyhow::Result<(Vec<f64>, Vec<f64>)> {
    let period_us = f64::from(group.sync_period_us);
    let options = Options {
        truth_period_ns: 0,
        ..Options::default()
    };
    let mut driving = Driving::ready(group, firmware, options)?;
    if cable {
        driving.plug_in()?;
    }
    driving.start()?;
    let period_ms = u64::from(group.sync_period_us) / 1_000;
    let steps = period_ms * 1_000 / sim::test_master::STEP_US;
    let (mut calls, mut syncs) = (Vec::new(), Vec::new());
    for call in 0..count {
        driving.master.twist = Some(Twist::ZERO);
        driving.master.run(STANDS_MS)?;
        driving.master.run_to_phase(period_ms, 0)?;
        for _ in 0..call % steps {
            driving.master.step()?;
        }
        driving.master.world.start_trace();
        let called_ns = driving.master.world.now_ns();
        driving.master.twist = Some(Twist::new(0.2, 0.0, 0.0));
        driving.master.run(MOVES_MS)?;
        let changes = driving.master.world.take_duty_changes(0);
        let later: Vec<u64> = changes.into_iter().filter(|at| *at > called_ns).collect();
        // A wheel that stands may still change its duty once; one that begins to move does in every
        // tick.
        let first = later.windows(2).find_map(|pair| match pair {
            [a, b] => (b - a < 1_500_000).then_some(*a),
            _ => None,
        });
        let at = first.context("the robot does not move when it is commanded to")?;
        calls.push((at - called_ns) as f64 * 1e-3);
        // SYNC comes at whole periods.
        syncs.push((at as f64 * 1e-3) % period_us);
    }
    ensure!(
        calls.len() == count as usize,
        "some calls had no effect on the PWM"
    );
    calls.sort_by(f64::total_cmp);
    Ok((calls, syncs))
}
