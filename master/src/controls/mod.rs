//! The controls of a group: one place that decides who drives, for every way of driving it.
//!
//! ```text
//!  page, keyboard, gamepad, bridge, ROS 2, VDA 5050 --wishes--> Controls --orders--> Pilot
//!                                                                  ^                   |
//!                                                                  '---- telemetry ----'
//! ```
//!
//! [`Controls`] asks the [`Arbiter`] and passes what it permits to the pilot as [`Order`]s; the
//! order in which orders leave is the order of the decisions. Each source of commands has a
//! [`Client`] number from [`Controls::client`]. The owner of the session passes its telemetry to
//! [`Controls::on_telemetry`] before anyone else sees it, so that no client knows of a state in
//! which it would still be refused.
//!
//! What the controls cannot do: they move nothing by themselves, and they do not stop a program
//! that gives the pilot orders of its own.

pub mod arbiter;
pub mod fields;

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use group::Limits;
use kinematics::Twist;

use self::arbiter::{Arbiter, Client};
use crate::monitor::telemetry::{EventKind, SessionState, Telemetry};
use crate::pilot::{Errand, Order, Pilot};

/// How long the controls exist, in ms.
pub type Clock = Box<dyn Fn() -> u64 + Send + Sync>;

/// Where orders go.
pub type OrderSink = Box<dyn Fn(Order) + Send + Sync>;

/// Decides who drives, and tells the pilot.
pub struct Controls {
    arbiter: Mutex<Arbiter>,
    order: OrderSink,
    clock: Clock,
    next_client: AtomicU64,
}

impl Controls {
    /// Controls whose orders go to `order`. No client drives yet.
    #[must_use]
    pub fn new(limits: &Limits, order: OrderSink) -> Self {
        let started = Instant::now();
        let clock = move || u64::try_from(started.elapsed().as_millis()).unwrap_or(u64::MAX);
        Self::with_clock(limits, order, Box::new(clock))
    }

    /// The same on a clock of the caller's: virtual time, for one.
    #[must_use]
    pub fn with_clock(limits: &Limits, order: OrderSink, clock: Clock) -> Self {
        Self {
            arbiter: Mutex::new(Arbiter::new(limits)),
            order,
            clock,
            next_client: AtomicU64::new(1),
        }
    }

    /// Controls of the group that `pilot` flies, for as long as it does.
    #[must_use]
    pub fn of(pilot: &Arc<Pilot>, limits: &Limits) -> Self {
        let reach = Arc::downgrade(pilot);
        Self::new(
            limits,
            Box::new(move |order| {
                if let Some(pilot) = reach.upgrade() {
                    pilot.order(order);
                }
            }),
        )
    }

    /// A number for a new client.
    pub fn client(&self) -> Client {
        self.next_client.fetch_add(1, Ordering::Relaxed)
    }

    /// ms since these controls exist.
    #[must_use]
    pub fn now(&self) -> u64 {
        (self.clock)()
    }

    /// Held until an order is out. A thread that panicked has not left it half changed.
    fn arbiter(&self) -> MutexGuard<'_, Arbiter> {
        self.arbiter.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Makes a client the driver, unless another one is.
    ///
    /// # Errors
    /// With the reason why not.
    pub fn take(&self, client: Client) -> Result<(), String> {
        self.arbiter().take(client)
    }

    /// Makes a client the driver, also where another one was but moves nothing at this time.
    /// Returns that one, which is to be told.
    ///
    /// # Errors
    /// With the reason why not.
    pub fn succeed(&self, client: Client) -> Result<Option<Client>, String> {
        self.arbiter().succeed(self.now(), client)
    }

    /// Starts the robots for the driver; they stand until a velocity comes.
    ///
    /// # Errors
    /// With the reason why not.
    pub fn start(&self, client: Client) -> Result<(), String> {
        let mut arbiter = self.arbiter();
        arbiter.start(self.now(), client)?;
        (self.order)(Order::Start);
        Ok(())
    }

    /// Ramps down and switches the drivers off. Any client may.
    pub fn stop(&self) {
        let mut arbiter = self.arbiter();
        arbiter.stop();
        (self.order)(Order::Stop);
    }

    /// A message of a dead-man's press; see [`Arbiter::press`].
    ///
    /// # Errors
    /// With the reason why it was refused, which has ended the press.
    pub fn press(
        &self,
        client: Client,
        number: u32,
        twist: Twist,
        clock: u64,
    ) -> Result<(), String> {
        let now = self.now();
        let mut arbiter = self.arbiter();
        let pressed = arbiter.press(now, client, number, twist, clock);
        if arbiter.drives(client) {
            (self.order)(arbiter.order(now));
        }
        pressed
    }

    /// A message of a dead-man's press that asks for a curve in a size; see
    /// [`Arbiter::press_curve`].
    ///
    /// # Errors
    /// With the reason why it was refused, which has ended the press.
    pub fn press_curve(
        &self,
        client: Client,
        number: u32,
        curve: (&str, f64),
        clock: u64,
    ) -> Result<(), String> {
        let now = self.now();
        let mut arbiter = self.arbiter();
        let pressed = arbiter.press_curve(now, client, number, curve, clock);
        if arbiter.drives(client) {
            (self.order)(arbiter.order(now));
        }
        pressed
    }

    /// Moves the group with this velocity, for no longer than so many ms without another one.
    ///
    /// # Errors
    /// With the reason why it was refused; then the group stands, if this client drove it.
    pub fn stream(&self, client: Client, twist: Twist, good_ms: u64) -> Result<(), String> {
        let mut arbiter = self.arbiter();
        let permitted = arbiter.stream(self.now(), client, twist, good_ms);
        match &permitted {
            Ok(()) => (self.order)(Order::Twist(twist, good_ms * 1_000)),
            Err(_) if arbiter.drives(client) => (self.order)(Order::Twist(Twist::ZERO, 0)),
            Err(_) => {}
        }
        permitted
    }

    /// Has the group follow a route.
    ///
    /// # Errors
    /// With the reason why it was refused; then nothing moves.
    pub fn follow(&self, client: Client, errand: Errand) -> Result<(), String> {
        let mut arbiter = self.arbiter();
        arbiter.route(self.now(), client)?;
        (self.order)(Order::Follow(errand));
        Ok(())
    }

    /// Vouches for the route that is followed: to be called several times a second.
    ///
    /// # Errors
    /// With the reason why this client drives no more.
    pub fn keep_following(&self, client: Client) -> Result<(), String> {
        self.arbiter().route(self.now(), client)
    }

    /// The client moves the group no longer; it stays the driver, and the robots started.
    pub fn release(&self, client: Client) {
        let mut arbiter = self.arbiter();
        if arbiter.drives(client) {
            arbiter.release(client);
            (self.order)(Order::Twist(Twist::ZERO, 0));
        }
    }

    /// A client has gone, or leaves the controls. When it was the driver, the robots are stopped.
    pub fn gone(&self, client: Client) {
        let mut arbiter = self.arbiter();
        if arbiter.drives(client) {
            arbiter.gone(client);
            (self.order)(Order::Twist(Twist::ZERO, 0));
            (self.order)(Order::Stop);
        }
    }

    /// Whether this client drives.
    #[must_use]
    pub fn drives(&self, client: Client) -> bool {
        self.arbiter().drives(client)
    }

    /// Whether a client drives.
    #[must_use]
    pub fn has_driver(&self) -> bool {
        self.arbiter().has_driver()
    }

    /// Takes in what the robots do, and switches them off when they have not been moved for long.
    pub fn on_telemetry(&self, item: &Telemetry) {
        let mut arbiter = self.arbiter();
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
