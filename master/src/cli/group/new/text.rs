//! The group file itself, as text with comments.

use std::fmt::Write as _;

use group::FIRST_NODE;

use super::Arguments;
use super::motor::{FASTEST, Limits, Motor, Robot, short};

/// The file itself.
pub(super) fn file(
    arguments: &Arguments,
    name: &str,
    robot: &Robot,
    motor: &Motor,
    places: &[[f64; 3]],
) -> anyhow::Result<String> {
    let limits = Limits::of(robot, arguments.roller_angle, places)?;
    let quoted = toml_edit::Value::from(name).to_string();
    let mut out = format!(
        "# Every key is explained in docs/group-files.md; `omnibus group check` checks this file.\n\
         name = {}\ngroup_id = {}\nsync_period_ms = 10\n\n\
         # What the wheels can follow: in every direction, with a fifth in reserve.\n\
         [limits]\n\
         linear_speed = {} # m/s\n\
         yaw_rate = {} # rad/s\n\
         linear_acceleration = {} # m/s2: what motors and a clean floor give\n\
         yaw_acceleration = {} # rad/s2\n\n",
        quoted.trim(),
        arguments.group_id,
        limits.speed,
        limits.yaw_rate,
        limits.acceleration,
        limits.yaw_acceleration,
    );
    let _ = write!(
        out,
        "# Values of every robot, unless its own entry has others.\n\
         [robot]\n\
         half_track = {} # m\n\
         half_wheelbase = {} # m\n\
         wheel_radius = {} # m\n\
         roller_angle_deg = {}\n\
         max_wheel_rate = {} # rad/s: {}\n\n\
         [robot.encoder]\n\
         counts_per_revolution = {}\n\
         gear_ratio = {}\n\n",
        short(robot.track / 2.0),
        short(robot.wheelbase / 2.0),
        short(robot.diameter / 2.0),
        arguments.roller_angle,
        limits.wheel_rate,
        match limits.wheel_rate < FASTEST {
            true => "80 % of the no-load speed",
            false => "the fastest that a robot can be told of",
        },
        robot.counts,
        robot.gear_ratio,
    );
    let _ = write!(
        out,
        "# As seen from the wheel, from the gear motor's data: {} V, {} rad/s and {} A without load,\n\
         # {} N m and {} A at stall. The gear passes on {:.0} % of the torque.\n\
         [robot.motor]\n\
         supply = {} # V\n\
         constant = {} # V s/rad, and N m/A\n\
         resistance = {} # ohm\n\
         inertia = {} # kg m2: a quarter of {} kg at the rim, over the gear's losses\n\
         friction = {} # N m\n\
         largest_current = {} # A: at stall; lower it to what your bridges stand\n\
         # For motor drivers that do not take PWM and direction: docs/bring-up.md, Motor drivers.\n\
         # output_stage = \"in-in-slow\"\n\
         # enable_wired = true\n\n",
        short(robot.supply),
        short(robot.no_load_rate),
        short(robot.no_load_current),
        short(robot.stall_torque),
        short(robot.stall_current),
        100.0 * motor.efficiency,
        short(robot.supply),
        short(motor.constant),
        short(motor.resistance),
        short(motor.inertia),
        short(robot.mass),
        short(motor.friction),
        short(robot.stall_current),
    );
    // In proportion to the motor's constant, as in the files of `groups/`.
    out.push_str("# Gains of the wheel-rate loops, as duty; `identify-motors` finds better ones.\n[robot.control]\n");
    let _ = writeln!(
        out,
        "proportional = {}",
        short(1.2 * motor.constant / robot.supply)
    );
    let _ = writeln!(
        out,
        "integral = {}",
        short(12.0 * motor.constant / robot.supply)
    );
    out.push_str("\n# Members: x ahead, y left, heading counter-clockwise.\n");
    for (node, [x, y, heading]) in (FIRST_NODE..).zip(places) {
        let _ = write!(out, "[[robots]]\nnode = {node}\nx = {x}\ny = {y}\n");
        if *heading != 0.0 {
            let _ = writeln!(out, "heading_deg = {heading}");
        }
        out.push('\n');
    }
    Ok(aligned(out.trim_end()))
}

/// The same text with the comments behind values in one column.
pub(super) fn aligned(text: &str) -> String {
    let mut out = String::new();
    for line in text.lines() {
        match line.split_once(" #") {
            Some((value, comment)) if !line.starts_with('#') => {
                let _ = writeln!(out, "{:<COMMENTS$}#{comment}", value.trim_end());
            }
            _ => {
                let _ = writeln!(out, "{line}");
            }
        }
    }
    out
}

/// Column of the comments behind values.
pub(super) const COMMENTS: usize = 28;
