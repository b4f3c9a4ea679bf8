//! Between the node and the group: two threads, a bounded channel, and an end for both.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use canopen::Frame;
use futures::channel::mpsc::{Receiver, Sender, channel};
use group::GroupFile;
use protocol::{Address, address};
use ros::message::Time;
use ros::names::Frames;
use ros::node::{Incoming, NodeError, Outgoing, Reply};

use super::commands::{Commands, Rules};
use super::diagnostics::{Asked, Own};
use super::odometry::Odometry;
use super::{diagnostics, messages};
use crate::abort::Abort;
use crate::controls::Controls;
use crate::monitor::telemetry::{
    BusFrame, EventKind, Interest, SessionState, Snapshot, Subscription, Telemetry,
};
use crate::pilot::{Order, Pilot};
use crate::run::DriveError;

/// Messages that may wait for the node: half a second.
const WAITING: usize = 64;
/// Items of telemetry that may wait, frames among them: a second of a full bus.
const TELEMETRY: usize = 8_192;
/// How often the main thread looks whether it is to end.
const TICK: Duration = Duration::from_millis(50);
/// Time between two reports of the state of all, in s.
const REPORT: f64 = 1.0;
/// A node that takes no message for so long hangs, in s.
const HANGS: f64 = 5.0;
/// How long a node may take to end.
const ENDS: Duration = Duration::from_secs(5);
/// The program may grow by so much, kB. A node needs some 20 MB. RustDDS 0.15.1 lists every message
/// that another writer says to have; one datagram that says 2^40 makes it take all the memory there
/// is.
const MOST_MEMORY: u64 = 256 << 10;

/// What robots are asked for that they do not send by themselves.
const ASKED: [Address; 2] = [address::SUPPLY, address::CURRENT];

/// How the group is shown.
#[derive(Clone, Debug)]
pub struct Options {
    /// Names of frames.
    pub frames: Frames,
    /// How long a velocity is good for, in ms.
    pub timeout_ms: u64,
    /// Shortest time between two messages of `odom`, `tf` and `joint_states`, in s.
    pub interval: f64,
    /// Whether `tf` is published.
    pub transforms: bool,
    /// Whether the robots are started at once.
    pub start: bool,
}

/// Why there is an end.
#[derive(Debug, thiserror::Error)]
pub enum RosError {
    /// The bus or the group.
    #[error(transparent)]
    Drive(#[from] DriveError),
    /// The node.
    #[error(transparent)]
    Node(#[from] NodeError),
    /// The node's thread has ended by itself, or does not end.
    #[error("the ROS 2 node has failed; the robots were ramped down and switched off")]
    NodeLost,
    /// The library takes more and more memory.
    #[error(
        "the ROS 2 library took more than 256 MB, as after a damaged message; the robots were \
         ramped down and switched off; start the program again"
    )]
    Memory,
}

/// What the node's thread runs: its messages to publish, and where to go with what it receives.
pub type NodeBody = Box<
    dyn FnOnce(Receiver<Outgoing>, &mut dyn FnMut(Incoming) -> Reply) -> Result<(), NodeError>
        + Send,
>;

/// Ends all when the node's thread ends, also by a panic.
struct Guard {
    controls: Arc<Controls>,
    over: Arc<AtomicBool>,
}

impl Drop for Guard {
    fn drop(&mut self) {
        self.controls.stop();
        self.over.store(true, Ordering::Relaxed);
    }
}

fn now_ns() -> u64 {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    u64::try_from(since.unwrap_or_default().as_nanos()).unwrap_or(u64::MAX)
}

/// Memory of this program, kB; `None` where it cannot be read.
fn memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.split_whitespace().next()?.parse().ok()
}

/// A thread that panicked has not left them half changed.
fn lock(commands: &Mutex<Commands>) -> MutexGuard<'_, Commands> {
    commands.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Keeps the group on ROS 2 until `abort` is asked for, the node ends or the bus fails; then the
