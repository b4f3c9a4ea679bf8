//! A simulated world as a bus. Its clock is virtual: it moves only while the master waits.
//!
//! For people who watch or steer, [`SimLink::in_real_time`] keeps it from running ahead of the
//! clock on the wall: after each step of the master it sleeps off the difference. What happens in
//! the world is the same to the byte, it only takes longer.

use std::time::{Duration, Instant};

use canopen::{Frame, Micros};
use sim::World;

use crate::bus::link::{Link, LinkError};

/// Further behind the clock on the wall than this, the world gives up catching up.
const LAG: Duration = Duration::from_millis(200);

/// A world and the name the user gave it.
pub struct SimLink {
    /// The world, for an observer.
    pub world: World,
    name: String,
    /// Clock on the wall when virtual time was zero.
    wall: Option<Instant>,
}

impl SimLink {
    /// Takes over a world. `name` is how errors call it.
    #[must_use]
    pub fn new(world: World, name: impl Into<String>) -> Self {
        Self {
            world,
            name: name.into(),
            wall: None,
        }
    }

    /// Lets virtual time pass no faster than the clock on the wall from here on.
    #[must_use]
    pub fn in_real_time(mut self) -> Self {
        let passed = Duration::from_micros(self.world.now().0);
        self.wall = Instant::now().checked_sub(passed);
        self
    }

    /// Sleeps until the clock on the wall has caught up. A world that has fallen far behind is not
    /// hurried.
    fn keep_pace(&mut self) {
        let Some(wall) = &mut self.wall else {
            return;
        };
        let virtual_time = Duration::from_micros(self.world.now().0);
        let passed = wall.elapsed();
        if virtual_time > passed {
            std::thread::sleep(virtual_time - passed);
        } else if passed - virtual_time > LAG {
            *wall += passed - virtual_time;
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
        let received = self.world.receive(until).map_err(|error| LinkError {
            bus: self.name.clone(),
            problem: error.to_string(),
            remedy: "the simulated world has stopped; this is a defect of the simulator, please report it"
                .into(),
        })?;
        self.keep_pace();
        Ok(received)
    }
}
