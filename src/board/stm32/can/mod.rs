//! The CAN controller (bxCAN, RM0390 rev 6 section 30), 1 Mbit/s.
//!
//! # Receiving
//!
//! Frames arrive in one FIFO of three; the interrupt takes them out at once and stamps them with
//! the local time. A second, weaker interrupt ([`arrivals`]) puts them into [`RX_QUEUE`], from
//! where the bus task takes them in order: a control tick need not wait for that. One FIFO, because
//! with two the order of a setpoint and the SYNC that latches it would be lost. Two things can
//! overflow, and both are counted: the hardware FIFO (an overrun, only when interrupts are held off
//! for three frame times, 140 us at least) and the queue (when the bus task does not run for 32
//! frames, at least 1.5 ms of back-to-back empty frames).
//!
//! The first interrupt drops frames of function codes that this robot does not use
//! ([`Can::listen`]), which costs a hundred cycles instead of a run of the bus task. It keeps all
//! frames with the robot's own node number, because only another robot with the same number sends
//! them. The controller's own filters are not used, because they can only be changed while it does
//! not receive. For frames that have no effect before the next SYNC the interrupt does not wake the
//! bus task: they wait for the control tick, which wakes it, or for the next frame that cannot
//! wait. So do the members' votes but the last one ([`Can::expect_votes`]), with which the group
//! decides. A millisecond has at most 20 frames, so the queue can hold them.
//!
//! # Gateway
//!
//! A robot that is a gateway ([`Can::set_gateway`]) passes frames of its cable on to the bus one at
//! a time, and receives each itself when it has left: the queue holds the frames of both sides in
//! the one order in which the bus has seen them, with the times at which the other nodes received
//! them. A frame that does not leave (no acknowledgement, bus-off, 20 ms) is taken back and
//! received then. Until a frame leaves again the controller counts as alone: frames of the cable
//! are received at once, and offered to the bus where there is room. The weaker interrupt prints
//! all frames of the bus into the ring of the cable's port, so a storm of frames that this robot
//! does not use displaces none that it does.
//!
//! All robots take the time of a frame from the local time at the begin of an interrupt, the
//! gateway for its own frames too. Simulated, both interrupts come at the end of the frame. A real
//! sender may be a bit time (1 us) later than the receivers: to them a frame is valid at the last
//! but one bit of its end, to the sender at the last (ISO 11898-1; RM0390 30.7.3 says so of
//! reception, and of transmission nothing). So 1 us of a gateway's time is not known before it is
//! measured.
//!
//! # Sending
//!
//! Frames leave through three mailboxes in the order they were requested (`TXFP`), and are repeated
//! until they are acknowledged. While the mailboxes are full the sender keeps its frame; this
//! driver drops none.
//!
//! # Errors on the bus
//!
//! An interrupt reports error passive and bus-off and saves the error counters at that time,
//! because a good frame may end a period of error passive before the bus task reads them. After
//! bus-off the controller stays off the bus until [`Can::recover`] is called; the caller decides
//! when.
//!
//! # Files
//!
//! This file has what the bus task calls; `start` brings the controller up, `cable` is the
//! gateway's part, `mailboxes` is between frames and registers, `interrupts` takes frames in,
//! [`arrivals`] lies between its stronger and its weaker part, [`away`] answers while the flash is
//! erased.
//!
//! # Why not the HAL's driver
//!
//! Its buffered receiver silently drops a frame when its queue is full, and its buffered sender
//! loses the second of two frames with one identifier.

mod arrivals;
#[cfg(slots)]
pub mod away;
mod cable;
pub mod interrupts;
mod mailboxes;
mod start;

use core::sync::atomic::{AtomicU16, AtomicU32, Ordering};

use canopen::Frame;
use control::time::Micros;
use embassy_stm32::pac::can::regs;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use robot::CanErrors;

pub use cable::{CABLE_PATIENCE, print_to_cable};
use mailboxes::{free, request};
#[cfg(slots)]
pub use start::bit_timing;

use crate::board::family::bxcan::CAN;

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
static LISTENS_TO: AtomicU16 = AtomicU16::new(u16::MAX);
static CAN_WAIT: AtomicU16 = AtomicU16::new(0);
/// Votes until the bus task is woken for them; 0 for never.
static VOTES_MISSING: AtomicU32 = AtomicU32::new(0);
static OWN_NODE: AtomicU16 = AtomicU16::new(0);
/// The error register as it was when the controller became error passive; 0 once it was read.
static PASSIVE_AT: AtomicU32 = AtomicU32::new(0);
static OVERRUNS: AtomicU32 = AtomicU32::new(0);
static QUEUE_OVERFLOWS: AtomicU32 = AtomicU32::new(0);

/// The CAN controller.
pub struct Can(());

impl Can {
    /// From now on takes frames of these function codes only, one bit for each (bit n: identifiers
    /// from 128 n on), and those with this node number; frames of the second set wait for the tick.
    /// Before the first call all frames are received, at once.
    pub fn listen(&self, function_codes: u16, node: u8, can_wait: u16) {
        OWN_NODE.store(node.into(), Ordering::Relaxed);
        LISTENS_TO.store(function_codes, Ordering::Relaxed);
        CAN_WAIT.store(can_wait, Ordering::Relaxed);
    }

    /// The last of so many votes of members from now on does not wait for the tick.
    pub fn expect_votes(&self, missing: u32) {
        VOTES_MISSING.store(missing, Ordering::Relaxed);
    }

    /// Takes the oldest received frame, if there is one.
    pub fn try_receive(&self) -> Option<Received> {
        RX_QUEUE.try_receive().ok()
    }

    /// Puts a frame into a free mailbox; `false` when all three are taken. Then the bus task is
    /// woken when one is free.
    #[must_use]
    pub fn try_send(&mut self, frame: &Frame) -> bool {
        // Masked: an interrupt notices which mailboxes frames of the cable have left.
        cortex_m::interrupt::free(|_| {
            let Some(mailbox) = free() else {
                // Comes at once if a mailbox has become free since.
                CAN.ier().modify(|w| w.set_tmeie(true));
                return false;
            };
            request(mailbox, frame);
            true
        })
    }

    /// Waits until all mailboxes are empty, for 20 ms at most, before a reset.
    pub fn drain(&mut self) {
        for _ in 0..20_000 {
            let status = CAN.tsr().read();
            if (0..3).all(|mailbox| status.tme(mailbox)) {
                return;
            }
            cortex_m::asm::delay(crate::board::WIRING.clocks.cycles_per_us());
        }
    }

    /// Aborts the frames that wait in mailboxes.
    pub fn discard(&mut self) {
        CAN.tsr().write(|w| {
            w.set_abrq(0, true);
            w.set_abrq(1, true);
            w.set_abrq(2, true);
        });
    }

    /// Begins the recovery from bus-off, which is complete after 128 times 11 recessive bits.
    ///
    /// RM0390 30.7.6: without ABOM, software has to enter and to leave initialisation mode.
    pub fn recover(&mut self) {
        let can = CAN;
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
            0 => CAN.esr().read(),
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
        let error = CAN.esr().read();
        Health {
            overruns: OVERRUNS.load(Ordering::Relaxed),
            queue_overflows: QUEUE_OVERFLOWS.load(Ordering::Relaxed),
            bus_off: error.boff(),
        }
    }
}

/// Whether this robot wants to see frames with this identifier.
fn concerns_us(id: u16) -> bool {
    id & 0x7F == OWN_NODE.load(Ordering::Relaxed)
        || LISTENS_TO.load(Ordering::Relaxed) >> (id >> 7) & 1 == 1
}