/// group is ramped down.
///
/// # Errors
/// When the bus cannot be opened or fails, or the node cannot be made or ends by itself.
pub fn operate(
    pilot: Arc<Pilot>,
    group: &GroupFile,
    options: &Options,
    abort: &Abort,
    body: NodeBody,
) -> Result<(), RosError> {
    let controls = Arc::new(Controls::of(&pilot, &group.limits));
    let rules = Rules {
        limits: group.limits,
        base: options.frames.base.clone(),
        timeout_ms: options.timeout_ms,
    };
    let commands = Commands::new(Arc::clone(&controls), pilot.abort(), rules);
    let commands = Arc::new(Mutex::new(commands));
    let (outgoing, taken) = channel(WAITING);
    let over = Arc::new(AtomicBool::new(false));
    let guard = Guard {
        controls: Arc::clone(&controls),
        over: Arc::clone(&over),
    };
    let its_commands = Arc::clone(&commands);
    let node = std::thread::Builder::new()
        .name("ros".into())
        .spawn(move || {
            let _guard = guard;
            body(taken, &mut |incoming| {
                lock(&its_commands).handle(incoming, now_ns())
            })
        });
    let node = node.map_err(|_| RosError::NodeLost)?;
    let mut state = State {
        group: group.clone(),
        options: options.clone(),
        controls,
        commands,
        odometry: Odometry::new(group),
        asked: vec![Asked::default(); group.robots.len()],
        own: Own::default(),
        outgoing,
        last: f64::NEG_INFINITY,
        reported: f64::NEG_INFINITY,
        e_stop: None,
        full_since: None,
        turn: 0,
        started: !options.start,
    };
    let stream = pilot.hub().subscribe(Interest::Frames, TELEMETRY);
    let reach = Arc::downgrade(&pilot);
    let its_over = Arc::clone(&over);
    let telling = std::thread::spawn(move || {
        let ask = |order| {
            if let Some(pilot) = reach.upgrade() {
                pilot.order(order);
            }
        };
        state.run(&stream, &its_over, &ask);
    });
    let most = memory().map(|now| now + MOST_MEMORY);
    let mut grown = false;
    while !abort.is_asked() && !over.load(Ordering::Relaxed) && !pilot.is_over() && !grown {
        std::thread::sleep(TICK);
        grown = memory() > most;
    }
    let asked = abort.is_asked() || pilot.is_over();
    let flown = Pilot::finish_shared(pilot);
    // The telemetry has ended with the pilot, and with its thread the node's messages.
    let _ = telling.join();
    flown?;
    if grown {
        return Err(RosError::Memory);
    }
    // One that hangs would be waited for for ever.
    let began = Instant::now();
    while !node.is_finished() && began.elapsed() < ENDS {
        std::thread::sleep(TICK);
    }
    if !node.is_finished() {
        return Err(RosError::NodeLost);
    }
    match node.join() {
        Ok(Ok(())) if asked => Ok(()),
        Ok(Err(error)) => Err(error.into()),
        Ok(Ok(())) | Err(_) => Err(RosError::NodeLost),
    }
}

/// Messages to the node.
struct State {
    group: GroupFile,
    options: Options,
    controls: Arc<Controls>,
    commands: Arc<Mutex<Commands>>,
    odometry: Odometry,
    asked: Vec<Asked>,
    own: Own,
    outgoing: Sender<Outgoing>,
    /// When motion was last published, on the link's clock.
    last: f64,
    /// When the state of all robots was last published.
    reported: f64,
    e_stop: Option<bool>,
    /// Since when the node has taken nothing.
    full_since: Option<f64>,
    /// Which robot is asked next, and for what.
    turn: usize,
    started: bool,
}

impl State {
    fn run(&mut self, stream: &Subscription, over: &AtomicBool, ask: &dyn Fn(Order)) {
        while !stream.is_over() {
            let Some(item) = stream.next_within(TICK) else {
                continue;
            };
            self.controls.on_telemetry(&item);
            match item {
                Telemetry::Snapshot(now) => self.on_snapshot(&now, ask),
                Telemetry::Frame(frame) => self.on_frame(&frame),
                Telemetry::Event(event) => {
                    if let EventKind::Failed(why) = event.what {
                        self.own.failed = Some(why);
                    }
                }
            }
            if self
                .full_since
                .is_some_and(|since| self.last > since + HANGS)
            {
                over.store(true, Ordering::Relaxed);
            }
        }
    }

