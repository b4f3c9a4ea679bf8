//! Drives on a CAN bus of their own that regulate the motor's current and report its angle:
//! RoboMaster C620 and C610.
//!
//! # Theory of operation
//!
//! A drive reports the angle of the rotor a thousand times a second, modulo a turn. [`Drives`] adds
//! the differences to a count that wraps at 16 bits, as an encoder's counter does. It extrapolates
//! this count from the last report to the time of the tick with the rate that the drive reports.
//! Drives and tick have clocks of their own, so without the extrapolation a tick would now and then
//! use a report twice or miss one.
//!
//! A difference is unambiguous up to half a turn of the rotor. At [`SILENT_US`] without a report
//! that is 10 000 rpm, more than these motors reach.
//!
//! # Faults
//!
//! | what is seen | fault | after |
//! |---|---|---|
//! | one identifier reports far more often than a drive does | `DriveDoubled` | [`WINDOW_US`], twice at most |
//! | reports of an identifier that no wheel has | `DriveIdentifier` | at once |
//! | a wheel's drive does not report: off, unplugged, or its bus is broken | `DriveSilent` | [`SILENT_US`] |
//! | a motor is hotter than it may be | `DriveHot`, which ramps | at once |
//!
//! The first in this order is reported, because it is the cause of those below it. Before a wheel's
//! drive has reported for the first time it counts as silent.
//!
//! # Interface
//!
//! The receive interrupt calls [`Drives::on_frame`] with each frame, and the tick calls
//! [`Drives::counts`] and [`Drives::fault`], and where wheels have an index
//! [`Drives::index_pulses`](index).

pub mod frames;
pub mod index;

use protocol::Fault;

use crate::time::Micros;
use frames::{COUNTS, FIRST_FEEDBACK, Feedback, IDENTIFIERS};

/// A drive that has not reported for so long is silent, us: three reports.
pub const SILENT_US: u64 = 3_000;

/// Reports are counted over so long, us,
pub const WINDOW_US: u64 = 20_000;

/// and this many of one identifier are those of two drives: a half more than the 20 of one.
const DOUBLED: u8 = 30;

/// An identifier that no wheel has is one while it has reported within this time, us.
const STRANGE_US: u64 = 100_000;

/// Counts in a microsecond for one rpm.
const COUNTS_PER_RPM_US: f32 = COUNTS as f32 / 60e6;

/// The drives of the wheels, as the configuration has them.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct DriveConfiguration {
    /// Identifier of each wheel's drive, 1 to 4, all different: front left, front right, rear left,
    /// rear right.
    pub identifiers: [u8; 4],
    /// Highest temperature of a motor, degrees Celsius.
    pub hottest: u8,
}

impl DriveConfiguration {
    /// Until there is a configuration.
    pub const DEFAULT: Self = Self {
        identifiers: [1, 2, 3, 4],
        hottest: 80,
    };
}

/// What is known of the drive with one identifier.
#[derive(Clone, Copy)]
struct Seen {
    at: Option<Micros>,
    angle: u16,
    count: u16,
    rpm: i16,
    temperature: u8,
    /// Reports in the present window, and whether the last one had too many.
    reports: u8,
    doubled: bool,
}

impl Seen {
    const NOTHING: Self = Self {
        at: None,
        angle: 0,
        count: 0,
        rpm: 0,
        temperature: 0,
        reports: 0,
        doubled: false,
    };

    fn take(&mut self, feedback: &Feedback, now: Micros) {
        if self.at.is_some() {
            self.count = self
                .count
                .wrapping_add(difference(self.angle, feedback.angle));
        }
        self.at = Some(now);
        self.angle = feedback.angle;
        self.rpm = feedback.rpm;
        self.temperature = feedback.temperature;
        self.reports = self.reports.saturating_add(1);
    }

    /// Time since the last report, us.
    fn age_us(&self, now: Micros) -> Option<u64> {
        self.at.map(|at| now.since(at).0)
    }

    fn is_silent(&self, now: Micros) -> bool {
        self.age_us(now).is_none_or(|age| age > SILENT_US)
    }

    /// The count at a time shortly after the last report.
    fn count_at(&self, now: Micros) -> u16 {
        self.count_after(self.age_us(now).unwrap_or(0) as f32)
    }

    /// The count so long after the last report, us, or before it.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "at most 32 767 rpm for three milliseconds: 13 422 counts"
    )]
    fn count_after(&self, us: f32) -> u16 {
        const LONGEST: f32 = SILENT_US as f32;
        let ahead = f32::from(self.rpm) * us.clamp(-LONGEST, LONGEST) * COUNTS_PER_RPM_US;
        self.count.wrapping_add((ahead as i16).cast_unsigned())
    }
}

