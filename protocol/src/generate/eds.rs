//! The electronic data sheet (CiA 306) of a robot.
//!
//! The objects from 0x2000 on, and those of a program download, come from the object table. Those
//! of the communication are written by the caller, which has the robot's CANopen device
//! (`canopen::eds`), with a list that has the former, too
//! ([`PROFILE_OBJECTS`](crate::table::PROFILE_OBJECTS)).

use core::fmt::{Result, Write};

use super::Shown;
use crate::pdos::PDOS;
use crate::table::{OBJECTS, RECORDS};
use crate::{Access, Kind, Object};

/// Writes the EDS; `communication` writes the lists of mandatory and optional objects in it.
///
/// # Errors
/// Those of the writer and of `communication`.
pub fn eds<W: Write>(out: &mut W, communication: impl FnOnce(&mut W) -> Result) -> Result {
    head(out)?;
    communication(out)?;
    let own = RECORDS.iter().filter(|(index, _)| *index >= 0x2000);
    let count = own.clone().count();
    writeln!(out, "[ManufacturerObjects]\nSupportedObjects={count}")?;
    for (number, (index, _)) in (1..).zip(own) {
        let number: u16 = number;
        writeln!(out, "{number}=0x{index:04X}")?;
    }
    writeln!(out)?;
    for (index, name) in RECORDS {
        manufacturer(out, *index, name)?;
    }
    Ok(())
}

fn head<W: Write>(out: &mut W) -> Result {
    let (name, product, version) = (crate::NAME, crate::PRODUCT, crate::WIRE_VERSION);
    writeln!(
        out,
        "[FileInfo]\nFileName=omnibus.eds\nFileVersion={version}\nFileRevision=0\nEDSVersion=4.0"
    )?;
    writeln!(
        out,
        "Description=One Mecanum-wheeled robot of a group that moves as one body\n\
         CreationTime=12:00AM\nCreationDate=01-01-2026\nCreatedBy=omnibus-protocol\n\
         ModificationTime=12:00AM\nModificationDate=01-01-2026\nModifiedBy=omnibus-protocol\n"
    )?;
    let receive = PDOS.iter().filter(|pdo| pdo.receive).count();
    let transmit = PDOS.len() - receive;
    writeln!(
        out,
        "[DeviceInfo]\nVendorName=Omnibus\nVendorNumber=0\nProductName={name}\n\
         ProductNumber=0x{product:X}\nRevisionNumber=0x{version:04X}0000\nOrderCode=\n\
         BaudRate_10=0\nBaudRate_20=0\nBaudRate_50=0\nBaudRate_125=0\nBaudRate_250=0\n\
         BaudRate_500=0\nBaudRate_800=0\nBaudRate_1000=1\n\
         SimpleBootUpMaster=0\nSimpleBootUpSlave=1\nGranularity=8\nDynamicChannelsSupported=0\n\
         GroupMessaging=0\nNrOfRXPDO={receive}\nNrOfTXPDO={transmit}\nLSS_Supported=1\n"
    )?;
    writeln!(
        out,
        "[DummyUsage]\nDummy0001=0\nDummy0002=1\nDummy0003=1\nDummy0004=1\nDummy0005=1\n\
         Dummy0006=1\nDummy0007=1\n"
    )?;
    writeln!(out, "[Comments]\nLines=0\n")
}

/// Objects whose sub-indices have all the same meaning and the same type: the program download of
/// CiA 302-3.
const ARRAYS: [u16; 4] = [0x1F50, 0x1F51, 0x1F56, 0x1F57];

fn manufacturer(out: &mut impl Write, index: u16, name: &str) -> Result {
    let members = OBJECTS
        .iter()
        .filter(move |object| object.address.index == index);
    let highest = members
        .clone()
        .map(|object| object.address.sub)
        .max()
        .unwrap_or(0);
    if highest > 0 {
        writeln!(
            out,
            "[{index:04X}]\nParameterName={name}\nObjectType=0x{}\nSubNumber={}\n",
            if ARRAYS.contains(&index) { 8 } else { 9 },
            u16::from(highest) + 1
        )?;
        writeln!(
            out,
            "[{index:04X}sub0]\nParameterName=Highest sub-index supported\nObjectType=0x7\n\
             DataType=0x0005\nAccessType=const\nDefaultValue={highest}\nPDOMapping=0\n"
        )?;
    }
    for object in members {
        let sub = object.address.sub;
        if highest > 0 {
            writeln!(out, "[{index:04X}sub{sub:X}]")?;
        } else {
            writeln!(out, "[{index:04X}]")?;
        }
        writeln!(
            out,
            "ParameterName={}\nObjectType=0x{}\nDataType=0x{:04X}\nAccessType={}",
            object.name,
            if object.kind == Kind::Domain { 2 } else { 7 },
            object.kind as u8,
            object.access.eds()
        )?;
        values(out, object)?;
        writeln!(out, "PDOMapping={}\n", u8::from(object.mappable))?;
    }
    Ok(())
}

/// Limits and default. Those of a REAL32 are comments: CiA 306 gives numbers as integers only, and
/// tools read a real as a decimal number or as the integer with the same bits (ADR 0034).
fn values(out: &mut impl Write, object: &Object) -> Result {
    let remark = if object.kind == Kind::F32 { ";" } else { "" };
    if object.access == Access::Parameter && object.kind != Kind::Domain {
        let (min, max) = (Shown(object.min), Shown(object.max));
        writeln!(out, "{remark}LowLimit={min}\n{remark}HighLimit={max}")?;
    }
    // What the robot works out has no default.
    if matches!(object.access, Access::ReadOnly | Access::WriteOnly) {
        return writeln!(out, "DefaultValue=");
    }
    writeln!(out, "{remark}DefaultValue={}", Shown(object.default))
}
