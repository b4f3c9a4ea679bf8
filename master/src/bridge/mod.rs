//! `omnibus bridge`: other programs drive the group and see it, by lines of JSON.
//!
//! A [`Bridge`] stands between a [`Pilot`] and any number of clients, each a pair of a reader and a
//! writer: standard input and output, a TCP connection, a Unix socket. Each client gets the
//! telemetry from a queue of its own, so a slow one loses its oldest lines and delays no client.
//! Who may drive is decided by the same [`Arbiter`] as for the page. `docs/bridge.md` has the
//! messages; [`message`] reads and writes them.
//!
//! A velocity is good for the time that its message names. After that the group is commanded to
//! stand and the robots ramp by their limits; the same happens when the client goes. What a hung
//! bridge cannot do any more, the robots do by their command timeout.

#[cfg(feature = "foxglove")]
pub mod live;
pub mod message;
pub mod server;

use std::io::{self, BufRead, Read, Write};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use group::GroupFile;
use kinematics::Twist;
use serde_json::Value;

use self::message::{LONGEST, Request};
use crate::abort::Abort;
use crate::monitor::telemetry::{
    DEFAULT_CAPACITY, EventKind, Hub, Interest, SessionState, Subscription, Telemetry,
};
use crate::pilot::{Order, Pilot};
use crate::serve::arbiter::{Arbiter, Client, Reply};
use crate::serve::message::ClientMessage;

/// How often a client's writer looks whether it is still wanted, and the bridge whether it is to
/// end.
const TICK: Duration = Duration::from_millis(50);

/// What all clients share.
pub struct Bridge {
    welcome: Value,
    /// What clients hear. The arbiter hears it first, so that no client sees a state in which it
    /// would still be refused.
    hub: Hub,
    arbiter: Mutex<Arbiter>,
    order: Box<dyn Fn(Order) + Send + Sync>,
    started: Instant,
    /// Shortest time between two states that a client gets, in s.
    interval: f64,
    next_client: AtomicU64,
}

