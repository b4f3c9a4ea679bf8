//! The gateway's part: frames of the cable on their way to the bus, and of the bus to the cable.
//!
//! One frame of the cable is in a mailbox at a time. It is received by this robot when it has left,
//! or when it is taken back.

use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

use can_text::slcan::flags;
use canopen::Frame;
use control::time::Micros;
use embassy_stm32::pac;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;

use super::mailboxes::{self, frame_of, request};
use super::{Can, QUEUE_OVERFLOWS, RX_QUEUE, Received, concerns_us};
use crate::board::now;
use crate::wake;

/// Frames of the bus for the cable.
static OVERHEARD: Channel<CriticalSectionRawMutex, Overheard, 32> = Channel::new();
/// The mailbox with a frame of the cable, and since when, the lower half of the time in
/// microseconds.
static LEAVING: AtomicU8 = AtomicU8::new(NONE);
static LEAVING_SINCE: AtomicU32 = AtomicU32::new(0);
pub(super) static GATEWAY: AtomicBool = AtomicBool::new(false);
/// A frame has left, and nothing since says that the bus is gone.
static JOINED: AtomicBool = AtomicBool::new(false);
/// Bus-off has come while others were on the bus.
static LEFT: AtomicBool = AtomicBool::new(false);
/// Frames of the bus that found no room on the way to the cable.
static OVERHEARD_LOST: AtomicBool = AtomicBool::new(false);
/// Frames of the cable that the bus was not even offered.
static NOT_OFFERED: AtomicBool = AtomicBool::new(false);

/// How long a frame of the cable may wait for the bus. One of low priority waits for some
/// milliseconds on a full bus.
pub const CABLE_PATIENCE: Micros = Micros(20_000);

/// [`LEAVING`]: no frame, for which [`RECEIVED`] is set too; the bits of the mailbox; the robot
/// itself has it already.
const NONE: u8 = u8::MAX;
const MAILBOX: u8 = 3;
const RECEIVED: u8 = 1 << 7;

/// A frame of the bus, for the cable.
#[derive(Clone, Copy)]
pub struct Overheard {
    /// When it was received, the lower half of the time in microseconds.
    pub at_us: u32,
    /// The frame.
    pub frame: Frame,
}

impl Can {
    /// Becomes a gateway, or is none any more.
    pub fn set_gateway(&mut self, on: bool) {
        GATEWAY.store(on, Ordering::Relaxed);
        while !on && OVERHEARD.try_receive().is_ok() {}
    }

    /// Takes the oldest frame of the bus for the cable, if there is one.
    pub fn try_overhear(&self) -> Option<Overheard> {
        OVERHEARD.try_receive().ok()
    }

    /// What was lost between cable and bus since the last call, as bits of an adapter's answer to
    /// `F`.
    pub fn take_losses(&self) -> u8 {
        let bit = |lost: &AtomicBool, flag| {
            if lost.swap(false, Ordering::Relaxed) {
                flag
            } else {
                0
            }
        };
        bit(&OVERHEARD_LOST, flags::RECEIVE_FULL) | bit(&NOT_OFFERED, flags::TRANSMIT_FULL)
    }

    /// What an adapter says of the controller, as bits of its answer to `F`.
    pub fn status_flags(&self) -> u8 {
        let error = pac::CAN1.esr().read();
        let bit = |on: bool, flag| if on { flag } else { 0 };
        bit(error.ewgf(), flags::WARNING)
            | bit(error.epvf(), flags::PASSIVE)
            | bit(error.boff(), flags::BUS_ERROR)
    }

    /// Whether the controller has gone off a bus on which others were, since the last call.
    pub fn has_been_left(&self) -> bool {
        LEFT.swap(false, Ordering::Relaxed)
    }

    /// Whether others are on the bus: a frame has left since nobody acknowledged one.
    pub fn is_joined(&self) -> bool {
        JOINED.load(Ordering::Relaxed)
    }

