//! What a group file is refused for, with the exact text a person reads.
//!
//! Each case takes one valid file, changes one thing, and expects one sentence: file, line, field,
//! problem, remedy. Lines are those of [`VALID`].

#[macro_use]
mod common;

use omnibus_group::GroupFile;

const VALID: &str = concat!(
    r#"name = "pair"
group_id = 7
sync_period_ms = 10

[limits]
linear_speed = 2.0

"#,
    robot!(),
    members!(),
    r#"compensation = { lateral = 1.033 }

[simulation]
crystal_ppm = [0, 20]
"#
);

/// The refusal of [`VALID`] with one piece of text replaced.
fn refusal(from: &str, to: &str) -> String {
    assert_eq!(VALID.matches(from).count(), 1, "{from:?} must occur once");
    GroupFile::parse("pair.toml", &VALID.replace(from, to))
        .expect_err("must be refused")
        .to_string()
}

#[test]
fn accepts_the_file_the_cases_start_from() {
    let group = GroupFile::parse("pair.toml", VALID).unwrap();
    assert_eq!(group.robots.len(), 2);
}

#[test]
fn unknown_key_names_the_key_that_was_meant() {
    assert_eq!(
        refusal("wheel_radius", "wheel_raduis"),
        "pair.toml:11: robot.wheel_raduis: unknown key; did you mean `wheel_radius`?"
    );
}

#[test]
fn a_lag_that_is_no_contacts_is_refused() {
    assert_eq!(
        refusal("[robot]", "[contact_lag]\nyaw_ms = 101\n\n[robot]"),
        "pair.toml:9: contact_lag.yaw_ms: is 101; give at most 100; contacts do not creep by more"
    );
}

#[test]
fn a_loss_that_is_no_rollers_is_refused() {
    let with_rollers = |loss: &str| {
        let text = format!(
            "[roller_transition]\nloss_s_per_m = {loss}\n\n[robot]\nrollers = {{ count = 8, phases_deg = [0, 0, 0, 0] }}"
        );
        refusal("[robot]", &text)
    };
    assert_eq!(
        with_rollers("0.06"),
        "pair.toml:9: roller_transition.loss_s_per_m: is 0.06; give at most 0.05; a roller does \
         not cost more"
    );
    assert_eq!(
        with_rollers("-0.001"),
        "pair.toml:9: roller_transition.loss_s_per_m: is -0.001; give 0 or a positive number"
    );
    assert_eq!(
        refusal(
            "[robot]",
            "[roller_transition]\nloss_s_per_m = 0.001\n\n[robot]"
        ),
        "pair.toml:9: roller_transition.loss_s_per_m: applies only to robots with `rollers`; add \
         the robots' rollers, or remove it"
    );
}

#[test]
fn unknown_key_lists_the_keys_there_are() {
    assert_eq!(
        refusal(
            "compensation = { lateral = 1.033 }",
            "compensation = { sideways = 1.033 }"
        ),
        "pair.toml:24: robots[1].compensation.sideways: unknown key; remove it, or use one of: longitudinal, lateral, \
         yaw, table"
    );
}

#[test]
fn zero_radius() {
    assert_eq!(
        refusal("wheel_radius = 0.1524", "wheel_radius = 0"),
        "pair.toml:11: robot.wheel_radius: is 0; give a number greater than 0"
    );
}

#[test]
fn negative_dimension() {
    assert_eq!(
        refusal("half_track = 0.37", "half_track = -0.37"),
        "pair.toml:9: robot.half_track: is -0.37; give a number greater than 0"
    );
}

#[test]
fn radius_that_is_zero_in_the_robot() {
    assert_eq!(
        refusal("wheel_radius = 0.1524", "wheel_radius = 1e-60"),
        "pair.toml:11: robot.wheel_radius: is \
         0.000000000000000000000000000000000000000000000000000000000001; give a number greater \
         than 0"
    );
}

