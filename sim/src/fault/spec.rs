//! A fault as text: parts with colons between them, in any order.
//!
//! | part | meaning |
//! |---|---|
//! | `t=SECONDS` | when it begins, virtual time; at once without it |
//! | `for=SECONDS` | how long it lasts; for ever without it |
//! | `node=N` | which robot; 1 is the master and every other program outside |
//! | `id=ID` | only frames with this identifier |
//! | `wheel=NAME` | which wheel: `front-left`, `front-right`, `rear-left`, `rear-right` |
//! | `ACTION` or `ACTION=VALUE` | what happens; exactly one |
//!
//! So `t=5:node=3:power-cycle`, `node=2:wheel=rear-left:encoder-dead:for=1.5`,
//! `node=3:emergency-stop=off`. [`ACTIONS`] lists the actions. An invalid spec is refused with the
//! name of the part and a remedy.

use std::fmt;

use group::GroupFile;

use super::action::{Action, BusAction, Place, RobotAction, WHEELS};
use crate::bus::disturb::Share;
use crate::motor::BRAKE_TORQUE;
use crate::world::{Cable, EncoderState};

/// Longest time that can be asked for, s: a day.
const LONGEST_S: f64 = 86_400.0;
/// No quantity of a fault is larger: of pulses in a second as many would fill most of it.
const MOST: f64 = 1e7;
/// Highest identifier of a base frame.
const LAST_IDENTIFIER: u16 = 0x7FF;
/// Default identifier of a babbling node: only NMT has priority over it.
const BABBLE: u16 = 0x001;
/// Node of the master.
const MASTER: &str = "1";

/// Every action. `docs/simulation.md` describes them.
pub const ACTIONS: &[&str] = &[
    "power-cycle",
    "power-off",
    "power-on",
    "emergency-stop",
    "driver-fault",
    "protective-stop",
    "bus-cut",
    "bus-parts",
    "cable-cut",
    "bus-off",
    "overrun",
    "misses=ID",
    "encoder-dead",
    "encoder-one-channel",
    "encoder-reversed",
    "encoder-floats",
    "encoder-works",
    "encoder-noise=HZ",
    "encoder-slow-edges=US",
    "wheel-drag=NM",
    "wheel-push=NM",
    "brake-torque=NM",
    "brake-release=MS",
    "brake-engage=MS",
    "driver-trip=A",
    "supply=V",
    "no-regeneration=UF",
    "halt",
    "crash",
    "corrupt=SHARE",
    "lost-acknowledge=SHARE",
    "babble",
    "delay=SECONDS",
];

/// One fault: what, when, how long.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaultSpec {
    /// When it begins, ns of virtual time; `None` is now.
    pub at_ns: Option<u64>,
    /// How long it lasts, ns; `None` is for ever, or as long as the action lasts by itself.
    pub lasts_ns: Option<u64>,
    /// What happens.
    pub action: Action,
}

/// Why a text is no fault.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SpecError {
    /// The part.
    pub part: String,
    /// What is wrong with it.
    pub problem: String,
    /// What to write.
    pub remedy: String,
}

impl fmt::Display for SpecError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}; {}", self.part, self.problem, self.remedy)
    }
}

impl std::error::Error for SpecError {}

type Checked<T> = Result<T, SpecError>;

fn refuse<T>(part: &str, problem: impl Into<String>, remedy: impl Into<String>) -> Checked<T> {
    Err(SpecError {
        part: part.to_owned(),
        problem: problem.into(),
        remedy: remedy.into(),
    })
}

/// The parts of a text, not parsed yet.
#[derive(Default)]
struct Parts<'a> {
    time: Option<&'a str>,
    lasts: Option<&'a str>,
    node: Option<&'a str>,
    wheel: Option<&'a str>,
    id: Option<&'a str>,
    action: Option<(&'a str, Option<&'a str>)>,
}

