//! The figures of a report as JSON, for scripts and tests. The names are fixed; the paper's own
//! (`x_percent` lateral, `y_percent` longitudinal) are only in a report in its axes.

use serde::Serialize;

use super::{Report, Scalar};

#[derive(Serialize)]
struct Run {
    compensation: &'static str,
    ahead_percent: f64,
    aside_percent: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    x_percent: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    y_percent: Option<f64>,
    rms_mm: f64,
    ripple_percent: f64,
    heading_error_deg: f64,
    turn_percent: f64,
    lag_ms: f64,
    shape_error_mm: f64,
}

#[derive(Serialize)]
struct Document<'a> {
    backend: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    scalar: Option<&'static str>,
    config: &'a str,
    trajectory: &'a str,
    robots: usize,
    realtime_factor: f64,
    bus_load_percent: Option<f64>,
    runs: Vec<Run>,
}

/// Rounds to four decimals: more would suggest an accuracy that was not measured.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

/// The report's figures as an indented JSON document with a final newline.
#[must_use]
pub fn to_json(report: &Report) -> String {
    let document = Document {
        backend: report.backend.word(),
        scalar: report.scalar.map(Scalar::word),
        config: &report.config,
        trajectory: &report.trajectory,
        robots: report.robots.len(),
        realtime_factor: rounded(report.realtime_factor()),
        bus_load_percent: report.bus_load_percent().map(rounded),
        runs: report
            .runs
            .iter()
            .map(|run| Run {
                compensation: run.compensation_word(),
                ahead_percent: rounded(run.errors.y_percent),
                aside_percent: rounded(run.errors.x_percent),
                x_percent: report.paper.then(|| rounded(run.errors.x_percent)),
                y_percent: report.paper.then(|| rounded(run.errors.y_percent)),
                rms_mm: rounded(run.errors.rms_mm),
                ripple_percent: rounded(run.evenness.ripple_percent),
                heading_error_deg: rounded(run.evenness.heading_error_deg),
                turn_percent: rounded(run.evenness.turn_percent),
                lag_ms: rounded(run.evenness.lag_ms),
                shape_error_mm: rounded(run.shape_error_mm),
            })
            .collect(),
    };
    // Serialising plain numbers and strings into memory has no way to fail.
    serde_json::to_string_pretty(&document).unwrap_or_default() + "\n"
}
