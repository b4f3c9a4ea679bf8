//! The gateway's part: frames of the cable on their way to the bus, and of the bus to the cable.
//!
//! One frame of the cable is in a mailbox at a time. It is received by this robot when it has left,
//! or when it is taken back. A frame of the bus is printed into the port's ring by an
//! interrupt weaker than the control tick, and no task is woken for it.

use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

use can_text::slcan::{self, STAMP_PERIOD_MS, flags};
use canopen::Frame;
use control::time::Micros;

use super::mailboxes::{self, frame_of, request};
use super::{Can, QUEUE_OVERFLOWS, RX_QUEUE, Received, concerns_us};
use crate::board::family::bxcan::CAN;
use crate::board::family::serial;
use crate::board::now;

/// The mailbox with a frame of the cable, and since when, the lower half of the time in
/// microseconds.
static LEAVING: AtomicU8 = AtomicU8::new(NONE);
static LEAVING_SINCE: AtomicU32 = AtomicU32::new(0);
pub(super) static GATEWAY: AtomicBool = AtomicBool::new(false);
/// Frames go to the cable with time stamps.
static STAMPS: AtomicBool = AtomicBool::new(false);
/// A frame has left, and nothing since says that the bus is gone.
static JOINED: AtomicBool = AtomicBool::new(false);
/// Bus-off has come while others were on the bus.
static LEFT: AtomicBool = AtomicBool::new(false);
/// Frames of the cable that have not left for the bus, or that this robot had no room for.
static NOT_PASSED_ON: AtomicU32 = AtomicU32::new(0);

/// How long a frame of the cable may wait for the bus. One of low priority waits for some
/// milliseconds on a full bus.
pub const CABLE_PATIENCE: Micros = Micros(20_000);

/// [`LEAVING`]: no frame, for which [`RECEIVED`] is set too; the bits of the mailbox; the robot
/// itself has it already.
const NONE: u8 = u8::MAX;
const MAILBOX: u8 = 3;
const RECEIVED: u8 = 1 << 7;

impl Can {
    /// Becomes a gateway, or is none any more; with time stamps or without.
    pub fn set_gateway(&mut self, on: bool, stamps: bool) {
        STAMPS.store(stamps, Ordering::Relaxed);
        GATEWAY.store(on, Ordering::Relaxed);
    }

    /// Frames of the cable that have not left for the bus, or that this robot had no room for,
    /// since the start, wrapping.
    pub fn not_passed_on(&self) -> u32 {
        NOT_PASSED_ON.load(Ordering::Relaxed)
    }

    /// What an adapter says of the controller, as bits of its answer to `F`.
    pub fn status_flags(&self) -> u8 {
        let error = CAN.esr().read();
        let bit = |on: bool, flag| if on { flag } else { 0 };
        bit(error.ewgf(), flags::WARNING)
            | bit(error.epvf(), flags::PASSIVE)
            | bit(error.boff(), flags::BUS_ERROR)
    }

    /// Whether the controller has gone off a bus on which others were, since the last call.
    pub fn has_been_left(&self) -> bool {
        LEFT.load(Ordering::Relaxed) && LEFT.swap(false, Ordering::Relaxed)
    }

    /// Whether others are on the bus: a frame has left since one was not acknowledged.
    pub fn is_joined(&self) -> bool {
        JOINED.load(Ordering::Relaxed)
    }

    /// Passes a frame of the cable on to the bus. The robot itself receives it when it has left;
    /// alone, at once. `None` while there is no free mailbox, which the bus task learns; `false`
    /// when the robot has no room for it.
    pub fn pass_on(&mut self, frame: &Frame) -> Option<bool> {
        cortex_m::interrupt::free(|_| {
            if JOINED.load(Ordering::Relaxed) {
                return leave(frame, 0).then_some(true);
            }
            let received = receive_own(now(), *frame);
            if LEAVING.load(Ordering::Relaxed) != NONE || !leave(frame, RECEIVED) || !received {
                NOT_PASSED_ON.fetch_add(1, Ordering::Relaxed);
            }
            Some(received)
        })
    }

    /// Whether a frame of the cable is on its way that the robot itself has not received.
    pub fn is_passing_on(&self) -> bool {
        LEAVING.load(Ordering::Relaxed) & RECEIVED == 0
    }

    /// Whether a frame of the cable is in a mailbox.
    pub fn has_one_of_the_cable(&self) -> bool {
        LEAVING.load(Ordering::Relaxed) != NONE
    }

