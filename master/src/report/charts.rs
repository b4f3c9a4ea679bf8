//! The charts of a report, from the rows of its runs.
//!
//! The map, the displacements and the velocities go ahead and to the right, said in words, so that
//! they are right in any axes and can be laid beside the paper's figures 12 and 18. Wheel
//! rates keep the sign of this project: positive rolls the base forward.

use chart::{Chart, PALETTE, RGBColor, Series, Stroke};
use kinematics::Pose;

use super::{Outline, Report, Run};
use crate::monitor::metrics::to_paper;
use crate::monitor::rows::TruthRow;

/// Half of the window over which a velocity is the slope of the path, in sampling periods.
const SLOPE_ROWS: usize = 5;

/// Size of a chart across the page, in pixels.
const WIDE: (u32, u32) = (1040, 300);
/// Size of one of two charts side by side.
const HALF: (u32, u32) = (515, 300);

/// The colour of a run: what is uncompensated is orange everywhere, what is compensated blue; with
/// roller phase purple and green.
fn color(run: &Run) -> RGBColor {
    PALETTE[match (run.phase, run.compensation) {
        (false, true) => 0,
        (false, false) => 1,
        (true, true) => 2,
        (true, false) => 3,
    }]
}

/// A line through one number of every truth row.
fn line(
    run: &Run,
    label: String,
    color: Option<RGBColor>,
    value: impl Fn(&TruthRow) -> f64,
) -> Series {
    Series {
        label,
        color,
        stroke: Stroke::Line,
        points: run.truth.iter().map(|row| (row.t, value(row))).collect(),
    }
}

/// The theory of the first run, as a band to be drawn under everything else.
fn theory(report: &Report, points: impl Fn(&TruthRow) -> (f64, f64)) -> Option<Series> {
    Some(Series {
        label: "theory".into(),
        color: None,
        stroke: Stroke::Band,
        points: report.runs.first()?.truth.iter().map(points).collect(),
    })
}

fn chart(title: &str, y_label: &str, size: (u32, u32), series: Vec<Series>) -> Chart {
    Chart {
        title: title.into(),
        x_label: "time / s".into(),
        y_label: y_label.into(),
        size,
        equal_axes: false,
        series,
        outlines: vec![],
    }
}

/// Corners of a robot's wheel rectangle with the group at `group`, in the paper's axes.
fn corners(robot: &Outline, group: &Pose) -> Vec<(f64, f64)> {
    let place = |pose: &Pose, x: f64, y: f64| {
        let (sin, cos) = f64::from(pose.heading).sin_cos();
        (
            f64::from(pose.x) + cos * x - sin * y,
            f64::from(pose.y) + sin * x + cos * y,
        )
    };
    let (l, w) = (f64::from(robot.half_wheelbase), f64::from(robot.half_track));
    [(l, w), (l, -w), (-l, -w), (-l, w)]
        .map(|(x, y)| {
            let (x, y) = place(&robot.mount, x, y);
            let (x, y) = place(group, x, y);
            (-y, x)
        })
        .to_vec()
}

/// The load: a line through the middles of the robots.
fn load(report: &Report, group: &Pose) -> Series {
    let middle = |robot: &Outline| {
        let point = Outline {
            half_track: 0.0,
            half_wheelbase: 0.0,
            ..*robot
        };
        corners(&point, group)[0]
    };
    Series {
        label: "load".into(),
        color: Some(PALETTE[5]),
        stroke: Stroke::Band,
        points: report.robots.iter().map(middle).collect(),
    }
}

/// The map: theory and the driven paths, the robots drawn where the first run began.
#[must_use]
pub fn map(report: &Report) -> Chart {
    let start = report.runs.first().and_then(|run| run.truth.first());
    let mut series: Vec<_> = start
        .map(|start| load(report, &start.group))
        .into_iter()
        .collect();
    series.extend(theory(report, |row| to_paper(&row.theory).into()));
    series.extend(report.runs.iter().map(|run| {
        Series {
            label: report.heading(run),
            color: Some(color(run)),
            stroke: Stroke::Line,
            points: run
                .truth
                .iter()
                .map(|row| to_paper(&row.group).into())
                .collect(),
        }
    }));
    let outlines = start.map_or_else(Vec::new, |start| {
        let robots = report.robots.iter();
        robots
            .map(|robot| chart::Outline {
                color: PALETTE[5],
                label: robot.node.to_string(),
                corners: corners(robot, &start.group),
            })
            .collect()
    });
    Chart {
        title: format!("{} ({})", report.title(), report.config),
        x_label: "to the right / m".into(),
        y_label: "ahead / m".into(),
        size: (760, 820),
        equal_axes: true,
        series,
        outlines,
    }
}

