//! The PDOs of all robots as a DBC, for tools that decode recorded traffic.

use core::fmt::{Result, Write};

use super::scale;
use crate::object::Kind;
use crate::pdos::PDOS;
use crate::{FIRST_ROBOT, Fault, LAST_ROBOT, Limit, MemberState};

/// Writes the DBC.
///
/// # Errors
/// Those of the writer.
pub fn dbc<W: Write>(out: &mut W) -> Result {
    writeln!(out, "VERSION \"{}\"\n", crate::WIRE_VERSION)?;
    writeln!(out, "NS_ :\n\nBS_:\n")?;
    write!(out, "BU_: Master")?;
    for node in FIRST_ROBOT..=LAST_ROBOT {
        write!(out, " Robot{node}")?;
    }
    writeln!(out, "\n")?;
    for pdo in PDOS {
        let name = pdo.name;
        let nodes = if pdo.broadcast {
            0..=0
        } else {
            FIRST_ROBOT..=LAST_ROBOT
        };
        for node in nodes {
            let id = pdo.cob_base + u16::from(node);
            match (pdo.broadcast, pdo.receive) {
                (true, _) => writeln!(out, "BO_ {id} {name}: 8 Master")?,
                (false, true) => writeln!(out, "BO_ {id} {name}{node}: 8 Master")?,
                (false, false) => writeln!(out, "BO_ {id} {name}{node}: 8 Robot{node}")?,
            }
            let mut bit = 0;
            for object in pdo.objects() {
                let bits = object.kind.bytes() * 8;
                let sign = match object.kind {
                    Kind::I16 | Kind::I24 | Kind::F32 => '-',
                    Kind::U8 | Kind::U16 | Kind::U32 | Kind::Domain => '+',
                };
                let (factor, unit) = scale(object.unit);
                write!(out, " SG_ ")?;
                for character in object.name.chars() {
                    out.write_char(if character == ' ' { '_' } else { character })?;
                }
                writeln!(
                    out,
                    " : {bit}|{bits}@1{sign} ({factor},0) [0|0] \"{unit}\" Vector__XXX"
                )?;
                bit += bits;
            }
            writeln!(out)?;
        }
    }
    for node in FIRST_ROBOT..=LAST_ROBOT {
        let id = crate::cob::member_status(node);
        write!(out, "VAL_ {id} State")?;
        for state in MemberState::ALL {
            write!(out, " {} \"{state:?}\"", state as u8)?;
        }
        writeln!(out, " ;")?;
        write!(out, "VAL_ {id} Limit_or_fault 0 \"None\"")?;
        for limit in Limit::ALL {
            write!(out, " {} \"{}\"", limit.code(), limit.name())?;
        }
        for fault in Fault::ALL {
            write!(out, " {} \"{}\"", fault.code(), fault.name())?;
        }
        writeln!(out, " ;")?;
    }
    Ok(())
}
