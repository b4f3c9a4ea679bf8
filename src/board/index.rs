//! The encoders' index inputs: the counter as it stands when the pulse comes.
//!
//! All four are lines of one external interrupt vector, at a priority above everything that
//! computes, so that a counter is read within about a microsecond of the edge: at 15 rad/s and 40
//! 000 counts a turn a tenth of a count late. The control task takes what is there at its next
//! tick; a pulse is told from the last one by a number that wraps at 256.
//!
//! Noise must not take the processor from the control tick. So the lines listen only when the
//! configuration has indexes, and a line that has had its pulse listens again from the next tick
//! on: one interrupt a wheel and tick at most. A wheel turns once in a hundred milliseconds, so
//! what comes within a millisecond of a pulse is none.

#![expect(unsafe_code, reason = "an interrupt handler is called by the hardware")]

use core::sync::atomic::{AtomicU32, Ordering};

use control::rollers::IndexPulse;
use embassy_stm32::gpio::{Input, Pull};
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::{Peri, interrupt, pac, peripherals};

/// Lines of the pins, which are their numbers: front left, front right, rear left, rear right.
const LINES: [usize; 4] = [10, 12, 14, 15];

/// The four lines in a register.
const MASK: u32 = 1 << 10 | 1 << 12 | 1 << 14 | 1 << 15;

/// Number of the last pulse in the upper half, the counter at it in the lower.
static PULSES: [AtomicU32; 4] = [const { AtomicU32::new(0) }; 4];

/// The index inputs.
pub struct Indexes {
    _pins: [Input<'static>; 4],
    /// The lines in a register that are listened to: all or none.
    lines: u32,
}

impl Indexes {
    /// Takes the pins of the front left, front right, rear left and rear right index. A pulse is a
    /// rising edge.
    pub fn new(
        front_left: Peri<'static, peripherals::PB10>,
        front_right: Peri<'static, peripherals::PA12>,
        rear_left: Peri<'static, peripherals::PB14>,
        rear_right: Peri<'static, peripherals::PB15>,
    ) -> Self {
        let pins = [
            Input::new(front_left, Pull::Down),
            Input::new(front_right, Pull::Down),
            Input::new(rear_left, Pull::Down),
            Input::new(rear_right, Pull::Down),
        ];
        // RM0390 rev 6, 8.2.5 and 8.2.6: which port a line listens to; 0 is A, 1 is B.
        const PORTS: [u8; 4] = [1, 0, 1, 1];
        for (line, port) in LINES.into_iter().zip(PORTS) {
            pac::SYSCFG
                .exticr(line / 4)
                .modify(|w| w.set_exti(line % 4, port));
        }
        pac::EXTI.rtsr(0).modify(|w| w.0 |= MASK);
        interrupt::EXTI15_10.set_priority(Priority::P2);
        // SAFETY: the handler below touches its own registers and atomics only.
        unsafe { interrupt::EXTI15_10.enable() };
        Self {
            _pins: pins,
            lines: 0,
        }
    }

    /// Whether pulses are wanted, from the next [`Indexes::pulses`] on.
    pub fn listen(&mut self, wanted: bool) {
        self.lines = if wanted { MASK } else { 0 };
        cortex_m::interrupt::free(|_| pac::EXTI.imr(0).modify(|w| w.0 &= !MASK));
    }

    /// The last pulse of each wheel. Lines that have had one listen again.
    pub fn pulses(&self) -> [IndexPulse; 4] {
        let deaf = self.lines & !pac::EXTI.imr(0).read().0;
        if deaf != 0 {
            // Edges that came meanwhile are pending.
            pac::EXTI.pr(0).write(|w| w.0 = deaf);
            cortex_m::interrupt::free(|_| pac::EXTI.imr(0).modify(|w| w.0 |= deaf));
        }
        let one = |pulse: &AtomicU32| {
            let [low, high, number, _] = pulse.load(Ordering::Relaxed).to_le_bytes();
            IndexPulse {
                number,
                count: u16::from_le_bytes([low, high]),
            }
        };
        let [a, b, c, d] = &PULSES;
        [one(a), one(b), one(c), one(d)]
    }
}

#[interrupt]
fn EXTI15_10() {
    // The counters first: everything else can wait.
    let counts = [
        pac::TIM2.cnt().read(),
        pac::TIM3.cnt().read().0,
        pac::TIM4.cnt().read().0,
        pac::TIM5.cnt().read(),
    ];
    // A line that is masked may be pending: its counter is not that of its edge.
    let listening = pac::EXTI.imr(0).read().0;
    let pending = pac::EXTI.pr(0).read().0 & listening & MASK;
    pac::EXTI.imr(0).write(|w| w.0 = listening & !pending);
    pac::EXTI.pr(0).write(|w| w.0 = pending);
    for ((line, count), pulse) in LINES.into_iter().zip(counts).zip(&PULSES) {
        if pending >> line & 1 == 1 {
            let number = (pulse.load(Ordering::Relaxed) >> 16).wrapping_add(1) & 0xFF;
            pulse.store(number << 16 | count & 0xFFFF, Ordering::Relaxed);
        }
    }
}
