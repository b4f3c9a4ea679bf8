//! Between frames and the controller's registers.

use canopen::Frame;
use embassy_stm32::pac;
use embassy_stm32::pac::can::regs;
use embassy_stm32::pac::can::vals::{Ide, Rtr};

use super::cable::leaving_mailbox;

/// A free mailbox, but for that of the frame of the cable, which nobody has noticed yet.
pub(super) fn free() -> Option<u8> {
    let status = pac::CAN1.tsr().read();
    let Some(leaving) = leaving_mailbox() else {
        // RM0390 30.9.2: with at least one mailbox free, CODE is the number of the next free one.
        let any = status.tme(0) || status.tme(1) || status.tme(2);
        return any.then(|| status.code().min(2));
    };
    (0..3).find(|mailbox| status.tme(usize::from(*mailbox)) && leaving != *mailbox)
}

/// Asks for a frame to be sent through a free mailbox.
pub(super) fn request(mailbox: u8, frame: &Frame) {
    let mailbox = pac::CAN1.tx(usize::from(mailbox.min(2)));
    let [a, b, c, d, e, f, g, h] = *frame.padded();
    mailbox.tdtr().write(|w| w.set_dlc(frame.len()));
    mailbox
        .tdlr()
        .write_value(regs::Tdlr(u32::from_le_bytes([a, b, c, d])));
    mailbox
        .tdhr()
        .write_value(regs::Tdhr(u32::from_le_bytes([e, f, g, h])));
    mailbox.tir().write(|w| {
        w.set_stid(frame.id());
        w.set_ide(Ide::STANDARD);
        w.set_rtr(Rtr::DATA);
        w.set_txrq(true);
    });
}

/// The frame in the registers of a mailbox.
pub(super) fn frame_of(id: u16, length: u8, [low, high]: [u32; 2]) -> Frame {
    let data = (u64::from(high) << 32) | u64::from(low);
    Frame::prefix(id, data.to_le_bytes(), length)
}
