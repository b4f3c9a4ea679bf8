//! What the optional features of the tool cost: `cargo xtask bench --features-cost`.
//!
//! The tool is built from nothing for every set of features, in the release profile and in a folder
//! of its own. Crates are those that `cargo tree` names for the normal edges, bytes are what is
//! loaded of the program, symbols and debug information apart, and the time is that of the
//! processor, of cargo and all that it starts. Crates and bytes are the same in every run on one
//! platform; the time is that of this machine.
//!
//! Limits: the time is read from `/proc`, so this needs Linux.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::{Context as _, bail};
use object::{Object as _, ObjectSegment as _};

use super::figure::Figure;
use crate::cargo;

/// Sets of features beside the default ones.
const SETS: [&str; 3] = ["", "ros", "vda5050"];
/// Clock ticks of `/proc` in a second (proc(5)); Linux has no other.
const TICKS: f64 = 100.0;

/// Builds the tool with each set of features and measures it.
pub fn figures() -> anyhow::Result<Vec<Figure>> {
    let mut figures = Vec::new();
    for features in SETS {
        let with = if features.is_empty() {
            "default"
        } else {
            features
        };
        println!("building the tool from nothing: {with}");
        let folder = cargo::target_folder().join("features-cost");
        if folder.exists() {
            std::fs::remove_dir_all(&folder).with_context(|| folder.display().to_string())?;
        }
        let before = spent()?;
        cargo::run(
            cargo::command()
                .args(["build", "--release", "--quiet", "--locked"])
                .args(["--package", "omnibus-master", "--bin", "omnibus"])
                .args(["--features", features])
                .arg("--target-dir")
                .arg(&folder),
        )?;
        let spent = spent()? - before;
        let name = |what: &str| format!("tool.{with}.{what}");
        figures.extend([
            Figure::new(name("crates"), crates(features)? as f64, "crates"),
            Figure::new(
                name("size"),
                loaded(&folder.join("release/omnibus"))? as f64,
                "bytes",
            ),
            Figure::new(name("build"), spent, "s of processor"),
        ]);
    }
    Ok(figures)
}

/// Crates that the tool is made of, its own among them.
fn crates(features: &str) -> anyhow::Result<usize> {
    let output = cargo::command()
        .args(["tree", "--package", "omnibus-master", "--locked"])
        .args(["--edges", "normal", "--prefix", "none"])
        .args(["--features", features])
        .output()
        .context("cargo tree")?;
    if !output.status.success() {
        bail!("cargo tree: {}", String::from_utf8_lossy(&output.stderr));
    }
    let text = String::from_utf8(output.stdout)?;
    // A line names a crate and its version; one that stood before has a mark behind them.
    let names: BTreeSet<Vec<&str>> = text
        .lines()
        .map(|line| line.split_whitespace().take(2).collect())
        .collect();
    Ok(names.len())
}

/// Bytes of a program that are loaded from its file.
fn loaded(program: &Path) -> anyhow::Result<u64> {
    let bytes = std::fs::read(program).with_context(|| program.display().to_string())?;
    let file = object::File::parse(&*bytes).context("not a program")?;
    Ok(file.segments().map(|segment| segment.file_range().1).sum())
}

/// Processor time of all programs that this one has started and that have ended, in s.
fn spent() -> anyhow::Result<f64> {
    let text = std::fs::read_to_string("/proc/self/stat").context("/proc/self/stat")?;
    // The name before may have spaces in it; the third field comes after its bracket.
    let (_, fields) = text.rsplit_once(") ").context("/proc/self/stat")?;
    let fields: Vec<&str> = fields.split(' ').collect();
    let ticks = |field: usize| -> anyhow::Result<f64> {
        Ok(fields.get(field - 3).context("/proc/self/stat")?.parse()?)
    };
    // cutime and cstime.
    Ok((ticks(16)? + ticks(17)?) / TICKS)
}