/// From one angle of the rotor to the next, the shorter way, wrapping.
fn difference(from: u16, to: u16) -> u16 {
    // 13 bits at the upper end of 16: the sign is that of the shorter way.
    const SHIFT: u32 = 3;
    ((to.wrapping_sub(from) << SHIFT).cast_signed() >> SHIFT).cast_unsigned()
}

/// What is known of all drives on the bus.
#[derive(Clone)]
pub struct Drives {
    seen: [Seen; IDENTIFIERS],
    /// Beginning of the window in which reports are counted.
    window: Micros,
}

impl Default for Drives {
    fn default() -> Self {
        Self::new()
    }
}

impl Drives {
    /// Nothing has reported yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            seen: [Seen::NOTHING; IDENTIFIERS],
            window: Micros::ZERO,
        }
    }

    /// A frame has come at a time. What is no feedback is ignored.
    pub fn on_frame(&mut self, id: u16, data: &[u8], now: Micros) {
        self.turn_window(now);
        let place = usize::from(id.wrapping_sub(FIRST_FEEDBACK));
        let seen = self.seen.get_mut(place);
        if let (Some(seen), Some(feedback)) = (seen, Feedback::decode(data)) {
            seen.take(&feedback, now);
        }
    }

    fn turn_window(&mut self, now: Micros) {
        if now.since(self.window).0 >= WINDOW_US {
            self.window = now;
            for seen in &mut self.seen {
                seen.doubled = seen.reports >= DOUBLED;
                seen.reports = 0;
            }
        }
    }

    /// The drive of a wheel.
    fn of(&self, identifier: u8) -> &Seen {
        let place = usize::from(identifier).wrapping_sub(1);
        self.seen.get(place).unwrap_or(&Seen::NOTHING)
    }

    /// The counts of the wheels' rotors at this time, wrapping at 16 bits.
    #[must_use]
    pub fn counts(&self, drives: &DriveConfiguration, now: Micros) -> [u16; 4] {
        drives.identifiers.map(|n| self.of(n).count_at(now))
    }

    /// The hottest motor, degrees Celsius.
    #[must_use]
    pub fn temperature(&self, drives: &DriveConfiguration) -> u8 {
        let temperatures = drives.identifiers.map(|n| self.of(n).temperature);
        temperatures.into_iter().max().unwrap_or(0)
    }

    /// What is wrong with the drives, the most likely cause first.
    #[must_use]
    pub fn fault(&self, drives: &DriveConfiguration, now: Micros) -> Option<Fault> {
        if self.seen.iter().any(|seen| seen.doubled) {
            return Some(Fault::DriveDoubled);
        }
        let strange = |(identifier, seen): (u8, &Seen)| {
            !drives.identifiers.contains(&identifier)
                && seen.age_us(now).is_some_and(|age| age <= STRANGE_US)
        };
        if (1..).zip(&self.seen).any(strange) {
            return Some(Fault::DriveIdentifier);
        }
        if drives
            .identifiers
            .iter()
            .any(|n| self.of(*n).is_silent(now))
        {
            return Some(Fault::DriveSilent);
        }
        (self.temperature(drives) > drives.hottest).then_some(Fault::DriveHot)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHEELS: DriveConfiguration = DriveConfiguration::DEFAULT;

    fn report(angle: u16, rpm: i16, temperature: u8) -> [u8; 8] {
        let [a, b] = angle.to_be_bytes();
        let [c, d] = rpm.to_be_bytes();
        [a, b, c, d, 0, 0, temperature, 0]
    }

    /// Drives 1 to 4 report every millisecond for so long; returns what they are then.
    fn healthy(ms: u64) -> Drives {
        let mut drives = Drives::new();
        for ms in 0..ms {
            for id in 0x201..0x205 {
                drives.on_frame(id, &report(0, 0, 30), Micros(1_000 * ms));
            }
        }
        drives
    }

    /// Any rate up to 9 200 rpm, the no-load speed of an M3508's rotor, either way: after 2 s the
    /// count is 8192 for each turn, modulo 2^16.
    #[test]
    fn the_angle_is_unwrapped_in_both_directions() {
        for rpm in [9_200_i32, 1, 137, -1, -9_200, 0] {
            let mut drives = Drives::new();
            let counts = |us: i64| i64::from(rpm) * us * 8192 / 60_000_000;
            for us in (0..=2_000_000).step_by(1_000) {
                let angle = counts(us).rem_euclid(8192) as u16;
                drives.on_frame(0x202, &report(angle, rpm as i16, 0), Micros(us as u64));
            }
            let now = Micros(2_000_000);
            let [_, count, ..] = drives.counts(&WHEELS, now);
            assert_eq!(count, counts(2_000_000) as u16, "{rpm} rpm");
        }
    }

    /// Drives and tick drift past each other: 1.0 ms and 0.999 ms. At a constant 3 000 rpm every
    /// tick must see 409.2 counts, to within the truncation of a count at either end.
    #[test]
    fn reports_and_ticks_that_drift_apart_leave_the_rate_smooth() {
        let (mut drives, mut reported, mut last) = (Drives::new(), 0_u64, None);
        for tick in 0..5_000_u64 {
            let now = tick * 999;
            while reported <= now {
                let angle = (3_000 * reported * 8192 / 60_000_000 % 8192) as u16;
                drives.on_frame(0x201, &report(angle, 3_000, 0), Micros(reported));
                reported += 1_000;
            }
            let [count, ..] = drives.counts(&WHEELS, Micros(now));
            if let Some(last) = last.replace(count) {
                let passed = f64::from(count.wrapping_sub(last));
                assert!((passed - 409.2).abs() <= 2.0, "{passed} at {tick}");
            }
        }
    }

    #[test]
    fn a_wheel_is_where_its_identifier_says() {
        let mut drives = Drives::new();
        for (id, angle) in [(0x201, 10), (0x202, 20), (0x203, 30), (0x204, 40)] {
            drives.on_frame(id, &report(0, 0, 0), Micros(0));
            drives.on_frame(id, &report(angle, 0, 0), Micros(1_000));
        }
        let crossed = DriveConfiguration {
            identifiers: [3, 1, 4, 2],
            ..WHEELS
        };
        assert_eq!(drives.counts(&crossed, Micros(1_000)), [30, 10, 40, 20]);
    }

    #[test]
    fn silence_is_a_fault_after_three_milliseconds_and_before_the_first_report() {
        assert_eq!(
            Drives::new().fault(&WHEELS, Micros(0)),
            Some(Fault::DriveSilent)
        );
        let mut drives = healthy(50);
        assert_eq!(drives.fault(&WHEELS, Micros(49_000)), None);
        for ms in 50..52 {
            for id in 0x201..0x204 {
                drives.on_frame(id, &report(0, 0, 30), Micros(1_000 * ms));
            }
        }
        assert_eq!(drives.fault(&WHEELS, Micros(52_000)), None);
        let silent = Some(Fault::DriveSilent);
        assert_eq!(drives.fault(&WHEELS, Micros(52_001)), silent);
    }

    #[test]
    fn two_drives_on_one_identifier_are_named_before_the_one_that_is_missing() {
        let mut drives = Drives::new();
        for us in (0..60_000).step_by(500) {
            // Two of them 3, one 1 and one 2; nobody is 4.
            drives.on_frame(0x203, &report((us % 2 * 4_000) as u16, 0, 30), Micros(us));
            for id in [0x201, 0x202] {
                if us % 1_000 == 0 {
                    drives.on_frame(id, &report(0, 0, 30), Micros(us));
                }
            }
        }
        let doubled = Some(Fault::DriveDoubled);
        assert_eq!(drives.fault(&WHEELS, Micros(59_500)), doubled);
        // Mended: it is over after the next whole window.
        for us in (60_000..110_000).step_by(1_000) {
            for id in 0x201..0x205 {
                drives.on_frame(id, &report(0, 0, 30), Micros(us));
            }
        }
        assert_eq!(drives.fault(&WHEELS, Micros(109_500)), None);
    }

    #[test]
    fn an_identifier_that_no_wheel_has_is_named() {
        let mut drives = healthy(50);
        drives.on_frame(0x207, &report(0, 0, 30), Micros(49_000));
        let strange = Some(Fault::DriveIdentifier);
        assert_eq!(drives.fault(&WHEELS, Micros(49_000)), strange);
        // A command of another sender, and frames of other devices, are not feedback.
        let mut drives = healthy(50);
        for id in [0x200, 0x1FF, 0x209, 0, 0x7FF] {
            drives.on_frame(id, &report(0, 0, 99), Micros(49_000));
        }
        assert_eq!(drives.fault(&WHEELS, Micros(49_000)), None);
    }

    #[test]
    fn a_hot_motor_is_named() {
        let mut drives = healthy(50);
        drives.on_frame(0x204, &report(0, 0, 80), Micros(49_000));
        assert_eq!(drives.fault(&WHEELS, Micros(49_000)), None);
        drives.on_frame(0x204, &report(0, 0, 81), Micros(49_000));
        assert_eq!(drives.fault(&WHEELS, Micros(49_000)), Some(Fault::DriveHot));
    }
}
