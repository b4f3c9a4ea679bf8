//! `omnibus group`: group files, from the first one to the robots.

use std::io::Write as _;
#[cfg(feature = "simulation")]
use std::path::Path;
use std::path::PathBuf;

use anyhow::bail;
use group::{Examination, GroupError, GroupFile};
use omnibus::session::{configure, sdo};
use ros::names::Frames;
use serde_json::json;

use super::output::{self, Found};
use super::{Target, json, print_json, print_line, print_note, refuse_input};

mod draw;
mod new;

const EXAMPLES: &str = "Examples:
  omnibus group new my-group.toml
  omnibus group check groups/*.toml
  omnibus group draw groups/tcc-2.toml --output tcc-2.svg
  omnibus group show groups/tcc-2.toml --node 3
  omnibus group schema > group.schema.json
  omnibus group apply --group groups/tcc-2.toml --bus socketcan:can0 --save";

const CHECK_EXAMPLES: &str = "Examples:
  omnibus group check my-group.toml
  omnibus group check groups/*.toml

Lists every error with its file, line, key and remedy, and then exits with code 6. A value that is allowed but probably
not intended, such as a speed that the wheels cannot reach, is a warning. docs/group-files.md explains every key.";

const SHOW_EXAMPLES: &str = "Examples:
  omnibus group show groups/tcc-2.toml
  omnibus group show groups/tcc-2.toml --node 3";

const APPLY_EXAMPLES: &str = "Examples:
  omnibus group apply --group groups/tcc-2.toml --bus socketcan:can0 --save";

const SCHEMA_EXAMPLES: &str = "Examples:
  omnibus group schema > group.schema.json

An editor that supports JSON Schema for TOML completes and explains keys when the first line of the file is
`#:schema ./group.schema.json`.";

const ROS_EXAMPLES: &str = "Examples:
  omnibus group urdf groups/tcc-2.toml > tcc-2.urdf
  omnibus group nav2 groups/tcc-2.toml > nav2_params.yaml
  omnibus group localization groups/tcc-2.toml > ekf.yaml

docs/ros.md explains how to use them.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Writes a group file for your own robots; asks for everything that the options do not give.
    New(Box<new::Arguments>),
    /// Checks a group file and lists all errors.
    #[command(after_help = CHECK_EXAMPLES)]
    Check {
        /// The files.
        #[arg(required = true)]
        files: Vec<PathBuf>,
    },
    /// Draws the group seen from above.
    Draw(draw::Arguments),
    /// Shows every parameter that a group file would write into a robot.
    #[command(after_help = SHOW_EXAMPLES)]
    Show {
        /// The file.
        file: PathBuf,
        /// Node of the robot; by default all robots.
        #[arg(long, value_parser = super::robot)]
        node: Option<u8>,
    },
    /// Prints the JSON Schema of group files, for editors.
    #[command(after_help = SCHEMA_EXAMPLES)]
    Schema,
    /// Prints a robot model (URDF) of the group, for ROS.
    #[command(after_help = ROS_EXAMPLES)]
    Urdf {
        /// The file.
        file: PathBuf,
    },
    /// Prints parameters of Nav2 for the group.
    #[command(after_help = ROS_EXAMPLES)]
    Nav2(RosFile),
    /// Prints parameters of robot_localization for the group.
    #[command(after_help = ROS_EXAMPLES)]
    Localization(RosFile),
    /// Writes the group file into the robots and reads every value back.
    #[command(after_help = APPLY_EXAMPLES)]
    Apply {
        /// Also saves the values to the robots' flash.
        #[arg(long)]
        save: bool,
        #[command(flatten)]
        target: Target,
    },
}

#[derive(clap::Args)]
struct RosFile {
    /// The file.
    file: PathBuf,
    /// Prefix of the frames odom and base_link, as for `omnibus ros`.
    #[arg(long, value_name = "PREFIX", default_value = "", value_parser = ros::names::frame_prefix)]
    frame_prefix: String,
}

/// Messages of odometry per second that the filter expects, as `omnibus ros` publishes them.
const ODOMETRY_RATE: f64 = 50.0;

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    match &arguments.command {
        Command::New(arguments) => new::run(arguments),
        Command::Check { files } => check(files),
        Command::Draw(arguments) => draw::run(arguments),
        Command::Show { file, node } => show(&GroupFile::load(file)?, *node),
        Command::Schema => {
            write!(std::io::stdout().lock(), "{}", group::reference::schema())?;
            Ok(())
        }
        Command::Urdf { file } => print(&ros::urdf::urdf(&GroupFile::load(file)?)),
        Command::Nav2(RosFile { file, frame_prefix }) => {
            let group = GroupFile::load(file)?;
            print(&ros::nav2::params(&group, &Frames::new(frame_prefix)))
        }
        Command::Localization(RosFile { file, frame_prefix }) => {
            let (group, frames) = (GroupFile::load(file)?, Frames::new(frame_prefix));
            print(&ros::localization::params(
                &group.name,
                &frames,
                ODOMETRY_RATE,
            ))
        }
        Command::Apply { save, target } => apply(target, *save),
    }
}

fn print(text: &str) -> anyhow::Result<()> {
    write!(std::io::stdout().lock(), "{text}")?;
    Ok(())
}

fn check(files: &[PathBuf]) -> anyhow::Result<()> {
    let (mut good, mut problems, mut warnings) = (Vec::new(), Vec::new(), Vec::new());
    for file in files {
        let found = match Examination::of_file(file) {
            Ok(found) => found,
            Err(error) => Examination {
                group: None,
                errors: vec![error],
                warnings: Vec::new(),
            },
        };
        #[cfg(feature = "simulation")]
        let found = simulated(found, file);
        for error in &found.errors {
            print_line(error)?;
            problems.push(finding_json(error));
        }
        for warning in &found.warnings {
            print_line(format_args!("warning: {warning}"))?;
            warnings.push(finding_json(warning));
        }
        let Some(group) = found.group else { continue };
        let nodes: Vec<u8> = group.robots.iter().map(|robot| robot.node).collect();
        let robots = if nodes.len() == 1 { "robot" } else { "robots" };
        print_line(format_args!(
            "{}: group '{}', {} {robots}, nodes {nodes:?}: good",
            file.display(),
            group.name,
            nodes.len(),
        ))?;
        good.push(json!({"file": file.display().to_string(), "group": group.name, "nodes": nodes}));
    }
    if json() {
        print_json(&json!({"good": good, "problems": problems, "warnings": warnings}))?;
    }
    match problems.len() {
        0 => Ok(()),
        1 => Err(Found("1 problem found".into()).into()),
        count => Err(Found(format!("{count} problems found")).into()),
    }
}

/// The same, with what a simulated world says of the group.
#[cfg(feature = "simulation")]
fn simulated(mut found: Examination, file: &Path) -> Examination {
    let refusal = |group| omnibus::simulation::refusal(group, file);
    if let Some(error) = found.group.as_ref().and_then(refusal) {
        found.group = None;
        found.errors.push(error);
    }
    found
}

fn finding_json(error: &GroupError) -> serde_json::Value {
    json!({"file": error.file, "line": error.line, "key": error.field, "problem": error.problem,
           "remedy": error.remedy})
}

fn show(group: &GroupFile, node: Option<u8>) -> anyhow::Result<()> {
    let robots: Vec<_> = group
        .robots
        .iter()
        .filter(|robot| node.is_none_or(|node| node == robot.node))
        .collect();
    if robots.is_empty() {
        bail!("--node {}: the group has no such robot", node.unwrap_or(0));
    }
    if json() {
        let robots = robots.iter().map(|robot| {
            let parameters = configure::parameters(group, robot, true);
            let objects = parameters.iter().map(|(at, value)| {
                json!({"object": at.to_string(), "name": sdo::name(*at), "value": sdo::show(*value),
                       "unit": sdo::unit(*at)})
            });
            json!({"node": robot.node, "parameters": objects.collect::<Vec<_>>()})
        });
        let robots: Vec<_> = robots.collect();
        return print_json(&json!({"group": group.name, "robots": robots}));
    }
    let mut header = ["object", "name", "unit"].map(str::to_owned).to_vec();
    header.extend(robots.iter().map(|robot| format!("node {}", robot.node)));
    let mut table = output::table(header.iter().map(String::as_str));
    let columns: Vec<_> = robots
        .iter()
        .map(|robot| configure::parameters(group, robot, true))
        .collect();
    for (row, (at, _)) in columns[0].iter().enumerate() {
        let mut cells = vec![
            at.to_string(),
            sdo::full_name(*at),
            sdo::unit(*at).to_owned(),
        ];
        cells.extend(columns.iter().map(|column| sdo::show(column[row].1)));
        table.add_row(cells);
    }
    print_line(&table)?;
    Ok(())
}

fn apply(target: &Target, save: bool) -> anyhow::Result<()> {
    let file = target.group()?;
    let (mut group, _) = super::configured(target, &file)?;
    let counts: Vec<_> = file
        .robots
        .iter()
        .map(|robot| (robot.node, configure::parameters(&file, robot, true).len()))
        .collect();
    if save {
        for (node, _) in &counts {
            group.wire().save(*node)?;
        }
    }
    if json() {
        let robots = counts
            .iter()
            .map(|(node, count)| json!({"node": node, "written": count}));
        let robots: Vec<_> = robots.collect();
        return print_json(&json!({"group": file.name, "stored": save, "robots": robots}));
    }
    for (node, count) in counts {
        print_line(format_args!(
            "node {node}: {count} parameters written and read back{}",
            if save { ", stored" } else { "" }
        ))?;
    }
    if !save {
        print_note("the robots lose these values at power-off; --save keeps them");
    }
    Ok(())
}
