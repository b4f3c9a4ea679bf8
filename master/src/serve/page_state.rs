//! What all connections share: the newest state, the last events, the arbiter, and the way to the
//! pilot.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use group::GroupFile;
use kinematics::Twist;
use serde_json::Value;

use super::arbiter::{Arbiter, Client, Reply, STALE_MS};
use super::http::Names;
use super::message::{self, ClientMessage};
use crate::abort::Abort;
use crate::monitor::listener::Reckoning;
use crate::monitor::telemetry::{Event, EventKind, SessionState, Snapshot, Telemetry};
use crate::pilot::{Order, Pilot};
use crate::run::DriveError;

/// Time between two states that pages get, in ms.
const STATE_MS: u64 = 50;
/// Events kept for pages that come later.
const EVENT_HISTORY: usize = 60;

/// Who may do what.
#[derive(Clone, Debug)]
pub struct Access {
    /// Names of this server.
    pub names: Names,
    /// What a page has to show before it may drive.
    pub token: String,
    /// Whether a page has to show it before it may see anything.
    pub closed: bool,
}

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
    /// Who may do what.
    pub access: Access,
    welcome: Value,
    arbiter: Mutex<Arbiter>,
    published: Mutex<Published>,
    started: Instant,
    order: Box<dyn Fn(Order) + Send + Sync>,
    next_client: AtomicU64,
    /// Connections that are open.
    pub connections: AtomicUsize,
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
    /// A page for a group on a bus. `order` reaches the pilot; without one the page only watches.
    #[must_use]
    pub fn new(
        group: &GroupFile,
        bus: &str,
        access: Access,
        order: Option<Box<dyn Fn(Order) + Send + Sync>>,
    ) -> Self {
        Self {
            access,
            welcome: message::welcome(group, bus, order.is_some()),
            arbiter: Mutex::new(Arbiter::new(&group.limits, order.is_some())),
            published: Mutex::default(),
            started: Instant::now(),
            order: order.unwrap_or_else(|| Box::new(|_| {})),
            next_client: AtomicU64::new(1),
            connections: AtomicUsize::new(0),
        }
    }

    /// A number for a new connection.
    pub fn client(&self) -> Client {
        self.next_client.fetch_add(1, Ordering::Relaxed)
    }

    /// ms since the server started.
    fn now(&self) -> u64 {
        u64::try_from(self.started.elapsed().as_millis()).unwrap_or(u64::MAX)
    }

    /// Takes a message of a client; returns why it was refused.
    pub fn handle(&self, client: Client, trusted: bool, message: &ClientMessage) -> Option<String> {
        let now = self.now();
        // Held until the order is out: orders leave in the order of decisions.
        let mut arbiter = lock(&self.arbiter);
        let drove = arbiter.drives(client);
        let reply = arbiter.handle(now, client, trusted, message);
        match (message, &reply) {
            (ClientMessage::Start {}, Reply::Done) => (self.order)(Order::Start),
            (ClientMessage::Stop {}, _) => (self.order)(Order::Stop),
            (ClientMessage::Leave {}, _) if drove => (self.order)(Order::Stop),
            (ClientMessage::Drive { .. } | ClientMessage::Release {}, _) if drove => {
                (self.order)(Order::Twist(arbiter.twist(now), STALE_MS * 1_000));
            }
            _ => {}
        }
        match reply {
            Reply::Done => None,
            Reply::Refused(reason) => Some(reason),
        }
    }

    /// A message that could not even be read: like every refused one it ends the press.
    pub fn confused(&self, client: Client) {
        self.handle(client, false, &ClientMessage::Release {});
    }

    /// A connection has ended.
    pub fn gone(&self, client: Client) {
        let mut arbiter = lock(&self.arbiter);
        if arbiter.drives(client) {
            arbiter.gone(client);
            (self.order)(Order::Twist(Twist::ZERO, STALE_MS * 1_000));
            (self.order)(Order::Stop);
        }
    }

    /// What a client has not seen yet, oldest first.
    pub fn news(&self, client: Client, cursor: &mut Cursor) -> Vec<Value> {
        let mut news = Vec::new();
        if !std::mem::replace(&mut cursor.welcomed, true) {
            news.push(self.welcome.clone());
        }
        let seat = {
            let arbiter = lock(&self.arbiter);
            (arbiter.drives(client), arbiter.has_driver())
        };
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

    fn publish(&self, snapshot: Arc<Snapshot>) {
        let now = self.now();
        let running = snapshot.phase == SessionState::Running;
        lock(&self.arbiter).set_running(running);
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
        if matches!(event.what, EventKind::Failed(_)) {
            lock(&self.arbiter).stop();
        }
        let mut published = lock(&self.published);
        published.events.push_back(message::event(event));
        published.next_event += 1;
        if published.events.len() > EVENT_HISTORY {
            published.events.pop_front();
        }
    }

    /// Switches robots off that have not been moved for long.
    fn keep_house(&self) {
        let now = self.now();
        let mut arbiter = lock(&self.arbiter);
        let running = lock(&self.published).running;
        if running && !arbiter.is_wanted(now) {
            (self.order)(Order::Stop);
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
    let mut tidied = Instant::now();
    while !abort.is_asked() && !pilot.is_over() {
        match stream.next_within(Duration::from_millis(STATE_MS)) {
            Some(Telemetry::Snapshot(snapshot)) => {
                let target = snapshot.target.or(reckoning.advance(&snapshot));
                let mut snapshot = Arc::unwrap_or_clone(snapshot);
                snapshot.target = target;
                page.publish(Arc::new(snapshot));
            }
            Some(Telemetry::Event(event)) => page.on_event(&event),
            Some(Telemetry::Frame(_)) | None => {}
        }
        if tidied.elapsed() > Duration::from_secs(1) {
            tidied = Instant::now();
            page.keep_house();
        }
    }
    Pilot::finish_shared(pilot)
}
