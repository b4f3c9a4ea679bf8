//! What turns the wheels: four PWM channels with direction pins or with four more, the driver
//! enable, the holding brake.
//!
//! # Theory of operation
//!
//! TIM1 makes the PWM on four channels, 20 kHz unless the configuration wants another frequency.
//! Its master output enable (MOE) is set only while the drivers are enabled, and the emergency-stop
//! input clears it in hardware (break input), with the core halted or not. With MOE clear the
//! outputs are driven to their idle level, low, not left floating (`OSSI`).
//!
//! Driver enable and brake release are outputs of TIM8, channels 2 and 3, complementary outputs
//! alone, forced to a level instead of compared (RM0390 17.4.7, OCxM 100 and 101). TIM8 counts
//! nothing; it is there for its own break input, to which the emergency stop is wired as well: a
//! stop takes drivers and brake back without the processor.
//!
//! Where the board has two PWMs a wheel, TIM8 makes the second as TIM1 makes the first, and its
//! break input cuts it: both inputs of every bridge are low then, which drives none. A channel has
//! one reference for both of its outputs, so driver enable and brake release are outputs of the
//! port, and go off in the control tick.
//!
//! What a duty means at these pins depends on the kind of bridges, which [`Pattern`] resolves when
//! the robot is configured. Where PWM low is not the safe state of a bridge (IN/IN while reversing,
//! locked antiphase), the driver enable is: it is the first to go off and the last to come on, and
//! the break input cuts it in hardware. With the drivers disabled all directions are low as well.
//!
//! # Interface
//!
//! The control task calls [`Outputs::set`] in each tick, and [`Outputs::configure`] with the
//! drivers disabled; a failing program calls [`cut`].
//!
//! # Limits
//!
//! Compare values are not preloaded: they act at once, so that the moment of a change is the moment
//! of the tick and not the end of a PWM period up to 50 us later. A value written in the middle of
//! a period can shorten or lengthen that one pulse; PWM mode 1 compares levels, so no pulse can be
//! missed. With two PWMs a wheel TIM8 is some tens of nanoseconds behind TIM1; one input of a
//! bridge stands at a time, so this is no voltage.

#![expect(unsafe_code, reason = "an order that only assembly asks for")]

use control::output_stage::{OutputStage, Pattern, steps};
use control::quantity::Drive;
use embassy_stm32::pac;
use embassy_stm32::pac::gpio::regs::Bsrr;
use embassy_stm32::pac::timer::TimAdv;
use embassy_stm32::pac::timer::vals::{Bkp, Lock, Ocm, Ossi, Ossr};

use super::pin::{Pin, Pull, Role, Speed};
use crate::board::WIRING;
use crate::board::family::drives;

/// Frequency of the PWM until there is a configuration, the same as its default.
const PWM_HZ: u32 = 20_000;

/// Timer clocks in one PWM period at a frequency in Hz. The slowest is what the counter allows:
/// 2.75 kHz at 180 MHz.
const fn period(hz: u32) -> u16 {
    let clocks = WIRING.clocks.apb2_timers_hz() / if hz == 0 { 1 } else { hz };
    if clocks > 0xFFFF {
        0xFFFF
    } else {
        clocks as u16
    }
}

/// Data sheet DS10693 rev 10, table 11; DS8626, table 9: TIM1 is alternate function 1, TIM8
/// is 3.
const TIM1_AF: u8 = 1;
const TIM8_AF: u8 = 3;

/// Four motor drivers and the holding brake. Wheels in the order front left, front right, rear
/// left, rear right.
pub struct Outputs {
    pattern: Pattern,
    enabled: bool,
}

/// The kinds of drives that the board has, as [`Hardware`](robot::Hardware) has them. Only
/// where the emergency stop cuts the driver enable in hardware is that enable a safe state.
pub const STAGES: u8 = if drives::ARE_WIRED {
    robot::Hardware::SMART
} else if TWO_PWMS {
    robot::Hardware::TWO_PWMS
} else if WIRING.gate_stop.is_some() {
    robot::Hardware::SWITCHED
} else {
    OutputStage::PwmDirection.bit()
};

