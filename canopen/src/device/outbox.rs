//! What leaves the device: frames, events, counts, and the time it next wants to be polled.

use heapless::Deque;

use crate::time::Timer;
use crate::{Counters, Event, Frame, Micros};

/// Frames that may wait for the application to take them.
const FRAMES: usize = 16;
/// Events that may wait.
const EVENTS: usize = 16;

pub(super) struct Outbox {
    frames: Deque<Frame, FRAMES>,
    events: Deque<Event, EVENTS>,
    counters: Counters,
    next: Micros,
}

impl Outbox {
    pub const fn new() -> Self {
        Self {
            frames: Deque::new(),
            events: Deque::new(),
            counters: Counters {
                tx_overflow: 0,
                event_overflow: 0,
                sync_gaps: 0,
                rpdo_too_short: 0,
                rpdo_refused: 0,
                sdo_aborts: 0,
                heartbeats_lost: 0,
            },
            next: Micros::MAX,
        }
    }

    pub fn send(&mut self, frame: Frame) {
        if self.frames.push_back(frame).is_err() {
            self.count(|counters| &mut counters.tx_overflow);
        }
    }

    pub fn emit(&mut self, event: Event) {
        if self.events.push_back(event).is_err() {
            self.count(|counters| &mut counters.event_overflow);
        }
    }

    pub fn count(&mut self, which: impl FnOnce(&mut Counters) -> &mut u32) {
        let counter = which(&mut self.counters);
        *counter = counter.wrapping_add(1);
    }

    /// The next `poll` must not come later than this timer.
    pub fn wake(&mut self, timer: Timer) {
        self.next = self.next.min(timer.moment());
    }

    pub fn clear_next(&mut self) {
        self.next = Micros::MAX;
    }

    pub fn clear_frames(&mut self) {
        self.frames.clear();
    }

    pub fn pop_frame(&mut self) -> Option<Frame> {
        self.frames.pop_front()
    }

    pub fn pop_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    pub const fn next(&self) -> Micros {
        self.next
    }

    pub const fn counters(&self) -> Counters {
        self.counters
    }
}
