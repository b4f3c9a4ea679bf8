//! The last failure: one record that survives a reset, but not a loss of power.
//!
//! The panic and fault handlers write it; start-up reads and clears it once. It is in RAM that
//! start-up does not initialise (`.uninit`). After power-on it holds random data, which the magic
//! number and the checksum reject.

#![expect(unsafe_code, reason = "a static that is not initialised")]

use core::mem::MaybeUninit;
use core::ptr::addr_of_mut;

use cortex_m::interrupt;

use super::stack;

/// How the program failed.
#[derive(Clone, Copy, defmt::Format)]
pub enum Failure {
    /// A Rust panic.
    Panic(Calls),
    /// A fault exception.
    HardFault {
        /// Address of the instruction; 0 when the stack held no frame.
        pc: u32,
        /// Stack pointer at the fault.
        sp: u32,
        /// Configurable fault status register.
        cfsr: u32,
        /// Address that could not be accessed, if `cfsr` says it is valid.
        bfar: u32,
    },
    /// The bus side went silent while driving, and the control side brought the robot to rest.
    BusStarved,
    /// HSE stopped.
    ClockLost,
    /// The supply of the chip sank below the voltage detector's threshold.
    SupplyCollapse,
    /// An interrupt without a handler; its number counts from 0, exceptions are negative.
    UnhandledInterrupt(i16),
}

/// The calls that have led to a panic, the latest first, by the addresses behind them.
///
/// A panic's file and line are not used: their names, and the code that passes them on from each of
/// some hundred checks, would be 8 KB of the image. `docs/bring-up.md` says how to read these.
#[derive(Clone, Copy)]
pub struct Calls([u32; CALLS]);

/// Calls that are kept; the first is inside the panic.
const CALLS: usize = WORDS - 2;

impl Calls {
    /// Those of now.
    pub fn here() -> Self {
        Self(stack::calls())
    }
}

impl defmt::Format for Calls {
    fn format(&self, formatter: defmt::Formatter) {
        defmt::write!(formatter, "{=[?; 6]:#x}", self.0);
    }
}

const MAGIC: u32 = 0x6d6f_7274;
const WORDS: usize = 8;
type Words = [u32; WORDS];

#[unsafe(link_section = ".uninit.post_mortem")]
static mut RECORD: MaybeUninit<Words> = MaybeUninit::uninit();

#[unsafe(link_section = ".uninit.post_mortem")]
static mut WATCHDOG_RESETS: MaybeUninit<[u32; 2]> = MaybeUninit::uninit();

/// Watchdog resets since power came, this one included if it `is_one`. Called once at start-up,
/// before tasks and ticks run.
pub fn count_watchdog_reset(is_one: bool) -> u32 {
    // SAFETY: this function alone uses the static, and by contract is called once, before the tasks
    // run. Start-up leaves the words as they are: any bits, all of them valid.
    unsafe {
        let [check, count] = addr_of_mut!(WATCHDOG_RESETS).read_volatile().assume_init();
        let before = if check == MAGIC ^ count { count } else { 0 };
        let count = before.saturating_add(u32::from(is_one));
        addr_of_mut!(WATCHDOG_RESETS).write_volatile(MaybeUninit::new([MAGIC ^ count, count]));
        count
    }
}

/// Stores `failure` for the next start.
pub fn write(failure: Failure) {
    let mut words: Words = [MAGIC, 0, 0, 0, 0, 0, 0, 0];
    match failure {
        Failure::Panic(Calls(calls)) => {
            words[1] = 7;
            words[2..].copy_from_slice(&calls);
        }
        Failure::HardFault { pc, sp, cfsr, bfar } => {
            words[1] = 2;
            words[2..6].copy_from_slice(&[pc, sp, cfsr, bfar]);
        }
        Failure::UnhandledInterrupt(number) => {
            words[1] = 3;
            words[2] = u32::from(number.cast_unsigned());
        }
        Failure::BusStarved => words[1] = 4,
        Failure::ClockLost => words[1] = 5,
        Failure::SupplyCollapse => words[1] = 6,
    }
    words[0] = MAGIC ^ fold(&words);
    // SAFETY: there is one core, and interrupts are masked. What cannot be masked (NMI, HardFault)
    // may write the record too, but never returns to what it has interrupted.
    interrupt::free(|_| unsafe { addr_of_mut!(RECORD).write_volatile(MaybeUninit::new(words)) });
}

/// Returns the record of the last run, if there is one, and erases it.
pub fn consume() -> Option<Failure> {
    // SAFETY: as in `write`. Start-up leaves the words as they are: any bits, all of them valid.
    let words = interrupt::free(|_| unsafe {
        let words = addr_of_mut!(RECORD).read_volatile().assume_init();
        addr_of_mut!(RECORD).write_volatile(MaybeUninit::new([0; WORDS]));
        words
    });
    if words[0] != MAGIC ^ fold(&words) {
        return None;
    }
    // 1 was a panic with file and line.
    match words[1] {
        2 => Some(Failure::HardFault {
            pc: words[2],
            sp: words[3],
            cfsr: words[4],
            bfar: words[5],
        }),
        3 => Some(Failure::UnhandledInterrupt(words[2] as u16 as i16)),
        4 => Some(Failure::BusStarved),
        5 => Some(Failure::ClockLost),
        6 => Some(Failure::SupplyCollapse),
        7 => {
            let mut calls = [0; CALLS];
            calls.copy_from_slice(&words[2..]);
            Some(Failure::Panic(Calls(calls)))
        }
        _ => None,
    }
}

/// Sum of the content, without the word that holds it.
fn fold(words: &Words) -> u32 {
    words[1..]
        .iter()
        .fold(1, |sum: u32, word| sum.rotate_left(5).wrapping_add(*word))
}