    fn put(&mut self, message: Outgoing) {
        if self.outgoing.try_send(message).is_ok() {
            self.full_since = None;
        } else {
            self.own.dropped += 1;
            self.full_since.get_or_insert(self.last);
        }
    }

    fn on_snapshot(&mut self, now: &Snapshot, ask: &dyn Fn(Order)) {
        self.odometry.update(now);
        if !std::mem::replace(&mut self.started, true) {
            lock(&self.commands).handle(Incoming::Call(ros::node::Call::Start), now_ns());
        }
        lock(&self.commands).set_session(now.phase != SessionState::Idle, now.foreign_master);
        if now.phase == SessionState::Running {
            self.own.failed = None;
        }
        // A snapshot is complete one period after its SYNC.
        let behind = u64::from(self.group.sync_period_us) * 1_000;
        let stamp = Time::of_ns(now_ns().saturating_sub(behind));
        let latched = lock(&self.commands).is_latched();
        let e_stop = latched || diagnostics::has_emergency_stop(now);
        if self.e_stop.replace(e_stop) != Some(e_stop) {
            self.put(Outgoing::EmergencyStop(e_stop));
        }
        // Half a microsecond: times are sums of floating-point periods.
        if now.t >= self.last + self.options.interval - 5e-7 {
            self.last = now.t;
            let frames = self.options.frames.clone();
            let odometry = messages::odometry(&stamp, &frames, &self.odometry);
            self.put(Outgoing::Odometry(Box::new(odometry)));
            if self.options.transforms {
                let transforms = messages::transforms(&stamp, &frames, &self.odometry);
                self.put(Outgoing::Transforms(transforms));
            }
            let joints = messages::joints(&stamp, &self.group, &self.odometry);
            self.put(Outgoing::Joints(joints));
        }
        if now.t >= self.reported + REPORT {
            self.reported = now.t;
            self.report(&stamp, now, ask);
        }
    }

    fn report(&mut self, stamp: &Time, now: &Snapshot, ask: &dyn Fn(Order)) {
        let (group, asked, own) = (&self.group, &self.asked, &self.own);
        let mut commands = lock(&self.commands);
        let all = diagnostics::diagnostics(stamp, group, now, asked, &mut commands, own);
        drop(commands);
        self.put(Outgoing::Diagnostics(all));
        let supply = self.group.robots.iter().zip(&self.asked);
        let supply = supply.filter_map(|(robot, asked)| Some((robot.node, asked.supply?)));
        if let Some(battery) = messages::battery(stamp, supply) {
            self.put(Outgoing::Battery(Box::new(battery)));
        }
        // One object a second, while no other transfer is under way.
        if now.phase == SessionState::Running && !self.group.robots.is_empty() {
            let robot = &self.group.robots[self.turn % self.group.robots.len()];
            let turn = self.turn / self.group.robots.len();
            ask(Order::Ask(robot.node, ASKED[turn % ASKED.len()]));
            self.turn += 1;
        }
    }

    /// Answers to what was asked, seen on the bus.
    fn on_frame(&mut self, seen: &BusFrame) {
        let Some((node, object, value)) = answer(&seen.frame) else {
            return;
        };
        let index = self
            .group
            .robots
            .iter()
            .position(|robot| robot.node == node);
        let Some(asked) = index.and_then(|index| self.asked.get_mut(index)) else {
            return;
        };
        // 0 where it is not measured.
        let value = f32::from_bits(value);
        let value = (value.is_finite() && value != 0.0).then_some(value);
        if object == address::SUPPLY {
            asked.supply = value;
        } else {
            asked.current = value;
        }
    }
}

/// The value of an SDO server's answer to a read of one of [`ASKED`] (CiA 301, 7.2.4.3.6).
fn answer(frame: &Frame) -> Option<(u8, Address, u32)> {
    let node = u8::try_from(frame.id().checked_sub(0x580)?).ok()?;
    let [0x43, low, high, sub, value @ ..] = frame.data() else {
        return None;
    };
    let object = Address::new(u16::from_le_bytes([*low, *high]), *sub);
    let value = u32::from_le_bytes(value.try_into().ok()?);
    let asked = ASKED.contains(&object);
    (asked && (1..=127).contains(&node)).then_some((node, object, value))
}
