//! A calibration as a picture: coefficients over speed with their 95 % intervals.

use chart::{Chart, PALETTE, Placed, RGBColor, Series, Sheet, Stroke};

use super::Calibration;
use super::fit::Row;
use super::manoeuvre::Way;
use super::measure::Observation;

/// Half the width of a tick that stands for one motion, m/s or rad/s.
const TICK: f64 = 0.008;
/// Size of one chart, in pixels.
const SIZE: (u32, u32) = (640, 400);

/// The charts of a calibration: of what moves straight, and of what turns, below each other for
/// every subject.
#[must_use]
pub fn sheet(calibration: &Calibration) -> Sheet {
    let mut sheet = Sheet::default();
    let mut top = 0;
    for outcome in &calibration.outcomes {
        let found = &outcome.found;
        let column = |n: usize| -> Vec<Row> { found.oblique.iter().map(|row| row[n]).collect() };
        let straight = [
            ("ahead", found.ahead.clone()),
            ("sideways", found.aside.clone()),
            ("oblique, longitudinal", column(0)),
            ("oblique, lateral", column(1)),
        ];
        let turning = [("turning", found.yaw.clone())];
        let nodes = crate::report::nodes(&outcome.nodes);
        let title = format!("{nodes}: commanded over achieved");
        let straight = chart(&title, "speed / m/s", &straight);
        let turning = chart("turning", "rate / rad/s", &turning);
        for (left, chart) in [(0, straight), (SIZE.0, turning)] {
            sheet.charts.push(Placed { left, top, chart });
        }
        top += SIZE.1;
    }
    sheet
}

/// One motion of one subject, as the picture of a running calibration has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    way: Way,
    /// m/s or rad/s.
    speed: f64,
    /// Way by the wheels over way measured.
    ratio: f64,
}

/// What a step's observations show; nothing for steps that are not about slip.
#[must_use]
pub fn seen(observed: &serde_json::Value) -> Vec<Measured> {
    let each: Vec<Option<Observation>> =
        serde_json::from_value(observed.clone()).unwrap_or_default();
    let each = each.into_iter().flatten().map(|o| {
        let along = |way: [f64; 3]| match o.way {
            Way::Turn => way[2],
            _ => way[0].hypot(way[1]),
        };
        Measured {
            way: o.way,
            speed: o.speed,
            ratio: (along(o.believed) / along(o.measured)).abs(),
        }
    });
    each.filter(|seen| seen.ratio.is_finite()).collect()
}

/// The picture of a calibration that still runs: every motion a point.
#[must_use]
pub fn so_far(seen: &[Measured]) -> Sheet {
    let points = |ways: &[(&'static str, Way)]| -> Vec<Series> {
        let mut series = Vec::new();
        for ((label, way), color) in ways.iter().zip(PALETTE) {
            let mut label = *label;
            for seen in seen.iter().filter(|seen| seen.way == *way) {
                let (from, to) = (seen.speed - TICK, seen.speed + TICK);
                series.push(Series {
                    label: std::mem::take(&mut label).into(),
                    color: Some(color),
                    stroke: Stroke::Line,
                    points: vec![(from, seen.ratio), (to, seen.ratio)],
                });
            }
        }
        series
    };
    let straight = [
        ("ahead", Way::Ahead),
        ("sideways", Way::Aside),
        ("oblique", Way::Oblique),
    ];
    let mut sheet = Sheet::default();
    for (left, title, x_label, series) in [
        (
            0,
            "motions so far: by the wheels over measured",
            "speed / m/s",
            points(&straight),
        ),
        (
            SIZE.0,
            "turning",
            "rate / rad/s",
            points(&[("turning", Way::Turn)]),
        ),
    ] {
        if !series.is_empty() {
            let chart = framed(title, x_label, series);
            sheet.charts.push(Placed {
                left,
                top: 0,
                chart,
            });
        }
    }
    sheet
}

fn framed(title: &str, x_label: &str, series: Vec<Series>) -> Chart {
    Chart {
        title: title.into(),
        x_label: x_label.into(),
        y_label: "coefficient".into(),
        size: SIZE,
        equal_axes: false,
        series,
        outlines: vec![],
    }
}

fn chart(title: &str, x_label: &str, lines: &[(&str, Vec<Row>)]) -> Chart {
    let mut series = Vec::new();
    for ((label, rows), color) in lines.iter().zip(PALETTE) {
        let line = |label: &str, points: Vec<(f64, f64)>, color: RGBColor| Series {
            label: label.into(),
            color: Some(color),
            stroke: Stroke::Line,
            points,
        };
        let points = rows.iter().map(|row| (row.speed, row.fit.coefficient));
        series.push(line(label, points.collect(), color));
        for Row { speed, fit } in rows {
            let bar = [(*speed, fit.interval.0), (*speed, fit.interval.1)];
            series.push(line("", bar.to_vec(), color));
        }
    }
    framed(title, x_label, series)
}
