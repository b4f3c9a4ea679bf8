//! A world with its master, controlled by the page.
//!
//! Theory of operation: the session of the master runs over the world's bus in the same thread, one
//! SYNC period a step ([`Flight::step`]). The page's messages go through the same
//! [`Controls`] and [`PageState`] as on `omnibus serve`, whose clock
//! here is the world's: what happens depends on the messages and the virtual times at which they
//! come, and on nothing else.
//!
//! Interface: [`Playground::advance`] lets time pass, [`Playground::receive`] takes a message,
//! [`Playground::news`] gives what the page has not seen yet.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, PoisonError};

use emulator::Firmware;
use group::GroupFile;
use kinematics::Pose;
use omnibus::Group;
use omnibus::controls::Controls;
use omnibus::controls::arbiter::Client;
use omnibus::monitor::listener::Reckoning;
use omnibus::monitor::telemetry::{Interest, Subscription, Telemetry};
use omnibus::pilot::{Flight, Order};
use omnibus::serve::message::{ClientMessage, refused};
use omnibus::serve::page_state::{Cursor, PageState};
use omnibus::simulation::link::SimLink;
use serde_json::{Value, json};
use sim::fault::{FaultSpec, Schedule};
use sim::{Backend, Options, World};

use crate::choice::{Choice, Robots};
use crate::panes::{FramePane, RobotPane};

/// Rows kept of a session without an end.
const ROWS: usize = 200;
/// Telemetry that waits for the end of a step: a start takes some hundred periods.
const CAPACITY: usize = 1 << 16;

/// A log of the bus that is still written to.
#[derive(Clone, Default)]
struct SharedLog(Arc<Mutex<Vec<u8>>>);

impl Write for SharedLog {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut log = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        log.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A world with its master.
pub struct Playground {
    group: Group<SimLink>,
    file: GroupFile,
    emulated: bool,
    flight: Flight,
    orders: Receiver<Order>,
    page: PageState,
    client: Client,
    cursor: Cursor,
    telemetry: Subscription,
    reckoning: Reckoning,
    /// Virtual time, ms: the clock of the controls.
    clock: Arc<AtomicU64>,
    faults: Schedule,
    frames: FramePane,
    robot: RobotPane,
    /// What the page is to be told beside the state.
    notes: VecDeque<Value>,
    /// Why time stands still.
    stopped: Option<String>,
    log: Option<SharedLog>,
}

impl Playground {
    /// The world of a choice, with freshly booted robots; `image` is what emulated ones run.
    ///
    /// # Errors
    /// When the world cannot be built.
    pub fn new(choice: &Choice, image: Option<&Firmware>) -> Result<Self, String> {
        let file = choice.file()?;
        let backend =
            match choice.robots {
                Robots::Native => Backend::Native,
                Robots::Emulated => Backend::Emulator(image.cloned().ok_or(
                    "emulated robots need the firmware's image, which has not been loaded",
                )?),
            };
        let options = Options {
            truth_period_ns: 0,
            start: Pose::new(0.0, 0.0, 0.0),
            ..Options::default()
        };
        let world = World::new(&file, backend, options).map_err(|error| error.to_string())?;
        let mut group = Group::observe(SimLink::new(world, "the page's bus"), &file);
        group.keep_last(ROWS);
        let telemetry = group.hub().subscribe(Interest::Frames, CAPACITY);
        let (sender, orders) = channel();
        let clock = Arc::new(AtomicU64::new(0));
        let now = Arc::clone(&clock);
        let controls = Controls::with_clock(
            &file.limits,
            // The receiver lives as long as the controls.
            Box::new(move |order| _ = sender.send(order)),
            Box::new(move || now.load(Ordering::Relaxed)),
        );
        let page = PageState::new(&file, "in this browser", controls, true);
        Ok(Self {
            client: page.client(),
            group,
            emulated: choice.robots == Robots::Emulated,
            flight: Flight::default(),
            orders,
            page,
            cursor: Cursor::default(),
            telemetry,
            reckoning: Reckoning::default(),
            clock,
            faults: Schedule::default(),
            frames: FramePane::default(),
            robot: RobotPane::default(),
            notes: VecDeque::from([json!({"type": "trusted"})]),
            stopped: None,
            log: None,
            file,
        })
    }

