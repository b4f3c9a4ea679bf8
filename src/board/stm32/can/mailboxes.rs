//! Between frames and the controller's registers.

use canopen::Frame;
use embassy_stm32::pac::can::regs;
use embassy_stm32::pac::can::vals::{Ide, Rtr};

use super::cable::leaving_mailbox;
use crate::board::family::bxcan::CAN;

/// A free mailbox, but for that of the frame of the cable, which has not been noticed yet.
pub(super) fn free() -> Option<u8> {
    let status = CAN.tsr().read();
    let Some(leaving) = leaving_mailbox() else {
        // RM0390 30.9.2: with at least one mailbox free, CODE is the number of the next free one.
        let any = status.tme(0) || status.tme(1) || status.tme(2);
        return any.then(|| status.code().min(2));
    };
    (0..3).find(|mailbox| status.tme(usize::from(*mailbox)) && leaving != *mailbox)
}

/// Asks for a frame to be sent through a free mailbox.
pub(super) fn request(mailbox: u8, frame: &Frame) {
    let mailbox = CAN.tx(usize::from(mailbox.min(2)));
    let [tir, tdtr, tdlr, tdhr] = words_of(frame);
    mailbox.tdtr().write_value(regs::Tdtr(tdtr));
    mailbox.tdlr().write_value(regs::Tdlr(tdlr));
    mailbox.tdhr().write_value(regs::Tdhr(tdhr));
    mailbox.tir().write_value(regs::Tir(tir));
}

/// What the registers TIR, TDTR, TDLR and TDHR hold for a frame to be sent.
#[inline(always)]
pub(super) fn words_of(frame: &Frame) -> [u32; 4] {
    let [a, b, c, d, e, f, g, h] = *frame.padded();
    let mut tir = regs::Tir(0);
    tir.set_stid(frame.id());
    tir.set_ide(Ide::STANDARD);
    tir.set_rtr(Rtr::DATA);
    tir.set_txrq(true);
    [
        tir.0,
        frame.len().into(),
        u32::from_le_bytes([a, b, c, d]),
        u32::from_le_bytes([e, f, g, h]),
    ]
}

/// The frame in the registers of a mailbox.
pub(super) fn frame_of(id: u16, length: u8, [low, high]: [u32; 2]) -> Frame {
    let data = (u64::from(high) << 32) | u64::from(low);
    Frame::prefix(id, data.to_le_bytes(), length)
}
