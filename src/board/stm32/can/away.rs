//! The code in RAM that runs while a sector of the flash is erased and the program stands still.
//!
//! The chip has one bank of flash: until an erase ends, whatever reads from it waits, instructions
//! and vectors as well as constants. So [`erase`] masks interrupts and calls [`in_ram`], which lies
//! in RAM, begins the erase and stays until its end. It answers one question and sends the
//! heartbeat, both as `robot::update::StandIn` has prepared them, and keeps the frames that are for
//! this robot. These are received when the program goes on.
//!
//! In between the core sleeps. What wakes it is pending and never served: a received frame, the end
//! of the erase, and, for the heartbeat, SysTick, which only the wait for the crystal at start-up
//! uses otherwise.
//!
//! Limits: the local time stands still, and the cable is neither read nor written. Frames
//! for all robots, like SYNC, are dropped without being counted. `in_ram` may call nothing
//! that is not inlined, and may not panic; `tests/update_boot.rs` runs it on a chip that stalls.

#![expect(
    unsafe_code,
    reason = "code in RAM, mailboxes and registers of the core by address"
)]

use core::sync::atomic::Ordering;

use canopen::Frame;
use cortex_m::peripheral::{NVIC, SCB, SYST};
use embassy_stm32::interrupt::InterruptExt;
use embassy_stm32::{interrupt, pac};
use protocol::cob;
use robot::update::StandIn;

use super::cable::leaving_mailbox;
use super::mailboxes::{frame_of, words_of};
use super::{QUEUE_OVERFLOWS, RX_QUEUE, Received};
use crate::board::family::bxcan::CAN;
use crate::board::{WIRING, now};
use crate::wake;

/// Frames that are kept; a client has one request under way.
const ROOM: usize = 8;
/// SysTick counts 24 bits: 93 ms at 180 MHz.
const LONGEST_TICK_MS: u32 = 90;
const _: () = assert!(LONGEST_TICK_MS * CYCLES_PER_MS < 1 << 24);
const CYCLES_PER_MS: u32 = 1_000 * WIRING.clocks.cycles_per_us();
/// Registers of interrupts in the NVIC, 32 in each; the chip has 97.
const WORDS: usize = 4;

/// ICSR: SysTick is pending, and clears that (ARMv7-M ARM, B3.2.4).
const PENDSTSET: u32 = 1 << 26;
const PENDSTCLR: u32 = 1 << 25;

/// A mailbox and the words of its registers: TIR with the request to send, TDTR, TDLR, TDHR.
struct Outgoing {
    mailbox: *mut u32,
    words: [u32; 4],
}

impl Outgoing {
    #[inline(never)]
    fn new(mailbox: usize, frame: &Frame) -> Self {
        Self {
            mailbox: CAN.tx(mailbox).as_ptr().cast(),
            words: words_of(frame),
        }
    }
}

/// What the code in RAM works with, all of it in RAM.
struct Away {
    question_id: u16,
    question: u32,
    node: u16,
    answer: Outgoing,
    heartbeat: Outgoing,
    /// A heartbeat every so many ticks, and how many are left.
    every: u32,
    left: u32,
    /// Identifier, length, data.
    kept: [(u16, u8, [u32; 2]); ROOM],
    count: usize,
    lost: u32,
}

impl Away {
    /// Whether a frame is the question; it is kept if it is not, and for this robot.
    #[inline(always)]
    fn take(&mut self, id: u16, length: u8, data: [u32; 2]) -> bool {
        if id == self.question_id && data[0] == self.question {
            return true;
        }
        if id == cob::NMT || id & 0x7F == self.node {
            if let Some(place) = self.kept.get_mut(self.count) {
                *place = (id, length, data);
                self.count = self.count.wrapping_add(1);
            } else {
                self.lost = self.lost.wrapping_add(1);
            }
        }
        false
    }
}

/// Runs the erase that FLASH_CR is set up for, to its end. Mailboxes are empty.
pub fn erase(stand_in: &StandIn) {
    // All but that with a frame of the cable, which has left without being noticed.
    let mailboxes = match leaving_mailbox() {
        Some(0) => [1, 2],
        Some(1) => [0, 2],
        Some(_) | None => [0, 1],
    };
    let period_ms = u32::from(stand_in.heartbeat_ms);
    let every = period_ms.div_ceil(LONGEST_TICK_MS);
    let tick_ms = period_ms.checked_div(every).unwrap_or(0);
    let [a, b, c, d, ..] = *stand_in.question.padded();
    let mut away = Away {
        question_id: stand_in.question.id(),
        question: u32::from_le_bytes([a, b, c, d]),
        node: stand_in.node.get().into(),
        answer: Outgoing::new(mailboxes[0], &stand_in.answer),
        heartbeat: Outgoing::new(mailboxes[1], &stand_in.heartbeat),
        every,
        left: every,
        kept: [(0, 0, [0; 2]); ROOM],
        count: 0,
        lost: 0,
    };
    cortex_m::interrupt::free(|_| {
        // What has been received since the bus task looked.
        while let Ok(Received { frame, .. }) = RX_QUEUE.try_receive() {
            let [.., low, high] = words_of(&frame);
            if away.take(frame.id(), frame.len(), [low, high]) {
                send(&away.answer);
            }
        }
        let enabled = only_what_wakes();
        start_ticks(tick_ms * CYCLES_PER_MS);
        in_ram(&mut away);
        start_ticks(0);
        give_back(enabled);
    });
    receive(&away);
}

