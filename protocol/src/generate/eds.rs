//! The electronic data sheet (CiA 306) of a robot.
//!
//! The communication objects are listed here with the values this robot has; everything else comes
//! from the object table.

use core::fmt::{Result, Write};

use super::Shown;
use crate::pdos::PDOS;
use crate::table::{OBJECTS, RECORDS};
use crate::{Access, Kind, Object};

/// Objects of one index: name, and the sub-indices from 0 on; a lone variable has one entry.
struct Communication {
    index: u16,
    name: &'static str,
    subs: &'static [Sub],
}

/// Name, type, access, default; a `$NODEID+` default follows the node number.
struct Sub(u8, &'static str, u8, &'static str, &'static str);

const U8: u8 = 5;
const U16: u8 = 6;
const U32: u8 = 7;
const TEXT: u8 = 9;

const MANDATORY: &[Communication] = &[
    Communication {
        index: 0x1000,
        name: "Device type",
        subs: &[Sub(0, "Device type", U32, "ro", "0")],
    },
    Communication {
        index: 0x1001,
        name: "Error register",
        subs: &[Sub(0, "Error register", U8, "ro", "0")],
    },
    Communication {
        index: 0x1018,
        name: "Identity",
        subs: &[
            Sub(0, "Highest sub-index supported", U8, "const", "4"),
            Sub(1, "Vendor-ID", U32, "ro", "0"),
            Sub(2, "Product code", U32, "ro", "0x4F4D4E49"),
            Sub(3, "Revision number", U32, "ro", ""),
            Sub(4, "Serial number", U32, "ro", ""),
        ],
    },
];

const OPTIONAL: &[Communication] = &[
    Communication {
        index: 0x1003,
        name: "Pre-defined error field",
        subs: &[
            Sub(0, "Number of errors", U8, "rw", "0"),
            Sub(1, "Newest error", U32, "ro", ""),
            Sub(2, "Error 2", U32, "ro", ""),
            Sub(3, "Error 3", U32, "ro", ""),
            Sub(4, "Error 4", U32, "ro", ""),
            Sub(5, "Error 5", U32, "ro", ""),
            Sub(6, "Error 6", U32, "ro", ""),
            Sub(7, "Error 7", U32, "ro", ""),
            Sub(8, "Error 8", U32, "ro", ""),
        ],
    },
    Communication {
        index: 0x1005,
        name: "COB-ID SYNC",
        subs: &[Sub(0, "COB-ID SYNC", U32, "rw", "0x80")],
    },
    Communication {
        index: 0x1006,
        name: "Communication cycle period",
        subs: &[Sub(0, "Communication cycle period", U32, "rw", "0")],
    },
    Communication {
        index: 0x1007,
        name: "Synchronous window length",
        subs: &[Sub(0, "Synchronous window length", U32, "rw", "0")],
    },
    Communication {
        index: 0x1008,
        name: "Manufacturer device name",
        subs: &[Sub(
            0,
            "Manufacturer device name",
            TEXT,
            "const",
            "Omnibus robot",
        )],
    },
    Communication {
        index: 0x1010,
        name: "Store parameters",
        subs: &[
            Sub(0, "Highest sub-index supported", U8, "const", "3"),
            Sub(1, "Save all parameters", U32, "rw", "1"),
            Sub(2, "Save communication parameters", U32, "rw", "1"),
            Sub(3, "Save application parameters", U32, "rw", "1"),
        ],
    },
    Communication {
        index: 0x1011,
        name: "Restore default parameters",
        subs: &[
            Sub(0, "Highest sub-index supported", U8, "const", "3"),
            Sub(1, "Restore all default parameters", U32, "rw", "1"),
            Sub(
                2,
                "Restore communication default parameters",
                U32,
                "rw",
                "1",
            ),
            Sub(3, "Restore application default parameters", U32, "rw", "1"),
        ],
    },
    Communication {
        index: 0x1014,
        name: "COB-ID EMCY",
        subs: &[Sub(0, "COB-ID EMCY", U32, "rw", "$NODEID+0x80")],
    },
    Communication {
        index: 0x1015,
        name: "Inhibit time EMCY",
        subs: &[Sub(0, "Inhibit time EMCY", U16, "rw", "0")],
    },
    Communication {
        index: 0x1016,
        name: "Consumer heartbeat time",
        subs: &[
            Sub(0, "Highest sub-index supported", U8, "const", "17"),
            Sub(1, "Consumer heartbeat time 1", U32, "rw", "0"),
            Sub(2, "Consumer heartbeat time 2", U32, "rw", "0"),
            Sub(3, "Consumer heartbeat time 3", U32, "rw", "0"),
            Sub(4, "Consumer heartbeat time 4", U32, "rw", "0"),
            Sub(5, "Consumer heartbeat time 5", U32, "rw", "0"),
            Sub(6, "Consumer heartbeat time 6", U32, "rw", "0"),
            Sub(7, "Consumer heartbeat time 7", U32, "rw", "0"),
            Sub(8, "Consumer heartbeat time 8", U32, "rw", "0"),
            Sub(9, "Consumer heartbeat time 9", U32, "rw", "0"),
            Sub(10, "Consumer heartbeat time 10", U32, "rw", "0"),
            Sub(11, "Consumer heartbeat time 11", U32, "rw", "0"),
            Sub(12, "Consumer heartbeat time 12", U32, "rw", "0"),
            Sub(13, "Consumer heartbeat time 13", U32, "rw", "0"),
            Sub(14, "Consumer heartbeat time 14", U32, "rw", "0"),
            Sub(15, "Consumer heartbeat time 15", U32, "rw", "0"),
            Sub(16, "Consumer heartbeat time 16", U32, "rw", "0"),
            Sub(17, "Consumer heartbeat time 17", U32, "rw", "0"),
        ],
    },
    Communication {
        index: 0x1017,
        name: "Producer heartbeat time",
        subs: &[Sub(0, "Producer heartbeat time", U16, "rw", "100")],
    },
    Communication {
        index: 0x1019,
        name: "Synchronous counter overflow value",
        subs: &[Sub(
            0,
            "Synchronous counter overflow value",
            U8,
            "rw",
            "240",
        )],
    },
    Communication {
        index: 0x1029,
        name: "Error behaviour",
        subs: &[
            Sub(0, "Highest sub-index supported", U8, "const", "1"),
            Sub(1, "Communication error", U8, "rw", "0"),
        ],
    },
    Communication {
        index: 0x1F80,
        name: "NMT startup",
        subs: &[Sub(0, "NMT startup", U32, "rw", "4")],
    },
];

/// Writes the EDS.
///
/// # Errors
/// Those of the writer.
pub fn eds<W: Write>(out: &mut W) -> Result {
    head(out)?;
    list(
        out,
        "MandatoryObjects",
        MANDATORY.iter().map(|object| object.index),
    )?;
    for object in MANDATORY {
        communication(out, object)?;
    }
    let pdos = PDOS.iter().flat_map(|pdo| {
        let base = if pdo.receive { 0x1400 } else { 0x1800 };
        let communication = base + u16::from(pdo.number) - 1;
        [communication, communication + 0x200]
    });
    list(
        out,
        "OptionalObjects",
        OPTIONAL.iter().map(|object| object.index).chain(pdos),
    )?;
    for object in OPTIONAL {
        communication(out, object)?;
    }
    pdo_objects(out)?;
    list(
        out,
        "ManufacturerObjects",
        RECORDS.iter().map(|(index, _)| *index),
    )?;
    for (index, name) in RECORDS {
        manufacturer(out, *index, name)?;
    }
    Ok(())
}

fn head<W: Write>(out: &mut W) -> Result {
    let version = crate::WIRE_VERSION;
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
        "[DeviceInfo]\nVendorName=Omnibus\nVendorNumber=0\nProductName=Omnibus robot\n\
         ProductNumber=0x4F4D4E49\nRevisionNumber=0x{version:04X}0000\nOrderCode=\n\
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

fn list(out: &mut impl Write, section: &str, indices: impl Iterator<Item = u16> + Clone) -> Result {
    writeln!(out, "[{section}]")?;
    writeln!(out, "SupportedObjects={}", indices.clone().count())?;
    for (number, index) in (1..).zip(indices) {
        let number: u16 = number;
        writeln!(out, "{number}=0x{index:04X}")?;
    }
    writeln!(out)
}

/// Objects that CiA 301 defines as an ARRAY; all others with sub-indices are a RECORD.
const ARRAYS: [u16; 5] = [0x1003, 0x1010, 0x1011, 0x1016, 0x1029];

fn record(out: &mut impl Write, index: u16, name: &str, subs: usize) -> Result {
    writeln!(
        out,
        "[{index:04X}]\nParameterName={name}\nObjectType=0x{:X}\nSubNumber={subs}\n",
        if ARRAYS.contains(&index) { 8 } else { 9 }
    )
}

fn variable(
    out: &mut impl Write,
    (index, sub): (u16, Option<u8>),
    Sub(_, name, kind, access, default): &Sub,
) -> Result {
    match sub {
        Some(sub) => writeln!(out, "[{index:04X}sub{sub:X}]")?,
        None => writeln!(out, "[{index:04X}]")?,
    }
    writeln!(
        out,
        "ParameterName={name}\nObjectType=0x7\nDataType=0x{kind:04X}\nAccessType={access}\n\
         DefaultValue={default}\nPDOMapping=0\n"
    )
}

fn communication(out: &mut impl Write, object: &Communication) -> Result {
    if let [only] = object.subs {
        return variable(out, (object.index, None), only);
    }
    record(out, object.index, object.name, object.subs.len())?;
    for sub in object.subs {
        variable(out, (object.index, Some(sub.0)), sub)?;
    }
    Ok(())
}

/// Communication and mapping record of every PDO.
fn pdo_objects<W: Write>(out: &mut W) -> Result {
    for pdo in PDOS {
        let (base, kind, last, subs) = if pdo.receive {
            (0x1400, "RPDO", "5", 4)
        } else {
            (0x1800, "TPDO", "6", 6)
        };
        let number = pdo.number;
        let index = base + u16::from(number) - 1;
        writeln!(
            out,
            "[{index:04X}]\nParameterName={kind}{number} communication parameter\n\
             ObjectType=0x9\nSubNumber={subs}\n"
        )?;
        let highest = Sub(0, "Highest sub-index supported", U8, "const", last);
        variable(out, (index, Some(0)), &highest)?;
        let node = if pdo.broadcast { "" } else { "$NODEID+" };
        writeln!(
            out,
            "[{index:04X}sub1]\nParameterName=COB-ID\nObjectType=0x7\nDataType=0x0007\n\
             AccessType=rw\nDefaultValue={node}0x{:X}\nPDOMapping=0\n",
            pdo.cob_base
        )?;
        variable(
            out,
            (index, Some(2)),
            &Sub(2, "Transmission type", U8, "rw", "1"),
        )?;
        if !pdo.receive {
            let inhibit = Sub(3, "Inhibit time", U16, "rw", "0");
            variable(out, (index, Some(3)), &inhibit)?;
        }
        variable(
            out,
            (index, Some(5)),
            &Sub(5, "Event timer", U16, "rw", "0"),
        )?;
        if !pdo.receive {
            let start = Sub(6, "SYNC start value", U8, "rw", "0");
            variable(out, (index, Some(6)), &start)?;
        }
        mapping(out, index + 0x200, kind, pdo)?;
    }
    Ok(())
}

fn mapping(out: &mut impl Write, index: u16, kind: &str, pdo: &crate::pdos::Pdo) -> Result {
    let number = pdo.number;
    writeln!(
        out,
        "[{index:04X}]\nParameterName={kind}{number} mapping parameter\nObjectType=0x9\n\
         SubNumber=9\n"
    )?;
    writeln!(
        out,
        "[{index:04X}sub0]\nParameterName=Number of mapped objects\nObjectType=0x7\n\
         DataType=0x0005\nAccessType=rw\nDefaultValue={}\nPDOMapping=0\n",
        pdo.objects().count()
    )?;
    let mut objects = pdo.objects();
    for sub in 1..=8 {
        writeln!(
            out,
            "[{index:04X}sub{sub}]\nParameterName=Mapped object {sub}\nObjectType=0x7\n\
             DataType=0x0007\nAccessType=rw"
        )?;
        match objects.next() {
            Some(object) => writeln!(
                out,
                "DefaultValue=0x{:04X}{:02X}{:02X}",
                object.address.index,
                object.address.sub,
                object.kind.bytes() * 8
            )?,
            None => writeln!(out, "DefaultValue=0")?,
        }
        writeln!(out, "PDOMapping=0\n")?;
    }
    Ok(())
}

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
        record(out, index, name, usize::from(highest) + 1)?;
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
    if object.access == Access::ReadOnly {
        return writeln!(out, "DefaultValue=");
    }
    writeln!(out, "{remark}DefaultValue={}", Shown(object.default))
}
