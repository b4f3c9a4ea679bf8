//! VDA 5050 as the vehicle sees it: messages, orders and trajectories, without a transport.
//!
//! ```text
//!  order, instantActions --> Vehicle --> messages (state, connection, factsheet, visualization)
//!        what is seen    -->         --> requests: drive these legs, pause, resume, stop
//! ```
//!
//! [`Vehicle`] is the state machine of chapter 6 of VDA 5050 2.0: it accepts an order or refuses it
//! with the error that the standard names, keeps the node and edge states, and answers every
//! instant action. It gets the time, the messages that arrived and the motion of the vehicle, and
//! it returns [`Request`]s and [`Outgoing`] messages. It opens no connection and starts no thread,
//! so every rule is tested without a broker and without a robot.
//!
//! [`leg`] turns an edge into poses on the map, a trajectory by [`nurbs`] included. [`message`] has
//! the JSON of versions 2.0, 2.1 and 3.0; [`Version`] says what differs between them.
//!
//! # Limits
//!
//! Not here: MQTT, and what moves the vehicle. Both are in `master/src/vda5050`.
//!
//! Source: VDA 5050 2.0.0 (January 2022), 2.1.0 and 3.0.0; chapter numbers are those of 2.0.0
//! unless a later version is named.
#![forbid(unsafe_code)]

pub mod configuration;
pub mod error;
pub mod leg;
pub mod message;
pub mod nurbs;
mod order;
mod relocation;
pub mod time;
mod validate;
pub mod vehicle;
mod version;

pub use configuration::Configuration;
pub use error::{ErrorKind, Refusal};
pub use vehicle::{Outgoing, Request, Seen, Topic, Vehicle};
pub use version::Version;