    /// Counts as alone until a frame leaves.
    pub fn give_up(&mut self) {
        JOINED.store(false, Ordering::Relaxed);
    }

    /// Notices what has left, and takes back a frame of the cable that does not leave. To be called
    /// at every turn while one is on its way, and before [`Can::is_joined`] is asked.
    pub fn look_after(&mut self) {
        cortex_m::interrupt::free(|_| {
            let at = now();
            collect_sent(at);
            let error = CAN.esr().read();
            // ISO 11898-1: from 128 on a node is error passive.
            let gone = error.boff() || error.tec() >= 128;
            if gone && JOINED.swap(false, Ordering::Relaxed) && error.boff() {
                LEFT.store(true, Ordering::Relaxed);
            }
            let leaving = LEAVING.load(Ordering::Relaxed);
            if leaving == NONE {
                return;
            }
            let waited = low_us(at).wrapping_sub(LEAVING_SINCE.load(Ordering::Relaxed));
            if u64::from(waited) > CABLE_PATIENCE.0 || gone && leaving & RECEIVED == 0 {
                let mailbox = usize::from(leaving & MAILBOX);
                CAN.tsr().write(|w| w.set_abrq(mailbox, true));
            }
        });
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "compared by wrapping differences"
)]
pub(super) fn low_us(time: Micros) -> u32 {
    time.0 as u32
}

/// Writes a frame into the ring of the port, with its time if stamps are wanted.
pub fn print_to_cable(frame: &Frame, at: Micros) {
    let stamp = STAMPS.load(Ordering::Relaxed).then(|| stamp(at));
    serial::put(|line| slcan::print(frame, stamp, line));
}

/// A time as a time stamp.
fn stamp(at: Micros) -> u16 {
    u16::try_from(at.0 / 1_000 % u64::from(STAMP_PERIOD_MS)).unwrap_or(0)
}

/// The mailbox of the frame of the cable, if there is one.
pub(super) fn leaving_mailbox() -> Option<u8> {
    let leaving = LEAVING.load(Ordering::Relaxed);
    (leaving != NONE).then_some(leaving & MAILBOX)
}

/// Receives a frame of the cable at `at`, if it concerns this robot; `false` when there is no room.
fn receive_own(at: Micros, frame: Frame) -> bool {
    !concerns_us(frame.id()) || RX_QUEUE.try_send(Received { at, frame }).is_ok()
}

/// Puts a frame of the cable into a mailbox; `false` when all are taken. With interrupts masked.
/// The transmit interrupt comes when it has left, or when there is a free mailbox.
fn leave(frame: &Frame, received: u8) -> bool {
    CAN.ier().modify(|w| w.set_tmeie(true));
    let Some(mailbox) = mailboxes::free() else {
        return false;
    };
    request(mailbox, frame);
    LEAVING.store(mailbox | received, Ordering::Relaxed);
    LEAVING_SINCE.store(low_us(now()), Ordering::Relaxed);
    true
}

/// Notices which mailboxes are done, and receives the frame of the cable that has left. One that
/// was taken back is received too: the bus is gone. With interrupts masked, or from the weaker
/// interrupt; `at` is when the transmit interrupt came.
pub(super) fn collect_sent(at: Micros) {
    let can = CAN;
    let status = can.tsr().read();
    for mailbox in 0..3_u8 {
        let number = usize::from(mailbox);
        if !status.rqcp(number) {
            continue;
        }
        // Flags of this register are cleared by writing one.
        can.tsr().write(|w| w.set_rqcp(number, true));
        let left = status.txok(number);
        if left {
            JOINED.store(true, Ordering::Relaxed);
        }
        let leaving = LEAVING.load(Ordering::Relaxed);
        if leaving == NONE || leaving & MAILBOX != mailbox {
            continue;
        }
        LEAVING.store(NONE, Ordering::Relaxed);
        if !left {
            JOINED.store(false, Ordering::Relaxed);
            NOT_PASSED_ON.fetch_add(1, Ordering::Relaxed);
        }
        let mailbox = can.tx(number);
        let frame = frame_of(
            mailbox.tir().read().stid(),
            mailbox.tdtr().read().dlc(),
            [mailbox.tdlr().read().0, mailbox.tdhr().read().0],
        );
        if leaving & RECEIVED == 0 && !receive_own(at, frame) {
            QUEUE_OVERFLOWS.fetch_add(1, Ordering::Relaxed);
        }
    }
}
