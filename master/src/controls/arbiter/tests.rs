use super::*;

const LIMITS: Limits = Limits {
    linear_speed: 2.0,
    yaw_rate: 1.0,
    linear_acceleration: 1.0,
    yaw_acceleration: 1.0,
    linear_jerk: 1.0,
    yaw_jerk: 1.0,
    command_timeout_us: 100_000,
    sync_timeout_us: 0,
};

fn ahead(vx: f32) -> Twist {
    Twist::new(vx, 0.0, 0.0)
}

/// The velocity that is asked for.
fn velocity(arbiter: &mut Arbiter, now: u64) -> Twist {
    match arbiter.order(now) {
        Order::Twist(twist, _) => twist,
        order => panic!("{order:?}"),
    }
}

/// Client 1 drives robots that were started at 1000 ms.
fn started() -> Arbiter {
    let mut arbiter = Arbiter::new(&LIMITS);
    arbiter.take(1).unwrap();
    arbiter.start(1000, 1).unwrap();
    arbiter.set_running(true);
    arbiter
}

fn is_refused(reply: Result<(), String>, word: &str) {
    assert!(
        matches!(&reply, Err(reason) if reason.contains(word)),
        "{reply:?}"
    );
}

#[test]
fn a_press_moves_until_its_messages_stop() {
    let mut arbiter = started();
    assert_eq!(velocity(&mut arbiter, 1000), Twist::ZERO);
    arbiter.press(1010, 1, 1, ahead(0.5), 1000).unwrap();
    assert_eq!(velocity(&mut arbiter, 1010 + STALE_MS).vx, 0.5);
    assert_eq!(velocity(&mut arbiter, 1011 + STALE_MS), Twist::ZERO);
    // What was pressed then is over, also when its messages come again.
    arbiter.press(1300, 1, 1, ahead(0.5), 1290).unwrap();
    assert_eq!(velocity(&mut arbiter, 1300), Twist::ZERO);
    arbiter.press(1310, 1, 2, ahead(0.4), 1290).unwrap();
    assert_eq!(velocity(&mut arbiter, 1310).vx, 0.4);
}

#[test]
fn release_stops_at_once() {
    let mut arbiter = started();
    arbiter.press(1010, 1, 1, ahead(0.5), 1000).unwrap();
    arbiter.release(1);
    assert_eq!(velocity(&mut arbiter, 1020), Twist::ZERO);
    assert!(arbiter.is_wanted(1020), "the robots stay started");
}

#[test]
fn a_driver_that_goes_stops_the_robots() {
    let mut arbiter = started();
    arbiter.press(1010, 1, 1, ahead(0.5), 1000).unwrap();
    arbiter.gone(2);
    assert_eq!(velocity(&mut arbiter, 1010).vx, 0.5);
    arbiter.gone(1);
    assert_eq!(velocity(&mut arbiter, 1010), Twist::ZERO);
    assert!(!arbiter.is_wanted(1010) && !arbiter.has_driver());
}

#[test]
fn only_the_driver_moves_anything_and_anybody_stops() {
    let mut arbiter = started();
    is_refused(arbiter.take(2), "another");
    is_refused(arbiter.press(1010, 2, 1, ahead(0.5), 1000), "take");
    is_refused(arbiter.stream(1010, 2, ahead(0.5), 200), "start");
    is_refused(arbiter.start(1010, 2), "take");
    assert_eq!(velocity(&mut arbiter, 1010), Twist::ZERO);
    arbiter.press(1010, 1, 1, ahead(0.5), 1000).unwrap();
    // Another's release is not the driver's.
    arbiter.release(2);
    assert_eq!(velocity(&mut arbiter, 1020).vx, 0.5);
    arbiter.stop();
    assert_eq!(velocity(&mut arbiter, 1030), Twist::ZERO);
    assert!(!arbiter.is_wanted(1030));
}

#[test]
fn a_driver_that_moves_nothing_can_be_succeeded_and_is_named() {
    let mut arbiter = started();
    arbiter.stream(1010, 1, ahead(0.5), 200).unwrap();
    assert!(arbiter.succeed(1209, 2).is_err(), "the velocity is good");
    assert_eq!(arbiter.succeed(1209, 1), Ok(None));
    assert_eq!(arbiter.succeed(1210, 2), Ok(Some(1)));
    assert!(arbiter.drives(2) && !arbiter.drives(1));
    assert!(arbiter.is_wanted(1210), "the robots stay started");
    // A press holds the controls in the same way.
    arbiter.press(1300, 2, 1, ahead(0.1), 1300).unwrap();
    assert!(arbiter.succeed(1300 + STALE_MS, 3).is_err());
    assert_eq!(arbiter.succeed(1301 + STALE_MS, 3), Ok(Some(2)));
    // After a stop nothing is good any more.
    arbiter.stream(2000, 3, ahead(0.1), 1000).unwrap();
    arbiter.stop();
    assert_eq!(arbiter.succeed(2001, 4), Ok(Some(3)));
}

