//! `omnibus param`: the robots' object dictionary, by address or name.

use std::path::PathBuf;

use anyhow::{Context as _, bail};
use omnibus::bus::link::Link;
use omnibus::bus::wire::Wire;
use omnibus::error::MasterError;
use omnibus::session::{configure, sdo};
use protocol::object::Access;
use protocol::{Address, Code, Kind, MemberState, OBJECTS, Object, Value, address};
use serde_json::json;

use super::output::Found;
use super::param_file::Parameters;
use super::param_text::{find, parse};
use super::{
    Target, Usage, abort_on_ctrl_c, communication, json, output, param_file, print_json,
    print_line, print_note,
};

const EXAMPLES: &str = "Examples:
  omnibus param list wheel
  omnibus param get 2010:3 --node 3 --bus socketcan:can0
  omnibus param get 'wheel radius' --node 3 --bus socketcan:can0
  omnibus param set 2031:1 1.5 --node 3 --bus socketcan:can0
  omnibus param dump --node 3 --output node-3.toml --bus socketcan:can0
  omnibus param load node-3.toml --node 3 --bus socketcan:can0
  omnibus param diff --bus socketcan:can0 --group groups/tcc-2.toml
  omnibus param diff node-3.toml --node 3 --bus socketcan:can0
  omnibus param save --node 3 --bus socketcan:can0

A simulated bus (sim:) starts from the beginning with every command, so values that are set there are lost. To try
these commands on robots that remain, start `omnibus-sim serve` and use its slcan-tcp address.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Args)]
struct At {
    /// Node of the robot.
    #[arg(long, value_parser = super::robot)]
    node: u8,
    #[command(flatten)]
    target: Target,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Lists the objects of a robot: address, type, unit, limits, meaning. Needs no bus.
    #[command(after_help = "Example:\n  omnibus param list wheel")]
    List {
        /// Lists only objects whose name, address or meaning contains this text.
        filter: Option<String>,
    },
    /// Reads one object of one robot.
    #[command(
        after_help = "Examples:\n  omnibus param get 2010:3 --node 3 --bus socketcan:can0\n  omnibus param get 'wheel radius' --node 3 --bus socketcan:can0\n  omnibus param get 1017 --node 3 --bus socketcan:can0"
    )]
    Get {
        /// Address such as 2010:3, or name such as 'wheel radius'. Communication objects, such as
        /// 1017, have only an address.
        object: String,
        #[command(flatten)]
        at: At,
    },
    /// Writes one object of one robot and reads it back.
    #[command(
        after_help = "Example:\n  omnibus param set 2031:1 1.5 --node 3 --bus socketcan:can0"
    )]
    Set {
        /// Address such as 2010:3, or name.
        object: String,
        /// The value.
        #[arg(allow_negative_numbers = true)]
        value: String,
        #[command(flatten)]
        at: At,
    },
    /// Reads all parameters of one robot into a file.
    #[command(
        after_help = "Example:\n  omnibus param dump --node 3 --output node-3.toml --bus socketcan:can0"
    )]
    Dump {
        /// The file; an existing one is replaced. By default standard output.
        #[arg(long, short)]
        output: Option<PathBuf>,
        #[command(flatten)]
        at: At,
    },
    /// Writes the parameters of a file into a robot and reads them back.
    #[command(
        after_help = "Example:\n  omnibus param load node-3.toml --node 3 --bus socketcan:can0"
    )]
    Load {
        /// The file, as `dump` writes it.
        file: PathBuf,
        #[command(flatten)]
        at: At,
    },
    /// Compares the robots with the group file, or one robot with a file; exits with code 6 if they
    /// differ.
    #[command(
        after_help = "Examples:\n  omnibus param diff --bus socketcan:can0 --group groups/tcc-2.toml\n  omnibus param diff node-3.toml --node 3 --bus socketcan:can0"
    )]
    Diff {
        /// A file as `dump` writes it; by default the group file.
        file: Option<PathBuf>,
        /// Node of the robot; by default all of the group file.
        #[arg(long, value_parser = super::robot)]
        node: Option<u8>,
        #[command(flatten)]
        target: Target,
    },
    /// Stores the parameters in a robot's flash, so that they survive power-off.
    #[command(after_help = "Example:\n  omnibus param save --node 3 --bus socketcan:can0")]
    Save {
        #[command(flatten)]
        at: At,
    },
    /// Restores the default parameters at the robot's next reset.
    #[command(
        after_help = "Examples:\n  omnibus param restore --node 3 --bus socketcan:can0\n  omnibus reset --node 3 --bus socketcan:can0"
    )]
    Restore {
        #[command(flatten)]
        at: At,
    },
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    match &arguments.command {
        Command::List { filter } => list(filter.as_deref()),
        Command::Get { object, at } => {
            if let Some(address) = communication::find(object) {
                return communication::get(address, at.node, || at.target.visit());
            }
            let object = find(object).map_err(wrong)?;
            let mut wire = at.target.visit()?;
            if object.kind == Kind::Domain {
                let bytes = param_file::hex(&wire.read_block(at.node, object.address)?);
                return print_value(at.node, object, &json!(bytes));
            }
            let value = wire.read(at.node, object.address, object.kind)?;
            print_value(at.node, object, &number(value))
        }
        Command::Set { object, value, at } => set(object, value, at),
        Command::Dump { output, at } => dump(output.as_ref(), at),
        Command::Load { file, at } => load(file, at),
        Command::Diff { file, node, target } => match file {
            Some(file) => diff_file(file, *node, target),
            None => diff_group(*node, target),
        },
        Command::Save { at } => {
            at.target.visit()?.save(at.node)?;
            done(at.node, "has stored its parameters")
        }
        Command::Restore { at } => {
            at.target.visit()?.restore(at.node)?;
            let next = format!("after the next `omnibus reset --node {}`", at.node);
            done(at.node, &format!("will have its default parameters {next}"))
        }
    }
}

