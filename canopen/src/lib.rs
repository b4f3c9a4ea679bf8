//! A CANopen device (CiA 301 version 4.2) without I/O.
//!
//! The crate uses neither a CAN controller nor a clock; the caller owns both. The caller passes
//! every received frame to [`Device::on_frame`] in the order of reception, together with its time
//! of reception, calls [`Device::poll`] when [`Device::next_deadline`] has passed, and takes frames
//! to send from [`Device::pop_frame`] and events from [`Device::pop_event`]. All state is in the
//! `Device`, so a process may run any number of nodes.
//!
//! The device holds the communication objects (0x1000 to 0x1FFF); the application holds all others
//! and provides them through the [`Application`] trait.
//!
//! The transmit queue and the event queue can overflow. Both then drop the newest entry and count
//! it ([`Device::counters`]). Limits: the crate does not support remote frames, 29-bit identifiers,
//! or node guarding, which CiA 301 itself advises against.
//!
//! The `eds` module writes these objects as sections of an electronic data sheet (CiA 306).
//!
//! The [`client`] module is the counterpart: the services that a master needs to talk to such
//! devices.
//!
//! A device with one object, and a master's client that writes it. Here both are in one process,
//! and every frame of one is passed to the other:
//!
//! ```
//! use canopen::client::{Outcome, SdoClient};
//! use canopen::{AbortCode, Config, Device, Micros, NmtState, NodeId, Application};
//!
//! /// 0x2000: the brightness of a lamp, 0 to 255.
//! struct Lamp(u8);
//!
//! impl Application for Lamp {
//!     fn read(&self, index: u16, sub: u8, out: &mut [u8]) -> Result<usize, AbortCode> {
//!         match (index, sub) {
//!             (0x2000, 0) => out[0] = self.0,
//!             _ => return Err(AbortCode::NoObject),
//!         }
//!         Ok(1)
//!     }
//!     fn write(&mut self, index: u16, sub: u8, data: &[u8], _: NmtState)
//!         -> Result<(), AbortCode>
//!     {
//!         match (index, sub, data) {
//!             (0x2000, 0, &[brightness]) => self.0 = brightness,
//!             (0x2000, 0, _) => return Err(AbortCode::TooLong),
//!             _ => return Err(AbortCode::NoObject),
//!         }
//!         Ok(())
//!     }
//! }
//!
//! let node = NodeId::new(5).ok_or("1 to 127")?;
//! let (mut lamp, now) = (Lamp(0), Micros::ZERO);
//! let mut device = Device::new(Config { node: Some(node), ..Config::DEFAULT });
//! device.poll(now, &mut lamp); // boots: it may answer from here on
//!
//! let mut client = SdoClient::new(node, Micros::from_millis(100));
//! client.download(now, 0x2000, 0, &[200]).map_err(|_| "busy")?;
//! let outcome = loop {
//!     while let Some(request) = client.pop_frame() {
//!         device.on_frame(now, &request, &mut lamp);
//!     }
//!     let frame = device.pop_frame().ok_or("no answer")?; // the first is the boot-up message
//!     if let Some(outcome) = client.on_frame(now, &frame) {
//!         break outcome;
//!     }
//! };
//! assert_eq!((outcome, lamp.0), (Outcome::Downloaded, 200));
//! # Ok::<(), &str>(())
//! ```

#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::unreachable,
        clippy::indexing_slicing,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )
)]
// What only the device uses.
#![cfg_attr(feature = "stub", allow(dead_code))]

#[cfg(test)]
extern crate std;

mod abort;
mod application;
pub mod bits;
mod bytes;
pub mod client;
mod config;
mod crc;
#[cfg(not(feature = "stub"))]
mod device;
#[cfg(feature = "stub")]
#[path = "stub.rs"]
mod device;
mod emergency;
mod event;
mod frame;
mod nmt;
mod node;
mod sink;
mod storage;
mod time;

pub use abort::AbortCode;
pub use application::{Application, PdoDirection, ReceivedSync, ResetScope};
pub use config::{CobId, Config, Identity, Mapping, PdoConfig};
#[cfg(not(feature = "stub"))]
pub use device::eds;
pub use device::{Device, Errors, MAX_CONSUMERS, MAX_MAPPED, MAX_RPDO, MAX_SDO, MAX_TPDO};
pub use emergency::{Emergency, ErrorClass};
pub use event::{Counters, Event, RpdoSet};
pub use frame::{Frame, function_code_bit};
pub use nmt::{NmtCommand, NmtState, NmtTarget};
pub use node::NodeId;
pub use sink::Sink;
pub use storage::{Storage, StoreProgress, StoreScope};
pub use time::Micros;
