//! The CAN controller (bxCAN, RM0390 rev 6 section 30), 1 Mbit/s.
//!
//! Frames arrive in one FIFO of three; the interrupt takes them out at once, stamps them with the
//! local time and puts them into [`RX_QUEUE`], from where the bus task takes them in order. One
//! FIFO, because with two the order of a setpoint and the SYNC that latches it would be lost. Two
//! things can overflow, and both are counted: the hardware FIFO (an overrun, only when interrupts
//! are held off for three frame times, 150 us at least) and the queue (when the bus task does not
//! run for 32 frames, at least 1.6 ms of back-to-back short frames).
//!
//! The interrupt drops frames of function codes that this robot does not use ([`Can::listen`]),
//! which costs a hundred cycles instead of a run of the bus task. It keeps all frames with the
//! robot's own node number, because only another robot with the same number sends them. The
//! controller's own filters are not used, because they can only be changed while it does not
//! receive. For frames that have no effect before the next SYNC the interrupt does not wake the bus
//! task: they wait for the control tick, which wakes it, or for the next frame that cannot wait. A
//! millisecond has at most 20 frames, so the queue can hold them.
//!
//! A robot that is a gateway ([`Can::set_gateway`]) passes frames of its cable on to the bus one at
//! a time, and takes each as received when it has left: the queue holds the frames of both sides in
//! the one order in which the bus has seen them, with the times at which the other nodes have got
//! them. A frame that does not leave (nobody acknowledges, bus-off, 20 ms) is taken back and
//! received then. Until a frame leaves again the controller counts as alone: frames of the cable
//! are received at once, and offered to the bus where there is room. All frames of the bus are kept
//! for the cable in a queue of their own, [`OVERHEARD`], so a storm of what concerns nobody here
//! costs the robot none of its own.
//!
//! Frames leave through three mailboxes in the order they were requested (`TXFP`), and are repeated
//! until they are acknowledged. While the mailboxes are full the sender keeps its frame; this
//! driver drops none.
//!
//! An interrupt reports error passive and bus-off and saves the error counters at that time,
//! because a good frame may end a period of error passive before the bus task reads them.
//!
//! After bus-off the controller stays off the bus until [`Can::recover`] is called; when, is the
//! caller's policy.
//!
//! Why not the HAL's driver: its buffered receiver silently drops a frame when its queue is full,
//! and its buffered sender loses the second of two frames with one identifier.

use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU16, AtomicU32, Ordering};

use can_text::slcan::flags;
use canopen::Frame;
use control::time::Micros;
use embassy_stm32::interrupt::InterruptExt;
use embassy_stm32::interrupt::typelevel::{self, Handler};
use embassy_stm32::pac::can::regs;
use embassy_stm32::pac::can::vals::{Ide, Rtr};
use embassy_stm32::{bind_interrupts, interrupt, pac};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use robot::CanErrors;

use super::pin::{Pull, Role, Speed};
use crate::board::{WIRING, now};
use crate::wake;

/// Frames the receive queue can hold.
pub const RX_QUEUE_LENGTH: usize = 32;

/// A frame with the local time at which the interrupt took it.
#[derive(Clone, Copy)]
pub struct Received {
    /// When the interrupt took it; a frame is complete on the wire some 2 us before.
    pub at: Micros,
    /// The frame.
    pub frame: Frame,
}

/// Error counts and states of the controller, since boot.
#[derive(Clone, Copy, PartialEq, Eq, defmt::Format)]
pub struct Health {
    /// Frames lost because the hardware FIFO was full.
    pub overruns: u32,
    /// Frames lost because the receive queue was full.
    pub queue_overflows: u32,
    /// Whether the controller is off the bus at the moment.
    pub bus_off: bool,
}

impl Health {
    /// Frames lost on reception since boot, for either reason.
    pub fn lost(&self) -> u32 {
        self.overruns.wrapping_add(self.queue_overflows)
    }
}

