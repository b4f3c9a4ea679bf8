//! `omnibus bridge`: other programs drive and observe the group by JSON lines.
//!
//! A [`Bridge`] stands between a [`Pilot`] and any number of clients, each a pair of a reader and a
//! writer: standard input and output, a TCP connection, a Unix socket. Each client gets the
//! telemetry from a queue of its own, so a slow one loses its oldest lines and delays no client.
//! Who may drive is decided by the same [`Controls`] as for the page. `docs/bridge.md` has the
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
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use group::GroupFile;
use serde_json::Value;

use self::message::{LONGEST, Request};
use crate::abort::Abort;
use crate::controls::Controls;
use crate::controls::arbiter::Client;
use crate::monitor::telemetry::{DEFAULT_CAPACITY, Hub, Interest, Subscription, Telemetry};
use crate::pilot::Pilot;

/// How often a client's writer looks whether it is still wanted, and the bridge whether it is to
/// end.
const TICK: Duration = Duration::from_millis(50);

/// What all clients share.
pub struct Bridge {
    welcome: Value,
    /// What clients hear. The controls hear it first.
    hub: Hub,
    controls: Controls,
    /// Shortest time between two states that a client gets, in s.
    interval: f64,
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
        Self {
            welcome: message::welcome(group, bus),
            hub: Hub::default(),
            controls: Controls::of(pilot, &group.limits),
            interval,
        }
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
        let client = self.controls.client();
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
        self.controls.gone(client);
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
        match *request {
            Request::Start => {
                self.controls.take(client)?;
                self.controls.start(client)
            }
            Request::Stop => {
                self.controls.stop();
                Ok(())
            }
            Request::Twist { twist, timeout_ms } => self.controls.stream(client, twist, timeout_ms),
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
                bridge.controls.on_telemetry(&item);
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