/// Whether TIM8 makes a second PWM for each wheel.
const TWO_PWMS: bool = WIRING.second_pwm.is_some();
const _: () = assert!(
    !TWO_PWMS || WIRING.gate_stop.is_some(),
    "nothing cuts the second PWM in hardware"
);

/// Timers that make PWM, and what CCER enables of them.
const PWM_TIMERS: &[(TimAdv, u32)] = if TWO_PWMS {
    &[(pac::TIM1, enabled(true)), (pac::TIM8, enabled(false))]
} else {
    &[(pac::TIM1, enabled(true))]
};

impl Outputs {
    /// Takes the outputs, which have been low since the first instructions; drivers disabled, brake
    /// engaged.
    pub fn new() -> Self {
        pac::RCC.apb2enr().modify(|w| {
            w.set_tim1en(true);
            w.set_tim8en(true);
        });
        WIRING
            .stop
            .become_a(Role::PeripheralInput(TIM1_AF, Pull::Up));
        if let Some(stop) = WIRING.gate_stop {
            stop.become_a(Role::PeripheralInput(TIM8_AF, Pull::Up));
        }
        for (timer, channels) in PWM_TIMERS {
            for half in 0..2 {
                timer.ccmr_output(half).write(|w| {
                    w.set_ocm(0, Ocm::PWM_MODE1);
                    w.set_ocm(1, Ocm::PWM_MODE1);
                });
            }
            timer.ccer().write(|w| w.0 = *channels);
            // The modes of the channels stay as they are, so they are locked too.
            lock(*timer, Lock::LEVEL3);
        }
        for (timer, _) in PWM_TIMERS {
            timer.cr1().write(|w| w.set_cen(true));
        }

        force(false, false);
        if !TWO_PWMS {
            pac::TIM8.ccer().write(|w| {
                w.set_ccne(1, true);
                w.set_ccne(2, true);
            });
            lock(pac::TIM8, Lock::LEVEL2);
            for gate in [WIRING.driver_enable, WIRING.brake_release] {
                gate.become_a(Role::PeripheralOutput(TIM8_AF, Pull::None, Speed::Low));
            }
        }
        let pwm = |function| Role::PeripheralOutput(function, Pull::Down, Speed::Medium);
        for pin in WIRING.pwm.into_iter().flatten() {
            pin.become_a(pwm(TIM1_AF));
        }
        for pin in WIRING.second_pwm.into_iter().flatten() {
            pin.become_a(pwm(TIM8_AF));
        }
        Self {
            pattern: configure(OutputStage::PwmDirection, PWM_HZ),
            enabled: false,
        }
    }

    /// Sets the kind of the bridges and the frequency of their PWM, Hz; with the drivers disabled.
    pub fn configure(&mut self, stage: OutputStage, hz: u32) {
        self.pattern = configure(stage, hz);
    }

    /// Whether the emergency stop is pressed, its wire is broken, or it has cut the outputs since
    /// they were last enabled.
    pub fn emergency_stop(&self) -> bool {
        let cut = || !pac::TIM1.bdtr().read().moe() || !pac::TIM8.bdtr().read().moe();
        WIRING.stop.is_high()
            || WIRING.gate_stop.is_some_and(Pin::is_high)
            || (self.enabled && cut())
    }

