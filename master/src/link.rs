//! The way to the bus: one trait, so that the master does not care what the frames travel over.
//!
//! A link has a clock of its own. On a simulated bus that clock is virtual and only moves while
//! someone waits in [`Link::receive`]; on a real adapter it is the monotonic clock of this machine.
//! The master never asks any other clock, so a run over a simulated bus is repeatable to the bit.
//!
//! A link keeps the order of frames in both directions. It may lose frames only by saying so.

use canopen::{Frame, Micros};

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
}

impl<L: Link + ?Sized> Link for &mut L {
    fn now(&self) -> Micros {
        (**self).now()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), LinkError> {
        (**self).send(frame)
    }

    fn receive(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, LinkError> {
        (**self).receive(until)
    }
}

impl<L: Link + ?Sized> Link for Box<L> {
    fn now(&self) -> Micros {
        (**self).now()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), LinkError> {
        (**self).send(frame)
    }

    fn receive(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, LinkError> {
        (**self).receive(until)
    }
}
