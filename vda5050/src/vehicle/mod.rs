//! One vehicle: takes messages, holds the order, and returns what to drive and what to send.
//!
//! The caller passes the time with every call, in ms since 1970. It calls [`Vehicle::receive`] for
//! a message, [`Vehicle::passed`] when a node is reached, and [`Vehicle::see`] periodically with
//! the observed state of the vehicle; then it takes [`Vehicle::requests`] and
//! [`Vehicle::outgoing`].
//!
//! Every change that chapter 6.10 names produces a state message of its own, including every node
//! that is passed, so a fleet control that counts nodes misses none. Without a connection at most
//! [`MOST_WAITING`] states wait here, and they are sent in order when it is back. Losing the
//! connection changes nothing else: the vehicle drives to the last released node (6.2).
//!
//! `orders` decides about orders, `actions` executes instant actions.

mod actions;
mod orders;

use std::collections::VecDeque;

use kinematics::{Pose, Twist};
use serde_json::Value;

use crate::configuration::Configuration;
use crate::error::Refusal;
use crate::leg::Leg;
use crate::message::Connection;
use crate::message::factsheet;
use crate::message::state::{ActionState, ActionStatus, OperatingMode, State, VehicleError};
use crate::order::Held;

/// Messages that wait for a connection at most; the oldest go first.
pub const MOST_WAITING: usize = 1_000;
/// Refusals and instant actions that are remembered at most.
const MOST_REMEMBERED: usize = 50;

/// Where a message comes from or goes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topic {
    /// Orders.
    Order,
    /// Actions at once.
    InstantActions,
    /// What the vehicle does.
    State,
    /// Where it is.
    Visualization,
    /// Whether it is there.
    Connection,
    /// What it can do.
    Factsheet,
}

impl Topic {
    /// The last level.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Order => "order",
            Self::InstantActions => "instantActions",
            Self::State => "state",
            Self::Visualization => "visualization",
            Self::Connection => "connection",
            Self::Factsheet => "factsheet",
        }
    }
}

/// A message to be sent.
#[derive(Clone, Debug, PartialEq)]
pub struct Outgoing {
    /// Where to.
    pub topic: Topic,
    /// What.
    pub message: Value,
}

/// What the driver of the vehicle is asked to do.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Drive these legs, from where the vehicle stands (`fresh`) or after those before.
    Drive {
        /// The way.
        legs: Vec<Leg>,
        /// Whether they begin a new order.
        fresh: bool,
    },
    /// Stop on the way.
    Pause,
    /// Drive on.
    Resume,
    /// Stop on the way and forget it.
    Stop,
    /// The standing vehicle is here on the map.
    SetPosition(Pose<f64>),
}

/// What is seen of the vehicle.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seen {
    /// Where it is on the map, where that is known.
    pub pose: Option<Pose<f64>>,
    /// How fast it moves, in its own axes.
    pub velocity: Option<Twist<f64>>,
    /// Whether it moves, or is about to.
    pub driving: bool,
    /// What is wrong with it.
    pub errors: Vec<VehicleError>,
    /// Whether a drive ended before its end, so that the vehicle is not where its order has it.
    pub interrupted: bool,
    /// Whether an emergency stop is active.
    pub emergency_stop: bool,
    /// Whether its supply is low.
    pub supply_low: bool,
    /// Who controls it.
    pub mode: OperatingMode,
}

/// One vehicle.
#[derive(Clone, Debug)]
pub struct Vehicle {
    configuration: Configuration,
    map: String,
    order: Option<Held>,
    last_node: (String, u32),
    paused: bool,
    actions: Vec<ActionState>,
    refusals: Vec<Refusal>,
    seen: Seen,
    requests: Vec<Request>,
    waiting: VecDeque<Outgoing>,
    headers: [u32; 4],
    connected: bool,
    changed: bool,
    last_state: Option<u64>,
    last_visualization: u64,
}

impl Vehicle {
    /// A vehicle without an order.
    #[must_use]
    pub fn new(configuration: Configuration) -> Self {
        Self {
            map: configuration.map.clone(),
            configuration,
            order: None,
            last_node: (String::new(), 0),
            paused: false,
            actions: Vec::new(),
            refusals: Vec::new(),
            seen: Seen::default(),
            requests: Vec::new(),
            waiting: VecDeque::new(),
            headers: [0; 4],
            connected: false,
            changed: false,
            last_state: None,
            last_visualization: 0,
        }
    }