/// A thread that panicked has not left these half changed.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Bridge {
    /// A bridge to the group that `pilot` flies. `interval` is the shortest time between two states
    /// that a client gets, in s.
    #[must_use]
    pub fn new(pilot: &Arc<Pilot>, group: &GroupFile, bus: &str, interval: f64) -> Self {
        let reach = Arc::downgrade(pilot);
        Self {
            welcome: message::welcome(group, bus),
            hub: Hub::default(),
            arbiter: Mutex::new(Arbiter::new(&group.limits, true)),
            // A pilot that has ended ends the bridge, too.
            order: Box::new(move |order| {
                if let Some(pilot) = reach.upgrade() {
                    pilot.order(order);
                }
            }),
            started: Instant::now(),
            interval,
            next_client: AtomicU64::new(1),
        }
    }

    /// ms since the bridge started.
    fn now(&self) -> u64 {
        u64::try_from(self.started.elapsed().as_millis()).unwrap_or(u64::MAX)
    }

    /// Serves one client until it has gone: reads its requests here, writes its telemetry in a
    /// thread of its own. The robots are stopped when it drove.
    ///
    /// # Errors
    /// When the connection fails, or a line is too long.
    pub fn serve(
        &self,
        input: impl BufRead,
        output: impl Write + Send + 'static,
    ) -> io::Result<()> {
        let client = self.next_client.fetch_add(1, Ordering::Relaxed);
        let mut output = output;
        line(&mut output, &self.welcome)?;
        let output = Arc::new(Mutex::new(output));
        let over = Arc::new(AtomicBool::new(false));
        let stream = self.hub.subscribe(Interest::Group, DEFAULT_CAPACITY);
        let writer = {
            let (output, over, interval) = (Arc::clone(&output), Arc::clone(&over), self.interval);
            std::thread::spawn(move || publish(&stream, &output, &over, interval))
        };
        let read = self.listen(client, input, &output);
        self.gone(client);
        over.store(true, Ordering::Relaxed);
        let _ = writer.join();
        read
    }

    fn listen<W: Write>(
        &self,
        client: Client,
        mut input: impl BufRead,
        output: &Mutex<W>,
    ) -> io::Result<()> {
        let mut text = Vec::new();
        loop {
            text.clear();
            let mut room = (&mut input).take(LONGEST as u64 + 1);
            if room.read_until(b'\n', &mut text)? == 0 {
                return Ok(());
            }
            let request = Request::parse(&text);
            let understood = request.is_ok();
            let done = request.and_then(|request| self.handle(client, &request));
            if let Err(reason) = done {
                line(&mut *lock(output), &message::refused(&reason))?;
            }
            // A client that speaks another language, such as a browser, is disconnected.
            if !understood {
                return Ok(());
            }
        }
    }

    /// Does what a client asks for, or says why not.
    fn handle(&self, client: Client, request: &Request) -> Result<(), String> {
        let now = self.now();
        // Held until the order is out: orders leave in the order of decisions.
        let mut arbiter = lock(&self.arbiter);
        match *request {
            Request::Start => {
                for wish in [ClientMessage::Take {}, ClientMessage::Start {}] {
                    if let Reply::Refused(reason) = arbiter.handle(now, client, true, &wish) {
                        return Err(reason);
                    }
                }
                (self.order)(Order::Start);
            }
            Request::Stop => {
                arbiter.stop();
                (self.order)(Order::Stop);
            }
            Request::Twist { twist, timeout_ms } => {
                let permitted = arbiter.permit(now, client, twist);
                let drives = arbiter.drives(client);
                let good_us = timeout_ms * 1_000;
                match &permitted {
                    Ok(()) => (self.order)(Order::Twist(twist, good_us)),
                    Err(_) if drives => (self.order)(Order::Twist(Twist::ZERO, 0)),
                    Err(_) => {}
                }
                return permitted;
            }
        }
        Ok(())
    }

    fn gone(&self, client: Client) {
        let mut arbiter = lock(&self.arbiter);
        if arbiter.drives(client) {
            arbiter.gone(client);
            (self.order)(Order::Twist(Twist::ZERO, 0));
            (self.order)(Order::Stop);
        }
    }

    /// Keeps the arbiter up to date with what the robots do.
    fn on_telemetry(&self, item: &Telemetry) {
        let mut arbiter = lock(&self.arbiter);
        match item {
            Telemetry::Snapshot(snapshot) => {
                let running = snapshot.phase == SessionState::Running;
                arbiter.set_running(running);
                if running && !arbiter.is_wanted(self.now()) {
                    (self.order)(Order::Stop);
                }
            }
            Telemetry::Event(event) if matches!(event.what, EventKind::Failed(_)) => arbiter.stop(),
            Telemetry::Event(_) | Telemetry::Frame(_) => {}
        }
    }
}

/// Keeps the bridge going until `abort` is asked for, `ended` says so, or the bus fails; then the
/// group is ramped down.
///
/// # Errors
/// When the bus cannot be opened or fails.
pub fn operate(
    pilot: Arc<Pilot>,
    bridge: &Bridge,
    abort: &Abort,
    ended: &AtomicBool,
) -> Result<(), crate::run::DriveError> {
    let stream = pilot.telemetry();
    std::thread::scope(|scope| {
        // Until the group has ended, its ramp included.
        scope.spawn(|| {
            for item in stream {
                bridge.on_telemetry(&item);
                bridge.hub.publish(&item);
            }
            bridge.hub.end();
        });
        while !abort.is_asked() && !ended.load(Ordering::Relaxed) && !pilot.is_over() {
            std::thread::sleep(TICK);
        }
        Pilot::finish_shared(pilot)
    })
}

/// Writes what the subscription brings until the client or the session is over.
fn publish<W: Write>(stream: &Subscription, output: &Mutex<W>, over: &AtomicBool, interval: f64) {
    let mut last = f64::NEG_INFINITY;
    while !over.load(Ordering::Relaxed) && !stream.is_over() {
        let value = match stream.next_within(TICK) {
            // Half a microsecond: times are sums of floating-point periods.
            Some(Telemetry::Snapshot(now)) if now.t >= last + interval - 5e-7 => {
                last = now.t;
                message::state(&now)
            }
            Some(Telemetry::Event(event)) => message::event(&event),
            Some(_) | None => continue,
        };
        if line(&mut *lock(output), &value).is_err() {
            return;
        }
    }
}

fn line(output: &mut impl Write, value: &Value) -> io::Result<()> {
    output.write_all(format!("{value}\n").as_bytes())?;
    output.flush()
}
