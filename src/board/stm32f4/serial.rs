//! The serial port to the cable: USART2 with DMA both ways, 1 Mbit/s, eight data bits, one stop
//! bit.
//!
//! What comes is put into a ring by DMA1 stream 5, without end; the bus task reads it there. An
//! idle line wakes the task, and each half of the ring that has been filled. What goes is printed
//! into a second ring, by the bus task and by a CAN interrupt ([`put`]), from which stream 6
//! takes it; its interrupt goes on with what has been added meanwhile (RM0390 rev 6: USART section
//! 25, DMA section 9, requests table 28).
//!
//! What can overflow: the first ring, when the task does not read for 2.4 ms of bytes without a
//! pause, and the second, when more is written than the line carries. A line that finds no room in
//! the second is dropped and counted. When the first overflows, and when the port reports a
//! framing, noise or overrun error, everything that has not been read is dropped and said to be
//! damaged; the reader drops the line it is in. Nothing waits here, so a cable without a reader, or
//! no cable, costs nothing.

use core::cell::RefCell;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering, compiler_fence};

use can_text::slcan::LINE;
use cortex_m::interrupt::Mutex;
use embassy_stm32::interrupt::typelevel::{self, Handler};
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::pac::dma::regs::Ixr;
use embassy_stm32::pac::dma::vals::Dir;
use embassy_stm32::{bind_interrupts, interrupt, pac};

use crate::board::WIRING;
use crate::board::stm32::pin::{Pull, Role, Speed};
use crate::wake;

/// The baud rate.
const BAUD: u32 = 1_000_000;

/// Clocks of APB1 in a bit; USARTDIV is a sixteenth of it.
const DIVIDER: u32 = {
    assert!(
        WIRING.clocks.apb1_hz().is_multiple_of(BAUD),
        "the clock of APB1 gives no 1 Mbaud"
    );
    WIRING.clocks.apb1_hz() / BAUD
};

/// Bytes of the ring for what comes.
const IN: u32 = 256;
/// Unread bytes above which the ring is taken to have overflowed: the DMA writes on while the task
/// reads.
const IN_MOST: u32 = 240;
/// Bytes of the ring for what goes: 5 ms of the line.
const OUT: u32 = 512;

/// The streams of DMA1, and the channel of both.
const RECEIVE: usize = 5;
const TRANSMIT: usize = 6;
const CHANNEL: u8 = 4;

static INCOMING: [AtomicU8; IN as usize] = [const { AtomicU8::new(0) }; IN as usize];
static OUTGOING: Mutex<RefCell<Outgoing>> = Mutex::new(RefCell::new(Outgoing::new()));
/// Halves of the first ring that have been filled since the start.
static HALVES: AtomicU32 = AtomicU32::new(0);
/// An interrupt has told of bytes, or of damage, since the last look.
static NEWS: AtomicBool = AtomicBool::new(false);
/// Something of what came was wrong.
static DAMAGED: AtomicBool = AtomicBool::new(false);
/// Lines that have found no room in the second ring.
static DROPPED: AtomicU32 = AtomicU32::new(0);

bind_interrupts!(struct Irqs {
    USART2 => PortHandler;
    DMA1_STREAM5 => InHandler;
    DMA1_STREAM6 => OutHandler;
});

/// The port.
pub struct Serial {
    /// Bytes that have ever been read.
    read: u32,
}

/// What has come since the last look.
pub struct Arrived {
    /// Where it ends.
    until: u32,
    /// Whether something before it was lost.
    pub damaged: bool,
}

/// Whether the board has a port for a cable.
pub const IS_WIRED: bool = WIRING.cable.is_some();