#[test]
fn not_a_number() {
    assert_eq!(
        refusal("x = -0.6", "x = nan"),
        "pair.toml:23: robots[1].x: is nan; give a finite number"
    );
}

#[test]
fn infinite() {
    assert_eq!(
        refusal("linear_speed = 2.0", "linear_speed = inf"),
        "pair.toml:6: limits.linear_speed: is inf; give a number greater than 0"
    );
}

#[test]
fn a_speed_that_no_setpoint_can_hold() {
    // A setpoint's components are 16 bits in 0.1 mm/s and 0.1 mrad/s: 32 767 of them at most.
    assert_eq!(
        refusal("linear_speed = 2.0", "linear_speed = 50"),
        "pair.toml:6: limits.linear_speed: is 50 m/s; give more than 0, up to 3.2767 m/s; if the \
         value is in mm/s, write 0.05"
    );
    assert_eq!(
        refusal("linear_speed = 2.0", "yaw_rate = 4"),
        "pair.toml:6: limits.yaw_rate: is 4 rad/s; give more than 0, up to 3.2767 rad/s; if the \
         value is in degrees per second, write 0.0698"
    );
    let fastest = VALID.replace("linear_speed = 2.0", "linear_speed = 3.2767");
    GroupFile::parse("pair.toml", &fastest).unwrap();
}

#[test]
fn two_robots_with_one_node() {
    assert_eq!(
        refusal("node = 3", "node = 2"),
        "pair.toml:22: robots[1].node: node 2 is already robots[0]; give every robot a node of \
         its own"
    );
}

#[test]
fn the_masters_node() {
    assert_eq!(
        refusal("node = 3", "node = 1"),
        "pair.toml:22: robots[1].node: is 1; give a robot's node, 2 to 17 (1 is the master)"
    );
}

#[test]
fn node_beyond_the_last() {
    assert_eq!(
        refusal("node = 3", "node = 18"),
        "pair.toml:22: robots[1].node: is 18; give a robot's node, 2 to 17 (1 is the master)"
    );
}

#[test]
fn node_left_out() {
    assert_eq!(
        refusal("node = 3\n", ""),
        "pair.toml:21: robots[1].node: is missing; give it in this entry"
    );
}

#[test]
fn empty_group() {
    let text = "name = \"none\"\ngroup_id = 1\nrobots = []\n";
    assert_eq!(
        GroupFile::parse("none.toml", text).unwrap_err().to_string(),
        "none.toml:3: robots: the group is empty; add a `[[robots]]` entry for every robot"
    );
    let text = "name = \"none\"\ngroup_id = 1\n";
    assert_eq!(
        GroupFile::parse("none.toml", text).unwrap_err().to_string(),
        "none.toml:3: robots: the group is empty; add a `[[robots]]` entry for every robot"
    );
}

#[test]
fn seventeen_robots() {
    let robots: String = (2..=18)
        .map(|node| format!("[[robots]]\nnode = {node}\n"))
        .collect();
    let text = format!("name = \"many\"\ngroup_id = 1\n{robots}");
    assert_eq!(
        GroupFile::parse("many.toml", &text)
            .unwrap_err()
            .to_string(),
        "many.toml:35: robots: 17 robots in one group; put at most 16 on one bus"
    );
}

#[test]
fn compensation_of_zero() {
    assert_eq!(
        refusal("lateral = 1.033", "lateral = 0"),
        "pair.toml:24: robots[1].compensation.lateral: is 0; give 1 for no compensation; 0 would \
         delete the axis"
    );
}

#[test]
fn compensation_that_is_not_a_number() {
    assert_eq!(
        refusal("lateral = 1.033", "yaw = nan"),
        "pair.toml:24: robots[1].compensation.yaw: is nan; give a finite number"
    );
}

