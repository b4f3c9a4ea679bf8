//! The two flash sectors that belong to the parameters (RM0390 rev 6 section 3; `memory.x` has the map).
//!
//! The chip has one bank: while a word is programmed (16 us) or a sector erased (16 KiB: 250 ms typically, 800 ms at
//! most at 8 bits parallelism, data sheet DS10693 rev 10 table 49) it executes nothing. For that long no interrupt is
//! served, and frames that do not fit into the CAN controller's FIFO are lost; during an erase the local time stands
//! still. Between the operations interrupts are served, but no other task of the bus executor runs, and
//! clearing up a full sector takes the store up to 400 ms of computing. So this may be used only while the outputs are
//! off, and the watchdog, which cannot be stopped, is given more time by
//! [`patiently`](super::iwdg::patiently).

use embassy_stm32::Peri;
use embassy_stm32::flash::{Bank1Region1, Blocking, Error, Flash};
use embassy_stm32::pac;
use embassy_stm32::peripherals::FLASH;
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, ReadNorFlash};

/// Offset of the first of the two sectors; `__parameters_start` in `memory.x`.
pub const PARAMETERS: u32 = 0x4000;

/// Flash sectors 0 to 3.
pub struct ParameterFlash(Bank1Region1<'static, Blocking>);

impl ParameterFlash {
    /// Takes the flash interface.
    pub fn new(flash: Peri<'static, FLASH>) -> Self {
        Self(
            Flash::new_blocking(flash)
                .into_blocking_regions()
                .bank1_region1,
        )
    }
}

impl ErrorType for ParameterFlash {
    type Error = Error;
}

impl ReadNorFlash for ParameterFlash {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Error> {
        self.0.blocking_read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        0x1_0000
    }
}

impl NorFlash for ParameterFlash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 0x4000;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Error> {
        // The local time counts this timer's overflows in an interrupt. If it missed some, the time and the timer would
        // be half a period apart for ever after, and every alarm 33 ms off; so the time stands still.
        pac::TIM9.cr1().modify(|w| w.set_cen(false));
        let result = self.0.blocking_erase(from, to);
        pac::TIM9.cr1().modify(|w| w.set_cen(true));
        // 3.4.2: the data cache does not notice an erase.
        pac::FLASH.acr().modify(|w| w.set_dcen(false));
        pac::FLASH.acr().modify(|w| w.set_dcrst(true));
        pac::FLASH.acr().modify(|w| w.set_dcrst(false));
        pac::FLASH.acr().modify(|w| w.set_dcen(true));
        result
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Error> {
        self.0.blocking_write(offset, bytes)
    }
}
