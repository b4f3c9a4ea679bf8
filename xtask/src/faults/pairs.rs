//! Two causes, one after the other: a cause that cuts must cut within its promised time, whatever
//! cause comes before or after it.
//!
//! Every ordered pair of causes that can be combined is tested, with the second 0, 20 and 200 ms
//! after the first. Only the watched robot is measured, so only it runs the image in the trials
//! where a cause cuts; the full product runs with native robots. A trial measures when the watched
//! robot's bridges are off and its brake is commanded to engage:
//!
//! - A cause that cuts: from its appearance, within its row's time. If both cut, each has to; the
//!   one with less margin is reported.
//! - None cuts: from the first cause, within the time of whichever row is due first, the ramp, and
//!   [`HOLD_MS`] until the brake.
//!
//! A halted processor cannot cut by program ([`Case`] 17 and 20). A cause that is not yet due when
//! the halt begins has its time from the moment when the processor resumes or is reset by its
//! watchdog.
//!
//! For a reversed encoder (12) the page promises more time where the wheel is already slow, and in
//! return that the wheel does not become faster: [`Slow`]. On a wheel at rest the fault has no
//! effect, and the robot is off at the end of the ramp.

use acceptance::causes::{Promise, Slow};
use group::{GroupFile, StageKind};
use sim::test_master::TestMaster;

use protocol::Reaction;

use crate::firmware::Board;

use super::causes::{CASES, Case, Procedure, SPEED, WATCHED};
use super::measure::Driving;

/// How long after the first the second appears, ms.
pub const DELAYS_MS: [u64; 3] = [0, 20, 200];
/// From the end of a ramp to the brake, at the latest (docs/safety.md), ms.
const HOLD_MS: f64 = 300.0;
/// How much longer than promised is looked, ms.
const MARGIN_MS: f64 = 30.0;
/// How long a standstill of the processor lasts, ms: cause 17 as it is brought about.
const STANDSTILL_MS: f64 = 22.0;
/// The cause of a reversed encoder.
const REVERSED: u8 = 12;
/// What a rate may be larger than promised, rad/s: as fine as the table of the page.
const RESOLUTION: f64 = 0.01;
/// A wheel that is slower stands, rad/s.
const STANDS: f64 = 0.05;
/// Causes that stop or upset the processor; one at a time.
const OF_PROCESSOR: std::ops::RangeInclusive<u8> = 17..=20;

/// Two causes and the time between them.
#[derive(Clone, Copy)]
pub struct Pair<'a> {
    pub first: (&'a Promise, &'static Case),
    pub second: (&'a Promise, &'static Case),
    pub delay_ms: u64,
}

/// The result of a pair.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    pub promise_ms: f64,
    /// `None`: not within the time that was looked.
    pub measured_ms: Option<f64>,
    /// The wheel with the reversed encoder became faster than it may.
    pub faster: bool,
}

impl Outcome {
    pub fn holds(&self) -> bool {
        !self.faster && self.measured_ms.is_some_and(|ms| ms <= self.promise_ms)
    }
}

