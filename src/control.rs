//! The control task: 1 kHz.

use embassy_stm32::gpio::Input;
use embassy_time::{Duration, Instant, Timer};

use crate::board::Encoders;
use crate::board::drive::Drive;
use crate::handover::{CONTROL_LATENESS, CONTROL_PROGRESS};

/// Reads the encoders and holds the outputs safe.
#[embassy_executor::task]
pub async fn control(mut drive: Drive, encoders: Encoders, driver_fault: Input<'static>) {
    let mut next = Instant::now();
    loop {
        next += Duration::from_millis(1);
        Timer::at(next).await;
        let _ = (
            encoders.counts(),
            drive.emergency_stop(),
            driver_fault.is_low(),
        );
        drive.set([0.0; 4], false, false);
        CONTROL_PROGRESS.made();
        CONTROL_LATENESS
            .note(u32::try_from((Instant::now() - next).as_micros()).unwrap_or(u32::MAX));
    }
}
