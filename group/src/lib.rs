//! The group file: which robots move as one body, and where each stands in it.
//!
//! One TOML file describes a group completely. Two programs read it: the master, which writes its
//! values into the robots over the bus before it moves anything, and the simulator, which builds
//! the same robots out of nothing. They read it through this crate so that they cannot disagree,
//! and neither has to depend on the other for it.
//!
//! Reading is all or nothing. [`GroupFile::load`] returns a group in which every number is finite
//! and in its range, every node identifier is used once, and nothing was ignored: an unknown key is
//! an error, because a misspelt key is a value that silently kept its default. Every [`GroupError`]
//! says which file, line and field, what is wrong with it, and what to write instead.
//!
//! # Modules
//!
//! - `schema`: the file as TOML has it, every value with its place in the text.
//! - `model` and `simulation`: the group as the programs use it, SI units, checked.
//! - `check`, `member` and `check_simulation`: the way from one to the other, and all rules.
//! - `parameters`: what a robot must be told, as objects and values.
//! - `error`: what is said when a rule is broken.
//! - [`input`]: reading files that may have no end.
//!
//! The file does not say how anything behaves: it holds data of robots, and the `[simulation]`
//! table holds what only a simulated world needs to be told (which losses, which crystal errors).
#![forbid(unsafe_code)]

mod check;
mod check_simulation;
mod declaration;
mod error;
pub mod input;
mod member;
mod model;
mod number;
mod parameters;
mod possible;
pub mod reference;
mod schema;
mod simulation;
mod structure;
mod whole;

pub use check::Examination;
pub use error::GroupError;
pub use model::{
    Board, CompensationTable, ContactLag, Control, Encoder, FIRST_NODE, Feedforward, GroupFile,
    LAST_NODE, Limits, Motor, OutputStage, Reversed, Robot, Rollers, StageKind, Wheel,
};
pub use parameters::{
    Parameter, ROOM, agreement_delay_us, compensation_set, member_mask, parameters, preview_us,
};
pub use robot::configuration::RAMP_GRACE;
pub use simulation::{
    Battery, Contact, Driver, EncoderFault, EncoderFaultKind, EncoderNoise, Gyro, Patch, Payload,
    Plant, PoseNoise, Simulation, Tables, WheelName,
};
