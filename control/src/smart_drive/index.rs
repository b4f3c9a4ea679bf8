//! The count of a smart drive at the index of its wheel.
//!
//! # Theory of operation
//!
//! No counter stands behind the wheel, so the interrupt of the index takes the time of the edge,
//! and the next tick asks what the drive's count was then. The last report has the rotor's angle
//! and rate: the count is carried on by that rate to the edge, or back to it. A report is as old as
//! its frame is long when it has come, and the wheel was ahead of it by so much
//! ([`REPORT_US`]).
//!
//! # Error
//!
//! Against where the rotor stood at the edge, at a rate `r` (counts/s) and an acceleration `a`, the
//! report taken a time `t` from the edge, of at most [`FARTHEST_US`]:
//!
//! ```text
//! |error| <= 2 + r (bits + wait + 2 us) + 0.5 rpm t + a t^2 / 2
//! ```
//!
//! One count each of the angle's resolution and of the cut after carrying it; the frame's stuff
//! bits, 12 us more or less than the middle; the wait of a report for a control tick, which has the
//! same priority, 100 us; a microsecond of each clock. With M3508 motors and wheels of 76 mm that
//! are 10 counts at the 0.2 m/s of the search for an index, 0.022 degrees of the wheel, and 36
//! counts at 0.9 m/s, 0.082 degrees. [`index_error`] is this bound without the acceleration, which
//! adds 0.6 counts at 2.4 m/s2.
//!
//! # Limits
//!
//! How long a drive takes from the angle to the frame is in no manual, and is not in the bound:
//! every 100 us of it are 0.015 degrees at 0.2 m/s and 0.07 at 0.9 m/s. Nor is the time that a
//! report waits for others on the bus, if the drive takes the angle before.

use super::{COUNTS_PER_RPM_US, DriveConfiguration, Drives};
use crate::rollers::IndexPulse;
use crate::time::Micros;

/// From the angle to the received report, us: a frame of 108 bits at 1 Mbit/s and half of the
/// 24 stuff bits that it can have.
const REPORT_US: f32 = 120.0;

/// What the time of a report can be off by, us: the other stuff bits, a wait for the tick, and two
/// clocks that are read in whole microseconds.
const LATE_US: f32 = 12.0 + 100.0 + 2.0;

/// The longest time between a report's angle and an edge, us: a millisecond from report to report
/// or from tick to tick, and what a report takes.
const FARTHEST_US: f32 = 1_000.0 + REPORT_US + LATE_US;

/// The edge of an index pulse.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct IndexEdge {
    /// Counts the pulses, wrapping: a new one has come when this changes.
    pub number: u8,
    /// Lower half of the local time at the edge, us.
    pub at_us: u16,
}

/// Counts by which the count at an edge can be off at a rate, counts/s.
#[must_use]
pub fn index_error(rate: f32) -> f32 {
    2.0 + rate.abs() * LATE_US * 1e-6 + 0.5 * COUNTS_PER_RPM_US * FARTHEST_US
}

impl Drives {
    /// The index pulses of the wheels, whose edges have come by now. The count of an edge is right
    /// in the tick that follows it; later only the number counts.
    #[must_use]
    pub fn index_pulses(
        &self,
        drives: &DriveConfiguration,
        edges: &[IndexEdge; 4],
        now: Micros,
    ) -> [IndexPulse; 4] {
        let [low, high, ..] = now.0.to_le_bytes();
        let now_us = u16::from_le_bytes([low, high]);
        let [a, b, c, d] = *edges;
        let [e, f, g, h] = drives.identifiers;
        let one = |edge: IndexEdge, identifier| {
            let seen = self.of(identifier);
            // Negative for an edge after the tick has begun.
            let ago = f32::from(now_us.wrapping_sub(edge.at_us).cast_signed());
            let age = seen.age_us(now).unwrap_or(0) as f32;
            IndexPulse {
                number: edge.number,
                count: seen.count_after(age - ago + REPORT_US),
            }
        };
        [one(a, e), one(b, f), one(c, g), one(d, h)]
    }
}

#[cfg(test)]
mod tests {
    use super::super::{FIRST_FEEDBACK, SILENT_US};
    use super::*;

    const WHEELS: DriveConfiguration = DriveConfiguration::DEFAULT;

