//! The bus task: frames in, frames out.

use canopen::Frame;
use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Instant, Timer};

use crate::board::can::Can;
use crate::handover::BUS_PROGRESS;
use crate::led::{self, Pattern};

/// Sends a heartbeat every 100 ms and echoes nothing else.
#[embassy_executor::task]
pub async fn bus(mut can: Can, node: u8) {
    let id = 0x700 + u16::from(node);
    let _ = can.try_send(&Frame::of(id, [0]));
    let heartbeat = Frame::of(id, [0x7F]);
    let mut next = Instant::now();
    let mut received: u32 = 0;
    let mut health = can.health();
    loop {
        BUS_PROGRESS.made();
        let tick = Instant::now() + Duration::from_millis(2);
        match select(can.receive(), Timer::at(tick)).await {
            Either::First(frame) => {
                received += 1;
                if received == 1 {
                    defmt::info!(
                        "first frame {=u16:#x} at {=u64} us",
                        frame.frame.id(),
                        frame.at.0
                    );
                }
            }
            Either::Second(()) => {}
        }
        if Instant::now() >= next {
            next += Duration::from_millis(100);
            let now = can.health();
            led::show(if now.bus_off {
                Pattern::Flickering
            } else {
                Pattern::Blinking
            });
            if now != health {
                defmt::warn!("{}", now);
                health = now;
            }
            if !can.try_send(&heartbeat) {
                can.mailbox_free().await;
            }
        }
    }
}
