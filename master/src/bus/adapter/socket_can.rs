//! Linux CAN interfaces: `can0`, or `vcan0` for trying things out.
//!
//! Error frames are asked for too: they show that no node acknowledges, or that the bit rate is
//! wrong.

use std::io;
use std::sync::Arc;

use canopen::Frame;
use socketcan::{
    CanDataFrame, CanFrame, CanSocket, EmbeddedFrame as _, Socket as _, SocketOptions as _,
    StandardId,
};

use super::AdapterLink;
use super::diagnosis::{self, Diagnosis};
use crate::bus::address::BusAddress;

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
    // Virtual interfaces have no errors to report.
    let _ = reader.set_error_filter_accept_all();
    let diagnosis = Diagnosis::default();
    let report = diagnosis.clone();
    let writer = Arc::clone(&reader);
    let read = move || {
        loop {
            let frame = reader.read_frame()?;
            if let CanFrame::Error(error) = &frame {
                report.report(diagnosis::of_error_frame(error.error_bits()));
            }
            if let Some(frame) = ours(&frame) {
                report.report(None);
                return Ok(frame);
            }
        }
    };
    let write = move |frame: &Frame| {
        let id = StandardId::new(frame.id()).ok_or(io::ErrorKind::InvalidInput)?;
        let frame = CanDataFrame::new(id, frame.data()).ok_or(io::ErrorKind::InvalidInput)?;
        writer.write_frame(&frame)
    };
    let mut link = AdapterLink::start(bus, read, write);
    link.diagnosis = diagnosis;
    Ok(link)
}