#[test]
fn an_index_tolerance_no_robot_takes() {
    for counts in [0, 20_000] {
        assert_eq!(
            refusal(
                "node = 2\n",
                &format!("node = 2\nrollers = {{ count = 8, index_tolerance = {counts} }}\n")
            ),
            format!(
                "pair.toml:19: robots[0].rollers.index_tolerance: is {counts}; give encoder \
                 counts, 1 to 10000: the play between encoder and wheel, and two"
            )
        );
    }
}

#[test]
fn roller_angle_of_a_right_angle() {
    assert_eq!(
        refusal("roller_angle_deg = 45", "roller_angle_deg = 90"),
        "pair.toml:12: robot.roller_angle_deg: is 90; give the angle between roller axle and \
         wheel axle in degrees, above 0 and below 90"
    );
}

#[test]
fn a_dimension_left_out() {
    assert_eq!(
        refusal("half_wheelbase = 0.35\n", ""),
        "pair.toml:16: robots[0].half_wheelbase: is missing; give it in `[robot]` or in this entry"
    );
}

#[test]
fn wheel_rate_beyond_the_motor() {
    assert_eq!(
        refusal("max_wheel_rate = 22", "max_wheel_rate = 31"),
        "pair.toml:13: robot.max_wheel_rate: is 31 rad/s, but the motors of robots[0] reach only 30.0; \
         lower it, or fix the values of `motor`"
    );
}

/// The refusal of a second robot that is a kit, with this in its `motor`.
fn kit(motor: &str) -> String {
    let entry = format!("board = \"kit-f103rc\"\nmotor = {{ {motor} }}");
    refusal("compensation = { lateral = 1.033 }", &entry)
}

#[test]
fn a_kit_with_what_it_is_not_wired_for() {
    assert_eq!(
        kit(""),
        "pair.toml:21: robots[1].motor.output_stage: is not for a `kit-f103rc`; give \
         `in-in-brake` or `in-in-fast`: its bridges have two PWMs a wheel"
    );
    assert_eq!(
        kit("output_stage = \"in-in-fast\", largest_current = 2, current_scale = 10"),
        "pair.toml:25: robots[1].motor.current_scale: is not for a `kit-f103rc`; remove it: the \
         board has no inputs for current sensors"
    );
    let rollers = "board = \"kit-f103rc\"\nmotor = { output_stage = \"in-in-brake\" }\n\
                   rollers = { count = 8 }";
    assert_eq!(
        refusal("compensation = { lateral = 1.033 }", rollers),
        "pair.toml:26: robots[1].rollers: is not for a `kit-f103rc`; remove it: the board has no \
         index inputs, so the rollers' phase is never known"
    );
}

/// `docs/boards.md`: the RoboMaster board has no inputs for current sensors either.
#[test]
fn a_current_sensor_on_a_board_without_inputs() {
    let entry = "board = \"robomaster-c\"\n\
                 motor = { output_stage = \"c620\", largest_current = 2, current_scale = 10 }";
    let text = VALID.replace("compensation = { lateral = 1.033 }", entry);
    let text = GroupFile::parse("pair.toml", &text).expect_err("must be refused");
    let expected = "pair.toml:25: robots[1].motor.current_scale: is not for a `robomaster-c`; \
                    remove it: the board has no inputs for current sensors";
    assert!(text.to_string().contains(expected), "{text}");
}

/// Fixed point has no number for 8 V s^2/rad (docs/numbers.md); a robot with floats takes 50.
#[test]
fn a_kit_whose_wheels_are_too_heavy_for_fixed_point() {
    let heavy = |inertia: &str| format!("output_stage = \"in-in-brake\", inertia = {inertia}");
    assert_eq!(
        kit(&heavy("30")),
        "pair.toml:21: robots[1].motor.inertia: gives Acceleration feedforward (2021:3) = 11.25, \
         which a `kit-f103rc` accepts from 0 to 8 V s^2/rad; lower it or `motor.resistance`, or \
         fix `motor.constant`"
    );
    let other = VALID.replace(
        "compensation = { lateral = 1.033 }",
        "motor = { inertia = 30 }",
    );
    GroupFile::parse("pair.toml", &other).unwrap();
}

