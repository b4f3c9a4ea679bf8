//! The highest rate of the control tick that holds, by running images that tick faster.
//!
//! Each image differs from the release image only in the period of its tick. Three robots drive for
//! a second; the rate holds when none of them has a fault and no tick of the first one is late by
//! half a period, as the robot itself counts it. Rates are tried from the highest one that fits
//! into the available time.

use emulator::Firmware;
use group::GroupFile;
use protocol::MemberState;
use sim::Options;

use super::driving::Driving;
use super::figure::{Better, Figure};
use super::running;
use crate::firmware;

/// Periods that are tried, us: parts of SYNC's period, or robots would not tick together.
const PERIODS_US: [u32; 9] = [25, 40, 50, 80, 100, 125, 200, 250, 500];
/// Time of driving that is measured, ms.
const MEASURED_MS: u64 = 1_000;

/// The highest rate that holds, at most the one that was calculated (kHz).
pub fn figure(group: &GroupFile, calculated_khz: f64) -> anyhow::Result<Figure> {
    let mut held = 1_000;
    for period_us in PERIODS_US {
        if 1e3 / f64::from(period_us) > calculated_khz {
            continue;
        }
        let image = Firmware::load(&firmware::build_with_tick(period_us)?)?;
        if holds(group, &image, period_us)? {
            held = period_us;
            break;
        }
    }
    let rate = Figure::new("tick.rate", 1e3 / f64::from(held), "kHz").ceiling(HELD_KHZ);
    Ok(Figure {
        better: Better::Higher,
        ..rate
    })
}

/// What has been reached.
const HELD_KHZ: f64 = 25.0;

fn holds(group: &GroupFile, image: &Firmware, period_us: u32) -> anyhow::Result<bool> {
    let options = Options {
        truth_period_ns: 0,
        ..Options::default()
    };
    let tick = running::function(image, running::TICK)?;
    let Ok(mut driving) = Driving::new(group, image, options) else {
        return Ok(false); // it does not come to driving
    };
    let robot = driving.first()?.clone();
    robot.start_profile(&[tick]);
    driving.drive(MEASURED_MS)?;
    let profile = robot.take_profile()?;
    let begins: Vec<f64> = profile
        .calls(tick)
        .iter()
        .map(|call| call.began as f64 / running::CYCLES_PER_US)
        .collect();
    let longest = begins.windows(2).filter_map(|pair| match pair {
        [a, b] => Some(b - a),
        _ => None,
    });
    let longest = longest.fold(0.0, f64::max);
    let period_us = f64::from(period_us);
    let full = MEASURED_MS as f64 * 1e3 / period_us;
    // Steering towards SYNC makes a period at most 2 % longer.
    let all = begins.len() as f64 > 0.97 * full;
    Ok(all && longest <= 1.5 * period_us && driving.master.all_are(MemberState::Moving))
}