impl Serial {
    /// Switches the port on; `None` on a board without one.
    pub fn new() -> Option<Self> {
        let wiring = WIRING.cable?;
        // Data sheet DS10693 rev 10, table 11: USART2 is alternate function 7.
        const USART2_AF: u8 = 7;
        wiring
            .receive
            .become_a(Role::PeripheralInput(USART2_AF, Pull::Up));
        wiring
            .transmit
            .become_a(Role::PeripheralOutput(USART2_AF, Pull::None, Speed::Medium));
        pac::RCC.apb1enr().modify(|w| w.set_usart2en(true));
        pac::RCC.ahb1enr().modify(|w| w.set_dma1en(true));

        let port = pac::USART2;
        let data = port.dr().as_ptr() as u32;
        for (stream, direction) in [
            (RECEIVE, Dir::PERIPHERAL_TO_MEMORY),
            (TRANSMIT, Dir::MEMORY_TO_PERIPHERAL),
        ] {
            let registers = pac::DMA1.st(stream);
            registers.par().write_value(data);
            if stream == RECEIVE {
                registers.m0ar().write_value(INCOMING.as_ptr() as u32);
                registers.ndtr().write(|w| w.0 = IN);
            }
            registers.cr().write(|w| {
                w.set_chsel(CHANNEL);
                w.set_dir(direction);
                w.set_minc(true);
                w.set_tcie(true);
                w.set_circ(stream == RECEIVE);
                w.set_htie(stream == RECEIVE);
                w.set_en(stream == RECEIVE);
            });
        }
        // The mantissa is above the fraction's four bits, so that the register is the divider.
        port.brr().write(|w| w.0 = DIVIDER);
        port.cr3().write(|w| {
            w.set_dmar(true);
            w.set_dmat(true);
            w.set_eie(true);
        });
        port.cr1().write(|w| {
            w.set_ue(true);
            w.set_re(true);
            w.set_te(true);
            w.set_idleie(true);
        });
        enable_interrupts();
        Some(Self { read: 0 })
    }

    /// Whether bytes, or damage, may have come since the last call: every byte is followed by an
    /// idle line or by more bytes, and both have an interrupt.
    pub fn has_news(&self) -> bool {
        NEWS.load(Ordering::Relaxed) && NEWS.swap(false, Ordering::Relaxed)
    }

    /// What has come.
    pub fn arrived(&mut self) -> Arrived {
        let until = received();
        let unread = until.wrapping_sub(self.read);
        let damaged = DAMAGED.load(Ordering::Relaxed) || unread > IN_MOST;
        if damaged {
            DAMAGED.store(false, Ordering::Relaxed);
            self.read = until;
        }
        Arrived { until, damaged }
    }

    /// The next byte of what has come.
    pub fn read(&mut self, arrived: &Arrived) -> Option<u8> {
        if self.read == arrived.until {
            return None;
        }
        let byte = INCOMING.get((self.read % IN) as usize)?;
        self.read = self.read.wrapping_add(1);
        Some(byte.load(Ordering::Relaxed))
    }

    /// Sends these bytes, a line's at most, if there is room for a line.
    pub fn write(&mut self, bytes: &[u8]) {
        put(|line| {
            for (place, byte) in line.iter_mut().zip(bytes) {
                *place = *byte;
            }
            bytes.len()
        });
    }

    /// Lines that have found no room on the way out since the start, wrapping.
    pub fn dropped(&self) -> u32 {
        DROPPED.load(Ordering::Relaxed)
    }
}

/// Bytes of the ring for what goes, behind which there is room for a line that begins at its end.
const OUT_ROOM: usize = OUT as usize + LINE;

/// The ring for what goes. All three counts wrap.
struct Outgoing {
    ring: [u8; OUT_ROOM],
    /// Bytes that have ever been written.
    written: u32,
    /// Bytes that have left it.
    gone: u32,
    /// Bytes that the stream is moving.
    moving: u32,
}

/// Has a line printed into the ring for what goes, and sent: `print` gets room for the longest, and
/// returns how many bytes it has used. Without room for the longest the line is dropped. For the
/// bus task and every interrupt; a line takes a microsecond, with interrupts masked.
pub fn put(print: impl FnOnce(&mut [u8; LINE]) -> usize) {
    let room = cortex_m::interrupt::free(|cs| {
        let mut outgoing = OUTGOING.borrow(cs).try_borrow_mut().ok()?;
        outgoing.put(print)
    });
    if room.is_none() {
        DROPPED.fetch_add(1, Ordering::Relaxed);
    }
}

impl Outgoing {
    const fn new() -> Self {
        Self {
            ring: [0; OUT_ROOM],
            written: 0,
            gone: 0,
            moving: 0,
        }
    }

    #[inline]
    fn put(&mut self, print: impl FnOnce(&mut [u8; LINE]) -> usize) -> Option<()> {
        let waiting = self.written.wrapping_sub(self.gone);
        #[expect(clippy::cast_possible_truncation, reason = "some tens of bytes")]
        const LONGEST: u32 = LINE as u32;
        if waiting + LONGEST > OUT {
            return None;
        }
        let at = (self.written % OUT) as usize;
        let line = self.ring.get_mut(at..)?.first_chunk_mut()?;
        let length = print(line);
        // What has been printed behind the end goes on at the beginning.
        if let Some(over @ 1..) = (at + length).checked_sub(OUT as usize) {
            let (ring, behind) = self.ring.split_at_mut_checked(OUT as usize)?;
            for (place, byte) in ring.iter_mut().zip(behind.iter().take(over)) {
                *place = *byte;
            }
        }
        self.written = self.written.wrapping_add(u32::try_from(length).ok()?);
        self.send();
        Some(())
    }

