//! Linux CAN interfaces: `can0`, or `vcan0` for trying things out.

use std::io;
use std::sync::Arc;

use canopen::Frame;
use socketcan::{CanDataFrame, CanFrame, CanSocket, EmbeddedFrame as _, Socket as _, StandardId};

use super::AdapterLink;
use crate::bus::BusAddress;

/// A frame of ours, if it is one that the bus carries: 11-bit data frames only.
fn ours(frame: &CanFrame) -> Option<Frame> {
    let CanFrame::Data(frame) = frame else {
        return None;
    };
    match frame.id() {
        socketcan::Id::Standard(id) => Frame::new(id.as_raw(), frame.data()),
        socketcan::Id::Extended(_) => None,
    }
}

/// Opens an interface that is already up; its bit rate is the system's business.
pub fn open(bus: &BusAddress, interface: &str) -> io::Result<AdapterLink> {
    let reader = Arc::new(CanSocket::open(interface)?);
    let writer = Arc::clone(&reader);
    let read = move || {
        loop {
            if let Some(frame) = ours(&reader.read_frame()?) {
                return Ok(frame);
            }
        }
    };
    let write = move |frame: &Frame| {
        let id = StandardId::new(frame.id()).ok_or(io::ErrorKind::InvalidInput)?;
        let frame = CanDataFrame::new(id, frame.data()).ok_or(io::ErrorKind::InvalidInput)?;
        writer.write_frame(&frame)
    };
    Ok(AdapterLink::start(bus, read, write))
}
