//! Where the ports of an STM32G4 are.

pub use crate::board::stm32::moder::{give, port_address};

/// Ports A to G.
pub const PORTS: usize = 7;

/// Address of port A.
pub const PORT_A: usize = 0x4800_0000;

/// Address of AHB2ENR, whose lowest bits clock the ports.
pub const PORT_CLOCKS: u32 = 0x4002_104C;
