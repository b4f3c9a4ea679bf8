//! The watchdog task: feeds the independent watchdog while both executors prove progress.
//!
//! It runs on the bus executor, in thread mode, and so is the first to starve. Every 10 ms it looks at the two counts;
//! it feeds only if the bus task *and* the control task have come round since the last look. The bus task comes round
//! at least every 2 ms, the control task every millisecond. Nothing else feeds, so a task that hangs, an interrupt
//! storm, or a task that never yields resets the chip 50 ms after the last feeding (34 to 94 ms over the LSI's
//! tolerance).

use embassy_stm32::peripherals::IWDG;
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_time::{Duration, Ticker};

use crate::handover::{BUS_PROGRESS, CONTROL_PROGRESS};

const PERIOD: Duration = Duration::from_millis(10);

/// Feeds `watchdog`.
#[embassy_executor::task]
pub async fn watchdog(mut watchdog: IndependentWatchdog<'static, IWDG>) {
    let mut ticker = Ticker::every(PERIOD);
    let mut bus = BUS_PROGRESS.count();
    let mut control = CONTROL_PROGRESS.count();
    loop {
        ticker.next().await;
        let (bus_now, control_now) = (BUS_PROGRESS.count(), CONTROL_PROGRESS.count());
        if bus_now != bus && control_now != control {
            watchdog.pet();
            (bus, control) = (bus_now, control_now);
        }
    }
}
