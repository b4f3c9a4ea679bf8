//! `omnibus scan` and `omnibus status`: which robots are on the bus, and their state. Both only
//! read; neither claims to be the master, so a running group is not disturbed.

use canopen::NmtState;
use omnibus::bus::wire::Wire;
use omnibus::commission::survey::{Survey, ask};
use omnibus::error::MasterError;
use protocol::address::history;
use protocol::{Code, Fault, GyroState, Kind, StoredFault, address};
use serde_json::json;

use super::output::{self, Found};
use super::{Target, json, print_json, print_line};

const SCAN_EXAMPLES: &str = "Examples:
  omnibus scan --bus sim:groups/tcc-3.toml
  omnibus scan --bus auto
  omnibus scan --bus socketcan:can0
  omnibus scan --bus slcan:/dev/ttyACM0 --group groups/tcc-2.toml

With a group file it also lists robots that are missing or do not belong to the group, and then exits with code 6.";
const STATUS_EXAMPLES: &str = "Examples:
  omnibus status --bus socketcan:can0 --group groups/tcc-2.toml
  omnibus status --history --bus socketcan:can0

--history also reads the last eight faults that each robot has stored: when the fault appeared, and the supply voltage
and the wheel rates at that moment.";

#[derive(clap::Args)]
#[command(after_help = SCAN_EXAMPLES)]
pub struct Scan {
    #[command(flatten)]
    target: Target,
}

#[derive(clap::Args)]
#[command(after_help = STATUS_EXAMPLES)]
pub struct Status {
    #[command(flatten)]
    target: Target,
    /// Also shows the last faults of each robot, including those before it was switched off.
    #[arg(long)]
    history: bool,
}

/// The faults a robot remembers, the newest first, and the number of its present start.
struct History {
    start: u32,
    faults: Vec<StoredFault>,
}

impl History {
    fn read(
        wire: &mut Wire<Box<dyn omnibus::bus::link::Link>>,
        node: u8,
    ) -> Result<Self, MasterError> {
        let start = wire.read(node, address::START_NUMBER, Kind::U32)?.to_bits();
        let bytes = wire.read_block(node, address::STORED_FAULTS)?;
        let faults = bytes.as_chunks().0.iter().map(StoredFault::decode);
        Ok(Self {
            start,
            faults: faults.collect(),
        })
    }

    fn json(&self) -> serde_json::Value {
        let fault = |fault: &StoredFault| {
            json!({"code": fault.code, "name": fault_name(fault.code), "start": fault.start,
                   "starts_ago": self.start.saturating_sub(fault.start),
                   "time_s": f64::from(fault.time_ms) / 1e3, "supply_v": fault.supply,
                   "wheel_rates_rad_s": fault.rates})
        };
        json!({"start": self.start, "faults": self.faults.iter().map(fault).collect::<Vec<_>>()})
    }

    /// A line for each fault: node, fault, start, time, supply, wheel rates.
    fn rows(&self, node: u8) -> impl Iterator<Item = [String; 6]> {
        self.faults.iter().map(move |fault| {
            let start = match self.start.saturating_sub(fault.start) {
                0 => "this one".into(),
                1 => "the last one".into(),
                ago => format!("{ago} ago"),
            };
            let rates = fault.rates.map(|rate| format!("{rate:.1}"));
            [
                node.to_string(),
                fault_name(fault.code),
                start,
                format!("{:.1} s", f64::from(fault.time_ms) / 1e3),
                fault
                    .supply
                    .map_or_else(|| "-".into(), |supply| format!("{supply:.1} V")),
                rates.join(" "),
            ]
        })
    }
}

fn fault_name(code: u16) -> String {
    Fault::from_code(code).map_or_else(
        || format!("unknown {code:#06x}"),
        |fault| fault.name().into(),
    )
}

fn state_name(state: Option<NmtState>) -> String {
    state.map_or_else(|| "silent".into(), |state| format!("{state:?}"))
}

