//! Routes driven in the steps of a follower, against the limits and closed forms.

use super::*;
use std::f64::consts::FRAC_PI_2;

const LIMITS: Limits = Limits {
    linear_speed: 2.0,
    yaw_rate: 1.0,
    linear_acceleration: 2.4,
    yaw_acceleration: 2.0,
    linear_jerk: 100.0,
    yaw_jerk: 80.0,
    command_timeout_us: 100_000,
    sync_timeout_us: 0,
};
const LEAD: f64 = 0.04;

fn line(from: f64, to: f64, mark: u32) -> Stretch {
    let poses = (0..=100).map(|n| Pose::new(from + (to - from) * f64::from(n) / 100.0, 0.0, 0.0));
    Stretch {
        poses: poses.collect(),
        speed: None,
        turn: None,
        mark: Some(mark),
    }
}

fn arc(speed: Option<f64>) -> Stretch {
    let poses = (0..=1000).map(|n| {
        let angle = FRAC_PI_2 * f64::from(n) / 1000.0;
        Pose::new(angle.cos(), angle.sin(), angle + FRAC_PI_2)
    });
    Stretch {
        poses: poses.collect(),
        speed,
        turn: None,
        mark: Some(2),
    }
}

/// Drives to the end in SYNC steps as the follower does; gives the time and every body twist.
fn drive(route: &SharedRoute, from: f64, each: &mut dyn FnMut(f64)) -> (f64, Vec<Twist<f64>>) {
    let (mut t, mut twists) = (from, Vec::new());
    while t < 600.0 && t - LEAD <= route.duration() {
        let (pose, twist) = route.at(t);
        twists.push(twist.to_body(pose.heading));
        each(t);
        t += 0.01;
    }
    route.close();
    (route.duration(), twists)
}

fn within_limits(twists: &[Twist<f64>]) {
    for pair in twists.windows(2) {
        let (v, change) = (pair[1], (pair[1] - pair[0]) * 100.0);
        assert!(v.vx.hypot(v.vy) <= 2.0 && v.omega.abs() <= 1.0, "{v:?}");
        assert!(change.vx.hypot(change.vy) <= 2.4, "{change:?} at {v:?}");
        assert!(change.omega.abs() <= 2.0, "{change:?} at {v:?}");
    }
}

/// The follower asks for nothing behind the end, which is a multiple of the time law's steps but
/// for rounding.
#[test]
fn the_mark_at_the_end_is_passed_when_the_route_is_closed() {
    for speed in (1..=36).map(|n| 0.05 * f64::from(n)) {
        let way = Stretch {
            speed: Some(speed),
            ..line(0.0, 2.0, 2)
        };
        let route = SharedRoute::new(&LIMITS, &[way], LEAD, false);
        let mut t = 0.0;
        while t <= route.duration() {
            let _ = route.at(t);
            t += 0.01;
        }
        let end = Pose::new(2.0, 0.0, 0.0);
        assert_eq!(route.at(route.duration()).0, end, "{speed} m/s");
        assert!(route.passed().is_empty(), "the group is not there yet");
        route.close();
        assert!(!route.is_reported(), "{speed} m/s");
        assert_eq!(route.passed(), [2], "{speed} m/s");
        assert!(route.is_reported());
    }
}

/// d = 4 m with 1.44 m/s² up to 1.8 m/s: t = d/v + v/a.
#[test]
fn a_line_takes_as_long_as_a_trapezoid_and_keeps_the_limits() {
    let route = SharedRoute::new(&LIMITS, &[line(0.0, 4.0, 2)], LEAD, false);
    let (duration, twists) = drive(&route, 0.0, &mut |_| {});
    assert!(
        (duration - (4.0 / 1.8 + 1.8 / 1.44)).abs() < 0.1,
        "{duration}"
    );
    within_limits(&twists);
    assert_eq!(
        route.at(duration),
        (Pose::new(4.0, 0.0, 0.0), Twist::new(0.0, 0.0, 0.0))
    );
    assert_eq!(route.passed(), [2]);
    assert!(route.passed().is_empty());
}

