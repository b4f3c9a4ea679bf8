//! What the tests of errors on the bus share.

use canopen::Micros;
use omnibus_sim::bus::disturb::Share;
use omnibus_sim::bus::errors::ErrorCounters;
use omnibus_sim::{MASTER, World};

pub fn run(world: &mut World, until_us: u64) {
    world.run_until(Micros(until_us)).unwrap();
}

/// Times in us and identifiers of the frames that the master has received since the last call.
pub fn received(world: &mut World) -> Vec<(u64, u16)> {
    let frames = std::iter::from_fn(|| world.take_received(MASTER));
    frames.map(|(at, frame)| (at.0, frame.id())).collect()
}

/// Every frame with this identifier.
pub fn all(id: u16) -> Share {
    Share {
        of: 1.0,
        id: Some(id),
    }
}

pub fn counters(transmit: u32, receive: u32) -> ErrorCounters {
    ErrorCounters { transmit, receive }
}
