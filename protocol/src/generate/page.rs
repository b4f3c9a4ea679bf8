//! The protocol page, `docs/can-protocol.md`.

use core::fmt::{Result, Write};

use super::{Shown, scale};
use crate::object::{Access, Kind};
use crate::pdos::PDOS;
use crate::table::{OBJECTS, RECORDS};
use crate::{Fault, Limit, Reaction};

const INTRODUCTION: &str = "\
CANopen (CiA 301) at 1 Mbit/s, 11-bit identifiers, little-endian. The master is node
1, robots are nodes 2 to 17. This page, `omnibus.eds` and `omnibus.dbc` are generated from the
object table in `protocol/`; a test fails when they are stale. Frames and units are REP-103: x
forward, y left, heading counter-clockwise.

## Bringing a group up

1. The robots boot into PRE-OPERATIONAL (boot-up frame 0x700 + node, data 00).
2. The master reads 0x2000 (wire version) and refuses a robot that has another.
3. It writes every object marked *required* by expedited SDO. 0x2002:1 reads 0 when the
   configuration is complete and consistent; otherwise it names the first object that is not.
   0x2002:2 is the CRC of all parameters.
4. NMT start. Each robot checks its whole configuration, its stop input and its drivers, and arms:
   drivers on, reference zero. A robot with an objection sends an emergency message and stays off.
5. Once a SYNC period, the master sends a group twist with the next sequence, then SYNC with its
   counter (1 to 240). Its heartbeat (0x701) goes on all the while.

## What happens to a group twist

At SYNC *k* every member latches the twist received before it and publishes the scale at which its
own wheels can follow and the group keeps its limits (0x2030:8 and :9), with the sequence it latched
and a checksum of what it is about to do. That is its vote. With the last vote every member knows
the smallest scale. All apply twist(*k*) times that at the same time, the *agreement delay*
(0x2041:5) after SYNC *k*.

A vote of a member that is in no state to follow, echoes another sequence, has another checksum or
permits 0, stops the group as soon as all votes are in: all ramp down along the direction of motion
with the common deceleration. So does a member that is not heard before SYNC *k+1*; until then the
others hold the setpoint in force. The same ramp follows a member's emergency message with the code
of a fault, at once; a silent master, a missing SYNC and an overdue setpoint. Of the master's
heartbeats only those count that say OPERATIONAL (one byte, 05); its boot-up message is a stop.

Only an NMT start, standstill and a new sequence end that: after a start, setpoints of less than
0.01 m/s and 0.01 rad/s must come, and be agreed on, at three SYNCs in a row (0x2042:1). Until then
a member permits 0 for every other setpoint and reports limit 0x000C. A master therefore begins with
setpoints of zero until all members are *moving*.
";

const PROCESS_DATA: &str = "\
All PDOs are synchronous, transmission type 1, and exactly eight bytes, YawRate five. Scaled fields
are rounded to nearest and saturate; the most negative value (-32768, or -8388608 in 24 bits; of an
unsigned magnitude 255) means *invalid*. A setpoint's sequence must lie 1 to 127 ahead of the last
one, wrapping; what repeats or lies behind is not followed and does not reset the timeout.

The yaw rate of MeasuredTwist is that of the wheels on every robot, because members compare it; the
heading of Pose is that of the gyro where one is used. Only robots with a gyro send YawRate; on
others bit 31 of 0x1804:1 switches it off. Remote frames are not answered; bit 30 of a PDO's
identifier reads as it was written.

A master may have a robot's PDO at every n-th SYNC (sub-index 2 of 0x1800 to 0x1804: types 1 to 240)
or as often as its event timer says (254 or 255, sub-index 5). Nothing else triggers one: of type 0
none is sent, and of 254 or 255 without a timer one after each NMT start.
";

const FAULTS: &str = "\
A fault is latched: the robot comes to rest, by *ramp* along the direction of motion or by *cut*
(drivers off and brake engaged in the same tick), and stays so until an NMT start finds the cause
gone. Each appearance is announced by an emergency message with this number as error code, and its
end by one with error code 0. What is present at an NMT reset is announced again after the boot-up.
";