static RX_QUEUE: Channel<CriticalSectionRawMutex, Received, RX_QUEUE_LENGTH> = Channel::new();
/// Frames of the bus for the cable.
static OVERHEARD: Channel<CriticalSectionRawMutex, Overheard, 32> = Channel::new();
/// The mailbox with a frame of the cable, and since when, the lower half of the time in
/// microseconds.
static LEAVING: AtomicU8 = AtomicU8::new(NONE);
static LEAVING_SINCE: AtomicU32 = AtomicU32::new(0);
static GATEWAY: AtomicBool = AtomicBool::new(false);
/// A frame has left, and nothing since says that the bus is gone.
static JOINED: AtomicBool = AtomicBool::new(false);
/// Bus-off has come while others were on the bus.
static LEFT: AtomicBool = AtomicBool::new(false);
/// Frames of the bus that found no room on the way to the cable.
static OVERHEARD_LOST: AtomicBool = AtomicBool::new(false);
/// Frames of the cable that the bus was not even offered.
static NOT_OFFERED: AtomicBool = AtomicBool::new(false);
static LISTENS_TO: AtomicU16 = AtomicU16::new(u16::MAX);
static CAN_WAIT: AtomicU16 = AtomicU16::new(0);
static OWN_NODE: AtomicU16 = AtomicU16::new(0);
/// The error register as it was when the controller became error passive; 0 once it was read.
static PASSIVE_AT: AtomicU32 = AtomicU32::new(0);
static OVERRUNS: AtomicU32 = AtomicU32::new(0);
static QUEUE_OVERFLOWS: AtomicU32 = AtomicU32::new(0);

bind_interrupts!(struct Irqs {
    CAN1_RX0 => RxHandler;
    CAN1_TX => TxHandler;
    CAN1_SCE => ErrorHandler;
});

/// The bit rate.
const BIT_HZ: u32 = 1_000_000;

/// A time quantum in clocks of APB1: a fifteenth of a bit at 45 MHz, a fourteenth at 42 MHz.
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

/// The CAN controller.
pub struct Can(());

impl Can {
    /// Starts the controller. It joins the bus by itself after 11 recessive bits.
    pub fn new() -> Self {
        // Data sheet DS10693 rev 10, table 11; DS8626, table 9: CAN1 is alternate function 9.
        const CAN1_AF: u8 = 9;
        let crate::board::stm32f4::wiring::Can { receive, transmit } = WIRING.can;
        receive.become_a(Role::PeripheralInput(CAN1_AF, Pull::Up));
        transmit.become_a(Role::PeripheralOutput(CAN1_AF, Pull::None, Speed::VeryHigh));

        pac::RCC.apb1enr().modify(|w| w.set_can1en(true));
        let can = pac::CAN1;
        can.mcr().write(|w| {
            w.set_inrq(true);
            w.set_abom(false); // after bus-off, back on the bus when asked to, see `recover`
            w.set_txfp(true); // mailboxes leave in the order of request
        });
        while !can.msr().read().inak() {}

        // At 45 MHz one bit is 1 (sync) + 12 + 2 = 15 quanta, sampled after 13 of 15: 86.7 %.
        // Bosch, CAN 2.0 part A, oscillator tolerance: each clock may be off by SJW / (20 x 15) =
        // 0.67 % while frames go well and 2 / (2 x (13 x 15 - 2)) = 0.52 % through an error frame.
        // Every field holds one less than its value.
        const SEGMENT_1: u8 = QUANTA as u8 - 1 - SEGMENT_2;
        can.btr().write(|w| {
            w.set_brp(PRESCALER - 1);
            w.set_ts(0, SEGMENT_1 - 1);
            w.set_ts(1, SEGMENT_2 - 1);
            w.set_sjw(JUMP_WIDTH - 1);
        });

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
        can.fmr().modify(|w| w.set_finit(false));

        can.ier().write(|w| {
            w.set_fmpie(0, true);
            w.set_fovie(0, true);
            w.set_epvie(true);
            w.set_bofie(true);
            w.set_errie(true);
        });
        let _ = Irqs;
        interrupt::CAN1_RX0.unpend();
        interrupt::CAN1_TX.unpend();
        interrupt::CAN1_SCE.unpend();
        enable_interrupts();

        can.mcr().modify(|w| w.set_inrq(false));
        Self(())
    }

