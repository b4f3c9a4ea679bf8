//! The health task: once a second it compares stack use and lateness with the worst values so far
//! and logs those that got worse; otherwise it logs nothing. It also makes the meters compare their
//! reference with the chip's own; once a second is enough for its drift.

use embassy_time::{Duration, Ticker};

use crate::board::{calibrate_meters, stack};
use crate::shared::CONTROL_LATENESS;

/// Lateness of a control tick worth a line, in microseconds: a tenth of its period.
const LATE_US: u32 = 100;

/// Stack growth worth a line.
const STACK_STEP_BYTES: usize = 128;

/// Watches stack and lateness.
#[embassy_executor::task]
pub async fn health() {
    let mut ticker = Ticker::every(Duration::from_secs(1));
    let mut stack_worst = 0;
    let mut late_worst_us = LATE_US;
    loop {
        calibrate_meters();
        ticker.next().await;
        let stack = stack::high_water();
        if stack.most >= stack_worst + STACK_STEP_BYTES {
            defmt::info!(
                "stack: {=usize} of {=usize} bytes used",
                stack.most,
                stack.size
            );
            stack_worst = stack.most;
        }
        let late_us = CONTROL_LATENESS.reset_us();
        if late_us > late_worst_us {
            defmt::warn!("control tick {=u32} us late", late_us);
            late_worst_us = late_us;
        }
    }
}
