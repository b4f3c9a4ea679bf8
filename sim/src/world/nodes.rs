//! The nodes of the bus: their arbitration, and their reaction to the end of a frame.
//!
//! Nodes are numbered: first the robots, then a foreign node that only babbles, then the ports: a
//! port may be added while a frame is on the wire, and no other number changes by that. While
//! the bus is parted, its far half is a separate bus with robots only; a robot that is alone on it
//! gets no acknowledge.

use canopen::{Frame, Micros};

use super::World;
use super::unit::Unit;
use crate::bus::errors::{ErrorState, RECOVERY_NS, SUSPEND, TransmitError};
use crate::bus::{BIT_NS, Fate, Transfer};
use canopen::bits::Wire;

impl World {
    /// Updates the nodes' own state before arbitration.
    pub(super) fn look_at_nodes(&mut self) {
        let now_ns = self.now_ns;
        for port in &mut self.ports {
            if port.errors.state() == ErrorState::BusOff && port.back_ns <= now_ns {
                port.errors.recovered();
            }
        }
        if !self.all_connected {
            self.all_connected = true;
            for unit in &mut self.units {
                let is_late = unit.injected.delay_ns > 0 || unit.held.is_some();
                if is_late || unit.far || !unit.connected {
                    self.all_connected = false;
                    unit.look(now_ns);
                }
            }
        }
        self.suspended.retain(|(_, until)| *until > now_ns);
    }

    /// The next time at which a node may want to send that does not want to now, ns.
    pub(super) fn next_of_nodes(&self) -> u64 {
        let now_ns = self.now_ns;
        let coming = self.ports.iter().filter_map(|port| {
            let (at, _) = port.send.front()?;
            let off = port.errors.state() == ErrorState::BusOff;
            Some(if off { port.back_ns.max(*at) } else { *at })
        });
        let others = if self.all_connected {
            &[]
        } else {
            self.units.as_slice()
        };
        let units = others.iter().filter_map(Unit::next_ns);
        let suspended = self.suspended.iter().map(|(_, until)| *until);
        coming
            .chain(units)
            .chain(suspended)
            .filter(|at| *at > now_ns)
            .min()
            .unwrap_or(u64::MAX)
    }

    /// Whether a cable is broken.
    pub(super) fn is_parted(&self) -> bool {
        !self.all_connected && self.units.iter().any(|unit| unit.far)
    }

    /// Arbitrates the free bus, or its far half.
    pub(super) fn arbitrate(&mut self, far: bool) {
        let now_ns = self.now_ns;
        let (babbler, first_port) = (self.babbler(), self.first_port());
        let ports = self.ports.iter().enumerate();
        let from_ports = ports.filter_map(|(n, port)| {
            let (at, frame) = port.send.front()?;
            let ready = *at <= now_ns && port.errors.state() != ErrorState::BusOff;
            (ready && !far).then_some((first_port + n, *frame))
        });
        let units = self.units.iter().enumerate();
        let units = units.filter(|(_, unit)| unit.far == far);
        let from_units = units.filter_map(|(n, unit)| Some((n, unit.wants(now_ns)?)));
        let babble = self
            .disturbances
            .babble
            .filter(|_| !far)
            .map(|frame| (babbler, frame));
        let contenders = from_ports
            .chain(from_units)
            .chain(babble)
            .filter(|(node, _)| self.suspended.iter().all(|(waits, _)| waits != node));
        let (ports, units) = (&self.ports, &self.units);
        let state = |node: usize| match node.checked_sub(first_port) {
            Some(n) => ports[n].errors.state(),
            None => units
                .get(node)
                .map_or(ErrorState::Active, Unit::error_state),
        };
        let disturbances = &mut self.disturbances;
        let mut missed = Vec::new();
        let bus = if far { &mut self.far } else { &mut self.bus };
        let is_active = |node: usize| state(node) == ErrorState::Active;
        let transfer = bus.arbitrate(now_ns, contenders, is_active, |senders, frame| {
            let active = senders.iter().any(|sender| is_active(*sender));
            let receives = |(n, unit): (usize, &Unit)| {
                let sends = senders.contains(&n);
                unit.far == far && unit.connected && unit.powered && !sends
            };
            // In the other half the ports are there.
            if far && !units.iter().enumerate().any(receives) {
                return Fate::Unacknowledged { active };
            }
            let mut fate = disturbances.fate(frame, active);
            for (n, unit) in units.iter().enumerate() {
                if !receives((n, unit)) || !disturbances.strikes(unit.injected.bad_receiver, frame)
                {
                    continue;
                }
                missed.push(n);
                if fate == Fate::Good && unit.error_state() == ErrorState::Active {
                    fate = Fate::Refused { by: n };
                }
            }
            fate
        });
        let Some(transfer) = transfer else {
            return;
        };
        for (n, unit) in self.units.iter_mut().enumerate() {
            if unit.far != far {
                continue;
            }
            unit.misses_this = missed.contains(&n);
            let sends = transfer.is_sent_by(n) || transfer.dropped.contains(&n);
            unit.sends_own = sends && unit.injected.babble.is_none();
            if unit.injected.babble.is_some() || !unit.connected {
                continue;
            }
            if unit.sends_own {
                unit.robot.begin();
            } else if unit.wants(now_ns).is_some() {
                unit.robot.lost_arbitration();
            }
        }
    }

