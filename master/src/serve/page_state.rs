//! What all connections share: the newest state, the last events, and the controls.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use group::GroupFile;
use serde_json::Value;

use super::message::{self, ClientMessage};
use crate::abort::Abort;
use crate::controls::Controls;
use crate::controls::arbiter::Client;
use crate::monitor::listener::Reckoning;
use crate::monitor::telemetry::{Event, SessionState, Snapshot, Telemetry};
use crate::pilot::Pilot;
use crate::run::DriveError;

/// Time between two states that pages get, in ms.
const STATE_MS: u64 = 50;
/// Events kept for pages that come later.
const EVENT_HISTORY: usize = 60;

#[derive(Default)]
struct Published {
    /// Counts states.
    number: u64,
    at: u64,
    snapshot: Arc<Snapshot>,
    running: bool,
    events: VecDeque<Value>,
    /// Number of the event behind the last one kept.
    next_event: u64,
}

/// What all connections to the page share.
pub struct PageState {
    welcome: Value,
    controls: Controls,
    /// Whether pages may drive here.
    open: bool,
    published: Mutex<Published>,
}

/// What a connection has seen already.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cursor {
    state: u64,
    event: u64,
    seat: Option<(bool, bool)>,
    welcomed: bool,
}

/// A thread that panicked has not left these half changed.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl PageState {
    /// A page for a group on a bus; one that is not `open` only watches.
    #[must_use]
    pub fn new(group: &GroupFile, bus: &str, controls: Controls, open: bool) -> Self {
        Self {
            welcome: message::welcome(group, bus, open),
            controls,
            open,
            published: Mutex::default(),
        }
    }

    /// A number for a new connection.
    pub fn client(&self) -> Client {
        self.controls.client()
    }

    /// Takes a message of a client, `trusted` when it has shown the token; returns why it was
    /// refused.
    pub fn handle(&self, client: Client, trusted: bool, message: &ClientMessage) -> Option<String> {
        let controls = &self.controls;
        let done = match message {
            ClientMessage::Stop => {
                controls.stop();
                Ok(())
            }
            ClientMessage::Release => {
                controls.release(client);
                Ok(())
            }
            ClientMessage::Leave => {
                controls.gone(client);
                Ok(())
            }
            // Whether the token is right was found out before.
            ClientMessage::Hello { .. } => Ok(()),
            _ if !self.open => Err("this page only watches".into()),
            _ if !trusted => Err("driving needs the token".into()),
            ClientMessage::Take => controls.take(client),
            ClientMessage::Start => controls.start(client),
            &ClientMessage::Drive {
                press,
                twist,
                clock,
            } => controls.press(client, press, twist, clock),
            ClientMessage::Curve {
                press,
                curve,
                scale,
                clock,
            } => controls.press_curve(client, *press, (curve, *scale), *clock),
        };
        done.err()
    }

    /// A message that could not even be read: like every refused one it ends the press.
    pub fn confused(&self, client: Client) {
        self.handle(client, false, &ClientMessage::Release);
    }

    /// A connection has ended.
    pub fn gone(&self, client: Client) {
        self.controls.gone(client);
    }

    /// What a client has not seen yet, oldest first.
    pub fn news(&self, client: Client, cursor: &mut Cursor) -> Vec<Value> {
        let mut news = Vec::new();
        if !std::mem::replace(&mut cursor.welcomed, true) {
            news.push(self.welcome.clone());
        }
        let seat = (self.controls.drives(client), self.controls.has_driver());
        if cursor.seat.replace(seat) != Some(seat) {
            news.push(serde_json::json!({"type": "seat", "yours": seat.0, "taken": seat.1}));
        }
        let published = lock(&self.published);
        let stored = published.events.len() as u64;
        let oldest = published.next_event - stored;
        let skip = usize::try_from(cursor.event.saturating_sub(oldest)).unwrap_or(usize::MAX);
        news.extend(published.events.iter().skip(skip).cloned());
        cursor.event = published.next_event;
        if published.number != cursor.state {
            cursor.state = published.number;
            let Published {
                snapshot,
                at,
                running,
                ..
            } = &*published;
            news.push(message::state(snapshot, *at, *running));
        }
        news
    }

    /// Takes in what the pilot has seen.
    pub fn on_telemetry(&self, item: Telemetry, reckoning: &mut Reckoning) {
        // First of all, so that no page sees a state in which it would still be refused.
        self.controls.on_telemetry(&item);
        match item {
            Telemetry::Snapshot(snapshot) => {
                let target = snapshot.target.or(reckoning.advance(&snapshot));
                let mut snapshot = Arc::unwrap_or_clone(snapshot);
                snapshot.target = target;
                self.publish(Arc::new(snapshot));
            }
            Telemetry::Event(event) => self.on_event(&event),
            Telemetry::Frame(_) => {}
        }
    }

    fn publish(&self, snapshot: Arc<Snapshot>) {
        let now = self.controls.now();
        let running = snapshot.phase == SessionState::Running;
        let mut published = lock(&self.published);
        let changed = published.snapshot.phase != snapshot.phase;
        if changed || published.number == 0 || now >= published.at + STATE_MS {
            published.number += 1;
            published.at = now;
            published.snapshot = snapshot;
            published.running = running;
        }
    }

    fn on_event(&self, event: &Event) {
        let mut published = lock(&self.published);
        published.events.push_back(message::event(event));
        published.next_event += 1;
        if published.events.len() > EVENT_HISTORY {
            published.events.pop_front();
        }
    }
}

/// Shows pages what the pilot sees, until `abort` is asked for or the bus fails; then the group is
/// ramped down.
///
/// # Errors
/// When the bus cannot be opened or fails.
pub fn operate(pilot: Arc<Pilot>, page: &PageState, abort: &Abort) -> Result<(), DriveError> {
    let stream = pilot.telemetry();
    let mut reckoning = Reckoning::default();
    while !abort.is_asked() && !pilot.is_over() {
        if let Some(item) = stream.next_within(Duration::from_millis(STATE_MS)) {
            page.on_telemetry(item, &mut reckoning);
        }
    }
    Pilot::finish_shared(pilot)
}
