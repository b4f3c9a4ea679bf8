//! The robot as a CAN adapter: slcan on its cable, for the bus and for itself.
//!
//! The bus task calls it every turn: [`Gateway::receive`] before it looks at received frames, with
//! what the cable has brought, and [`Gateway::send`] with each frame of this robot. Frames of the
//! bus go to the cable in an interrupt, which this only switches on. A frame of
//! the cable reaches the robot when it has left for the bus, so that all robots get the same frames
//! in the same order at the same time; alone, at once (`board`'s CAN driver has the rules). The
//! cable's end of the protocol is `can_text::slcan`.
//!
//! An open channel changes what is made of the CAN controller's state. The master is at the cable
//! then, so bus-off neither mutes the robot nor cuts its answers off; only if others were there
//! before, it is a fault, because the group is torn then. A closed channel changes nothing.
//!
//! On a board without a cable the compiler leaves all of it out.
//!
//! What it cannot do: extended and remote frames (refused), other bit rates (refused), hardware
//! time stamps (those of `Z1` are of the interrupt), flow control: what the cable does not carry is
//! dropped, counted in objects, and told by `F`.

use can_text::slcan::{self, Channel, Step, flags};
use canopen::Frame;
use control::time::Micros;
use protocol::Fault;
use robot::{BusSide, CableLosses};

use crate::board::{CABLE_IS_WIRED, CABLE_PATIENCE, Can, Health, Serial, now, print_to_cable};

/// How long after a try to come back from bus-off the next follows.
const RETRY: Micros = Micros(100_000);

/// The adapter's state.
pub struct Gateway {
    serial: Option<Serial>,
    channel: Channel,
    /// A frame that waits for a mailbox, and since when.
    waiting: Option<(Frame, Micros)>,
    /// Bytes have arrived that are not read yet, because a frame before them is still to be sent.
    unread: bool,
    /// How often bytes of the cable were damaged.
    damaged: u32,
    /// What was lost until the last `F`.
    reported: CableLosses,
    /// When to try to come back from bus-off.
    retry: Micros,
}

impl Gateway {
    /// A closed channel; `N` tells the lower half of this number.
    pub fn new(serial: Option<Serial>, number: u32) -> Self {
        Self {
            serial,
            channel: Channel::new(number),
            waiting: None,
            unread: false,
            damaged: 0,
            reported: CableLosses::default(),
            retry: Micros(0),
        }
    }

    /// Takes in what has come over the cable, up to a frame that has to wait for the bus.
    pub fn receive(&mut self, can: &mut Can) {
        if !CABLE_IS_WIRED {
            return;
        }
        let news = self.serial.as_ref().is_some_and(Serial::has_news);
        if news || self.unread || can.has_one_of_the_cable() {
            self.process(can);
        }
    }

    #[inline(never)]
    fn process(&mut self, can: &mut Can) {
        can.look_after();
        let Some(arrived) = self.serial.as_mut().map(Serial::arrived) else {
            return;
        };
        if arrived.damaged {
            self.channel.spoil();
            self.damaged = self.damaged.wrapping_add(1);
        }
        self.unread = true;
        loop {
            if self.waiting.is_some() && !self.pass_on(can) || can.is_passing_on() {
                return;
            }
            let Some(byte) = self.serial.as_mut().and_then(|port| port.read(&arrived)) else {
                self.unread = false;
                return;
            };
            match self.channel.push(byte) {
                Some(Step::Send(frame)) => self.waiting = Some((frame, now())),
                Some(Step::Answer(answer)) => self.write(answer.as_bytes()),
                Some(Step::Flags) => self.answer_flags(can),
                None => continue,
            }
            can.set_gateway(self.channel.is_open(), self.channel.stamps());
        }
    }

    /// Answers `F`: what has been lost since the last one, and what the controller says.
    fn answer_flags(&mut self, can: &Can) {
        let losses = self.losses(can);
        let before = core::mem::replace(&mut self.reported, losses);
        let bit = |now: u32, then: u32, flag| if now == then { 0 } else { flag };
        let flags = bit(losses.to_cable, before.to_cable, flags::RECEIVE_FULL)
            | bit(losses.to_bus, before.to_bus, flags::TRANSMIT_FULL)
            | bit(losses.damaged, before.damaged, flags::OVERRUN)
            | can.status_flags();
        self.write(slcan::flags_answer(flags).as_bytes());
    }

    /// What has been lost since the start.
    fn losses(&self, can: &Can) -> CableLosses {
        CableLosses {
            to_cable: self.serial.as_ref().map_or(0, Serial::dropped),
            to_bus: can.not_passed_on(),
            damaged: self.damaged,
        }
    }

    /// Passes on the frame that waits; `false` when it has to wait on.
    fn pass_on(&mut self, can: &mut Can) -> bool {
        let Some((frame, since)) = self.waiting else {
            return true;
        };
        if now().since(since) > CABLE_PATIENCE {
            can.give_up();
        }
        match can.pass_on(&frame) {
            None => return false,
            Some(true) => self.write(slcan::SENT),
            Some(false) => self.write(&[slcan::REFUSED]),
        }
        self.waiting = None;
        true
    }

    #[inline(never)]
    fn write(&mut self, bytes: &[u8]) {
        if let Some(serial) = &mut self.serial {
            serial.write(bytes);
        }
    }

    /// Sends a frame of this robot to the cable.
    pub fn send(&mut self, frame: &Frame) {
        if CABLE_IS_WIRED && self.channel.is_open() {
            print_to_cable(frame, now());
        }
    }

    /// Whether a frame of this robot that finds no mailbox is not worth waiting for.
    pub fn goes_on_without(&self, can: &mut Can) -> bool {
        if !CABLE_IS_WIRED || !self.channel.is_open() {
            return false;
        }
        can.look_after();
        !can.is_joined()
    }

    /// What is to be made of the CAN controller's state: with an open channel bus-off is not the
    /// end of the master's way to this robot.
    pub fn judge(&mut self, health: Health, can: &mut Can, side: &mut BusSide) -> Health {
        if !CABLE_IS_WIRED {
            return health;
        }
        side.counters_mut().cable = self.losses(can);
        if !self.channel.is_open() {
            return health;
        }
        if health.bus_off {
            can.look_after();
            if self.retry <= now() {
                self.retry = now() + RETRY;
                can.discard();
                can.recover();
            }
        }
        if can.has_been_left() {
            side.on_fault(now(), Fault::BusOff);
        }
        Health {
            bus_off: false,
            ..health
        }
    }
}
