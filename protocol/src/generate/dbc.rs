//! The PDOs of all robots, SYNC, emergency messages and heartbeats as a DBC, for tools that decode
//! recorded traffic.

use core::fmt::{Result, Write};
use core::ops::RangeInclusive;

use super::scale;
use crate::object::{Kind, Object, Value};
use crate::pdos::{PDOS, Pdo};
use crate::scaling::{INVALID_I16, INVALID_I24, INVALID_U8};
use crate::{FIRST_ROBOT, Fault, GyroState, LAST_ROBOT, Limit, MASTER, MemberState, address, cob};

/// The nodes that a PDO has identifiers of; 0 for one that all of them receive.
fn nodes(pdo: &Pdo) -> RangeInclusive<u8> {
    match pdo.broadcast {
        true => 0..=0,
        false => FIRST_ROBOT..=LAST_ROBOT,
    }
}

/// The name of a signal has no blanks.
fn signal<W: Write>(out: &mut W, object: &Object) -> Result {
    for character in object.name.chars() {
        out.write_char(if character == ' ' { '_' } else { character })?;
    }
    Ok(())
}

/// The bit pattern that stands for no value, as [`crate::scaling`] writes it.
fn invalid(object: &Object) -> Option<i32> {
    match object.kind {
        Kind::I16 => Some(i32::from(INVALID_I16)),
        Kind::I24 => Some(INVALID_I24),
        Kind::U8 if object.address == address::STATUS_SLIP => Some(i32::from(INVALID_U8)),
        _ => None,
    }
}

/// The lowest and the highest value, as transferred, without the pattern of an invalid one.
fn range(object: &Object) -> [i32; 2] {
    let [lowest, highest] = [object.min, object.max].map(|value| match value {
        Value::I16(value) => i32::from(value),
        Value::U8(value) => i32::from(value),
        Value::U16(value) => i32::from(value),
        Value::I24(value) => value,
        // Both ends 0: every number.
        Value::F32(_) => 0,
        // No PDO carries one of these.
        Value::U32(_) | Value::Domain => 0,
    });
    let pattern = invalid(object);
    [
        lowest + i32::from(pattern == Some(lowest)),
        highest - i32::from(pattern == Some(highest)),
    ]
}

/// Names the limits and faults that a signal holds.
fn codes<W: Write>(out: &mut W, id: u16, signal: &str) -> Result {
    write!(out, "VAL_ {id} {signal} 0 \"None\"")?;
    for limit in Limit::ALL {
        write!(out, " {} \"{}\"", limit.code(), limit.name())?;
    }
    for fault in Fault::ALL {
        write!(out, " {} \"{}\"", fault.code(), fault.name())?;
    }
    writeln!(out, " ;")
}

/// The messages of CiA 301 beside PDO, SDO and NMT.
fn services<W: Write>(out: &mut W) -> Result {
    writeln!(out, "BO_ {} SYNC: 1 Master", cob::SYNC)?;
    writeln!(
        out,
        " SG_ Counter : 0|8@1+ (1,0) [1|240] \"\" Vector__XXX\n"
    )?;
    for node in FIRST_ROBOT..=LAST_ROBOT {
        writeln!(
            out,
            "BO_ {} Emergency{node}: 8 Robot{node}",
            cob::emergency(node)
        )?;
        writeln!(out, " SG_ Code : 0|16@1+ (1,0) [0|65535] \"\" Vector__XXX")?;
        writeln!(
            out,
            " SG_ Error_register : 16|8@1+ (1,0) [0|255] \"\" Vector__XXX\n"
        )?;
    }
    for node in MASTER..=LAST_ROBOT {
        write!(out, "BO_ {} Heartbeat{node}: 1 ", cob::heartbeat(node))?;
        match node {
            MASTER => writeln!(out, "Master")?,
            robot => writeln!(out, "Robot{robot}")?,
        }
        writeln!(
            out,
            " SG_ NMT_state : 0|8@1+ (1,0) [0|127] \"\" Vector__XXX\n"
        )?;
    }
    Ok(())
}

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
        let (name, bytes) = (pdo.name, pdo.bytes());
        for node in nodes(pdo) {
            let id = pdo.cob_base + u16::from(node);
            match (pdo.broadcast, pdo.receive) {
                (true, _) => writeln!(out, "BO_ {id} {name}: {bytes} Master")?,
                (false, true) => writeln!(out, "BO_ {id} {name}{node}: {bytes} Master")?,
                (false, false) => writeln!(out, "BO_ {id} {name}{node}: {bytes} Robot{node}")?,
            }
            let mut bit = 0;
            for object in pdo.objects() {
                let bits = object.kind.bytes() * 8;
                let sign = match object.kind {
                    Kind::I16 | Kind::I24 | Kind::F32 => '-',
                    Kind::U8 | Kind::U16 | Kind::U32 | Kind::Domain => '+',
                };
                let (steps, unit) = scale(object.unit);
                let factor = 1.0 / steps;
                let [lowest, highest] = range(object).map(|value| f64::from(value) / steps);
                write!(out, " SG_ ")?;
                signal(out, object)?;
                writeln!(
                    out,
                    " : {bit}|{bits}@1{sign} ({factor},0) [{lowest}|{highest}] \"{unit}\" \
                     Vector__XXX"
                )?;
                bit += bits;
            }
            writeln!(out)?;
        }
    }
    services(out)?;
    for pdo in PDOS {
        for node in nodes(pdo) {
            let id = pdo.cob_base + u16::from(node);
            for object in pdo.objects() {
                if let Some(pattern) = invalid(object) {
                    write!(out, "VAL_ {id} ")?;
                    signal(out, object)?;
                    writeln!(out, " {pattern} \"Invalid\" ;")?;
                }
            }
        }
    }
    for node in FIRST_ROBOT..=LAST_ROBOT {
        let id = cob::yaw_rate(node);
        write!(out, "VAL_ {id} State")?;
        for state in GyroState::ALL {
            write!(out, " {} \"{state:?}\"", state as u8)?;
        }
        writeln!(out, " ;")?;
        let id = cob::member_status(node);
        write!(out, "VAL_ {id} State")?;
        for state in MemberState::ALL {
            write!(out, " {} \"{state:?}\"", state as u8)?;
        }
        writeln!(out, " ;")?;
        codes(out, id, "Limit_or_fault")?;
        codes(out, cob::emergency(node), "Code")?;
    }
    for node in MASTER..=LAST_ROBOT {
        let id = cob::heartbeat(node);
        writeln!(
            out,
            "VAL_ {id} NMT_state 0 \"Initialising\" 4 \"Stopped\" 5 \"Operational\" \
             127 \"PreOperational\" ;"
        )?;
    }
    // The signal is a float of 32 bits.
    for node in FIRST_ROBOT..=LAST_ROBOT {
        let id = cob::yaw_rate(node);
        writeln!(out, "SIG_VALTYPE_ {id} Yaw_rate : 1;")?;
    }
    Ok(())
}
