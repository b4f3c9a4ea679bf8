//! The wheels' index inputs: the counter as it stands when the pulse comes; with smart drives,
//! which have no counter here, the time of the pulse.
//!
//! All four are lines of two external interrupt vectors, at a priority above everything that
//! computes, so that a counter is read within about a microsecond of the edge: at 15 rad/s and 40
//! 000 counts a turn a tenth of a count late. The control side takes what is there at its
//! next tick; each pulse has a number that wraps at 256, which distinguishes it from the last one.
//!
//! Noise must not take the processor from the control tick. So the lines listen only when the
//! configuration has indexes, and a line that has had its pulse listens again from the next tick
//! on: one interrupt a wheel and tick at most. A wheel turns once in a hundred milliseconds, so
//! what comes within a millisecond of a pulse is none.

#![expect(unsafe_code, reason = "an interrupt handler is called by the hardware")]

use core::sync::atomic::{AtomicU32, Ordering};

use control::rollers::IndexPulse;
use control::smart_drive::index::IndexEdge;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::{interrupt, pac};

use super::encoders::count;
use super::pin::{Pull, Role};
use crate::board::WIRING;
use crate::board::family::drives;
use crate::board::family::listen_to_port;

/// Lines of the pins, which are their numbers: front left, front right, rear left, rear right. They
/// share two interrupt vectors, EXTI9_5 and EXTI15_10.
const LINES: Option<[u8; 4]> = {
    match WIRING.index {
        None => None,
        Some([a, b, c, d]) => {
            let lines = [a.bit, b.bit, c.bit, d.bit];
            let mask: u32 = 1 << a.bit | 1 << b.bit | 1 << c.bit | 1 << d.bit;
            assert!(
                mask.count_ones() == 4 && mask.trailing_zeros() >= 5,
                "the index pins need different numbers from 5 to 15"
            );
            Some(lines)
        }
    }
};

/// The four lines in a register.
const MASK: u32 = match LINES {
    None => 0,
    Some([a, b, c, d]) => 1 << a | 1 << b | 1 << c | 1 << d,
};

/// Lines of the first vector.
const LINES_9_5: u32 = 0x3E0;

/// Number of the last pulse in the upper half, the counter or the time at it in the lower.
static PULSES: [AtomicU32; 4] = [const { AtomicU32::new(0) }; 4];

/// The index inputs.
pub struct Indexes {
    /// The lines in a register that are listened to: all or none.
    lines: u32,
}

impl Indexes {
    /// Takes the pins. A pulse is a rising edge.
    pub fn new() -> Self {
        if let Some(pins) = WIRING.index {
            for pin in pins {
                pin.become_a(Role::Input(Pull::Down));
                listen_to_port(pin.bit.into(), pin.port);
            }
            pac::EXTI.rtsr(0).modify(|w| w.0 |= MASK);
            interrupt::EXTI15_10.set_priority(Priority::P2);
            if MASK & LINES_9_5 != 0 {
                interrupt::EXTI9_5.set_priority(Priority::P2);
                // SAFETY: as below.
                unsafe { interrupt::EXTI9_5.enable() };
            }
            // SAFETY: called at start-up, outside any critical section. The handler writes atomics
            // and EXTI's mask, which others change with interrupts masked once lines listen.
            unsafe { interrupt::EXTI15_10.enable() };
        }
        Self { lines: 0 }
    }

    /// Whether pulses are wanted, from the next [`Indexes::pulses`] on.
    pub fn listen(&mut self, wanted: bool) {
        if wanted && self.lines == 0 {
            // Nothing listens yet, so nothing writes them.
            for pulse in &PULSES {
                pulse.store(0, Ordering::Relaxed);
            }
        }
        self.lines = if wanted { MASK } else { 0 };
        cortex_m::interrupt::free(|_| pac::EXTI.imr(0).modify(|w| w.0 &= !MASK));
    }

    /// The last pulse of each wheel since the lines listen; `None` where they do not. Lines that
    /// have had one listen again.
    pub fn pulses(&self) -> Option<[IndexPulse; 4]> {
        (self.lines != 0).then(|| self.listened(|number, count| IndexPulse { number, count }))
    }

    /// The same with smart drives: the last edges.
    pub fn edges(&self) -> Option<[IndexEdge; 4]> {
        (self.lines != 0).then(|| self.listened(|number, at_us| IndexEdge { number, at_us }))
    }

    /// Not inlined: most robots have no index.
    #[inline(never)]
    fn listened<T>(&self, of: impl Fn(u8, u16) -> T) -> [T; 4] {
        let deaf = self.lines & !pac::EXTI.imr(0).read().0;
        if deaf != 0 {
            // Edges that came meanwhile are pending.
            pac::EXTI.pr(0).write(|w| w.0 = deaf);
            cortex_m::interrupt::free(|_| pac::EXTI.imr(0).modify(|w| w.0 |= deaf));
        }
        let one = |pulse: &AtomicU32| {
            let [low, high, number, _] = pulse.load(Ordering::Relaxed).to_le_bytes();
            of(number, u16::from_le_bytes([low, high]))
        };
        let [a, b, c, d] = &PULSES;
        [one(a), one(b), one(c), one(d)]
    }
}

#[interrupt]
fn EXTI9_5() {
    if MASK & LINES_9_5 != 0 {
        on_edge();
    }
}

#[interrupt]
fn EXTI15_10() {
    on_edge();
}

fn on_edge() {
    // First: everything else can wait.
    let captured = if drives::ARE_WIRED {
        let [low, high, ..] = crate::board::now().0.to_le_bytes();
        [u16::from_le_bytes([low, high]); 4]
    } else {
        WIRING.encoders.map(count)
    };
    // A line that is masked may be pending: what was captured is not of its edge.
    let listening = pac::EXTI.imr(0).read().0;
    let pending = pac::EXTI.pr(0).read().0 & listening & MASK;
    pac::EXTI.imr(0).write(|w| w.0 = listening & !pending);
    pac::EXTI.pr(0).write(|w| w.0 = pending);
    let lines = LINES.into_iter().flatten();
    for ((line, captured), pulse) in lines.zip(captured).zip(&PULSES) {
        if pending >> line & 1 == 1 {
            let number = (pulse.load(Ordering::Relaxed) >> 16).wrapping_add(1) & 0xFF;
            pulse.store(number << 16 | u32::from(captured), Ordering::Relaxed);
        }
    }
}
