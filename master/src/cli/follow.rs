//! `omnibus follow CURVE`: drives a curve and prints the figures.

use std::path::PathBuf;

use anyhow::{Context as _, bail};
use indicatif::{ProgressBar, ProgressStyle};
use omnibus::bus::BusAddress;
use omnibus::curve::Curve;
use omnibus::drive::{self, Drive};
use omnibus::report::{self, BackendName};

use super::{Target, say};

/// Resolution of the progress bar.
const STEPS: f64 = 1000.0;

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Switch {
    On,
    Off,
}

#[derive(clap::Args)]
pub struct Arguments {
    /// The curve.
    curve: Curve,
    #[command(flatten)]
    target: Target,
    /// Whether the robots compensate for wheel slip, with the group file's coefficients.
    #[arg(long, value_enum, default_value_t = Switch::On)]
    compensation: Switch,
    /// Drives only the first seconds of the curve.
    #[arg(long)]
    quick: bool,
    /// Prints the figures as JSON instead of a table.
    #[arg(long)]
    json: bool,
    /// Writes an HTML report with charts.
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Writes every frame as a candump log.
    #[arg(long, value_name = "FILE.log")]
    candump: Option<PathBuf>,
    /// Writes what the emulated robots' firmware logged.
    #[arg(long, value_name = "FILE.log")]
    log: Option<PathBuf>,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let target = &arguments.target;
    let group = target.group()?;
    let progress = ProgressBar::new(STEPS as u64);
    let style = ProgressStyle::with_template("{prefix} [{bar:40}] {percent:>3} %  {elapsed} {msg}");
    progress.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    progress.set_prefix(arguments.curve.name());
    let drive = Drive {
        group: &group,
        curve: arguments.curve,
        quick: arguments.quick,
        compensation: arguments.compensation == Switch::On,
        elf: target.elf()?,
        candump: arguments.candump.clone(),
        log: arguments.log.clone(),
        abort: super::abort_on_ctrl_c()?,
    };
    let tell = &mut |share: f64, phase| {
        progress.set_position((share * STEPS) as u64);
        progress.set_message(phase);
    };
    let (backend, run) = match &target.bus {
        BusAddress::Sim(_) => (target.backend, drive::simulated(&drive, tell)?),
        _ if drive.candump.is_some() || drive.log.is_some() => {
            bail!("--candump and --log are for simulated buses; use candump itself")
        }
        _ => {
            let link = target.link(&group)?;
            (BackendName::Robots, drive::measured(link, &drive, tell)?)
        }
    };
    progress.finish_and_clear();
    let report = drive::report(&group, arguments.curve, backend, vec![run]);
    if let Some(path) = &arguments.report {
        std::fs::write(path, report::html::to_html(&report)?)
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    if arguments.json {
        say(report::json::to_json(&report).trim_end())?;
    } else {
        say(report::table::to_table(&report))?;
        say("Axes as in the paper: x lateral, y longitudinal.")?;
    }
    Ok(())
}
