//! `omnibus group check|show`: group files, without a bus.

use std::path::PathBuf;

use comfy_table::{Table, presets};
use group::GroupFile;
use omnibus::{configure, sdo};
use serde_json::json;

use super::say;

#[derive(clap::Subcommand)]
pub enum Command {
    /// Says whether a group file is good, and what is wrong with it otherwise.
    Check {
        /// The files.
        #[arg(required = true)]
        files: Vec<PathBuf>,
    },
    /// Shows every parameter that a group file would write into a robot.
    Show {
        /// The file.
        file: PathBuf,
        /// Node of the robot; all robots otherwise.
        #[arg(long)]
        node: Option<u8>,
        /// Prints JSON.
        #[arg(long)]
        json: bool,
    },
}

pub fn run(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Check { files } => {
            for file in files {
                let group = GroupFile::load(file)?;
                say(format_args!(
                    "{}: group '{}', {} robots, nodes {:?}: good",
                    file.display(),
                    group.name,
                    group.robots.len(),
                    group.robots.iter().map(|r| r.node).collect::<Vec<_>>(),
                ))?;
            }
            Ok(())
        }
        Command::Show { file, node, json } => show(&GroupFile::load(file)?, *node, *json),
    }
}

fn show(group: &GroupFile, node: Option<u8>, json: bool) -> anyhow::Result<()> {
    let robots: Vec<_> = group
        .robots
        .iter()
        .filter(|robot| node.is_none_or(|node| node == robot.node))
        .collect();
    if robots.is_empty() {
        anyhow::bail!("--node {}: the group has no such robot", node.unwrap_or(0));
    }
    if json {
        let robots = robots.iter().map(|robot| {
            let parameters = configure::parameters(group, robot, true);
            let objects = parameters.iter().map(|(at, value)| {
                json!({"object": at.to_string(), "name": sdo::name(*at), "value": sdo::show(*value)})
            });
            json!({"node": robot.node, "parameters": objects.collect::<Vec<_>>()})
        });
        let robots: Vec<_> = robots.collect();
        return super::print_json(&json!({"group": group.name, "robots": robots}));
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