    /// Whether an order is being executed or waits for more of it.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        self.order.as_ref().is_some_and(Held::is_active)
    }

    /// What is to be done, once.
    pub fn requests(&mut self) -> Vec<Request> {
        std::mem::take(&mut self.requests)
    }

    /// What is to be sent, once and in this order; nothing without a connection.
    pub fn outgoing(&mut self) -> Vec<Outgoing> {
        if !self.connected {
            return Vec::new();
        }
        self.waiting.drain(..).collect()
    }

    /// There is a connection: says so, and what the vehicle is.
    pub fn connect(&mut self, now: u64) {
        self.connected = true;
        let identity = &self.configuration.identity;
        let online = identity.connection(self.headers[0], now, Connection::Online);
        self.headers[0] = self.headers[0].wrapping_add(1);
        self.waiting.push_front(Outgoing {
            topic: Topic::Connection,
            message: online,
        });
        self.send_factsheet(now);
        self.send_state(now);
    }

    /// The connection is gone.
    pub fn disconnect(&mut self) {
        self.connected = false;
    }

    /// What is sent before the connection is closed on purpose.
    pub fn offline(&mut self, now: u64) -> Outgoing {
        let identity = &self.configuration.identity;
        Outgoing {
            topic: Topic::Connection,
            message: identity.connection(self.headers[0], now, Connection::Offline),
        }
    }

    /// Takes a message.
    pub fn receive(&mut self, topic: Topic, text: &[u8], now: u64) {
        match topic {
            Topic::Order => self.take_order(text),
            Topic::InstantActions => self.take_actions(text, now),
            Topic::State | Topic::Visualization | Topic::Connection | Topic::Factsheet => return,
        }
        self.settle();
        self.flush(now);
    }

    /// Takes what is seen of the vehicle.
    pub fn see(&mut self, seen: Seen, now: u64) {
        let before = &self.seen;
        self.changed |= before.driving != seen.driving
            || before.errors != seen.errors
            || before.emergency_stop != seen.emergency_stop
            || before.supply_low != seen.supply_low
            || before.mode != seen.mode
            || before.pose.is_some() != seen.pose.is_some();
        self.seen = seen;
        // Whoever takes the vehicle by hand takes it out of its order (6.10.6, MANUAL).
        if self.seen.mode != OperatingMode::Automatic && self.is_busy() {
            self.requests.push(Request::Stop);
            self.drop_order();
        }
        self.settle();
        self.flush(now);
        self.show(now);
    }

    /// A node was reached.
    pub fn passed(&mut self, sequence: u32, now: u64) {
        let Some(node) = self.order.as_mut().and_then(|order| order.pass(sequence)) else {
            return;
        };
        self.last_node = (node.node_id, node.sequence_id);
        self.changed = true;
        self.flush(now);
    }

    /// Ends the actions that wait for standstill. What has just been asked for is not seen yet.
    fn settle(&mut self) {
        if self.seen.driving || !self.requests.is_empty() {
            return;
        }
        if self.is_cancelling() {
            self.drop_order();
        }
        for action in &mut self.actions {
            if action.status == ActionStatus::Running {
                action.status = ActionStatus::Finished;
                self.changed = true;
            }
        }
        self.relocate();
    }

    /// Sends the state when something has changed, or when it is time.
    fn flush(&mut self, now: u64) {
        let interval = self.configuration.state_interval_ms;
        let due = self.last_state.is_none_or(|last| now >= last + interval);
        if self.changed || due {
            self.send_state(now);
        }
    }

    fn state(&self) -> State<'_> {
        let order = self.order.as_ref();
        State {
            order_id: order.map_or("", |order| &order.id),
            order_update_id: order.map_or(0, |order| order.update),
            last_node: (&self.last_node.0, self.last_node.1),
            nodes: order.map_or_else(Vec::new, |order| order.nodes.iter().collect()),
            edges: order.map_or_else(Vec::new, |order| order.edges.iter().collect()),
            driving: self.seen.driving,
            paused: self.paused,
            new_base_request: order.is_some_and(Held::wants_base),
            position: self.seen.pose,
            map: &self.map,
            velocity: self.seen.velocity,
            actions: &self.actions,
            supply_good: !self.seen.supply_low,
            mode: self.seen.mode,
            emergency_stop: self.seen.emergency_stop,
            refusals: &self.refusals,
            errors: &self.seen.errors,
        }
    }

    fn send_state(&mut self, now: u64) {
        let body = self.state().body(self.configuration.identity.version);
        self.push(Topic::State, 1, now, body);
        (self.changed, self.last_state) = (false, Some(now));
    }

    fn send_factsheet(&mut self, now: u64) {
        let body = factsheet::body(&self.configuration);
        self.push(Topic::Factsheet, 2, now, body);
    }

    /// Sends where the vehicle is. Without a connection that is of no use later.
    fn show(&mut self, now: u64) {
        let interval = self.configuration.visualization_interval_ms;
        if interval == 0 || !self.connected || now < self.last_visualization + interval {
            return;
        }
        self.last_visualization = now;
        let body = self.state().motion(self.configuration.identity.version);
        self.push(Topic::Visualization, 3, now, body);
    }

    fn push(
        &mut self,
        topic: Topic,
        counter: usize,
        now: u64,
        body: serde_json::Map<String, Value>,
    ) {
        let Some(header) = self.headers.get_mut(counter) else {
            return;
        };
        let message = self.configuration.identity.message(*header, now, body);
        *header = header.wrapping_add(1);
        if self.waiting.len() >= MOST_WAITING {
            self.waiting.pop_front();
        }
        self.waiting.push_back(Outgoing { topic, message });
    }
}
