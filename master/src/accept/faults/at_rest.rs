//! Causes that keep the group from its first motion, brought about by a parameter that is wrong on
//! purpose while it stands, and right again afterwards.

use acceptance::Bound;
use acceptance::causes::Promise;
use protocol::{Address, Kind, Value, address};

use super::super::hand::Hand;
use super::super::records;
use super::super::{AcceptError, Trial};
use super::{Means, ends_all, source};
use crate::bus::link::Link;
use crate::session::STOP_PATIENCE_US;

/// A share of what is measured.
const LESS: f32 = 0.9;

impl<L: Link, H: Hand<L>> Trial<'_, L, H> {
    /// Tries such a cause.
    pub(super) fn at_rest(&mut self, promise: &Promise, means: Means) -> Result<(), AcceptError> {
        let node = self.watched;
        let (at, kind) = match means {
            Means::Plan => (address::JERK, Kind::F32),
            _ => (address::MEMBERS, Kind::U32),
        };
        let right = self.group.wire().read(node, at, kind)?;
        let wrong = match means {
            Means::Plan => Value::F32(f32::from_bits(right.to_bits()) * LESS),
            // A group of others.
            _ => Value::U32(right.to_bits() & !(1 << node) | 1 << other_than(node)),
        };
        let began = self.group.wire().now().0;
        self.group.wire().write(node, at, wrong)?;
        let started = self.group.start();
        self.group.ramp_down(STOP_PATIENCE_US)?;
        self.group.wire().write(node, at, right)?;
        let is_running = started.is_ok();
        match started {
            Err(error) if ends_all(&error) => Err(error.into()),
            _ => self.judge_start(promise, (at, began), is_running),
        }
    }

    /// What the robots' histories say since `began`, when the parameter was written.
    fn judge_start(
        &mut self,
        promise: &Promise,
        (at, began): (Address, u64),
        started: bool,
    ) -> Result<(), AcceptError> {
        let nodes: Vec<u8> = self.group.members().iter().map(|m| m.node).collect();
        let mut announced = 0;
        for node in nodes {
            let history = records::since(self.group.wire(), node, began)?;
            let found = history.iter().any(|entry| entry.fault == promise.fault);
            announced += u32::from(found);
        }
        let check = self.measured(
            format!("fault.{:02}.reaction", promise.number),
            Bound::AtLeast(1.0),
            "robots",
            source(promise),
            "robots that announce it, and do not start, while one has a wrong parameter",
            announced.into(),
        );
        check.note = format!("0x{:04X}:{} was wrong", at.index, at.sub);
        if started {
            check.measured = Some(0.0);
            check.note += "; the group could be started";
        }
        Ok(())
    }
}

/// Another robot's number.
const fn other_than(node: u8) -> u8 {
    if node == protocol::FIRST_ROBOT {
        protocol::LAST_ROBOT
    } else {
        protocol::FIRST_ROBOT
    }
}
