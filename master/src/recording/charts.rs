//! The charts of a recording.

use chart::{Chart, Outline, PALETTE, Placed, RGBColor, Series, Sheet, Stroke};
use kinematics::{Pose, Twist};

use super::Recording;
use crate::monitor::telemetry::{MemberSample, Snapshot};

/// Size of a chart over time, in pixels.
const WIDE: (u32, u32) = (1040, 260);
/// Size of the map.
const MAP: (u32, u32) = (1040, 640);
const GREY: RGBColor = PALETTE[5];

type Points = Vec<(f64, f64)>;

fn series(label: &str, color: RGBColor, points: Points) -> Series {
    Series {
        label: label.into(),
        color: Some(color),
        stroke: Stroke::Line,
        points,
    }
}

/// One number of every row in which it is known.
fn over_time(rows: &[Snapshot], value: impl Fn(&Snapshot) -> Option<f32>) -> Points {
    let point = |row: &Snapshot| Some((row.t, f64::from(value(row)?)));
    rows.iter().filter_map(point).collect()
}

fn chart(title: &str, y_label: &str, series: Vec<Series>) -> Chart {
    Chart {
        title: title.into(),
        x_label: "time / s".into(),
        y_label: y_label.into(),
        size: WIDE,
        equal_axes: false,
        series: series
            .into_iter()
            .filter(|s| !s.points.is_empty())
            .collect(),
        outlines: vec![],
    }
}

/// A place on the map: forward is up, left is left.
fn on_map(pose: Pose) -> (f64, f64) {
    (-f64::from(pose.y), f64::from(pose.x))
}

/// Corners of a robot's wheel rectangle with the group at `group`.
fn corners(robot: &group::Robot, group: Pose) -> Points {
    let (l, w) = (robot.geometry.half_wheelbase(), robot.geometry.half_track());
    [(l, w), (l, -w), (-l, -w), (-l, w)]
        .map(|(x, y)| on_map(group.compose(robot.mount).compose(Pose::new(x, y, 0.0))))
        .to_vec()
}

/// Where the group was, seen by its own wheels, by an observer and by the curve, all in the frame
/// in which the group stood at the beginning of the recording.
#[must_use]
pub fn map(recording: &Recording, rows: &[Snapshot]) -> Chart {
    let all = |poses: &[(f64, Pose)]| {
        poses
            .iter()
            .map(|(_, pose)| on_map(*pose))
            .collect::<Points>()
    };
    let path: Vec<Pose> = rows.iter().filter_map(|row| row.pose).collect();
    // The curve and the observer may have another origin than the wheels: both begin where the
    // group stood at that moment.
    let begin = recording.plan.first().or(recording.truth.first());
    let wheels_then = begin.and_then(|(t, _)| {
        let row = rows.iter().filter(|row| row.t <= *t);
        row.filter_map(|row| row.pose).next_back()
    });
    let place = |pose: Pose| match (begin, wheels_then) {
        (Some((_, origin)), Some(then)) => origin.compose(relative_to(then, pose)),
        _ => pose,
    };
    let place = &place;
    let mut lines = Vec::new();
    if !recording.plan.is_empty() {
        lines.push(Series {
            label: "curve".into(),
            color: None,
            stroke: Stroke::Band,
            points: all(&recording.plan),
        });
    }
    let wheels = path.iter().map(|pose| on_map(place(*pose))).collect();
    lines.push(series("group, by its wheels", PALETTE[0], wheels));
    if !recording.truth.is_empty() {
        lines.push(series(
            "group, seen from outside",
            PALETTE[1],
            all(&recording.truth),
        ));
    }
    let group = recording.group().ok().flatten();
    let robots = group.iter().flat_map(|group| &group.robots);
    let places = [path.first(), path.last()].into_iter().flatten();
    let outlines = places.flat_map(|pose| {
        robots.clone().map(move |robot| Outline {
            color: GREY,
            label: robot.node.to_string(),
            corners: corners(robot, place(*pose)),
        })
    });
    Chart {
        title: "path of the group; robots where it began and ended".into(),
        x_label: "to the right / m".into(),
        y_label: "forward / m".into(),
        size: MAP,
        equal_axes: true,
        outlines: outlines.collect(),
        series: lines,
    }
}

