//! A simulated world as a bus. Its clock is virtual: it moves only while the master waits.

use canopen::{Frame, Micros};
use sim::World;

use crate::link::{Link, LinkError};

/// A world and the name the user gave it.
pub struct SimLink {
    /// The world, for an observer.
    pub world: World,
    name: String,
}

impl SimLink {
    /// Takes over a world. `name` is how errors call it.
    #[must_use]
    pub fn new(world: World, name: impl Into<String>) -> Self {
        Self {
            world,
            name: name.into(),
        }
    }
}

impl Link for SimLink {
    fn now(&self) -> Micros {
        self.world.now()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), LinkError> {
        self.world.send(*frame);
        Ok(())
    }

    fn receive(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, LinkError> {
        self.world.receive(until).map_err(|error| LinkError {
            bus: self.name.clone(),
            problem: error.to_string(),
            remedy: "the simulated world has stopped; this is not what robots do, please report it"
                .into(),
        })
    }
}