const OTHER_EMERGENCIES: &str = "\
These are announced in the same way, but are no faults of the robot that sends them. Where the code
is that of a fault, other members stop all the same, whatever byte 3 says. What the robot itself does
without a heartbeat of 0x1016 is written in 0x1029:1. The message that says that an error is over has
its code in bytes 3 and 4, and in byte 5 what byte 3 was.

| code | byte 3 | meaning |
|---|---|---|
| 0x8110 | 0 | Frames could not be sent. |
| 0x8120 | 0 | The CAN controller is error passive. |
| 0x8130 | node | The heartbeat of a node in 0x1016 is overdue. |
| 0x8140 | 0 | The robot is back on the bus after bus-off; this one is not declared over. |
| 0x8210 | RPDO | A PDO with fewer bytes (byte 4) than are mapped (byte 5) was not taken. |
| 0x8240 | length | A SYNC had a counter and 0x1019 is 0, or it had none and 0x1019 is not. |
| 0x8250 | RPDO | A PDO is overdue by 0x1400:5 or 0x1401:5. |
| 0x8700 | 0 | SYNC is overdue by 0x1006. |
";

const OBJECT_NOTES: &str = "\
Access: *const* never changes, *ro* is written by the robot only, *wo* cannot be read, *rw* may be
written at any time unless its line says when, *set* is a parameter: refused while OPERATIONAL
(abort 0x08000022). *set* and *guarded* objects are refused while the robot is locked (abort
0x08000021, see 0x2004); the lock is off unless a key was set. **Required** parameters must be
written before the drivers can be enabled. A value out of its limits is refused with 0x06090031 (too
high), 0x06090032 (too low) or 0x06090030 (not a number), and nothing changes. Sub-index 0 of a record
reads its highest sub-index. What is read by SDO is what is at that moment; what is sent as a PDO is
what was at its SYNC. The code of a robot that is not started (0x2110:5) is what speaks against a
start, like an emergency stop that is pressed.
";

const PLAN: &str = "\
## The plan checksum

The last byte of a status (0x2110:6) is the top byte of a 32-bit hash over sixteen bytes, all
little-endian:

1. 4 bytes: the group CRC, 0x2002:3;
2. 4 bytes: CRC-32 (IEEE 802.3) over the communication objects of the group, four bytes each:
   0x1005, 0x1006, 0x1007, 0x1014 *; 0x1400:1, :2, :5, 0x1600:0 and its entries; 0x1800:1 *, :2, :3,
   :5, :6, 0x1A00:0 and its entries; 0x1801:1 *, :2, :3, :5, :6, 0x1A01:0 and its entries. The node
   number is subtracted from those with a star;
3. 8 bytes: the setpoint latched at this SYNC as the robot understood it, laid out as GroupTwist.

The hash is FNV-1a, `h = 0x811C9DC5`, then for each byte `h = (h ^ byte) * 0x01000193`; and at the
end `h ^= h >> 16`, `h *= 0x85EBCA6B`, `h ^= h >> 13`, `h *= 0xC2B2AE35`, `h ^= h >> 16`, all modulo
2^32. Before the first setpoint of a start the byte is 0. Items 1 and 2 are taken at the NMT start;
neither parameters nor objects 0x1005 to 0x1007, 0x1014 to 0x1017, 0x1019, 0x1029, 0x1400 to 0x1BFF
and 0x1F80 can be written while OPERATIONAL (abort 0x08000022).
";

const COMPENSATION: &str = "\
## Compensation tables

Object 0x2013:1 takes a whole set of tables in one SDO transfer, segmented or block. The robot
checks it before any of it takes effect; a set that is refused leaves the one before. It acts from
the next NMT start on. All numbers are little-endian.

| bytes | |
|---|---|
| 0-3 | CRC-32 (IEEE 802.3) of all that follows |
| 4-7 | version, chosen by the writer; a date such as 20261121 serves |
| 8 | format, 1 |
| 9-12 | rows of the longitudinal, lateral, oblique and yaw table, 0 to 8 each |
| then 4 a row | longitudinal: speed, coefficient |
| then 4 a row | lateral: speed, coefficient |
| then 6 a row | oblique, at 45 degrees: speed, longitudinal coefficient, lateral coefficient |
| then 4 a row | yaw: rate, coefficient |

