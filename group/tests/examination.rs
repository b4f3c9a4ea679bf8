//! Everything that is wrong with a file is said in one go.

#[macro_use]
mod common;

use omnibus_group::Examination;

const GOOD: &str = concat!(
    r#"name = "pair"
group_id = 7
sync_period_ms = 10

[limits]
linear_speed = 2.0
yaw_rate = 1.0

"#,
    robot!(),
    members!(),
    r#"heading_deg = 0
"#
);

/// What is said about [`GOOD`] with pieces replaced: errors, warnings.
fn messages(pieces: &[(&str, &str)]) -> (Vec<String>, Vec<String>) {
    let mut text = GOOD.to_owned();
    for (from, to) in pieces {
        assert_eq!(text.matches(from).count(), 1, "{from:?} must occur once");
        text = text.replace(from, to);
    }
    let found = Examination::of("pair.toml", &text);
    assert_eq!(found.group.is_some(), found.errors.is_empty());
    let texts = |errors: &[omnibus_group::GroupError]| {
        errors.iter().map(ToString::to_string).collect::<Vec<_>>()
    };
    (texts(&found.errors), texts(&found.warnings))
}

#[test]
fn a_good_file_is_good() {
    assert_eq!(messages(&[]), (vec![], vec![]));
}

#[test]
fn every_rule_that_is_broken_is_named_at_once() {
    let (errors, _) = messages(&[
        ("group_id = 7\n", ""),
        ("wheel_radius", "wheel_raduis"),
        ("half_track = 0.37", "half_track = \"0.37\""),
        ("roller_angle_deg = 45", "roller_angle_deg = 90"),
        ("supply = 24", "supply = 0"),
        ("node = 3", "node = 2"),
        ("sync_period_ms = 10", "sync_period_ms = 0.01"),
    ]);
    assert_eq!(
        errors,
        [
            "pair.toml:1: group_id: is missing; add `group_id = ...`",
            "pair.toml:2: sync_period_ms: is 0.01; give whole milliseconds, 1 to 10000; if the \
             value is in seconds, write 10",
            "pair.toml:9: robot.half_track: `\"0.37\"` is not allowed here; give a number",
            "pair.toml:11: robot.wheel_raduis: unknown key; did you mean `wheel_radius`?",
            "pair.toml:12: robot.roller_angle_deg: is 90; give the angle between roller axle and \
             wheel axle in degrees, above 0 and below 90",
            "pair.toml:15: robot.motor.supply: is 0; give a number greater than 0",
            "pair.toml:22: robots[1].node: node 2 is already robots[0]; give every robot a node \
             of its own",
        ]
    );
}

/// A blank file of one's own: once, not fourteen times.
#[test]
fn what_a_file_lacks_is_named_at_once() {
    let text = "name = \"mine\"\ngroup_id = 1\n[[robots]]\nnode = 2\n[[robots]]\nnode = 3\nx = 1\n";
    let errors = Examination::of("mine.toml", text).errors;
    let missing: Vec<_> = errors.iter().map(|error| error.field.as_str()).collect();
    assert_eq!(
        missing,
        [
            "robots[0].motor.supply",
            "robots[0].motor.constant",
            "robots[0].motor.resistance",
            "robots[0].motor.inertia",
            "robots[0].max_wheel_rate",
            "robots[0].encoder.counts_per_revolution",
            "robots[0].half_track",
            "robots[0].half_wheelbase",
            "robots[0].wheel_radius",
            "robots[0].roller_angle_deg",
        ]
    );
}

#[test]
fn what_a_robot_would_refuse_is_refused_with_the_unit_that_was_meant() {
    let (errors, _) = messages(&[
        ("half_track = 0.37", "half_track = 370"),
        ("wheel_radius = 0.1524", "wheel_radius = 152.4"),
        ("roller_angle_deg = 45", "roller_angle_deg = 0.785"),
        ("counts_per_revolution = 40000", "counts_per_revolution = 4"),
    ]);
    assert_eq!(
        errors,
        [
            "pair.toml:10: robot.half_track: is 370 m; give 0.02 to 5 m; if the value is in \
             millimetres, write 0.37",
            "pair.toml:12: robot.wheel_radius: is 152.4 m; give 0.01 to 1 m; if the value is in \
             millimetres, write 0.1524",
            "pair.toml:13: robot.roller_angle_deg: is 0.785 degrees; give 5.7296 to 84.2248 \
             degrees; if the value is in radians, write 44.9772",
            "pair.toml:15: robot.encoder.counts_per_revolution: is 4 counts; give 16 to 1000000 \
             counts",
        ]
    );
}

