//! The robot as a CAN adapter: slcan on its cable, for the bus and for itself.
//!
//! The bus task calls it every turn: [`Gateway::receive`] before it looks at received frames, with
//! what the cable has brought, [`Gateway::send_overheard`] with what the bus has brought, and
//! [`Gateway::send`] with each frame of this robot. A frame of the cable reaches the robot when it
//! has left for the bus, so that all robots get the same frames in the same order at the same time;
//! alone, at once (`board`'s CAN driver has the rule). The cable's end of the protocol is
//! `can_text::slcan`.
//!
//! An open channel changes what is made of the CAN controller's state. The master is at the cable
//! then, so bus-off neither mutes the robot nor cuts its answers off; only if others were there
//! before, it is a fault, because the group is torn then. A closed channel changes nothing.
//!
//! What it cannot do: extended and remote frames (refused), other bit rates (refused), hardware
//! time stamps (those of `Z1` are of the interrupt), flow control: what the cable does not carry is
//! dropped, counted, and told by `F`.

use can_text::slcan::{self, Channel, STAMP_PERIOD_MS, Step, flags};
use canopen::Frame;
use control::time::Micros;
use protocol::Fault;
use robot::BusSide;

use crate::board::{CABLE_PATIENCE, Can, Health, Serial, now};

/// How long after a try to come back from bus-off the next follows.
const RETRY: Micros = Micros(100_000);

/// The adapter's state.
pub struct Gateway {
    serial: Option<Serial>,
    channel: Channel,
    /// A frame that waits for a mailbox, and since when.
    waiting: Option<(Frame, Micros)>,
    /// What was lost since the last `F`, as its bits.
    lost: u8,
    /// How often something was lost since the start.
    losses: u32,
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
            lost: 0,
            losses: 0,
            retry: Micros(0),
        }
    }

    /// Takes in what has come over the cable, up to a frame that has to wait for the bus.
    pub fn receive(&mut self, can: &mut Can) {
        let news = self.serial.as_ref().is_some_and(Serial::has_news);
        // A robot that is no gateway pays for the questions only.
        if news || self.channel.is_open() || can.has_one_of_the_cable() {
            self.process(can);
        }
    }

    #[inline(never)]
    fn process(&mut self, can: &mut Can) {
        if self.channel.is_open() || can.has_one_of_the_cable() {
            can.look_after();
        }
        let Some(arrived) = self.serial.as_mut().map(Serial::arrived) else {
            return;
        };
        if arrived.damaged {
            self.channel.spoil();
            self.lose(flags::OVERRUN);
        }
        loop {
            if self.waiting.is_some() && !self.pass_on(can) || can.is_passing_on() {
                return;
            }
            let Some(byte) = self.serial.as_mut().and_then(|port| port.read(&arrived)) else {
                return;
            };
            match self.channel.push(byte) {
                Some(Step::Send(frame)) => self.waiting = Some((frame, now())),
                Some(Step::Answer(answer)) => self.write(answer.as_bytes()),
                Some(Step::Flags) => {
                    defmt::info!("cable: {=u32} losses", self.losses);
                    let flags = core::mem::take(&mut self.lost) | can.status_flags();
                    self.write(slcan::flags_answer(flags).as_bytes());
                }
                None => continue,
            }
            can.set_gateway(self.channel.is_open());
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
            Some(false) => {
                self.lose(flags::TRANSMIT_FULL);
                self.write(&[slcan::REFUSED]);
            }
        }
        self.waiting = None;
        true
    }

    fn lose(&mut self, what: u8) {
        self.lost |= what;
        self.losses = self.losses.wrapping_add(1);
    }

    #[inline(never)]
    fn write(&mut self, bytes: &[u8]) {
        if let Some(serial) = &mut self.serial
            && !serial.write(bytes)
        {
            self.lose(flags::RECEIVE_FULL);
        }
    }

    /// Sends what the bus has brought to the cable.
    pub fn send_overheard(&mut self, can: &Can) {
        if !self.channel.is_open() {
            return;
        }
        while let Some(overheard) = can.try_overhear() {
            self.print(&overheard.frame, overheard.at_us);
        }
        let lost = can.take_losses();
        if lost != 0 {
            self.lose(lost);
        }
    }

    /// Sends a frame of this robot to the cable.
    pub fn send(&mut self, frame: &Frame) {
        if self.channel.is_open() {
            self.print(frame, low_us(now()));
        }
    }

    #[inline(never)]
    fn print(&mut self, frame: &Frame, at_us: u32) {
        let stamp = self.channel.stamps().then(|| stamp(at_us));
        let line = slcan::frame(frame, stamp);
        self.write(line.as_bytes());
    }

    /// Whether a frame of this robot that finds no mailbox is not worth waiting for.
    pub fn goes_on_without(&self, can: &Can) -> bool {
        self.channel.is_open() && !can.is_joined()
    }

    /// What is to be made of the CAN controller's state: with an open channel bus-off is not the
    /// end of the master's way to this robot.
    pub fn judge(&mut self, health: Health, can: &mut Can, side: &mut BusSide) -> Health {
        if !self.channel.is_open() {
            return health;
        }
        if health.bus_off && self.retry <= now() {
            self.retry = now() + RETRY;
            can.discard();
            can.recover();
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

/// A time as a time stamp: the milliseconds of its lower half, counted from that of now.
fn stamp(at_us: u32) -> u16 {
    let now = now();
    let ago = low_us(now).wrapping_sub(at_us);
    let at = Micros(now.0.saturating_sub(u64::from(ago)));
    u16::try_from(at.0 / 1_000 % u64::from(STAMP_PERIOD_MS)).unwrap_or(0)
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "compared by wrapping differences"
)]
fn low_us(time: Micros) -> u32 {
    time.0 as u32
}
