//! Brings the controller up: pins, bit timing, filter, interrupts.

use embassy_stm32::interrupt::InterruptExt;
use embassy_stm32::pac::can::regs;

use super::Can;
use crate::board::WIRING;
use crate::board::family::bxcan::{self, CAN, CAN1_RX0, CAN1_RX1, CAN1_SCE, CAN1_TX};
use crate::board::family::drives;
use crate::board::stm32::pin::{Pull, Role, Speed};

/// The bit rate.
const BIT_HZ: u32 = 1_000_000;

/// A time quantum in clocks of APB1: a fifteenth of a bit at 45 MHz, a twelfth at 36 MHz.
const PRESCALER: u16 = 3;

/// Time quanta behind the sample, of [`QUANTA`]; the first is the synchronisation's, all others lie
/// before the sample.
const SEGMENT_2: u8 = 2;

/// Largest step of resynchronisation, in quanta.
const JUMP_WIDTH: u8 = 2;

/// Time quanta in a bit.
const QUANTA: u32 = {
    let quantum_hz = WIRING.clocks.apb1_hz() / PRESCALER as u32;
    assert!(
        quantum_hz.is_multiple_of(BIT_HZ)
            && quantum_hz * PRESCALER as u32 == WIRING.clocks.apb1_hz(),
        "the clock of APB1 gives no 1 Mbit/s"
    );
    quantum_hz / BIT_HZ
};

impl Can {
    /// Starts the controller. It joins the bus by itself after 11 recessive bits.
    pub fn new() -> Self {
        // Data sheet DS10693 rev 10, table 11; DS8626, table 9: CAN1 is alternate function 9.
        const CAN1_AF: u8 = 9;
        let crate::board::stm32::wiring::Can { receive, transmit } = WIRING.can;
        receive.become_a(Role::PeripheralInput(CAN1_AF, Pull::Up));
        transmit.become_a(Role::PeripheralOutput(CAN1_AF, Pull::None, Speed::VeryHigh));

        bxcan::clock();
        let can = CAN;
        can.mcr().write(|w| {
            w.set_inrq(true);
            w.set_abom(false); // after bus-off, back on the bus when asked to, see `recover`
            w.set_txfp(true); // mailboxes leave in the order of request
        });
        while !can.msr().read().inak() {}

        can.btr().write(bit_timing);

        // One filter, 32 bits wide, mask mode, into FIFO 0: any data frame with an 11-bit
        // identifier.
        can.fmr().modify(|w| w.set_finit(true));
        can.fa1r().write_value(regs::Fa1r(0));
        can.fm1r().write_value(regs::Fm1r(0));
        can.fs1r().modify(|w| w.set_fsc(0, true));
        can.ffa1r().write_value(regs::Ffa1r(0));
        const IDE_AND_RTR: u32 = 0b110;
        can.fb(0).fr1().write_value(regs::Fr1(0));
        can.fb(0).fr2().write_value(regs::Fr2(IDE_AND_RTR));
        can.fa1r().modify(|w| w.set_fact(0, true));
        drives::set_filter();
        can.fmr().modify(|w| w.set_finit(false));

        can.ier().write(|w| {
            w.set_fmpie(0, true);
            w.set_fovie(0, true);
            w.set_epvie(true);
            w.set_bofie(true);
            w.set_errie(true);
        });
        CAN1_RX0.unpend();
        CAN1_RX1.unpend();
        CAN1_TX.unpend();
        CAN1_SCE.unpend();
        enable_interrupts();

        can.mcr().modify(|w| w.set_inrq(false));
        Self(())
    }
}

/// The bit timing of both controllers.
///
/// At 45 MHz one bit is 1 (sync) + 12 + 2 = 15 quanta, sampled after 13 of 15: 86.7 %. Bosch, CAN
/// 2.0 part A, oscillator tolerance: each clock may be off by SJW / (20 x 15) = 0.67 % while frames
/// go well and 2 / (2 x (13 x 15 - 2)) = 0.52 % through an error frame. Every field holds one less
/// than its value.
pub fn bit_timing(w: &mut regs::Btr) {
    const SEGMENT_1: u8 = QUANTA as u8 - 1 - SEGMENT_2;
    w.set_brp(PRESCALER - 1);
    w.set_ts(0, SEGMENT_1 - 1);
    w.set_ts(1, SEGMENT_2 - 1);
    w.set_sjw(JUMP_WIDTH - 1);
}

#[expect(
    unsafe_code,
    reason = "enabling an interrupt can break a critical section"
)]
fn enable_interrupts() {
    // SAFETY: called once at start-up, outside any critical section that these handlers could
    // break.
    unsafe {
        CAN1_RX0.enable();
        CAN1_RX1.enable();
        CAN1_TX.enable();
        CAN1_SCE.enable();
    }
}
