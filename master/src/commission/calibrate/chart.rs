//! A calibration as a picture: coefficients over speed with their 95 % intervals.

use chart::{Chart, PALETTE, RGBColor, Series, Sheet, Stroke};

use super::Calibration;
use super::fit::Row;

/// Size of one chart, in pixels.
const SIZE: (u32, u32) = (640, 400);

/// The charts of a calibration: of what moves straight, and of what turns, below each other for
/// every subject.
#[must_use]
pub fn sheet(calibration: &Calibration) -> Sheet {
    let mut sheet = Sheet::default();
    let mut top = 0;
    for outcome in &calibration.outcomes {
        let nodes: Vec<_> = outcome.nodes.iter().map(u8::to_string).collect();
        let nodes = nodes.join(", ");
        let found = &outcome.found;
        let column = |n: usize| -> Vec<Row> { found.oblique.iter().map(|row| row[n]).collect() };
        let straight = [
            ("ahead", found.ahead.clone()),
            ("sideways", found.aside.clone()),
            ("oblique, longitudinal", column(0)),
            ("oblique, lateral", column(1)),
        ];
        let turning = [("turning", found.yaw.clone())];
        let title = format!("nodes {nodes}: commanded over achieved");
        let left = chart(&title, "speed / m/s", &straight);
        let right = chart("turning", "rate / rad/s", &turning);
        sheet.charts.push(((0, top), left));
        sheet.charts.push(((SIZE.0, top), right));
        top += SIZE.1;
    }
    sheet
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
    // A point at no speed, high up: the legend shall not cover a line.
    let all = || lines.iter().flat_map(|(_, rows)| rows);
    let ends =
        |f: fn(f64, f64) -> f64, from: f64| all().map(|row| row.fit.coefficient).fold(from, f);
    let (low, high) = (ends(f64::min, f64::INFINITY), ends(f64::max, 0.0));
    series.push(Series {
        label: String::new(),
        color: Some(PALETTE[0]),
        stroke: Stroke::Line,
        points: vec![(0.0, high + 0.5 * (high - low).max(0.002))],
    });
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
