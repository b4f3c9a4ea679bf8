//! `omnibus update`: a new image for all robots of a group, over the bus.

use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};

use boot::Slot;
use indicatif::{ProgressBar, ProgressStyle};
use omnibus::commission::survey::Survey;
use omnibus::commission::update::{self, Before, Image, Step};
use omnibus::error::MasterError;
use serde_json::json;

use super::output::Found;
use super::{
    Target, Usage, abort_on_ctrl_c, input, json, output, print_json, print_line, print_note,
};

const EXAMPLES: &str = "Examples:
  omnibus update omnibus.image --bus socketcan:can0 --group groups/tcc-3.toml
  omnibus update omnibus.image --dry-run --bus socketcan:can0
  omnibus update --rollback --node 3 --bus socketcan:can0

Either all robots start the new image, or all stay with the one they have. Robots have to be in PRE-OPERATIONAL; a group
that moves is stopped first. Ctrl-C before the first confirmation leaves all robots with the image they have. cargo
xtask release makes the file.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
#[command(group = clap::ArgGroup::new("image").args(["file", "rollback"]).required(true))]
pub struct Arguments {
    /// The image file.
    file: Option<PathBuf>,
    /// Updates only this robot; the image must have the wire version of the other robots.
    #[arg(long, value_parser = super::robot)]
    node: Option<u8>,
    /// Shows what would be done and changes nothing.
    #[arg(long)]
    dry_run: bool,
    /// Returns the robots to their previous image.
    #[arg(long)]
    rollback: bool,
    #[command(flatten)]
    target: Target,
}

/// `omnibus update`.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let target = &arguments.target;
    let image = arguments.file.as_deref().map(read).transpose()?;
    let abort = abort_on_ctrl_c()?;
    let group = target.group_if_any()?;
    let mut wire = target.exclusive()?;
    abort.check()?;
    let survey = Survey::take(&mut wire, group.as_ref())?;
    if let Some(node) = survey.missing.first() {
        return Err(MasterError::NodeSilent { node: *node }.into());
    }
    let chosen = |node: u8| arguments.node.is_none_or(|only| only == node);
    let found = survey.found.iter().filter(|robot| chosen(robot.node));
    let nodes: Vec<_> = found.map(|robot| (robot.node, robot.nmt)).collect();
    if nodes.is_empty() {
        return Err(match arguments.node {
            Some(node) => MasterError::NodeSilent { node }.into(),
            None => Found(format!("no robot answers on {}", target.bus)).into(),
        });
    }
    let robots = update::survey(&mut wire, &nodes)?;
    show_before(&robots, image.as_ref());
    if let Some(image) = &image {
        update::check(image, &robots)?;
        check_mixture(arguments, image, survey.found.len())?;
    }
    if arguments.dry_run {
        return finish(&robots, image.as_ref(), "nothing was changed");
    }
    let mut progress = Progress::new();
    // A return that has begun is completed, so that all robots go back.
    abort.check()?;
    match &image {
        Some(image) => {
            let mut show = |step| progress.show(step);
            update::update(&mut wire, image, &robots, &abort, &mut show)?;
        }
        None => update::go_back(&mut wire, &robots, &mut |step| progress.show(step))?,
    }
    let what = match &image {
        Some(_) => "all robots run the new image",
        None => "all robots run their previous image",
    };
    finish(&robots, image.as_ref(), what)
}

fn read(path: &Path) -> anyhow::Result<Image> {
    let give = "an image file, as `cargo xtask release --out FILE` makes it";
    let bytes = input::bytes(path, give)?;
    let image = Image::read(bytes);
    image.map_err(|problem| anyhow::anyhow!("{}: {problem}; give {give}", path.display()))
}

/// One robot alone must not get what the others do not understand.
fn check_mixture(arguments: &Arguments, image: &Image, robots: usize) -> anyhow::Result<()> {
    let same = image.header.wire_version == protocol::WIRE_VERSION;
    if let Some(node) = arguments.node
        && robots > 1
        && !same
    {
        return Err(Usage(format!(
            "--node {node}: the image has wire version {}, which the others on the bus do not \
             understand; update all of them",
            image.header.wire_version
        ))
        .into());
    }
    if !same {
        print_note(format!(
            "The image has wire version {}; this program speaks {} and must be updated, too.",
            image.header.wire_version,
            protocol::WIRE_VERSION
        ));
    }
    Ok(())
}

fn version(version: u32) -> String {
    let [major, minor, patch, _] = version.to_be_bytes();
    format!("{major}.{minor}.{patch}")
}

fn show_before(robots: &[Before], image: Option<&Image>) {
    for robot in robots {
        let slot = robot.slot.map_or("none".into(), |slot| format!("{slot:?}"));
        let then = match image {
            Some(image) => format!("gets {}", version(image.header.version)),
            None if robot.other != 0 => format!("goes back to {}", version(robot.other)),
            None if robot.slot == Some(Slot::B) => "goes back to what was flashed by cable".into(),
            None => "has no other image".into(),
        };
        print_note(format!(
            "node {}: version {} in slot {slot}, {then}",
            robot.node,
            version(robot.version)
        ));
    }
}

fn finish(robots: &[Before], image: Option<&Image>, what: &str) -> anyhow::Result<()> {
    if json() {
        let robots: Vec<_> = robots
            .iter()
            .map(|robot| json!({"node": robot.node, "version_before": version(robot.version)}))
            .collect();
        let new = image.map(|image| version(image.header.version));
        return print_json(&json!({"robots": robots, "version": new, "result": what}));
    }
    print_line(what)
}

/// A bar for each robot on a terminal, a line for each step elsewhere.
struct Progress {
    bar: Option<ProgressBar>,
    is_terminal: bool,
}

impl Progress {
    fn new() -> Self {
        Self {
            bar: None,
            is_terminal: output::prints_text() && std::io::stderr().is_terminal(),
        }
    }

    fn show(&mut self, step: Step) {
        match step {
            Step::Erases(node) => self.line(format!("node {node}: erases its slot")),
            Step::Receives(node, sent, length) => self.receives(node, sent, length),
            Step::HasIt(node) => {
                if let Some(bar) = self.bar.take() {
                    bar.finish();
                }
                self.line(format!("node {node}: has received the whole image"));
            }
            Step::Starts(node) => self.line(format!("node {node}: starts the new image")),
            Step::Confirmed(node) => self.line(format!("node {node}: confirmed")),
            Step::GoesBack(node) => self.line(format!("node {node}: goes back")),
        }
    }

    fn receives(&mut self, node: u8, sent: usize, length: usize) {
        if !self.is_terminal {
            return;
        }
        let bar = self.bar.get_or_insert_with(|| {
            let bar = ProgressBar::new(length as u64);
            let style = ProgressStyle::with_template("{msg} [{bar:40}] {bytes}/{total_bytes}");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
            bar.set_message(format!("node {node}"));
            bar
        });
        bar.set_position(sent as u64);
    }

    fn line(&self, line: String) {
        match &self.bar {
            Some(bar) => bar.println(line),
            None => print_note(line),
        }
    }
}
