//! The drive as a moving picture: one inline SVG whose robots run along the path (SMIL), without a
//! script. Up is where the group faced at the start of the curve, left is left.

use std::fmt::Write as _;

use kinematics::Pose;

use super::{Outline, Report};
use crate::monitor::rows::TruthRow;

/// Pixels of the longer side of the path, and around it.
const SIDE: f64 = 620.0;
const MARGIN: f64 = 40.0;
/// Pictures of the animation; between them positions are interpolated.
const FRAMES: usize = 160;
/// Points of a drawn path.
const POINTS: usize = 600;
/// Share of the driven time that the picture takes, and the longest it takes, s.
const FASTER: f64 = 0.5;
const LONGEST: f64 = 20.0;

/// The places of a drive on the page.
struct Page {
    left: f64,
    top: f64,
    scale: f64,
    width: f64,
    height: f64,
}

impl Page {
    /// Everything that the robots reach.
    fn of(report: &Report, rows: &[&TruthRow]) -> Self {
        let reach = |robot: &Outline| {
            let mount = &robot.mount;
            let own = robot.half_track.hypot(robot.half_wheelbase);
            f64::from(mount.x.hypot(mount.y) + own)
        };
        let reach = report.robots.iter().map(reach).fold(0.3, f64::max);
        let poses = || rows.iter().flat_map(|row| [&row.theory, &row.group]);
        let ends = |of: fn(&Pose) -> f32| {
            let values = poses().map(|pose| f64::from(of(pose)));
            values.fold((f64::MAX, f64::MIN), |(low, high), v| {
                (low.min(v), high.max(v))
            })
        };
        let ((x0, x1), (y0, y1)) = (ends(|pose| pose.x), ends(|pose| pose.y));
        let (tall, wide) = (x1 - x0 + 2.0 * reach, y1 - y0 + 2.0 * reach);
        let scale = SIDE / tall.max(wide);
        Self {
            left: y1 + reach,
            top: x1 + reach,
            scale,
            width: wide * scale + 2.0 * MARGIN,
            height: tall * scale + 2.0 * MARGIN,
        }
    }

    fn at(&self, pose: &Pose) -> (f64, f64) {
        (
            MARGIN + (self.left - f64::from(pose.y)) * self.scale,
            MARGIN + (self.top - f64::from(pose.x)) * self.scale,
        )
    }

    fn path(&self, rows: &[&TruthRow], of: fn(&TruthRow) -> &Pose) -> String {
        let step = rows.len().div_ceil(POINTS).max(1);
        let mut out = String::new();
        for row in rows.iter().step_by(step) {
            let (x, y) = self.at(of(row));
            let _ = write!(out, "{x:.1},{y:.1} ");
        }
        out
    }
}

/// The last run of a report; empty where the group's motion was not observed.
#[must_use]
pub fn animation(report: &Report) -> String {
    let Some(run) = report.runs.last() else {
        return String::new();
    };
    let rows: Vec<&TruthRow> = run.truth.iter().collect();
    let ([first, .., last], true) = (&rows[..], rows.len() > FRAMES / 4) else {
        return String::new();
    };
    let page = Page::of(report, &rows);
    let seconds = ((last.t - first.t) * FASTER).clamp(4.0, LONGEST);
    let mut out = format!(
        "<figure class=\"map\"><svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {:.0} \
         {:.0}\" role=\"img\" aria-label=\"The group driving the curve\" \
         font-family=\"system-ui, sans-serif\">",
        page.width, page.height
    );
    let _ = write!(
        out,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"#2d343e\" stroke-opacity=\"0.22\" \
         stroke-width=\"8\"/><polyline points=\"{}\" fill=\"none\" stroke=\"#005fa0\" \
         stroke-width=\"2\"/>",
        page.path(&rows, |row| &row.theory),
        page.path(&rows, |row| &row.group),
    );
    let step = (rows.len() as f64 / FRAMES as f64).max(1.0);
    let frames: Vec<&TruthRow> = (0..=FRAMES)
        .map(|n| rows[((n as f64 * step) as usize).min(rows.len() - 1)])
        .collect();
    let animate = |kind: &str, values: String| {
        format!(
            "<animateTransform attributeName=\"transform\" type=\"{kind}\" dur=\"{seconds:.1}s\" \
             repeatCount=\"indefinite\" values=\"{values}\"/>"
        )
    };
    let moves = frames.iter().map(|row| {
        let (x, y) = page.at(&row.group);
        format!("{x:.1} {y:.1}")
    });
    let turns = frames
        .iter()
        .map(|row| format!("{:.1}", -f64::from(row.group.heading).to_degrees()));
    let join = |values: &mut dyn Iterator<Item = String>| values.collect::<Vec<_>>().join(";");
    let (x, y) = page.at(&first.group);
    let _ = write!(
        out,
        "<g transform=\"translate({x:.1} {y:.1})\">{}<g>{}",
        animate("translate", join(&mut { moves })),
        animate("rotate", join(&mut { turns })),
    );
    for robot in &report.robots {
        robot_svg(&mut out, robot, page.scale);
    }
    let _ = write!(
        out,
        "</g></g></svg><figcaption>{:.0} s of {} shown in {seconds:.0} s. \
         Grey: the curve; blue: where the group was.</figcaption></figure>",
        last.t - first.t,
        report.heading(run)
    );
    out
}

/// A robot where it stands in the group: body, wheels, front, number.
fn robot_svg(out: &mut String, robot: &Outline, scale: f64) {
    let (x, y) = (
        -f64::from(robot.mount.y) * scale,
        -f64::from(robot.mount.x) * scale,
    );
    let turn = -f64::from(robot.mount.heading).to_degrees();
    let (long, wide) = (
        f64::from(robot.half_wheelbase) * scale,
        f64::from(robot.half_track) * scale,
    );
    let _ = write!(
        out,
        "<g transform=\"translate({x:.1} {y:.1}) rotate({turn:.1})\"><rect x=\"{:.1}\" y=\"{:.1}\" \
         width=\"{:.1}\" height=\"{:.1}\" rx=\"3\" fill=\"#dfe8f1\" stroke=\"#005fa0\"/>",
        -wide,
        -long,
        2.0 * wide,
        2.0 * long
    );
    let wheel = (0.4 * long, 0.14 * long);
    for (side, end) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let _ = write!(
            out,
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"#2d343e\"/>",
            side * wide - wheel.1,
            end * long - wheel.0,
            2.0 * wheel.1,
            2.0 * wheel.0
        );
    }
    let _ = write!(
        out,
        "<path d=\"M{:.1} {:.1}L0 {:.1}L{:.1} {:.1}\" fill=\"none\" stroke=\"#005fa0\" \
         stroke-width=\"2\"/><text text-anchor=\"middle\" y=\"{:.1}\" font-size=\"{:.0}\">{}</text></g>",
        -0.3 * wide,
        -0.5 * long,
        -0.85 * long,
        0.3 * wide,
        -0.5 * long,
        0.35 * long,
        (0.8 * long).clamp(8.0, 18.0),
        robot.node
    );
}