impl<'a> Parts<'a> {
    fn split(text: &'a str) -> Checked<Self> {
        let mut parts = Self::default();
        for part in text.split(':') {
            let (name, value) = match part.split_once('=') {
                Some((name, value)) => (name.trim(), Some(value.trim())),
                None => (part.trim(), None),
            };
            let field = match name {
                "t" => &mut parts.time,
                "for" => &mut parts.lasts,
                "node" => &mut parts.node,
                "wheel" => &mut parts.wheel,
                "id" => &mut parts.id,
                _ => {
                    if let Some((first, _)) = parts.action {
                        return refuse(
                            name,
                            format!("a fault has one action, and this one already has `{first}`"),
                            "write a second fault for it",
                        );
                    }
                    parts.action = Some((name, value));
                    continue;
                }
            };
            if field.is_some() {
                return refuse(name, "appears twice", "give it once");
            }
            if value.is_none_or(str::is_empty) {
                return refuse(name, "has no value", format!("write {name}=VALUE"));
            }
            *field = value;
        }
        Ok(parts)
    }

    fn place(&self, group: &GroupFile) -> Checked<Place> {
        let nodes: Vec<String> = group.robots.iter().map(|r| r.node.to_string()).collect();
        let remedy = format!("give one of {}", nodes.join(", "));
        let Some(text) = self.node else {
            return refuse("node", "is missing", remedy);
        };
        match nodes.iter().position(|node| node == text) {
            Some(robot) => Ok(Place {
                robot,
                node: group.robots[robot].node,
            }),
            None => refuse("node", format!("{text} is not in the group"), remedy),
        }
    }

    fn share(&self, name: &str, value: Option<&str>) -> Checked<Share> {
        if value == Some("off") {
            return Ok(Share::NONE);
        }
        let of = number(name, value, "a fraction of the frames")?;
        if of > 1.0 {
            return refuse(
                name,
                format!("{of} is more than 1"),
                "give a fraction, 0 to 1",
            );
        }
        let id = self
            .id
            .map(|text| identifier("id", Some(text)))
            .transpose()?;
        Ok(Share { of, id })
    }

    fn wheel(&self) -> Checked<usize> {
        let remedy = format!("give wheel=NAME, one of {}", WHEELS.join(", "));
        let Some(text) = self.wheel else {
            return refuse("wheel", "is missing", remedy);
        };
        match WHEELS.iter().position(|wheel| *wheel == text) {
            Some(wheel) => Ok(wheel),
            None => refuse("wheel", format!("{text} is not a wheel"), remedy),
        }
    }
}

impl FaultSpec {
    /// Reads a fault for this group. `has_processor`: its robots are emulated.
    ///
    /// # Errors
    /// When the text cannot be meant: the part, the problem, the remedy.
    pub fn parse(text: &str, group: &GroupFile, has_processor: bool) -> Checked<Self> {
        let parts = Parts::split(text)?;
        let at_ns = parts.time.map(|text| seconds("t", text)).transpose()?;
        let lasts_ns = parts.lasts.map(|text| seconds("for", text)).transpose()?;
        let Some((name, value)) = parts.action.filter(|(name, _)| !name.is_empty()) else {
            return refuse("action", "is missing", known_actions());
        };
        let at_wheel = name.starts_with("encoder-") || name.starts_with("wheel-");
        if parts.wheel.is_some() && !at_wheel {
            return refuse("wheel", format!("does not apply to {name}"), "leave it out");
        }
        if parts.id.is_some() && !["corrupt", "lost-acknowledge"].contains(&name) {
            return refuse("id", format!("does not apply to {name}"), "leave it out");
        }
        let action = match bus_action(name, value, &parts)? {
            Some(action) => Action::Bus(action),
            None => {
                let robot = robot_action(name, value, &parts, has_processor)?;
                Action::Robot(parts.place(group)?, robot)
            }
        };
        if lasts_ns.is_some() && action.undone().is_none() {
            return refuse(
                "for",
                format!("does not apply to {name}, which has no duration"),
                "leave it out",
            );
        }
        Ok(Self {
            at_ns,
            lasts_ns,
            action,
        })
    }
}

