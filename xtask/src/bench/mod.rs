//! `cargo xtask bench`: the cost and the accuracy of the firmware, each figure by execution.
//!
//! [`kernels`] counts the functions of the tick one by one; [`running`] drives emulated robots that
//! run the release image and counts, [`kit`] the same without a floating-point unit; [`image`]
//! inspects the image; [`bus`] measures the virtual bus; [`latency`] the time from a call to the
//! wheel; [`accuracy`] compares scalars; [`tracking`] drives curves; [`update`] times an update
//! over the bus. All of it is emulated or exact arithmetic, so two runs give the same figures, and
//! `--check` can hold them to their ceilings.
//! What depends on the speed of this machine is measured on request and kept separate: [`host`],
//! [`features`] of the tool, and a [`fleet`] of groups.

mod accuracy;
mod bus;
mod driving;
mod features;
mod figure;
mod fleet;
mod gateway;
mod host;
mod image;
mod kernels;
mod kit;
mod latency;
pub mod profile;
mod rate;
mod running;
mod tracking;
mod update;
mod watched;

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use emulator::Firmware;
use group::GroupFile;
use omnibus::report::Scalar;
use serde_json::{Value, json};

use crate::{cargo, firmware};
use figure::Figure;

/// Options of `cargo xtask bench`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Where to write the figures as JSON.
    #[arg(long, value_name = "PATH")]
    json: Option<PathBuf>,
    /// Fails when a figure exceeds its ceiling, or its budget where no ceiling is recorded.
    #[arg(long)]
    check: bool,
    /// Rewrites docs/performance.md.
    #[arg(long)]
    write_docs: bool,
    /// Also measures the speed of kinematics, the emulator and native robots on this machine. These
    /// times are never checked, and are separate from the other figures in the JSON.
    #[arg(long)]
    host: bool,
    /// Counts only the instructions of the functions of the tick, which needs no image and takes
    /// at most a minute.
    #[arg(long, conflicts_with_all = ["write_docs", "host", "image"])]
    kernels: bool,
    /// Measures only the kit with an STM32F103, which has no floating-point unit.
    #[arg(long, conflicts_with_all = ["kernels", "update", "write_docs", "host", "image"])]
    f103: bool,
    /// Times only an update over the bus, of eight robots.
    #[arg(long, conflicts_with_all = ["kernels", "write_docs", "host"])]
    update: bool,
    /// Measures instead what the features `ros` and `vda5050` of the tool cost: crates, bytes, and
    /// time to build. Builds the tool three times from nothing.
    #[arg(long, conflicts_with_all = ["kernels", "update", "write_docs", "host", "image", "check"])]
    features_cost: bool,
    /// Measures instead what twenty groups under one fleet control cost (VDA 5050); needs mosquitto
    /// and Python. Takes a minute.
    #[arg(long, conflicts_with_all = ["features_cost", "kernels", "update", "write_docs", "host", "image", "check"])]
    fleet: bool,
    /// Firmware image to measure; by default it is built.
    #[arg(long, value_name = "ELF")]
    image: Option<PathBuf>,
}

/// The group whose robots are measured.
const GROUP: &str = "groups/tcc-3.toml";
/// One robot, for the tracking of curves and the speed of the emulator.
const ALONE: &str = "groups/single.toml";
/// The generated page and the part of it that is written by hand.
const PAGE: &str = "docs/performance.md";
const BY_HAND: &str = "docs/performance.in.md";

/// Measures everything.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    if arguments.kernels {
        let figures = kernels::figures()?;
        print(&figures);
        write_json(arguments.json.as_deref(), &figures, &[])?;
        return hold(arguments, &figures);
    }
    if arguments.f103 {
        let figures = kit::figures(&GroupFile::load(cargo::root().join(GROUP))?)?;
        print(&figures);
        write_json(arguments.json.as_deref(), &figures, &[])?;
        return hold(arguments, &figures);
    }
    if arguments.features_cost || arguments.fleet {
        let host = match arguments.fleet {
            true => fleet::figures()?,
            false => features::figures()?,
        };
        print(&host);
        return write_json(arguments.json.as_deref(), &[], &host);
    }
    let elf = match &arguments.image {
        Some(path) => path.clone(),
        None => firmware::build(Scalar::F32)?,
    };
    let image = Firmware::load(&elf)?;
    let group = GroupFile::load(cargo::root().join(GROUP))?;
    if arguments.update {
        let figures = update::figures(&group, &elf, &image)?;
        print(&figures);
        write_json(arguments.json.as_deref(), &figures, &[])?;
        return hold(arguments, &figures);
    }

    let alone = GroupFile::load(cargo::root().join(ALONE))?;
    // In two halves that take about as long.
    let (ticks, rest) = std::thread::scope(|scope| {
        let ticks = scope.spawn(|| ticks(&group, &image));
        let rest = whole(&group, &alone, &elf, &image);
        (ticks.join(), rest)
    });
    let mut figures = ticks.map_err(std::panic::resume_unwind)??;
    figures.extend(rest?);
    print(&figures);
    let host = match arguments.host {
        true => host::figures(&alone, &group, &image)?,
        false => Vec::new(),
    };
    print(&host);
    write_json(arguments.json.as_deref(), &figures, &host)?;
    if arguments.write_docs {
        write_page(&figures)?;
    }
    hold(arguments, &figures)
}

