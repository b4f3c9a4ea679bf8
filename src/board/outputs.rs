//! What turns the wheels: four PWM channels with direction pins, the driver enable, the holding
//! brake.
//!
//! TIM1 makes 20 kHz on four channels. Its master output enable (MOE) is set only while the drivers
//! are enabled, and the emergency-stop input clears it in hardware (break input), with the core
//! halted or not. With MOE clear the outputs are driven to their idle level, low, not left floating
//! (`OSSI`).
//!
//! Driver enable and brake release are outputs of TIM8, channels 2 and 3, complementary outputs
//! alone, forced to a level instead of compared (RM0390 17.4.7, OCxM 100 and 101). TIM8 counts
//! nothing; it is there for its own break input, to which the emergency stop is wired as well: a
//! stop takes drivers and brake back without the processor.
//!
//! Compare values are not preloaded: they act at once, so that the moment of a change is the moment
//! of the tick and not the end of a PWM period up to 50 us later. A value written in the middle of
//! a period can shorten or lengthen that one pulse; PWM mode 1 compares levels, so no pulse can be
//! missed.

use embassy_stm32::Peri;
use embassy_stm32::gpio::{AfType, Flex, Output, OutputType, Pull, Speed};
use embassy_stm32::pac;
use embassy_stm32::pac::gpio::regs::Bsrr;
use embassy_stm32::pac::timer::TimAdv;
use embassy_stm32::pac::timer::vals::{Bkp, Lock, Ocm, Ossi, Ossr};
use embassy_stm32::peripherals::{TIM1, TIM8};
use embassy_stm32::rcc;
use embassy_stm32::time::Hertz;
use embassy_stm32::timer::Channel;
use embassy_stm32::timer::low_level::{CountingMode, OutputCompareMode, RoundTo, Timer};

use super::nucleo_f446re::{BRAKE_RELEASE_PB, DRIVER_ENABLE_PB, FIRST_DIRECTION_PC};

const PWM_FREQUENCY: Hertz = Hertz(20_000);

const CHANNELS: [Channel; 4] = [Channel::Ch1, Channel::Ch2, Channel::Ch3, Channel::Ch4];