    /// Lets the stream move what waits, if it is not moving anything.
    fn send(&mut self) {
        let begin = self.gone % OUT;
        let waiting = self.written.wrapping_sub(self.gone);
        let length = waiting.min(OUT - begin);
        if self.moving != 0 || length == 0 {
            return;
        }
        self.moving = length;
        // What has been printed is in memory before the stream is told to read it.
        compiler_fence(Ordering::Release);
        let stream = pac::DMA1.st(TRANSMIT);
        stream.m0ar().write_value(self.ring.as_ptr() as u32 + begin);
        stream.ndtr().write(|w| w.0 = length);
        stream.cr().modify(|w| w.set_en(true));
    }

    /// The stream has moved what it was to move.
    fn moved(&mut self) {
        self.gone = self.gone.wrapping_add(self.moving);
        self.moving = 0;
        self.send();
    }
}

/// Bytes that have ever come, wrapping.
fn received() -> u32 {
    let (halves, left) = cortex_m::interrupt::free(|_| {
        let left = pac::DMA1.st(RECEIVE).ndtr().read().0 & 0xFFFF;
        (HALVES.load(Ordering::Relaxed), left)
    });
    let at = IN.saturating_sub(left) % IN;
    // The interrupt of the half that has just been filled may be still to come.
    let halves = halves.wrapping_add((halves ^ (at / (IN / 2))) & 1);
    halves.wrapping_mul(IN / 2).wrapping_add(at % (IN / 2))
}

/// Clears the flags of a stream.
fn clear(stream: usize) {
    // RM0390 9.5.3: all five of a stream of the second register.
    const FLAGS: u32 = 0x3D;
    const SHIFTS: [u32; 4] = [0, 6, 16, 22];
    let flags = FLAGS << SHIFTS[stream % 4];
    pac::DMA1.ifcr(stream / 4).write_value(Ixr(flags));
}

#[expect(
    unsafe_code,
    reason = "enabling an interrupt can break a critical section"
)]
fn enable_interrupts() {
    let _ = Irqs;
    interrupt::USART2.set_priority(Priority::P7);
    interrupt::DMA1_STREAM5.set_priority(Priority::P7);
    interrupt::DMA1_STREAM6.set_priority(Priority::P7);
    // SAFETY: called once at start-up, outside any critical section that these handlers could
    // break.
    unsafe {
        interrupt::USART2.enable();
        interrupt::DMA1_STREAM5.enable();
        interrupt::DMA1_STREAM6.enable();
    }
}

struct PortHandler;

#[expect(unsafe_code, reason = "an interrupt handler is called by the hardware")]
impl Handler<typelevel::USART2> for PortHandler {
    unsafe fn on_interrupt() {
        let port = pac::USART2;
        let status = port.sr().read();
        // RM0390 25.6.1: reading the status and then the data clears the flags. The DMA has taken
        // what was to be read.
        let _ = port.dr().read();
        if status.fe() || status.ne() || status.ore() {
            DAMAGED.store(true, Ordering::Relaxed);
        }
        NEWS.store(true, Ordering::Relaxed);
        wake::BUS.signal();
    }
}

struct InHandler;

#[expect(unsafe_code, reason = "an interrupt handler is called by the hardware")]
impl Handler<typelevel::DMA1_STREAM5> for InHandler {
    unsafe fn on_interrupt() {
        let flags = pac::DMA1.isr(RECEIVE / 4).read();
        clear(RECEIVE);
        HALVES.fetch_add(1, Ordering::Relaxed);
        // Both halves since the last interrupt: the processor stood still for longer than one of
        // them lasts, while a sector was erased, and how often the ring went round is not known.
        if flags.htif(RECEIVE % 4) && flags.tcif(RECEIVE % 4) {
            DAMAGED.store(true, Ordering::Relaxed);
        }
        NEWS.store(true, Ordering::Relaxed);
        wake::BUS.signal();
    }
}

struct OutHandler;

#[expect(unsafe_code, reason = "an interrupt handler is called by the hardware")]
impl Handler<typelevel::DMA1_STREAM6> for OutHandler {
    unsafe fn on_interrupt() {
        clear(TRANSMIT);
        cortex_m::interrupt::free(|cs| {
            if let Ok(mut outgoing) = OUTGOING.borrow(cs).try_borrow_mut() {
                outgoing.moved();
            }
        });
    }
}
