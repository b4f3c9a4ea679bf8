//! The channel behind the telemetry: one writer, any number of readers, none of which holds up
//! the others.
//!
//! Every subscription has a queue of its own with a fixed capacity. When it is full the oldest item
//! goes and is counted. The writer takes one short lock per subscription and item.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use super::Telemetry;

/// Items a subscription holds unless told otherwise: ten seconds of snapshots at 100 Hz.
pub const DEFAULT_CAPACITY: usize = 1_000;

/// Which items a subscription wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interest {
    /// Snapshots and events.
    Group,
    /// Every frame on the bus as well.
    Frames,
}

#[derive(Default)]
struct Queue {
    items: VecDeque<Telemetry>,
    missed: u64,
    ended: bool,
}

struct Shared {
    queue: Mutex<Queue>,
    arrived: Condvar,
    capacity: usize,
    interest: Interest,
}

impl Shared {
    /// A reader that panicked has not left the queue half changed.
    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Where the items come from. Cheap to clone: a clone can hand out subscriptions from another
/// thread.
#[derive(Clone, Default)]
pub struct Hub(Arc<Mutex<Vec<Weak<Shared>>>>);

impl Hub {
    /// A new reader, which gets everything from now on. `capacity` items may wait for it.
    #[must_use]
    pub fn subscribe(&self, interest: Interest, capacity: usize) -> Subscription {
        let shared = Arc::new(Shared {
            queue: Mutex::default(),
            arrived: Condvar::new(),
            capacity: capacity.max(1),
            interest,
        });
        self.readers().push(Arc::downgrade(&shared));
        Subscription(shared)
    }

    fn readers(&self) -> MutexGuard<'_, Vec<Weak<Shared>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether there is a subscriber for items of this kind.
    #[must_use]
    pub fn is_wanted(&self, interest: Interest) -> bool {
        self.readers().iter().any(|reader| {
            reader
                .upgrade()
                .is_some_and(|reader| interest == Interest::Group || reader.interest == interest)
        })
    }

    /// Hands an item to all who want it.
    pub fn publish(&self, item: &Telemetry) {
        let mut readers = self.readers();
        readers.retain(|reader| reader.strong_count() > 0);
        for reader in readers.iter().filter_map(Weak::upgrade) {
            if matches!(item, Telemetry::Frame(_)) && reader.interest != Interest::Frames {
                continue;
            }
            let mut queue = reader.lock();
            if queue.items.len() == reader.capacity {
                queue.items.pop_front();
                queue.missed += 1;
            }
            queue.items.push_back(item.clone());
            reader.arrived.notify_one();
        }
    }

    /// Says that nothing will come any more; readers get what waits and then the end.
    pub fn end(&self) {
        for reader in self.readers().iter().filter_map(Weak::upgrade) {
            reader.lock().ended = true;
            reader.arrived.notify_all();
        }
    }
}

/// One reader's end of the telemetry. Dropping it unsubscribes.
pub struct Subscription(Arc<Shared>);

impl Subscription {
    /// The next item, if one waits.
    #[must_use]
    pub fn try_next(&self) -> Option<Telemetry> {
        self.0.lock().items.pop_front()
    }

    /// The next item, waiting at most so long for it.
    #[must_use]
    pub fn next_within(&self, patience: Duration) -> Option<Telemetry> {
        let deadline = Instant::now() + patience;
        let mut queue = self.0.lock();
        loop {
            if let Some(item) = queue.items.pop_front() {
                return Some(item);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if queue.ended || left.is_zero() {
                return None;
            }
            let waited = self.0.arrived.wait_timeout(queue, left);
            queue = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Whether the session has ended and everything has been read.
    #[must_use]
    pub fn is_over(&self) -> bool {
        let queue = self.0.lock();
        queue.ended && queue.items.is_empty()
    }

    /// How many items this reader was too slow for.
    #[must_use]
    pub fn missed(&self) -> u64 {
        self.0.lock().missed
    }
}

/// Waits for items until the session ends.
impl Iterator for Subscription {
    type Item = Telemetry;

    fn next(&mut self) -> Option<Telemetry> {
        let mut queue = self.0.lock();
        loop {
            if let Some(item) = queue.items.pop_front() {
                return Some(item);
            }
            if queue.ended {
                return None;
            }
            let waited = self.0.arrived.wait(queue);
            queue = waited.unwrap_or_else(PoisonError::into_inner);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{BusFrame, Event, EventKind, SessionState};
    use super::*;
    use canopen::Frame;

    fn event(t: f64) -> Telemetry {
        Telemetry::Event(Event {
            t,
            node: None,
            what: EventKind::SessionState(SessionState::Running),
        })
    }

    fn frame() -> Telemetry {
        Telemetry::Frame(BusFrame {
            t: 0.0,
            frame: Frame::of(0x80, [1]),
            sent: true,
        })
    }

    #[test]
    fn everybody_gets_everything_they_want_in_order() {
        let hub = Hub::default();
        assert!(!hub.is_wanted(Interest::Group));
        let (a, b) = (
            hub.subscribe(Interest::Group, 8),
            hub.subscribe(Interest::Frames, 8),
        );
        for item in [event(1.0), frame(), event(2.0)] {
            hub.publish(&item);
        }
        hub.end();
        assert_eq!(a.collect::<Vec<_>>(), [event(1.0), event(2.0)]);
        assert_eq!(b.collect::<Vec<_>>(), [event(1.0), frame(), event(2.0)]);
    }

    #[test]
    fn a_slow_reader_loses_the_oldest_and_knows_how_many() {
        let hub = Hub::default();
        let slow = hub.subscribe(Interest::Group, 2);
        for t in 0..5 {
            hub.publish(&event(f64::from(t)));
        }
        assert_eq!(slow.missed(), 3);
        assert_eq!(slow.try_next(), Some(event(3.0)));
        assert_eq!(slow.try_next(), Some(event(4.0)));
        assert_eq!(slow.try_next(), None);
        assert!(!slow.is_over());
        hub.end();
        assert!(slow.is_over());
    }

    #[test]
    fn who_has_gone_is_not_served() {
        let hub = Hub::default();
        drop(hub.subscribe(Interest::Frames, 1));
        assert!(!hub.is_wanted(Interest::Frames));
        assert!(!hub.is_wanted(Interest::Group));
    }
}