#[test]
fn a_gain_that_is_too_high_in_volts() {
    assert_eq!(
        refusal(
            "compensation = { lateral = 1.033 }",
            "control = { proportional = 5 }"
        ),
        "pair.toml:21: robots[1].control.proportional: gives Proportional gain (2021:4) = 120, \
         which robots accept from 0 to 100 V s/rad; lower it: it counts times `motor.supply`"
    );
}

#[test]
fn group_without_robots() {
    assert_eq!(
        refusal("group_id = 7", "group_id = 0"),
        "pair.toml:2: group_id: is 0; give a whole number from 1 to 255"
    );
}

#[test]
fn name_of_nothing() {
    assert_eq!(
        refusal("name = \"pair\"", "name = \" \""),
        "pair.toml:1: name: is empty; give the group a short name"
    );
}

#[test]
fn a_required_key_left_out() {
    assert_eq!(
        refusal("group_id = 7\n", ""),
        "pair.toml:1: group_id: is missing; add `group_id = ...`"
    );
}

#[test]
fn period_between_milliseconds() {
    assert_eq!(
        refusal("sync_period_ms = 10", "sync_period_ms = 0.5"),
        "pair.toml:3: sync_period_ms: is 0.5; give whole milliseconds, 1 to 10000"
    );
}

#[test]
fn text_where_a_number_belongs() {
    assert_eq!(
        refusal("wheel_radius = 0.1524", "wheel_radius = \"0.1524\""),
        "pair.toml:11: robot.wheel_radius: `\"0.1524\"` is not allowed here; give a number"
    );
}

#[test]
fn crystals_of_other_robots() {
    assert_eq!(
        refusal("[0, 20]", "[0, 20, 40]"),
        "pair.toml:27: simulation.crystal_ppm: has 3 values for 2 robots; give one value per robot, \
         in their order"
    );
}

#[test]
fn crystal_that_no_crystal_has() {
    assert_eq!(
        refusal("[0, 20]", "[0, 20000]"),
        "pair.toml:27: simulation.crystal_ppm: is 20000; give an error between -1000 and 1000 ppm"
    );
}

#[test]
fn unknown_plant() {
    assert_eq!(
        refusal("[simulation]\n", "[simulation]\nplant = \"ice\"\n"),
        "pair.toml:27: simulation.plant: \"ice\" is not one of its values; use one of: table, contact, \
         external"
    );
}

#[test]
fn external_plant_without_an_address() {
    assert_eq!(
        refusal("[simulation]\n", "[simulation]\nplant = \"external\"\n"),
        "pair.toml:27: simulation.address: is missing; give the other simulator's `host:port`"
    );
}

#[test]
fn text_that_is_not_toml() {
    let text = refusal("x = 0.6", "x = 0.6.2");
    assert!(text.starts_with("pair.toml:19: x: "), "{text}");
    assert!(text.ends_with("; fix the TOML here"), "{text}");
}

#[test]
fn a_file_that_is_not_there() {
    let error = GroupFile::load("no/such.toml").unwrap_err();
    assert_eq!(error.line, None);
    let text = error.to_string();
    assert!(text.starts_with("no/such.toml: cannot be read ("), "{text}");
    assert!(text.ends_with("; give the path of a group file"), "{text}");
}

/// The refusal of [`VALID`] with these rows of a table.
fn table(rows: &str) -> String {
    let with = format!("compensation = {{ table = {{ version = 1, {rows} }} }}");
    refusal("compensation = { lateral = 1.033 }", &with)
}

#[test]
fn compensation_table_with_a_zero() {
    assert_eq!(
        table("lateral = [[0.1, 1.1], [0.2, 0]]"),
        "pair.toml:24: robots[1].compensation.table.lateral[1]: has coefficient 0; give 0.5 to \
         1.9999; 1 is no compensation, 0 would delete the axis"
    );
}