/// Stays until the erase that it begins ends.
#[inline(never)]
#[unsafe(link_section = ".data.away")]
fn in_ram(away: &mut Away) {
    let can = CAN;
    pac::FLASH.cr().modify(|w| {
        w.set_eopie(true);
        w.set_strt(true);
    });
    cortex_m::asm::dsb();
    // SAFETY: these registers exist on every Cortex-M4. What is written below clears pending bits
    // of SysTick and CAN1_RX0 and nothing else; a frame that is left in the FIFO pends the
    // interrupt again.
    let (icsr, icpr) = unsafe { (&(*SCB::PTR).icsr, &(*NVIC::PTR).icpr) };
    while pac::FLASH.sr().read().bsy() {
        let outgoing = if icsr.read() & PENDSTSET != 0 {
            // SAFETY: as above.
            unsafe { icsr.write(PENDSTCLR) };
            away.left = away.left.wrapping_sub(1);
            if away.left != 0 {
                continue;
            }
            away.left = away.every;
            &away.heartbeat
        } else if can.rfr(0).read().fmp() != 0 {
            let mailbox = can.rx(0);
            let id = mailbox.rir().read().stid();
            let data = [mailbox.rdlr().read().0, mailbox.rdhr().read().0];
            let is_question = away.take(id, mailbox.rdtr().read().dlc(), data);
            can.rfr(0).write(|w| w.set_rfom(true));
            while can.rfr(0).read().rfom() {}
            if !is_question {
                continue;
            }
            &away.answer
        } else {
            const RX0: u16 = interrupt::CAN1_RX0 as u16;
            // SAFETY: as above.
            unsafe { icpr[RX0 as usize / 32].write(1 << (RX0 % 32)) };
            // A frame that has come since is pending, and ends the sleep.
            cortex_m::asm::wfi();
            continue;
        };
        send(outgoing);
    }
}

/// Puts a frame into its mailbox, unless the last one has not left that.
#[inline(always)]
fn send(frame: &Outgoing) {
    // TIR: the request to send, which the words have, and which ends when the frame has left.
    const TXRQ: u32 = 1;
    let [tir, tdtr, tdlr, tdhr] = frame.words;
    // SAFETY: `Outgoing::new` has made the pointer from the four registers of a mailbox. `erase`
    // masks interrupts around every call, so nothing else uses mailboxes meanwhile.
    unsafe {
        if frame.mailbox.read_volatile() & TXRQ != 0 {
            return;
        }
        frame.mailbox.add(1).write_volatile(tdtr);
        frame.mailbox.add(2).write_volatile(tdlr);
        frame.mailbox.add(3).write_volatile(tdhr);
        frame.mailbox.write_volatile(tir);
    }
}

/// Disables all interrupts but those that end the sleep, and returns which were enabled. Masked
/// ones would end it as well, and once pending they stay so.
fn only_what_wakes() -> [u32; WORDS] {
    // SAFETY: `erase` has masked interrupts, so enabling one runs no handler; `give_back` restores
    // which are enabled before they are unmasked.
    unsafe {
        let nvic = &*NVIC::PTR;
        let enabled = core::array::from_fn(|word| nvic.iser[word].read());
        for word in &nvic.icer[..WORDS] {
            word.write(u32::MAX);
        }
        interrupt::CAN1_RX0.enable();
        interrupt::FLASH.unpend();
        interrupt::FLASH.enable();
        enabled
    }
}

/// Enables the interrupts that were.
fn give_back(enabled: [u32; WORDS]) {
    // The end of an erase has no handler.
    pac::FLASH.cr().modify(|w| w.set_eopie(false));
    interrupt::FLASH.disable();
    interrupt::FLASH.unpend();
    // SAFETY: these were enabled before, and interrupts are masked until the critical section of
    // `erase` ends.
    unsafe {
        for (word, bits) in (*NVIC::PTR).iser.iter().zip(enabled) {
            word.write(bits);
        }
    }
}

/// Makes SysTick pending every so many cycles; 0 stops it.
fn start_ticks(cycles: u32) {
    // The core's clock, and pending at 0.
    const RUNNING: u32 = 0b111;
    // SAFETY: the registers exist on every Cortex-M4. `power::wait`, their other user, has
    // ended before the first task, and no handler runs while interrupts are masked.
    unsafe {
        let timer = &*SYST::PTR;
        timer.csr.write(0);
        (*SCB::PTR).icsr.write(PENDSTCLR);
        timer.rvr.write(cycles.saturating_sub(1));
        timer.cvr.write(0);
        if cycles > 0 {
            timer.csr.write(RUNNING);
        }
    }
}

/// Receives what was kept, now.
fn receive(away: &Away) {
    let at = now();
    let mut lost = away.lost;
    for (id, length, data) in away.kept.iter().take(away.count) {
        let frame = frame_of(*id, *length, *data);
        lost += u32::from(RX_QUEUE.try_send(Received { at, frame }).is_err());
    }
    QUEUE_OVERFLOWS.fetch_add(lost, Ordering::Relaxed);
    wake::BUS.signal();
}
