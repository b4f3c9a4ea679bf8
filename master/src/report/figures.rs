//! The figures of a report, row by row, for all forms of a report: x ahead and y left, or the
//! paper's axes beside its values.

use super::{BackendName, Report, Run, paper_table_6};

/// One figure of every run.
pub struct Row {
    /// What it is.
    pub name: &'static str,
    /// One value a run, with its unit.
    pub values: Vec<String>,
    /// What the paper prints for its uncompensated robot.
    pub paper: Option<String>,
}

/// A signed percentage with two decimals, as the paper prints them.
#[must_use]
pub fn percent(value: f64) -> String {
    format!("{} %", signed(value, 2))
}

/// A number with its sign and so many decimals; what they show as nothing is on neither side of it.
fn signed(value: f64, decimals: usize) -> String {
    let text = format!("{value:+.decimals$}");
    let is_zero = text.parse() == Ok(0.0);
    if is_zero { text[1..].to_owned() } else { text }
}

/// A bus load with one decimal.
#[must_use]
pub fn load(value: Option<f64>) -> String {
    value.map_or_else(|| "not measured".into(), |value| format!("{value:.1} %"))
}

/// All of them.
#[must_use]
pub fn rows(report: &Report) -> Vec<Row> {
    let paper = paper_table_6(&report.trajectory).filter(|_| report.paper);
    let [lateral, longitudinal] = if report.paper {
        ["x error (lateral)", "y error (longitudinal)"]
    } else {
        ["y error (left)", "x error (ahead)"]
    };
    let row = |name, value: &dyn Fn(&Run) -> String, paper: Option<f64>| Row {
        name,
        values: report.runs.iter().map(value).collect(),
        paper: paper.map(percent),
    };
    let mm = |value: f64| format!("{value:.2} mm");
    let mut rows = vec![
        row(
            lateral,
            &|run| percent(run.errors.x_percent),
            paper.map(|p| p.0),
        ),
        row(
            longitudinal,
            &|run| percent(run.errors.y_percent),
            paper.map(|p| p.1),
        ),
    ];
    if report.turns() {
        rows.push(row(
            "error of the turned angle",
            &|run| percent(run.evenness.turn_percent),
            None,
        ));
    }
    rows.extend([
        row("tracking error, rms", &|run| mm(run.errors.rms_mm), None),
        row(
            "tracking error, largest",
            &|run| mm(run.errors.max_mm),
            None,
        ),
        row(
            "lag behind the curve",
            &|run| format!("{} ms", signed(run.evenness.lag_ms, 2)),
            None,
        ),
        row(
            "ripple of the speed",
            &|run| format!("{:.2} %", run.evenness.ripple_percent),
            None,
        ),
        row(
            "heading error at the end",
            &|run| format!("{} deg", signed(run.evenness.heading_error_deg, 3)),
            None,
        ),
        row("shape error, largest", &|run| mm(run.shape_error_mm), None),
    ]);
    // The load of a real bus is not measured here.
    if report.backend != BackendName::Robots {
        rows.push(row(
            "bus load, largest in 100 ms",
            &|run| load(run.bus_load_percent),
            None,
        ));
    }
    if report.backend == BackendName::Emulator {
        rows.push(row(
            "robots' time / real time",
            &|run| format!("{:.2}", run.realtime_factor),
            None,
        ));
    }
    if !report.paper && !report.turns() {
        rows.swap(0, 1);
    }
    rows
}

/// Whether the paper has anything to say about the curve.
#[must_use]
pub fn has_paper(rows: &[Row]) -> bool {
    rows.iter().any(|row| row.paper.is_some())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_rounds_to_nothing_has_no_sign() {
        for (value, text) in [
            (-0.004, "0.00 %"),
            (0.0, "0.00 %"),
            (-0.006, "-0.01 %"),
            (0.005_1, "+0.01 %"),
            (-13.78, "-13.78 %"),
        ] {
            assert_eq!(percent(value), text);
        }
    }
}
