//! The cells that the two sides share; they exchange data in no other way.
//!
//! | cell | from | to | when it is not read in time |
//! |---|---|---|---|
//! | [`COMMAND`] | bus | control | the newer command replaces it; the older one is never wanted |
//! | [`SYNC`] | bus | control | the newer time replaces it |
//! | [`report`](crate::control::report) | control | bus | the next tick changes it |
//! | [`IDENTIFIED`] | control | bus | the newer result replaces it |
//! | [`BUS_PROGRESS`] | bus | control, for the watchdog | counts on; only a change matters |
//! | [`CONTROL_LATENESS`] | control | health | the largest value stays |
//!
//! The control tick uses the cells where they are: the bus side does not run beside it. The bus
//! side copies with interrupts masked (`board`'s `TickMutex`). That takes a microsecond for the
//! data of every turn. A new configuration has no cell: the bus side calls
//! [`configure`](crate::control::configure), with interrupts masked and the outputs off. Both are
//! shorter than it takes to fill the three places of a receive FIFO (at least 140 us), so they can
//! delay a receive time stamp but cannot lose a frame. The signal that wakes the bus task is in
//! [`wake`](crate::wake).

use core::cell::RefCell;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use control::interface::Command;
use control::time::Micros;
use embassy_sync::blocking_mutex::Mutex;
use identification::Outcome;

use crate::board::TickMutex;

/// A value that one side replaces and the other reads: the latest wins.
pub struct Latest<T: Copy>(Mutex<TickMutex, RefCell<T>>);

impl<T: Copy> Latest<T> {
    const fn new(first: T) -> Self {
        Self(Mutex::new(RefCell::new(first)))
    }

    /// Replaces the value.
    pub fn put(&self, value: &T) {
        self.0.lock(|cell| *cell.borrow_mut() = *value);
    }

    /// Uses the latest value where it is.
    pub fn with<R>(&self, use_it: impl FnOnce(&T) -> R) -> R {
        self.0.lock(|cell| use_it(&cell.borrow()))
    }
}

/// A value that one side puts in and the other receives, once: the latest wins.
pub struct Mailbox<T: Copy> {
    content: Mutex<TickMutex, RefCell<Option<T>>>,
    /// Read without the mutex, by the tick. Relaxed: there is one core, and the mutex around the
    /// content keeps the compiler's order.
    full: AtomicBool,
}

impl<T: Copy> Mailbox<T> {
    const fn new() -> Self {
        Self {
            content: Mutex::new(RefCell::new(None)),
            full: AtomicBool::new(false),
        }
    }

    /// Puts a value in. By reference, so that it is copied once.
    pub fn put(&self, value: &T) {
        self.content.lock(|cell| *cell.borrow_mut() = Some(*value));
        self.full.store(true, Ordering::Relaxed);
    }

    /// Empties it: returns the value if there is one.
    pub fn receive(&self) -> Option<T> {
        if !self.full.load(Ordering::Relaxed) {
            return None;
        }
        // Before the content: a value that is put in between is found twice rather than missed.
        self.full.store(false, Ordering::Relaxed);
        self.content.lock(|cell| cell.borrow_mut().take())
    }
}

/// The bus side's command.
pub static COMMAND: Latest<Command> = Latest::new(Command::NONE);

/// When the last SYNC was received, local time, until the control side has received it.
pub static SYNC: Mailbox<Micros> = Mailbox::new();

/// The result of an identification, until the bus side has received it.
pub static IDENTIFIED: Mailbox<Outcome> = Mailbox::new();

/// Turns that the bus task has completed.
pub static BUS_PROGRESS: Progress = Progress::new();

/// Longest time by which a control tick started late, since it was last read.
pub static CONTROL_LATENESS: Longest = Longest::new();

/// A count that shows that a task still runs.
pub struct Progress(AtomicU32);

impl Progress {
    const fn new() -> Self {
        Self(AtomicU32::new(0))
    }

    /// Records that the task has run once more.
    pub fn made(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// How often it has run, wrapping.
    pub fn count(&self) -> u32 {
        self.0.load(Ordering::Relaxed)
    }
}

/// The longest time seen.
pub struct Longest(AtomicU32);

impl Longest {
    const fn new() -> Self {
        Self(AtomicU32::new(0))
    }

    /// Records a time.
    pub fn record(&self, time: Micros) {
        let time_us = u32::try_from(time.0).unwrap_or(u32::MAX);
        self.0.fetch_max(time_us, Ordering::Relaxed);
    }

    /// Returns the longest time noted, in microseconds, and starts again from zero.
    pub fn reset_us(&self) -> u32 {
        self.0.swap(0, Ordering::Relaxed)
    }
}