#[test]
fn a_bad_press_is_refused_and_ends_it() {
    let bad = [
        (ahead(2.1), 1010, "2 m/s"),
        (ahead(f32::NAN), 1010, "m/s"),
        (ahead(f32::INFINITY), 1010, "m/s"),
        (ahead(0.5), 1010 - OLD_MS - 1, "older"),
        // From the future: not one of ours.
        (ahead(0.5), 1021, "older"),
        (Twist::new(0.0, 0.0, -1.1), 1010, "1 rad/s"),
    ];
    for (twist, clock, word) in bad {
        let mut arbiter = started();
        arbiter.press(1010, 1, 1, ahead(0.5), 1000).unwrap();
        is_refused(arbiter.press(1010, 1, 1, twist, clock), word);
        assert_eq!(velocity(&mut arbiter, 1010), Twist::ZERO, "{twist:?}");
    }
}

#[test]
fn robots_are_started_before_they_are_driven_and_not_left_on() {
    let mut arbiter = Arbiter::new(&LIMITS);
    arbiter.take(1).unwrap();
    is_refused(arbiter.press(0, 1, 1, ahead(0.5), 0), "start");
    arbiter.start(0, 1).unwrap();
    is_refused(arbiter.press(0, 1, 1, ahead(0.5), 0), "not ready");
    assert_eq!(velocity(&mut arbiter, 0), Twist::ZERO);
    let mut arbiter = started();
    assert!(arbiter.is_wanted(1000 + IDLE_MS));
    assert!(!arbiter.is_wanted(1001 + IDLE_MS));
}

#[test]
fn a_curve_goes_on_while_its_messages_come_and_does_not_come_back() {
    let mut arbiter = started();
    let circle = ("circle", 0.2);
    arbiter.press_curve(1010, 1, 1, circle, 1000).unwrap();
    let Order::Curve(first, _) = arbiter.order(1010) else {
        panic!("no curve")
    };
    assert_eq!(first.name(), "circle");
    // 2 pi 0.5 m in 20 s.
    assert!(
        (first.fastest() - 0.157).abs() < 1e-3,
        "{}",
        first.fastest()
    );
    arbiter.press_curve(1210, 1, 1, circle, 1200).unwrap();
    assert!(matches!(arbiter.order(1460), Order::Curve(plan, _) if Arc::ptr_eq(&plan, &first)));
    assert_eq!(velocity(&mut arbiter, 1461), Twist::ZERO);
    arbiter.press_curve(1470, 1, 1, circle, 1450).unwrap();
    assert_eq!(velocity(&mut arbiter, 1470), Twist::ZERO);
    // A new press starts it again.
    arbiter.press_curve(1480, 1, 2, circle, 1470).unwrap();
    assert!(matches!(arbiter.order(1480), Order::Curve(plan, _) if !Arc::ptr_eq(&plan, &first)));
    assert!(arbiter.succeed(1490, 2).is_err(), "it moves the group");
    arbiter.stop();
    assert_eq!(velocity(&mut arbiter, 1490), Twist::ZERO);
    assert!(!arbiter.is_wanted(1490));
}

#[test]
fn a_curve_is_refused_like_a_press_and_by_what_it_needs() {
    let refusals = [
        ("square", 1.0, 1010, "no curve `square`"),
        ("circle", f64::NAN, 1010, "between 0.05 and 10"),
        ("circle", 0.01, 1010, "between 0.05 and 10"),
        // l w sqrt(1 + 4) with l = 2.5 m and w = pi/10, times 2.
        (
            "figure-eight",
            2.0,
            1010,
            "needs 3.51 m/s, and limits.linear_speed is 2 m/s",
        ),
        ("circle", 0.2, 1010 - OLD_MS - 1, "older"),
    ];
    for (name, scale, clock, word) in refusals {
        let mut arbiter = started();
        arbiter.press(1010, 1, 1, ahead(0.5), 1000).unwrap();
        is_refused(arbiter.press_curve(1010, 1, 2, (name, scale), clock), word);
        assert_eq!(velocity(&mut arbiter, 1010), Twist::ZERO, "{name}");
    }
    let mut arbiter = started();
    let circle = ("circle", 0.2);
    is_refused(arbiter.press_curve(1010, 2, 1, circle, 1000), "take");
    arbiter.set_running(false);
    is_refused(arbiter.press_curve(1010, 1, 1, circle, 1000), "not ready");
    arbiter.stop();
    is_refused(
        arbiter.press_curve(1010, 1, 1, circle, 1000),
        "start the robots",
    );
}
