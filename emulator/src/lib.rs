//! An STM32F4 or STM32F103 that runs the release firmware unmodified.
//!
//! The emulator loads and executes the same image, byte for byte, that is flashed into a robot. The
//! processor core with its interrupt controller, system timer and cycle counter comes from
//! [`rsemu`]; this crate models ST's peripherals from the reference manuals RM0390 rev 6 and RM0090
//! rev 19, for the STM32F1's registers RM0008 rev 21, one file per peripheral, each naming its
//! sections. Which chip a board has follows from its image, and what is particular to a chip is a
//! value ([`chip`]). The crate has no knowledge of the firmware: a [`Board`] has pins, PWM outputs,
//! encoder inputs, a CAN controller and a serial port, which the caller connects to a simulated
//! world.
//!
//! Peripherals do no work per clock cycle. A counter is computed from the time at which it is read,
//! and each peripheral reports the time of its next event; a core that sleeps skips straight to
//! that time. Time is counted in core clock cycles (see [`clock`]), so two runs with the same
//! inputs are the same to the cycle.
//!
//! An access to a register that is not modelled ends the run with a [`Stop`] that names the
//! register and the source line, because ignoring it would look like working hardware. An access to
//! a peripheral whose clock is off, and a clock outside the chip's specification, also end the run.
//!
//! | modelled | RM0390 | not modelled (an access stops the run unless noted) |
//! |---|---|---|
//! | RCC: clock tree with lock times, gating, resets, reset causes, CSS | 6 | LPENR has no effect |
//! | PWR: over-drive, voltage scale, limits of HCLK, voltage detector, brown-out | 5 | stop and standby mode |
//! | flash: wait states with prefetch and caches, keys, erase and program with their times, stall | 3 | stale cache lines; of the option bytes only the brown-out level has an effect |
//! | GPIO A..I, alternate functions of the signals below | 7 | LCKR |
//! | EXTI, SYSCFG | 8, 10 | events (EMR is stored, without effect), memory remap |
//! | TIM1..14: counting, preload, PWM, complementary outputs alone, encoder with input filters, break, lock | 17..20 | capture, other slave modes, DMA |
//! | CAN1 and CAN2: modes, mailboxes, shared filters, FIFOs, time stamps, errors, bus-off, loop-back of CAN1 | 30 | TGT (no effect), loop-back of CAN2 (receives nothing) |
//! | ADC1 to 3: one regular channel, once or continuously, injected ones after it | 13 | sequences, triggers, DMA |
//! | USART2: eight data bits, baud rate, framing and overrun errors, idle line, DMA | 25 | other ports, parity, other lengths, noise, LIN, flow control |
//! | SPI1 of an STM32F4: master, 8 or 16 bits (table in `system/spi.rs`) | 26 | other ports, slave, interrupts, DMA, CRC, I2S |
//! | DMA1: byte by byte between USART2 and RAM, once or circular | 9 | other requests, FIFO, double buffers |
//! | IWDG with its oscillator's tolerance | 21 | WWDG |
//! | unique number, flash size, DBGMCU | 33, 34 | freezing of peripherals other than timers and IWDG while halted |
//! | core, NVIC, SysTick, SCB, FPU, DWT cycle counter (rsemu) | | ITM, watchpoints |
//! | log over RTT with defmt | | other RTT channels |
//!
//! Most instructions are executed on a fast path that is compared with the reference core to the
//! cycle ([`BoardConfig::reference_core`] switches it off).
//!
//! ```no_run
//! use emulator::{Board, BoardConfig, Firmware, Port};
//!
//! let firmware = Firmware::load("target/thumbv7em-none-eabihf/release/omnibus-firmware")?;
//! let mut board = Board::new(&firmware, BoardConfig::default());
//! board.set_input(Port::B, 12, false);
//! board.run_until(10_000_000)?; // 10 ms of the world's time
//! for line in board.take_log() {
//!     println!("{line}");
//! }
//! println!("{:?}", board.pwm(1, 1));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![warn(missing_docs)]

mod address_space;
mod bmi088;
mod board;
pub mod can;
pub mod chip;
pub mod clock;
mod defect;
pub mod family;
mod fast;
mod fetch;
mod firmware;
mod memory_map;
pub mod profile;
mod ram;
mod rtt;
mod soc;
mod stop;
pub mod system;
pub mod timer;
mod trace;
pub mod waveform;

pub use bmi088::{Bmi088, GyroDefect};
pub use board::{Board, BoardConfig, CoreRegisters, Outputs, ResetCause, SerialPort};
pub use can::{CanError, CanFrame, CanId, CanPort, ErrorCounters};
pub use chip::Chip;
pub use defect::Defect;
pub use firmware::{Firmware, LoadError, Symbol, programmed};
pub use rtt::{Level, LogLine};
pub use stop::{Stop, StopKind};
pub use system::flash::FlashOperations;
pub use system::gpio::{PinLevel, Port};
pub use timer::PwmState;
pub use trace::{Change, Traced};