/// The same in the width of a table's column, as `omnibus watch` has it.
fn nmt_word(state: Option<NmtState>) -> &'static str {
    match state {
        Some(NmtState::Operational) => "OP",
        Some(NmtState::PreOperational) => "PRE-OP",
        Some(NmtState::Stopped) => "STOP",
        Some(NmtState::Initialising) => "BOOT",
        None => "silent",
    }
}

/// The newest fault since a robot started.
struct LastFault {
    code: u16,
    /// When it appeared, s since the start.
    at: f64,
    /// How long ago that is; `None` for a robot that does not tell its time.
    ago: Option<f64>,
}

impl LastFault {
    fn read(
        wire: &mut Wire<Box<dyn omnibus::bus::link::Link>>,
        node: u8,
    ) -> Result<Option<Self>, MasterError> {
        let code = wire.read(node, history::code(1), Kind::U16)?.to_bits();
        let Ok(code @ 1..) = u16::try_from(code) else {
            return Ok(None);
        };
        let at = wire.read(node, history::time(1), Kind::U32)?.to_bits();
        let now = match wire.read(node, address::UPTIME, Kind::U32) {
            Ok(now) => Some(now.to_bits()),
            Err(MasterError::Refused { .. }) => None,
            Err(error) => return Err(error),
        };
        let seconds = |ms: u32| f64::from(ms) / 1e3;
        Ok(Some(Self {
            code,
            at: seconds(at),
            ago: now.map(|now| seconds(now.saturating_sub(at))),
        }))
    }

    fn json(&self) -> serde_json::Value {
        json!({"code": self.code, "name": fault_name(self.code), "time_s": self.at,
               "age_s": self.ago})
    }
}

impl std::fmt::Display for LastFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let name = fault_name(self.code);
        match self.ago {
            Some(ago) if ago < 600.0 => write!(f, "{name}, {ago:.1} s ago"),
            Some(ago) => write!(f, "{name}, {:.0} min ago", ago / 60.0),
            None => write!(f, "{name}, {:.1} s after the start", self.at),
        }
    }
}