    /// Passes a frame of the cable on to the bus. The robot itself receives it when it has left;
    /// alone, at once. `None` while there is no free mailbox, of which the bus task is told;
    /// `false` when the robot has no room for it.
    pub fn pass_on(&mut self, frame: &Frame) -> Option<bool> {
        cortex_m::interrupt::free(|_| {
            if JOINED.load(Ordering::Relaxed) {
                return leave(frame, 0).then_some(true);
            }
            let received = receive_own(*frame);
            if LEAVING.load(Ordering::Relaxed) != NONE || !leave(frame, RECEIVED) {
                NOT_OFFERED.store(true, Ordering::Relaxed);
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
    /// at every turn, until nothing is on its way any more.
    pub fn look_after(&mut self) {
        cortex_m::interrupt::free(|_| {
            collect_sent();
            let error = pac::CAN1.esr().read();
            // ISO 11898-1: from 128 on a node is error passive.
            let gone = error.boff() || error.tec() >= 128;
            if gone && JOINED.swap(false, Ordering::Relaxed) && error.boff() {
                LEFT.store(true, Ordering::Relaxed);
            }
            let leaving = LEAVING.load(Ordering::Relaxed);
            if leaving == NONE {
                return;
            }
            let waited = low_us(now()).wrapping_sub(LEAVING_SINCE.load(Ordering::Relaxed));
            if u64::from(waited) > CABLE_PATIENCE.0 || gone && leaving & RECEIVED == 0 {
                let mailbox = usize::from(leaving & MAILBOX);
                pac::CAN1.tsr().write(|w| w.set_abrq(mailbox, true));
            }
        });
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "compared by wrapping differences"
)]
fn low_us(time: Micros) -> u32 {
    time.0 as u32
}

/// Offers a frame of the bus to the cable.
pub(super) fn overhear(at: Micros, frame: Frame) {
    let at_us = low_us(at);
    if OVERHEARD.try_send(Overheard { at_us, frame }).is_err() {
        OVERHEARD_LOST.store(true, Ordering::Relaxed);
    }
    wake::BUS.signal_cable_at_next_tick();
}

/// The mailbox of the frame of the cable, if there is one.
pub(super) fn leaving_mailbox() -> Option<u8> {
    let leaving = LEAVING.load(Ordering::Relaxed);
    (leaving != NONE).then_some(leaving & MAILBOX)
}

/// Receives a frame of the cable, if it concerns this robot; `false` when there is no room.
fn receive_own(frame: Frame) -> bool {
    let at = now();
    !concerns_us(frame.id()) || RX_QUEUE.try_send(Received { at, frame }).is_ok()
}

/// Puts a frame of the cable into a mailbox; `false` when all are taken. With interrupts masked, or
/// from the transmit interrupt, which comes when it has left, or when there is a free mailbox.
fn leave(frame: &Frame, received: u8) -> bool {
    pac::CAN1.ier().modify(|w| w.set_tmeie(true));
    let Some(mailbox) = mailboxes::free() else {
        return false;
    };
    request(mailbox, frame);
    LEAVING.store(mailbox | received, Ordering::Relaxed);
    LEAVING_SINCE.store(low_us(now()), Ordering::Relaxed);
    true
}

/// Notices which mailboxes are done, and receives the frame of the cable that has left. One that
/// was taken back is received too: the bus is gone. With interrupts masked, or from the transmit
/// interrupt.
pub(super) fn collect_sent() {
    let can = pac::CAN1;
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
        }
        let mailbox = can.tx(number);
        let frame = frame_of(
            mailbox.tir().read().stid(),
            mailbox.tdtr().read().dlc(),
            [mailbox.tdlr().read().0, mailbox.tdhr().read().0],
        );
        if leaving & RECEIVED == 0 && !frame.is_none_or(receive_own) {
            QUEUE_OVERFLOWS.fetch_add(1, Ordering::Relaxed);
        }
    }
}
