//! The last faults, newest first, with the time each appeared.

use protocol::Fault;
use protocol::address::history::DEPTH;

/// The last eight faults.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct History {
    faults: [Option<(Fault, u32)>; DEPTH as usize],
}

impl History {
    pub const fn new() -> Self {
        Self {
            faults: [None; DEPTH as usize],
        }
    }

    /// Puts a fault in front; the oldest falls out.
    pub fn push(&mut self, fault: Fault, time_ms: u32) {
        self.faults.rotate_right(1);
        if let Some(first) = self.faults.first_mut() {
            *first = Some((fault, time_ms));
        }
    }

    /// The `nth` newest, counted from 1.
    pub fn nth(&self, nth: u8) -> Option<(Fault, u32)> {
        let at = usize::from(nth).checked_sub(1)?;
        self.faults.get(at).copied().flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newest_is_first_and_the_oldest_falls_out() {
        let mut history = History::new();
        assert_eq!(history.nth(1), None);
        for time in 0..10 {
            history.push(Fault::SyncLost, time);
        }
        assert_eq!(history.nth(1), Some((Fault::SyncLost, 9)));
        assert_eq!(history.nth(8), Some((Fault::SyncLost, 2)));
        assert_eq!(history.nth(9), None);
        assert_eq!(history.nth(0), None);
    }
}
