//! What a robot counts beside what its control side does.

/// Since the robot started, wrapping.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Counters {
    /// Gaps in the SYNC counter.
    pub lost_syncs: u32,
    /// Setpoints not followed.
    pub ignored_setpoints: u32,
    /// Writes to the table that were refused.
    pub refused_writes: u32,
    /// Times a fault brought the robot to rest.
    pub stops: u32,
    /// Set by the platform.
    pub watchdog_resets: u32,
    /// Set by the platform.
    pub can_errors: u32,
    /// What the platform's cable has lost.
    pub cable: CableLosses,
    /// SYNCs whose votes came too late for the agreement delay.
    pub late_votes: u32,
    /// Longest time from SYNC to the last vote on it, us.
    pub latest_vote_us: u32,
    /// What the platform's store has been through.
    pub store: StoreWear,
}

/// What has been lost between a robot's cable and its bus since it started, wrapping.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct CableLosses {
    /// Lines, most of them frames of the bus, that the cable had no room for.
    pub to_cable: u32,
    /// Frames of the cable that have not left for the bus.
    pub to_bus: u32,
    /// Times that bytes from the cable were damaged or came too fast.
    pub damaged: u32,
}

/// What a store has been through since it was new.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct StoreWear {
    /// Images stored.
    pub saves: u32,
    /// Sectors erased.
    pub erases: u32,
    /// Saves that a loss of power cut off.
    pub cut: u32,
}