/// The tick: its functions, what it costs in a driving group, and how fast it could be.
fn ticks(group: &GroupFile, image: &Firmware) -> anyhow::Result<Vec<Figure>> {
    let mut figures = kernels::figures()?;
    let running = running::figures(group, image)?;
    let calculated = running
        .iter()
        .find(|figure| figure.name == running::CALCULATED_RATE)
        .context("the run produced no calculated rate")?
        .value;
    figures.extend(running);
    let fixed = Firmware::load(&firmware::build(Scalar::Fixed)?)?;
    figures.extend(running::tick(group, &fixed, "tick.fixed")?);
    figures.push(rate::figure(group, calculated)?);
    figures.push(running::ready(group, image)?);
    Ok(figures)
}

/// A kit's tick, and what concerns whole robots and groups.
fn whole(
    group: &GroupFile,
    alone: &GroupFile,
    elf: &Path,
    image: &Firmware,
) -> anyhow::Result<Vec<Figure>> {
    let mut figures = kit::figures(group)?;
    figures.extend(latency::figures(group, image)?);
    figures.extend(gateway::figures(group, image)?);
    figures.extend(update::figures(group, elf, image)?);
    figures.extend(image::figures(elf, image)?);
    figures.extend(bus::figures(group)?);
    figures.extend(accuracy::figures()?);
    figures.extend(tracking::figures(alone)?);
    Ok(figures)
}

/// Fails for figures past their ceilings, if `--check` is given.
fn hold(arguments: &Arguments, figures: &[Figure]) -> anyhow::Result<()> {
    let regressions: Vec<String> = figures.iter().filter_map(Figure::regression).collect();
    if arguments.check && !regressions.is_empty() {
        bail!(
            "these figures exceed their ceilings:\n{}",
            regressions.join("\n")
        );
    }
    Ok(())
}

/// Flash and RAM.
pub fn size(board: firmware::Board, json: Option<&Path>) -> anyhow::Result<()> {
    let elf = firmware::build_for(board)?;
    firmware::print_size(&elf)?;
    let figures = image::figures(&elf, &Firmware::load(&elf)?)?;
    print(&figures);
    write_json(json, &figures, &[])
}

fn print(figures: &[Figure]) {
    for figure in figures {
        let budget = figure.budget.map(|budget| match figure.keeps_budget() {
            Some(true) => format!("budget {budget}"),
            _ => format!("budget {budget} MISSED"),
        });
        let peer = figure.peer.map(|(value, name)| format!("{name} {value}"));
        println!(
            "{:<44} {:>14.4} {:<13} {:<22} {}",
            figure.name,
            figure.value,
            figure.unit,
            budget.unwrap_or_default(),
            peer.unwrap_or_default()
        );
    }
}

/// The figures that every run repeats, and separately those of this machine.
fn content(figures: &[Figure], host: &[Figure]) -> Value {
    let list = |figures: &[Figure]| figures.iter().map(Figure::json).collect::<Vec<_>>();
    if host.is_empty() {
        json!({ "figures": list(figures) })
    } else {
        json!({ "figures": list(figures), "host": list(host) })
    }
}

fn write_json(path: Option<&Path>, figures: &[Figure], host: &[Figure]) -> anyhow::Result<()> {
    let Some(path) = path else {
        return Ok(());
    };
    let text = serde_json::to_string_pretty(&content(figures, host))?;
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

/// The page is the part written by hand with the table in place of its mark.
fn write_page(figures: &[Figure]) -> anyhow::Result<()> {
    const MARK: &str = "<!-- figures -->";
    let root = cargo::root();
    let by_hand = std::fs::read_to_string(root.join(BY_HAND))
        .with_context(|| format!("cannot read {BY_HAND}"))?;
    let rows: Vec<String> = figures.iter().map(Figure::row).collect();
    let table = format!(
        "| figure | value | unit | budget | ceiling | best public peer |\n|---|---|---|---|---|---|\n{}",
        rows.join("\n")
    );
    let page = format!(
        "<!-- Generated by `cargo xtask bench --write-docs` from {BY_HAND}; edit that. -->\n\n{}",
        by_hand.replace(MARK, &table)
    );
    std::fs::write(root.join(PAGE), page).with_context(|| format!("cannot write {PAGE}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_of_this_machine_are_apart_from_what_every_run_repeats() {
        let figures = [Figure::new("load", 6.5, "%")];
        let host = [Figure::new("host.inverse.f64_cost", 1.5, "times f32")];
        let names = |content: &Value, kind: &str| -> Vec<String> {
            let list = content[kind].as_array().into_iter().flatten();
            list.map(|figure| figure["name"].to_string()).collect()
        };
        let both = content(&figures, &host);
        assert_eq!(names(&both, "figures"), [r#""load""#]);
        assert_eq!(names(&both, "host"), [r#""host.inverse.f64_cost""#]);
        assert_eq!(content(&figures, &[]).get("host"), None);
    }
}
