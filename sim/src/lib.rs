//! A virtual CAN bus, plants, and robots native or emulated: the desk in place of the workshop.
//!
//! A [`World`] holds the robots of a group file and lets virtual time pass. Whoever drives it sits
//! at the bus: [`World::send`] and [`World::receive`], nothing else reaches the robots. Every
//! number of their motion comes about the way it does in life: frames, controller, PWM, motor,
//! wheel, floor, encoder.
//!
//! ```text
//!  master --frames--> bus::Bus <--frames--> robot::Robot --duty--> motor::Motor --.
//!                                                ^                            angle |
//!                                                '-- encoder counts --- plant::Plant <'
//!                                                                  truth: poses <--'
//! ```
//!
//! - [`robot`]: native robots and emulated ones behind one trait.
//! - [`bus`]: arbitration, exact bit times, load, candump logs.
//! - [`motor`], [`battery`], [`encoder`]: from duty to angle and back to counts.
//! - [`plant`]: the paper's tables, rolling contacts with friction, or another program.
//! - [`configure`]: the group file written into the robots.
//! - [`test_master`]: a master that can be told to do wrong, for trying what robots do about it.
//! - [`study`]: many groups without a bus.
//! - [`scale`]: how fast all this is on the machine at hand.
//! - [`paper`]: the source paper's experiments, beside its own numbers.
//! - [`fault`]: what goes wrong at a time, as text and as a schedule.
//! - [`endpoint`]: the bus for programs outside.
#![forbid(unsafe_code)]

pub mod battery;
pub mod bus;
pub mod configure;
mod digest;
pub mod encoder;
pub mod endpoint;
mod error;
pub mod fault;
mod gyro;
pub mod motor;
pub mod paper;
pub mod plant;
mod random;
pub mod robot;
pub mod scale;
pub mod study;
pub mod test_master;
mod truth;
mod worker_pool;
mod world;

pub use bus::BusLoad;
pub use error::SimError;
pub use gyro::GyroSample;
pub use robot::{Backend, Crash};
pub use truth::{RobotTruth, TruthSample};
pub use world::{EncoderState, MASTER, Options, Port, World, index};
