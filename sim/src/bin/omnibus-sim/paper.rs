//! `omnibus-sim paper` runs the source paper's experiments and puts what comes out beside what it
//! prints.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use clap::{Args, ValueEnum};
use omnibus_sim::Backend;
use omnibus_sim::paper::page::{to_html, to_text};
use omnibus_sim::paper::{Findings, OnPlant, SCENARIOS, Scenario, Setting, find};

use crate::output::print_line;
use crate::robots::Robots;

/// Options of `omnibus-sim paper`.
#[derive(Args)]
#[command(after_help = "Examples:
  omnibus-sim paper --list
  omnibus-sim paper table-6
  omnibus-sim paper all --out target/paper")]
pub struct Paper {
    /// Name of an experiment, or all.
    name: Option<String>,
    /// Lists the experiments.
    #[arg(long)]
    list: bool,
    /// Plant to use; by default every plant that suits the experiment.
    #[arg(long, value_enum)]
    plant: Option<PlantName>,
    #[command(flatten)]
    robots: Robots,
    /// Writes report.html and the figures as SVG files into this folder.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

#[derive(Clone, Copy, ValueEnum)]
enum PlantName {
    /// The compensation tables of the paper.
    Table,
    /// Rigid bodies on rollers with friction.
    Contact,
}

/// Runs the experiments asked for.
///
/// # Errors
/// When there is no such experiment, a robot faults, or a file cannot be written.
pub fn paper(arguments: &Paper) -> anyhow::Result<()> {
    if arguments.list {
        for scenario in SCENARIOS {
            print_line(format_args!("{:<22} {}", scenario.name, scenario.text))?;
        }
        return Ok(());
    }
    let chosen: Vec<&Scenario> = match arguments.name.as_deref() {
        None => bail!("paper: give the name of an experiment, all, or --list"),
        Some("all") => SCENARIOS.iter().collect(),
        Some(name) => match find(name) {
            Some(scenario) => vec![scenario],
            None => {
                bail!("paper {name}: no experiment has this name; --list prints them all")
            }
        },
    };
    let backend = arguments.robots.backend()?;
    let word = match backend {
        Backend::Native => "native",
        _ => "emulator",
    };
    if let Some(folder) = &arguments.out {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot create {}", folder.display()))?;
    }
    let setting = Setting {
        backend,
        plants: match arguments.plant {
            None => vec![],
            Some(PlantName::Table) => vec![OnPlant::Table],
            Some(PlantName::Contact) => vec![OnPlant::Contact],
        },
    };
    let mut all = Vec::new();
    for scenario in chosen {
        let findings = scenario
            .run(&setting)
            .with_context(|| format!("experiment {}", scenario.name))?;
        let text = to_text(&findings);
        all.push(findings);
        // After each, so that an early end keeps what was found.
        if let Some(folder) = &arguments.out {
            write(folder, &all, word)?;
        }
        print_line(text)?;
    }
    if let Some(folder) = &arguments.out {
        print_line(format_args!(
            "report   {}",
            folder.join("report.html").display()
        ))?;
    }
    Ok(())
}

/// The charts of the newest findings, and the page of all.
fn write(folder: &Path, all: &[Findings], backend: &str) -> anyhow::Result<()> {
    let file = |name: String, text: String| {
        let path = folder.join(name);
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    if let Some(findings) = all.last() {
        for (n, chart) in findings.charts.iter().enumerate() {
            file(format!("{}-{}.svg", findings.name, n + 1), chart.to_svg()?)?;
        }
    }
    file("report.html".to_owned(), to_html(all, backend)?)
}
