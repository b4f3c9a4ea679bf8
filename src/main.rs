//! The firmware of one robot: tasks that connect a board to `robot` and `control`.
//!
//! There are two executors. The tasks of the bus side share one in thread mode; the control side
//! has its own in an interrupt and preempts them (`board::executors` has the priorities). Decisions
//! are made in `robot` and `control`, and registers are accessed in `board`; this crate defines
//! only when each task wakes and what the tasks exchange.
//!
//! # Tasks
//!
//! | task | executor | wakes | does |
//! |---|---|---|---|
//! | [`bus_task`] | bus | a frame, bytes of the cable, a deadline, a free mailbox, at least every 5 ms | CANopen, agreement, state machine, parameter store, [`gateway`] between cable and CAN |
//! | [`led`] | bus | as its pattern asks | shows the state on LD2 |
//! | [`health`] | bus | every second | logs stack use and lateness when they get worse |
//! | [`control`] | control | TIM7 every millisecond, in step with SYNC | encoders, wheel loops, PWM, brake; feeds the [`watchdog`] while both sides run |
//!
//! # Channels
//!
//! | from | to | channel | can overflow | then |
//! |---|---|---|---|---|
//! | CAN receive, transmit interrupt | weaker CAN interrupt | ring of 8 frames | yes | newest dropped, counted, fault "receive overrun" |
//! | weaker CAN interrupt | bus | queue of 32 frames | yes | newest dropped, counted, fault "receive overrun" |
//! | weaker CAN interrupt, bus | cable | ring of 512 bytes | yes | newest dropped, reported by `F` |
//! | cable | bus | ring of 256 bytes | yes | all of it and the line it ends in dropped, reported by `F` |
//! | bus | CAN mailbox | one frame of the cable; the others stay in its ring | no | |
//! | bus | CAN mailboxes | one frame waiting, then the queues of `robot` | those, yes | newest dropped, counted |
//! | bus | control | [`shared`]: command, SYNC time | no, the latest wins | |
//! | bus | control | configuration, applied by a call between two ticks | no | |
//! | control | bus | [`shared`]: report | no, the latest wins | |
//! | CAN interrupts, control | bus | [`wake`]: a signal | no, one is enough | |
//! | bus | control | [`shared`]: count of turns | no | no progress: the watchdog is not fed, reset |
//! | bus | led | pattern | no, the latest wins | |
//! | control | health | [`shared`]: worst lateness | no | |
//! | all tasks | debugger | RTT, 1024 bytes of defmt | yes | the log loses lines; no task waits for it, in any mode that a debugger has left |
//!
//! # Limits
//!
//! On the host this is an empty program, so that the workspace builds as a whole.
#![cfg_attr(target_os = "none", no_std, no_main)]
#![cfg_attr(
    all(target_os = "none", any(feature = "self-test", feature = "sketch")),
    expect(dead_code, reason = "these images have the board, and no robot")
)]

#[cfg(target_os = "none")]
mod board;
#[cfg(robot)]
mod bus_task;
#[cfg(robot)]
mod control;
#[cfg(robot)]
mod gateway;
#[cfg(robot)]
mod health;
#[cfg(robot)]
mod led;
#[cfg(all(target_os = "none", feature = "self-test"))]
mod self_test;
#[cfg(robot)]
mod shared;
#[cfg(all(target_os = "none", feature = "sketch"))]
mod sketch;
#[cfg(robot)]
mod start;
#[cfg(robot)]
mod update;
#[cfg(robot)]
mod wake;
#[cfg(robot)]
mod watchdog;

#[cfg(target_os = "none")]
use defmt_rtt as _;

#[cfg(target_os = "none")]
#[cortex_m_rt::entry]
fn main() -> ! {
    #[cfg(feature = "self-test")]
    self_test::run();
    #[cfg(feature = "sketch")]
    sketch::run();
    #[cfg(not(any(feature = "self-test", feature = "sketch")))]
    start::start()
}

/// Says what this is good for.
#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This is the firmware of a robot; build it with --target thumbv7em-none-eabihf.");
}