#[test]
fn an_arc_is_kept_and_its_speed_is_bounded_by_turning_and_by_what_was_asked() {
    for (asked, fastest) in [(None, 0.9), (Some(0.3), 0.3)] {
        let route = SharedRoute::new(&LIMITS, &[arc(asked)], LEAD, false);
        let mut off = 0.0_f64;
        let (_, twists) = drive(&route, 0.0, &mut |t| {
            let (pose, _) = route.at(t);
            off = off.max((pose.x.hypot(pose.y) - 1.0).abs());
        });
        within_limits(&twists);
        assert!(off < 1e-6, "{off} m beside the circle");
        let most = twists.iter().map(|v| v.vx.hypot(v.vy)).fold(0.0, f64::max);
        assert!((most - fastest).abs() < 0.01, "{most}");
    }
}

#[test]
fn corners_and_turns_on_the_spot_are_almost_stops() {
    let up = (0..=100)
        .map(|n| Pose::new(1.0, f64::from(n) / 100.0, 0.0))
        .collect();
    let turn = (0..=100)
        .map(|n| Pose::new(1.0, 1.0, f64::from(n) / 100.0))
        .collect();
    let stretch = |poses, mark| Stretch {
        poses,
        speed: None,
        turn: None,
        mark: Some(mark),
    };
    let way = [line(0.0, 1.0, 2), stretch(up, 4), stretch(turn, 6)];
    let route = SharedRoute::new(&LIMITS, &way, LEAD, false);
    let mut marks = Vec::new();
    let (duration, twists) = drive(&route, 0.0, &mut |_| marks.extend(route.passed()));
    within_limits(&twists);
    marks.extend(route.passed());
    assert_eq!(marks, [2, 4, 6], "one by one");
    let (end, _) = route.at(duration);
    assert!((end.x - 1.0).abs() < 1e-9 && (end.heading - 1.0).abs() < 1e-9);
}

#[test]
fn a_held_route_stands_and_then_goes_on_to_its_end() {
    let route = SharedRoute::new(&LIMITS, &[line(0.0, 4.0, 2)], LEAD, false);
    let mut stood = None;
    let (duration, twists) = drive(&route, 0.0, &mut |t| {
        if (t - 1.0).abs() < 1e-6 {
            route.hold();
        }
        if stood.is_none() && route.stands() {
            stood = Some((t, route.at(t).0.x));
        }
        if (t - 5.0).abs() < 1e-6 {
            route.resume();
        }
    });
    within_limits(&twists);
    let (t, x) = stood.unwrap();
    // 1.44 m/s at 1 s, 1 s of braking.
    assert!(
        (t - 2.0).abs() < 0.15 && (x - 1.44).abs() < 0.15,
        "{t} s, {x} m"
    );
    assert!(duration > 5.0 && (route.at(duration).0.x - 4.0).abs() < 1e-9);
}

#[test]
fn a_cut_route_ends_on_the_way_and_takes_no_more() {
    let route = SharedRoute::new(&LIMITS, &[line(0.0, 4.0, 2)], LEAD, false);
    let (duration, twists) = drive(&route, 0.0, &mut |t| {
        if (t - 1.0).abs() < 1e-6 {
            route.cut();
            assert!(!route.extend(&[line(4.0, 5.0, 4)]));
        }
    });
    within_limits(&twists);
    let (end, _) = route.at(duration);
    assert!((end.x - 1.44).abs() < 0.15, "{end:?}");
    assert!(route.passed().is_empty());
    // The same for one that is held, or has not begun.
    let held = SharedRoute::new(&LIMITS, &[line(0.0, 4.0, 2)], LEAD, true);
    held.at(3.0);
    held.cut();
    assert!(held.duration() <= 3.1);
}

#[test]
fn a_route_that_is_extended_in_time_is_driven_through() {
    let route = SharedRoute::new(&LIMITS, &[line(0.0, 2.0, 2)], LEAD, false);
    let mut slowest = f64::INFINITY;
    let (_, twists) = drive(&route, 0.0, &mut |t| {
        if (t - 0.8).abs() < 1e-6 {
            assert!(route.extend(&[line(2.0, 4.0, 4)]));
        }
        let (pose, twist) = route.at(t);
        if pose.x > 1.0 && pose.x < 3.0 {
            slowest = slowest.min(twist.vx);
        }
    });
    within_limits(&twists);
    assert!(slowest > 1.4, "{slowest} m/s at the joint");
    assert_eq!(route.passed(), [2, 4]);
    assert!(
        !route.extend(&[line(4.0, 5.0, 6)]),
        "it has come to its end"
    );
}
