//! Smart drives on CAN2 (bxCAN, RM0390 rev 6 section 30): RoboMaster C620 and C610, 1 Mbit/s.
//!
//! # Theory of operation
//!
//! The control tick sends one command with the four currents and reads what has been reported. The
//! receive interrupt takes the reports, four a millisecond, out of the FIFO. It has the priority of
//! the control tick: neither interrupts the other, so a tick waits for the few microseconds of one
//! report at most, and a report waits in the FIFO, which holds three, for one tick of less than a
//! hundred microseconds. A frame takes at least 108 us.
//!
//! # Falling silent
//!
//! The drives keep a current for a time that no manual names, so it matters what is sent last. A
//! command is sent once, whatever becomes of it (`NART`), and one that still waits when the next is
//! due is taken back: nothing is on the bus later than the program wants it. A program that fails
//! leaves one more frame to the controller, four times no current ([`rest`]), and then nothing.
//!
//! # Interface
//!
//! The control task calls [`Drives::configure`], [`Drives::read`], [`Drives::index_pulses`] and
//! [`Drives::send`], and the way into the safe state [`rest`].
//!
//! # Limits
//!
//! The emergency stop does not reach the drives without the program: the timers' break input cuts
//! driver enable and brake. The stop chain has to cut the motors' power.

#![expect(unsafe_code, reason = "an interrupt handler is called by the hardware")]

use core::cell::RefCell;

use control::rollers::IndexPulse;
use control::smart_drive::frames::{COMMAND, FIRST_FEEDBACK, Model, command};
use control::smart_drive::index::IndexEdge;
use control::smart_drive::{self, DriveConfiguration};
use control::time::Micros;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::pac::can::vals::{Ide, Rtr};
use embassy_stm32::pac::can::{Can as Controller, regs};
use embassy_stm32::{interrupt, pac};
use embassy_sync::blocking_mutex::CriticalSectionMutex;
use protocol::Fault;

use crate::board::WIRING;
use crate::board::stm32::can::bit_timing;
use crate::board::stm32::pin::{Pull, Role, Speed};

/// Whether smart drives turn the wheels.
pub const ARE_WIRED: bool = WIRING.drives.is_some();

/// The first filter bank of CAN2: CAN2SB of FMR after reset (RM0390 30.9.4).
const FIRST_BANK: usize = 14;

/// Filter, 32 bits, mask: identifiers from 0x200 to 0x20F, among them the reports of all drives.
const FILTER: [u32; 2] = [((FIRST_FEEDBACK & 0x7F0) as u32) << 21, 0x7F0 << 21 | 0b110];

const CONTROLLER: Controller = pac::CAN2;

/// The mailbox that only [`rest`] uses, so that it is free; commands take turns in the others.
const LAST_MAILBOX: usize = 2;

/// What has been reported. The interrupt writes it and the tick reads it.
static SEEN: CriticalSectionMutex<RefCell<smart_drive::Drives>> =
    CriticalSectionMutex::new(RefCell::new(smart_drive::Drives::new()));

/// The drives of the wheels.
pub struct Drives {
    wheels: DriveConfiguration,
    model: Model,
}

impl Drives {
    /// Starts the controller, after that of the group, which has the filters.
    pub fn new() -> Self {
        if let Some(pins) = WIRING.drives {
            // Data sheet DS10693 rev 10, table 11; DS8626, table 9: CAN2 is alternate function 9.
            const CAN2_AF: u8 = 9;
            pins.receive
                .become_a(Role::PeripheralInput(CAN2_AF, Pull::Up));
            pins.transmit
                .become_a(Role::PeripheralOutput(CAN2_AF, Pull::None, Speed::VeryHigh));
            pac::RCC.apb1enr().modify(|w| w.set_can2en(true));
            CONTROLLER.mcr().write(|w| {
                w.set_inrq(true);
                w.set_abom(true); // comes back by itself; until then the drives are silent
                w.set_nart(true);
                w.set_txfp(true);
            });
            while !CONTROLLER.msr().read().inak() {}
            CONTROLLER.btr().write(bit_timing);
            CONTROLLER.ier().write(|w| w.set_fmpie(0, true));
            interrupt::CAN2_RX0.set_priority(Priority::P6);
            interrupt::CAN2_RX0.unpend();
            // SAFETY: called once at start-up, outside any critical section.
            unsafe { interrupt::CAN2_RX0.enable() };
            CONTROLLER.mcr().modify(|w| w.set_inrq(false));
        }
        Self {
            wheels: DriveConfiguration::DEFAULT,
            model: Model::C620,
        }
    }