/// The pairs of all causes that concern a board and its kind of bridges.
pub fn all(promises: &[Promise], (board, stage): (Board, StageKind)) -> Vec<Pair<'_>> {
    let promised = |case: &'static Case| {
        let promise = promises.iter().find(|p| p.number == case.number)?;
        promise.millis.map(|_| (promise, case))
    };
    let causes: Vec<_> = CASES
        .iter()
        .filter(|case| !case.alone && case.drives.concern(stage))
        .filter(|case| (case.boards)(board))
        .filter(|case| !matches!(case.procedure, Procedure::Stored(_)))
        .filter_map(promised)
        .collect();
    let mut pairs = Vec::new();
    for first in &causes {
        for second in causes
            .iter()
            .filter(|second| fit_together(first.1, second.1))
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
fn fit_together(first: &Case, second: &Case) -> bool {
    /// The front left encoder; the setpoints that the master sends; the supply.
    const SAME: [&[u8]; 3] = [&[11, 12], &[3, 7, 8, 27], &[16, 26]];
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
    pub fn measure(&self, driving: &Driving<'_>, slow: Slow) -> anyhow::Result<Outcome> {
        let group = driving.group;
        let mut master = driving.start(SPEED, &[self.first.1, self.second.1])?;
        let mut wheel = Wheel::default();
        let at_first = wheel.rate(&master);
        self.first.1.procedure.appear(&mut master)?;
        let first_ns = master.world.now_ns();
        wheel.run_to(&mut master, first_ns + self.delay_ms * 1_000_000)?;
        let at_second = wheel.rate(&master);
        self.second.1.procedure.appear(&mut master)?;
        let second_ns = master.world.now_ns();
        let reversed = [(self.first.1, at_first), (self.second.1, at_second)]
            .into_iter()
            .find_map(|(case, rate)| (case.number == REVERSED).then_some(rate));
        let is_slow = reversed.filter(|rate| *rate < slow.below);
        if self.second.1.number == REVERSED {
            wheel.fastest = at_second;
        }
        let slow_ms = is_slow.map(|rate| {
            if rate > STANDS {
                return slow.millis;
            }
            // It shows nothing, so what holds is the end of the ramp of the first cause.
            let due = self.first.0.millis.unwrap_or(0.0) - self.delay_ms as f64;
            due + ramp_ms(group) + HOLD_MS
        });
        let promises = self.promises(group, (first_ns, second_ns), slow_ms);
        let ends = promises
            .iter()
            .map(|(from_ns, ms)| *from_ns as f64 + ms * 1e6);
        let last = ends.fold(0.0, f64::max) + MARGIN_MS * 1e6;
        wheel.run_to(&mut master, last as u64)?;
        let faster = is_slow.is_some_and(|rate| wheel.fastest > slow.factor * rate + RESOLUTION);
        let safe_ns = master.world.safe_since_ns(WATCHED);
        let outcome = |(from_ns, promise_ms): (u64, f64)| Outcome {
            promise_ms,
            measured_ms: safe_ns.map(|at| at.saturating_sub(from_ns) as f64 / 1e6),
            faster,
        };
        let spare = |o: &Outcome| {
            o.measured_ms
                .map_or(f64::NEG_INFINITY, |ms| o.promise_ms - ms)
        };
        let outcomes = promises.into_iter().map(outcome);
        let worst = outcomes.min_by(|a, b| spare(a).total_cmp(&spare(b)));
        worst.ok_or_else(|| anyhow::anyhow!("nothing is promised"))
    }

    /// What has to hold: from when, ns, and within what, ms. `slow_ms` is for a reversed encoder of
    /// a slow wheel.
    fn promises(
        &self,
        group: &GroupFile,
        (first_ns, second_ns): (u64, u64),
        slow_ms: Option<f64>,
    ) -> Vec<(u64, f64)> {
        let both = [(self.first, first_ns), (self.second, second_ns)];
        let millis = |promise: &Promise| {
            let slow_ms = slow_ms.filter(|_| promise.number == REVERSED);
            slow_ms.or(promise.millis).unwrap_or(0.0)
        };
        if self.cuts() {
            // What the program had seen of a wheel is void after a standstill, so its time begins
            // again.
            let stands = both.iter().find_map(|((promise, case), at)| {
                let at_ns = *at as f64;
                match case.number {
                    17 => Some((at_ns - STANDSTILL_MS * 1e6, at_ns)),
                    20 => Some((at_ns, at_ns + millis(promise) * 1e6)),
                    _ => None,
                }
            });
            let within = |promise: &Promise, at: u64| {
                let (at_ns, ms) = (at as f64, millis(promise));
                let meets = |(begin, end): &(f64, f64)| *begin < at_ns + ms * 1e6 && at_ns < *end;
                ms + stands
                    .filter(meets)
                    .map_or(0.0, |(_, end)| (end - at_ns) / 1e6)
            };
            let cutting = both.into_iter().filter(|((promise, _), _)| cuts(promise));
            return cutting
                .map(|((promise, _), at)| (at, within(promise, at)))
                .collect();
        }
        let later_ms = second_ns.saturating_sub(first_ns) as f64 / 1e6;
        let due = millis(self.first.0).min(later_ms + millis(self.second.0));
        vec![(first_ns, due + ramp_ms(group) + HOLD_MS)]
    }
}

/// How long the ramp from the speed of the trials lasts, ms.
fn ramp_ms(group: &GroupFile) -> f64 {
    let (v, d, j) = (
        f64::from(SPEED),
        f64::from(group.limits.linear_acceleration),
        f64::from(group.limits.linear_jerk),
    );
    (v / d + d / j) * 1e3
}

fn cuts(promise: &Promise) -> bool {
    promise.fault.reaction() == Reaction::Cut
}

/// The wheel that fails, of the watched robot.
#[derive(Default)]
struct Wheel {
    /// Its largest true rate since the last check, rad/s.
    fastest: f64,
}

impl Wheel {
    /// Its true rate now, rad/s, either way.
    fn rate(&mut self, master: &TestMaster) -> f64 {
        let truth = master.world.truth();
        let robot = truth.robots.get(WATCHED);
        let rate = robot.map_or(0.0, |robot| robot.wheel_rates.front_left.abs());
        self.fastest = self.fastest.max(rate);
        rate
    }

    /// Goes on to a time, ns, by the steps of the master.
    fn run_to(&mut self, master: &mut TestMaster, end_ns: u64) -> anyhow::Result<()> {
        while master.world.now_ns() < end_ns {
            master.step()?;
            self.rate(master);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use acceptance::causes as promise;
    use protocol::address as at;

    /// A reversed encoder doubles what a wheel stays behind its reference. Half of the threshold is
    /// enough for that, if the reference still has it at the end of the 60 ms, with the
    /// deceleration of the group.
    #[test]
    fn the_page_says_from_which_rate_on_a_reversed_encoder_is_seen() {
        let page = include_str!("../../../docs/safety.md");
        let slow = promise::slow(page).unwrap();
        let group = group::GroupFile::load(crate::cargo::root().join(super::super::GROUP)).unwrap();
        let mut objects = protocol::OBJECTS.iter();
        let object = objects.find(|o| o.address == at::BLOCKED_RATE);
        let protocol::Value::F32(blocked) = object.unwrap().default else {
            panic!("a rate is a real number");
        };
        let reversed = promise::read(page).unwrap();
        let reversed = reversed.iter().find(|p| p.number == super::REVERSED);
        let seconds = reversed.unwrap().millis.unwrap() / 1e3;
        let limits = &group.limits;
        let radius = f64::from(group.robots[0].geometry.wheel_radius());
        let fall = f64::from(limits.linear_acceleration) / radius;
        let least = 0.5 * f64::from(blocked) + fall * seconds;
        assert!((slow.below - least).abs() < 0.01, "{least} rad/s");
    }
}
