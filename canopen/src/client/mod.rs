//! The master's side: the services that a master needs to talk to CANopen devices.
//!
//! [`SdoClient`] reads and writes the objects of one device; the functions of this module encode
//! and decode the frames of the other services. The module has no I/O either.

mod lss;
mod messages;
mod sdo;

pub use lss::{
    FastScan, LssAnswer, Scanned, lss_identify, lss_inquire_node, lss_select, lss_set_node,
    lss_store, lss_switch_all, parse_lss,
};
pub use messages::{heartbeat, nmt, parse_heartbeat, parse_nmt, sync};
pub use sdo::{Busy, Outcome, SdoClient, SdoError};
