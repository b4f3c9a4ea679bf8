//! The firmware of one robot.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod board;
#[cfg(target_os = "none")]
mod bus;
#[cfg(target_os = "none")]
mod control;

#[cfg(target_os = "none")]
use {defmt_rtt as _, embassy_executor as _};

#[cfg(target_os = "none")]
#[cortex_m_rt::entry]
fn main() -> ! {
    let board = board::Board::new();
    defmt::info!(
        "reset: {}, node {=u8}, uid {=[u8]:02x}",
        board.reset_cause,
        2 + board.node_switches,
        board.uid
    );

    let control = board::executors::start_control();
    control.spawn(defmt::unwrap!(control::control(
        board.drive,
        board.encoders,
        board.driver_fault
    )));
    board::executors::bus().run(|spawner| {
        spawner.spawn(defmt::unwrap!(bus::bus(
            board.can,
            2 + board.node_switches,
            board.led,
            board.watchdog
        )));
    })
}

/// On the host the firmware is an empty program, so that the workspace builds as a whole.
#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This is the firmware; build it with --target thumbv7em-none-eabihf.");
}
