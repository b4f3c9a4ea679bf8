//! NUCLEO-G474RE (STM32G474RET6, LQFP64): clocks and pins. **A sketch**: neither FDCAN nor another
//! driver is written, so its image (feature `sketch`) takes no command and drives nothing.
//!
//! # Pins
//!
//! | function | peripheral | pins |
//! |---|---|---|
//! | PWM front left, front right, rear left, rear right | TIM1 CH1..4 (2) | PC0 PC1 PC2 PC3 |
//! | direction, same order; high rolls the base forward | GPIO | PA8 PA9 PA10 PB9 |
//! | the opposite of the direction, same order, for bridges with IN1 and IN2 | GPIO | PB2 PB4 PB5 PD2 |
//! | encoders, same order; count up when the base rolls forward | TIM2 (1) TIM3 (2) TIM4 (2) TIM5 (2) | PA15/PB3 PC6/PC7 PB6/PB7 PA0/PA1 |
//! | encoder index, same order; a rising edge once a turn | EXTI lines 10 11 14 15 | PB10 PB11 PB14 PB15 |
//! | CAN | FDCAN1 (9) | PA11 receive, PA12 transmit |
//! | driver enable, high is enabled | TIM8 CH2N (4) | PB0 |
//! | holding brake, high is released | TIM8 CH3N (4) | PB1 |
//! | emergency stop, normally closed to ground; high stops | TIM1 BKIN (6), TIM8 BKIN (4) | PB12 and PA6, wired together |
//! | supply voltage, divided by 11 | ADC2 IN17 | PA4 |
//! | motor current, optional, up to three sensors | ADC2 IN4 IN5 IN11 | PA7 PC4 PC5 |
//! | driver fault, low is a fault | GPIO | PB13 |
//! | protective stop, normally closed to ground; high asks for standstill | GPIO | PC12 |
//! | node id switches, closed to ground is 1 | GPIO | PC8 (bit 0) PC9 PC10 PC11 |
//! | LED LD2 | GPIO | PA5 |
//! | cable: the virtual COM port of the ST-LINK | USART2 (7) | PA3 receive, PA2 transmit |
//!
//! The number behind a peripheral is the alternate function, which differs from pin to pin on this
//! chip: the shared drivers have one for each timer.
//!
//! # What differs from the reference board
//!
//! CAN is not on PB8: that pin is BOOT0, and a transceiver's idle level there starts the chip's own
//! loader where the option bytes say so. So PWM moves away from PA11, and directions to where PWM
//! was. PB4 and PB6 are pulled down by the USB-C controller from reset until the clocks have
//! started.
//!
//! # Sources
//!
//! Alternate functions and converter inputs: `stm32-metapac` 21.0, made from ST's own files.
//! Crystal of 24 MHz, LED, virtual COM port and PLL: the board's description in Zephyr
//! (`boards/st/nucleo_g474re`). BOOT0 on PB8: users' reports alone. UM2505 and DS12288 were not at
//! hand.

use super::stm32::pin::{pin, pins};
use super::stm32::wiring::{Analog, Can, Clocks, Encoder, IN_ORDER, Serial, Wiring};

/// Pins and clocks of this board.
pub const WIRING: Wiring = Wiring {
    // 170 MHz from a crystal of 24 MHz: 24 / 6 x 85 / 2, for all buses.
    clocks: Clocks {
        hse_hz: 24_000_000,
        hse_is_clock: false,
        divide_by: 6,
        multiply_by: 85,
    },
    remap: 0,
    channels: IN_ORDER,
    pwm: Some(pins(["PC0", "PC1", "PC2", "PC3"])),
    second_pwm: None,
    direction: Some(pins(["PA8", "PA9", "PA10", "PB9"])),
    inverse: Some(pins(["PB2", "PB4", "PB5", "PD2"])),
    encoders: [
        encoder(2, ["PA15", "PB3"]),
        encoder(3, ["PC6", "PC7"]),
        encoder(4, ["PB6", "PB7"]),
        encoder(5, ["PA0", "PA1"]),
    ],
    index: Some(pins(["PB10", "PB11", "PB14", "PB15"])),
    can: Can {
        receive: pin("PA11"),
        transmit: pin("PA12"),
    },
    drives: None,
    driver_enable: pin("PB0"),
    brake_release: pin("PB1"),
    stop: pin("PB12"),
    gate_stop: Some(pin("PA6")),
    converter: 2,
    supply: analog("PA4", 17),
    currents: Some([analog("PA7", 4), analog("PC4", 5), analog("PC5", 11)]),
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
