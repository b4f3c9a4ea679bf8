//! The figures of a report as a table for the terminal, the paper's values beside the measured.

use comfy_table::{CellAlignment, ContentArrangement, Table, presets};

use super::{Report, paper_table_6};

/// A signed percentage with two decimals, as the paper prints them.
#[must_use]
pub fn percent(value: f64) -> String {
    format!("{value:+.2} %")
}

/// A bus load with one decimal.
#[must_use]
pub fn load(value: Option<f64>) -> String {
    value.map_or_else(|| "not measured".into(), |value| format!("{value:.1} %"))
}

/// The report as a table, without a final newline. Axes as in the paper.
#[must_use]
pub fn to_table(report: &Report) -> String {
    let mut table = Table::new();
    table
        .load_style(presets::UTF8_FULL_CONDENSED)
        .set_content_arrangement(ContentArrangement::Disabled);
    let mut header = vec![String::new()];
    header.extend(
        report
            .runs
            .iter()
            .map(|run| format!("compensation {}", run.compensation_word())),
    );
    header.push("paper, off (Table 6)".into());
    table.set_header(header);

    let paper = paper_table_6(&report.trajectory);
    let mut row = |name: &str, value: &dyn Fn(&super::Run) -> String, paper: String| {
        let mut cells = vec![name.to_owned()];
        cells.extend(report.runs.iter().map(value));
        cells.push(paper);
        table.add_row(cells);
    };
    let or_dash = |value: Option<f64>| value.map_or_else(|| "-".into(), percent);
    row(
        "x error (lateral)",
        &|run| percent(run.errors.x_percent),
        or_dash(paper.map(|p| p.0)),
    );
    row(
        "y error (longitudinal)",
        &|run| percent(run.errors.y_percent),
        or_dash(paper.map(|p| p.1)),
    );
    let mm = |value: f64| format!("{value:.2} mm");
    row(
        "rms tracking error",
        &|run| mm(run.errors.rms_mm),
        "-".into(),
    );
    row(
        "lag behind the curve",
        &|run| format!("{:.2} ms", run.evenness.lag_ms),
        "-".into(),
    );
    row(
        "ripple of the speed",
        &|run| format!("{:.2} %", run.evenness.ripple_percent),
        "-".into(),
    );
    row(
        "heading error at the end",
        &|run| format!("{:+.3} deg", run.evenness.heading_error_deg),
        "-".into(),
    );
    if report.trajectory == "turn" {
        row(
            "turned angle error",
            &|run| percent(run.evenness.turn_percent),
            "-".into(),
        );
    }
    row(
        "shape error, largest",
        &|run| mm(run.shape_error_mm),
        "-".into(),
    );
    row(
        "bus load, largest",
        &|run| load(run.bus_load_percent),
        "-".into(),
    );
    row(
        "emulated time / real time",
        &|run| format!("{:.2}", run.realtime_factor),
        "-".into(),
    );
    for index in 1..=report.runs.len() + 1 {
        if let Some(column) = table.column_mut(index) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table.to_string()
}
