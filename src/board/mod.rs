//! The board: the only place that knows the microcontroller, its pins and its registers.
//!
//! An image is for one board, which a cargo feature selects (`build.rs` refuses to build without
//! one). A board is one file: a table of its pins and clocks. The drivers belong to its chip family
//! (`stm32f4/`). The interface for the tasks is the same for every board and is this file: the
//! names it re-exports, and [`Board`], which owns the peripherals. `docs/boards.md` says how to add
//! a board.

#[cfg(not(feature = "slot-b"))]
mod boot_code;
mod memory;
pub mod post_mortem;
pub mod stack;
mod stm32f4;

#[cfg(feature = "board-nucleo-f446re")]
mod nucleo_f446re;
#[cfg(feature = "board-robomaster-c")]
mod robomaster_c;

#[cfg(feature = "board-nucleo-f446re")]
use nucleo_f446re::WIRING;
#[cfg(feature = "board-robomaster-c")]
use robomaster_c::WIRING;

pub use stm32f4::can::{CABLE_PATIENCE, Can, Health, print_to_cable};
pub use stm32f4::drives::{ARE_WIRED as DRIVES_ARE_WIRED, Drives};
pub use stm32f4::encoders::Encoders;
pub use stm32f4::executors;
pub use stm32f4::flash::ParameterFlash;
pub use stm32f4::gyro::Gyro;
pub use stm32f4::index::Indexes;
pub use stm32f4::iwdg::{Watchdog, patiently};
pub use stm32f4::meters::{Meters, calibrate as calibrate_meters};
pub use stm32f4::outputs::Outputs;
pub use stm32f4::program_flash::{BootCode, ProgramFlash};
pub use stm32f4::serial::{IS_WIRED as CABLE_IS_WIRED, Serial};
pub use stm32f4::tick::{TickMutex, TickTimer};
pub use stm32f4::{Board, Led, Lines, now, reset};
#[cfg(feature = "self-test")]
pub use stm32f4::{pin, probe};

/// Why the chip was reset, with the numbers of the object "reset cause".
#[derive(Clone, Copy, PartialEq, Eq, defmt::Format)]
#[repr(u8)]
pub enum ResetCause {
    /// Power-on.
    Power = 0,
    /// The reset pin alone: button or debugger.
    Pin = 1,
    /// Reset by software.
    Software = 2,
    /// The independent watchdog: a task made no progress, or the program failed.
    Watchdog = 3,
    /// The window watchdog, which the firmware does not use.
    WindowWatchdog = 4,
    /// A low-power mode entered by mistake.
    LowPower = 5,
    /// The supply sagged.
    BrownOut = 6,
}
