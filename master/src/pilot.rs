//! A session in a thread of its own, for programs that have something else to do: live views,
//! teleoperation, the page.
//!
//! A [`Pilot`] opens the bus, observes it, and executes commands: start, move, stop. It is told a
//! velocity together with how long that is good for; when nothing newer has come by then it
//! commands standstill, and the robots ramp by their own limits. That is the dead-man's key: the
//! source of commands must repeat them. A curve is good for so long, too, and goes on only as long
//! as it is confirmed; a curve that has ended, or was not confirmed in time, does not come back.
//!
//! An error of the group (a fault, a missing member) ramps the group down, is published as
//! [`EventKind::Failed`](crate::monitor::telemetry::EventKind::Failed), and leaves the pilot
//! waiting for the next start. An error of the bus ends it. Orders wait in a queue and are taken
//! once per SYNC period, or every 50 ms while nothing runs. Give it a bus in real time: see
//! [`SimLink::in_real_time`](crate::simulation::link::SimLink::in_real_time).

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use canopen::{Frame, Micros};
use group::{GroupFile, Limits};
use kinematics::{Pose, Twist};
use protocol::Address;

use crate::abort::Abort;
use crate::bus::link::Link;
use crate::error::MasterError;
use crate::monitor::telemetry::{
    DEFAULT_CAPACITY, Hub, Interest, Progress, SessionState, Subscription,
};
use crate::path::curve::{Instant, Motion, Plan};
use crate::path::route::SharedRoute;
use crate::path::steering::{Law, PoseInput, Steering};
use crate::run::DriveError;
use crate::session::follow::Period;
use crate::session::{Group, check_twist, slowed};
use crate::source::pose::PoseStream;

/// How often the bus is polled while nothing runs, in µs.
const IDLE_US: u64 = 50_000;
/// Rows kept of a session without an end.
const ROWS: usize = 200;

/// What a pilot can be told.
#[derive(Clone, Debug)]
pub enum Order {
    /// Become the bus's master, configure the robots where [`Group::start`] does, and start them.
    Start,
    /// Ramp down and leave OPERATIONAL.
    Stop,
    /// Move with this velocity (group frame) for at most so many µs; beyond the limits of the group
    /// file it is scaled down in its direction. Without effect unless started.
    Twist(Twist, u64),
    /// Drive this curve from where the group stands, for at most so many µs. The same curve again
    /// (the same [`Arc`]) goes on with it for so many µs more. A curve beyond the limits of the
    /// group file stops the group. Without effect unless started.
    Curve(Arc<Plan>, u64),
    /// Ask a robot for an object of at most four bytes. The answer is among the frames of the
    /// telemetry. Without effect unless started, because other transfers may be under way then.
    Ask(u8, Address),
    /// Follow a route to its end, unless something else is ordered before. Without effect unless
    /// started.
    Follow(Errand),
}

/// A route, and how a group is kept on it.
#[derive(Clone, Debug)]
pub struct Errand {
    /// The way. It is closed when it is driven no more.
    pub route: SharedRoute,
    /// Where the group stands now, in the frame of the route: m, m, rad.
    pub start: Pose,
    /// How poses correct the drive.
    pub law: Law,
    /// Where poses come from; `None`: the robots' own wheels.
    pub poses: Option<PoseStream>,
}

/// A session in a thread of its own. Dropping it ramps the group down and waits for that.
pub struct Pilot {
    orders: Option<Sender<Order>>,
    hub: Hub,
    abort: Abort,
    thread: Option<JoinHandle<Result<(), DriveError>>>,
}

impl Pilot {
    /// Starts the thread. `open` opens the bus, in the thread.
    pub fn launch<L: Link>(
        open: impl FnOnce() -> Result<L, DriveError> + Send + 'static,
        file: GroupFile,
    ) -> Self {
        let (orders, told) = channel();
        let (hub, abort) = (Hub::default(), Abort::default());
        let (its_hub, its_abort) = (hub.clone(), abort.clone());
        let thread = std::thread::spawn(move || {
            // The hub ends with the group; without one, here.
            let link = open().inspect_err(|_| its_hub.end())?;
            let mut group = Group::observe(link, &file);
            group.set_hub(its_hub);
            group.set_abort(its_abort);
            group.keep_last(ROWS);
            Ok(fly(&mut group, &told)?)
        });
        Self {
            orders: Some(orders),
            hub,
            abort,
            thread: Some(thread),
        }
    }