A speed is the achieved one, UNSIGNED16 in 0.1 mm/s or 0.1 mrad/s, above zero and rising from row to
row. A coefficient is commanded over achieved velocity, UNSIGNED16 in 1/32768, at least 0.5; 0 is
refused. Between rows the coefficient follows a curve without overshoot, outside it stays. An axis
without rows has the constant of 0x2012. Without oblique rows each axis goes by its own speed; with
them longitudinal and lateral go by the speed of the whole motion, and with *s* the lateral share of
its square

    longitudinal = ahead + 2 s (oblique - ahead)        lateral = aside + 2 (1 - s) (oblique - aside)

A robot without tables reads a set without rows, version 0.

## Resets

Reset communication (NMT) sets the communication objects to their saved values; reset node
also those of the application, 0x2051:4 to :8 to their defaults, and 0x2059, 0x2100 and 0x2101 to 0.
Neither changes what the robot measures: pose (0x2112), counters and histories go on, and so do the
results of an identification. A robot that moves ramps down with its group.

## Node number

The switches on the board give it, unless LSS has stored one, which comes first: 0x2001:4 shows the
one, 0x2001:5 the other. A node given by LSS takes effect at the next reset; LSS `store` keeps it
(nodes 2 to 17), LSS node 255 and `store` forgets it. Saving and restoring parameters leaves it
alone. LSS neither gives nor stores a node (error 0xFF) while the robot is OPERATIONAL or not at
rest, and when it was addressed together with other robots that it has heard. Configure bit timing
(0x13) is answered with error 1: the bit rate is 1 Mbit/s.

Two robots with one number are a fault of both (0xFF1C, DuplicateNode): each hears an identifier
that only it should send.

## Several groups on one bus

One master sends SYNC, the heartbeat of node 1 and, in every period, one 0x181 for each group; byte
7 is the group's number (0x2040:1). A robot neither takes nor counts a twist for another group. Node
numbers are those of the bus: all groups on it have sixteen robots together.

## Saving

A save (0x1010) is taken with outputs off and not while OPERATIONAL. As a rule the answer comes in
milliseconds; when a sector has to be erased, after up to 2 s, in which the robot sends nothing. If
power is lost before the answer, the next start finds the old set or the new one, whole, and says so
by fault 0xFF15.

Of the communication objects those are saved that differ from their defaults, four bytes and the
value each. A PDO that has been changed takes ten bytes for its identifier, three more if that is not
the default one, and ten and eight for each entry if it is mapped again. All together may have 512
bytes, fewer where most parameters have been written; otherwise the save is refused with 0x08000020
and nothing is stored. A default identifier is saved as such: it follows the node number.
";

const STORED_FAULTS: &str = "\
## Stored faults

Object 0x2128:1 is read in one SDO transfer. All numbers are little-endian; each of up to eight
faults has 32 bytes:

| bytes | |
|---|---|
| 0-1 | fault code |
| 2-3 | 0 |
| 4-7 | number of the start in which it appeared; 0x2129:1 is that of this start |
| 8-11 | time since that start, ms |
| 12-15 | supply voltage, V, FLOAT32; not a number where it is not measured |
| 16-31 | wheel rates front left, front right, rear left, rear right, rad/s, FLOAT32 |
";

/// Writes the page.
///
/// # Errors
/// Those of the writer.
pub fn page<W: Write>(out: &mut W) -> Result {
    writeln!(out, "# What Omnibus says on the CAN bus\n")?;
    writeln!(out, "Wire version {}. {INTRODUCTION}", crate::WIRE_VERSION)?;
    timing(out)?;
    identifiers(out)?;
    process_data(out)?;
    codes(out)?;
    writeln!(out, "{PLAN}")?;
    writeln!(out, "{COMPENSATION}")?;
    writeln!(out, "{STORED_FAULTS}")?;
    objects(out)
}

const TIMING: &str = "\
## When a group twist takes effect

