//! The control task: 1 kHz.

use embassy_stm32::gpio::Input;
use embassy_time::{Duration, Instant, Timer};

use crate::board::Encoders;
use crate::board::drive::Drive;

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
    }
}
