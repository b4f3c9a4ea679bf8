//! `omnibus ros` without a network: the node is a closure that says what a node would.
//!
//! What foreign software sees of the node is in `tests/interop/test_ros.py`.

use std::sync::Arc;
use std::time::Duration;

use group::GroupFile;
use omnibus::abort::Abort;
use omnibus::monitor::telemetry::{EventKind, SessionState, Telemetry};
use omnibus::pilot::Pilot;
use omnibus::ros::commands::{Rules, judge};
use omnibus::ros::{NodeBody, Options, RosError, operate};
use omnibus::simulation::link::SimLink;
use ros::message::{Header, Time, Twist, Vector3};
use ros::names::Frames;
use ros::node::{Call, Incoming, Outgoing, Reply};

const SECOND: u64 = 1_000_000_000;

fn file() -> GroupFile {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-2.toml");
    GroupFile::load(path).unwrap()
}

fn options() -> Options {
    Options {
        frames: Frames::new(""),
        timeout_ms: 250,
        interval: 0.02,
        transforms: true,
        start: false,
    }
}

fn rules() -> Rules {
    Rules {
        limits: file().limits,
        base: "base_link".into(),
        timeout_ms: 250,
    }
}

fn ahead(vx: f64) -> Twist {
    Twist {
        linear: Vector3 {
            x: vx,
            ..Vector3::default()
        },
        angular: Vector3::default(),
    }
}

fn command(vx: f64) -> Incoming {
    Incoming::Command {
        from: [7; 16],
        header: None,
        twist: ahead(vx),
    }
}

/// A pilot of a simulated group, in real time: what counts is the clock on the wall.
fn pilot() -> Arc<Pilot> {
    let group = file();
    let open = move || {
        let pose = kinematics::Pose::new(0.0, 0.0, 0.0);
        let world = omnibus::simulation::run::world(&group, None, pose)?;
        Ok(SimLink::new(world, "sim").in_real_time())
    };
    Arc::new(Pilot::launch(open, file()))
}

/// How a drive ended.
struct End {
    result: Result<(), RosError>,
    /// Whether the group stood, with its drivers off, before the bus ended.
    stood: bool,
    /// How long it moved, s of the bus.
    moved_for: f64,
}

/// Drives until the group moves, then does `then`, in the node's place.
fn driven_until_it(then: impl FnOnce() + Send + 'static) -> End {
    let pilot = pilot();
    let telemetry = pilot.telemetry();
    let body: NodeBody = Box::new(move |mut outgoing, on| {
        assert!(on(Incoming::Call(Call::Start)).success);
        loop {
            while let Ok(message) = outgoing.try_recv() {
                if let Outgoing::Odometry(odometry) = message
                    && odometry.twist.twist.linear.x > 0.1
                {
                    then();
                    return Ok(());
                }
            }
            let _: Reply = on(command(0.2));
            std::thread::sleep(Duration::from_millis(2));
            let _: Reply = on(command(0.0));
            let _: Reply = on(command(0.2));
        }
    });
    let result = operate(pilot, &file(), &options(), &Abort::default(), body);
    let (mut moving, mut idle) = (None, false);
    for item in telemetry {
        match item {
            Telemetry::Snapshot(now) => {
                if now.measured.is_some_and(|twist| twist.vx > 0.1) {
                    let (first, _) = moving.unwrap_or((now.t, now.t));
                    moving = Some((first, now.t));
                }
                idle = moving.is_some() && now.phase == SessionState::Idle;
            }
            Telemetry::Event(event) => {
                let is_idle = event.what == EventKind::SessionState(SessionState::Idle);
                idle |= moving.is_some() && is_idle;
            }
            Telemetry::Frame(_) => {}
        }
    }
    let (first, last) = moving.expect("the group has moved");
    End {
        result,
        stood: idle,
        moved_for: last - first,
    }
}

#[test]
fn a_node_that_panics_ends_the_motion_and_the_program() {
    let End { result, stood, .. } = driven_until_it(|| panic!("as the library does"));
    assert!(matches!(result, Err(RosError::NodeLost)), "{result:?}");
    assert!(stood, "the group was ramped down and switched off");
}

#[test]
fn a_node_that_ends_by_itself_is_a_failure_too() {
    let End { result, stood, .. } = driven_until_it(|| ());
    assert!(matches!(result, Err(RosError::NodeLost)), "{result:?}");
    assert!(stood);
}

/// The last velocity expires after 0.25 s and the ramp from 0.2 m/s takes less than that; the
/// program needs 5 s to see that nothing is taken any more.
#[test]
fn a_node_that_hangs_moves_nothing_for_longer_than_a_velocity_is_good_for() {
    let End {
        result,
        stood,
        moved_for,
    } = driven_until_it(|| {
        loop {
            std::thread::park();
        }
    });
    assert!(matches!(result, Err(RosError::NodeLost)), "{result:?}");
    assert!(stood);
    assert!(moved_for < 2.0, "it moved for {moved_for} s");
}

#[test]
fn what_cannot_be_followed_is_refused_in_words() {
    let now = 1_000 * SECOND;
    let header = |ns: u64, frame: &str| Header {
        stamp: Time::of_ns(ns),
        frame_id: frame.into(),
    };
    let good = [
        header(0, ""),
        header(now, "base_link"),
        header(now - SECOND / 4, ""),
        header(now + SECOND / 4, ""),
    ];
    for header in good {
        let judged = judge(&rules(), Some(&header), &ahead(0.5), now);
        assert_eq!(
            judged.map(|(twist, factor)| (twist.vx, factor)),
            Ok((0.5, 1.0))
        );
    }
    let refused = |header: Header, twist: &Twist| judge(&rules(), Some(&header), twist, now);
    let of = |result: Result<_, String>| result.err().unwrap_or_default();
    assert!(of(refused(header(now - SECOND, ""), &ahead(0.1))).contains("old"));
    assert!(of(refused(header(now + SECOND, ""), &ahead(0.1))).contains("ahead"));
    assert!(of(refused(header(now, "map"), &ahead(0.1))).contains("frame_id"));
    let mut tilted = ahead(0.1);
    for (set, name) in [(0, "linear.z"), (1, "angular.x"), (2, "angular.y")] {
        tilted.linear.z = if set == 0 { 0.1 } else { 0.0 };
        tilted.angular.x = if set == 1 { 0.1 } else { 0.0 };
        tilted.angular.y = if set == 2 { 0.1 } else { 0.0 };
        assert!(of(judge(&rules(), None, &tilted, now)).contains(name));
    }
    for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let reason = of(judge(&rules(), None, &ahead(number), now));
        assert!(reason.starts_with("linear.x is "), "{reason}");
    }
    // Ten times 2 m/s is the end; up to there it is slowed down, in its direction.
    assert!(of(judge(&rules(), None, &ahead(20.1), now)).contains("limits"));
    let (slow, factor) = judge(&rules(), None, &ahead(-4.0), now).unwrap();
    assert!(
        (slow.vx + 2.0).abs() < 1e-3 && (factor - 0.5).abs() < 1e-3,
        "{slow:?} {factor}"
    );
}
