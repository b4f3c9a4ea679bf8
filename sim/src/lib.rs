//! A virtual CAN bus, plants, and robots native or emulated.
#![forbid(unsafe_code)]

pub mod bus;
mod crew;
mod digest;
mod error;
pub mod motor;
pub mod plant;
mod random;
pub mod robot;
mod truth;
mod world;

pub use bus::BusLoad;
pub use error::SimError;
pub use robot::Backend;
pub use truth::{RobotTruth, TruthSample};
pub use world::{MASTER, Options, Port, World};
