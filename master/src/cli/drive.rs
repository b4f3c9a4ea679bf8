//! `omnibus drive --vx --vy --omega --for`: one velocity of the group for a time, with ramps that
//! the robots make by their own limits.

use kinematics::{Pose, Twist};
use omnibus::Group;
use omnibus::bus::link::Link;
use omnibus::monitor::average::counted_on;
use omnibus::monitor::odometry::relative_to;
use omnibus::monitor::rows::{Recorder, Row};
use omnibus::path::course::LONGEST;
use serde_json::json;

use super::output::Progress;
use super::recorder::{self, RecordTo};
use super::{Target, json, print_json, print_line, print_note};

/// Rows that are kept; a drive of an hour has 360 000.
const ROWS: usize = 1_000;

const EXAMPLES: &str = "Examples:
  omnibus drive --vx 0.2 --for 3 --bus sim:groups/tcc-2.toml
  omnibus drive --omega -0.3 --for 5 --bus socketcan:can0 --group groups/tcc-2.toml

Ctrl-C ramps the group down; pressed again, it takes the robots out of OPERATIONAL at once.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    #[command(flatten)]
    target: Target,
    /// Forward velocity of the group, m/s.
    #[arg(
        long,
        default_value_t = 0.0,
        allow_negative_numbers = true,
        value_parser = super::real::<f32>
    )]
    vx: f32,
    /// Velocity to the left, m/s.
    #[arg(
        long,
        default_value_t = 0.0,
        allow_negative_numbers = true,
        value_parser = super::real::<f32>
    )]
    vy: f32,
    /// Yaw rate, counter-clockwise, rad/s.
    #[arg(
        long,
        default_value_t = 0.0,
        allow_negative_numbers = true,
        value_parser = super::real::<f32>
    )]
    omega: f32,
    /// Duration, s.
    #[arg(
        long = "for",
        value_name = "SECONDS",
        allow_negative_numbers = true,
        value_parser = super::real::<f64>
    )]
    seconds: f64,
    #[command(flatten)]
    record: RecordTo,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let file = arguments.target.group()?;
    let twist = Twist::new(arguments.vx, arguments.vy, arguments.omega);
    // Refused before the bus is even opened.
    omnibus::session::check_twist(twist, &file.limits)?;
    if !(arguments.seconds > 0.0 && arguments.seconds <= LONGEST) {
        usage!(
            "--for: {} s; give more than 0 and at most {LONGEST} s",
            arguments.seconds
        );
    }
    arguments.record.check(&arguments.target)?;
    let abort = super::abort_on_ctrl_c()?;
    let link = arguments.target.command(&file)?;
    abort.check()?;
    let recorder = arguments
        .record
        .begin(&arguments.target, "drive", link.now())?;
    let mut group = Group::observe(link, &file);
    group.set_abort(abort);
    group.keep_last(ROWS);
    if let Some(recorder) = &recorder {
        group.wire().tap(recorder.sink());
    }
    let driven = drive(arguments, &mut group, twist);
    // What was heard is kept however it ended, and the result is printed whatever became of it.
    let recorded = recorder::finish(recorder);
    let punctuality = group.punctuality();
    if let Some(punctuality) = punctuality {
        print_note(punctuality);
    }
    driven?;
    let rows = group.recorder().rows();
    let slowed = group.recorder().outline().slowest;
    let moved = moved(group.recorder());
    if let Some(moved) = moved {
        print_line(format_args!(
            "moved {:.3} m ahead, {:.3} m to the left, turned {:.2} degrees (by the wheels)",
            moved.x,
            moved.y,
            moved.heading.to_degrees()
        ))?;
    }
    super::print_slowdown(slowed, &file);
    let mut robots = Vec::new();
    for (index, robot) in file.robots.iter().enumerate() {
        let last = rows.iter().rev().find_map(|row| row.members[index].pose);
        if let Some(pose) = last {
            robots.push(
                json!({"node": robot.node, "x": pose.x, "y": pose.y, "heading": pose.heading}),
            );
        }
    }
    if json() {
        print_json(&json!({
            "robots": robots,
            "moved": moved.map(|p| json!({"x": p.x, "y": p.y, "heading": p.heading})),
            "smallest_scale": slowed.map_or(1.0, |slowed| slowed.scale),
            "sync": punctuality.map(|p| super::sync_json(&p)),
        }))?;
    }
    recorded
}

/// How far the group has come since the first row, in the frame it had then.
fn moved(recorder: &Recorder) -> Option<Pose> {
    let first = recorder.outline().first?;
    let last = recorder.rows().iter().rev().find_map(Row::pose)?;
    let turned = counted_on(
        0.0,
        Pose {
            heading: last.heading - first.heading,
            ..last
        },
    )
    .heading;
    let way = relative_to(first, last);
    Some(Pose {
        heading: turned,
        ..way
    })
}

/// From finding the robots to their standing again.
fn drive<L: Link>(arguments: &Arguments, group: &mut Group<L>, twist: Twist) -> anyhow::Result<()> {
    group.claim()?;
    group.start()?;
    group.set_twist(twist)?;
    let progress = Progress::new("drive");
    let driven = group.run_with(arguments.seconds, &mut |share| progress.share(share, ""));
    drop(progress);
    let stopped = group.stop();
    Ok(driven.and(stopped)?)
}
