//! The controller's interrupts: a frame has come, a mailbox is done, error passive or bus-off.

use core::sync::atomic::Ordering;

use embassy_stm32::interrupt::typelevel::Handler;
use embassy_stm32::pac::can::regs;
use protocol::cob;

use super::arrivals;
use super::cable::{GATEWAY, collect_sent, leaving_mailbox, print_to_cable};
use super::mailboxes::frame_of;
use super::{
    CAN_WAIT, OVERRUNS, OWN_NODE, PASSIVE_AT, QUEUE_OVERFLOWS, RX_QUEUE, Received, VOTES_MISSING,
    concerns_us,
};
use crate::board::family::bxcan::{CAN, typelevel};
use crate::board::family::serial::IS_WIRED as CABLE_IS_WIRED;
use crate::board::now;
use crate::wake;

/// A frame has come.
pub struct RxHandler;

#[expect(unsafe_code, reason = "an interrupt handler is called by the hardware")]
impl Handler<typelevel::CAN1_RX0> for RxHandler {
    unsafe fn on_interrupt() {
        let can = CAN;
        loop {
            let fifo = can.rfr(0).read();
            if fifo.fovr() {
                OVERRUNS.fetch_add(1, Ordering::Relaxed);
                wake::BUS.signal();
                // The flags of this register are cleared by writing one, and only this one is to be
                // cleared.
                can.rfr(0).write(|w| w.set_fovr(true));
            }
            if fifo.fmp() == 0 {
                break;
            }
            let at = now();
            let mailbox = can.rx(0);
            let rir = mailbox.rir().read();
            let taken = !(is_gateway() || concerns_us(rir.stid()))
                || arrivals::put(
                    at,
                    [
                        rir.0,
                        mailbox.rdtr().read().0,
                        mailbox.rdlr().read().0,
                        mailbox.rdhr().read().0,
                    ],
                );
            can.rfr(0).write(|w| w.set_rfom(true));
            if !taken {
                QUEUE_OVERFLOWS.fetch_add(1, Ordering::Relaxed);
            }
            while can.rfr(0).read().rfom() {}
        }
    }
}

/// Whether frames of the bus go to the cable.
fn is_gateway() -> bool {
    CABLE_IS_WIRED && GATEWAY.load(Ordering::Relaxed)
}

/// There is something in the ring of [`arrivals`].
pub struct LaterHandler;

#[expect(unsafe_code, reason = "an interrupt handler is called by the hardware")]
impl Handler<typelevel::CAN1_RX1> for LaterHandler {
    unsafe fn on_interrupt() {
        while let Some((at, [rir, rdtr, low, high])) = arrivals::take() {
            if rir == arrivals::SENT {
                collect_sent(at);
                if leaving_mailbox().is_some() {
                    CAN.ier().modify(|w| w.set_tmeie(true));
                }
                wake::BUS.signal();
            } else {
                let (id, length) = (regs::Rir(rir).stid(), regs::Rdtr(rdtr).dlc());
                arrived(Received {
                    at,
                    frame: frame_of(id, length, [low, high]),
                });
            }
        }
    }
}

/// A frame goes to the cable and to the bus task, whichever wants it.
fn arrived(received: Received) {
    let id = received.frame.id();
    if is_gateway() {
        print_to_cable(&received.frame, received.at);
    }
    if !concerns_us(id) {
        return;
    }
    let taken = RX_QUEUE.try_send(received).is_ok();
    if !taken {
        QUEUE_OVERFLOWS.fetch_add(1, Ordering::Relaxed);
    }
    let own = id & 0x7F == OWN_NODE.load(Ordering::Relaxed);
    let can_wait = CAN_WAIT.load(Ordering::Relaxed) >> (id >> 7) & 1 == 1;
    if taken && !own && can_wait && !is_last_vote(id) {
        wake::BUS.signal_at_next_tick();
    } else {
        wake::BUS.signal();
    }
}

/// Whether this is the last of the votes that the bus task expects.
fn is_last_vote(id: u16) -> bool {
    let missing = VOTES_MISSING.load(Ordering::Relaxed);
    if missing == 0 || !matches!(cob::sent(id), Some((cob::Sent::Status, _))) {
        return false;
    }
    // The bus task does not run beside an interrupt, so load and store are one.
    VOTES_MISSING.store(missing - 1, Ordering::Relaxed);
    missing == 1
}

/// A mailbox is done.
pub struct TxHandler;

#[expect(unsafe_code, reason = "an interrupt handler is called by the hardware")]
impl Handler<typelevel::CAN1_TX> for TxHandler {
    unsafe fn on_interrupt() {
        // At the same point as the receive interrupt of the other robots: SYNC has one time.
        let at = now();
        CAN.ier().modify(|w| w.set_tmeie(false));
        if !arrivals::put(at, [arrivals::SENT, 0, 0, 0]) {
            // The bus task finds out by itself.
            wake::BUS.signal();
        }
    }
}

/// Error passive, or bus-off.
pub struct ErrorHandler;

#[expect(unsafe_code, reason = "an interrupt handler is called by the hardware")]
impl Handler<typelevel::CAN1_SCE> for ErrorHandler {
    unsafe fn on_interrupt() {
        // Error passive or bus-off. Flags of this register are cleared by writing one.
        CAN.msr().write(|w| w.set_erri(true));
        let error = CAN.esr().read();
        if error.epvf() {
            PASSIVE_AT.store(error.0, Ordering::Relaxed);
        }
        wake::BUS.signal();
    }
}