![One SYNC period of eight robots: the votes after SYNC, the agreement delay, the control tick at \
which the setpoint takes effect, and the straight line to it](sync-timing.svg)

The agreement delay counts from SYNC as every member estimates it, without its jitter. It is the
smallest that fits the members. From the end of SYNC to the time at which all votes are known in all
members pass, in the worst case:
";

const TIMING_NOTES: &str = "\
A frame is the longest there is, 135 bits with all stuff bits. Votes go out by node number, so those
of all lower nodes come first, also of robots of another group on the bus. The sum and the allowance
for a late SYNC are rounded up to 200 us before a control tick; ticks come half a millisecond after
whole ones since SYNC. Where the SYNC period is too short for that, the allowance is; where it is too
short for the votes, the group file is refused, and so is a start (0x2041:5).

A master sends its setpoint 1.25 ms before SYNC. Any time between two SYNCs will do, but what is
given to an adapter together with SYNC may leave it after SYNC.

The members reach the setpoint on a straight line over one SYNC period from there on. A setpoint
latched at SYNC *k* is therefore reached one period and the agreement delay later; a master that
drives a curve sends each setpoint ahead by that.

Votes that come later than the agreement delay stop nothing: the setpoint then takes effect late, on
the same line. Each member counts them (0x2121:8), reports limit 0x000F with its next status, and
shows the longest time from SYNC to the last vote (0x2121:9).
";

/// What the agreement delay is made of, and its value for groups of every size.
fn timing<W: Write>(out: &mut W) -> Result {
    use crate::timing::{
        BIT_RATE, DECISION_US, LONGEST_FRAME_BITS, RESPONSE_US, SYNC_ALLOWANCE_US,
        agreement_delay_us, votes_known_us,
    };
    writeln!(out, "{TIMING}")?;
    writeln!(out, "| time | what |\n|---|---|")?;
    writeln!(
        out,
        "| {RESPONSE_US} us | every robot has its vote ready to be sent |"
    )?;
    let frame_us = LONGEST_FRAME_BITS * 1_000 / (BIT_RATE / 1_000);
    writeln!(
        out,
        "| {} us | a frame that is on the wire already, and one of higher priority |",
        2 * frame_us
    )?;
    writeln!(
        out,
        "| {frame_us} us a robot | the votes of all nodes up to the group's highest |"
    )?;
    writeln!(
        out,
        "| {DECISION_US} us | every robot has decided, in time for its control tick |"
    )?;
    writeln!(
        out,
        "| {SYNC_ALLOWANCE_US} us | allowance for a SYNC that comes late |\n"
    )?;
    writeln!(
        out,
        "| highest node | votes known | agreement delay at 100 Hz |\n|---|---|---|"
    )?;
    let alone = agreement_delay_us(1 << 2, 10_000, BIT_RATE).unwrap_or(0);
    writeln!(out, "| one robot alone | | {alone} us |")?;
    for highest in [3, 4, 9, 10, 17] {
        let members = 1 << highest | 1 << 2;
        let delay = agreement_delay_us(members, 10_000, BIT_RATE).unwrap_or(0);
        let known = votes_known_us(highest, BIT_RATE);
        writeln!(out, "| {highest} | {known} us | {delay} us |")?;
    }
    writeln!(out, "\n{TIMING_NOTES}")
}

fn identifiers<W: Write>(out: &mut W) -> Result {
    writeln!(out, "## Identifiers\n")?;
    writeln!(out, "| identifier | frame | from |\n|---|---|---|")?;
    writeln!(out, "| 0x000 | NMT | master |")?;
    writeln!(out, "| 0x080 | SYNC, counter 1 to 240 | master |")?;
    writeln!(out, "| 0x080 + node | emergency | robot |")?;
    for pdo in PDOS {
        let from = if pdo.receive { "master" } else { "robot" };
        let kind = if pdo.receive { 'R' } else { 'T' };
        let node = if pdo.broadcast { "" } else { " + node" };
        writeln!(
            out,
            "| 0x{:03X}{node} | {} ({kind}PDO{} of a robot) | {from} |",
            pdo.cob_base, pdo.name, pdo.number
        )?;
    }
    writeln!(out, "| 0x580 + node | SDO answer | robot |")?;
    writeln!(out, "| 0x600 + node | SDO request | master |")?;
    writeln!(out, "| 0x700 + node | heartbeat, boot-up | all |")?;
    writeln!(out, "| 0x7E4, 0x7E5 | LSS | robot, master |\n")
}

