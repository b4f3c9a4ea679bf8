//! The way to the bus: one trait, so that the master is the same on every kind of bus.
//!
//! A link has a clock of its own. On a simulated bus that clock is virtual and only moves while
//! someone waits in [`Link::receive`]; on a real adapter it is the monotonic clock of this machine.
//! The master never asks any other clock, so a run over a simulated bus is repeatable to the bit.
//!
//! A link keeps the order of frames in both directions. It may lose frames only by saying so.

use std::ops::DerefMut;

use std::time::Duration;

use canopen::{Frame, Micros};

use crate::bus::punctuality::Punctuality;

/// Why a frame did not go out or none can come in.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{bus}: {problem}; {remedy}")]
pub struct LinkError {
    /// The bus as the user named it.
    pub bus: String,
    /// What happened.
    pub problem: String,
    /// What to check or do.
    pub remedy: String,
}

/// When SYNC is sent, by a link that does so by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schedule {
    /// Time of the first one, on the link's clock.
    pub first: Micros,
    /// Time from one to the next, in µs.
    pub period_us: u64,
    /// Counter of the first one.
    pub counter: u8,
    /// The counter runs from 1 to this.
    pub overflow: u8,
}

/// A connection to a CAN bus.
pub trait Link {
    /// Time on the link's clock.
    fn now(&self) -> Micros;

    /// Queues a frame behind those already sent.
    ///
    /// # Errors
    /// When the bus does not take it.
    fn send(&mut self, frame: &Frame) -> Result<(), LinkError>;

    /// The next frame that arrives before `until`, with the time it was complete on the bus;
    /// `None` once `until` has come.
    ///
    /// # Errors
    /// When the bus is gone.
    fn receive(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, LinkError>;

    /// Whether the bus's time waits for this end, however late it is.
    fn time_waits(&self) -> bool {
        false
    }

    /// What the adapter says is wrong with the bus, if it can tell, with what to check.
    fn diagnosis(&mut self) -> Option<String> {
        None
    }

    /// How long the adapter takes to answer, there and back, if it can be asked: the median of
    /// several tries.
    fn latency(&mut self) -> Option<Duration> {
        None
    }

    /// Asks the link to send SYNC by itself from now on, or with `None` to leave off. `false` when
    /// it cannot: then the caller of the session sends SYNC when the link's clock says so, which on
    /// a bus with virtual time is exact.
    fn pace(&mut self, _schedule: Option<Schedule>) -> bool {
        false
    }

    /// The next of those SYNCs that has gone out, and when; all that went out before a frame that
    /// [`Link::receive`] has given are there when it returns.
    fn take_sent(&mut self) -> Option<(Micros, Frame)> {
        None
    }

    /// How punctual those SYNCs were; `None` where the link sends none.
    fn punctuality(&self) -> Option<Punctuality> {
        None
    }
}

/// Whatever points to a link: `&mut L`, `Box<L>`.
impl<P: DerefMut<Target: Link>> Link for P {
    fn now(&self) -> Micros {
        (**self).now()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), LinkError> {
        (**self).send(frame)
    }

    fn receive(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, LinkError> {
        (**self).receive(until)
    }

    fn time_waits(&self) -> bool {
        (**self).time_waits()
    }

    fn diagnosis(&mut self) -> Option<String> {
        (**self).diagnosis()
    }

    fn latency(&mut self) -> Option<Duration> {
        (**self).latency()
    }

    fn pace(&mut self, schedule: Option<Schedule>) -> bool {
        (**self).pace(schedule)
    }

    fn take_sent(&mut self) -> Option<(Micros, Frame)> {
        (**self).take_sent()
    }

    fn punctuality(&self) -> Option<Punctuality> {
        (**self).punctuality()
    }
}
