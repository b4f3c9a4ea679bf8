//! Twenty groups under one fleet control on this machine: `cargo xtask bench --fleet`.
//!
//! `tests/interop/fleet_load.py` starts mosquitto and the groups, each of one simulated robot in
//! real time, sends each an order of its own, and counts. The tool is built in the release profile.
//! The figures are those of this machine and of what else it does.

use std::process::Command;

use anyhow::{Context as _, bail};
use serde_json::Value;

use super::figure::Figure;
use crate::cargo;

/// Groups on one broker.
const GROUPS: u32 = 20;

/// Builds the tool and measures.
pub fn figures() -> anyhow::Result<Vec<Figure>> {
    cargo::run(
        cargo::command()
            .args(["build", "--release", "--package", "omnibus-master"])
            .args(["--features", "vda5050", "--bin", "omnibus"]),
    )?;
    let output = Command::new("python3")
        .current_dir(cargo::root())
        .args(["tests/interop/fleet_load.py", &GROUPS.to_string()])
        .env("OMNIBUS", cargo::target_folder().join("release/omnibus"))
        .output()
        .context("python3: is it installed?")?;
    if !output.status.success() {
        bail!(
            "fleet_load.py failed; it needs mosquitto and its clients:\n{}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
    let printed: Value = serde_json::from_slice(&output.stdout).context("fleet_load.py")?;
    [
        ("messages", "1/s"),
        ("states", "1/s"),
        ("processor", "% of a core, one group"),
        ("memory", "MB, one group"),
        ("broker", "% of a core"),
    ]
    .into_iter()
    .map(|(what, unit)| {
        let value = printed[what].as_f64().with_context(|| what.to_owned())?;
        Ok(Figure::new(
            format!("host.fleet.{GROUPS}_groups.{what}"),
            value,
            unit,
        ))
    })
    .collect()
}
