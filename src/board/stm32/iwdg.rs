//! The independent watchdog (RM0390 rev 6, section 21). It cannot be stopped once it runs.
//!
//! Two settings: [`NORMAL`], and [`PATIENT`] while flash is erased or programmed. A setting takes
//! up to five LSI cycles to arrive, 106 to 294 us. Meanwhile PVU and RVU in SR are set, the
//! registers read their old values and must not be written (21.4.2 to 21.4.4). So every change
//! waits until both are clear, before and after; the settings are constants and are never read back
//! to be restored. The first count after the start is the longest there is, so the start ends with
//! a feeding, too.

use embassy_stm32::pac;
use embassy_stm32::pac::iwdg::vals::{Key, Pr};

use crate::board::WIRING;
use crate::board::family::{FASTEST_LSI_KHZ, LONGEST_ERASE_MS, LSI_HZ, NORMAL};

/// A time without feeding after which the chip is reset.
#[derive(Clone, Copy)]
pub struct Setting {
    /// LSI cycles of a count.
    pub prescaler: Pr,
    /// Counts, less one.
    pub reload: u16,
}

/// 4096 counts of 32 LSI cycles, the most that there are: 4.1 s at 32 kHz, 2.8 s at 47 kHz. Within
/// that comes one erase of 128 KiB, 2 s at most at 32 bits, or one save: two erases of 16 KiB, 500
/// ms each, and 600 words at 100 us (DS10693 rev 10, table 49).
const PATIENT: Setting = Setting {
    prescaler: Pr::DIVIDE_BY32,
    reload: 4096 - 1,
};
const _: () = {
    let ms = (PATIENT.reload as u32 + 1) * 32 / FASTEST_LSI_KHZ;
    assert!(ms >= LONGEST_ERASE_MS * 5 / 4, "an erase could be cut");
};

/// Longest wait for a setting to arrive, in steps of a microsecond: 2 ms, for what takes 294 us.
const WAIT_STEPS: u32 = 2_000;

/// An update does not end: LSI has stopped, and so has the watchdog.
pub struct Stuck;

/// The watchdog, running.
pub struct Watchdog(());

impl Watchdog {
    /// Starts it with the normal setting. Needs no clock but its own, so it can be the first thing.
    pub fn start() -> Self {
        pac::IWDG.kr().write(|w| w.set_key(Key::START));
        log(set(NORMAL));
        Self(())
    }

    /// Feeds it.
    pub fn feed(&mut self) {
        feed();
    }
}

/// Runs a long operation with a longer watchdog time; call it only with the outputs off.
///
/// # Errors
/// When that time cannot be set; the operation is then not run.
pub fn patiently<T>(f: impl FnOnce() -> T) -> Result<T, Stuck> {
    set(PATIENT)?;
    let result = f();
    if set(NORMAL).is_err() {
        defmt::error!("watchdog: cannot be set back");
    }
    Ok(result)
}

/// Feeds it; for the start, before there are tasks.
pub fn feed() {
    pac::IWDG.kr().write(|w| w.set_key(Key::RESET));
}

/// Gives the watchdog a setting and feeds it once it has arrived.
fn set(setting: Setting) -> Result<(), Stuck> {
    wait()?;
    // The control side feeds it too, which would end the permission to write.
    cortex_m::interrupt::free(|_| {
        feed();
        pac::IWDG.kr().write(|w| w.set_key(Key::ENABLE));
        pac::IWDG.pr().write(|w| w.set_pr(setting.prescaler));
        pac::IWDG.rlr().write(|w| w.set_rl(setting.reload));
    });
    wait()?;
    feed();
    Ok(())
}

/// Waits until no update is under way.
fn wait() -> Result<(), Stuck> {
    for _ in 0..WAIT_STEPS {
        if pac::IWDG.sr().read().0 == 0 {
            return Ok(());
        }
        cortex_m::asm::delay(WIRING.clocks.cycles_per_us());
    }
    Err(Stuck)
}

/// Logs the watchdog's setting.
fn log(set: Result<(), Stuck>) {
    let (prescaler, reload) = (pac::IWDG.pr().read().0, pac::IWDG.rlr().read().0);
    // 4 << PR LSI cycles a count.
    let us = (reload + 1) * ((4_000_000 / LSI_HZ) << prescaler.min(6));
    match set {
        Ok(()) => defmt::info!("watchdog: {=u32} us typically", us),
        Err(Stuck) => defmt::error!("watchdog: cannot be set, {=u32} us typically", us),
    }
}