fn process_data<W: Write>(out: &mut W) -> Result {
    writeln!(out, "## Process data\n\n{PROCESS_DATA}")?;
    for pdo in PDOS {
        writeln!(out, "### {}\n", pdo.name)?;
        writeln!(
            out,
            "| bytes | field | object | type | one step |\n|---|---|---|---|---|"
        )?;
        let mut byte = 0;
        for object in pdo.objects() {
            let last = byte + object.kind.bytes() - 1;
            let (steps, unit) = scale(object.unit);
            if byte == last {
                write!(out, "| {byte} ")?;
            } else {
                write!(out, "| {byte}-{last} ")?;
            }
            write!(
                out,
                "| {} | {} | {} |",
                object.name,
                object.address,
                object.kind.name()
            )?;
            match (object.unit, unit) {
                ("", _) => writeln!(out, " |")?,
                (step, "") => writeln!(out, " {step} |")?,
                (_, unit) => writeln!(out, " {} {unit} |", 1.0 / steps)?,
            }
            byte = last + 1;
        }
        writeln!(out)?;
    }
    Ok(())
}

fn codes<W: Write>(out: &mut W) -> Result {
    writeln!(out, "## Limits\n")?;
    writeln!(
        out,
        "A limit stops nothing by itself: it says why the robot does less than it was asked, or may soon. It
ends when its cause does.\n\n| code | name | meaning |\n|---|---|---|"
    )?;
    for limit in Limit::ALL {
        writeln!(
            out,
            "| 0x{:04X} | {} | {} |",
            limit.code(),
            limit.name(),
            limit.text().trim_start()
        )?;
    }
    writeln!(out, "\n## Faults\n\n{FAULTS}")?;
    writeln!(
        out,
        "| code | name | reaction | meaning |\n|---|---|---|---|"
    )?;
    for fault in Fault::ALL {
        let reaction = match fault.reaction() {
            Reaction::Ramp => "ramp",
            Reaction::Cut => "cut",
        };
        writeln!(
            out,
            "| 0x{:04X} | {} | {reaction} | {} |",
            fault.code(),
            fault.name(),
            fault.text().trim_start()
        )?;
    }
    writeln!(out, "\n## Other emergency messages\n\n{OTHER_EMERGENCIES}")
}

fn objects<W: Write>(out: &mut W) -> Result {
    writeln!(out, "## Objects\n\n{OBJECT_NOTES}")?;
    for (index, name) in RECORDS {
        writeln!(out, "### {index:04X} {name}\n")?;
        writeln!(
            out,
            "| sub | name | type | access | unit | limits | default | |\n|---|---|---|---|---|---|---|---|"
        )?;
        for object in OBJECTS
            .iter()
            .filter(|object| object.address.index == *index)
        {
            let access = match object.access {
                Access::Parameter => "set",
                other => other.eds(),
            };
            write!(
                out,
                "| {} | {} | {} | {access} | {} |",
                object.address.sub,
                object.name,
                object.kind.name(),
                object.unit
            )?;
            match object.access {
                Access::Parameter if object.kind == Kind::Domain => write!(out, " | |")?,
                Access::Parameter => write!(
                    out,
                    " {} to {} | {} |",
                    Shown(object.min),
                    Shown(object.max),
                    Shown(object.default)
                )?,
                Access::Const => write!(out, " | {} |", Shown(object.default))?,
                Access::ReadOnly | Access::WriteOnly | Access::ReadWrite => write!(out, " | |")?,
            }
            if object.required {
                write!(out, " **Required.**")?;
            }
            if object.guarded && object.access != Access::Parameter {
                write!(out, " *Guarded.*")?;
            }
            writeln!(out, " {} |", object.text)?;
        }
        writeln!(out)?;
    }
    Ok(())
}