    /// Virtual time, ms.
    #[must_use]
    pub fn now_ms(&self) -> u64 {
        self.clock.load(Ordering::Relaxed)
    }

    /// The world, for an observer.
    pub fn world(&mut self) -> &mut World {
        &mut self.group.link().world
    }

    /// Writes every frame from now on into a log that [`Playground::take_log`] gives.
    pub fn log_frames(&mut self) {
        let log = SharedLog::default();
        self.world().log_candump(Box::new(log.clone()));
        self.log = Some(log);
    }

    /// The log of the bus so far, as `candump -L` writes it.
    #[must_use]
    pub fn take_log(&mut self) -> Vec<u8> {
        let log = self.log.clone().unwrap_or_default();
        let mut text = log.0.lock().unwrap_or_else(PoisonError::into_inner);
        std::mem::take(&mut *text)
    }

    /// Lets virtual time pass up to this, in whole steps of the session: a SYNC period while it
    /// runs, 50 ms while it does not. A start or a stop takes as long as it takes. Returns the
    /// time.
    pub fn advance(&mut self, until_ms: u64) -> u64 {
        while self.now_ms() < until_ms && self.stopped.is_none() {
            self.step();
        }
        self.now_ms()
    }

    fn step(&mut self) {
        let order = self.orders.try_recv().ok();
        let done = self.flight.step(&mut self.group, order);
        let done = done.map_err(|error| error.to_string()).and_then(|()| {
            let world = &mut self.group.link().world;
            let now = world.now_ns();
            let node = |_: u64, _: &sim::fault::Action| {};
            let ran = self.faults.run_until(world, now, &mut { node });
            ran.map_err(|error| error.to_string())
        });
        if let Err(reason) = done {
            self.notes.push_back(refused(&reason));
            self.stopped = Some(reason);
        }
        let world = &mut self.group.link().world;
        self.clock.store(world.now().0 / 1_000, Ordering::Relaxed);
        self.robot.take_logs(world);
        while let Some(item) = self.telemetry.try_next() {
            match item {
                Telemetry::Frame(frame) => self.frames.push(frame),
                item => self.page.on_telemetry(item, &mut self.reckoning),
            }
        }
    }

    /// Takes a message of the page, as text; a refusal is among the next news.
    pub fn receive(&mut self, text: &str) {
        let refusal = match ClientMessage::parse(text) {
            Ok(message) => self.page.handle(self.client, true, &message),
            Err(reason) => {
                self.page.confused(self.client);
                Some(reason)
            }
        };
        self.notes.extend(refusal.as_deref().map(refused));
    }

    /// Injects a fault, written as for `--fault`; see [`sim::fault::spec`].
    ///
    /// # Errors
    /// With what is wrong with the text.
    pub fn inject(&mut self, text: &str) -> Result<(), String> {
        let fault = FaultSpec::parse(text, &self.file, self.emulated);
        let fault = fault.map_err(|error| error.to_string())?;
        let now = self.world().now_ns();
        self.faults.add(&fault, now);
        Ok(())
    }

    /// Which robot the page looks into, and whether it looks at the frames.
    pub fn look(&mut self, node: Option<u8>, frames: bool) {
        self.robot.node = node;
        self.frames.shown = frames;
    }

    /// What the page has not seen yet.
    pub fn news(&mut self) -> Value {
        let mut messages = self.page.news(self.client, &mut self.cursor);
        messages.extend(self.notes.drain(..));
        let world = &mut self.group.link().world;
        json!({"messages": messages, "now": world.now().0 / 1_000,
               "instructions": world.instructions(), "frames": self.frames.take(),
               "robot": self.robot.show(world), "stopped": self.stopped})
    }
}