#[test]
fn robots_on_the_same_floor_are_refused() {
    let (errors, _) = messages(&[("x = -0.6", "x = 0.6")]);
    assert_eq!(
        errors,
        [
            "pair.toml:22: robots[1]: its wheels overlap those of robots[0], 0.000 m away; \
             fix x, y and heading_deg, or the dimensions"
        ]
    );
    // A length is 2 x (0.35 + 0.1524) = 1.0048 m: in line they touch there, turned by a right
    // angle (0.5024 + 0.37 = 0.8724 m) nearer.
    let at = |x: &str, heading: &str| {
        let x = format!("x = {x}");
        messages(&[("x = -0.6", &x), ("heading_deg = 0", heading)])
            .0
            .len()
    };
    assert_eq!(at("-0.405", "heading_deg = 0"), 0);
    assert_eq!(at("-0.404", "heading_deg = 0"), 1);
    assert_eq!(at("-0.273", "heading_deg = 90"), 0);
    assert_eq!(at("-0.272", "heading_deg = 90"), 1);
}

#[test]
fn speeds_beyond_the_wheels_are_mentioned() {
    // 15 rad/s x 0.1524 m = 2.29 m/s at the rim; a diagonal leaves that over the square root of 2.
    // Turning, the far wheels are at 0.95 m and 0.37 m: 0.6 + 0.35 + 0.37 m of rim a radian.
    let (errors, warnings) = messages(&[
        ("max_wheel_rate = 22", "max_wheel_rate = 15"),
        ("linear_speed = 2.0", "linear_speed = 3"),
        ("yaw_rate = 1.0", "yaw_rate = 2.6"),
    ]);
    assert!(errors.is_empty());
    assert_eq!(
        warnings,
        [
            "pair.toml:6: limits.linear_speed: is 3 m/s, but the wheels of node 2 reach only 1.62 \
             m/s in every direction; lower it, or the group moves slower than commanded",
            "pair.toml:7: limits.yaw_rate: is 2.6 rad/s, but the wheels of node 2 reach only 1.73 \
             rad/s; lower it, or the group turns slower than commanded",
        ]
    );
}

/// With rollers at 30 degrees a wheel turns with vx + vy / tan(30): sin(30) of the rim's speed is
/// left in the worst direction. In a turn a wheel at (x, y) goes with |y| + |x| / tan(30).
#[test]
fn speeds_follow_from_the_angle_of_the_rollers() {
    let (errors, warnings) = messages(&[
        ("roller_angle_deg = 45", "roller_angle_deg = 30"),
        ("yaw_rate = 1.0", "yaw_rate = 2.2"),
    ]);
    assert!(errors.is_empty());
    assert_eq!(warnings.len(), 2, "{warnings:?}");
    let rim = 22.0 * 0.1524_f64;
    let linear = format!("reach only {:.2} m/s", rim * 0.5);
    let reach = 0.37 + (0.6 + 0.35) * 3.0_f64.sqrt();
    let turning = format!("reach only {:.2} rad/s", rim / reach);
    assert!(warnings[0].contains(&linear), "{}: {linear}", warnings[0]);
    assert!(warnings[1].contains(&turning), "{}: {turning}", warnings[1]);
}

/// What a robot would refuse when it has everything is said before it is asked.
#[test]
fn what_no_robot_accepts_is_an_error() {
    // 1.25 x 2 m/s over 0.5 m/s2 are 5 s.
    let (errors, _) = messages(&[(
        "yaw_rate = 1.0",
        "yaw_rate = 1.0\nlinear_acceleration = 0.5",
    )]);
    assert_eq!(
        errors,
        [
            "pair.toml:8: limits.linear_acceleration: is 0.5: node 2 would not stand within 3 s \
             from the fastest that its wheels and 1.25 times limits.linear_speed allow; raise it, \
             or lower limits.linear_speed"
        ]
    );
    // A robot in the middle of long beams could turn the group faster than its limit lets it.
    let slow = "yaw_rate = 0.4\nyaw_acceleration = 0.3";
    let (errors, _) = messages(&[("yaw_rate = 1.0", slow)]);
    assert!(errors.is_empty(), "{errors:?}");
}

#[test]
fn a_heading_in_radians_is_mentioned() {
    let (_, warnings) = messages(&[("heading_deg = 0", "heading_deg = 1.5708")]);
    assert_eq!(
        warnings,
        [
            "pair.toml:25: robots[1].heading_deg: is 1.5708 degrees; if the value is in radians, \
             write 90"
        ]
    );
    let (_, warnings) = messages(&[("heading_deg = 0", "heading_deg = 1.5")]);
    assert!(warnings.is_empty());
}
