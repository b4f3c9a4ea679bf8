//! The output of `omnibus calibrate`: tables, or JSON.

use omnibus::commission::calibrate::fit::Row;
use omnibus::commission::calibrate::manoeuvre::Way;
use omnibus::commission::calibrate::{Calibration, Outcome, group_file};
use protocol::compensation;
use serde_json::{Value, json};

use crate::cli::print_line;

/// The coefficients with their names.
fn coefficients(outcome: &Outcome) -> Vec<(&'static str, Way, Row)> {
    let found = &outcome.found;
    let mut out = Vec::new();
    out.extend(
        found
            .ahead
            .iter()
            .map(|row| ("longitudinal", Way::Ahead, *row)),
    );
    out.extend(found.aside.iter().map(|row| ("lateral", Way::Aside, *row)));
    for [x, y] in &found.oblique {
        out.push(("longitudinal", Way::Oblique, *x));
        out.push(("lateral", Way::Oblique, *y));
    }
    out.extend(found.yaw.iter().map(|row| ("yaw", Way::Turn, *row)));
    out
}

/// Prints what was found, for people.
pub fn show(calibration: &Calibration) -> anyhow::Result<()> {
    for outcome in &calibration.outcomes {
        print_line(format!(
            "Coefficients of {}, version {}, with intervals of 95 %",
            omnibus::report::nodes(&outcome.nodes),
            calibration.version
        ))?;
        let columns = ["motion", "axis", "coefficient", "residual", "used"];
        let mut table = crate::cli::output::table(columns);
        for (axis, way, row) in coefficients(outcome) {
            let half = (row.fit.interval.1 - row.fit.interval.0) / 2.0;
            let milli = if way == Way::Turn { "mrad/s" } else { "mm/s" };
            table.add_row([
                format!("{} {} {}", way.name(), row.speed, way.unit()),
                axis.to_owned(),
                format!("{:.4} ± {half:.4}", row.fit.coefficient),
                format!("{:.2} {milli}", row.fit.residual * 1e3),
                format!("{} of {}", row.fit.used, row.fit.used + row.fit.rejected),
            ]);
        }
        print_line(&table)?;
        let left = outcome.left.iter();
        let left: Vec<_> = left
            .map(|left| format!("{} {:+.2} %", left.way.name(), left.error * 100.0))
            .collect();
        print_line(format!(
            "Largest remaining error with these coefficients: {}.",
            left.join(", ")
        ))?;
        if outcome.missed > 0 {
            print_line(format!("{} motions were skipped.", outcome.missed))?;
        }
    }
    print_line(format!("\n{}", group_file::lines(&calibration.file)))
}

/// What every robot computes with, as it was written.
pub fn constants_json(calibration: &Calibration) -> Vec<Value> {
    let robots = calibration.file.robots.iter();
    let each = robots.map(|robot| {
        let rollers = robot.rollers.as_ref();
        let constant = rollers.map_or(&robot.compensation, |rollers| &rollers.compensation);
        let table = rollers
            .is_none()
            .then_some(&robot.compensation_table)
            .map(|table| {
                let rows = |rows: &[compensation::Row]| {
                    rows.iter().map(|row| row.pair()).collect::<Vec<_>>()
                };
                let oblique = table.oblique.iter();
                let oblique: Vec<_> = oblique
                    .map(|row| [row.speed, row.longitudinal, row.lateral])
                    .collect();
                json!({"longitudinal": rows(&table.longitudinal),
                    "lateral": rows(&table.lateral), "oblique": oblique,
                    "yaw": rows(&table.yaw)})
            });
        json!({
            "node": robot.node,
            "longitudinal": constant.longitudinal(),
            "lateral": constant.lateral(),
            "yaw": constant.yaw(),
            "table": table,
            "phases_deg": rollers.map(|r| r.phases.map(f32::to_degrees)),
        })
    });
    each.collect()
}

/// What was found, by the motions it was found in.
pub fn outcome_json(outcome: &Outcome) -> Value {
    let rows: Vec<Value> = coefficients(outcome)
        .into_iter()
        .map(|(axis, way, row)| {
            json!({
                "motion": way.name(),
                "speed": row.speed,
                "unit": way.unit(),
                "axis": axis,
                "coefficient": row.fit.coefficient,
                "low": row.fit.interval.0,
                "high": row.fit.interval.1,
                "residual": row.fit.residual,
                "used": row.fit.used,
                "rejected": row.fit.rejected,
            })
        })
        .collect();
    let left: Vec<Value> = outcome
        .left
        .iter()
        .map(|left| {
            json!({
                "motion": left.way.name(),
                "speed": left.speed,
                "percent": left.error * 100.0,
            })
        })
        .collect();
    json!({"nodes": outcome.nodes, "coefficients": rows, "left": left, "missed": outcome.missed})
}