    /// From now on takes frames of these function codes only, one bit for each (bit n: identifiers
    /// from 128 n on), and those with this node number; frames of the second set wait for the tick.
    /// Before the first call all frames are received, at once.
    pub fn listen(&self, function_codes: u16, node: u8, can_wait: u16) {
        OWN_NODE.store(node.into(), Ordering::Relaxed);
        LISTENS_TO.store(function_codes, Ordering::Relaxed);
        CAN_WAIT.store(can_wait, Ordering::Relaxed);
    }

    /// Takes the oldest received frame, if there is one.
    pub fn try_receive(&self) -> Option<Received> {
        RX_QUEUE.try_receive().ok()
    }

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
            note_left();
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

    /// Puts a frame into a free mailbox; `false` when all three are taken. Then the bus task is
    /// woken when one is free.
    #[must_use]
    pub fn try_send(&mut self, frame: &Frame) -> bool {
        // Masked: the transmit interrupt takes mailboxes for frames of the cable.
        cortex_m::interrupt::free(|_| {
            let Some(mailbox) = free_mailbox() else {
                // Comes at once if a mailbox has become free since.
                pac::CAN1.ier().modify(|w| w.set_tmeie(true));
                return false;
            };
            request(mailbox, frame);
            true
        })
    }

    /// Aborts the frames that wait in mailboxes.
    pub fn discard(&mut self) {
        pac::CAN1.tsr().write(|w| {
            w.set_abrq(0, true);
            w.set_abrq(1, true);
            w.set_abrq(2, true);
        });
    }

    /// Begins the recovery from bus-off, which is complete after 128 times 11 recessive bits.
    ///
    /// RM0390 30.7.6: without ABOM, software has to enter and to leave initialisation mode.
    pub fn recover(&mut self) {
        let can = pac::CAN1;
        can.mcr().modify(|w| w.set_inrq(true));
        // Off the bus there is no frame to wait for, so this takes a few cycles. The bound is for a
        // broken chip.
        const CYCLES: u32 = 1_000;
        let _ = (0..CYCLES).find(|_| can.msr().read().inak());
        can.mcr().modify(|w| w.set_inrq(false));
    }

    /// Returns the error counters: those of the moment at which the controller became error passive
    /// if it has since the last call, even if a good frame has followed.
    pub fn errors(&self) -> CanErrors {
        let error = match PASSIVE_AT.load(Ordering::Relaxed) {
            0 => pac::CAN1.esr().read(),
            passive => {
                PASSIVE_AT.store(0, Ordering::Relaxed);
                regs::Esr(passive)
            }
        };
        CanErrors {
            transmit: error.tec(),
            receive: error.rec(),
            // RM0390 30.9.2: 7 is what software writes; a good frame sets 0.
            last: error.lec().to_bits() % 7,
        }
    }

    /// Returns the error counts and states.
    pub fn health(&self) -> Health {
        let error = pac::CAN1.esr().read();
        Health {
            overruns: OVERRUNS.load(Ordering::Relaxed),
            queue_overflows: QUEUE_OVERFLOWS.load(Ordering::Relaxed),
            bus_off: error.boff(),
        }
    }
}

#[expect(
    unsafe_code,
    reason = "enabling an interrupt can break a critical section"
)]
fn enable_interrupts() {
    // SAFETY: called once at start-up, outside any critical section that these handlers could
    // break.
    unsafe {
        interrupt::CAN1_RX0.enable();
        interrupt::CAN1_TX.enable();
        interrupt::CAN1_SCE.enable();
    }
}

