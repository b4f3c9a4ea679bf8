//! The load of the bus: overall, and in the busiest window.
//!
//! Windows follow each other from time 0. A frame across a boundary counts in both windows with its
//! part in each.

/// Load of the bus, 0..=1 of the time; intermissions count as taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BusLoad {
    /// Since time 0.
    pub mean: f64,
    /// In the fullest complete window.
    pub largest: f64,
    /// Length of a window, ns.
    pub window_ns: u64,
}

/// Adds up the time the wire is taken.
#[derive(Debug, Clone)]
pub struct LoadMeter {
    window_ns: u64,
    /// Busy time of all closed windows, and of the open one.
    closed_ns: u64,
    open_ns: u64,
    /// Start of the open window.
    start_ns: u64,
    largest_ns: u64,
    /// End of the last busy interval: it may lie ahead of the clock.
    last: (u64, u64),
}

impl LoadMeter {
    /// A meter with windows of this length, ns, at least 1.
    #[must_use]
    pub fn new(window_ns: u64) -> Self {
        Self {
            window_ns: window_ns.max(1),
            closed_ns: 0,
            open_ns: 0,
            start_ns: 0,
            largest_ns: 0,
            last: (0, 0),
        }
    }

    /// The wire is taken from `from` to `to`, ns. Intervals come in order and do not overlap.
    pub fn busy(&mut self, from: u64, to: u64) {
        self.settle(from);
        self.last = (from, to);
    }

    /// The last interval ends at another time than was thought; not before now.
    pub fn ends(&mut self, to: u64) {
        self.last.1 = to;
    }

    /// Books the last interval as far as it lies before `now`, and closes windows that are over.
    fn settle(&mut self, now: u64) {
        let (mut from, end) = self.last;
        let to = end.min(now);
        loop {
            let boundary = self.start_ns + self.window_ns;
            let part = to.min(boundary).saturating_sub(from);
            self.open_ns += part;
            from += part;
            if now < boundary {
                break;
            }
            self.largest_ns = self.largest_ns.max(self.open_ns);
            self.closed_ns += self.open_ns;
            self.open_ns = 0;
            self.start_ns = boundary;
        }
        self.last = (from, end);
    }

    /// Busy time up to now, ns.
    #[must_use]
    pub fn busy_ns(&self, now: u64) -> u64 {
        let (from, end) = self.last;
        self.closed_ns + self.open_ns + end.min(now).saturating_sub(from)
    }

    /// Load up to now.
    #[must_use]
    pub fn read(&self, now: u64) -> BusLoad {
        let mut settled = Self { ..*self };
        settled.settle(now);
        BusLoad {
            mean: self.busy_ns(now) as f64 / now.max(1) as f64,
            largest: settled.largest_ns as f64 / self.window_ns as f64,
            window_ns: self.window_ns,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Windows of 100: 30 taken in the first; an interval of 60 across the boundary leaves 20 in
    /// the second and 40 in the third; 10 more in the third.
    #[test]
    fn a_frame_across_a_boundary_counts_in_both_windows() {
        let mut meter = LoadMeter::new(100);
        meter.busy(10, 40);
        meter.busy(180, 240);
        meter.busy(250, 260);
        assert_eq!(
            meter.read(300),
            BusLoad {
                mean: 1.0 / 3.0,
                largest: 0.5,
                window_ns: 100
            }
        );
    }

    #[test]
    fn what_lies_ahead_is_not_counted_yet() {
        let mut meter = LoadMeter::new(100);
        meter.busy(10, 40);
        assert_eq!(meter.busy_ns(20), 10);
        assert_eq!(meter.read(100).largest, 0.3);
    }

    /// The open window is left out: it would read 100 % just after a frame begins.
    #[test]
    fn an_open_window_is_not_the_largest() {
        let mut meter = LoadMeter::new(100);
        meter.busy(0, 40);
        assert_eq!(meter.read(50).largest, 0.0);
    }
}
