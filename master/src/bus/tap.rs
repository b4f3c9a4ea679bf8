//! A tap on a bus: every frame that goes through is copied to a recorder or another listener.

use std::sync::Arc;

use canopen::{Frame, Micros};

use crate::bus::link::{Link, LinkError};

/// Takes a copy of every frame: its time on the link's clock, the frame, and whether it was sent
/// here.
pub type FrameSink = Arc<dyn Fn(Micros, &Frame, bool) + Send + Sync>;

/// A link that is listened to.
pub struct Tap<L> {
    /// The link itself.
    pub inner: L,
    sinks: Vec<FrameSink>,
}

impl<L> Tap<L> {
    /// Puts a tap on a link.
    #[must_use]
    pub fn new(inner: L, sinks: impl IntoIterator<Item = FrameSink>) -> Self {
        Self {
            inner,
            sinks: sinks.into_iter().collect(),
        }
    }
}

impl<L: Link> Link for Tap<L> {
    fn now(&self) -> Micros {
        self.inner.now()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), LinkError> {
        self.inner.send(frame)?;
        let now = self.inner.now();
        for sink in &self.sinks {
            sink(now, frame, true);
        }
        Ok(())
    }

    fn receive(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, LinkError> {
        let received = self.inner.receive(until)?;
        if let Some((at, frame)) = &received {
            for sink in &self.sinks {
                sink(*at, frame, false);
            }
        }
        Ok(received)
    }

    fn diagnosis(&mut self) -> Option<String> {
        self.inner.diagnosis()
    }
}
