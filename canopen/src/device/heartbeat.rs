//! Heartbeat: this device's own (0x1017) and those it monitors (0x1016).
//!
//! A consumer starts with the first heartbeat it receives, as CiA 301, 7.2.8.3.2.2 requires: a node
//! that never appeared is not lost.
//!
//! The first period after a start is shorter, by up to a half that follows from the serial number.
//! Two devices with one node-ID by mistake, switched on or configured at the same moment, would
//! otherwise send their heartbeats in the same bits for a long time, and neither would receive the
//! other's.

use super::{Core, HEARTBEAT};
use crate::time::Timer;
use crate::{Config, Emergency, Event, Frame, Micros, NmtState, NodeId};

/// How many heartbeats a device can monitor: the master and sixteen peers.
pub const MAX_CONSUMERS: usize = 17;

#[derive(Clone, Copy)]
pub(super) struct Consumer {
    /// As in 0x1016: node-ID in bits 16 to 23, time in ms below.
    pub entry: u32,
    timer: Timer,
    state: Option<NmtState>,
}

#[derive(Clone)]
pub(super) struct Heartbeat {
    /// 0x1017.
    pub period_ms: u16,
    timer: Timer,
    pub consumers: [Consumer; MAX_CONSUMERS],
}

impl Consumer {
    const OFF: Self = Self {
        entry: 0,
        timer: Timer::OFF,
        state: None,
    };

    pub const fn new(entry: u32) -> Self {
        Self { entry, ..Self::OFF }
    }

    pub fn of(node: NodeId, millis: u16) -> Self {
        Self::new(u32::from(node.get()) << 16 | u32::from(millis))
    }

    pub const fn node(&self) -> Option<NodeId> {
        let [_, _, node, _] = self.entry.to_le_bytes();
        NodeId::new(node)
    }

    pub const fn millis(&self) -> u16 {
        crate::bytes::low_u16(self.entry)
    }

    /// CiA 301 ignores entries without a node or without a time.
    pub const fn is_used(&self) -> bool {
        self.millis() != 0 && self.node().is_some()
    }
}

impl Heartbeat {
    pub fn new(config: &Config) -> Self {
        let mut consumers = [Consumer::OFF; MAX_CONSUMERS];
        for (consumer, (node, millis)) in consumers.iter_mut().zip(config.consumers) {
            *consumer = Consumer::of(*node, *millis);
        }
        Self {
            period_ms: config.heartbeat_ms,
            timer: Timer::OFF,
            consumers,
        }
    }
}

/// The node that a heartbeat or boot-up message comes from, and its state.
pub(super) fn parse(frame: &Frame) -> Option<(NodeId, NmtState)> {
    match (frame.id() & 0x780, frame.data()) {
        (HEARTBEAT, &[code]) => NodeId::of_cob_id(frame.id()).zip(NmtState::from_code(code)),
        _ => None,
    }
}

impl Core {
    /// Starts a heartbeat period now.
    pub(super) fn start_heartbeat(&mut self, now: Micros) {
        let timer = Timer::after_millis(now, self.heartbeat.period_ms);
        // The golden ratio spreads neighbouring numbers over the whole range.
        let spread = self.config.identity.serial.wrapping_mul(0x9E37_79B9);
        let half_us = u64::from(self.heartbeat.period_ms).saturating_mul(500);
        let earlier = half_us.saturating_mul(spread.into()) >> 32;
        self.heartbeat.timer = Timer::at(timer.moment() - Micros(earlier));
        self.out.wake(self.heartbeat.timer);
    }

    pub(super) fn on_heartbeat(&mut self, now: Micros, sender: NodeId, state: NmtState) {
        if self.state == NmtState::Initialising {
            return;
        }
        self.lss.crowded |= self.config.permits_node(sender.get());
        let used = |consumer: &&mut Consumer| consumer.is_used() && consumer.node() == Some(sender);
        let Some(consumer) = self.heartbeat.consumers.iter_mut().find(used) else {
            return;
        };
        consumer.timer = Timer::after_millis(now, consumer.millis());
        self.out.wake(consumer.timer);
        let node = sender;
        match consumer.state.replace(state) {
            None => {
                self.clear(now, Emergency::HEARTBEAT_LOST, node.get());
                self.out.emit(Event::HeartbeatStarted { node, state });
            }
            Some(before) if before != state => {
                self.out.emit(Event::HeartbeatChanged { node, state });
            }
            Some(_) => {}
        }
    }

    pub(super) fn poll_heartbeat(&mut self, now: Micros) {
        let heartbeat = &mut self.heartbeat;
        if let (Some(node), true) = (self.node, heartbeat.timer.due(now)) {
            self.out
                .send(Frame::of(node.cob_id(HEARTBEAT), [self.state.code()]));
            // In step with the last one due, unless a whole period has been missed.
            let on_time = Timer::after_millis(heartbeat.timer.moment(), heartbeat.period_ms);
            heartbeat.timer = match on_time.due(now) {
                true => Timer::after_millis(now, heartbeat.period_ms),
                false => on_time,
            };
        }
        self.out.wake(heartbeat.timer);
        let mut lost = false;
        for at in 0..MAX_CONSUMERS {
            let Some(consumer) = self.heartbeat.consumers.get_mut(at) else {
                break;
            };
            if !consumer.timer.due(now) {
                self.out.wake(consumer.timer);
                continue;
            }
            consumer.timer = Timer::OFF;
            consumer.state = None;
            lost = true;
            self.out.count(|counters| &mut counters.heartbeats_lost);
            if let Some(node) = consumer.node() {
                self.out.emit(Event::HeartbeatLost { node });
                self.raise_communication(now, Emergency::HEARTBEAT_LOST, node.get());
            }
        }
        if lost {
            self.react_to_communication_error(now);
        }
    }
}
