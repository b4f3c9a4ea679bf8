//! Checks the demo's JSON against its promises, and the table in README.md against it. The bounds
//! come from the paper: its uncompensated lateral errors are -2.92 % (Table 6) to -3.36 % (500
//! mm/s, section 3); compensated curves are to agree with the theory, for which 0.3 % is the agreed
//! bound, and a rigid group keeps its shape.

use std::ops::RangeInclusive;
use std::path::Path;

use anyhow::{Context as _, ensure};
use serde_json::Value;

use crate::cargo;

/// Lateral error without compensation, in per cent.
const LATERAL_OFF: RangeInclusive<f64> = -4.0..=-2.5;
/// Error of either axis with compensation, in per cent.
const EITHER_ON: RangeInclusive<f64> = -0.3..=0.3;
/// Shape error, in mm.
const SHAPE: RangeInclusive<f64> = 0.0..=5.0;

/// Reads the JSON file and checks it.
pub fn demo(path: &Path) -> anyhow::Result<()> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let json =
        serde_json::from_str(&text).with_context(|| format!("{} is not JSON", path.display()))?;
    promises(&json).with_context(|| path.display().to_string())?;
    let readme = cargo::root().join("README.md");
    let page = std::fs::read_to_string(&readme)
        .with_context(|| format!("cannot read {}", readme.display()))?;
    shown(&page, &json).context("README.md: run `cargo xtask demo` and copy its table")?;
    println!("{}: as promised, and as README.md shows", path.display());
    Ok(())
}

/// Rows of the demo's table that depend on no computer, and their fields.
const ROWS: [(&str, &str); 7] = [
    ("x error (ahead)", "ahead_percent"),
    ("y error (left)", "aside_percent"),
    ("tracking error, rms", "rms_mm"),
    ("lag behind the curve", "lag_ms"),
    ("ripple of the speed", "ripple_percent"),
    ("heading error at the end", "heading_error_deg"),
    ("shape error, largest", "shape_error_mm"),
];

/// Whether a page's table has the numbers of both runs, as far as it prints them.
fn shown(page: &str, json: &Value) -> anyhow::Result<()> {
    for (name, field) in ROWS {
        let row = page.lines().find(|line| line.contains(name));
        let row = row.with_context(|| format!("no row \"{name}\""))?;
        let mut cells = row.split('┆').skip(1);
        for word in ["off", "on"] {
            let cell = cells.next().and_then(|cell| cell.split_whitespace().next());
            let cell =
                cell.with_context(|| format!("{name}: no value with compensation {word}"))?;
            let printed: f64 = cell.parse().with_context(|| format!("{name}: {cell}"))?;
            let decimals = cell.split_once('.').map_or(0, |(_, digits)| digits.len());
            let value = run(json, word)?[field].as_f64();
            let value = value.with_context(|| format!("{field} is missing"))?;
            // Half of the last digit, and what the JSON is rounded by.
            let bound = 0.5 * 0.1_f64.powi(decimals as i32) + 1e-4;
            ensure!(
                (printed - value).abs() <= bound,
                "{name} with compensation {word}: {cell}, measured {value}"
            );
        }
    }
    Ok(())
}

/// The run with compensation `word`.
fn run<'a>(json: &'a Value, word: &str) -> anyhow::Result<&'a Value> {
    json["runs"]
        .as_array()
        .and_then(|runs| runs.iter().find(|run| run["compensation"] == word))
        .with_context(|| format!("the file has no run with compensation {word}"))
}

/// A number of a run, checked against its bounds.
fn within(run: &Value, field: &str, bounds: &RangeInclusive<f64>) -> anyhow::Result<()> {
    let value = run[field]
        .as_f64()
        .with_context(|| format!("{field} is missing or not a number"))?;
    ensure!(
        bounds.contains(&value),
        "{field} is {value} with compensation {}, promised {} to {}",
        run["compensation"],
        bounds.start(),
        bounds.end()
    );
    Ok(())
}

fn promises(json: &Value) -> anyhow::Result<()> {
    ensure!(
        json["backend"] == "emulator",
        "backend is {}",
        json["backend"]
    );
    ensure!(json["robots"] == 3, "robots is {}", json["robots"]);
    let (off, on) = (run(json, "off")?, run(json, "on")?);
    within(off, "aside_percent", &LATERAL_OFF)?;
    within(on, "aside_percent", &EITHER_ON)?;
    within(on, "ahead_percent", &EITHER_ON)?;
    within(off, "shape_error_mm", &SHAPE)?;
    within(on, "shape_error_mm", &SHAPE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn sample(x_off: f64, x_on: f64) -> Value {
        let run = |word: &str, x: f64| {
            json!({"compensation": word, "aside_percent": x, "ahead_percent": -0.1,
                   "rms_mm": 1.0, "shape_error_mm": 0.5})
        };
        json!({"backend": "emulator", "config": "tcc-3", "trajectory": "figure-eight",
               "robots": 3, "realtime_factor": 1.0, "bus_load_percent": 20.0,
               "runs": [run("off", x_off), run("on", x_on)]})
    }

    #[test]
    fn accepts_the_promise_and_nothing_else() {
        assert!(promises(&sample(-3.2, 0.1)).is_ok());
        assert!(promises(&sample(-2.4, 0.1)).is_err());
        assert!(promises(&sample(-3.2, 0.31)).is_err());
        let mut native = sample(-3.2, 0.1);
        native["backend"] = json!("native");
        assert!(promises(&native).is_err());
        assert!(promises(&json!({})).is_err());
    }

    #[test]
    fn a_table_of_other_numbers_is_refused() {
        let mut json = sample(-3.2, 0.1);
        for run in json["runs"].as_array_mut().unwrap() {
            for field in ["lag_ms", "ripple_percent", "heading_error_deg"] {
                run[field] = json!(0.0649);
            }
        }
        let table = |y: &str| {
            ROWS.map(|(name, field)| match field {
                "aside_percent" => format!("│ {name} ┆ {y} % ┆ +0.10 % │\n"),
                "ahead_percent" => format!("│ {name} ┆ -0.10 % ┆ -0.1 % │\n"),
                "rms_mm" => format!("│ {name} ┆ 1.00 mm ┆ 1.00 mm │\n"),
                "shape_error_mm" => format!("│ {name} ┆ 0.5 mm ┆ 0.50 mm │\n"),
                _ => format!("│ {name} ┆ +0.06 ┆ +0.065 │\n"),
            })
            .concat()
        };
        shown(&table("-3.20"), &json).unwrap();
        let error = shown(&table("-3.21"), &json).unwrap_err().to_string();
        assert!(
            error.contains("y error (left) with compensation off: -3.21"),
            "{error}"
        );
        assert!(shown("", &json).is_err());
    }
}