fn done(node: u8, what: &str) -> anyhow::Result<()> {
    if json() {
        return print_json(&json!({"node": node, "done": what}));
    }
    print_line(format_args!("node {node} {what}"))
}

/// What people read.
fn text(value: &serde_json::Value) -> String {
    match value {
        serde_json::Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

/// A number where the value is one.
fn number(value: Value) -> serde_json::Value {
    serde_json::from_str(&sdo::show(value)).unwrap_or_else(|_| json!(sdo::show(value)))
}

/// What a number stands for, where it is a state or a code.
fn meaning(object: &Object, value: &serde_json::Value) -> Option<String> {
    let number = u16::try_from(value.as_u64()?).ok()?;
    let of_code = || match Code::from_code(number) {
        Some(Code::None) => Some("none".to_owned()),
        Some(Code::Limit(limit)) => Some(limit.name().to_owned()),
        Some(Code::Fault(fault)) => Some(fault.name().to_owned()),
        None => None,
    };
    match object.address {
        address::STATE => {
            let state = MemberState::try_from(u8::try_from(number).ok()?).ok()?;
            Some(format!("{state:?}"))
        }
        address::STATUS_CODE => of_code(),
        // The last faults, and the last limits.
        Address {
            index: 0x2122 | 0x2124,
            ..
        } => of_code(),
        _ => None,
    }
}

fn print_value(node: u8, object: &Object, value: &serde_json::Value) -> anyhow::Result<()> {
    let meaning = meaning(object, value);
    if json() {
        return print_json(&json!({"node": node, "object": object.address.to_string(),
            "name": object.name, "value": value, "unit": object.unit, "meaning": meaning}));
    }
    let line = format!(
        "{} = {} {}",
        sdo::name(object.address),
        text(value),
        meaning.map_or_else(|| object.unit.to_owned(), |meaning| format!("({meaning})"))
    );
    print_line(line.trim_end())
}

/// What is wrong with an object or a value on the command line.
fn wrong(error: anyhow::Error) -> Usage {
    Usage(format!("{error:#}"))
}

fn set(object: &str, value: &str, at: &At) -> anyhow::Result<()> {
    let object = find(object).map_err(wrong)?;
    if matches!(object.access, Access::Const | Access::ReadOnly) {
        usage!("{} can only be read", sdo::name(object.address));
    }
    let value = parse(object, value).map_err(wrong)?;
    let mut wire = at.target.visit()?;
    wire.write_checked(at.node, object.address, value)?;
    print_value(at.node, object, &number(value))?;
    if object.persistent {
        print_note(format_args!(
            "until power-off; `omnibus param save --node {}` keeps it",
            at.node
        ));
    }
    Ok(())
}

fn list(filter: Option<&str>) -> anyhow::Result<()> {
    let wanted = |object: &&Object| {
        filter.is_none_or(|filter| {
            let text = format!("{} {} {}", object.address, object.name, object.text);
            text.to_lowercase().contains(&filter.to_lowercase())
        })
    };
    let objects: Vec<_> = OBJECTS.iter().filter(wanted).collect();
    if objects.is_empty() {
        bail!(
            "no object has '{}' in its name or meaning",
            filter.unwrap_or_default()
        );
    }
    if json() {
        let objects = objects.iter().map(|object| {
            json!({"object": object.address.to_string(), "name": object.name,
                   "type": object.kind.name(), "access": object.access.eds(), "unit": object.unit,
                   "min": number(object.min), "max": number(object.max),
                   "default": number(object.default), "text": object.text})
        });
        return print_json(&json!({"objects": objects.collect::<Vec<_>>()}));
    }
    let mut table = output::table(["object", "name", "type", "range", "default", "unit"]);
    for object in &objects {
        let writable = matches!(object.access, Access::ReadWrite | Access::Parameter);
        let limit = |value: Value| {
            if writable {
                sdo::show(value)
            } else {
                String::new()
            }
        };
        table.add_row([
            object.address.to_string(),
            sdo::full_name(object.address),
            format!("{} {}", object.kind.name(), object.access.eds()),
            if writable && object.kind != Kind::Domain {
                format!("{} to {}", sdo::show(object.min), sdo::show(object.max))
            } else {
                String::new()
            },
            limit(object.default),
            object.unit.to_owned(),
        ]);
    }
    print_line(&table)?;
    if let [only] = objects[..] {
        print_line(only.text)?;
    }
    Ok(())
}

fn dump(output: Option<&PathBuf>, at: &At) -> anyhow::Result<()> {
    if let Some(path) = output {
        at.target.check_output("--output", path)?;
    }
    let mut wire = at.target.visit()?;
    let serial = wire
        .read(at.node, address::SERIAL_NUMBER, Kind::U32)?
        .to_bits();
    let (mut values, mut blocks) = (Vec::new(), Vec::new());
    for object in param_file::objects() {
        if object.kind == Kind::Domain {
            blocks.push((object, wire.read_block(at.node, object.address)?));
        } else {
            values.push((object, wire.read(at.node, object.address, object.kind)?));
        }
    }
    let text = param_file::write(at.node, serial, &values, &blocks);
    if let Some(path) = output {
        omnibus::file::replace(path, &text)
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    if json() {
        let line = |object: &Object, value: serde_json::Value| {
            json!({"object": object.address.to_string(), "name": object.name, "value": value,
                   "unit": object.unit})
        };
        let values = values
            .iter()
            .map(|(object, value)| line(object, number(*value)));
        let blocks = blocks
            .iter()
            .map(|(object, bytes)| line(object, json!(param_file::hex(bytes))));
        let parameters: Vec<_> = values.chain(blocks).collect();
        return print_json(&json!({"node": at.node, "serial": serial, "parameters": parameters}));
    }
    match output {
        Some(path) => {
            let count = values.len() + blocks.len();
            print_line(format_args!("{count} parameters in {}", path.display()))
        }
        None => print_line(text.trim_end()),
    }
}

/// Reads a file, and says what becomes of the parameters that it lacks: it may have been cut short.
fn read(file: &std::path::Path, others: &str) -> anyhow::Result<Parameters> {
    let parameters = param_file::read(file)?;
    let all = param_file::objects().count();
    let lacks = all.saturating_sub(parameters.count());
    if lacks > 0 {
        let file = file.display();
        print_note(format_args!(
            "{file} lacks {lacks} of a robot's {all} parameters; those {others}"
        ));
    }
    Ok(parameters)
}

fn load(file: &std::path::Path, at: &At) -> anyhow::Result<()> {
    let parameters = read(file, "remain as they are")?;
    let mut wire = at.target.visit()?;
    if let Some(node) = parameters.node
        && node != at.node
    {
        print_note(format_args!(
            "the file was read from node {node}; its mount and group are now written into node {}",
            at.node
        ));
    }
    // From here on it is completed, whatever is pressed.
    let _ = abort_on_ctrl_c()?;
    for (object, value) in &parameters.values {
        wire.write_checked(at.node, *object, *value)?;
    }
    for (object, bytes) in &parameters.blocks {
        wire.write_block(at.node, *object, bytes)?;
    }
    let count = parameters.count();
    if json() {
        return print_json(&json!({"node": at.node, "written": count}));
    }
    print_line(format_args!(
        "node {}: {count} parameters written and read back",
        at.node
    ))?;
    print_note(format_args!(
        "until power-off; `omnibus param save --node {}` keeps them",
        at.node
    ));
    Ok(())
}

/// One value that is not as it should be.
struct Difference {
    node: u8,
    at: Address,
    found: serde_json::Value,
    wanted: serde_json::Value,
}

fn differences<L: Link>(
    wire: &mut Wire<L>,
    node: u8,
    wanted: &[(Address, Value)],
    blocks: &[(Address, Vec<u8>)],
    out: &mut Vec<Difference>,
) -> Result<(), MasterError> {
    for (at, wanted) in wanted {
        let found = wire.read(node, *at, wanted.kind())?;
        if found.to_bits() != wanted.to_bits() {
            out.push(Difference {
                node,
                at: *at,
                found: number(found),
                wanted: number(*wanted),
            });
        }
    }
    for (at, wanted) in blocks {
        let found = wire.read_block(node, *at)?;
        if found != *wanted {
            out.push(Difference {
                node,
                at: *at,
                found: json!(param_file::hex(&found)),
                wanted: json!(param_file::hex(wanted)),
            });
        }
    }
    Ok(())
}

fn diff_file(file: &std::path::Path, node: Option<u8>, target: &Target) -> anyhow::Result<()> {
    let parameters = read(file, "are not compared")?;
    let Some(node) = node.or(parameters.node) else {
        usage!(
            "--node is missing; it says which robot to compare with {}",
            file.display()
        );
    };
    let mut found = Vec::new();
    differences(
        &mut target.visit()?,
        node,
        &parameters.values,
        &parameters.blocks,
        &mut found,
    )?;
    judge(&found, "the file")
}

fn diff_group(node: Option<u8>, target: &Target) -> anyhow::Result<()> {
    let group = target.group()?;
    let mut wire = Wire::visiting(target.link(&group)?);
    let mut found = Vec::new();
    let robots = group
        .robots
        .iter()
        .filter(|r| node.is_none_or(|node| node == r.node));
    let mut compared = 0;
    for robot in robots {
        let wanted = configure::parameters(&group, robot, true);
        let set = configure::compensation_set(robot, true)?;
        let blocks = [(address::COMPENSATION_SET, set)];
        differences(&mut wire, robot.node, &wanted, &blocks, &mut found)?;
        compared += 1;
    }
    if compared == 0 {
        bail!("--node {}: the group has no such robot", node.unwrap_or(0));
    }
    judge(&found, "the group file")
}

fn judge(found: &[Difference], what: &str) -> anyhow::Result<()> {
    if json() {
        let differences = found.iter().map(|one| {
            json!({"node": one.node, "object": one.at.to_string(), "name": sdo::name(one.at),
                   "robot": one.found, "wanted": one.wanted})
        });
        let differences: Vec<_> = differences.collect();
        print_json(&json!({"differences": differences}))?;
    }
    for one in found {
        let line = format!(
            "node {}: {} ({}) is {}, {what} has {} {}",
            one.node,
            sdo::full_name(one.at),
            one.at,
            text(&one.found),
            text(&one.wanted),
            sdo::unit(one.at),
        );
        print_line(line.trim_end())?;
    }
    if found.is_empty() {
        return print_line(format_args!("all parameters are as in {what}"));
    }
    let differ = match found.len() {
        1 => "1 parameter differs".to_owned(),
        count => format!("{count} parameters differ"),
    };
    Err(Found(format!(
        "{differ}; `omnibus group apply` writes the group file into the robots, `omnibus param \
         load` a file"
    ))
    .into())
}
