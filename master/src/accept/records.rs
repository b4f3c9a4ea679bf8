//! When robots say that faults appeared, on the clock of the bus.
//!
//! A robot keeps its last eight faults with their times on its own clock (objects 0x2122 and
//! 0x2123), and tells that clock (0x2129:3). Both are whole milliseconds. The offset between the
//! two clocks is that of the fastest of a few readings, so a time is within 1 ms, and half of the
//! time that this reading took.

use protocol::address::{self, history};
use protocol::{Fault, Kind};

use crate::bus::link::Link;
use crate::bus::wire::Wire;
use crate::error::MasterError;

/// How often the clock is read.
const READINGS: u32 = 5;

/// A fault of a robot's history.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// Which.
    pub fault: Fault,
    /// When it appeared, µs on the link's clock.
    pub at_us: f64,
}

/// The history of a robot since a time on the link's clock, µs; the oldest first.
///
/// # Errors
/// When the robot does not answer.
pub fn since<L: Link>(
    wire: &mut Wire<L>,
    node: u8,
    from_us: u64,
) -> Result<Vec<Entry>, MasterError> {
    let offset_us = offset(wire, node)?;
    let mut entries = Vec::new();
    for nth in 1..=history::DEPTH {
        let code = wire.read(node, history::code(nth), Kind::U16)?.to_bits();
        let Some(fault) = u16::try_from(code).ok().and_then(Fault::from_code) else {
            break;
        };
        let time_ms = wire.read(node, history::time(nth), Kind::U32)?.to_bits();
        let at_us = f64::from(time_ms) * 1e3 + offset_us;
        // A millisecond is what the record leaves open.
        if at_us + 1e3 < from_us as f64 {
            break;
        }
        entries.push(Entry { fault, at_us });
    }
    entries.reverse();
    Ok(entries)
}

/// What has to be added to a time of the robot to get one of the link, µs.
fn offset<L: Link>(wire: &mut Wire<L>, node: u8) -> Result<f64, MasterError> {
    let mut best: Option<(u64, f64)> = None;
    for _ in 0..READINGS {
        let before = wire.now().0;
        let uptime_ms = wire.read(node, address::UPTIME, Kind::U32)?.to_bits();
        let took = wire.now().0 - before;
        let middle = before as f64 + took as f64 / 2.0;
        let offset = middle - f64::from(uptime_ms) * 1e3;
        if best.is_none_or(|(least, _)| took < least) {
            best = Some((took, offset));
        }
    }
    Ok(best.map_or(0.0, |(_, offset)| offset))
}