    /// Sets the outputs.
    ///
    /// `duty` per wheel is -1..=1, positive rolls the base forward. After the drivers were
    /// disabled, or cut by the break input, they come back only when `drivers_enabled` goes from
    /// `false` to `true`.
    pub fn set(&mut self, duty: [Drive; 4], drivers_enabled: bool, brake_released: bool) {
        // A bench image may be halted in any state of its outputs.
        let drivers_enabled = drivers_enabled && !cfg!(feature = "bench");
        if !drivers_enabled {
            pac::TIM8.bdtr().modify(|w| w.set_moe(false));
            pac::TIM1.bdtr().modify(|w| w.set_moe(false));
        }
        let pattern = &self.pattern;
        // Unrolled here and below: 39 instructions fewer than loops. Worked out before anything is
        // written, so that duties and directions change together.
        let [a, b, c, d] = duty;
        let duty = if drivers_enabled {
            [steps(a), steps(b), steps(c), steps(d)]
        } else {
            [0; 4]
        };
        let [a, b, c, d] = duty;
        if TWO_PWMS {
            write_pair(0, pattern.pair(a));
            write_pair(1, pattern.pair(b));
            write_pair(2, pattern.pair(c));
            write_pair(3, pattern.pair(d));
            self.enable(drivers_enabled, brake_released);
            return;
        }
        let high = [
            pattern.high(a),
            pattern.high(b),
            pattern.high(c),
            pattern.high(d),
        ];
        let back = [
            Pattern::back(a),
            Pattern::back(b),
            Pattern::back(c),
            Pattern::back(d),
        ];
        work_out(high);
        let set = |wheel: usize| pac::TIM1.ccr(wheel).write(|w| w.0 = high[wheel]);
        set(0);
        set(1);
        set(2);
        set(3);
        if drivers_enabled {
            if let Some(direction) = WIRING.direction {
                let set = |wheel: usize, pin: Pin| pin.level(true) << back[wheel];
                write_pins(direction, set, |word| pattern.direction(word));
            }
            if let Some(inverse) = WIRING.inverse {
                let set = |wheel: usize, pin: Pin| pin.level(false) >> back[wheel];
                write_pins(inverse, set, |word| pattern.direction(word));
            }
        } else {
            directions_low();
        }
        self.enable(drivers_enabled, brake_released);
    }

    /// Sets driver enable and brake release; switches the outputs on where the drivers were off.
    #[inline(always)]
    fn enable(&mut self, drivers_enabled: bool, brake_released: bool) {
        force(drivers_enabled, drivers_enabled && brake_released);
        if drivers_enabled && !self.enabled {
            // The enable last: until the PWM runs its pins are low, which drives some bridges.
            pac::TIM1.bdtr().modify(|w| w.set_moe(true));
            pac::TIM8.bdtr().modify(|w| w.set_moe(true));
        }
        self.enabled = drivers_enabled;
    }
}

#[cfg(feature = "self-test")]
impl Outputs {
    /// Sets the outputs of a bare board, for the self-test image: a duty, or driver enable and
    /// brake release, never both; if both are asked for, all are off. Directions are as for
    /// [`Outputs::set`]. After the break input has cut them, this switches them on again.
    pub fn test(&mut self, duty: [f32; 4], drivers_enabled: bool, brake_released: bool) {
        let driven = duty.iter().any(|duty| *duty != 0.0);
        cut();
        if driven && drivers_enabled {
            return;
        }
        for (wheel, duty) in duty.into_iter().enumerate() {
            let high = self.pattern.high(steps(Drive::new(duty)));
            pac::TIM1.ccr(wheel).write(|w| w.0 = high);
            if driven {
                if let Some(direction) = WIRING.direction {
                    direction[wheel].set(duty > 0.0);
                }
                if let Some(inverse) = WIRING.inverse {
                    inverse[wheel].set(duty < 0.0);
                }
            }
        }
        force(drivers_enabled, brake_released);
        pac::TIM1.bdtr().modify(|w| w.set_moe(driven));
        let gates = drivers_enabled || brake_released;
        pac::TIM8.bdtr().modify(|w| w.set_moe(gates));
    }
}

/// What CCER enables of TIM1, and of TIM8: the main output of a channel, or the complementary one
/// alone, which is the same signal then (RM0390 17.4.9, RM0008 14.4.9: output control bits).
const fn enabled(is_of_tim1: bool) -> u32 {
    let (mut bits, mut at) = (0, 0);
    while at < 8 {
        let channel = WIRING.channels[at / 2][at % 2];
        if channel.is_of_tim1 == is_of_tim1 {
            bits |= 1 << (4 * channel.number + if channel.complementary { 2 } else { 0 });
        }
        at += 1;
    }
    bits
}

/// Sets the period of the PWM; returns the pattern that fits it. Not inlined: it is called twice.
#[inline(never)]
fn configure(stage: OutputStage, hz: u32) -> Pattern {
    let period = period(hz);
    for (timer, _) in PWM_TIMERS {
        timer.arr().write(|w| w.set_arr(period.wrapping_sub(1)));
    }
    // A counter beyond the new end would run on to its largest value. One right after the other, so
    // that the counters stay together.
    for (timer, _) in PWM_TIMERS {
        timer.egr().write(|w| w.set_ug(true));
    }
    Pattern::new(stage, period)
}

