//! The differences between boards: pins and clocks.
//!
//! A board is one constant of type [`Wiring`]. The drivers read it where they need it, and so does
//! code without `self`: interrupt handlers, the transition to the safe state, and the first
//! instructions after reset. As a constant it costs no instruction. The drivers fix the use of
//! each timer: TIM1 the PWM, TIM8 driver enable and brake or each wheel's second PWM, TIM7 the
//! tick. The local time, and where there are any the cable and the gyro, are the family's.

use embassy_stm32::pac;
use embassy_stm32::pac::timer::TimAdv;

use super::pin::Pin;
pub use crate::board::family::clocks::Clocks;

/// Pins and clocks of one board. Wheels are in the order front left, front right, rear left, rear
/// right.
pub struct Wiring {
    /// Clocks.
    pub clocks: Clocks,
    /// What AFIO_MAPR of an STM32F1 is to hold; an STM32F4 assigns its pins one by one.
    #[cfg_attr(stm32f4, expect(dead_code, reason = "there is no AFIO"))]
    pub remap: u32,
    /// PWM. A board without has smart drives.
    pub pwm: Option<[Pin; 4]>,
    /// The second PWM, which rolls the base backward. Driver enable and brake are outputs of the
    /// port then.
    pub second_pwm: Option<[Pin; 4]>,
    /// The channels at both; where there is no second PWM, those of TIM1 alone.
    pub channels: [[Channel; 2]; 4],
    /// Direction, where there is PWM and no second one; high rolls the base forward.
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
    /// Index, a rising edge once a turn of the wheel: pins with different numbers from 5 to 15.
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

/// A channel that makes PWM.
#[derive(Clone, Copy)]
pub struct Channel {
    /// TIM1, or TIM8.
    pub is_of_tim1: bool,
    /// From 0.
    pub number: usize,
    /// Whether its complementary output is used, and not its main one.
    pub complementary: bool,
}

impl Channel {
    /// A timer's registers.
    pub const fn timer(self) -> TimAdv {
        if self.is_of_tim1 {
            pac::TIM1
        } else {
            pac::TIM8
        }
    }
}

/// Channels 1 to 4 of TIM1 and of TIM8.
pub const IN_ORDER: [[Channel; 2]; 4] = {
    const fn both(number: usize) -> [Channel; 2] {
        [main(true, number), main(false, number)]
    }
    const fn main(is_of_tim1: bool, number: usize) -> Channel {
        Channel {
            is_of_tim1,
            number,
            complementary: false,
        }
    }
    [both(0), both(1), both(2), both(3)]
};

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