/// What concerns the bus as a whole: it names no robot.
fn bus_action(name: &str, value: Option<&str>, parts: &Parts<'_>) -> Checked<Option<BusAction>> {
    Ok(Some(match (name, parts.node) {
        ("corrupt", None) => BusAction::Corrupt(parts.share(name, value)?),
        ("lost-acknowledge", None) => BusAction::LostAcknowledge(parts.share(name, value)?),
        ("lost-acknowledge", Some(_)) => {
            return refuse("node", "does not apply to lost-acknowledge", "leave it out");
        }
        ("babble", None) => BusAction::Babble(babble(name, value)?),
        ("delay", Some(MASTER)) => BusAction::Delay(delay(name, value)?),
        _ => return Ok(None),
    }))
}

fn babble(name: &str, value: Option<&str>) -> Checked<Option<u16>> {
    match value {
        None => Ok(Some(BABBLE)),
        Some("off") => Ok(None),
        Some(_) => identifier(name, value).map(Some),
    }
}

fn delay(name: &str, value: Option<&str>) -> Checked<u64> {
    match value {
        None => refuse(name, "has no value", "write delay=SECONDS"),
        Some("off") => Ok(0),
        Some(text) => seconds(name, text),
    }
}

fn robot_action(
    name: &str,
    value: Option<&str>,
    parts: &Parts<'_>,
    has_processor: bool,
) -> Checked<RobotAction> {
    let switch = || on_or_off(name, value);
    Ok(match name {
        "emergency-stop" => RobotAction::EmergencyStop(switch()?),
        "driver-fault" => RobotAction::DriverFault(switch()?),
        "protective-stop" => RobotAction::ProtectiveStop(switch()?),
        "bus-cut" => RobotAction::BusCut(switch()?),
        "bus-parts" => RobotAction::BusParts(switch()?),
        "corrupt" => RobotAction::BadReceiver(parts.share(name, value)?),
        "babble" => RobotAction::Babble(babble(name, value)?),
        "delay" => RobotAction::Delay(delay(name, value)?),
        "halt" | "crash" | "cable-cut" if !has_processor => {
            return refuse(
                name,
                "native robots have no processor",
                "serve with --backend emulator",
            );
        }
        "halt" => RobotAction::Halt(switch()?),
        "cable-cut" if value == Some("open") => RobotAction::Cable(Cable::Open),
        "cable-cut" => RobotAction::Cable(if switch()? {
            Cable::Low
        } else {
            Cable::Plugged
        }),
        "misses" if value == Some("off") => RobotAction::Misses(None),
        "misses" => RobotAction::Misses(Some(identifier(name, value)?)),
        "encoder-noise" => RobotAction::EncoderNoise(
            parts.wheel()?,
            number_or_off(name, value, "pulses per second")?,
        ),
        "encoder-slow-edges" => RobotAction::EncoderSlowEdges(
            parts.wheel()?,
            number_or_off(name, value, "R times C in us")? * 1e-6,
        ),
        "wheel-drag" => RobotAction::WheelDrag(
            parts.wheel()?,
            number_or_off(name, value, "a torque in N·m")?,
        ),
        "wheel-push" => {
            let torque = if value == Some("off") {
                Some("0")
            } else {
                value
            };
            let (sign, size) = match torque.and_then(|text| text.strip_prefix('-')) {
                Some(size) => (-1.0, Some(size)),
                None => (1.0, torque),
            };
            let torque = sign * number(name, size, "a torque in N·m")?;
            RobotAction::WheelPush(parts.wheel()?, torque)
        }
        "brake-torque" if value == Some("off") => RobotAction::BrakeTorque(BRAKE_TORQUE),
        "brake-torque" => RobotAction::BrakeTorque(number(name, value, "a torque in N·m")?),
        "brake-release" => {
            RobotAction::BrakeRelease(number_or_off(name, value, "a time in ms")? * 1e-3)
        }
        "brake-engage" => {
            RobotAction::BrakeEngage(number_or_off(name, value, "a time in ms")? * 1e-3)
        }
        "driver-trip" if value == Some("off") => RobotAction::DriverTrip(None),
        "driver-trip" => RobotAction::DriverTrip(Some(number(name, value, "a current in A")?)),
        "supply" => RobotAction::Supply(number(name, value, "a voltage in V")?),
        "no-regeneration" if value == Some("off") => RobotAction::NoRegeneration(None),
        "no-regeneration" => {
            let farad = number(name, value, "a capacitance in uF")? * 1e-6;
            if farad == 0.0 {
                return refuse(
                    name,
                    "0 is not a capacitance",
                    format!("write {name}=UF, more than 0"),
                );
            }
            RobotAction::NoRegeneration(Some(farad))
        }
        _ if value.is_some() && ACTIONS.contains(&name) => {
            return refuse(name, "takes no value", format!("write {name}"));
        }
        "power-cycle" => RobotAction::PowerCycle,
        "power-off" => RobotAction::Power(false),
        "power-on" => RobotAction::Power(true),
        "bus-off" => RobotAction::BusOff,
        "overrun" => RobotAction::Overrun,
        "crash" => RobotAction::Crash,
        "encoder-dead" => RobotAction::Encoder(parts.wheel()?, EncoderState::Dead),
        "encoder-one-channel" => RobotAction::Encoder(parts.wheel()?, EncoderState::OneChannel),
        "encoder-reversed" => RobotAction::Encoder(parts.wheel()?, EncoderState::Reversed),
        "encoder-floats" => RobotAction::Encoder(parts.wheel()?, EncoderState::Floats),
        "encoder-works" => RobotAction::Encoder(parts.wheel()?, EncoderState::Works),
        _ => return refuse(name, "is not an action", known_actions()),
    })
}