    /// Takes the drives of a configuration.
    pub fn configure(&mut self, wheels: DriveConfiguration, model: Model) {
        self.wheels = wheels;
        self.model = model;
    }

    /// The counts of the wheels, and what is wrong with their drives.
    pub fn read(&self, now: Micros) -> ([u16; 4], Option<Fault>) {
        SEEN.lock(|seen| {
            let seen = seen.borrow();
            (
                seen.counts(&self.wheels, now),
                seen.fault(&self.wheels, now),
            )
        })
    }

    /// The index pulses of the wheels, from their edges.
    pub fn index_pulses(&self, edges: &[IndexEdge; 4], now: Micros) -> [IndexPulse; 4] {
        SEEN.lock(|seen| seen.borrow().index_pulses(&self.wheels, edges, now))
    }

    /// The temperature of the hottest motor, degrees Celsius.
    pub fn temperature(&self) -> u8 {
        SEEN.lock(|seen| seen.borrow().temperature(&self.wheels))
    }

    /// Commands the currents of the wheels, A; where the drivers are disabled, none.
    pub fn send(&mut self, currents: [f32; 4], enabled: bool) {
        let mut by_identifier = [0.0; 4];
        if enabled {
            for (identifier, current) in self.wheels.identifiers.into_iter().zip(currents) {
                if let Some(place) = by_identifier.get_mut(usize::from(identifier).wrapping_sub(1))
                {
                    *place = current;
                }
            }
        }
        let status = CONTROLLER.tsr().read();
        CONTROLLER.tsr().write(|w| {
            // What still waits is old.
            w.set_abrq(0, !status.tme(0));
            w.set_abrq(1, !status.tme(1));
        });
        if let Some(mailbox) = (0..LAST_MAILBOX).find(|mailbox| status.tme(*mailbox)) {
            request(mailbox, command(self.model, by_identifier));
        }
    }
}

/// Sets their filter, which is one of CAN1's; to be called while that initialises its own.
pub fn set_filter() {
    if ARE_WIRED {
        let (can, [identifier, mask]) = (pac::CAN1, FILTER);
        can.fs1r().modify(|w| w.set_fsc(FIRST_BANK, true));
        let bank = can.fb(FIRST_BANK);
        bank.fr1().write_value(regs::Fr1(identifier));
        bank.fr2().write_value(regs::Fr2(mask));
        can.fa1r().modify(|w| w.set_fact(FIRST_BANK, true));
    }
}

/// Sends a command through a free mailbox.
fn request(mailbox: usize, data: [u8; 8]) {
    let [a, b, c, d, e, f, g, h] = data;
    let mailbox = CONTROLLER.tx(mailbox);
    mailbox.tdtr().write(|w| w.set_dlc(8));
    mailbox
        .tdlr()
        .write_value(regs::Tdlr(u32::from_le_bytes([a, b, c, d])));
    mailbox
        .tdhr()
        .write_value(regs::Tdhr(u32::from_le_bytes([e, f, g, h])));
    mailbox.tir().write(|w| {
        w.set_stid(COMMAND);
        w.set_ide(Ide::STANDARD);
        w.set_rtr(Rtr::DATA);
        w.set_txrq(true);
    });
}

/// Takes waiting commands back and leaves the controller one without current, from any context.
/// Nothing is sent after it. Before the controller has started there is nothing to do.
#[inline(always)]
pub fn rest() {
    if ARE_WIRED && pac::RCC.apb1enr().read().can2en() {
        CONTROLLER.tsr().write(|w| {
            w.set_abrq(0, true);
            w.set_abrq(1, true);
        });
        request(LAST_MAILBOX, [0; 8]);
    }
}

/// A report has come.
#[cfg(feature = "drives-c620")]
#[interrupt]
unsafe fn CAN2_RX0() {
    while CONTROLLER.rfr(0).read().fmp() != 0 {
        let at = crate::board::now();
        let mailbox = CONTROLLER.rx(0);
        let id = mailbox.rir().read().stid();
        let length = usize::from(mailbox.rdtr().read().dlc());
        let low = mailbox.rdlr().read().0.to_le_bytes();
        let high = mailbox.rdhr().read().0.to_le_bytes();
        CONTROLLER.rfr(0).write(|w| w.set_rfom(true));
        while CONTROLLER.rfr(0).read().rfom() {}
        let [a, b, c, d] = low;
        let [e, f, g, h] = high;
        let data = [a, b, c, d, e, f, g, h];
        let data = data.get(..length).unwrap_or(&data);
        SEEN.lock(|seen| seen.borrow_mut().on_frame(id, data, at));
    }
}