/// The temperature of a robot's hottest motor, degrees Celsius; `None` where it is not measured.
fn motor_temperature(
    wire: &mut Wire<Box<dyn omnibus::bus::link::Link>>,
    node: u8,
) -> Result<Option<u32>, MasterError> {
    match wire.read(node, address::TEMPERATURE, Kind::U8) {
        Ok(value) => Ok(Some(value.to_bits()).filter(|degrees| *degrees > 0)),
        // A robot that does not have the object.
        Err(MasterError::Refused { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

/// State and bias, rad/s, of a robot's gyro; `None` where there is none.
fn gyro(
    wire: &mut Wire<Box<dyn omnibus::bus::link::Link>>,
    node: u8,
) -> Result<Option<(GyroState, f32)>, MasterError> {
    let state = match wire.read(node, address::GYRO_STATE, Kind::U8) {
        Ok(value) => u8::try_from(value.to_bits()).ok(),
        // A robot that does not have the object.
        Err(MasterError::Refused { .. }) => None,
        Err(error) => return Err(error),
    };
    let state = state.and_then(GyroState::from_number);
    let Some(state) = state.filter(|state| *state != GyroState::None) else {
        return Ok(None);
    };
    let bias = wire.read(node, address::GYRO_BIAS, Kind::F32)?;
    Ok(Some((state, f32::from_bits(bias.to_bits()))))
}

/// What a robot has lost between its cable and its bus since it started.
#[derive(Clone, Copy, PartialEq)]
struct CableLosses {
    to_cable: u32,
    to_bus: u32,
    damaged: u32,
}

impl CableLosses {
    /// `None` for a robot that does not count them.
    fn read(
        wire: &mut Wire<Box<dyn omnibus::bus::link::Link>>,
        node: u8,
    ) -> Result<Option<Self>, MasterError> {
        let mut counts = [0; 3];
        let objects = [
            address::CABLE_LOST,
            address::CABLE_NOT_SENT,
            address::CABLE_DAMAGED,
        ];
        for (count, at) in counts.iter_mut().zip(objects) {
            *count = match wire.read(node, at, Kind::U32) {
                Ok(value) => value.to_bits(),
                Err(MasterError::Refused { .. }) => return Ok(None),
                Err(error) => return Err(error),
            };
        }
        let [to_cable, to_bus, damaged] = counts;
        Ok(Some(Self {
            to_cable,
            to_bus,
            damaged,
        }))
    }

    fn json(&self) -> serde_json::Value {
        json!({"to_cable": self.to_cable, "to_bus": self.to_bus, "damaged": self.damaged})
    }

    /// In words; `None` where nothing was lost.
    fn text(&self) -> Option<String> {
        let Self {
            to_cable,
            to_bus,
            damaged,
        } = self;
        (to_cable + to_bus + damaged > 0).then(|| {
            format!(
                "since its start it dropped {to_cable} lines to its cable and {to_bus} frames from \
                 the cable to the bus, and could not read its cable {damaged} times"
            )
        })
    }
}

/// A robot's code as the table shows it, if it is known. Outside of OPERATIONAL a robot stands by
/// command, so what limits it there is no finding.
fn shown_code(nmt: Option<NmtState>, code: u16) -> Option<Code> {
    match Code::from_code(code) {
        Some(Code::Limit(_)) if nmt != Some(NmtState::Operational) => Some(Code::None),
        code => code,
    }
}

/// The error that no robot answers, with the adapter's diagnosis.
fn no_answer(target: &Target, wire: &mut Wire<Box<dyn omnibus::bus::link::Link>>) -> anyhow::Error {
    let diagnosis = wire.diagnosis().unwrap_or_else(|| {
        "check the robots' power, CAN high and low, 120 ohm at both ends, and that the bit rate \
         is 1 Mbit/s everywhere"
            .into()
    });
    Found(format!("no robot answers on {}; {diagnosis}", target.bus)).into()
}

/// `omnibus scan`.
pub fn scan(arguments: &Scan) -> anyhow::Result<()> {
    let target = &arguments.target;
    let group = target.group_if_any()?;
    let mut wire = Wire::visiting(target.link_if_any(group.as_ref())?);
    let survey = Survey::take(&mut wire, group.as_ref())?;
    let name = group.as_ref().map(|group| group.name.as_str());
    let in_group = |node: u8| {
        let robots = group.as_ref().map(|group| &group.robots);
        robots.map(|robots| robots.iter().any(|robot| robot.node == node))
    };
    if json() {
        let nodes = survey.found.iter().map(|robot| {
            json!({"node": robot.node, "nmt": state_name(robot.nmt),
                   "state": robot.state.map(|state| format!("{state:?}")), "code": robot.code,
                   "serial": robot.serial, "firmware": robot.firmware_text(),
                   "wire_version": robot.wire_version, "in_group": in_group(robot.node)})
        });
        print_json(
            &json!({"nodes": nodes.collect::<Vec<_>>(), "missing": survey.missing,
            "master": survey.master, "conflicts": survey.conflicts}),
        )?;
    } else if !survey.found.is_empty() {
        let mut table = output::table([
            "node", "NMT", "state", "serial", "firmware", "wire", "group",
        ]);
        for robot in &survey.found {
            table.add_row([
                robot.node.to_string(),
                nmt_word(robot.nmt).into(),
                robot
                    .state
                    .map_or_else(|| "unknown".into(), |state| format!("{state:?}")),
                format!("{:08X}", robot.serial),
                robot.firmware_text(),
                robot.wire_version.to_string(),
                match in_group(robot.node) {
                    Some(true) => name.unwrap_or_default().into(),
                    Some(false) => "not in the file".into(),
                    None => "-".into(),
                },
            ]);
        }
        print_line(&table)?;
    }
    if survey.found.is_empty() {
        return Err(no_answer(target, &mut wire));
    }
    if !json()
        && let Some(latency) = wire.latency()
    {
        let ms = latency.as_secs_f64() * 1e3;
        print_line(format_args!("the adapter answers within {ms:.1} ms"))?;
    }
    for conflict in &survey.conflicts {
        print_line(conflict)?;
    }
    let mut wrong = survey.conflicts.len();
    for node in &survey.missing {
        wrong += 1;
        print_line(format_args!(
            "node {node} of group '{}' does not answer; check its power, its node switches and \
             its plug",
            name.unwrap_or_default()
        ))?;
    }
    if survey.master {
        print_line("another master's heartbeat is on the bus")?;
    }
    if wrong > 0 {
        let problems = if wrong == 1 { "problem" } else { "problems" };
        return Err(Found(format!("{wrong} {problems} found on this bus")).into());
    }
    Ok(())
}

/// `omnibus status`.
pub fn status(arguments: &Status) -> anyhow::Result<()> {
    let target = &arguments.target;
    let group = target.group_if_any()?;
    let mut wire = Wire::visiting(target.link_if_any(group.as_ref())?);
    let survey = Survey::take(&mut wire, group.as_ref())?;
    if survey.found.is_empty() {
        return Err(no_answer(target, &mut wire));
    }
    let mut table = output::table([
        "node",
        "NMT",
        "state",
        "limit or fault",
        "supply",
        "stops",
        "last fault",
    ]);
    let (mut rows, mut meanings) = (Vec::new(), Vec::new());
    let mut faults = output::table([
        "node",
        "fault",
        "start",
        "after",
        "supply",
        "rad/s: FL FR RL RR",
    ]);
    for robot in &survey.found {
        let node = robot.node;
        let mut read = |at, kind| -> anyhow::Result<String> {
            Ok(ask(&mut wire, node, at, kind)?
                .map_or_else(|| "?".into(), omnibus::session::sdo::show))
        };
        let supply = read(address::SUPPLY, Kind::F32)?;
        // 0 is what a robot without the divider says.
        let supply_v = supply.parse::<f32>().ok().filter(|volts| *volts != 0.0);
        let stops = read(address::STOPS, Kind::U32)?;
        let state = robot
            .state
            .map_or_else(|| "unknown".into(), |state| format!("{state:?}"));
        let last = LastFault::read(&mut wire, node)?;
        let losses = CableLosses::read(&mut wire, node)?;
        let mut row = json!({"node": node, "answers": true, "nmt": state_name(robot.nmt),
                             "state": state, "code": robot.code, "text": robot.code_text(),
                             "supply_v": supply_v,
                             "stops": stops.parse::<u32>().ok(),
                             "last_fault": last.as_ref().map(LastFault::json),
                             "cable": losses.as_ref().map(CableLosses::json)});
        let temperature = motor_temperature(&mut wire, node)?;
        if let Some(degrees) = temperature {
            row["motor_temperature_c"] = json!(degrees);
        }
        let gyro = gyro(&mut wire, node)?;
        if let Some((state, bias)) = gyro {
            row["gyro"] = json!({"state": state.text(), "bias_rad_s": bias});
        }
        if arguments.history {
            let history = History::read(&mut wire, node)?;
            row["history"] = history.json();
            faults.add_rows(history.rows(node));
        }
        rows.push(row);
        let (name, words) = match shown_code(robot.nmt, robot.code) {
            Some(Code::None) => ("none".into(), None),
            Some(Code::Limit(limit)) => (limit.name().into(), Some(robot.code_text())),
            Some(Code::Fault(fault)) => (fault.name().into(), Some(robot.code_text())),
            None => (robot.code_text(), None),
        };
        meanings.extend(words.map(|words| format!("node {node}: {words}")));
        let hot = temperature
            .map(|degrees| format!("node {node}: the hottest motor has {degrees} degrees Celsius"));
        meanings.extend(hot);
        let gyro = gyro.map(|(state, bias)| {
            let bias = bias.to_degrees();
            format!(
                "node {node}: gyro {}, bias {bias:.2} degrees/s",
                state.text()
            )
        });
        meanings.extend(gyro);
        let lost = losses.as_ref().and_then(CableLosses::text);
        meanings.extend(lost.map(|lost| format!("node {node}: {lost}")));
        table.add_row([
            node.to_string(),
            nmt_word(robot.nmt).into(),
            state,
            name,
            match supply_v {
                None if supply == "0" => "-".into(),
                _ => format!("{supply} V"),
            },
            stops,
            last.map_or_else(|| "none".into(), |fault| fault.to_string()),
        ]);
    }
    for node in &survey.missing {
        table.add_row([node.to_string(), "silent".into()]);
        rows.push(json!({"node": node, "answers": false}));
    }
    if json() {
        print_json(&json!({"group": group.map(|group| group.name), "robots": rows}))?;
        return survey_is_complete(&survey);
    }
    print_line(&table)?;
    for meaning in meanings {
        print_line(meaning)?;
    }
    if arguments.history && faults.is_empty() {
        print_line("no robot has stored a fault")?;
    } else if arguments.history {
        print_line(&faults)?;
    }
    survey_is_complete(&survey)
}

/// Whether every robot of the group file has answered.
fn survey_is_complete(survey: &Survey) -> anyhow::Result<()> {
    match survey.missing.len() {
        0 => Ok(()),
        1 => Err(Found("1 robot of the group file does not answer".into()).into()),
        n => Err(Found(format!("{n} robots of the group file do not answer")).into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_cable_has_lost_is_said_only_if_there_is_something() {
        let losses = |to_cable, to_bus, damaged| CableLosses {
            to_cable,
            to_bus,
            damaged,
        };
        assert_eq!(losses(0, 0, 0).text(), None);
        for one in [losses(17, 0, 0), losses(0, 17, 0), losses(0, 0, 17)] {
            assert!(one.text().unwrap().contains("17 "));
        }
        let json = losses(1, 2, 3).json();
        assert_eq!(
            json,
            json!({"to_cable": 1, "to_bus": 2, "damaged": 3}),
            "{json}"
        );
    }

    #[test]
    fn a_limit_is_shown_only_in_operational_and_a_fault_always() {
        let (limit, fault) = (protocol::Limit::Setpoint, Fault::EncoderDead);
        let shown = |nmt, code: u16| shown_code(nmt, code);
        let (ready, running) = (NmtState::PreOperational, NmtState::Operational);
        assert_eq!(shown(Some(ready), limit.code()), Some(Code::None));
        assert_eq!(shown(Some(running), limit.code()), Some(Code::Limit(limit)));
        assert_eq!(shown(Some(ready), fault.code()), Some(Code::Fault(fault)));
        assert_eq!(shown(None, 0x1234), None);
    }

    #[test]
    fn a_fault_is_told_by_name_with_the_start_it_appeared_in() {
        let fault = |start, supply| StoredFault {
            code: Fault::EncoderDead.code(),
            start,
            time_ms: 83_260,
            supply,
            rates: [3.94, 0.0, 3.9, 4.0],
        };
        let history = History {
            start: 7,
            faults: vec![fault(7, Some(23.46)), fault(6, None), fault(2, None)],
        };
        let rows: Vec<_> = history.rows(3).collect();
        let first = [
            "3",
            "EncoderDead",
            "this one",
            "83.3 s",
            "23.5 V",
            "3.9 0.0 3.9 4.0",
        ];
        assert_eq!(rows[0], first);
        assert_eq!((&*rows[1][2], &*rows[1][4]), ("the last one", "-"));
        assert_eq!(rows[2][2], "5 ago");
        let json = history.json();
        assert_eq!(json["start"], 7);
        assert_eq!(json["faults"][0]["name"], "EncoderDead");
        assert_eq!(json["faults"][0]["time_s"], 83.26);
        assert_eq!(json["faults"][2]["starts_ago"], 5);
        assert_eq!(json["faults"][1]["supply_v"], serde_json::Value::Null);
        assert_eq!(fault_name(0x1234), "unknown 0x1234");
    }
}