    /// Reports the outcome of a frame to all nodes in the same half.
    pub(super) fn deliver(&mut self, transfer: &Transfer, far: bool) {
        let destroyed = transfer.fate.is_destroyed();
        if !far {
            self.deliver_to_ports(transfer);
        }
        self.deliver_to_units(transfer, far);
        let bus = if far { &self.far } else { &self.bus };
        let until = bus.free_at_ns() + u64::from(SUSPEND) * BIT_NS;
        let senders = transfer.others.iter().chain(&transfer.dropped);
        for sender in senders.copied().chain([transfer.sender]) {
            let state = match sender.checked_sub(self.first_port()) {
                Some(n) => self.ports[n].errors.state(),
                None => (self.units.get(sender)).map_or(ErrorState::Active, Unit::error_state),
            };
            if state == ErrorState::Passive {
                self.suspended.push((sender, until));
            }
        }
        if destroyed {
            self.digest.error_frame(transfer.end_ns);
        } else {
            self.digest.frame(transfer.end_ns, &transfer.frame);
        }
        if let Some(log) = &mut self.candump {
            if destroyed {
                log.error(transfer.end_ns, transfer.fate);
            } else {
                log.frame(transfer.end_ns, &transfer.frame);
            }
        }
    }

    fn deliver_to_ports(&mut self, transfer: &Transfer) {
        let time = Micros(transfer.end_ns / 1_000);
        let first = self.first_port();
        for (n, port) in self.ports.iter_mut().enumerate() {
            if let Some(failed) = seen_by_sender(transfer, first + n) {
                match failed {
                    None => {
                        port.errors.transmitted();
                        port.send.pop_front();
                    }
                    Some(error) => {
                        if port.errors.transmit_failed(error) {
                            port.back_ns = transfer.end_ns + RECOVERY_NS;
                        }
                    }
                }
            } else if port.errors.state() == ErrorState::BusOff {
            } else if transfer.fate.is_destroyed() {
                port.errors.receive_failed(false);
            } else {
                port.errors.received();
                if !port.deaf {
                    port.received.push_back((time, transfer.frame));
                }
            }
        }
    }

    fn deliver_to_units(&mut self, transfer: &Transfer, far: bool) {
        for (n, unit) in self.units.iter_mut().enumerate() {
            if let Some(failed) = seen_by_sender(transfer, n) {
                if !unit.sends_own {
                    continue;
                }
                unit.robot.set_now(transfer.end_ns);
                match failed {
                    None => unit.robot.transmitted(),
                    Some(error) => unit.robot.transmit_failed(error),
                }
            } else if !unit.connected || unit.far != far {
                continue;
            } else if transfer.fate.is_destroyed() {
                let by_it = transfer.fate == Fate::Refused { by: n };
                unit.robot.set_now(transfer.end_ns);
                unit.robot.receive_failed(by_it);
            } else if unit.misses_this {
                unit.robot.set_now(transfer.end_ns);
                unit.robot.receive_failed(false);
            } else if unit.injected.misses != Some(transfer.frame.id()) {
                unit.robot.set_now(transfer.end_ns);
                unit.robot.receive(&transfer.frame);
            }
            unit.has_run();
        }
    }

    /// The foreign node.
    fn babbler(&self) -> usize {
        self.units.len()
    }

    pub(super) fn first_port(&self) -> usize {
        self.babbler() + 1
    }
}

/// The outcome for this node, if it is one of the senders.
fn seen_by_sender(transfer: &Transfer, node: usize) -> Option<Option<TransmitError>> {
    if transfer.is_sent_by(node) {
        Some(sender_sees(transfer.fate))
    } else if transfer.dropped.contains(&node) {
        Some(Some(TransmitError::Bit))
    } else {
        None
    }
}

/// The sender's view of the outcome.
fn sender_sees(fate: Fate) -> Option<TransmitError> {
    match fate {
        Fate::Good => None,
        Fate::Corrupt { .. } | Fate::CutOff | Fate::Collided { .. } => Some(TransmitError::Bit),
        Fate::Unacknowledged { .. } => Some(TransmitError::Acknowledge),
        Fate::Refused { .. } => Some(TransmitError::Form),
    }
}

impl Unit {
    pub(super) fn error_state(&self) -> ErrorState {
        self.robot.error_state().0
    }

    /// The frame for which it wants the bus now.
    fn wants(&self, now_ns: u64) -> Option<Frame> {
        if !self.connected {
            return None;
        }
        if self.powered && self.injected.babble.is_some() {
            return self.injected.babble;
        }
        let frame = self.robot.pending()?;
        let held = self.injected.delay_ns > 0
            && self
                .held
                .is_none_or(|(_, since)| since + self.injected.delay_ns > now_ns);
        (!held).then_some(frame)
    }

    /// When it may next want something that it does not want now, ns.
    fn next_ns(&self) -> Option<u64> {
        if !self.connected {
            return self.tries_alone().then_some(self.alone_ns);
        }
        let (_, since) = self.held?;
        Some(since + self.injected.delay_ns)
    }

    /// Notes since when it has had its frame, and lets it try alone on a stub without a bus.
    fn look(&mut self, now_ns: u64) {
        if self.injected.delay_ns > 0 {
            let pending = self.robot.pending();
            if self.held.map(|(frame, _)| frame) != pending {
                self.held = pending.map(|frame| (frame, now_ns));
            }
        }
        if !self.connected
            && self.tries_alone()
            && self.alone_ns <= now_ns
            && let Some(frame) = self.robot.pending()
        {
            let bits = Wire::of(&frame).bits_when_unacknowledged();
            self.alone_ns = now_ns + u64::from(bits) * BIT_NS;
            self.robot.set_now(now_ns);
            self.robot.begin();
            self.robot.transmit_failed(TransmitError::Acknowledge);
            self.has_run();
        }
    }

    /// Whether a node without a connection keeps sending: once it is error passive, that has no
    /// further effect.
    fn tries_alone(&self) -> bool {
        self.error_state() == ErrorState::Active && self.robot.pending().is_some()
    }
}
