//! A CAN bus as the master sees it: a name, a link to send and receive by, and how full it is.
//!
//! [`address`] reads the text after `--bus` and [`address::open`] opens it; every bus is a
//! [`link::Link`]. On a real one that is an [`adapter`], whose thread sends SYNC on time. [`wire`]
//! sends SDO requests over a link and waits for the answers; a [`tap`] copies every frame.

pub mod adapter;
pub mod address;
pub mod auto;
pub mod foreign;
pub mod link;
pub mod load;
pub mod punctuality;
pub mod tap;
pub mod wire;

pub use address::{BusAddress, open};
