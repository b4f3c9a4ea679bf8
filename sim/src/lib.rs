//! A virtual CAN bus, plants, and robots native or emulated.
//!
//! # Theory of operation
//!
//! A [`World`] holds the robots of a group file and advances virtual time. Commands reach the
//! robots over the bus alone ([`World::send`], [`World::receive`]), and every quantity of their
//! motion takes the path that it takes in a real robot: frames, controller, PWM, motor, wheel,
//! floor, encoder.
//!
//! ```text
//!  master --frames--> bus::Bus <--frames--> robot::Robot --duty--> motor::Motors -.
//!                                                ^                            angle |
//!                                                '-- encoder counts --- plant::Plant <'
//!                                                                  truth: poses <--'
//! ```
//!
//! # Modules
//!
//! - [`robot`]: native robots and emulated ones behind one trait.
//! - [`bus`]: arbitration, exact bit times, load, candump logs.
//! - [`motor`], [`battery`], [`encoder`]: from duty to angle and back to counts.
//! - [`smart_drive`]: drives on a CAN bus of their own.
//! - [`plant`]: the paper's tables, rolling contacts with friction, or another program.
//! - [`configure`]: the group file written into the robots.
//! - [`test_master`]: a master that can also misbehave, for tests of the robots' reactions.
//! - [`study`]: many groups without a bus.
//! - [`scale`]: the speed of the simulation on this machine.
//! - [`paper`]: the source paper's experiments, compared with its own numbers.
//! - [`fault`]: faults to inject at given times, as text and as a schedule.
//! - [`endpoint`]: the bus for other programs.
pub mod battery;
pub mod bridge;
pub mod bus;
pub mod configure;
mod digest;
pub mod encoder;
#[cfg(feature = "host")]
pub mod endpoint;
mod error;
pub mod fault;
mod four;
mod gyro;
pub mod motor;
#[cfg(feature = "host")]
pub mod paper;
pub mod plant;
mod random;
pub mod robot;
#[cfg(feature = "host")]
pub mod scale;
pub mod smart_drive;
pub mod study;
pub mod test_master;
mod truth;
mod world;

pub use bus::BusLoad;
pub use error::SimError;
pub use gyro::GyroSample;
pub use robot::{Backend, Crash};
pub use truth::{RobotTruth, TruthSample};
pub use world::{Cable, EncoderState, MASTER, Options, Port, World, index};