    /// Tells the pilot something. `false` when it has ended.
    pub fn order(&self, order: Order) -> bool {
        let orders = self.orders.as_ref();
        orders.is_some_and(|orders| orders.send(order).is_ok())
    }

    /// Snapshots and events from now on.
    #[must_use]
    pub fn telemetry(&self) -> Subscription {
        self.hub.subscribe(Interest::Group, DEFAULT_CAPACITY)
    }

    /// Where subscriptions come from.
    #[must_use]
    pub fn hub(&self) -> Hub {
        self.hub.clone()
    }

    /// By which a running group can be stopped from a signal handler.
    #[must_use]
    pub fn abort(&self) -> Abort {
        self.abort.clone()
    }

    /// Whether the thread has ended, which without being told it does only when the bus fails.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Ramps down, ends, and says how it went.
    ///
    /// # Errors
    /// When the bus could not be opened or failed.
    pub fn finish(mut self) -> Result<(), DriveError> {
        self.land()
    }

    /// The same for one that others hold as well, for moments only.
    ///
    /// # Errors
    /// As [`Pilot::finish`].
    pub fn finish_shared(mut pilot: Arc<Self>) -> Result<(), DriveError> {
        loop {
            match Arc::try_unwrap(pilot) {
                Ok(pilot) => return pilot.finish(),
                // A connection is just giving an order.
                Err(busy) => pilot = busy,
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn land(&mut self) -> Result<(), DriveError> {
        self.orders = None;
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            Some(Err(panic)) => std::panic::resume_unwind(panic),
            None => Ok(()),
        }
    }
}

impl Drop for Pilot {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            let _ = self.land();
        }
    }
}

/// A pilot without a thread: what it has been told. Callers give it the orders, and a group that
/// was only observed so far.
#[derive(Default)]
pub struct Flight {
    asked: Asked,
}

/// What the group is asked for, and until when on the link's clock.
#[derive(Default)]
struct Asked {
    motion: Asks,
    until: Micros,
}

#[derive(Default)]
enum Asks {
    #[default]
    Rest,
    Twist(Twist),
    Curve {
        plan: Arc<Plan>,
        /// The SYNC it began with.
        began: Micros,
        /// It has ended, or was not confirmed in time.
        over: bool,
    },
    Route(Box<Following>),
}

/// A route that is being followed. It is closed when this goes.
struct Following {
    route: SharedRoute,
    plan: Plan,
    steering: Steering,
    began: Micros,
}

impl Following {
    fn begin(errand: Errand, next_sync: Micros) -> Self {
        let Errand {
            route,
            start,
            law,
            poses,
        } = errand;
        let input = poses.map_or(PoseInput::Odometry, PoseInput::Stream);
        let mut steering = Steering::new(law, input, start, true);
        steering.begin(next_sync);
        Self {
            plan: Plan::from_rest("route", Motion(Box::new(route.clone()))),
            route,
            steering,
            began: next_sync,
        }
    }

    /// Drives one SYNC period; `false` when the route is over.
    fn drive<L: Link>(&mut self, group: &mut Group<L>) -> Result<bool, MasterError> {
        let period = Period {
            plan: &self.plan,
            began: self.began,
            steering: Some(&mut self.steering),
            shown: false,
        };
        Ok(group.period_of(period)?.is_some())
    }
}

impl Drop for Following {
    fn drop(&mut self) {
        self.route.close();
    }
}

impl Asked {
    /// Takes a curve, or the confirmation of the one that is being driven.
    fn take_curve(
        &mut self,
        asked: Arc<Plan>,
        next_sync: Micros,
        until: Micros,
        limits: &Limits,
    ) -> Result<(), MasterError> {
        if let Asks::Curve { plan, over, .. } = &mut self.motion
            && Arc::ptr_eq(plan, &asked)
        {
            *over |= next_sync > self.until;
        } else {
            asked.check(limits)?;
            self.motion = Asks::Curve {
                plan: asked,
                began: next_sync,
                over: false,
            };
        }
        self.until = until;
        Ok(())
    }

