//! Submitted reports of hardware in `docs/hardware/`: their format, and the summary of them in
//! README.

use anyhow::{Context as _, ensure};
use serde_json::Value;

use crate::report::FORMAT;

/// The levels, and what they are.
pub const LEVELS: [(u8, &str); 3] = [
    (1, "level 1: a bare board"),
    (2, "level 2: a group with its wheels off the floor"),
    (3, "level 3: a group on the floor"),
];

/// Checks the format of a report of hardware.
///
/// # Errors
/// Names the field.
pub fn check(report: &Value) -> anyhow::Result<()> {
    ensure!(
        report["format"] == FORMAT,
        "format is {}, not {FORMAT}; use the program of this release",
        report["format"]
    );
    ensure!(
        report["hardware"] == true,
        "hardware is {}: only what was measured on hardware belongs here",
        report["hardware"]
    );
    ensure!(
        report["mutation"].is_null(),
        "mutation is {}: a board with a defect on purpose",
        report["mutation"]
    );
    let level = report["level"].as_u64();
    ensure!(
        LEVELS
            .iter()
            .any(|(known, _)| level == Some((*known).into())),
        "level is {}, not 1 to 3",
        report["level"]
    );
    for field in ["board", "chip", "versions", "date"] {
        let text = report[field].as_str().unwrap_or_default();
        ensure!(!text.is_empty(), "{field} is missing");
    }
    let checks = report["checks"].as_array().context("checks is no list")?;
    ensure!(!checks.is_empty(), "checks is empty");
    for check in checks {
        let name = check["name"].as_str().context("a check has no name")?;
        ensure!(check["unit"].is_string(), "{name} has no unit");
        for field in ["promised", "measured"] {
            let value = &check[field];
            ensure!(
                value.is_number() || value.is_null(),
                "{name}: {field} is {value}"
            );
        }
        let within = &check["within"];
        ensure!(
            within.is_boolean() || within.is_null(),
            "{name}: within is {within}"
        );
    }
    Ok(())
}

/// The rows of README's table: what emulated boards keep, and what hardware did.
#[must_use]
pub fn rows(emulated: &[(u8, Value)], reports: &[(String, Value)]) -> String {
    let mut rows = String::new();
    for (level, name) in LEVELS {
        let numbers = |report: &Value| {
            format!(
                "{} promises kept, {} missed, {} not tried",
                report["kept"], report["missed"], report["not_tried"]
            )
        };
        let known = emulated.iter().find(|(of, _)| *of == level);
        let emulated = known.map_or_else(String::new, |(_, report)| {
            format!("emulated: {}; ", numbers(report))
        });
        let here: Vec<String> = reports
            .iter()
            .filter(|(_, report)| report["level"] == level)
            .map(|(file, report)| {
                let board = report["board"].as_str().unwrap_or_default();
                let date = report["date"].as_str().unwrap_or_default();
                let link = format!("[{board}, {date}](docs/hardware/{file})");
                format!("on hardware, {link}: {}", numbers(report))
            })
            .collect();
        let hardware = if here.is_empty() {
            "**not run on hardware**".to_owned()
        } else {
            here.join("; ")
        };
        rows += &format!("| [acceptance](docs/acceptance.md), {name} | {emulated}{hardware} |\n");
    }
    rows
}
