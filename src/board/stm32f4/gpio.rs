//! Where the ports of an STM32F4 are (RM0390 rev 6, table 1 and 6.3.10; RM0090, table 1).

pub use crate::board::stm32::moder::{give, port_address};

/// Ports A to I.
pub const PORTS: usize = 9;

/// Address of port A.
pub const PORT_A: usize = 0x4002_0000;

/// Address of AHB1ENR, whose lowest bits clock the ports.
pub const PORT_CLOCKS: u32 = 0x4002_3830;