/// Four motor drivers and the holding brake. Wheels in the order front left, front right, rear
/// left, rear right.
pub struct Outputs {
    timer: Timer<'static, TIM1>,
    /// Timer clocks in one PWM period.
    period: f32,
    _pwm: [Flex<'static>; 4],
    /// Break inputs of TIM1 and TIM8.
    stop: [Flex<'static>; 2],
    _direction: [Output<'static>; 4],
    /// Driver enable and brake release.
    _gate: [Flex<'static>; 2],
    enabled: bool,
}

/// The pins of [`Outputs`].
pub struct Pins {
    /// TIM1 channels 1 to 4, alternate function 1.
    pub pwm: [Flex<'static>; 4],
    /// Break inputs: TIM1 on alternate function 1, TIM8 on 3.
    pub stop: [Flex<'static>; 2],
    /// Directions of the wheels.
    pub direction: [Output<'static>; 4],
    /// Driver enable and brake release: TIM8 CH2N and CH3N, alternate function 3; driven low until
    /// now.
    pub gate: [Flex<'static>; 2],
}

impl Outputs {
    /// Takes the outputs; drivers disabled, brake engaged.
    pub fn new(timer: Peri<'static, TIM1>, _gate_timer: Peri<'static, TIM8>, pins: Pins) -> Self {
        // Data sheet DS10693 rev 10, table 11: TIM1 is alternate function 1 on PA8..PA11 and PB12,
        // TIM8 is 3 on PA6, PB0 and PB1.
        const TIM1_AF: u8 = 1;
        const TIM8_AF: u8 = 3;
        let Pins {
            pwm,
            stop: [mut stop, mut gate_stop],
            direction,
            gate,
        } = pins;
        let timer = Timer::new(timer);
        timer.set_counting_mode(CountingMode::EdgeAlignedUp);
        timer.set_frequency(PWM_FREQUENCY, RoundTo::Slower);
        for channel in CHANNELS {
            timer.set_output_compare_mode(channel, OutputCompareMode::PwmMode1);
            timer.set_output_compare_preload(channel, false);
            timer.set_compare_value(channel, 0);
            timer.set_ois(channel, false);
            timer.enable_channel(channel, true);
        }
        timer.generate_update_event();
        timer.start();
        stop.set_as_af_unchecked(TIM1_AF, AfType::input(Pull::Up));
        // The modes of the channels stay as they are, so they are locked too.
        lock(pac::TIM1, Lock::LEVEL3);

        rcc::enable_and_reset::<TIM8>();
        gate_stop.set_as_af_unchecked(TIM8_AF, AfType::input(Pull::Up));
        force(false, false);
        pac::TIM8.ccer().write(|w| {
            w.set_ccne(1, true);
            w.set_ccne(2, true);
        });
        lock(pac::TIM8, Lock::LEVEL2);
        let gate = gate.map(|mut pin| {
            pin.set_as_af_unchecked(TIM8_AF, AfType::output(OutputType::PushPull, Speed::Low));
            pin
        });
        let pwm = pwm.map(|mut pin| {
            pin.set_as_af_unchecked(
                TIM1_AF,
                AfType::output_pull(OutputType::PushPull, Speed::Medium, Pull::Down),
            );
            pin
        });
        let period = f32::from(timer.get_max_compare_value()) + 1.0;
        Self {
            timer,
            period,
            _pwm: pwm,
            stop: [stop, gate_stop],
            _direction: direction,
            _gate: gate,
            enabled: false,
        }
    }

    /// Whether the emergency stop is pressed, its wire is broken, or it has cut the outputs since
    /// they were last enabled.
    pub fn emergency_stop(&self) -> bool {
        let cut = || !self.timer.get_moe() || !pac::TIM8.bdtr().read().moe();
        let [stop, gate_stop] = &self.stop;
        stop.is_high() || gate_stop.is_high() || (self.enabled && cut())
    }

    /// Sets the outputs.
    ///
    /// `duty` per wheel is -1..=1, positive rolls the base forward. After the drivers were
    /// disabled, or cut by the break input, they come back only when `drivers_enabled` goes from
    /// `false` to `true`.
    pub fn set(&mut self, duty: [f32; 4], drivers_enabled: bool, brake_released: bool) {
        // A bench image is made to be halted with whatever its outputs are.
        let drivers_enabled = drivers_enabled && !cfg!(feature = "bench");
        if !drivers_enabled {
            pac::TIM8.bdtr().modify(|w| w.set_moe(false));
            self.timer.set_moe(false);
        }
        let duty = if drivers_enabled { duty } else { [0.0; 4] };
        let set = |wheel: usize, duty: f32| {
            pac::TIM1
                .ccr(wheel)
                .write(|w| w.set_ccr(compare(duty, self.period)));
            // The lower half of the register sets a pin, the upper half resets it.
            let forward = if duty >= 0.0 { 1_u32 } else { 1 << 16 };
            forward << (FIRST_DIRECTION_PC + wheel)
        };
        // Written out, not looped over: 39 instructions fewer.
        let [a, b, c, d] = duty;
        let directions = set(0, a) | set(1, b) | set(2, c) | set(3, d);
        pac::GPIOC.bsrr().write_value(Bsrr(directions));
        force(drivers_enabled, drivers_enabled && brake_released);
        if drivers_enabled && !self.enabled {
            pac::TIM8.bdtr().modify(|w| w.set_moe(true));
            self.timer.set_moe(true);
        }
        self.enabled = drivers_enabled;
    }
}

/// Sets the outputs' safe state and the break input, active high, and locks them until the next
/// reset: no program that has gone astray takes the emergency stop away.
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

/// What TIM8 puts on driver enable and brake release while its outputs are on.
fn force(drivers_enabled: bool, brake_released: bool) {
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

/// Timer clocks for which the output is high; `period` clocks are always high.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the value is between 0 and the period, which fits; NaN becomes 0"
)]
fn compare(duty: f32, period: f32) -> u16 {
    let share = duty.abs();
    // Not `min`: that is a function of the library, and makes a whole of what is no number.
    let share = if share > 1.0 { 1.0 } else { share };
    // By way of 32 bits, which the core converts to in one instruction.
    ((share * period + 0.5) as u32).min(0xFFFF) as u16
}

/// Cuts everything that moves, from any context: drivers off, brake engaged, PWM off.
pub fn cut() {
    // While start-up has not come so far the pins are outputs of the port, or still inputs; those
    // float as in reset.
    pac::GPIOB.bsrr().write(|w| {
        w.set_br(DRIVER_ENABLE_PB, true);
        w.set_br(BRAKE_RELEASE_PB, true);
    });
    pac::TIM8.bdtr().modify(|w| w.set_moe(false));
    pac::TIM1.bdtr().modify(|w| w.set_moe(false));
}
