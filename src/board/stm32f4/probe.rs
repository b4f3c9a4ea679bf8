//! Measurements of a bare board through its own pins, for the self-test image.
//!
//! Pins are found by number, and time is the core's cycle counter: a loop reads an input register
//! with interrupts masked, once every 20 to 100 clocks, so a time is known to half a microsecond.
//! No timer is needed for that, and any wire can be measured by any pin that is free.
//!
//! [`become_output`] refuses driver enable and brake release, which only [`Outputs::test`] drives,
//! and the pins by which the chip is talked to.
//!
//! [`Outputs::test`]: crate::board::stm32::outputs::Outputs::test

#![expect(unsafe_code, reason = "the cycle counter is a peripheral of the core")]

use cortex_m::peripheral::DWT;
use embassy_stm32::pac;
use embassy_stm32::pac::gpio::regs::Bsrr;
use protocol::self_test::{NEVER, WATCHED};

use crate::board::WIRING;
use crate::board::stm32::pin::{Pin, Pull, Role};

/// Periods that a wave is measured over, at most.
const PERIODS: u8 = 8;
/// Longest measurement of a wave, us.
const WAVE_US: u32 = 3_000;
/// How long pins are watched after a stop, us.
const STOP_US: u32 = 2_000;
/// How long a frame is waited for, us.
const FRAME_US: u32 = 15_000;
/// Bits without an edge after which a frame is over: more than five are only after its end.
const IDLE_BITS: u32 = 8;
/// Bits that are measured: start, identifier, control and eight bytes of data are 83.
const BITS: u32 = 80;

/// A wave at a pin; durations in clocks of the core.
#[derive(Clone, Copy, Default)]
pub struct Wave {
    /// All periods together.
    pub total: u32,
    /// Their high parts; without a period 1 for a high level.
    pub high: u32,
    /// How many periods.
    pub periods: u8,
}

/// Starts the cycle counter.
pub fn start() {
    // SAFETY: called once, by the first task; of what is taken only DCB and DWT are used, which
    // nothing else in this image uses.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();
}

/// Does something, and counts the clocks of the core meanwhile.
pub fn clocks<T>(what: impl FnOnce() -> T) -> (u32, T) {
    let from = DWT::cycle_count();
    let done = what();
    (DWT::cycle_count().wrapping_sub(from), done)
}

/// Clocks of the core in a second.
pub const fn core_hz() -> u32 {
    WIRING.clocks.cycles_per_us() * 1_000_000
}

/// The pin of this number, of ports A to D.
pub const fn by_number(number: u8) -> Option<Pin> {
    let (port, bit) = (number >> 4, number & 15);
    if port < 4 {
        Some(Pin { port, bit })
    } else {
        None
    }
}

const fn is(one: Pin, other: Pin) -> bool {
    one.port == other.port && one.bit == other.bit
}

/// Whether the program needs this pin for itself: CAN, cable, debugger.
fn is_taken(pin: Pin) -> bool {
    // RM0390 7.3.1: PA13 and PA14 are the debugger's.
    let debugger = pin.port == 0 && matches!(pin.bit, 13 | 14);
    let can = is(pin, WIRING.can.receive) || is(pin, WIRING.can.transmit);
    let cable = WIRING
        .cable
        .is_some_and(|cable| is(pin, cable.receive) || is(pin, cable.transmit));
    debugger || can || cable
}

/// Whether a power stage may listen to this pin, driver enable and brake release left out.
pub fn is_of_the_power_stage(pin: Pin) -> bool {
    let all = [WIRING.pwm, WIRING.direction, WIRING.inverse].into_iter();
    all.flatten().flatten().any(|other| is(pin, other))
}

/// Whether it is driver enable or brake release.
fn is_a_gate(pin: Pin) -> bool {
    is(pin, WIRING.driver_enable) || is(pin, WIRING.brake_release)
}

/// Makes a pin an input; `None` for one that the program needs.
pub fn become_input(pin: Pin, pull: Pull) -> Option<()> {
    if is_taken(pin) || is_a_gate(pin) {
        return None;
    }
    pin.become_a(Role::Input(pull));
    Some(())
}

/// Makes a pin an output of this level; `None` for one that must not be.
pub fn become_output(pin: Pin, high: bool) -> Option<()> {
    if is_taken(pin) || is_a_gate(pin) {
        return None;
    }
    pin.set(high);
    pin.become_a(Role::Output);
    Some(())
}

/// Levels of a port.
pub fn levels(port: u8) -> u16 {
    let any = Pin { port, bit: 0 };
    any.registers().idr().read().0 as u16
}

/// Waits until a pin has this level; returns the time of the counter then.
fn wait(pin: Pin, high: bool, from: u32) -> Option<u32> {
    let limit = WAVE_US * WIRING.clocks.cycles_per_us();
    loop {
        let level = pin.is_high();
        let now = DWT::cycle_count();
        if level == high {
            return Some(now);
        }
        if now.wrapping_sub(from) > limit {
            return None;
        }
    }
}

/// Measures the wave at a pin.
#[inline(never)]
pub fn wave(pin: Pin) -> Wave {
    cortex_m::interrupt::free(|_| measured(pin).unwrap_or_else(|| constant(pin)))
}

fn constant(pin: Pin) -> Wave {
    Wave {
        high: u32::from(pin.is_high()),
        ..Wave::default()
    }
}

