//! What the controller's stronger interrupts have noted and a weaker one does.
//!
//! An interrupt above the control tick delays a tick that it coincides with, and so moves this
//! robot's PWM away from that of the others. Receive and transmit interrupt therefore only take the
//! time and the frame ([`put`]). [`LaterHandler`](super::interrupts::LaterHandler), which the tick
//! interrupts, takes them out in the same order ([`take`]): it queues frames, prints them for the
//! cable and wakes the bus task. Its vector is that of the controller's second FIFO, which is not
//! used.
//!
//! What can fill up: the ring of [`PLACES`], when the weaker interrupt does not come for eight
//! frames, 400 us at least. Only a control tick and the interrupts above hold it up, for less than
//! two frames; with interrupts masked nothing is put in. What finds no place is counted as an
//! overflow of the queue.

use core::sync::atomic::{AtomicU32, Ordering, compiler_fence};

use control::time::Micros;
use embassy_stm32::interrupt::InterruptExt;

use super::cable::low_us;
use crate::board::family::bxcan::CAN1_RX1;

/// Places of the ring.
const PLACES: u32 = 8;

/// What has happened: the words of a receive mailbox, RIR, RDTR, RDLR and RDHR. Instead of RIR
/// there may be [`SENT`].
pub(super) type Words = [u32; 4];

/// A transmit mailbox is done. The filter lets in no frame whose RIR has IDE and RTR set.
pub(super) const SENT: u32 = u32::MAX;

/// The words, and the lower half of the time in microseconds and the upper.
type Place = [AtomicU32; 6];

static RING: [Place; PLACES as usize] =
    [const { [const { AtomicU32::new(0) }; 6] }; PLACES as usize];
/// Places that have ever been filled, and emptied, wrapping.
static FILLED: AtomicU32 = AtomicU32::new(0);
static EMPTIED: AtomicU32 = AtomicU32::new(0);

fn place(number: u32) -> Option<&'static Place> {
    RING.get((number % PLACES) as usize)
}

/// Notes what has happened at `at`, and pends the interrupt that takes it out; `false` without a
/// place. For interrupts of one priority, which do not interrupt each other.
#[inline(always)]
pub(super) fn put(at: Micros, words: Words) -> bool {
    let filled = FILLED.load(Ordering::Relaxed);
    let has_place = filled.wrapping_sub(EMPTIED.load(Ordering::Relaxed)) < PLACES;
    if has_place && let Some([rir, rdtr, rdlr, rdhr, low, high]) = place(filled) {
        rir.store(words[0], Ordering::Relaxed);
        rdtr.store(words[1], Ordering::Relaxed);
        rdlr.store(words[2], Ordering::Relaxed);
        rdhr.store(words[3], Ordering::Relaxed);
        low.store(low_us(at), Ordering::Relaxed);
        high.store((at.0 >> 32) as u32, Ordering::Relaxed);
        // One core: the compiler's order is that of the weaker interrupt.
        compiler_fence(Ordering::Release);
        FILLED.store(filled.wrapping_add(1), Ordering::Relaxed);
    }
    CAN1_RX1.pend();
    has_place
}

/// Takes out what has happened first, and when. For the weaker interrupt.
#[inline(always)]
pub(super) fn take() -> Option<(Micros, Words)> {
    let emptied = EMPTIED.load(Ordering::Relaxed);
    if emptied == FILLED.load(Ordering::Relaxed) {
        return None;
    }
    compiler_fence(Ordering::Acquire);
    let [rir, rdtr, rdlr, rdhr, low, high] = place(emptied)?;
    let words = [rir, rdtr, rdlr, rdhr].map(|word| word.load(Ordering::Relaxed));
    let at = u64::from(high.load(Ordering::Relaxed)) << 32;
    let at = Micros(at | u64::from(low.load(Ordering::Relaxed)));
    compiler_fence(Ordering::Release);
    EMPTIED.store(emptied.wrapping_add(1), Ordering::Relaxed);
    Some((at, words))
}
