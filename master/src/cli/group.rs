//! `omnibus group check|show|apply`: group files, and how they get into the robots.

use std::path::PathBuf;

use anyhow::bail;
use comfy_table::{Table, presets};
use group::GroupFile;
use omnibus::Group;
use omnibus::session::{configure, sdo};
use serde_json::json;

use super::{Target, json, note, print_json, say};

const EXAMPLES: &str = "Examples:
  omnibus group check groups/*.toml
  omnibus group show groups/tcc-2.toml --node 3
  omnibus group apply --group groups/tcc-2.toml --bus socketcan:can0 --save";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Says whether a group file is good, and what is wrong with it otherwise.
    #[command(after_help = EXAMPLES)]
    Check {
        /// The files.
        #[arg(required = true)]
        files: Vec<PathBuf>,
    },
    /// Shows every parameter that a group file would write into a robot.
    #[command(after_help = EXAMPLES)]
    Show {
        /// The file.
        file: PathBuf,
        /// Node of the robot; all robots otherwise.
        #[arg(long)]
        node: Option<u8>,
    },
    /// Writes the group file into the robots and reads every value back.
    #[command(after_help = EXAMPLES)]
    Apply {
        /// Stores it in the robots' flash too.
        #[arg(long)]
        save: bool,
        #[command(flatten)]
        target: Target,
    },
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    match &arguments.command {
        Command::Check { files } => check(files),
        Command::Show { file, node } => show(&GroupFile::load(file)?, *node),
        Command::Apply { save, target } => apply(target, *save),
    }
}

fn check(files: &[PathBuf]) -> anyhow::Result<()> {
    let mut good = Vec::new();
    for file in files {
        let group = GroupFile::load(file)?;
        let nodes: Vec<u8> = group.robots.iter().map(|robot| robot.node).collect();
        say(format_args!(
            "{}: group '{}', {} robots, nodes {nodes:?}: good",
            file.display(),
            group.name,
            nodes.len(),
        ))?;
        good.push(json!({"file": file.display().to_string(), "group": group.name, "nodes": nodes}));
    }
    if json() {
        print_json(&json!({"good": good}))?;
    }
    Ok(())
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
                json!({"object": at.to_string(), "name": sdo::name(*at), "value": sdo::show(*value)})
            });
            json!({"node": robot.node, "parameters": objects.collect::<Vec<_>>()})
        });
        let robots: Vec<_> = robots.collect();
        return print_json(&json!({"group": group.name, "robots": robots}));
    }
    let mut table = Table::new();
    table.load_style(presets::UTF8_FULL_CONDENSED);
    let mut header = vec!["object".to_owned()];
    header.extend(robots.iter().map(|robot| format!("node {}", robot.node)));
    table.set_header(header);
    let columns: Vec<_> = robots
        .iter()
        .map(|robot| configure::parameters(group, robot, true))
        .collect();
    for (row, (at, _)) in columns[0].iter().enumerate() {
        let mut cells = vec![sdo::name(*at)];
        cells.extend(columns.iter().map(|column| sdo::show(column[row].1)));
        table.add_row(cells);
    }
    say(&table)?;
    Ok(())
}

fn apply(target: &Target, save: bool) -> anyhow::Result<()> {
    let file = target.group()?;
    let mut group = Group::connect(target.command(&file)?, &file)?;
    group.configure(true)?;
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
        say(format_args!(
            "node {node}: {count} parameters written and read back{}",
            if save { ", stored" } else { "" }
        ))?;
    }
    if !save {
        note("until power-off; --save keeps them in the robots");
    }
    Ok(())
}