/// A free mailbox, but for that of the frame of the cable, which nobody has noticed yet.
fn free_mailbox() -> Option<u8> {
    let status = pac::CAN1.tsr().read();
    let leaving = LEAVING.load(Ordering::Relaxed);
    if leaving == NONE {
        // RM0390 30.9.2: with at least one mailbox free, CODE is the number of the next free one.
        let any = status.tme(0) || status.tme(1) || status.tme(2);
        return any.then(|| status.code().min(2));
    }
    (0..3).find(|mailbox| {
        status.tme(usize::from(*mailbox)) && (leaving == NONE || leaving & MAILBOX != *mailbox)
    })
}

/// Asks for a frame to be sent through a free mailbox.
fn request(mailbox: u8, frame: &Frame) {
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

/// Whether this robot wants to see frames with this identifier.
fn concerns_us(id: u16) -> bool {
    id & 0x7F == OWN_NODE.load(Ordering::Relaxed)
        || LISTENS_TO.load(Ordering::Relaxed) >> (id >> 7) & 1 == 1
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "compared by wrapping differences"
)]
fn low_us(time: Micros) -> u32 {
    time.0 as u32
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
    let Some(mailbox) = free_mailbox() else {
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
fn note_left() {
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

/// The frame in the registers of a mailbox.
fn frame_of(id: u16, length: u8, [low, high]: [u32; 2]) -> Option<Frame> {
    let data = ((u64::from(high) << 32) | u64::from(low)).to_le_bytes();
    let length = usize::from(length).min(data.len());
    Frame::new(id, &data[..length])
}

struct RxHandler;

#[expect(unsafe_code, reason = "an interrupt handler is called by the hardware")]
impl Handler<typelevel::CAN1_RX0> for RxHandler {
    unsafe fn on_interrupt() {
        let can = pac::CAN1;
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
            let gateway = GATEWAY.load(Ordering::Relaxed);
            let frame = if wanted || gateway {
                frame_of(
                    id,
                    mailbox.rdtr().read().dlc(),
                    [mailbox.rdlr().read().0, mailbox.rdhr().read().0],
                )
            } else {
                None
            };
            can.rfr(0).write(|w| w.set_rfom(true));
            while can.rfr(0).read().rfom() {}
            let Some(frame) = frame else { continue };
            if gateway {
                let at_us = low_us(at);
                if OVERHEARD.try_send(Overheard { at_us, frame }).is_err() {
                    OVERHEARD_LOST.store(true, Ordering::Relaxed);
                }
                wake::BUS.signal_at_next_tick();
            }
            if wanted {
                let taken = RX_QUEUE.try_send(Received { at, frame }).is_ok();
                if !taken {
                    QUEUE_OVERFLOWS.fetch_add(1, Ordering::Relaxed);
                }
                if taken && !own && is_in(&CAN_WAIT) {
                    wake::BUS.signal_at_next_tick();
                } else {
                    wake::BUS.signal();
                }
            }
        }
    }
}

struct TxHandler;

#[expect(unsafe_code, reason = "an interrupt handler is called by the hardware")]
impl Handler<typelevel::CAN1_TX> for TxHandler {
    unsafe fn on_interrupt() {
        pac::CAN1.ier().modify(|w| w.set_tmeie(false));
        note_left();
        if LEAVING.load(Ordering::Relaxed) != NONE {
            pac::CAN1.ier().modify(|w| w.set_tmeie(true));
        }
        wake::BUS.signal();
    }
}

struct ErrorHandler;

#[expect(unsafe_code, reason = "an interrupt handler is called by the hardware")]
impl Handler<typelevel::CAN1_SCE> for ErrorHandler {
    unsafe fn on_interrupt() {
        // Error passive or bus-off. Flags of this register are cleared by writing one.
        pac::CAN1.msr().write(|w| w.set_erri(true));
        let error = pac::CAN1.esr().read();
        if error.epvf() {
            PASSIVE_AT.store(error.0, Ordering::Relaxed);
        }
        wake::BUS.signal();
    }
}