fn known_actions() -> String {
    format!("give one of {}", ACTIONS.join(", "))
}

fn on_or_off(name: &str, value: Option<&str>) -> Checked<bool> {
    match value {
        None | Some("on") => Ok(true),
        Some("off") => Ok(false),
        Some(other) => refuse(
            name,
            format!("{other} is neither on nor off"),
            format!("write {name} or {name}=off"),
        ),
    }
}

fn seconds(part: &str, text: &str) -> Checked<u64> {
    match text.parse::<f64>() {
        // At most a day, so the product fits.
        Ok(s) if (0.0..=LONGEST_S).contains(&s) => Ok((s * 1e9).round() as u64),
        _ => refuse(
            part,
            format!("{text} is not a time"),
            format!("give seconds, 0 to {LONGEST_S}"),
        ),
    }
}

fn number(name: &str, value: Option<&str>, what: &str) -> Checked<f64> {
    let remedy = format!("write {name}=VALUE, {what}, 0 to {MOST:e}");
    match value.map(str::parse::<f64>) {
        Some(Ok(number)) if (0.0..=MOST).contains(&number) => Ok(number),
        Some(_) => refuse(
            name,
            format!("{} is not a value", value.unwrap_or("")),
            remedy,
        ),
        None => refuse(name, "has no value", remedy),
    }
}

fn number_or_off(name: &str, value: Option<&str>, what: &str) -> Checked<f64> {
    if value == Some("off") {
        return Ok(0.0);
    }
    number(name, value, what)
}

fn identifier(name: &str, value: Option<&str>) -> Checked<u16> {
    let parsed = value.and_then(|text| match text.strip_prefix("0x") {
        Some(digits) => u16::from_str_radix(digits, 16).ok(),
        None => text.parse().ok(),
    });
    match parsed {
        Some(id) if id <= LAST_IDENTIFIER => Ok(id),
        _ => refuse(
            name,
            format!("{} is not an identifier", value.unwrap_or("nothing")),
            format!("write {name}=0x181, at most 0x7FF"),
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_may_come_in_any_order() {
        let group = GroupFile::load("../groups/tcc-3.toml").unwrap();
        let place = Place { robot: 1, node: 3 };
        let wanted = FaultSpec {
            at_ns: Some(5_250_000_000),
            lasts_ns: Some(1_500_000_000),
            action: Action::Robot(place, RobotAction::Encoder(2, EncoderState::Dead)),
        };
        for text in [
            "t=5.25:node=3:wheel=rear-left:encoder-dead:for=1.5",
            "encoder-dead:for=1.5:wheel=rear-left:node=3:t=5.25",
            " t = 5.25 : node = 3 : encoder-dead : wheel = rear-left : for = 1.5 ",
        ] {
            assert_eq!(FaultSpec::parse(text, &group, false), Ok(wanted), "{text}");
        }
    }
}
