//! What a trial has shown, beside what docs/safety.md promises.

use acceptance::Bound;
use acceptance::causes::{self, Promise};
use acceptance::promise::{self, ACCEPTANCE, SAFETY};
use protocol::{Fault, Reaction};

use super::super::hand::Hand;
use super::super::records::{self, Entry};
use super::super::{AcceptError, Trial, not_tried};
use super::{Means, Seen, name, source};
use crate::bus::link::Link;

impl<L: Link, H: Hand<L>> Trial<'_, L, H> {
    /// Reads the histories, and compares with the page.
    pub(super) fn judge(
        &mut self,
        promise: &Promise,
        means: Means,
        seen: &Seen,
    ) -> Result<(), AcceptError> {
        let nodes: Vec<u8> = self.group.members().iter().map(|m| m.node).collect();
        let mut histories = Vec::new();
        for node in nodes {
            histories.push(records::since(self.group.wire(), node, seen.began)?);
        }
        let place = self.place();
        // The fault of the page is that of the others where a robot has left the bus.
        let in_one = matches!(
            means,
            Means::Encoder
                | Means::Driver
                | Means::Stop
                | Means::Protective
                | Means::Supply
                | Means::TooHigh
                | Means::Reversed
                | Means::Double
        );
        let concerned: Vec<usize> = (0..histories.len())
            .filter(|member| match means {
                Means::Bus => *member != place,
                _ => !in_one || *member == place,
            })
            .collect();
        self.judge_reaction(promise, seen, &histories, &concerned);
        self.judge_time(promise, means, seen, &histories, &concerned)?;
        if let (Some(most), Some(faster)) = (promise.wheel_rate, seen.faster)
            && means != Means::Reversed
        {
            let name = format!("fault.{:02}.wheel_rate", promise.number);
            let bound = Bound::AtMost(most);
            let procedure = "largest reported wheel rate after the cause, over that before it";
            self.measured(
                name,
                bound,
                "times",
                source(promise),
                procedure,
                faster.into(),
            );
        }
        if means == Means::Reversed {
            let most = promise::number(SAFETY, "never more than", "rad/s")?;
            let measured = f64::from(seen.asked.max(seen.faster.unwrap_or(0.0) * seen.asked));
            self.measured(
                format!("fault.{:02}.wheel_rate", promise.number),
                Bound::AtMost(most.value),
                "rad/s",
                most.source,
                "largest reported wheel rate with the encoder reversed from the first motion on",
                measured,
            );
        }
        let again = seen.again.map(|count| count as f64);
        let check = self.measured(
            format!("fault.{:02}.rest", promise.number),
            Bound::Near(0.0, 0.0),
            "reports",
            format!(
                "docs/safety.md: cause {}, nothing moves after a stop",
                promise.number
            ),
            "reports of turning wheels in the 0.5 s after all stood, while setpoints go on",
            again.unwrap_or(f64::NAN),
        );
        if again.is_none() {
            check.measured = None;
            check.note = "the wheels did not come to rest within 5 s of a fault".to_owned();
        }
        if means == Means::Stop && histories.len() > 1 && !self.is_skipped(&name(5)) {
            self.judge_others(seen, &histories, place)?;
        }
        Ok(())
    }

    /// Whether the right fault was announced, and the right reaction seen.
    fn judge_reaction(
        &mut self,
        promise: &Promise,
        seen: &Seen,
        histories: &[Vec<Entry>],
        concerned: &[usize],
    ) {
        let all = concerned.iter().map(|member| &histories[*member]);
        let announced = all.clone().any(|history| {
            let first = history.first();
            first.is_some_and(|entry| entry.fault == promise.fault)
        });
        let everywhere = all.clone().all(|history| !history.is_empty());
        let kind = concerned.iter().all(|member| {
            let ramped = seen.ramped[*member];
            match promise.fault.reaction() {
                // Without SYNC no report comes while it ramps.
                Reaction::Ramp => ramped || promise.fault == Fault::SyncLost,
                Reaction::Cut => !ramped,
            }
        });
        let right = announced && everywhere && kind;
        let mut note = String::new();
        if !right {
            let names = all.map(|history| {
                let names: Vec<_> = history.iter().map(|e| e.fault.name()).collect();
                names.join(" ")
            });
            let names: Vec<_> = names.collect();
            note = format!(
                "announced: [{}], wanted {} by {}",
                names.join("; "),
                promise.fault.name(),
                promise.reaction
            );
        }
        let check = self.measured(
            format!("fault.{:02}.reaction", promise.number),
            Bound::Near(1.0, 0.0),
            "as promised",
            source(promise),
            "code in the robots' histories, and whether they ramped or cut",
            f64::from(u8::from(right)),
        );
        check.note = note;
    }

    /// From the cause to the last robot's first fault.
    fn judge_time(
        &mut self,
        promise: &Promise,
        means: Means,
        seen: &Seen,
        histories: &[Vec<Entry>],
        concerned: &[usize],
    ) -> Result<(), AcceptError> {
        let millis = match means {
            Means::Reversed => {
                let slow = promise::number(SAFETY, "| from 0.1 rad/s on |", "ms |")?;
                Some(slow.value)
            }
            _ => promise.millis,
        };
        let Some(millis) = millis else {
            return Ok(());
        };
        let resolution = promise::number(ACCEPTANCE, "when a fault appeared within", "ms")?;
        let name = format!("fault.{:02}.time", promise.number);
        let Some(cause) = seen.cause else {
            let reason = "no frame shows when the cause appeared; level 1 measures the inputs";
            let bound = Bound::AtMost(millis);
            let check = not_tried(name, bound, "ms", source(promise), reason.to_owned());
            self.checks.push(check);
            return Ok(());
        };
        let latency = self.group.wire().latency();
        let latency_ms = latency.map_or(0.0, |latency| latency.as_secs_f64() * 1e3);
        // To a tenth, upwards.
        let open_ms = resolution.value + latency_ms + cause.open_us * 1e-3;
        let open_ms = (open_ms * 10.0).ceil() / 10.0;
        let bound = millis + open_ms;
        let first = |member: &usize| histories[*member].first().map(|entry| entry.at_us);
        let slowest = concerned.iter().map(first).reduce(|a, b| match (a, b) {
            (Some(a), Some(b)) => Some(a.max(b)),
            _ => None,
        });
        let measured = slowest.flatten().map(|at_us| (at_us - cause.at_us) * 1e-3);
        let check = self.measured(
            name,
            Bound::AtMost(bound),
            "ms",
            format!("{}; {}", source(promise), resolution.source),
            "from the cause to the fault in the history of the slowest robot concerned",
            measured.unwrap_or(f64::NAN),
        );
        check.note = format!("{millis} ms are promised, {open_ms:.1} ms is what is resolved");
        if measured.is_none() {
            check.measured = None;
            check.note = "a robot has no fault in its history".to_owned();
        }
        Ok(())
    }

    /// Cause 5: how long the others need after the first.
    fn judge_others(
        &mut self,
        seen: &Seen,
        histories: &[Vec<Entry>],
        place: usize,
    ) -> Result<(), AcceptError> {
        let promise = causes::of(5)?;
        let all: Vec<usize> = (0..histories.len()).filter(|n| *n != place).collect();
        self.judge_reaction(&promise, seen, histories, &all);
        let resolution = promise::number(ACCEPTANCE, "when a fault appeared within", "ms")?;
        let from = histories[place].first().map(|entry| entry.at_us);
        let others = histories.iter().enumerate().filter(|(n, _)| *n != place);
        let slowest = others
            .map(|(_, history)| history.first().map(|entry| entry.at_us))
            .reduce(|a, b| Some(a?.max(b?)))
            .flatten();
        let millis = promise.millis.unwrap_or(0.0);
        let measured = from.zip(slowest).map(|(from, to)| (to - from) * 1e-3);
        let check = self.measured(
            "fault.05.time".to_owned(),
            Bound::AtMost(millis + resolution.value),
            "ms",
            source(&promise),
            "from the fault of the robot whose stop was pressed to that of the slowest other",
            measured.unwrap_or(f64::NAN),
        );
        if measured.is_none() {
            check.measured = None;
            check.note = "a robot has no fault in its history".to_owned();
        }
        Ok(())
    }
}