#[test]
fn compensation_table_whose_speeds_do_not_rise() {
    for speeds in ["[0.2, 1.1], [0.2, 1.2]", "[0.1, 1.1], [nan, 1.2]"] {
        let text = table(&format!("yaw = [{speeds}]"));
        let remedy = "give speeds up to 6.5 that rise from row to row by 0.0001 or more";
        assert!(text.ends_with(remedy), "{text}");
    }
}

#[test]
fn compensation_table_that_cannot_be_inverted() {
    assert_eq!(
        table("lateral = [[0.3, 0.6], [0.31, 1.9]]"),
        "pair.toml:24: robots[1].compensation.table.lateral: row 1: the coefficient changes too \
         fast with speed to be inverted; fix the rows"
    );
    let text = table("oblique = [[0.3, 1.5, 1.5]]");
    assert!(
        text.contains("oblique and axial coefficients differ too much"),
        "{text}"
    );
}

#[test]
fn compensation_table_with_nine_rows() {
    let rows: Vec<String> = (1..=9).map(|i| format!("[0.{i}, 1.1]")).collect();
    let text = table(&format!("longitudinal = [{}]", rows.join(", ")));
    assert!(text.ends_with("has 9 rows; keep at most 8"), "{text}");
}

#[test]
fn compensation_table_without_a_version() {
    let with = "compensation = { table = { lateral = [[0.1, 1.1]] } }";
    let text = refusal("compensation = { lateral = 1.033 }", with);
    assert!(text.contains("version"), "{text}");
}

#[test]
fn an_output_stage_that_is_none_is_refused() {
    let wheels = |key: &str| refusal("inertia = 0.4", &format!("inertia = 0.4, {key}"));
    assert_eq!(
        wheels("largest_duty = 1.1"),
        "pair.toml:15: robot.motor.largest_duty: is 1.1; give 0.1 to 1"
    );
    assert_eq!(
        wheels("brake_engage_ms = 1001"),
        "pair.toml:15: robot.motor.brake_engage_ms: is 1001; give whole milliseconds, 0 to 1000"
    );
    assert_eq!(
        wheels("pwm_frequency = 50000"),
        "pair.toml:15: robot.motor.pwm_frequency: is 50000; give whole Hz, 8000 to 40000"
    );
    assert_eq!(
        wheels("output_stage = \"in-in-slow\""),
        "pair.toml:15: robot.motor.output_stage: has no safe state without an enable; wire the \
         drivers' enable to the robot's, so that low switches all bridges off, and set \
         `enable_wired = true`"
    );
    assert_eq!(
        wheels("output_stage = \"in-in-slow\", enable_wired = true, largest_duty = 0.95"),
        "pair.toml:15: robot.motor.largest_duty: is 0.95, but `in-in-slow` keeps a high side on; \
         leave it at 1, or take another driver"
    );
    assert_eq!(
        wheels("output_stage = \"c610\", largest_current = 10.5"),
        "pair.toml:15: robot.motor.largest_current: must be a current that these drives can \
         supply; give at most 10 A, and no more than the motors may"
    );
    assert_eq!(
        wheels("current_inputs = 4"),
        "pair.toml:15: robot.motor.current_inputs: is 4; give whole numbers, 1 to 3"
    );
    assert_eq!(
        wheels("current_scale = 100"),
        "pair.toml:15: robot.motor.current_scale: has nothing to be compared with; give \
         `motor.largest_current` as well: more than that is a fault"
    );
    // 3.3 V * 50 A/V is less than 1.25 * 4 * 40 A.
    assert_eq!(
        wheels("largest_current = 40, current_scale = 50"),
        "pair.toml:15: robot.motor.current_scale: with the other keys reaches 165 A; take a sensor \
         that reaches more than 200 A"
    );
    assert_eq!(
        wheels("largest_current = 0"),
        "pair.toml:15: robot.motor.largest_current: is 0; give a number greater than 0"
    );
}
