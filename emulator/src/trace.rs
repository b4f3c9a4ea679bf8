//! A record of a board's outputs: each change with its cycle.
//!
//! The trace contains the outputs: PWM duties when they take effect (with preload at the update
//! event, not at the write), output pins, and frames passed to the CAN controller. It also contains
//! the inputs: encoders and received frames. Two runs are equal when their traces are equal. On
//! demand the trace includes the position in the program.

use std::sync::Arc;

use crate::can::CanFrame;
use crate::system::gpio::{PinLevel, Port};
use crate::timer::{OutputState, PwmState};

/// One change of an output.
#[derive(Debug, Clone, PartialEq)]
pub enum Change {
    /// A PWM output of timer and channel (from 1), at its pin.
    Pwm {
        /// Timer, 1..=14.
        timer: usize,
        /// Channel, 1..=4.
        channel: usize,
        /// From now on.
        state: PwmState,
    },
    /// A pin in output mode, or no longer.
    Pin {
        /// Port.
        port: Port,
        /// Pin, 0..=15.
        pin: u8,
        /// From now on.
        level: PinLevel,
    },
    /// A frame was put into a transmit mailbox.
    Request(CanFrame),
    /// A frame arrived on the bus, whether a filter takes it or not.
    Arrival(CanFrame),
    /// An encoder was turned.
    Encoder {
        /// Its timer.
        timer: usize,
        /// Counter after it.
        count: u32,
    },
    /// The exception that is handled, 16 and on being interrupts; 0 is none.
    Exception(u16),
    /// The task that is polled.
    Task(Option<Arc<str>>),
}

/// A change with its time.
#[derive(Debug, Clone, PartialEq)]
pub struct Traced {
    /// World time in ns.
    pub t_ns: u64,
    /// What changed.
    pub change: Change,
}

/// Timers that can drive pins and have four channels.
pub(crate) const PWM_TIMERS: [usize; 6] = [1, 2, 3, 4, 5, 8];

/// The last known outputs and the changes since the record was taken.
#[derive(Debug, Clone, Default)]
pub(crate) struct Trace {
    pwm: [[PwmState; 4]; PWM_TIMERS.len()],
    /// What they follow from: version of the wiring, core clock in Hz, state of the timer.
    sources: [Option<(u64, u64, OutputState)>; PWM_TIMERS.len()],
    /// Pins that are driven low and that are driven high; all float at power-on.
    pins: [(u32, u32); Port::ALL.len()],
    requests: u64,
    pub(crate) changes: Vec<(u64, Change)>,
}

impl Trace {
    /// Whether the outputs of a timer follow from something else than before.
    pub(crate) fn is_new(&mut self, index: usize, source: (u64, u64, OutputState)) -> bool {
        self.sources[index].replace(source) != Some(source)
    }

    pub(crate) fn pwm(&mut self, now: u64, index: usize, channel: usize, state: PwmState) {
        let last = &mut self.pwm[index][channel - 1];
        if *last != state {
            *last = state;
            let timer = PWM_TIMERS[index];
            self.changes.push((
                now,
                Change::Pwm {
                    timer,
                    channel,
                    state,
                },
            ));
        }
    }

    /// The pins of a port that are driven low and that are driven high; the others float.
    pub(crate) fn pins(&mut self, now: u64, port: Port, low: u32, high: u32) {
        let before = std::mem::replace(&mut self.pins[port as usize], (low, high));
        let mut changed = (before.0 ^ low) | (before.1 ^ high);
        while changed != 0 {
            let pin = changed.trailing_zeros() as u8;
            changed &= changed - 1;
            let level = match (low >> pin & 1, high >> pin & 1) {
                (0, 0) => PinLevel::Floating,
                (0, _) => PinLevel::High,
                _ => PinLevel::Low,
            };
            self.changes.push((now, Change::Pin { port, pin, level }));
        }
    }

    pub(crate) fn request(&mut self, requests: u64, latest: Option<(CanFrame, u64)>) {
        if std::mem::replace(&mut self.requests, requests) != requests
            && let Some((frame, at)) = latest
        {
            self.changes.push((at, Change::Request(frame)));
        }
    }
}
