//! RoboMaster Development Board C (STM32F407IGH6, UFBGA176): clocks and pins.
//!
//! The image is emulated, and has not been run on hardware. A robot can drive with it by smart
//! drives only, because no encoder is reachable (see below).
//!
//! | function | peripheral | pins |
//! |---|---|---|
//! | index front left, front right, rear left, rear right; a rising edge once a turn of the wheel | EXTI lines 9 11 13 14 | PE9 PE11 PE13 PE14, the first four of the PWM header |
//! | CAN of the group | CAN1 | PD0 receive, PD1 transmit |
//! | smart drives, on a CAN of their own | CAN2 | PB5 receive, PB6 transmit |
//! | driver enable, high is enabled | TIM8 CH2N | PB14 (SPI2 MISO) |
//! | holding brake, high is released | TIM8 CH3N | PB15 (SPI2 MOSI) |
//! | emergency stop, normally closed to ground; high stops | TIM1 BKIN | PB12 (SPI2 CS) |
//! | supply voltage, by the board's divider | ADC3 IN8 | PF10 |
//! | driver fault, low is a fault | GPIO | PF0 (I2C2 SDA) |
//! | protective stop, normally closed to ground; high asks for standstill | GPIO | PB13 (SPI2 SCK) |
//! | gyro of the BMI088: clock, out of it, into it, select | SPI1, GPIO | PB3 PB4 PA7 PB0 |
//! | gyro: select of the accelerometer beside it, always high | GPIO | PA4 |
//! | LED, green | GPIO | PH11 |
//!
//! The wheels are turned by C620 or C610 drives on CAN2, through the board's own transceiver: its
//! feature selects `drives-c620`. There is no PWM, and the PWM header takes the indexes: each of
//! its plugs has ground and 5 V for a sensor beside the signal. The gyro is one on the board: its z
//! axis points up where the board lies with its connectors up, and nothing else is handled.
//!
//! # Limits
//!
//! The board lacks:
//! - **Encoders**: TIM2 to TIM5 need channels 1 and 2 of one timer. TIM5 has them on the LEDs
//!   (PH10, PH11), TIM4 one on CAN2 (PB6), TIM3 and TIM2 theirs on the inertial sensor (PB4, PA7,
//!   PB3) and the key (PA0); PC6 and PI6 are TIM8, whose other channels are driver enable and
//!   brake. So the board has smart drives only.
//! - **Break input of TIM8**: PA6 and PI4 are not brought out. The emergency stop cuts driver
//!   enable and brake with the next control tick.
//! - Current sensors, switches for the node-ID: it is 2, or what LSS has stored.
//!
//! # Sources
//!
//! The vendor's own configuration, `20.standard_robot/standard_robot.ioc` and
//! `5.servo_motor/servo_motor.ioc` of RoboMaster/Development-Board-C-Examples at bd594e1 (pins, 12
//! MHz crystal, PLL 6 and 168; SPI1 with CS1_GYRO and CS1_ACCEL); RM0090 (chip); DS8626 (alternate
//! functions). Its `18.ins_task` turns the sensor's axes about z alone, so z points up.
//!
//! `supported-devices/rm-dev-board-c.xml` of uw-advanced-robotics/taproot at 18f15a1 has the four
//! pins of the indexes as C1 to C4 of the header, as general inputs or outputs with a timer (not as
//! outputs, which it tells apart), and SPI2 (PB12 to PB15) and I2C2 (PF0, PF1) as such, too; by
//! `bsp/spi/bsp_spi.h` of HNUYueLuRM/basic_framework at 12796f8 SPI2 is on the connector with 8
//! pins. A schematic was not at hand: measure that a level at the header reaches the pin.

use robot::Hardware;

use super::stm32::pin::{pin, pins};
use super::stm32::wiring::{Analog, Can, Clocks, Gyro, IN_ORDER, Wiring};

/// What configurations are checked against.
pub const HARDWARE: Hardware = Hardware::ROBOMASTER_C;

/// Pins and clocks of this board.
pub const WIRING: Wiring = Wiring {
    // 168 MHz from the crystal of 12 MHz: 12 / 6 x 168 / 2. APB1 42 MHz, APB2 84 MHz.
    clocks: Clocks {
        hse_hz: 12_000_000,
        hse_is_clock: false,
        divide_by: 6,
        multiply_by: 168,
    },
    remap: 0,
    channels: IN_ORDER,
    pwm: None,
    second_pwm: None,
    direction: None,
    inverse: None,
    encoders: [None; 4],
    index: Some(pins(["PE9", "PE11", "PE13", "PE14"])),
    can: Can {
        receive: pin("PD0"),
        transmit: pin("PD1"),
    },
    drives: Some(Can {
        receive: pin("PB5"),
        transmit: pin("PB6"),
    }),
    driver_enable: pin("PB14"),
    brake_release: pin("PB15"),
    stop: pin("PB12"),
    gate_stop: None,
    converter: 3,
    supply: Analog {
        pin: pin("PF10"),
        channel: 8,
    },
    currents: None,
    driver_fault: pin("PF0"),
    protective_stop: pin("PB13"),
    node_switches: &[],
    led: pin("PH11"),
    cable: None,
    gyro: Some(Gyro {
        clock: pin("PB3"),
        miso: pin("PB4"),
        mosi: pin("PA7"),
        select: pin("PB0"),
        select_other: pin("PA4"),
    }),
};
