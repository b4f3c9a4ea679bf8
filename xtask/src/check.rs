//! Checks the demo's JSON against its promises. The bounds come from the paper: its uncompensated
//! lateral errors are -2.92 % (Table 6) to -3.36 % (500 mm/s, section 3); compensated curves are to
//! agree with the theory, for which 0.3 % is the agreed bound, and a rigid group keeps its shape.

use std::ops::RangeInclusive;
use std::path::Path;

use anyhow::{Context as _, ensure};
use serde_json::Value;

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
    println!("{}: as promised", path.display());
    Ok(())
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
    let run = |word: &str| {
        json["runs"]
            .as_array()
            .and_then(|runs| runs.iter().find(|run| run["compensation"] == word))
            .with_context(|| format!("the file has no run with compensation {word}"))
    };
    let (off, on) = (run("off")?, run("on")?);
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
}
