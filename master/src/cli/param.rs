//! `omnibus param list|get|set|diff`: the robots' object dictionary, by name or address.

use anyhow::{Context as _, bail};
use comfy_table::{Table, presets};
use omnibus::{configure, sdo, wire::Wire};
use protocol::object::Access;
use protocol::{Address, Kind, OBJECTS, Object, Value};

use super::{Target, say};

#[derive(clap::Subcommand)]
pub enum Command {
    /// Lists every object a robot has: address, type, unit, limits, meaning. Needs no bus.
    List,
    /// Reads one object of one robot.
    Get {
        /// Address such as 2010:3.
        object: String,
        /// Node of the robot.
        #[arg(long)]
        node: u8,
        #[command(flatten)]
        target: Target,
    },
    /// Writes one object of one robot and reads it back.
    Set {
        /// Address such as 2010:3.
        object: String,
        /// The value.
        value: String,
        /// Node of the robot.
        #[arg(long)]
        node: u8,
        #[command(flatten)]
        target: Target,
    },
    /// Compares the robots with the group file.
    Diff {
        #[command(flatten)]
        target: Target,
    },
}

/// The object at an address written as `2010:3`.
fn find(text: &str) -> anyhow::Result<&'static Object> {
    let (index, sub) = text.split_once(':').unwrap_or((text, "0"));
    let parsed = u16::from_str_radix(index.trim_start_matches("0x"), 16)
        .ok()
        .zip(u8::from_str_radix(sub, 16).ok());
    let Some((index, sub)) = parsed else {
        bail!("'{text}' is no address; write index and sub-index in hex, such as 2010:3");
    };
    let at = Address::new(index, sub);
    OBJECTS
        .iter()
        .find(|object| object.address == at)
        .with_context(|| format!("there is no object {at}; `omnibus param list` shows all"))
}

fn parse(kind: Kind, text: &str) -> anyhow::Result<Value> {
    let wrong = || format!("'{text}' is no {}", kind.name());
    Ok(match kind {
        Kind::I16 => Value::I16(text.parse().with_context(wrong)?),
        Kind::U8 => Value::U8(text.parse().with_context(wrong)?),
        Kind::U16 => Value::U16(text.parse().with_context(wrong)?),
        Kind::U32 => Value::U32(text.parse().with_context(wrong)?),
        Kind::F32 => Value::F32(text.parse().with_context(wrong)?),
        Kind::I24 => Value::I24(text.parse().with_context(wrong)?),
    })
}

pub fn run(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::List => list()?,
        Command::Get {
            object,
            node,
            target,
        } => {
            let object = find(object)?;
            let mut wire = Wire::visiting(target.link(&target.group()?)?);
            let value = wire.read(*node, object.address, object.kind)?;
            say(format_args!(
                "{} = {} {}",
                sdo::name(object.address),
                sdo::show(value),
                object.unit
            ))?;
        }
        Command::Set {
            object,
            value,
            node,
            target,
        } => {
            let object = find(object)?;
            let value = parse(object.kind, value)?;
            if matches!(object.access, Access::Const | Access::ReadOnly) {
                bail!("{} can only be read", sdo::name(object.address));
            }
            value.check(object.min, object.max).map_err(|error| {
                anyhow::anyhow!(
                    "{} = {}: {error}; give {} to {} {}",
                    sdo::name(object.address),
                    sdo::show(value),
                    sdo::show(object.min),
                    sdo::show(object.max),
                    object.unit,
                )
            })?;
            let mut wire = Wire::visiting(target.link(&target.group()?)?);
            wire.write_checked(*node, object.address, value)?;
            say(format_args!(
                "{} = {} {}",
                sdo::name(object.address),
                sdo::show(value),
                object.unit
            ))?;
        }
        Command::Diff { target } => diff(target)?,
    }
    Ok(())
}

fn list() -> anyhow::Result<()> {
    let mut table = Table::new();
    table.load_style(presets::UTF8_FULL_CONDENSED);
    table.set_header([
        "object", "name", "type", "access", "unit", "from", "to", "default",
    ]);
    for object in OBJECTS {
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
            object.name.to_owned(),
            object.kind.name().to_owned(),
            object.access.eds().to_owned(),
            object.unit.to_owned(),
            limit(object.min),
            limit(object.max),
            limit(object.default),
        ]);
    }
    say(&table)
}

fn diff(target: &Target) -> anyhow::Result<()> {
    let group = target.group()?;
    let mut wire = Wire::visiting(target.link(&group)?);
    let mut differences = 0;
    for robot in &group.robots {
        for (at, wanted) in configure::parameters(&group, robot, true) {
            let found = wire.read(robot.node, at, wanted.kind())?;
            if found.to_bits() != wanted.to_bits() {
                differences += 1;
                say(format_args!(
                    "node {}: {} is {}, the group file has {}",
                    robot.node,
                    sdo::name(at),
                    sdo::show(found),
                    sdo::show(wanted),
                ))?;
            }
        }
    }
    if differences > 0 {
        bail!(
            "{differences} parameters differ; `omnibus follow` and `omnibus drive` write the file's"
        );
    }
    say("all robots hold what the group file says")?;
    Ok(())
}