/// `pose` in the frame that `frame` is.
fn relative_to(frame: Pose, pose: Pose) -> Pose {
    let (sin, cos) = frame.heading.sin_cos();
    let (dx, dy) = (pose.x - frame.x, pose.y - frame.y);
    Pose::new(
        cos * dx + sin * dy,
        cos * dy - sin * dx,
        pose.heading - frame.heading,
    )
}

/// Setpoint and measured velocity, forward and left, and yaw rate.
#[must_use]
pub fn velocities(rows: &[Snapshot]) -> Vec<Chart> {
    type Axis = fn(Twist) -> f32;
    let axes: [(&str, &str, Axis); 3] = [
        ("forward velocity", "vx / (m/s)", |twist| twist.vx),
        ("velocity to the left", "vy / (m/s)", |twist| twist.vy),
        ("yaw rate", "omega / (rad/s)", |twist| twist.omega),
    ];
    let one = |(title, unit, axis): (&str, &str, Axis)| {
        let mut asked = series(
            "setpoint",
            GREY,
            over_time(rows, |row| Some(axis(row.command))),
        );
        (asked.color, asked.stroke) = (None, Stroke::Band);
        let measured = over_time(rows, |row| row.measured.map(axis));
        chart(
            title,
            unit,
            vec![asked, series("measured", PALETTE[0], measured)],
        )
    };
    axes.map(one).into()
}

/// One number of every robot.
fn of_robots(
    rows: &[Snapshot],
    title: &str,
    unit: &str,
    value: impl Fn(&MemberSample) -> Option<f32>,
) -> Chart {
    let nodes = nodes(rows);
    let lines = nodes.iter().enumerate().map(|(n, node)| {
        let points = over_time(rows, |row| {
            value(row.members.iter().find(|m| m.node == *node)?)
        });
        series(&format!("node {node}"), PALETTE[n % PALETTE.len()], points)
    });
    chart(title, unit, lines.collect())
}

/// The robots that were heard.
#[must_use]
pub fn nodes(rows: &[Snapshot]) -> Vec<u8> {
    let last = rows.last().map(|row| row.members.iter().map(|m| m.node));
    last.map_or_else(Vec::new, Iterator::collect)
}

/// Permitted scale, slip, strain and bus load.
#[must_use]
pub fn health(rows: &[Snapshot]) -> Vec<Chart> {
    let strain = over_time(rows, |row| row.strain.map(|strain| strain * 1000.0));
    let load = over_time(rows, |row| row.bus_load.map(|load| load * 100.0));
    vec![
        of_robots(rows, "scale that each robot permits", "scale", |m| {
            m.permitted_scale
        }),
        of_robots(
            rows,
            "wheel rates that no rigid motion explains",
            "slip / (rad/s)",
            |m| m.slip_residual,
        ),
        chart(
            "largest disagreement of two robots about the group's velocity",
            "strain / (mm/s)",
            vec![series("strain", PALETTE[0], strain)],
        ),
        chart(
            "bus load over 100 ms",
            "load / %",
            vec![series("load", PALETTE[0], load)],
        ),
    ]
}

/// The four wheel rates of one robot.
#[must_use]
pub fn wheel_rates(rows: &[Snapshot], node: u8) -> Chart {
    let names = ["front left", "front right", "rear left", "rear right"];
    let wheels = names.iter().enumerate().map(|(wheel, name)| {
        let points = over_time(rows, |row| {
            let member = row.members.iter().find(|m| m.node == node)?;
            let rates: [f32; 4] = member.wheel_rates?.into();
            rates.get(wheel).copied()
        });
        series(name, PALETTE[wheel], points)
    });
    chart(
        &format!("wheel rates of node {node}"),
        "rate / (rad/s)",
        wheels.collect(),
    )
}

/// Everything on one sheet: the map, then the charts over time below each other.
#[must_use]
pub fn sheet(recording: &Recording) -> Sheet {
    let (rows, _) = recording.decode();
    let mut charts = vec![map(recording, &rows)];
    charts.extend(velocities(&rows));
    charts.extend(health(&rows));
    charts.extend(nodes(&rows).iter().map(|node| wheel_rates(&rows, *node)));
    let (left, mut below) = (0, 0);
    let placed = charts.into_iter().map(|chart| {
        let top = below;
        below += chart.size.1;
        Placed { left, top, chart }
    });
    Sheet {
        charts: placed.collect(),
    }
}
