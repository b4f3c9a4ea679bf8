//! How late things on a schedule were: a histogram of whole microseconds.
//!
//! It holds 10 000 counts and never grows, so a session may run for days. Mean and worst are exact;
//! the 99 % value is rounded up to a whole microsecond and, beyond 10 ms, stands at 10 ms.

use std::time::{Duration, Instant};

/// Lateness from which all values share the last count, in µs.
const LONGEST_US: usize = 10_000;
/// What counts as recent.
const RECENT: Duration = Duration::from_secs(1);
/// Lateness that real-time priority would have prevented, in µs: a tenth of a period at 100 Hz.
const NOTABLE_US: f64 = 1_000.0;

/// How late frames of a schedule went out, in µs. What is measured is when the system took the
/// frame, after the time it was due.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Punctuality {
    /// How many were sent.
    pub count: u64,
    /// Mean lateness.
    pub mean_us: f64,
    /// 99 of 100 were not later than this.
    pub p99_us: f64,
    /// The latest one.
    pub worst_us: f64,
    /// The latest one of the last second.
    pub lately_us: f64,
    /// Whether the system gave the thread that sends them real-time priority.
    pub realtime: bool,
    /// Setpoints that were not ready in time for their SYNC.
    pub missed: u64,
}

/// A histogram of lateness.
#[derive(Clone, Debug)]
pub struct Lateness {
    counts: Vec<u32>,
    count: u64,
    sum_ns: u64,
    worst_ns: u64,
    /// When the latest of the last second went out, and how late.
    recent: Option<(Instant, u64)>,
    realtime: bool,
    missed: u64,
}

impl Default for Lateness {
    fn default() -> Self {
        Self {
            counts: vec![0; LONGEST_US + 1],
            count: 0,
            sum_ns: 0,
            worst_ns: 0,
            recent: None,
            realtime: false,
            missed: 0,
        }
    }
}

impl Lateness {
    /// One thing was so late.
    pub fn record(&mut self, late_ns: u64) {
        let bin = usize::try_from(late_ns.div_ceil(1000)).unwrap_or(LONGEST_US);
        self.counts[bin.min(LONGEST_US)] += 1;
        self.count += 1;
        self.sum_ns += late_ns;
        self.worst_ns = self.worst_ns.max(late_ns);
        if self.lately_ns() <= late_ns {
            self.recent = Some((Instant::now(), late_ns));
        }
    }

    fn lately_ns(&self) -> u64 {
        let recent = self.recent.filter(|(at, _)| at.elapsed() < RECENT);
        recent.map_or(0, |(_, late_ns)| late_ns)
    }

    /// Whether the system gave real-time priority.
    pub fn set_realtime(&mut self, realtime: bool) {
        self.realtime = realtime;
    }

    /// `slots` of the schedule passed without their setpoint.
    pub fn miss(&mut self, slots: u64) {
        self.missed += slots;
    }

    /// What it comes to.
    #[must_use]
    pub fn read(&self) -> Punctuality {
        let enough = self.count - self.count / 100;
        let mut seen = 0;
        let p99 = self.counts.iter().position(|count| {
            seen += u64::from(*count);
            seen >= enough
        });
        Punctuality {
            count: self.count,
            mean_us: self.sum_ns as f64 / self.count.max(1) as f64 / 1000.0,
            p99_us: p99.unwrap_or(0) as f64,
            worst_us: self.worst_ns as f64 / 1000.0,
            lately_us: self.lately_ns() as f64 / 1000.0,
            realtime: self.realtime,
            missed: self.missed,
        }
    }
}

impl std::fmt::Display for Punctuality {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} SYNCs, late by {:.0} us on average, 99 % within {:.0} us, worst {:.0} us",
            self.count, self.mean_us, self.p99_us, self.worst_us
        )?;
        if self.missed > 0 {
            write!(
                f,
                "; {} went without a new setpoint, because this computer was late",
                self.missed
            )?;
        }
        if !self.realtime && self.worst_us > NOTABLE_US {
            f.write_str(
                "; real-time priority would help (docs/operating.md, Busy computers: how to permit \
                 it)",
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 98 at 10 us, one at 50 us, one at 3000 us: by hand.
    #[test]
    fn mean_99_percent_and_worst() {
        let mut lateness = Lateness::default();
        for _ in 0..98 {
            lateness.record(10_000);
        }
        lateness.record(50_000);
        lateness.record(3_000_000);
        let read = lateness.read();
        assert_eq!(read.count, 100);
        assert!((read.mean_us - (980.0 + 50.0 + 3000.0) / 100.0).abs() < 1e-9);
        assert_eq!(read.p99_us, 50.0);
        assert_eq!(read.worst_us, 3000.0);
        assert_eq!(read.lately_us, 3000.0);
        assert!(read.to_string().ends_with("how to permit it)"));
        lateness.set_realtime(true);
        assert!(lateness.read().to_string().ends_with("worst 3000 us"));
    }

    #[test]
    fn nothing_noted_is_nothing_late_and_the_far_end_holds() {
        assert_eq!(Lateness::default().read(), Punctuality::default());
        let mut lateness = Lateness::default();
        lateness.record(60_000_000_000);
        lateness.miss(2);
        assert_eq!(lateness.read().p99_us, 10_000.0);
        assert_eq!(lateness.read().worst_us, 60e6);
        assert!(
            lateness
                .read()
                .to_string()
                .contains("2 went without a new setpoint")
        );
    }
}
