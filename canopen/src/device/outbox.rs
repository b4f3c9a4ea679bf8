//! The outputs of the device: frames, events, counts, and the time of its next poll.
//!
//! These functions have many callers; inlining them would cost 700 bytes of flash and save hardly
//! any time, hence `inline(never)`.

use heapless::Deque;

use crate::time::Timer;
use crate::{Counters, Event, Frame, Micros};

/// Frames that may wait for the application to take them.
const FRAMES: usize = 16;
/// Events that may wait, and how many of these places are for changes of the device itself alone:
/// an application that missed one would take it for what it was before.
const EVENTS: usize = 16;
const FOR_CHANGES: usize = 4;

#[derive(Clone)]
pub(super) struct Outbox {
    frames: Deque<Frame, FRAMES>,
    events: Deque<Event, EVENTS>,
    counters: Counters,
    next: Micros,
    /// Frames have been dropped since this was last taken.
    overflowed: bool,
    /// Off the bus: frames are dropped without counting.
    muted: bool,
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
                syncs_lost: 0,
                pdos_late: 0,
                rpdo_too_short: 0,
                rpdo_refused: 0,
                bus_off: 0,
                sdo_aborts: 0,
                heartbeats_lost: 0,
            },
            next: Micros::MAX,
            overflowed: false,
            muted: false,
        }
    }

    #[inline(never)]
    pub fn send(&mut self, frame: Frame) {
        if self.muted {
            return;
        }
        if self.frames.push_back(frame).is_err() {
            self.count(|counters| &mut counters.tx_overflow);
            self.overflowed = true;
        }
    }

    pub fn set_muted(&mut self, muted: bool) {
        self.muted = muted;
    }

    pub fn is_muted(&self) -> bool {
        self.muted
    }

    pub fn is_full(&self) -> bool {
        self.frames.is_full()
    }

    /// Whether frames have been dropped since the last call.
    pub fn take_overflowed(&mut self) -> bool {
        core::mem::take(&mut self.overflowed)
    }

    #[inline(never)]
    pub fn emit(&mut self, event: Event) {
        let is_change = matches!(
            event,
            Event::NmtCommand(_) | Event::NmtChanged { .. } | Event::RecoverBus
        );
        let has_room = is_change || self.events.len() < EVENTS - FOR_CHANGES;
        if !has_room || self.events.push_back(event).is_err() {
            self.count(|counters| &mut counters.event_overflow);
        }
    }

    #[inline(never)]
    pub fn count(&mut self, which: impl FnOnce(&mut Counters) -> &mut u32) {
        let counter = which(&mut self.counters);
        *counter = counter.wrapping_add(1);
    }

    /// The next `poll` must not come later than this timer.
    #[inline(never)]
    pub fn wake(&mut self, timer: Timer) {
        self.next = self.next.min(timer.moment());
    }

    pub fn clear_next(&mut self) {
        self.next = Micros::MAX;
    }

    pub fn clear_frames(&mut self) {
        self.frames.clear();
    }

    #[inline]
    pub fn pop_frame(&mut self) -> Option<Frame> {
        self.frames.pop_front()
    }

    pub fn pop_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    #[inline]
    pub fn has_events(&self) -> bool {
        !self.events.is_empty()
    }

    /// When `poll` has something to do.
    #[inline]
    pub const fn next(&self) -> Micros {
        match self.overflowed {
            true => Micros::ZERO,
            false => self.next,
        }
    }

    pub const fn counters(&self) -> Counters {
        self.counters
    }
}
