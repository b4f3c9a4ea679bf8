//! The controller's interrupts: a frame has come, a mailbox is done, error passive or bus-off.

use core::sync::atomic::{AtomicU16, Ordering};

use embassy_stm32::interrupt::typelevel::Handler;

use protocol::cob;

use super::cable::{GATEWAY, collect_sent, leaving_mailbox, print_to_cable};
use super::mailboxes::frame_of;
use super::{
    CAN_WAIT, LISTENS_TO, OVERRUNS, OWN_NODE, PASSIVE_AT, QUEUE_OVERFLOWS, RX_QUEUE, Received,
    VOTES_MISSING,
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
            let id = mailbox.rir().read().stid();
            let is_in = |codes: &AtomicU16| codes.load(Ordering::Relaxed) >> (id >> 7) & 1 == 1;
            let own = id & 0x7F == OWN_NODE.load(Ordering::Relaxed);
            let wanted = own || is_in(&LISTENS_TO);
            let gateway = CABLE_IS_WIRED && GATEWAY.load(Ordering::Relaxed);
            let frame = (wanted || gateway).then(|| {
                frame_of(
                    id,
                    mailbox.rdtr().read().dlc(),
                    [mailbox.rdlr().read().0, mailbox.rdhr().read().0],
                )
            });
            can.rfr(0).write(|w| w.set_rfom(true));
            while can.rfr(0).read().rfom() {}
            let Some(frame) = frame else { continue };
            if gateway {
                print_to_cable(&frame, at);
            }
            if wanted {
                let taken = RX_QUEUE.try_send(Received { at, frame }).is_ok();
                if !taken {
                    QUEUE_OVERFLOWS.fetch_add(1, Ordering::Relaxed);
                }
                if taken && !own && is_in(&CAN_WAIT) && !is_last_vote(id) {
                    wake::BUS.signal_at_next_tick();
                } else {
                    wake::BUS.signal();
                }
            }
        }
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
        CAN.ier().modify(|w| w.set_tmeie(false));
        collect_sent();
        if leaving_mailbox().is_some() {
            CAN.ier().modify(|w| w.set_tmeie(true));
        }
        wake::BUS.signal();
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
