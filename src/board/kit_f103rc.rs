//! A kit's controller with an STM32F103RC and four bridges of two inputs each, as
//! `docs/boards.md` describes it: clocks and pins.
//!
//! # Pins
//!
//! | function | peripheral | pins |
//! |---|---|---|
//! | PWM forward (IN1) front left, front right, rear left, rear right | TIM8 CH1, TIM1 CH4, TIM8 CH3, TIM1 CH2N | PC6 PA11 PC8 PB0 |
//! | PWM backward (IN2), same order | TIM8 CH2, TIM1 CH1, TIM8 CH4, TIM1 CH3N | PC7 PA8 PC9 PB1 |
//! | encoders, same order; count up when the base rolls forward | TIM2 TIM4 TIM5 TIM3 | PA15/PB3 PB6/PB7 PA0/PA1 PB4/PB5 |
//! | CAN | CAN | PB8 receive, PB9 transmit |
//! | driver enable, high is enabled | GPIO | PC10 |
//! | holding brake, high is released | GPIO | PC11 |
//! | emergency stop, normally closed to ground; high stops | TIM1 BKIN and TIM8 BKIN, one pin | PA6 |
//! | supply voltage, divided by 11 | ADC1 IN14 | PC4 |
//! | driver fault, low is a fault | GPIO | PC5 |
//! | protective stop, normally closed to ground; high asks for standstill | GPIO | PC12 |
//! | LED | GPIO | PC13 |
//!
//! # What it lacks
//!
//! The bridges have neither enable nor fault output: PC10, PC11, PC5 and PC12 are pins for which no
//! source names a use, to be wired to what a robot adds. A break makes both inputs of every bridge
//! low without the program, which drives none; driver enable and brake follow in the next control
//! tick. Node-IDs are given by LSS. There are no current sensors, no index inputs, no cable, no
//! updates over the bus.
//!
//! A kit whose fourth encoder is on PA6 and PA7 needs it moved to PB4 and PB5, or nothing stops the
//! PWM in hardware. SWD stays, JTAG does not: PA15, PB3 and PB4 are encoders'.
//!
//! # Sources
//!
//! `docs/boards.md` has them, and how far they can be believed: no schematic was read. RM0008
//! rev 21 (chip; remaps 9.3), DS5792 rev 13. Which motor is at which wheel is a choice made here.

use robot::Hardware;

use super::stm32::pin::{pin, pins};
use super::stm32::wiring::{Analog, Can, Channel, Clocks, Encoder, Wiring};

/// What configurations are checked against.
pub const HARDWARE: Hardware = Hardware::KIT_F103RC;

/// Pins and clocks of this board.
pub const WIRING: Wiring = Wiring {
    // 72 MHz from a crystal of 8 MHz. APB1 36 MHz, APB2 72 MHz.
    clocks: Clocks {
        hse_hz: 8_000_000,
        hse_is_clock: false,
        multiply_by: 9,
    },
    // TIM1 partial, TIM2 partial 1, TIM3 partial, CAN on port B, SWD without JTAG (9.4.2).
    remap: 0b01 << 6 | 0b01 << 8 | 0b10 << 10 | 0b10 << 13 | 0b010 << 24,
    pwm: Some(pins(["PC6", "PA11", "PC8", "PB0"])),
    second_pwm: Some(pins(["PC7", "PA8", "PC9", "PB1"])),
    channels: [
        [tim8(1), tim8(2)],
        [tim1(4), tim1(1)],
        [tim8(3), tim8(4)],
        [tim1_complementary(2), tim1_complementary(3)],
    ],
    direction: None,
    inverse: None,
    driver_enable: pin("PC10"),
    brake_release: pin("PC11"),
    stop: pin("PA6"),
    gate_stop: Some(pin("PA6")),
    encoders: [
        encoder(2, ["PA15", "PB3"]),
        encoder(4, ["PB6", "PB7"]),
        encoder(5, ["PA0", "PA1"]),
        encoder(3, ["PB4", "PB5"]),
    ],
    index: None,
    can: Can {
        receive: pin("PB8"),
        transmit: pin("PB9"),
    },
    drives: None,
    converter: 1,
    supply: Analog {
        pin: pin("PC4"),
        channel: 14,
    },
    currents: None,
    driver_fault: pin("PC5"),
    protective_stop: pin("PC12"),
    node_switches: &[],
    led: pin("PC13"),
    cable: None,
    gyro: None,
};

const fn tim1(number: usize) -> Channel {
    Channel {
        is_of_tim1: true,
        number: number - 1,
        complementary: false,
    }
}

const fn tim1_complementary(number: usize) -> Channel {
    Channel {
        complementary: true,
        ..tim1(number)
    }
}

const fn tim8(number: usize) -> Channel {
    Channel {
        is_of_tim1: false,
        ..tim1(number)
    }
}

const fn encoder(timer: usize, channels: [&str; 2]) -> Option<Encoder> {
    Some(Encoder {
        timer,
        channels: pins(channels),
    })
}
