//! The last faults, or limits, newest first, with the time each appeared.

use protocol::address::history::DEPTH;

/// The last eight.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct History {
    /// Code and time in ms; code 0 for none.
    entries: [(u16, u32); DEPTH as usize],
}

impl History {
    pub const fn new() -> Self {
        Self {
            entries: [(0, 0); DEPTH as usize],
        }
    }

    /// Puts one in front; the oldest falls out.
    pub fn push(&mut self, code: u16, time_ms: u32) {
        self.entries.rotate_right(1);
        if let Some(first) = self.entries.first_mut() {
            *first = (code, time_ms);
        }
    }

    /// Code and time of the `nth` newest, counted from 1; zeros for none.
    pub fn nth(&self, nth: u8) -> (u16, u32) {
        let at = usize::from(nth).checked_sub(1);
        let entry = at.and_then(|at| self.entries.get(at));
        entry.copied().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newest_is_first_and_the_oldest_falls_out() {
        let mut history = History::new();
        assert_eq!(history.nth(1), (0, 0));
        for time in 0..10 {
            history.push(7, time);
        }
        assert_eq!(history.nth(1), (7, 9));
        assert_eq!(history.nth(8), (7, 2));
        assert_eq!(history.nth(9), (0, 0));
        assert_eq!(history.nth(0), (0, 0));
    }
}