/// Has four numbers worked out here, before what is written next. Left alone, the compiler works
/// each out just before its store, and duties and directions are 0.6 us apart
/// (`direction_and_duty_change_together`).
#[inline(always)]
fn work_out([a, b, c, d]: [u32; 4]) {
    // SAFETY: no instruction at all.
    unsafe {
        core::arch::asm!(
            "/* {} {} {} {} */",
            in(reg) a,
            in(reg) b,
            in(reg) c,
            in(reg) d,
            options(nomem, nostack, preserves_flags)
        );
    }
}

/// Writes four pins with the words that `level` gives, with one store for all that are of one port,
/// by way of `turn`. Unrolled, so that the compiler knows which these are.
#[inline(always)]
fn write_pins(pins: [Pin; 4], level: impl Fn(usize, Pin) -> u32, turn: impl Fn(u32) -> u32) {
    let [a, b, c, d] = pins;
    let levels = [level(0, a), level(1, b), level(2, c), level(3, d)];
    let write = |first: Pin| {
        let of = |pin: Pin, level| if pin.port == first.port { level } else { 0 };
        let all = of(a, levels[0]) | of(b, levels[1]) | of(c, levels[2]) | of(d, levels[3]);
        first.registers().bsrr().write_value(Bsrr(turn(all)));
    };
    write(a);
    if b.port != a.port {
        write(b);
    }
    if c.port != a.port && c.port != b.port {
        write(c);
    }
    if d.port != a.port && d.port != b.port && d.port != c.port {
        write(d);
    }
}

/// Writes for how many clocks the two PWMs of a wheel are high.
#[inline(always)]
fn write_pair(wheel: usize, [first, second]: [u32; 2]) {
    let [one, other] = WIRING.channels[wheel];
    one.timer().ccr(one.number).write(|w| w.0 = first);
    other.timer().ccr(other.number).write(|w| w.0 = second);
}

/// Lowers the direction pins and their inverses.
#[inline(always)]
fn directions_low() {
    let low = |_, pin: Pin| pin.level(false);
    if let Some(direction) = WIRING.direction {
        write_pins(direction, low, |word| word);
    }
    if let Some(inverse) = WIRING.inverse {
        write_pins(inverse, low, |word| word);
    }
}

/// Sets the outputs' safe state and the break input, active high, and locks them until the next
/// reset: a runaway program cannot disable the emergency stop.
///
/// RM0390 17.4.18: level 2 locks break enable, polarities and idle states, level 3 the modes of the
/// channels too; MOE is never locked. The level is settled by the first write of the register, so
/// this is the first.
fn lock(timer: TimAdv, level: Lock) {
    timer.bdtr().write(|w| {
        w.set_ossi(Ossi::IDLE_LEVEL);
        w.set_ossr(Ossr::IDLE_LEVEL);
        w.set_bkp(0, Bkp::ACTIVE_HIGH);
        w.set_bke(0, true);
        w.set_lock(level);
    });
}

/// Sets the levels of driver enable and brake release, while TIM8's outputs are on where they are
/// TIM8's.
fn force(drivers_enabled: bool, brake_released: bool) {
    if TWO_PWMS {
        WIRING.driver_enable.set(drivers_enabled);
        WIRING.brake_release.set(brake_released);
        return;
    }
    let level = |high| {
        if high {
            Ocm::FORCE_ACTIVE
        } else {
            Ocm::FORCE_INACTIVE
        }
    };
    pac::TIM8
        .ccmr_output(0)
        .write(|w| w.set_ocm(1, level(drivers_enabled)));
    pac::TIM8
        .ccmr_output(1)
        .write(|w| w.set_ocm(0, level(brake_released)));
}

/// Cuts all outputs, from any context: drivers off, brake engaged, PWM off, directions low, smart
/// drives without current.
#[inline(never)]
pub fn cut() {
    // Before start-up gives them to TIM8, and with two PWMs always, the pins are outputs of the
    // port, or still inputs, which float as in reset.
    WIRING.driver_enable.set(false);
    WIRING.brake_release.set(false);
    pac::TIM8.bdtr().modify(|w| w.set_moe(false));
    pac::TIM1.bdtr().modify(|w| w.set_moe(false));
    directions_low();
    drives::rest();
}
