//! The board: the only place that knows the microcontroller, its pins and its registers.
//!
//! An image is for one board, which a cargo feature selects (`build.rs` refuses to build without
//! one). A board is one file: a table of its pins and clocks. Drivers are in `stm32/`; what they
//! need of a family of chips, and what only one has, is in a folder for each (`stm32f1/`,
//! `stm32f4/`, `stm32g4/`), of which [`family`] is that of the board. The interface for the tasks
//! is the same for every board and is this file: the names it re-exports, and `Board`, which owns
//! the peripherals; for a board that is not finished, `Sketch`. `docs/boards.md` says how to add
//! one.

#[cfg(all(slots, not(feature = "slot-b")))]
mod boot_code;
mod memory;
pub mod post_mortem;
pub mod stack;
mod stm32;
#[cfg(stm32f1)]
mod stm32f1;
#[cfg(stm32f4)]
mod stm32f4;
#[cfg(stm32g4)]
mod stm32g4;

#[cfg(feature = "board-kit-f103rc")]
mod kit_f103rc;
#[cfg(feature = "board-nucleo-f446re")]
mod nucleo_f446re;
#[cfg(feature = "board-nucleo-g474re")]
mod nucleo_g474re;
#[cfg(feature = "board-robomaster-c")]
mod robomaster_c;

#[cfg(feature = "board-kit-f103rc")]
use kit_f103rc::{HARDWARE, WIRING};
#[cfg(feature = "board-nucleo-f446re")]
use nucleo_f446re::{HARDWARE, WIRING};
#[cfg(feature = "board-nucleo-g474re")]
use nucleo_g474re::WIRING;
#[cfg(feature = "board-robomaster-c")]
use robomaster_c::{HARDWARE, WIRING};

#[cfg(stm32f1)]
use stm32f1 as family;
#[cfg(stm32f4)]
use stm32f4 as family;
#[cfg(stm32g4)]
use stm32g4 as family;

#[cfg(feature = "self-test")]
pub use family::probe;
pub use stm32::now;
#[cfg(feature = "self-test")]
pub use stm32::pin;
#[cfg(feature = "sketch")]
pub use stm32::sketch::Sketch;
#[cfg(not(feature = "sketch"))]
pub use {
    family::drives::{ARE_WIRED as DRIVES_ARE_WIRED, Drives},
    family::flash::ParameterFlash,
    family::gyro::Gyro,
    family::meters::{Meters, calibrate as calibrate_meters},
    family::program_flash::{BootCode, ProgramFlash},
    family::serial::{IS_WIRED as CABLE_IS_WIRED, Serial},
    stm32::can::{CABLE_PATIENCE, Can, Health, print_to_cable},
    stm32::encoders::Encoders,
    stm32::executors,
    stm32::index::Indexes,
    stm32::iwdg::{Watchdog, patiently},
    stm32::outputs::Outputs,
    stm32::tick::{TickMutex, TickTimer},
    stm32::{Board, Led, Lines, chip, reset},
};

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