    /// Drives one SYNC period.
    fn drive<L: Link>(&mut self, group: &mut Group<L>) -> Result<(), MasterError> {
        if let Asks::Curve { plan, began, over } = &mut self.motion {
            *over |= group.next_sync() > self.until;
            if !*over {
                let period = Period {
                    plan,
                    began: *began,
                    steering: None,
                    shown: false,
                };
                let instant = group.period_of(period)?;
                *over = instant.is_none();
                group
                    .set_curve(instant.map(|Instant { t, duration, .. }| Progress { t, duration }));
                return Ok(());
            }
        }
        if let Asks::Route(following) = &mut self.motion {
            if !following.drive(group)? {
                self.motion = Asks::Rest;
            }
            return Ok(());
        }
        group.set_curve(None);
        let Self { motion, until } = self;
        group.cycle_with(&mut |sync| match motion {
            Asks::Twist(twist) if sync < *until => *twist,
            _ => Twist::default(),
        })
    }
}

fn fly<L: Link>(group: &mut Group<L>, orders: &Receiver<Order>) -> Result<(), MasterError> {
    let mut flight = Flight::default();
    loop {
        let order = match orders.try_recv() {
            Ok(order) => Some(order),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => {
                if group.phase() == SessionState::Running {
                    group.stop()?;
                }
                return Ok(());
            }
        };
        flight.step(group, order)?;
    }
}

impl Flight {
    /// Executes an order, or without one lets time pass until the next SYNC, or [`IDLE_US`] while
    /// nothing runs.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn step<L: Link>(
        &mut self,
        group: &mut Group<L>,
        order: Option<Order>,
    ) -> Result<(), MasterError> {
        match (order, group.phase()) {
            (Some(Order::Start), SessionState::Idle) => {
                self.asked = Asked::default();
                if let Err(error) = group.claim().and_then(|()| group.start()) {
                    survive(group, error)?;
                }
            }
            (Some(Order::Stop), SessionState::Running) => {
                group.set_curve(None);
                self.asked = Asked::default();
                group.stop()?;
            }
            (Some(Order::Twist(twist, valid_us)), SessionState::Running) => {
                self.asked = Asked {
                    motion: Asks::Twist(within(twist, group.config())),
                    until: Micros(group.next_sync().0 + valid_us),
                };
            }
            (Some(Order::Curve(plan, valid_us)), SessionState::Running) => {
                let next = group.next_sync();
                let until = Micros(next.0 + valid_us);
                let limits = &group.config().limits;
                if let Err(error) = self.asked.take_curve(plan, next, until, limits) {
                    survive(group, error)?;
                }
            }
            (Some(Order::Follow(errand)), SessionState::Running) => {
                let following = Following::begin(errand, group.next_sync());
                self.asked.motion = Asks::Route(Box::new(following));
            }
            (Some(Order::Follow(errand)), _) => errand.route.close(),
            (Some(Order::Ask(node, object)), SessionState::Running) => {
                group.wire().send(&read_request(node, object))?;
            }
            (Some(_), _) => {}
            (None, SessionState::Running) => {
                if let Err(error) = self.asked.drive(group) {
                    let survived = survive(group, error);
                    // Only now is a route closed: who waits for that finds the group at rest.
                    self.asked = Asked::default();
                    survived?;
                }
            }
            (None, _) => {
                let until = Micros(group.wire().now().0 + IDLE_US);
                group.listen(until)?;
                if !group.foreign_master() {
                    group.publish_idle();
                }
            }
        }
        Ok(())
    }
}

/// An SDO client's request to read an object (CiA 301, 7.2.4.3.6).
fn read_request(node: u8, object: Address) -> Frame {
    let [low, high] = object.index.to_le_bytes();
    let data = [0x40, low, high, object.sub, 0, 0, 0, 0];
    Frame::of(0x600 + u16::from(node), data)
}

