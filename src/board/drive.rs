//! What turns the wheels: four PWM channels with direction pins, the driver enable, the holding brake.
//!
//! TIM1 makes 20 kHz on four channels. Its master output enable (MOE) is set only while the drivers are enabled,
//! and the emergency-stop input clears it in hardware (break input), with the core halted or not. With MOE clear
//! the outputs are driven to their idle level, low, not left floating (`OSSI`).
//!
//! Compare values are not preloaded: they act at once, so that the moment of a change is the moment of the tick
//! and not the end of a PWM period up to 50 us later. A value written in the middle of a period can shorten or
//! lengthen that one pulse; PWM mode 1 compares levels, so no pulse can be missed.

use embassy_stm32::Peri;
use embassy_stm32::gpio::{AfType, Flex, Level, Output, OutputType, Pull, Speed};
use embassy_stm32::pac::timer::vals::{Bkp, Ossi, Ossr};
use embassy_stm32::peripherals::TIM1;
use embassy_stm32::time::Hertz;
use embassy_stm32::timer::Channel;
use embassy_stm32::timer::low_level::{CountingMode, OutputCompareMode, RoundTo, Timer};

const PWM_FREQUENCY: Hertz = Hertz(20_000);

const CHANNELS: [Channel; 4] = [Channel::Ch1, Channel::Ch2, Channel::Ch3, Channel::Ch4];

/// Four motor drivers and the holding brake. Wheels in the order front left, front right, rear left, rear right.
pub struct Drive {
    timer: Timer<'static, TIM1>,
    /// Timer clocks in one PWM period.
    period: f32,
    _pwm: [Flex<'static>; 4],
    stop: Flex<'static>,
    direction: [Output<'static>; 4],
    driver_enable: Output<'static>,
    brake_release: Output<'static>,
    enabled: bool,
}

impl Drive {
    /// Takes the outputs; drivers disabled, brake engaged.
    ///
    /// `pwm` are the pins of channels 1 to 4 and `stop` the break input, all on alternate function 1 (TIM1).
    pub fn new(
        timer: Peri<'static, TIM1>,
        pwm: [Flex<'static>; 4],
        stop: Flex<'static>,
        direction: [Output<'static>; 4],
        driver_enable: Output<'static>,
        brake_release: Output<'static>,
    ) -> Self {
        // Data sheet DS10693 rev 10, table 11: TIM1 is alternate function 1 on PA8..PA11 and PB12.
        const TIM1_AF: u8 = 1;
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
        timer.set_ossi(Ossi::IDLE_LEVEL);
        timer.set_ossr(Ossr::IDLE_LEVEL);
        timer.set_break_polarity(Bkp::ACTIVE_HIGH);
        timer.set_automatic_output_enable(false);
        timer.generate_update_event();
        timer.start();

        let mut stop = stop;
        stop.set_as_af_unchecked(TIM1_AF, AfType::input(Pull::Up));
        timer.set_break_enable(true);
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
            stop,
            direction,
            driver_enable,
            brake_release,
            enabled: false,
        }
    }

    /// Whether the emergency stop is pressed, its wire is broken, or it has cut the outputs since they were
    /// last enabled.
    pub fn emergency_stop(&self) -> bool {
        self.stop.is_high() || (self.enabled && !self.timer.get_moe())
    }

    /// Sets the outputs.
    ///
    /// `duty` per wheel is -1..=1, positive rolls the base forward. After the drivers were disabled, or cut by the
    /// break input, they come back only when `drivers_enabled` goes from `false` to `true`.
    pub fn set(&mut self, duty: [f32; 4], drivers_enabled: bool, brake_released: bool) {
        if !drivers_enabled {
            self.timer.set_moe(false);
            self.driver_enable.set_low();
        }
        for ((channel, direction), duty) in CHANNELS.into_iter().zip(&mut self.direction).zip(duty)
        {
            let duty = if drivers_enabled { duty } else { 0.0 };
            direction.set_level(Level::from(duty >= 0.0));
            self.timer
                .set_compare_value(channel, compare(duty, self.period));
        }
        if drivers_enabled && !self.enabled {
            self.driver_enable.set_high();
            self.timer.set_moe(true);
        }
        self.enabled = drivers_enabled;
        self.brake_release.set_level(Level::from(brake_released));
    }
}

/// Timer clocks for which the output is high; `period` clocks are always high.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the value is between 0 and the period, which fits; NaN becomes 0"
)]
fn compare(duty: f32, period: f32) -> u16 {
    (duty.abs().min(1.0) * period + 0.5) as u16
}

/// Cuts everything that moves, from any context: drivers off, brake engaged, PWM off.
pub fn cut() {
    use embassy_stm32::pac;
    // The pins may still be inputs when start-up itself has failed; the outputs then float as they do in reset.
    pac::GPIOB.bsrr().write(|w| {
        w.set_br(super::nucleo_f446re::DRIVER_ENABLE_PB, true);
        w.set_br(super::nucleo_f446re::BRAKE_RELEASE_PB, true);
    });
    pac::TIM1.bdtr().modify(|w| w.set_moe(false));
}