fn measured(pin: Pin) -> Option<Wave> {
    let begin = DWT::cycle_count();
    wait(pin, false, begin)?;
    let first = wait(pin, true, begin)?;
    let mut wave = Wave::default();
    let mut rise = first;
    while wave.periods < PERIODS {
        let (Some(fall), Some(next)) = (wait(pin, false, begin), wait(pin, true, begin)) else {
            break;
        };
        wave.high += fall.wrapping_sub(rise);
        wave.total = next.wrapping_sub(first);
        wave.periods += 1;
        rise = next;
    }
    (wave.periods > 0).then_some(wave)
}

/// Raises `source`, and returns after how many clocks each of the other pins was low.
#[inline(never)]
pub fn stop(source: Pin, watched: &[Option<Pin>; WATCHED]) -> [u32; WATCHED] {
    let mut low = [NEVER; WATCHED];
    let limit = STOP_US * WIRING.clocks.cycles_per_us();
    cortex_m::interrupt::free(|_| {
        let begin = DWT::cycle_count();
        source.set(true);
        loop {
            for (pin, low) in watched.iter().zip(&mut low) {
                let now = DWT::cycle_count().wrapping_sub(begin);
                if *low == NEVER && pin.is_some_and(|pin| !pin.is_high()) {
                    *low = now;
                }
            }
            let all = watched.iter().zip(&low);
            let mut left = all.filter(|(pin, low)| pin.is_some() && **low == NEVER);
            if left.next().is_none() || DWT::cycle_count().wrapping_sub(begin) > limit {
                break;
            }
        }
        source.set(false);
    });
    low
}

/// The signals of an encoder that is to be simulated.
#[derive(Clone, Copy)]
pub struct Signals {
    /// A and B.
    pub pins: [Pin; 2],
    /// Time between two edges, us.
    pub step_us: u8,
    /// Each edge lies in a pulse at the other pin, as short as can be.
    pub noisy: bool,
}

/// Makes quadrature edges, A first when `forward`. Both pins are low before and afterwards if their
/// number is a multiple of four.
#[inline(never)]
pub fn turn(signals: &Signals, edges: u16, forward: bool) {
    // Levels of both after each edge; the first of them is the state before.
    const STATES: [[bool; 2]; 4] = [[false, false], [true, false], [true, true], [false, true]];
    let [a, b] = signals.pins;
    let pins = if forward { [a, b] } else { [b, a] };
    let pause = u32::from(signals.step_us) * WIRING.clocks.cycles_per_us();
    for edge in 1..=usize::from(edges) {
        let levels = STATES[edge % 4];
        let (moves, stands) = ((edge + 1) % 2, edge % 2);
        let edge = pins[moves].level(levels[moves]);
        if signals.noisy {
            let stands = (pins[stands], levels[stands]);
            edge_in_a_pulse((pins[moves], edge), stands);
        } else {
            pins[moves].registers().bsrr().write_value(Bsrr(edge));
        }
        cortex_m::asm::delay(pause.max(1));
    }
}

/// Makes an edge while the other pin has the wrong level, for as short a time as two stores take.
/// Both edges of a pulse alone would be counted up and down again, and not be noticed.
#[inline(always)]
fn edge_in_a_pulse((moves, edge): (Pin, u32), (stands, level): (Pin, bool)) {
    let (there, back) = (Bsrr(stands.level(!level)), Bsrr(stands.level(level)));
    let (moving, standing) = (moves.registers().bsrr(), stands.registers().bsrr());
    standing.write_value(there);
    moving.write_value(Bsrr(edge));
    standing.write_value(back);
}

/// The edges of a frame at the input of CAN.
#[derive(Clone, Copy, Default)]
pub struct Bits {
    /// Clocks from the first edge to the last.
    pub total: u32,
    /// Largest distance of an edge from a whole number of bits after the first, clocks.
    pub off: u32,
    /// Bits between the first edge and the last.
    pub bits: u8,
    /// Edges.
    pub edges: u8,
}

/// Looks at the next frame on the bus, up to the bits of its data: what follows them, another node
/// acknowledges in its own time. Without a frame in time nothing is returned.
#[inline(never)]
pub fn bits() -> Bits {
    let pin = WIRING.can.receive;
    let bit = WIRING.clocks.cycles_per_us();
    let mut bits = Bits::default();
    cortex_m::interrupt::free(|_| {
        let begin = DWT::cycle_count();
        // A frame that has begun already shows at its next edge.
        let mut level = pin.is_high();
        let (mut first, mut number) = (0, 0);
        let mut last = begin;
        loop {
            let (high, now) = (pin.is_high(), DWT::cycle_count());
            if high != level {
                if bits.edges == 0 {
                    first = now;
                }
                if bits.edges > 0 {
                    // Counted from edge to edge, so that bits of another length add up.
                    number += (now.wrapping_sub(last) + bit / 2) / bit;
                }
                (level, last) = (high, now);
                bits.total = now.wrapping_sub(first);
                bits.off = bits.off.max(bits.total.abs_diff(number * bit));
                bits.bits = number as u8;
                bits.edges += 1;
            }
            let limit = if bits.edges == 0 { FRAME_US } else { IDLE_BITS };
            let is_over = bits.edges > 0 && now.wrapping_sub(first) > BITS * bit;
            if is_over || now.wrapping_sub(last) > limit * bit {
                break;
            }
        }
    });
    bits
}

/// Whether over-drive and the voltage's scale are as the clock needs them (RM0390 5.4.2): ready,
/// switched, scale, from bit 0.
pub fn over_drive() -> u8 {
    let status = pac::PWR.csr1().read();
    u8::from(status.odrdy()) | u8::from(status.odswrdy()) << 1 | u8::from(status.vosrdy()) << 2
}

/// Stops the program for good; the watchdog resets the chip.
pub fn halt() -> ! {
    cortex_m::interrupt::disable();
    loop {
        cortex_m::asm::nop();
    }
}
