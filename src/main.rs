//! The firmware of one robot.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod board;
#[cfg(target_os = "none")]
mod bus;
#[cfg(target_os = "none")]
mod control;
#[cfg(target_os = "none")]
mod handover;
#[cfg(target_os = "none")]
mod health;
#[cfg(target_os = "none")]
mod led;
#[cfg(target_os = "none")]
mod watchdog;

#[cfg(target_os = "none")]
use {defmt_rtt as _, embassy_executor as _};

#[cfg(target_os = "none")]
#[cortex_m_rt::entry]
fn main() -> ! {
    use board::{Board, executors, post_mortem};
    use defmt::unwrap;

    let board = Board::new();
    defmt::info!(
        "reset: {}, node {=u8}, uid {=[u8]:02x}",
        board.reset_cause,
        2 + board.node_switches,
        board.uid
    );
    if let Some(failure) = post_mortem::take() {
        defmt::error!("the last run ended with {}", failure);
    }

    executors::start_control().spawn(unwrap!(control::control(
        board.drive,
        board.encoders,
        board.driver_fault
    )));
    executors::bus().run(|bus| {
        bus.spawn(unwrap!(bus::bus(board.can, 2 + board.node_switches)));
        bus.spawn(unwrap!(watchdog::watchdog(board.watchdog)));
        bus.spawn(unwrap!(led::led(board.led)));
        bus.spawn(unwrap!(health::health()));
    })
}

/// On the host the firmware is an empty program, so that the workspace builds as a whole.
#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This is the firmware; build it with --target thumbv7em-none-eabihf.");
}