/// Tells subscribers what went wrong and stops the group; an error of the bus is passed on.
fn survive<L: Link>(group: &mut Group<L>, error: MasterError) -> Result<(), MasterError> {
    group.set_curve(None);
    group.fail(&error);
    if matches!(error, MasterError::Link(_)) {
        return Err(error);
    }
    if group.phase() != SessionState::Idle {
        group.stop()?;
    }
    group.abort().forget();
    Ok(())
}

/// `twist` within the group's limits; standstill if it is not finite.
fn within(twist: Twist, file: &GroupFile) -> Twist {
    slowed(twist, &file.limits)
        .map(|(twist, _)| twist)
        .filter(|twist| check_twist(*twist, &file.limits).is_ok())
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::monitor::telemetry::{EventKind, Snapshot, Telemetry};
    use crate::path::course::Course;
    use crate::path::curve::Curve;
    use crate::simulation::link::SimLink;
    use kinematics::Pose;

    fn file() -> GroupFile {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-2.toml");
        GroupFile::load(path).unwrap()
    }

    fn pilot() -> Pilot {
        let group = file();
        Pilot::launch(
            move || {
                let world = crate::simulation::run::world(&group, None, Pose::new(0.0, 0.0, 0.0))?;
                Ok(SimLink::new(world, "sim"))
            },
            file(),
        )
    }

    fn snapshot_until(
        stream: &Subscription,
        mut wanted: impl FnMut(&Snapshot) -> bool,
    ) -> Option<Arc<Snapshot>> {
        for _ in 0..200_000 {
            match stream.next_within(Duration::from_secs(20))? {
                Telemetry::Snapshot(now) if wanted(&now) => return Some(now),
                _ => {}
            }
        }
        None
    }

    /// Time is virtual here and runs as fast as it can, so what counts is what is in the snapshots.
    #[test]
    fn a_velocity_is_good_for_as_long_as_was_said_and_no_longer() {
        let pilot = pilot();
        let stream = pilot.telemetry();
        assert!(pilot.order(Order::Start));
        assert!(pilot.order(Order::Twist(Twist::new(0.2, 0.0, 0.0), 500_000)));
        let first = snapshot_until(&stream, |s| s.command.vx > 0.0).unwrap();
        let after = snapshot_until(&stream, |s| s.command.vx == 0.0).unwrap();
        let lasted = after.t - first.t;
        assert!(
            (lasted - 0.5).abs() < 0.011,
            "{lasted} s; one period more or less"
        );
        let still = snapshot_until(&stream, |s| {
            s.measured.is_some_and(|m| m.vx.hypot(m.vy) < 1e-3)
        });
        assert_eq!(still.unwrap().phase, SessionState::Running);
        assert!(pilot.order(Order::Stop));
        assert!(snapshot_until(&stream, |s| s.phase == SessionState::Idle).is_some());
        pilot.finish().unwrap();
    }

    /// The largest speed asked for, and what else is in the snapshots until the curve is over.
    fn driven(stream: &Subscription) -> (f32, Option<Progress>, Option<Pose>) {
        let (mut fastest, mut last) = (0.0_f32, None);
        let end = snapshot_until(stream, |s| {
            fastest = fastest.max(s.command.vx.hypot(s.command.vy));
            let over = last.is_some() && s.curve.is_none();
            last = s.curve.or(last);
            over && s
                .measured
                .is_some_and(|twist| twist.vx.hypot(twist.vy) < 1e-3)
        });
        (fastest, last, end.and_then(|s| s.pose))
    }

    #[test]
    fn a_curve_is_driven_to_its_end_while_it_is_confirmed() {
        let pilot = pilot();
        let stream = pilot.telemetry();
        pilot.order(Order::Start);
        assert!(snapshot_until(&stream, |s| s.phase == SessionState::Running).is_some());
        let plan = Arc::new(Curve::Lateral.plan(false));
        pilot.order(Order::Curve(Arc::clone(&plan), 3_000_000));
        // Once more, and longer than the curve: it goes on and does not start again.
        assert!(snapshot_until(&stream, |s| s.curve.is_some_and(|c| c.t > 1.0)).is_some());
        pilot.order(Order::Curve(Arc::clone(&plan), 60_000_000));
        let (fastest, last, end) = driven(&stream);
        let last = last.unwrap();
        assert!(last.t > plan.duration(), "{last:?}");
        assert!((fastest - 0.5).abs() < 0.02, "{fastest}");
        let way = plan.at(plan.duration()).0.y - plan.at(0.0).0.y;
        let end = end.unwrap();
        assert!((end.y - way).abs() < 0.02 * way, "{end:?} of {way}");
        // It is over: the same one does not move anything again.
        pilot.order(Order::Curve(plan, 60_000_000));
        let from = snapshot_until(&stream, |_| true).unwrap().t;
        let moved = snapshot_until(&stream, |s| s.command != Twist::ZERO || s.t > from + 1.0);
        assert_eq!(moved.unwrap().command, Twist::ZERO);
    }

    #[test]
    fn a_curve_that_is_not_confirmed_ends_in_a_ramp() {
        let pilot = pilot();
        let stream = pilot.telemetry();
        pilot.order(Order::Start);
        assert!(snapshot_until(&stream, |s| s.phase == SessionState::Running).is_some());
        let plan = Arc::new(Curve::Forward.plan(false));
        pilot.order(Order::Curve(Arc::clone(&plan), 2_500_000));
        let (_, last, end) = driven(&stream);
        assert!((last.unwrap().t - 2.5).abs() < 0.05, "{last:?}");
        assert!(end.is_some());
        // A confirmation that comes too late, and a curve that is too fast.
        pilot.order(Order::Curve(plan, 2_500_000));
        let from = snapshot_until(&stream, |_| true).unwrap().t;
        let moved = snapshot_until(&stream, |s| s.command != Twist::ZERO || s.t > from + 1.0);
        assert_eq!(moved.unwrap().command, Twist::ZERO);
        let course = Course {
            speed: 2.0,
            ..Course::of(Curve::FigureEight)
        };
        pilot.order(Order::Curve(Arc::new(course.plan().unwrap()), 2_500_000));
        let idle = snapshot_until(&stream, |s| {
            assert_eq!(s.command, Twist::ZERO);
            s.phase == SessionState::Idle
        });
        assert!(idle.is_some());
    }

    #[test]
    fn an_abort_stops_the_group_and_the_pilot_stays() {
        let pilot = pilot();
        let stream = pilot.telemetry();
        pilot.order(Order::Start);
        assert!(snapshot_until(&stream, |s| s.phase == SessionState::Running).is_some());
        pilot.abort().ask();
        let failed = std::iter::from_fn(|| stream.next_within(Duration::from_secs(20)))
            .take(100_000)
            .any(|item| {
                matches!(item, Telemetry::Event(event)
                    if matches!(&event.what, EventKind::Failed(why) if why.contains("on request")))
            });
        assert!(failed);
        assert!(snapshot_until(&stream, |s| s.phase == SessionState::Idle).is_some());
        pilot.order(Order::Start);
        assert!(snapshot_until(&stream, |s| s.phase == SessionState::Running).is_some());
    }

    #[test]
    fn a_bus_that_cannot_be_opened_ends_the_stream() {
        let refused = || -> Result<SimLink, DriveError> { Err(MasterError::Aborted.into()) };
        let pilot = Pilot::launch(refused, file());
        let stream = pilot.telemetry();
        assert!(pilot.finish().is_err());
        assert_eq!(stream.try_next(), None);
    }

    #[test]
    fn too_fast_is_slowed_down_in_its_direction() {
        let slowed = within(Twist::new(4.0, 3.0, 0.5), &file());
        let limit = file().limits.linear_speed;
        assert!((slowed.vx.hypot(slowed.vy) / limit - 1.0).abs() < 2e-4);
        assert!((slowed.vy / slowed.vx - 0.75).abs() < 1e-5);
        assert!((slowed.omega / slowed.vx - 0.125).abs() < 1e-5);
        let nothing = within(Twist::new(f32::NAN, 0.0, 0.0), &file());
        assert_eq!(nothing, Twist::default());
    }
}
