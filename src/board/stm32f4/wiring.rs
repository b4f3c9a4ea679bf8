//! The differences between boards with a chip of this family: pins and clocks.
//!
//! A board is one constant of type [`Wiring`]. The drivers read it where they need it, and so does
//! code without `self`: interrupt handlers, the transition to the safe state, and the first
//! instructions after reset. As a constant it costs no instruction. The family fixes the use of
//! each timer: TIM1 the PWM, TIM8 driver enable and brake or each wheel's second PWM, TIM7 the
//! tick, TIM9 the local time, USART2 the cable, SPI1 the gyro.

use embassy_stm32::Config;
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllSource, Sysclk,
};
use embassy_stm32::time::Hertz;

use super::pin::Pin;

/// Pins and clocks of one board. Wheels are in the order front left, front right, rear left, rear
/// right.
pub struct Wiring {
    /// Clocks.
    pub clocks: Clocks,
    /// PWM: TIM1 channels 1 to 4.
    pub pwm: [Pin; 4],
    /// The second PWM, which rolls the base backward: TIM8 channels 1 to 4. Driver enable and brake
    /// are outputs of the port then.
    pub second_pwm: Option<[Pin; 4]>,
    /// Direction, where there is no second PWM; high rolls the base forward.
    pub direction: Option<[Pin; 4]>,
    /// The opposite of the direction, for bridges with PWM, IN1 and IN2.
    pub inverse: Option<[Pin; 4]>,
    /// Driver enable, high is enabled: TIM8 CH2N, or any pin where TIM8 makes the second PWM.
    pub driver_enable: Pin,
    /// Holding brake, high is released: TIM8 CH3N, or any pin.
    pub brake_release: Pin,
    /// Emergency stop, closed to ground; high stops: TIM1 BKIN.
    pub stop: Pin,
    /// The same wire at TIM8 BKIN. Without it, a stop cuts driver enable and brake in the next
    /// control tick, not in hardware; a second PWM cannot be without it.
    pub gate_stop: Option<Pin>,
    /// Encoders; they count up when the base rolls forward. Without one, the count does not change.
    pub encoders: [Option<Encoder>; 4],
    /// Encoder index, a rising edge once a turn: pins with different numbers from 10 to 15.
    pub index: Option<[Pin; 4]>,
    /// CAN1.
    pub can: Can,
    /// Smart drives on CAN2, which turn the wheels in place of bridges.
    pub drives: Option<Can>,
    /// The converter with the analog inputs: 1 to 3.
    pub converter: usize,
    /// Supply voltage behind a divider.
    pub supply: Analog,
    /// Motor current, three sensors.
    pub currents: Option<[Analog; 3]>,
    /// Low when a motor driver reports a fault.
    pub driver_fault: Pin,
    /// Protective stop, closed to ground; high asks for standstill.
    pub protective_stop: Pin,
    /// Switches of the node-ID, closed to ground is 1, the lowest bit first.
    pub node_switches: &'static [Pin],
    /// LED, high is on.
    pub led: Pin,
    /// The serial port of the cable: USART2.
    pub cable: Option<Serial>,
    /// The gyro of a BMI088 on SPI1, its z axis up.
    pub gyro: Option<Gyro>,
}

/// Pins of a BMI088.
#[derive(Clone, Copy)]
pub struct Gyro {
    /// Clock.
    pub clock: Pin,
    /// Out of the sensor.
    pub miso: Pin,
    /// Into the sensor.
    pub mosi: Pin,
    /// Chip select of the gyro.
    pub select: Pin,
    /// Chip select of the accelerometer.
    pub select_other: Pin,
}

/// Pins of USART2.
#[derive(Clone, Copy)]
pub struct Serial {
    /// Receive.
    pub receive: Pin,
    /// Transmit.
    pub transmit: Pin,
}

/// One encoder.
#[derive(Clone, Copy)]
pub struct Encoder {
    /// Its counter, TIM2 to TIM5.
    pub timer: usize,
    /// Channels 1 and 2 of the timer.
    pub channels: [Pin; 2],
}

/// Pins of a CAN controller.
#[derive(Clone, Copy)]
pub struct Can {
    /// Receive.
    pub receive: Pin,
    /// Transmit.
    pub transmit: Pin,
}

/// One input of the converter.
#[derive(Clone, Copy)]
pub struct Analog {
    /// The pin.
    pub pin: Pin,
    /// Its channel.
    pub channel: u8,
}

/// Clocks: `hse_hz` / `divide_by` x `multiply_by` / 2 for the core, a quarter of that for APB1 and
/// half of it for APB2. Timers of a divided bus run at twice its clock.
pub struct Clocks {
    /// Frequency of the clock from outside.
    pub hse_hz: u32,
    /// Whether it is a clock already (bypass) or a crystal.
    pub hse_is_clock: bool,
    /// PLLM.
    pub divide_by: u8,
    /// PLLN.
    pub multiply_by: u16,
}

impl Clocks {
    /// The core's.
    pub const fn core_hz(&self) -> u32 {
        self.hse_hz / self.divide_by as u32 * self.multiply_by as u32 / 2
    }

    /// That of APB1 and its peripherals: CAN1, for one.
    pub const fn apb1_hz(&self) -> u32 {
        self.core_hz() / 4
    }

    /// That of the timers of APB1: TIM2 to TIM7.
    pub const fn apb1_timers_hz(&self) -> u32 {
        self.core_hz() / 2
    }

    /// That of APB2 and its peripherals: the converters.
    pub const fn apb2_hz(&self) -> u32 {
        self.core_hz() / 2
    }

    /// That of the timers of APB2: TIM1, TIM8 and TIM9.
    pub const fn apb2_timers_hz(&self) -> u32 {
        self.core_hz()
    }

    /// Core cycles in a microsecond.
    pub const fn cycles_per_us(&self) -> u32 {
        self.core_hz() / 1_000_000
    }

    /// The same for the HAL.
    pub fn config(&self) -> Config {
        let mut config = Config::default();
        config.rcc.hse = Some(Hse {
            freq: Hertz(self.hse_hz),
            mode: if self.hse_is_clock {
                HseMode::Bypass
            } else {
                HseMode::Oscillator
            },
        });
        config.rcc.pll_src = PllSource::HSE;
        config.rcc.pll = Some(Pll {
            prediv: PllPreDiv::from_bits(self.divide_by),
            mul: PllMul::from_bits(self.multiply_by),
            divp: Some(PllPDiv::DIV2),
            divq: None,
            divr: None,
        });
        config.rcc.sys = Sysclk::PLL1_P;
        config.rcc.ahb_pre = AHBPrescaler::DIV1;
        config.rcc.apb1_pre = APBPrescaler::DIV4;
        config.rcc.apb2_pre = APBPrescaler::DIV2;
        config
    }
}
