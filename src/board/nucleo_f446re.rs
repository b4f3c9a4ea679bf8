//! NUCLEO-F446RE (STM32F446RET6, LQFP64): clocks and pins. The reference board.
//!
//! # Pins
//!
//! | function | peripheral | pins |
//! |---|---|---|
//! | PWM front left, front right, rear left, rear right | TIM1 CH1..4 | PA8 PA9 PA10 PA11 |
//! | direction, same order; high rolls the base forward | GPIO | PC0 PC1 PC2 PC3 |
//! | the opposite of the direction, same order, for bridges with IN1 and IN2 | GPIO | PB2 PB4 PB5 PD2 |
//! | encoders, same order; count up when the base rolls forward | TIM2 TIM3 TIM4 TIM5 | PA15/PB3 PC6/PC7 PB6/PB7 PA0/PA1 |
//! | encoder index, same order; a rising edge once a turn | EXTI lines 10 12 14 15 | PB10 PA12 PB14 PB15 |
//! | CAN | CAN1 | PB8 receive, PB9 transmit |
//! | driver enable, high is enabled | TIM8 CH2N | PB0 |
//! | holding brake, high is released | TIM8 CH3N | PB1 |
//! | emergency stop, normally closed to ground; high stops | TIM1 BKIN, TIM8 BKIN | PB12 and PA6, wired together |
//! | supply voltage, divided by 11 | ADC1 IN4 | PA4 |
//! | motor current, optional, up to three sensors | ADC1 IN7 IN14 IN15 | PA7 PC4 PC5 |
//! | driver fault, low is a fault | GPIO | PB13 |
//! | protective stop, normally closed to ground; high asks for standstill | GPIO | PC12 |
//! | node id switches, closed to ground is 1 | GPIO | PC8 (bit 0) PC9 PC10 PC11 |
//! | LED LD2 | GPIO | PA5 |
//! | cable: the virtual COM port of the ST-LINK | USART2 | PA3 receive, PA2 transmit |
//! | user button | GPIO | PC13 |
//!
//! # Smart drives
//!
//! With the feature `drives-c620` the wheels are turned by C620 or C610 drives on CAN2: PB5
//! receives, PB6 transmits, through a transceiver of their own. These pins are a direction's
//! opposite and an encoder's otherwise, so an image has one or the other. Opposites and encoders
//! are not used then, indexes are; PWM and directions stay low.
//!
//! # Two PWMs a wheel
//!
//! With the feature `two-pwms` each wheel has two PWMs, for bridges with IN1 and IN2. TIM8 makes
//! the second one on pins of an encoder and of switches, which move to pins of directions. Nothing
//! else changes place:
//!
//! | function with two PWMs | peripheral | pins |
//! |---|---|---|
//! | IN1: PWM forward, front left, front right, rear left, rear right | TIM1 CH1..4 | PA8 PA9 PA10 PA11 |
//! | IN2: PWM backward, same order | TIM8 CH1..4 | PC6 PC7 PC8 PC9 |
//! | encoder of the front right wheel | TIM3 | PB4/PB5 |
//! | node id switches, closed to ground is 1 | GPIO | PC0 (bit 0) PC1 PC10 PC11 |
//!
//! Driver enable (PB0) and brake (PB1) are outputs of the port then: TIM8's channels 2 and 3 are
//! needed, and a channel has one reference. The break inputs make both inputs of every bridge low
//! without the program; driver enable and brake follow in the next control tick.
//!
//! # Sources
//!
//! UM1724 rev 15 (board), RM0390 rev 6 (chip), DS10693 rev 10 (alternate functions).

use robot::Hardware;

use super::stm32::pin::{pin, pins};
use super::stm32::wiring::{Analog, Can, Clocks, Encoder, IN_ORDER, Serial, Wiring};

/// What configurations are checked against.
pub const HARDWARE: Hardware = Hardware::NUCLEO_F446RE;

/// Pins and clocks of this board.
#[cfg(not(any(feature = "drives-c620", feature = "two-pwms")))]
pub const WIRING: Wiring = BRIDGES;

/// The same with two PWMs a wheel.
#[cfg(feature = "two-pwms")]
pub const WIRING: Wiring = Wiring {
    second_pwm: Some(pins(["PC6", "PC7", "PC8", "PC9"])),
    direction: None,
    inverse: None,
    encoders: [
        BRIDGES.encoders[0],
        encoder(3, ["PB4", "PB5"]),
        BRIDGES.encoders[2],
        BRIDGES.encoders[3],
    ],
    node_switches: &pins(["PC0", "PC1", "PC10", "PC11"]),
    ..BRIDGES
};

/// The same with smart drives.
#[cfg(feature = "drives-c620")]
pub const WIRING: Wiring = Wiring {
    inverse: None,
    encoders: [None; 4],
    drives: Some(Can {
        receive: pin("PB5"),
        transmit: pin("PB6"),
    }),
    ..BRIDGES
};

/// With bridges and encoders, as in the table.
const BRIDGES: Wiring = Wiring {
    // 180 MHz from the 8 MHz that the ST-LINK feeds into the HSE input: 8 / 4 x 180 / 2. APB1
    // 45 MHz, APB2 90 MHz.
    clocks: Clocks {
        hse_hz: 8_000_000,
        hse_is_clock: true,
        divide_by: 4,
        multiply_by: 180,
    },
    remap: 0,
    channels: IN_ORDER,
    pwm: Some(pins(["PA8", "PA9", "PA10", "PA11"])),
    second_pwm: None,
    direction: Some(pins(["PC0", "PC1", "PC2", "PC3"])),
    inverse: Some(pins(["PB2", "PB4", "PB5", "PD2"])),
    encoders: [
        encoder(2, ["PA15", "PB3"]),
        encoder(3, ["PC6", "PC7"]),
        encoder(4, ["PB6", "PB7"]),
        encoder(5, ["PA0", "PA1"]),
    ],
    index: Some(pins(["PB10", "PA12", "PB14", "PB15"])),
    can: Can {
        receive: pin("PB8"),
        transmit: pin("PB9"),
    },
    drives: None,
    driver_enable: pin("PB0"),
    brake_release: pin("PB1"),
    stop: pin("PB12"),
    gate_stop: Some(pin("PA6")),
    converter: 1,
    supply: analog("PA4", 4),
    currents: Some([analog("PA7", 7), analog("PC4", 14), analog("PC5", 15)]),
    driver_fault: pin("PB13"),
    protective_stop: pin("PC12"),
    node_switches: &pins(["PC8", "PC9", "PC10", "PC11"]),
    led: pin("PA5"),
    gyro: None,
    cable: Some(Serial {
        receive: pin("PA3"),
        transmit: pin("PA2"),
    }),
};

const fn encoder(timer: usize, channels: [&str; 2]) -> Option<Encoder> {
    Some(Encoder {
        timer,
        channels: pins(channels),
    })
}

const fn analog(name: &str, channel: u8) -> Analog {
    Analog {
        pin: pin(name),
        channel,
    }
}
