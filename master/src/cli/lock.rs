//! `omnibus lock` and `omnibus unlock`: a key that guards parameters and images of robots.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use omnibus::bus::link::Link;
use omnibus::bus::wire::Wire;
use omnibus::commission::lock::{self, Key, LockState};
use omnibus::commission::survey::Survey;
use omnibus::error::MasterError;
use serde_json::json;

use super::output::Found;
use super::{Target, Usage, input, json, print_json, print_line, print_note};

const LOCK_EXAMPLES: &str = "Examples:
  omnibus lock --set-key lock.key --new --bus socketcan:can0     # a new key for all robots on the bus
  omnibus lock --bus socketcan:can0                              # locks robots that have a key
  omnibus lock --remove-key --bus socketcan:can0                 # robots must be unlocked

A locked robot refuses new parameters, node ids and updates; it drives and stops as before.
--set-key sends the key over the bus unencrypted, so connect nothing else to the bus then. If the key is
lost, only a debug probe helps (docs/security.md).";

const UNLOCK_EXAMPLES: &str = "Examples:
  omnibus unlock --key lock.key --bus socketcan:can0
  pass robots/key | omnibus unlock --key - --bus socketcan:can0

Robots lock themselves at every reset, and when nothing was written for ten minutes.";

#[derive(clap::Args)]
#[command(after_help = LOCK_EXAMPLES)]
pub struct Lock {
    /// Gives the robots the key in this file (- for standard input), and locks them.
    #[arg(long, value_name = "FILE", conflicts_with = "remove_key")]
    set_key: Option<PathBuf>,
    /// Creates that file with a new key; only your user can read it.
    #[arg(long, requires = "set_key")]
    new: bool,
    /// Removes the key from the robots, which must be unlocked.
    #[arg(long)]
    remove_key: bool,
    /// Node of the robot; by default all robots on the bus.
    #[arg(long, value_parser = super::robot)]
    node: Option<u8>,
    #[command(flatten)]
    target: Target,
}

#[derive(clap::Args)]
#[command(after_help = UNLOCK_EXAMPLES)]
pub struct Unlock {
    /// File with the key, - for standard input.
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    /// Node of the robot; by default all robots on the bus.
    #[arg(long, value_parser = super::robot)]
    node: Option<u8>,
    #[command(flatten)]
    target: Target,
}

type BusWire = Wire<Box<dyn Link>>;

/// `omnibus lock`.
pub fn run(arguments: &Lock) -> anyhow::Result<()> {
    let file = arguments.set_key.as_deref();
    if arguments.new && file == Some(Path::new("-")) {
        usage!("--new creates a file; give --set-key its name instead of -");
    }
    // Bad input is refused before anything else.
    let known = file.filter(|_| !arguments.new).map(read).transpose()?;
    let (mut wire, nodes) = robots(&arguments.target, arguments.node)?;
    let states = nodes
        .iter()
        .map(|node| lock::state(&mut wire, *node))
        .collect::<Result<Vec<_>, _>>()?;
    // Nothing is changed unless all can follow.
    for (node, state) in nodes.iter().zip(&states) {
        let changes = file.is_some() || arguments.remove_key;
        match state {
            LockState::Locked if changes => usage!(
                "node {node} is locked and has a key already; run `omnibus unlock --key FILE` first"
            ),
            LockState::NoKey if !changes => {
                usage!("node {node} has no key; `omnibus lock --set-key FILE` sets one")
            }
            _ => {}
        }
    }
    let key = match file {
        Some(path) if arguments.new => Some(new_key(path)?),
        _ => known,
    };
    for node in &nodes {
        if let Some(key) = &key {
            lock::set_key(&mut wire, *node, Some(key))?;
        }
        if arguments.remove_key {
            lock::set_key(&mut wire, *node, None)?;
        } else {
            lock::lock(&mut wire, *node)?;
        }
    }
    finish(&mut wire, &nodes)
}

/// `omnibus unlock`.
pub fn run_unlock(arguments: &Unlock) -> anyhow::Result<()> {
    let key = read(&arguments.key)?;
    let (mut wire, nodes) = robots(&arguments.target, arguments.node)?;
    for node in &nodes {
        lock::unlock(&mut wire, *node, &key)?;
    }
    finish(&mut wire, &nodes)
}

fn robots(target: &Target, only: Option<u8>) -> anyhow::Result<(BusWire, Vec<u8>)> {
    let mut wire = target.exclusive()?;
    let found = Survey::take(&mut wire, None)?.found;
    let mut nodes: Vec<u8> = found.iter().map(|robot| robot.node).collect();
    nodes.retain(|node| only.is_none_or(|only| only == *node));
    if nodes.is_empty() {
        return Err(match only {
            Some(node) => MasterError::NodeSilent { node }.into(),
            None => Found(format!("no robot answers on {}", target.bus)).into(),
        });
    }
    Ok((wire, nodes))
}

/// Says how the robots are now.
fn finish(wire: &mut BusWire, nodes: &[u8]) -> anyhow::Result<()> {
    let mut all = Vec::new();
    for node in nodes {
        let state = match lock::state(wire, *node)? {
            LockState::NoKey => "without a key",
            LockState::Locked => "locked",
            LockState::Unlocked => "unlocked",
        };
        if json() {
            all.push(json!({"node": node, "lock": state}));
        } else {
            print_line(format_args!("node {node} is {state}"))?;
        }
    }
    if json() {
        return print_json(&json!({"robots": all}));
    }
    Ok(())
}

fn read(path: &Path) -> anyhow::Result<Key> {
    let give = "the file with the key; `omnibus lock --set-key FILE --new` makes one";
    let bytes = if path == Path::new("-") {
        let read = ::group::input::limited(std::io::stdin().lock(), input::LARGEST);
        input::named(read, path, give)?
    } else {
        input::bytes(path, give)?
    };
    lock::key(&bytes).map_err(|problem| Usage(format!("{}: {problem}", path.display())).into())
}

fn new_key(path: &Path) -> anyhow::Result<Key> {
    let mut key = Key::default();
    getrandom::fill(&mut key).context("the system has no random numbers")?;
    let mut options = std::fs::OpenOptions::new();
    // Never over another key.
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut file = options.open(path).map_err(|error| {
        let remedy = match error.kind() {
            std::io::ErrorKind::AlreadyExists => "; without --new this key is set",
            _ => "",
        };
        anyhow::anyhow!("cannot create {} ({error}){remedy}", path.display())
    })?;
    // On the disk before a robot has it, and never a part of it.
    if let Err(error) = file.write_all(&key).and_then(|()| file.sync_all()) {
        let _ = std::fs::remove_file(path);
        return Err(error).with_context(|| format!("cannot write {}", path.display()));
    }
    print_note(format_args!(
        "Keep a copy of {}: without it only a debug probe unlocks the robots.",
        path.display()
    ));
    Ok(key)
}
