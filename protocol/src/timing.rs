//! Times that both ends of the bus go by. Each stands here and nowhere else; those that can be set
//! are objects of the [`table`](crate::table).

/// Period of every heartbeat, the master's and the robots', ms.
pub const HEARTBEAT_MS: u16 = 100;

/// How long after the SYNC that puts a setpoint in force the robots act on it, us.
///
/// Longer than SYNC may jitter, so that all robots have it by then. A setpoint latched at SYNC *k*
/// is therefore begun at SYNC *k+1* plus this, and reached one SYNC period later.
pub const APPLY_DELAY_US: u64 = 2_000;

/// SYNC's counter runs from 1 to this (object 0x1019).
pub const SYNC_OVERFLOW: u8 = 240;