    /// Counts of a radian of the wheel, behind the M3508's gear of 3591 : 187, and the wheel's
    /// radius, m.
    const COUNTS_PER_RAD: f64 = 8192.0 * 3591.0 / 187.0 / std::f64::consts::TAU;
    const RADIUS: f64 = 0.076;

    /// Of one run.
    const TICKS: u32 = 1_000;

    /// A wheel that goes by `v` (m/s) at first and by `a` (m/s2) faster every second. Its drive has
    /// a clock of its own and reports through frames of any length, which now and then wait for a
    /// tick; edges come at any time. The largest error of the counts at the edges.
    fn worst(v: f64, a: f64) -> f64 {
        let position = |us: f64| {
            let t = us * 1e-6;
            (v * t + a * t * t / 2.0) / RADIUS * COUNTS_PER_RAD
        };
        let rpm = |us: f64| (v + a * us * 1e-6) / RADIUS * COUNTS_PER_RAD / 8192.0 * 60.0;
        let (mut drives, mut random, mut worst) = (Drives::new(), 1_u32, 0.0_f64);
        let mut next = |below: f64| {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(random) / 2_f64.powi(32) * below
        };
        // When the next report's angle is taken, and when it has come.
        let (mut taken, mut comes) = (0.0, 108.0);
        for tick in 0..TICKS {
            let now = 1_000.0 * f64::from(tick);
            while comes <= now {
                let angle = position(taken).floor().rem_euclid(8192.0) as u16;
                let [a, b] = angle.to_be_bytes();
                let [c, d] = (rpm(taken).round() as i16).to_be_bytes();
                let data = [a, b, c, d, 0, 0, 30, 0];
                drives.on_frame(FIRST_FEEDBACK, &data, Micros(comes as u64));
                taken += 999.7;
                let waits = if next(3.0) < 1.0 { next(100.0) } else { 0.0 };
                comes = taken + 108.0 + next(24.0) + waits;
            }
            if tick < 4 {
                continue;
            }
            let edge = now - next(1_000.0);
            let edges = [IndexEdge {
                number: 0,
                at_us: edge as u64 as u16,
            }; 4];
            let [pulse, ..] = drives.index_pulses(&WHEELS, &edges, Micros(now as u64));
            let off = pulse
                .count
                .wrapping_sub(position(edge).floor() as i64 as u16);
            worst = worst.max(f64::from(off.cast_signed()).abs());
        }
        worst
    }

    /// From the crawl of a fit to more than any motor gives, both ways, and while it accelerates by
    /// 2.4 m/s2; and what remains is small beside a roller's pitch of 45 degrees.
    #[test]
    fn the_count_at_an_edge_is_within_its_bound() {
        for v in [0.0, 0.02, 0.2, -0.2, 0.9, -0.9, 3.0] {
            for a in [0.0, 2.4, -2.4] {
                let seconds = f64::from(TICKS) * 1e-3;
                let fastest = (f64::abs(v) + f64::abs(a) * seconds) / RADIUS * COUNTS_PER_RAD;
                let span = f64::from(FARTHEST_US) * 1e-6;
                let bent = f64::abs(a) / RADIUS * COUNTS_PER_RAD * span * span / 2.0;
                let bound = f64::from(index_error(fastest as f32)) + bent;
                let worst = worst(v, a);
                std::println!("{v} m/s, {a} m/s2: {worst} counts of {bound:.1}");
                assert!(worst <= bound, "{v} m/s, {a} m/s2: {worst} of {bound}");
            }
        }
        let degrees = |v: f64| {
            let rate = (v / RADIUS * COUNTS_PER_RAD) as f32;
            f64::from(index_error(rate)) / COUNTS_PER_RAD * 180.0 / std::f64::consts::PI
        };
        assert!(degrees(0.2) < 0.023 && degrees(0.9) < 0.085);
    }

    /// Drives that stand or have never reported, and edges long ago, give a number and no more.
    #[test]
    fn an_edge_is_told_by_its_number() {
        let edges = [1, 2, 3, 4].map(|number| IndexEdge { number, at_us: 0 });
        for now in [0, 1, 40_000, 70_000, u64::MAX] {
            let pulses = Drives::new().index_pulses(&WHEELS, &edges, Micros(now));
            assert_eq!(pulses.map(|pulse| pulse.number), [1, 2, 3, 4]);
            assert_eq!(pulses.map(|pulse| pulse.count), [0; 4]);
        }
        assert!(
            FARTHEST_US < SILENT_US as f32,
            "no edge is farther from its report"
        );
    }
}
