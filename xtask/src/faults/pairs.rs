//! Two causes, one after the other: one that cuts always cuts within its promise, whatever happened before it or
//! happens after.
//!
//! Every ordered pair of causes that can be brought about together is tried, the second 0, 20 and 200 ms after the first.
//! Only the watched robot matters, so it alone runs the image in the trials where a cause cuts; the full product runs
//! with native robots. What is measured is when the watched robot's bridges are off and its brake is told to hold:
//!
//! - A cause that cuts: from its appearance, within its row's time. If both cut, each has to; the one with less time to
//!   spare is told.
//! - None cuts: from the first cause, within the time of whichever row is due first, the ramp, and [`HOLD_MS`] until
//!   the brake.
//!
//! A processor that stands still cuts nothing that it has to cut by program: then the time of the standstill, or of the
//! watchdog that ends it, is added ([`Case`] 17 and 20).

use group::GroupFile;
use sim::rig::Rig;

use protocol::Reaction;

use super::causes::{CASES, Case, SPEED, Trial, WATCHED};
use super::measure::{self, Robots};
use super::promise::Promise;

/// How long after the first the second appears, ms.
pub const DELAYS_MS: [u64; 3] = [0, 20, 200];
/// From the end of a ramp to the brake, at the latest (docs/safety.md), ms.
const HOLD_MS: f64 = 300.0;
/// How much longer than promised is looked, ms.
const MARGIN_MS: f64 = 30.0;
/// How long a standstill of the processor lasts, ms: cause 17 as it is brought about.
const STANDSTILL_MS: f64 = 22.0;
/// Causes that stop or upset the processor; one at a time.
const OF_PROCESSOR: std::ops::RangeInclusive<u8> = 17..=20;

/// Two causes and the time between them.
#[derive(Clone, Copy)]
pub struct Pair<'a> {
    pub first: (&'a Promise, &'static Case),
    pub second: (&'a Promise, &'static Case),
    pub delay_ms: u64,
}

/// What came of a pair.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    pub promise_ms: f64,
    /// `None`: not within the time that was looked.
    pub measured_ms: Option<f64>,
}

impl Outcome {
    pub fn kept(&self) -> bool {
        self.measured_ms.is_some_and(|ms| ms <= self.promise_ms)
    }
}

/// The pairs of all causes.
pub fn all(promises: &[Promise]) -> Vec<Pair<'_>> {
    let promised = |case: &'static Case| {
        let promise = promises.iter().find(|p| p.number == case.number)?;
        promise.millis.map(|_| (promise, case))
    };
    let causes: Vec<_> = CASES
        .iter()
        .filter(|case| !case.alone && !matches!(case.trial, Trial::Stored(_)))
        .filter_map(promised)
        .collect();
    let mut pairs = Vec::new();
    for first in &causes {
        for second in causes
            .iter()
            .filter(|second| go_together(first.1, second.1))
        {
            pairs.extend(DELAYS_MS.map(|delay_ms| Pair {
                first: *first,
                second: *second,
                delay_ms,
            }));
        }
    }
    pairs
}

fn is_of_processor(case: &Case) -> bool {
    OF_PROCESSOR.contains(&case.number)
        || [30, 31].contains(&case.number)
        || case.variant == "processor halted"
}

/// Whether both can be brought about: not when they do something else to the same thing.
fn go_together(first: &Case, second: &Case) -> bool {
    /// The front left encoder; the setpoints that the master sends; the supply.
    const SAME: [&[u8]; 3] = [&[11, 12], &[3, 7, 8], &[16, 26]];
    let both =
        |numbers: &&[u8]| numbers.contains(&first.number) && numbers.contains(&second.number);
    let of_processor = (is_of_processor(first), is_of_processor(second));
    // A robot that does not run has nothing to send, so its controller cannot go off the bus.
    let silent = of_processor.0 && second.number == 9;
    first.number != second.number
        && !SAME.iter().any(both)
        && of_processor != (true, true)
        && !silent
}

impl Pair<'_> {
    /// Whether one of the two cuts.
    pub fn cuts(&self) -> bool {
        cuts(self.first.0) || cuts(self.second.0)
    }

    /// Whether it needs a processor.
    pub fn needs_image(&self) -> bool {
        is_of_processor(self.first.1) || is_of_processor(self.second.1)
    }

    pub fn concerns(&self, number: u8) -> bool {
        self.first.0.number == number || self.second.0.number == number
    }

    /// Tries it; `Err` when it could not be brought about or a robot stopped.
    pub fn measure(&self, group: &GroupFile, robots: Robots<'_>) -> anyhow::Result<Outcome> {
        let mut rig = measure::driving(group, robots, SPEED)?;
        rig.run_to_phase(100, 1)?;
        self.first.1.trial.appear(&mut rig)?;
        let first_ns = rig.world.now_ns();
        run_to(&mut rig, first_ns + self.delay_ms * 1_000_000)?;
        self.second.1.trial.appear(&mut rig)?;
        let second_ns = rig.world.now_ns();
        let promises = self.promises(group, first_ns, second_ns);
        let ends = promises
            .iter()
            .map(|(from_ns, ms)| *from_ns as f64 + ms * 1e6);
        let last = ends.fold(0.0, f64::max) + MARGIN_MS * 1e6;
        run_to(&mut rig, last as u64)?;
        let safe_ns = rig.world.safe_since_ns(WATCHED);
        let outcome = |(from_ns, promise_ms): (u64, f64)| Outcome {
            promise_ms,
            measured_ms: safe_ns.map(|at| at.saturating_sub(from_ns) as f64 / 1e6),
        };
        let spare = |o: &Outcome| {
            o.measured_ms
                .map_or(f64::NEG_INFINITY, |ms| o.promise_ms - ms)
        };
        let outcomes = promises.into_iter().map(outcome);
        let worst = outcomes.min_by(|a, b| spare(a).total_cmp(&spare(b)));
        worst.ok_or_else(|| anyhow::anyhow!("nothing is promised"))
    }

    /// What has to hold: from when, ns, and within what, ms.
    fn promises(&self, group: &GroupFile, first_ns: u64, second_ns: u64) -> Vec<(u64, f64)> {
        let both = [(self.first, first_ns), (self.second, second_ns)];
        let millis = |promise: &Promise| promise.millis.unwrap_or(0.0);
        if self.cuts() {
            let other_ms = |cause: &Case| {
                let other = if std::ptr::eq(cause, self.first.1) {
                    self.second
                } else {
                    self.first
                };
                match other.1.number {
                    17 => STANDSTILL_MS,
                    20 => millis(other.0),
                    _ => 0.0,
                }
            };
            let cutting = both.into_iter().filter(|((promise, _), _)| cuts(promise));
            return cutting
                .map(|((promise, case), at)| (at, millis(promise) + other_ms(case)))
                .collect();
        }
        let (v, d, j) = (
            f64::from(SPEED),
            f64::from(group.limits.linear_acceleration),
            f64::from(group.limits.linear_jerk),
        );
        let ramp_ms = (v / d + d / j) * 1e3;
        let later_ms = second_ns.saturating_sub(first_ns) as f64 / 1e6;
        let due = millis(self.first.0).min(later_ms + millis(self.second.0));
        vec![(first_ns, due + ramp_ms + HOLD_MS)]
    }
}

fn cuts(promise: &Promise) -> bool {
    promise.fault.reaction() == Reaction::Cut
}

/// Goes on to a time, ns, by the steps of the master.
fn run_to(rig: &mut Rig, end_ns: u64) -> anyhow::Result<()> {
    while rig.world.now_ns() < end_ns {
        rig.step()?;
    }
    Ok(())
}