/// One of the paper's axes, by its index in [`to_paper`].
struct Axis {
    index: usize,
    name: &'static str,
}

const AXES: [Axis; 2] = [
    Axis {
        index: 0,
        name: "to the right",
    },
    Axis {
        index: 1,
        name: "ahead",
    },
];

/// Displacement over time, lateral and longitudinal.
#[must_use]
pub fn displacements(report: &Report) -> Vec<Chart> {
    let of_axis = |axis: &Axis| {
        let at = |pose: &Pose| to_paper(pose)[axis.index];
        let lines = report.runs.iter().map(|run| {
            line(run, report.heading(run), Some(color(run)), |row| {
                at(&row.group)
            })
        });
        let wanted = theory(report, |row| (row.t, at(&row.theory)));
        let series = wanted.into_iter().chain(lines);
        let title = format!("way {}", axis.name);
        let unit = "way / m";
        chart(&title, unit, HALF, series.collect())
    };
    AXES.iter().map(of_axis).collect()
}

/// Velocity of the group over time, lateral and longitudinal: the slope of the observed path over
/// 2 x [`SLOPE_ROWS`] sampling periods.
#[must_use]
pub fn velocities(report: &Report) -> Vec<Chart> {
    let of_axis = |axis: &Axis| {
        let at = |pose: &Pose| to_paper(pose)[axis.index];
        let lines = report.runs.iter().map(|run| {
            let slope = |rows: &[TruthRow]| {
                let [first, .., last] = rows else {
                    return None;
                };
                let middle = &rows[rows.len() / 2];
                let dt = last.t - first.t;
                (dt > 0.0).then(|| (middle.t, (at(&last.group) - at(&first.group)) / dt))
            };
            Series {
                label: report.heading(run),
                color: Some(color(run)),
                stroke: Stroke::Line,
                points: run
                    .truth
                    .windows(2 * SLOPE_ROWS + 1)
                    .filter_map(slope)
                    .collect(),
            }
        });
        let wanted = theory(report, |row| {
            let [x, y] = [
                -f64::from(row.theory_twist.vy),
                f64::from(row.theory_twist.vx),
            ];
            (row.t, [x, y][axis.index])
        });
        let title = format!("velocity {}", axis.name);
        let unit = "velocity / (m/s)";
        chart(
            &title,
            unit,
            HALF,
            wanted.into_iter().chain(lines).collect(),
        )
    };
    AXES.iter().map(of_axis).collect()
}

/// Distance between theory and group at the same instant.
#[must_use]
pub fn tracking(report: &Report) -> Chart {
    let distance = |row: &TruthRow| {
        let ([x, y], [x0, y0]) = (to_paper(&row.group), to_paper(&row.theory));
        (x - x0).hypot(y - y0) * 1000.0
    };
    let lines = report.runs.iter();
    let lines = lines.map(|run| line(run, report.heading(run), Some(color(run)), distance));
    chart(
        "distance from where the curve is at that instant",
        "distance / mm",
        WIDE,
        lines.collect(),
    )
}

/// Heading of the group less the curve's.
#[must_use]
pub fn heading(report: &Report) -> Chart {
    let off = |row: &TruthRow| {
        (f64::from(row.group.heading) - f64::from(row.theory.heading)).to_degrees()
    };
    let lines = report.runs.iter();
    let lines = lines.map(|run| line(run, report.heading(run), Some(color(run)), off));
    chart("heading error", "angle / deg", WIDE, lines.collect())
}

/// Largest distance of a robot from its place in the group.
#[must_use]
pub fn shape(report: &Report) -> Chart {
    let lines = report.runs.iter();
    let lines = lines.map(|run| {
        line(run, report.heading(run), Some(color(run)), |r| {
            r.shape_error_mm
        })
    });
    chart("shape error", "distance / mm", WIDE, lines.collect())
}

/// Wheel rates of one robot in one run, from the observer.
#[must_use]
pub fn wheel_rates(report: &Report, run: &Run, robot: usize) -> Chart {
    let names = ["front left", "front right", "rear left", "rear right"];
    let wheels = names.iter().enumerate().map(|(wheel, name)| Series {
        label: (*name).into(),
        color: Some(PALETTE[wheel]),
        stroke: Stroke::Line,
        points: run
            .truth
            .iter()
            .filter_map(|row| {
                let rates: [f32; 4] = row.robots.get(robot)?.wheel_rates.into();
                Some((row.t, f64::from(rates[wheel])))
            })
            .collect(),
    });
    let node = report.robots.get(robot).map_or(0, |outline| outline.node);
    chart(
        &format!("node {node}, {}", report.heading(run)),
        "rate / (rad/s)",
        HALF,
        wheels.collect(),
    )
}
