//! A CAN bus as the master sees it: a name, a link to send and receive by, and how full it is.
//!
//! [`address`] reads the text after `--bus` and [`open`] opens it; every bus is a
//! [`link::Link`]. On a real one that is an [`adapter`], whose thread sends SYNC on time. [`wire`]
//! sends SDO requests over a link and waits for the answers; a [`tap`] copies every frame.

pub mod adapter;
pub mod address;
pub mod auto;
pub mod foreign;
pub mod frame_name;
pub mod link;
pub mod load;
pub mod punctuality;
pub mod tap;
pub mod wire;

use group::GroupFile;

use crate::run::DriveError;
use link::Link;

pub use address::BusAddress;

/// Opens a bus. A simulated one is built with freshly booted native robots of `group` at the
/// origin.
///
/// # Errors
/// When the adapter cannot be opened or the world cannot be built; the error says what to check.
pub fn open(bus: &BusAddress, group: &GroupFile) -> Result<Box<dyn Link>, DriveError> {
    Ok(match bus {
        #[cfg(feature = "simulation")]
        BusAddress::Sim(_) => Box::new(crate::simulation::open(group, None, bus.to_string())?),
        #[cfg(not(feature = "simulation"))]
        BusAddress::Sim(_) => {
            let _ = group;
            return Err(DriveError::NoSimulation);
        }
        real => adapter::open(real).map_err(crate::error::MasterError::from)?,
    })
}
